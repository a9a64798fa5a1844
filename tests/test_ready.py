"""Memory that was never made a state is told by every entry, and not used: in C, in Python, and in lanes."""

import re
from string import Template
from typing import Any

import emitted
import numpy as np
import pytest
from emitted import files, step, tool

import hgogen as hg
from hgogen.emit import layout
from hgogen.emit.interface import Prototype, address, entries, prototypes, structs
from hgogen.emit.naming import prefixed
from hgogen.emit.saved import mark
from hgogen.run import native
from hgogen.run.samples import Engine
from hgogen.stepping.guards import NO_PARAMETERS, UNINITIALISED, mark_number
from tests.sweep import by_turns

NAMES = [*emitted.STEPS]
# one of each kind: sections that ask by themselves, one section, sensors that say when, late samples, 32 bits of status
KINDS = ["two", "pendulum", "bank", "delayed", "no_input", "many_states", "wide"]
FILLS = ("0x00", "0xFF", "0xA5", "0xCD", "0x55", "0x01")
SANITIZE = ("-O1", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")
ENGINES = [pytest.param("c", marks=needs_compiler), "python"]

_GARBAGE = Template("""
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "$name.h"

static unsigned seed = 1u;

/* memory as it may be found: filled with one byte, or as a stack leaves it */
static void fill(void *object, size_t size, unsigned how)
{
    static const int bytes[] = {$fills};
    unsigned char *const memory = object;
    const unsigned count = (unsigned)(sizeof bytes/sizeof bytes[0]);
    if (how < count) {
        (void)memset(object, bytes[how], size);
    }
    for (size_t i = 0u; how >= count && i < size; ++i) {
        seed = 1664525u*seed + 1013904223u;
        memory[i] = (unsigned char)(seed >> 16);
    }
}

static int differs(const char *entry, unsigned how)
{
    (void)printf("%s from memory %u\\n", entry, how);
    return 1;
}

int main(void)
{
$locals
    uint16_t at = 0u;
    $state made;
    ${name}_init(&made, &p$t);
$samples
    for (unsigned how = 0u; how < 40u; ++how) {
        $state s;
        $state fresh;
        $params none;
$entries
        fill(&s, sizeof s, how);
        ${name}_reset(&s$t);
        if ($step_s != $step_made) {
            return differs("reset", how);
        }
        ${name}_reset(&made$t);
    }
    return 0;
}
""")
_ENTRY = Template("""
fill(&s, sizeof s, how);
fill(&fresh, sizeof fresh, how < 6u ? how : 0u);
${name}_reset(&fresh$t);
fill(&none, sizeof none, how);
if ($without != (unsigned long)(${upper}_NO_PARAMETERS | ${upper}_UNINITIALISED)
    || (how < 6u && memcmp(&s, &fresh, sizeof s) != 0)) {
    return differs("$entry without parameters", how);
}
if ($without != (unsigned long)${upper}_NO_PARAMETERS) {
    return differs("$entry without parameters again", how);
}
fill(&s, sizeof s, how);
for (unsigned k = 0u; k < 3u; ++k) {
    const unsigned long status = $mine;
    const unsigned long wanted = $its;
    if (status != (wanted | (k == 0u ? (unsigned long)${upper}_UNINITIALISED : 0u))) {
        return differs("$entry", how);
    }
    if ((wanted & ${upper}_UNINITIALISED) != 0u || (how < 6u && memcmp(&s, &fresh, sizeof s) != 0)) {
        return differs("$entry", how);
    }
}
""")


def asking(made: hg.Step) -> list[Prototype]:
    """The functions that a caller has and that change a state which there has to be."""
    known = entries(made).items()
    return [prototypes(made)[name] for name, each in known if each.public and each.status and "s" in each.written]


def called(function: Prototype, state: str, parameters: str = "p") -> str:
    """A call on a state and parameters of these names."""
    names = {"s": f"&{state}", "p": f"&{parameters}"}
    return function.call(lambda each: names.get(each.name, address(each)))


def garbage(made: hg.Step) -> str:
    """A program that calls each entry first on memory that is no state, and beside it on one that was reset."""
    values = {"name": made.name, "upper": made.name.upper(), "t": emitted.begin(made)}
    bodies = [
        _ENTRY.substitute(
            values,
            entry=each.name,
            mine=called(each, "s"),
            its=called(each, "fresh"),
            without=called(each, "s", "none"),
        )
        for each in asking(made)
    ]
    kinds = (("in", made.inputs), ("measurement", made.outputs), ("measurement", made.ages))
    number = {made.ages: "0", made.outputs: "1", made.inputs: "1"}
    samples = [f"    {short}.{s.name} = {number[signals]};" for short, signals in kinds for s in signals]
    whole = prototypes(made)["step"]
    return _GARBAGE.substitute(
        values,
        fills=", ".join(FILLS),
        state=f"{made.name}_state",
        params=f"{made.name}_params",
        locals="\n".join(f"    {each.local}" for each in structs(made) if each.name not in ("s", "x")),
        samples="\n".join(["    (void)at;", *samples]),
        entries="\n".join(bodies),
        step_s=called(whole, "s"),
        step_made=called(whole, "made"),
    )


@pytest.mark.ordinary("two-gcc", "pendulum-clang", "bank-gcc")
@pytest.mark.parametrize(("name", "compiler"), by_turns(KINDS, ["gcc", "clang"]))
def test_every_entry_tells_memory_that_is_no_state_and_begins_as_after_a_reset(
    name: str, compiler: str, tmp_path: Any
) -> None:
    made = step(name)
    assert len(asking(made)) == 1 + (len(made.code.sections) + len(made.code.timed)) * made.code.separable
    texts = {f"{made.name}.{end}": files(name)[f"{made.name}.{end}"] for end in "hc"} | {"main.c": garbage(made)}
    program = emitted.compiled(tool(compiler), texts, tmp_path, *SANITIZE)
    emitted.run([str(program)], tmp_path)


_TUNED = Template("""
#include <string.h>

#include "$name.h"

int main(void)
{
    static const ${name}_params constant = ${upper}_PARAMS_INIT;
    ${name}_params p;
    (void)memset(&p, 0, sizeof p);
    if (${name}_tune(&p) != ${upper}_NO_PARAMETERS) {
        return 1;
    }
    return ((${name}_tune(&p) == 0u) && (memcmp(&p, &constant, sizeof p) == 0)) ? 0 : 2;
}
""")


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_tune_makes_memory_that_is_none_nominal_parameters(compiler: str, tmp_path: Any) -> None:
    """Those with which constant parameters begin, bit for bit."""
    made = step("tunable")
    texts = {f"{made.name}.{end}": files("tunable")[f"{made.name}.{end}"] for end in "hc"}
    texts["main.c"] = _TUNED.substitute(name=made.name, upper=made.name.upper())
    emitted.run([str(emitted.compiled(tool(compiler), texts, tmp_path, *SANITIZE))], tmp_path)


_COPIES = Template("""
#include <string.h>

#include "left.h"
#include "right.h"

int main(void)
{
    left_state s;
    left_params p;
    right_state t;
    right_params q;
    left_input in = {0};
    left_output measurement = {0};
    right_input right_in = {0};
    right_output right_out = {0};
    unsigned char stored[sizeof s];
    left_init(&s, &p);
    right_init(&t, &q);
    (void)left_step(&s, &p, &in, &measurement);
    left_state copy = s;                        /* by value */
    (void)memcpy(stored, &s, sizeof s);         /* as a page of flash holds it */
    left_state restored;
    (void)memset(&restored, 0xFF, sizeof restored);
    (void)memcpy(&restored, stored, sizeof restored);
    const unsigned wanted = left_step(&s, &p, &in, &measurement);
    if (left_step(&copy, &p, &in, &measurement) != wanted || left_step(&restored, &p, &in, &measurement) != wanted) {
        return 1;
    }
    if (memcmp(&s, &copy, sizeof s) != 0 || memcmp(&s, &restored, sizeof s) != 0 || s.ready != LEFT_READY) {
        return 2;
    }
    if ((wanted & LEFT_UNINITIALISED) != 0u) {
        return 3;
    }
    (void)memset(&t, 0, sizeof t);              /* the other observer's state in the place of this one's */
    (void)memcpy(&t, &s, sizeof t < sizeof s ? sizeof t : sizeof s);
    if ((right_step(&t, &q, &right_in, &right_out) & RIGHT_UNINITIALISED) == 0u) {
        return 4;
    }
    stored[0] ^= 1u;                            /* a bit of the mark is lost */
    (void)memcpy(&restored, stored, sizeof restored);
    return ((left_step(&restored, &p, &in, &measurement) & LEFT_UNINITIALISED) != 0u) ? 0 : 5;
}
""")


@pytest.mark.full
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_copies_go_on_and_states_of_another_observer_do_not(compiler: str, tmp_path: Any) -> None:
    plant = step("pendulum").observer.form.system
    form = hg.forms.triangular(plant)
    left = prefixed(hg.sample(hg.observers.riccati(form, Q=[1, 1], R=1), dt=1e-3), "left")
    right = prefixed(hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1)), dt=1e-3), "right")
    texts = {file: text for one in (left, right) for file, text in hg.targets.c99(one, check=False).items()}
    program = emitted.compiled(tool(compiler), {**texts, "main.c": _COPIES.substitute()}, tmp_path, *SANITIZE)
    emitted.run([str(program)], tmp_path)


