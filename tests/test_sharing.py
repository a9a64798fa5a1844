"""What stands in several places of a step is one function of its C, and does there what it did."""

import re
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import emitted
import plants
import pytest
from emitted import step

import hgogen as hg
from hgogen.emit.sharing import FEWEST, SharingWriter, _name, _runs
from hgogen.emit.syntaxes import C
from hgogen.model import load
from hgogen.program import Block, Place, When, sym
from hgogen.stepping.members import read_fields
from hgogen.stepping.projection import SWEEPS

SHIPPED = ["induction_motor", "pmsm_sensorless", "quadruple_tank", "not_iss"]
NAMES = [*emitted.STEPS, *SHIPPED]


@cache
def made(name: str) -> hg.Step:
    if name in emitted.STEPS:
        return step(name)
    return load(next(path for path in plants.MODELS.glob(f"{name}.*"))).step()


@cache
def source(name: str) -> str:
    texts = emitted.files(name) if name in emitted.STEPS else hg.targets.c99(made(name), check=False)
    return texts[f"{made(name).name}.c"]


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "delayed")
@pytest.mark.parametrize("name", NAMES)
def test_no_list_of_first_values_stands_twice(name: str) -> None:
    """But that of the estimate, with which the compiler folds what comes after it."""
    shown = "|".join(read_fields([made(name).observer.z]))
    lines = [line.strip() for line in source(name).splitlines()]
    value = rf"s->(?!(?:{shown})\b)\w+(\[\d+\])? = (-?[\d.e+-]+f?|\d+u);"
    begins = [re.fullmatch(value, line) is not None for line in lines]
    runs = [tuple(lines[k : k + FEWEST]) for k in range(len(lines)) if all(begins[k : k + FEWEST])]
    assert runs or made(name).clock.guards == "none"
    assert [run for run, times in Counter(runs).items() if times > 1] == []


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks")
@pytest.mark.parametrize("name", NAMES)
def test_each_box_of_several_numbers_stands_once(name: str) -> None:
    """Each text of what keeps a field in its box, which differs where it is another box."""
    texts = re.findall(r"( */\* keep \w+ in its box \*/\n(?: +)\{\n(?:.*\n)*?) +\}\n(?! +(?:if|\}))", source(name))
    texts = [re.sub(r"\s+", " ", text) for text in texts if text.count("s->") >= 2 * FEWEST]
    assert len(texts) == len(set(texts))


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", NAMES)
def test_a_part_is_called_more_than_once_and_writes_more_than_a_call_does(name: str) -> None:
    text, writer = source(name), SharingWriter(C, made(name), "float")
    for part in writer.parts:
        calls = re.findall(rf"\b{part.prototype.name}\(s\);", text)
        assert len(calls) >= 2
        assert sum(" = " in line and "const" not in line for line in part.body.lines) >= FEWEST
    assert len({part.prototype.name for part in writer.parts}) == len(writer.parts)


@pytest.mark.parametrize("name", ["battery", "lithium_cell", "not_iss"])
def test_each_sweep_of_a_fit_calls_one_function(name: str) -> None:
    """However few numbers it writes, and however short the function around it is."""
    text = source(name)
    for output in made(name).outputs:
        prototype, calls = rf"static void {made(name).name}_fit_{output}\(", rf"^ +\w+_fit_{output}\(s, "
        assert len(re.findall(prototype, text)) == 1
        assert len(re.findall(calls, text, re.MULTILINE)) == SWEEPS
        assert text.count(f"/* from the sample of {output} */") == 1


def test_parts_of_one_name_that_differ_have_a_number() -> None:
    """And one that stands once is no function."""
    of = made("two")
    first, second, third = (
        Block(
            "all",
            {Place("state", "z"): sym("state", "z", 3) * k, Place("state", "L"): sym("state", "L", 3)},
            part="same",
        )
        for k in (2, 3, 4)
    )
    sections = (
        replace(of.code.sections[0], program=(first, second, third)),
        replace(of.code.sections[1], program=(When(Place("work", "fresh"), (second, first)),)),
    )
    writer = SharingWriter(C, with_parts(of, code=replace(of.code, sections=sections, inner=())), "float")
    assert [part.prototype.name for part in writer.parts] == ["two_same", "two_same_2"]
    assert "4.0f" not in "".join("".join(part.body.lines) for part in writer.parts)
    assert "4.0f" in "".join(writer.function(sections[0].program).lines)


