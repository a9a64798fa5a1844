"""The functions that a caller has of a step, in no language: what each is given, whether it writes there, what it says.

A parameter is one of `s` (the state), `p` (the parameters), `in`, `out` (what a call is given), `x` (the estimate) and
`at` (a counter).
"""

from collections.abc import Iterable
from dataclasses import dataclass

from hgogen.program import Call, Place, Section, places, walk
from hgogen.step import Step

REACHED = {  # the parameter of a function that a place is reached through, or is, and the member of it
    "state": ("s", ""),
    "plant": ("p", "plant"),
    "gain": ("p", "gain"),
    "derived": ("p", "derived"),
    "input": ("in", ""),
    "output": ("out", ""),
    "estimate": ("x", ""),
    "argument": ("at", ""),
}
MEANINGS = {  # of the parameters
    "s": "the state: what a step remembers",
    "p": "the parameters",
    "in": "the input now",
    "out": "the measurement now",
    "x": "the estimate of the plant's state",
    "at": "the number of the period in which the sample was taken",
}


@dataclass(frozen=True)
class Entry:
    """A function: its name, its parameters and which of them it writes, whether it returns a status, whether a caller
    may call it; `anew`: those that it writes whatever they were; `inner`: the name of what it does once its state is
    ready, where others do that too."""

    name: str
    parameters: tuple[str, ...]
    written: tuple[str, ...]
    meaning: str
    status: bool = True
    public: bool = True
    anew: tuple[str, ...] = ()
    inner: str = ""


def entries(step: Step) -> dict[str, Entry]:
    """The functions by name, in the order in which they are shown: those of every step, then the sections that it is
    made of, which are none of the caller's where they cannot be called apart."""
    whole = "one sampling period: " + ", ".join(section.name for section in step.code.sections)
    does = ["limits them to their ranges"] * step.clock.guarded
    does += ["computes the derived ones"] * bool(step.layout.derived)
    limits = f"after a change of parameters: {' and '.join(does) or 'nothing is left to do'}"
    both, nominal = ("s", "p"), "nominal parameters, tuned, and a reset state"
    every = (
        Entry("init", both, both, nominal, status=False, anew=both),
        Entry("tune", ("p",), ("p",), limits),
        Entry("reset", ("s",), ("s",), "the state as before the first call", status=False, anew=("s",)),
        Entry("step", _parameters(step, {"in", "out"}), ("s",), whole),
        Entry("estimate", ("s", "p", "x"), ("x",), "the estimate of the plant's state", status=False, anew=("x",)),
    )
    parts = (*step.code.inner, *step.code.parts, *step.code.timed)
    return {entry.name: entry for entry in (*every, *(of_section(step, section) for section in parts))}


def of_section(step: Step, section: Section) -> Entry:
    """The function of a section."""
    called = (s.section.program for s in walk(section.program) if isinstance(s, Call))
    used = reached(place for program in (section.program, *called) for place, _ in places(program))
    public = step.code.apart and section.name not in {each.name for each in step.code.inner}  # a call may hold another
    meaning = f"part of a step: {section.meaning}"
    inner = f"run_{section.name}" if public and step.layout.mark and section in step.code.sections else ""
    return Entry(section.name, _parameters(step, used), ("s",), meaning, public=public, inner=inner)


def reached(places: Iterable[Place]) -> set[str]:
    """The parameters that places are reached through."""
    return {REACHED[place.struct][0] for place in places if place.struct in REACHED}


def direction(entry: Entry, name: str) -> str:
    """Whether a parameter goes in, comes out, or both."""
    return "in" if name not in entry.written else "out" if name in entry.anew else "in,out"


def _parameters(step: Step, used: set[str]) -> tuple[str, ...]:
    others = (*(["in"] if step.inputs else []), "out", "at")
    return ("s", "p", *(name for name in others if name in used))