# --- the mark -----------------------------------------------------------------------------------------------


@pytest.mark.full
def test_a_mark_is_no_number_that_memory_is_likely_to_hold() -> None:
    marks = [mark(step(name), real) for name in NAMES for real in ("float", "double")]
    assert len(set(marks)) == len(marks)
    for number in marks:
        high, low = divmod(number, 256)
        assert len({high, low, 0x00, 0xFF}) == 4
        assert number <= 0xFFFF


def test_marks_of_any_program_have_two_bytes_that_differ() -> None:
    """Over the digests that there may be, as far as they count."""
    seen = {mark_number(bytes((high, low))) for high in range(0, 256, 5) for low in range(256)}
    assert all(number >> 8 != number & 0xFF for number in seen)
    assert all(0 < byte < 0xFF for number in seen for byte in divmod(number, 256))


# --- Python and lanes ---------------------------------------------------------------------------------------


def garbage_of(made: hg.Step, how: int) -> bytes:
    """Memory of the size of a state that nothing made one: filled, or drawn."""
    size = len(made._kept.state)
    return bytes([how]) * size if how < 256 else np.random.default_rng(how).bytes(size)


HOW = (0x00, 0xFF, 0xA5, 0xCD, 256, 257)


def samples_of(made: hg.Step, count: int = 30) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(2)
    y = np.hstack([draw.uniform(-1, 1, (count, len(made.outputs))), np.zeros((count, len(made.ages)))])
    return draw.uniform(-1, 1, (count, len(made.inputs))), y