def test_a_part_writes_so_many_numbers_of_the_state_wherever_it_stands() -> None:
    """Bits of the status are none of them."""
    of = made("two")

    def block(name: str, *more: Place) -> Block:
        values = {Place("state", "z"): sym("state", "z", 3) * 2, **dict.fromkeys(more, sym("state", "calls") * 3)}
        return Block(name, values, part=name)

    enough = block("enough", Place("state", "fault_count_range"))
    few = block("few", Place("status", "RESTARTED"))
    program = (enough, few, When(Place("state", "calls"), (few,), (enough,)))
    sections = (replace(of.code.sections[0], program=program), *of.code.sections[1:])
    writer = SharingWriter(C, with_parts(of, code=replace(of.code, sections=sections)), "float")
    names = {part.prototype.name for part in writer.parts}
    assert "two_enough" in names
    assert "two_few" not in names
    assert sum(size for _, size in enough.written) == sum(size for _, size in few.written) == FEWEST


def test_a_part_that_says_something_leaves_nothing_as_after_a_reset() -> None:
    of = made("two")
    start = {
        Place("state", "z"): sym("state", "z", 3) * 0,
        Place("state", "fault_count_range"): sym("state", "calls") * 0,
    }
    writer = SharingWriter(C, of, "float")
    assert writer._reset_places((Block("start", start),)) == set(start)
    assert (
        writer._reset_places((Block("start", {**start, Place("status", "RESTARTED"): sym("state", "calls") + 1}),))
        == set()
    )


@pytest.mark.parametrize("part", ["correct", "limit", "sqrt", "flow", "step", "ready"])
def test_a_part_is_not_named_as_another_function_of_the_file(part: str) -> None:
    """A kernel, a small and a mathematical function, a routine, the interface: once in a long section, or twice."""
    of = made("many_states")
    fields = [field for field in of.layout.state if field.kind == "real"]
    block = Block("b", {Place("state", f.name): sym("state", f.name, f.size) * 2 for f in fields}, part=part)
    section, writer = replace(of.code.sections[0], name="predict", corrects=None), SharingWriter(C, of, "float")
    writer._outlined(part, (block,), section)
    assert list(writer.functions) == [f"{part}_predict"]
    program = (When(Place("state", "calls"), (block,), (block,)), *section.program)
    sections = (replace(section, program=program), *of.code.sections[1:])
    parts = SharingWriter(C, with_parts(of, code=replace(of.code, sections=sections)), "float").parts
    assert f"{of.name}_{part}_2" in {each.prototype.name for each in parts}
    assert f"{of.name}_{part}" not in {each.prototype.name for each in parts}


def with_parts(of: hg.Step, **parts: Any) -> hg.Step:
    """The program of a step, with other parts."""
    return replace(hg.Step(of.name, of.observer, of.method, of.clock, of.layout, of.code), **parts)


def test_only_what_is_as_after_a_reset_stands_in_the_reset() -> None:
    writer = SharingWriter(C, made("fitzhugh_nagumo"), "float")
    names = {place.name for place in writer.resetting if place.struct == "state"}
    assert {"fault_count_y", "theta", "L", "D", "oldest"} <= names
    assert not names & {"z", "calls", "used_y", "u"}
    assert Place("predictor", "z") in writer.resetting
    first, *others = made("fitzhugh_nagumo").layout.state
    state = (replace(first, initial=(1.0, 2.0, 3.0)), *others)
    other = with_parts(made("fitzhugh_nagumo"), layout=replace(made("fitzhugh_nagumo").layout, state=state))
    assert Place("predictor", "z") not in SharingWriter(C, other, "float").resetting


def test_what_keeps_a_value_does_not_begin_from_a_reset() -> None:
    """The memory holds anything before a reset: twice nothing is as after one, twice what is there is not."""
    step = made("fitzhugh_nagumo")
    place, writer = Place("state", "fault_count_y"), SharingWriter(C, step, "float")
    (first,) = (field.initial for field in step.layout.state if field.name == place.name)
    begins, keeps = (
        Block("b", {place: value}, part="b") for value in (ca.SX(list(first)), sym(*place, len(first)) * 2)
    )
    assert first == (0.0,)
    assert [writer._reset_places((block,)) for block in (begins, keeps)] == [{place}, set()]


def test_a_part_ends_where_something_else_is_touched() -> None:
    """At another part, at what reads a work value, at a condition; what is not of the state is none."""
    z, L = ({Place("state", name): sym("state", name, 3) * 2} for name in "zL")
    work = Block("work", {Place("work", "e"): sym("state", "z", 3)})
    begun, more, other = (
        Block("begun", {**z, **L}, part="begun"),
        Block("more", L),
        Block("other", {**z, **L}, part="other"),
    )
    none = Block("none", {Place("state", "z"): sym("work", "e", 3)}, part="none")
    when = When(Place("state", "calls"), (more,))
    program = (begun, more, other, work, more, begun, when, none, begun, none)
    assert [len(run) for run in _runs(program)] == [2, 1, 1, 1, 1, 1, 1, 1, 1]
    assert [_name(run) for run in _runs(program)] == ["begun", "other", "", "", "begun", "", "", "begun", ""]
