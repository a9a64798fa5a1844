"""A program for a step or a peer: it runs over a record, and says its estimates, or the time of a sample."""

import re
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import emitted
import numpy as np
from cases import Case
from peers import EIGEN, Source

import hgogen as hg

BOARD = emitted.HERE / "c"
X86 = {"O2": ("-O2",), "O3": ("-O3", "-mavx2", "-mfma", "-ffp-contract=fast")}
M4F = ("-O2", *emitted.M4F, "-ffp-contract=fast")
ROWS = 600  # of a record in the flash of the board
Parts = tuple[Mapping[str, str], str, tuple[str, ...]]  # files, what drives the step, the step's own sources
COPIES = 40  # of the state, so that a tick of 40 instructions tells one of them

_HEAD = """
#include <stddef.h>
#define N {n}
#define COLUMNS {columns}
typedef {real} real;
"""
_OURS = """
#include "{name}.h"
typedef struct {{
    {name}_state s;
    {name}_params p;
}} memory;
#define BEGIN(m) {name}_init(&(m)->s, &(m)->p), sample(m, record[0])

static void sample(memory *m, const real *row)
{{
{pack}
    (void){name}_step({call});
}}

static void estimate(const memory *m, real *x)
{{
    {name}_plant plant;
    {name}_estimate(&m->s, &m->p, &plant);
{states}
}}
"""
_PEER = """
void peer_step(const real *w, const real *before, const real *row, real *next);
typedef struct {{
    real w[2][{size}];
    real before[COLUMNS];
    int now;
}} memory;
static const real start[{size}] = {{{start}}};
#define BEGIN(m) begin(m)

static void begin(memory *m)
{{
    for (int i = 0; i < {size}; ++i) {{
        m->w[0][i] = start[i];
    }}
    for (int i = 0; i < COLUMNS; ++i) {{
        m->before[i] = record[0][i];
    }}
    m->now = 0;
}}

static void sample(memory *m, const real *row)
{{
    peer_step(m->w[m->now], m->before, row, m->w[1 - m->now]);
    m->now = 1 - m->now;
    for (int i = 0; i < COLUMNS; ++i) {{
        m->before[i] = row[i];
    }}
}}

static void estimate(const memory *m, real *x)
{{
    for (int i = 0; i < N; ++i) {{
        x[i] = m->w[m->now][i];
    }}
}}
"""
_HOSTED = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
static memory m;

static void run(int samples)
{
    for (int k = 1; k <= samples; ++k) {
        sample(&m, record[1 + (k - 1) % (RECORD - 1)]);
    }
}

int main(int argc, char **argv)
{
    BEGIN(&m);
    if (argc > 2) { /* nanoseconds a sample */
        struct timespec a, b;
        for (int repeat = 0; repeat < atoi(argv[2]); ++repeat) {
            clock_gettime(CLOCK_MONOTONIC, &a);
            run(atoi(argv[1]));
            clock_gettime(CLOCK_MONOTONIC, &b);
            printf("%.6g\\n", ((b.tv_sec - a.tv_sec)*1e9 + (double)(b.tv_nsec - a.tv_nsec))/atoi(argv[1]));
        }
        return 0;
    }
    run(atoi(argv[1]));
    real x[N];
    estimate(&m, x);
    for (int i = 0; i < N; ++i) {
        printf("%.17g\\n", (double)x[i]);
    }
    return 0;
}
"""
_ON_BOARD = """
#include "mps2.h"
static memory m, copies[COPIES];
volatile real last;

static unsigned over(int first, int count)
{
    const unsigned start_ = ticks();
    for (int k = first; k < first + count; ++k) {
        sample(&m, record[k]);
    }
    return ticks() - start_;
}

static unsigned of_one(int k) /* the instructions of a sample, of so many runs of it */
{
    for (int i = 0; i < COPIES; ++i) {
        copies[i] = m;
    }
    const unsigned start_ = ticks();
    for (int i = 0; i < COPIES; ++i) {
        sample(&copies[i], record[k]);
    }
    const unsigned count = (ticks() - start_)*40u/COPIES;
    sample(&m, record[k]);
    return count;
}

int board_main(void)
{
    BEGIN(&m);
    paint();
    (void)over(1, 50);
    say_number("stack ", painted_over());
    say_number("quiet ", over(51, 200)*40u/200u);
    unsigned most = 0u;
    for (int k = QUIET; k < RECORD; ++k) {
        const unsigned count = of_one(k);
        most = (count > most) ? count : most;
    }
    say_number("worst ", most);
    say_number("ram ", sizeof m);
    real x[N];
    estimate(&m, x);
    last = x[0];
    return 0;
}
"""


class CannotBuild(RuntimeError):
    """A compiler that is missing, or refuses a program."""


@dataclass(frozen=True)
class Built:
    """A program, the seconds that its step took to compile, and the bytes of the step's text."""

    path: Path
    seconds: float
    text: int