@pytest.mark.ordinary("two-python", "pendulum-python", "many_states-c")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", KINDS)
def test_a_run_from_memory_that_is_no_state_is_one_from_a_reset(name: str, engine: Engine) -> None:
    made = step(name)
    u, y = samples_of(made)
    bit = 1 << [each.name for each in made.layout.bits].index("UNINITIALISED")
    made.reset()
    wanted, left = made.run(u, y, engine=engine), bytes(made._kept.state)
    assert not (wanted.status & bit).any()
    for how in HOW:
        made._kept.state[:] = garbage_of(made, how)
        run = made.run(u, y, engine=engine)
        np.testing.assert_array_equal(run.x, wanted.x)
        assert run.status.tolist() == [wanted.status[0] | bit, *wanted.status[1:]]
        assert values(made, bytes(made._kept.state)) == values(made, left)
    made.reset()


def values(made: hg.Step, state: bytes) -> list[bytes]:
    """The numbers of a state, without what lies between them."""
    record = np.frombuffer(state, layout.state_type(made))
    return [record["ready"].tobytes(), *(array.tobytes() for array in layout.state_places(made, record).values())]


@pytest.mark.parametrize("engine", ENGINES)
def test_parts_of_a_step_tell_it_and_say_what_comes_before_a_predict(engine: Engine) -> None:
    of = step("two")
    made = hg.sample(of.observer, of.method, of.dt, engine=engine)
    first = made.outputs[0].name
    made._kept.state[:] = bytes(len(made._kept.state))
    assert set(made.update(**{first: 0.1}).flags) == {"OUT_OF_ORDER", "UNINITIALISED"}
    assert made.update(**{first: 0.1}).flags == ("OUT_OF_ORDER",)
    made._kept.state[:] = b"\xff" * len(made._kept.state)
    assert "UNINITIALISED" in made.predict(u=0.1).flags
    assert "UNINITIALISED" not in made.update(**{first: 0.1}).flags


