"""A program for a step or a peer: it runs over a record, and says its estimates, or the time of a sample."""

import re
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cases import Case
from peers import EIGEN, Source

import hgogen as hg
from hgogen.extras import costs as qemu
from hgogen.extras.costs import ROWS, counting_program, driver, harness, head, literal

X86 = {"O2": ("-O2",), "O3": ("-O3", "-mavx2", "-mfma", "-ffp-contract=fast")}
CPP = ("-std=c++17", f"-I{EIGEN}", "-DNDEBUG", "-fno-exceptions")  # no test of an index, nothing that unwinds
M4F = ("-O2", *qemu.M4F, "-ffp-contract=fast")
Parts = tuple[Mapping[str, str], str, tuple[str, ...]]  # files, what drives the step, the step's own sources

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


def ours(case: Case, real: str) -> Parts:
    """What a program of a step consists of."""
    files = hg.targets.c99(case.step, real=real, check=False)
    return files, driver(case.step), (f"{case.step.name}.c",)


def peer(source: Source, start: Sequence[float], real: str) -> Parts:
    """The same of a peer."""
    file = "peer.c" if source.language == "c" else "peer.cpp"
    text = _PEER.format(size=len(start), start=", ".join(literal(v, real) for v in start))
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
    main = head(rows, real, len(case.plant.declared.states), ROWS // 2)
    main += counting_program(drive) if board else f"{drive}\n{_HOSTED}"
    hg.write({**files, "main.c": main}, folder)
    prefix = "arm-none-eabi-" if board else ""
    objects, begin = [], time.perf_counter()
    for file in sources:
        objects.append(f"{Path(file).stem}.o")
        compiler = ["gcc", "-std=c99"] if file.endswith(".c") else ["g++", *CPP]
        said([f"{prefix}{compiler[0]}", *compiler[1:], *flags, "-w", "-c", file, "-o", objects[-1]], folder)
    seconds = time.perf_counter() - begin
    size = int(said([f"{prefix}size", *objects], folder).splitlines()[1].split()[0])
    if board:
        return Built(qemu.linked(main, objects, harness(), folder, flags), seconds, size)
    said(["gcc", "-std=gnu99", *flags, "-w", "main.c", *objects, "-o", "program", "-lm", "-lstdc++"], folder)
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