def said(command: Sequence[object], folder: Path, timeout: float = 900) -> str:
    """What a command prints. Raises: `CannotBuild`."""
    try:
        done = subprocess.run(list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=timeout)
    except (FileNotFoundError, subprocess.TimeoutExpired) as error:
        raise CannotBuild(str(error)) from None
    if done.returncode:
        raise CannotBuild(f"{' '.join(map(str, command))}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout + done.stderr


def _record(rows: np.ndarray, real: str, quiet: int) -> str:
    lines = ",\n".join("    {" + ", ".join(_literal(v, real) for v in row) + "}" for row in rows.tolist())
    head = f"#define RECORD {len(rows)}\n#define QUIET {quiet}\n#include <math.h>\n"
    return f"{head}static const real record[RECORD][COLUMNS] = {{\n{lines}\n}};\n"


def _literal(value: float, real: str) -> str:
    if not np.isfinite(value):
        return "NAN" if np.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"
    return f"{value!r}f" if real == "float" else repr(value)


def ours(case: Case, real: str) -> Parts:
    """What a program of a step consists of."""
    step, name = case.step, case.step.name
    files = {k: v for k, v in hg.targets.c99(step, real=real).items() if "check" not in k}
    pack, call, column = [], ["&m->s", "&m->p"], 0
    for kind, short, signals in (("input", "in", step.inputs), ("output", "out", step.samples)):
        if signals:
            pack.append(f"    {name}_{kind} {short};")
            call.append(f"&{short}")
        for s in signals:
            pack.append(f"    {short}.{s.name} = row[{column}];")
            column += 1
    states = "\n".join(f"    x[{i}] = plant.{x.name};" for i, x in enumerate(case.plant.declared.states))
    text = _OURS.format(name=name, pack="\n".join(pack), call=", ".join(call), states=states)
    return files, text, (f"{name}.c",)


def peer(source: Source, start: Sequence[float], real: str) -> Parts:
    """The same of a peer."""
    file = "peer.c" if source.language == "c" else "peer.cpp"
    text = _PEER.format(size=len(start), start=", ".join(_literal(v, real) for v in start))
    return {file: source.text}, text, (file,)


def built(
    case: Case,
    parts: Parts,
    real: str,
    folder: Path,
    board: bool,
    flags: Sequence[str],
) -> Built:
    """The program of a step or a peer, on this machine or, for the `board`, of QEMU's.

    Raises: `CannotBuild`.
    """
    files, drive, sources = parts
    rows = case.quiet if not board else np.concatenate([case.quiet[: ROWS // 2], case.hostile[: ROWS // 2]])
    head = _HEAD.format(real=real, n=len(case.plant.declared.states), columns=rows.shape[1])
    main = (
        head + _record(rows, real, ROWS // 2) + drive + (f"#define COPIES {COPIES}\n{_ON_BOARD}" if board else _HOSTED)
    )
    hg.write({**files, "main.c": main}, folder)
    prefix = "arm-none-eabi-" if board else ""
    objects, begin = [], time.perf_counter()
    for file in sources:
        objects.append(f"{Path(file).stem}.o")
        compiler = ["gcc", "-std=c99"] if file.endswith(".c") else ["g++", "-std=c++17", f"-I{EIGEN}"]
        said([f"{prefix}{compiler[0]}", *compiler[1:], *flags, "-w", "-c", file, "-o", objects[-1]], folder)
    seconds = time.perf_counter() - begin
    size = int(said([f"{prefix}size", *objects], folder).splitlines()[1].split()[0])
    common = [f"{prefix}gcc", "-std=gnu99", *flags, "-w", "main.c", *objects]
    if board:
        common += [f"-I{BOARD}", "-I.", "-nostartfiles", "-T", BOARD / "mps2.ld", BOARD / "mps2.c"]
    end = ["-lm"] if board else ["-lm", "-lstdc++"]
    said([*common, "-o", "program", *end], folder)
    return Built(folder / "program", seconds, size)


def estimates(program: Path, samples: int) -> np.ndarray:
    """The estimate after so many samples."""
    return np.array(said([program, samples], program.parent).split(), dtype=float)


def instructions(program: Path) -> int:
    """Of a sample, by callgrind: the difference of two runs."""
    counts = []
    for samples in (200, 1200):
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={program}.out", program, samples]
        total = re.search(r"Collected : (\d+)", said(command, program.parent))
        assert total is not None
        counts.append(int(total[1]))
    return round((counts[1] - counts[0]) / 1000)


def nanoseconds(program: Path, samples: int, repeats: int) -> list[float]:
    """A sample, of some runs over so many."""
    return list(map(float, said([program, samples, repeats], program.parent).split()))


def on_board(program: Path) -> dict[str, int]:
    """Instructions of a sample, quiet and the worst of the hostile rows, bytes of stack and RAM, on a Cortex-M4F."""
    options = ["-nographic", "-icount", "shift=0", "-semihosting-config", "enable=on,target=native"]
    text = said(["qemu-system-arm", "-M", "mps2-an386", *options, "-kernel", program], program.parent)
    return {key: int(value) for key, value in re.findall(r"(\w+) (\d+)", text)}