@pytest.mark.ordinary("pendulum-c", "pendulum-python", "bank-c", "two-python")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["pendulum", "bank", "two"])
def test_many_records_that_start_from_no_state(name: str, engine: Engine) -> None:
    """In lanes or one by one, the bits are those of each alone; the memory of the step itself is left as it is."""
    made = step(name)
    u, y = samples_of(made)
    for how in HOW:
        made._kept.state[:] = start = garbage_of(made, how)
        many = made.run_many(u, np.stack([y, 2 * y] * 5), engine=engine)
        assert engine == "python" or many.engine == "lanes"
        assert bytes(made._kept.state) == start
        for k, each in enumerate((y, 2 * y)):
            made._kept.state[:] = start
            alone = made.run(u, each, engine=engine)
            np.testing.assert_array_equal(many.x[k], alone.x)
            assert many.status[k].tolist() == alone.status.tolist()
            assert values(made, bytes(many.memory[k])) == values(made, bytes(made._kept.state))
        made._kept.state[:] = start
        assert bytes(made.run_many(u[:0], y[:0], engine=engine).memory[0]) == start
    made.reset()


@pytest.mark.parametrize("engine", ENGINES)
def test_without_parameters_no_sample_is_taken(engine: Engine) -> None:
    """Zeros ran open loop for ever with a status of 0."""
    of = step("two")
    made = hg.sample(of.observer, of.method, of.dt, engine=engine)
    u, y = samples_of(made)
    start = (made(u[0], y[0]) and made.reset()) or made.save()
    made(u[0], y[0])
    whole = bytes(made._kept.whole)
    parameters = made._kept.record["params"].view(np.uint8)
    parameters[:] = 0
    for _ in range(2):
        assert made(u[1], y[1]).flags == (NO_PARAMETERS.name,)
        assert values(made, made._kept.saved(made.save())) == values(made, made._kept.saved(start))
    made._kept.whole[:] = whole
    assert NO_PARAMETERS.name not in made(u[1], y[1]).flags


# --- where there is no mark ---------------------------------------------------------------------------------


def test_where_a_state_cannot_be_without_values_there_is_no_mark() -> None:
    made = step("two")
    crate, graphs = hg.targets.rust(made, check=False)["two.rs"], hg.targets.casadi(made)
    assert "ready" not in re.findall(r"pub (\w+):", crate)
    assert not {UNINITIALISED.name, NO_PARAMETERS.name} & set(re.findall(r"\w+", crate))
    assert "ready" not in graphs.memory.names
    assert not {UNINITIALISED.name, NO_PARAMETERS.name} & set(graphs.bits)


def test_without_guards_nothing_is_asked_and_nothing_is_remembered() -> None:
    plain = step("pendulum").rebuilt(guards="none")
    text = "".join(hg.targets.c99(plain, check=False).values())
    assert plain.layout.mark is None
    assert not re.search(f"ready|{UNINITIALISED.name}|{NO_PARAMETERS.name}", text, re.IGNORECASE)
    plain._kept.state[:] = bytes(len(plain._kept.state))
    assert plain(0.0, 0.1).status == 0
