"""Emitted C under any input, any restored state and any parameter: sanitizers, Python's bits, and recovery."""

from collections.abc import Mapping
from pathlib import Path
from string import Template

import emitted
import numpy as np
import pytest
from emitted import files, run, step, tool
from exact import machine
from native_step import NUMBER, NativeStep, unpack_state
from oracle import fitzhugh_nagumo as fn

import hgogen as hg
from hgogen.emit import layout
from hgogen.emit.saved import mark
from hgogen.emit.syntax import Real
from hgogen.emit.syntaxes import C
from hgogen.program import Place, lines_of
from hgogen.run import native

NAMES = list(emitted.STEPS)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
NASTY = (0.0, -0.0, 1e-45, -1e-40, 1.0, -1.0, 1e6, 1e15, -1e16, 1e30, -1e30, 3e38, -3e38, np.nan, np.inf, -np.inf)

# --- sanitizers ---------------------------------------------------------------------------------------------

_NASTY = Template("""
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "$name.h"

static unsigned seed = 1u;

static unsigned draw(void)
{
    seed = 1664525u*seed + 1013904223u;
    return (seed >> 8) & 0xffffu;
}

static $real nasty(void)
{
    static const $real values[] = {$values, ($real)NAN, ($real)INFINITY, -($real)INFINITY};
    return values[draw() % (sizeof values/sizeof values[0])];
}

static void noise(void *object, size_t size)
{
    unsigned char *const bytes = object;
    for (size_t i = 0u; i < size; ++i) {
        bytes[i] = (unsigned char)draw();
    }
}

int main(void)
{
    for (unsigned round = 0u; round < ${rounds}u; ++round) {
        ${name}_state s;
        ${name}_params p;
        ${name}_output measurement;
        ${name}_plant x;
$input
        ${name}_init(&s, &p$t);
        if (round % 2u == 1u) { /* a state restored from worn memory */
            noise(&s, sizeof s);
        }
        if (round % 8u < 4u) { /* with the mark of a state */
            s.ready = ${upper}_READY;
        }
        if (round % 4u > 1u) {
            noise(&p, sizeof p);
            (void)${name}_tune(&p);
        }
        for (unsigned k = 0u; k < 12u; ++k) {
$fill
            const unsigned long status = ${name}_step($call);
            const bool began = (status & ${upper}_UNINITIALISED) != 0u;
            ${name}_estimate(&s, &p, &x);
            if (began != (k == 0u && round % 8u > 3u && round % 2u == 1u)) {
                printf("round %u, sample %u: the state began anew, or did not\\n", round, k);
                return 1;
            }
            if ((round % 8u > 3u || round % 2u == 0u) && !($box)) {
                printf("round %u, sample %u: the state is out of its box\\n", round, k);
                return 1;
            }
            if (k > 0u && !($finite)) {
                printf("round %u, sample %u: the estimate is not finite\\n", round, k);
                return 1;
            }
        }
    }
    return 0;
}
""")


def nasty(name: str, real: Real, rounds: int) -> Mapping[str, str]:
    """A program that steps over absurd inputs, from reset and from random states, with random parameters."""
    made = step(name)
    sides = [
        f"{e.text} {sign} {C.literal(end, 'unsigned' if e.field.kind == 'index' else real)}"
        for e in emitted.elements(made)
        for sign, end in ((">=", e.low), ("<=", e.high))
        if (e.field.kind, sign) != ("index", ">=") and e.field.name != "innovation_e"  # NaN for a missing sample
    ]
    members = [*(f"in.{s.name}" for s in made.given), *(f"measurement.{s.name}" for s in made.samples)]
    text = _NASTY.substitute(
        name=made.name,
        upper=made.name.upper(),
        real=real,
        t=emitted.begin(made),
        rounds=rounds,
        values=", ".join(f"({real}){value!r}" for value in NASTY if np.isfinite(value)),
        input=f"        {made.name}_input in;" if made.given else "",
        fill="\n".join(f"            {member} = nasty();" for member in members),
        call="&s, &p, &in, &measurement" if made.given else "&s, &p, &measurement",
        box="\n                && ".join(sides),
        finite=" && ".join(f"isfinite(x.{s.name})" for s in made.states),
    )
    return {**{f"{made.name}.{end}": files(name, real)[f"{made.name}.{end}"] for end in "hc"}, "main.c": text}


SANITIZE = ("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-g1", "-O1")

DIVIDE = ("-fsanitize=float-divide-by-zero",)


def sanitized(name: str, real: Real, compiler: str, folder: Path, rounds: int) -> None:
    """The self-check, which divides by no zero; then worn states, whose infinite values the guards meet."""
    for texts, more in ((files(name, real), DIVIDE), (nasty(name, real, rounds), ())):
        run([str(emitted.compiled(tool(compiler), texts, folder, *SANITIZE, *more))], folder)
        for file in folder.iterdir():
            file.unlink()


@pytest.mark.ordinary("fitzhugh_nagumo-float", "window_held-float")
@pytest.mark.parametrize(
    ("name", "real"),
    [
        *(("fitzhugh_nagumo", "double"), ("fitzhugh_nagumo", "float"), ("functions", "float")),
        *(("window_held", "float"), ("many_states", "double"), ("integrated", "double")),
        ("delayed", "float"),
    ],
)
def test_sanitizers_find_nothing_under_absurd_inputs(name: str, real: Real, tmp_path: Path) -> None:
    sanitized(name, real, "gcc", tmp_path, 200)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", NAMES)
def test_sanitizers_find_nothing_in_any_model(name: str, real: Real, compiler: str, tmp_path: Path) -> None:
    sanitized(name, real, compiler, tmp_path, 3000)


@pytest.mark.full
def test_sanitizers_find_a_seeded_index(tmp_path: Path) -> None:
    """So that the tests above cannot pass on nothing."""
    texts = dict(nasty("fitzhugh_nagumo", "float", 10))
    wrong = texts["fitzhugh_nagumo.c"].replace("k < 5u", "k < 6u")
    program = emitted.compiled(tool("gcc"), {**texts, "fitzhugh_nagumo.c": wrong}, tmp_path, *SANITIZE, "-Wno-error")
    with pytest.raises(AssertionError, match=r"runtime error|AddressSanitizer"):
        run([str(program)], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_memcheck_finds_nothing_read_before_it_is_written(name: str, tmp_path: Path) -> None:
    for texts in (files(name), nasty(name, "float", 100)):
        program = emitted.compiled(tool("gcc"), texts, tmp_path, "-g", "-O1")
        run([tool("valgrind"), "-q", "--error-exitcode=9", str(program)], tmp_path)
        for file in tmp_path.iterdir():
            file.unlink()


# --- Python's bits ------------------------------------------------------------------------------------------


def random_state(made: hg.Step, record: np.ndarray, draw: np.random.Generator) -> None:
    """Numbers in their boxes, beyond them, and of every size; counters in their ranges."""
    members = [(record[0], made.layout.state)]
    for line in lines_of(made.layout.groups):
        rows = [record[0]]
        for group in line:
            rows = [row for above in rows for row in above[group.name]]
        members += [(row, line[-1].fields) for row in rows]
    absurd = draw.random() < 0.2
    for row, fields in members:
        for field in fields:
            low, high = (np.array(ends) for ends in zip(*field.box, strict=True))
            if field.kind == "index":
                row[field.name] = draw.integers(0, int(high[0]) + 1)
                continue
            low, high = np.maximum(low, -20), np.minimum(high, 20)
            values = low + (high - low) * draw.uniform(-0.2, 1.2, field.size)
            values = np.maximum(values, 1e-9) if field.name in ("D", "theta") else values
            values = np.where(absurd & (draw.random(field.size) < 0.3), draw.choice(NASTY, field.size), values)
            row[field.name] = values if field.size > 1 else values[0]


def random_samples(signals: tuple[hg.Signal, ...], draw: np.random.Generator) -> np.ndarray:
    low, high = (np.array([max(min(s.interval[end], 10), -10) for s in signals]) for end in (0, 1))
    values = low + (high - low) * draw.uniform(-0.3, 1.3, len(signals))
    return np.where(draw.random(len(signals)) < 0.1, draw.choice(NASTY, len(signals)), values)[None]


@pytest.mark.ordinary("pendulum", "one_state", "many_states")
@needs_compiler
@pytest.mark.parametrize("name", NAMES)
def test_from_any_state_python_computes_the_same_bits(name: str) -> None:
    """Every branch, guards and caps and restarts, which a record from a reset does not reach; NaN equal to NaN."""
    made, draw = step(name), np.random.default_rng(3)
    reader, compiled = machine(made, "float"), NativeStep(made, "float")
    kind, seen = layout.state_type(made, "float"), 0
    for _ in range(12 if name in ("functions", "many_states", "wide", "wider") else 60):
        state = np.zeros(1, kind)
        random_state(made, state, draw)
        u, y = (random_samples(signals, draw).astype(np.float32) for signals in (made.given, made.samples))
        unpack_state(made, state, reader.memory)
        compiled.state[:] = state
        compiled.state["ready"] = mark(made, "float")
        for place, row in (
            ("input", zip(made.given, u[0], strict=True)),
            ("output", zip(made.samples, y[0], strict=True)),
        ):
            for signal, value in row:
                reader.memory[Place(place, signal.name)][0] = value
        status, result = reader.call(), compiled.run(u, y)
        assert result.status[0] == status
        seen |= status
        x = [reader.memory[Place("estimate", s.name)][0] for s in made.states]
        np.testing.assert_array_equal(result.x[0], x)
        again = {place: array.copy() for place, array in reader.memory.items()}
        unpack_state(made, compiled.state, again)
        for place, array in again.items():
            np.testing.assert_array_equal(array, reader.memory[place], err_msg=place)
    assert seen.bit_count() >= 5


@needs_compiler
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "tunable", "one_state", "no_input"])
def test_any_parameters_are_tuned_to_the_same_bits(name: str) -> None:
    made, draw = step(name), np.random.default_rng(4)
    reader, compiled = machine(made, "float"), NativeStep(made, "float")
    kinds = (("plant", made.layout.plant), ("gain", made.layout.gains))
    limited = 0
    for _ in range(100):
        for kind, fields in kinds:
            for field in fields:
                low, high = (np.array(ends) for ends in zip(*field.box, strict=True))
                values = low + (high - low) * draw.uniform(-0.1, 1.1, field.size)
                values = np.where(draw.random(field.size) < 0.2, draw.choice(NASTY, field.size), values)
                reader.memory[Place(kind, field.name)][:] = values
                compiled.params[kind][field.name][0] = values if field.size > 1 else values[0]
        status = reader.tune()
        assert compiled.tune() == status
        limited += status != 0
        for kind, fields in (*kinds, ("derived", made.layout.derived)):
            for field in fields:
                values = np.ravel(compiled.params[kind][field.name][0])
                np.testing.assert_array_equal(values, reader.memory[Place(kind, field.name)], err_msg=field.name)
                low, high = (np.array(ends, np.float32) for ends in zip(*field.box, strict=True))
                assert np.isfinite(values).all()
                assert (values >= low).all()
                assert (values <= high).all()
    assert 0 < limited < 100


@pytest.mark.ordinary("fitzhugh_nagumo-float", "two-float", "two-double", "no_input-float", "wide-float")
@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "two", "no_input", "wide"])
def test_a_record_is_its_steps(name: str, real: Real) -> None:
    made, draw = step(name), np.random.default_rng(5)
    u, y = (
        np.concatenate([random_samples(signals, draw) for _ in range(300)]).astype(NUMBER[real])
        for signals in (made.inputs, made.samples)
    )
    whole, single = NativeStep(made, real), NativeStep(made, real)
    record, steps = whole.run(u, y), single.step_by_step(u, y)
    np.testing.assert_array_equal(record.x, steps.x)
    np.testing.assert_array_equal(record.traces, steps.traces.reshape(record.traces.shape))
    np.testing.assert_array_equal(record.status, steps.status)
    assert whole.state.tobytes() == single.state.tobytes()


# --- recovery -----------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 3e38, -3e38])
@pytest.mark.parametrize("signal", ["y", "u"])
def test_the_estimate_recovers_from_absurd_samples(signal: str, value: float, real: Real) -> None:
    """Half a second of absurd samples while the estimate is good: nothing but the samples is lost.

    Without noise, and with eta right, the model predicts half a second to within what a lost input of at most 1 can do,
    u x2 for half a second; the trial's own settling time, 13 s, takes that back to the trial's band on eta, 0.3.
    """
    scenario = fn.Scenario((), 40.0)
    t, truth = fn.times(scenario), fn.truth(scenario)
    made = step("fitzhugh_nagumo")
    compiled, u, y = NativeStep(made, real), np.sin(t), truth[:, 0].copy()
    lost = (t >= 25) & (t < 25.5)
    {"u": u, "y": y}[signal][lost] = value
    result = compiled.run(u, y)
    assert np.isfinite(result.x).all()
    names = {made.layout.bits[k].name for k in range(len(made.layout.bits)) for s in result.status[lost] if s >> k & 1}
    wanted = {"y": "REJECTED_Y" if np.isfinite(value) else "MISSING_Y", "u": "REUSED_U"}[signal]
    assert wanted in names
    assert np.abs(result.x[t < 25] - truth[t < 25])[-1].max() < 0.3
    assert np.abs(result.x - truth)[t >= 25 + 13].max() < 0.3


@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
def test_a_state_of_random_bytes_recovers(real: Real) -> None:
    """A worn memory is no worse than a wrong start: within the settling time the estimate is back."""
    scenario = fn.Scenario((), 40.0)
    t, truth = fn.times(scenario), fn.truth(scenario)
    compiled = NativeStep(step("fitzhugh_nagumo"), real)
    draw = np.random.default_rng(6)
    for _ in range(20):
        compiled.state.view(np.uint8)[:] = draw.integers(0, 256, compiled.state.nbytes, np.uint8)
        result = compiled.run(np.sin(t), truth[:, 0])
        assert np.isfinite(result.x[1:]).all()
        assert np.abs(result.x - truth)[t >= 38].max() < 0.3
