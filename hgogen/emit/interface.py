"""The functions that a caller has of a step: in no language, what each is given, whether it writes there and what it
says; and as C, from which declarations and calls are printed.

A parameter is one of `s` (the state), `p` (the parameters), `in`, `measurement` (what a call is given), `x` (the
estimate) and `at` (a counter).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from hgogen.program import Call, Place, Section, places, walk
from hgogen.signal import Signal
from hgogen.step import Step

REACHED = {  # the parameter of a function that a place is reached through, or is, and the member of it
    "state": ("s", ""),
    "plant": ("p", "plant"),
    "gain": ("p", "gain"),
    "derived": ("p", "derived"),
    "input": ("in", ""),
    "output": ("measurement", ""),
    "estimate": ("x", ""),
    "argument": ("at", ""),
}
MEANINGS = {  # of the parameters
    "s": "the state: what a step remembers",
    "p": "the parameters",
    "in": "the input now",
    "measurement": "the measurement now",
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
        Entry("step", _parameters(step, {"in", "measurement"}), ("s",), whole),
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
    others = (*(["in"] if step.inputs else []), "measurement", "at")
    return ("s", "p", *(name for name in others if name in used))


@dataclass(frozen=True)
class Parameter:
    """A parameter of a C function: a pointer to `type`, which is only read where `constant`, or a value."""

    type: str
    name: str
    constant: bool = False
    pointer: bool = True

    def __str__(self) -> str:
        return f"{'const ' * self.constant}{self.type} {'*' * self.pointer}{self.name}"

    @property
    def local(self) -> str:
        """The declarations of a caller whose structs are named as the parameters are."""
        return f"{self.type} {self.name};"


AT = Parameter("uint16_t", "at", pointer=False)


@dataclass(frozen=True)
class Prototype:
    """A C function: what it `returns`, its name, its parameters; `public` in the interface, else of its file."""

    returns: str
    name: str
    parameters: tuple[Parameter, ...] = ()
    meaning: str = ""
    public: bool = True

    def __str__(self) -> str:
        parameters = ", ".join(map(str, self.parameters)) or "void"
        return f"{'' if self.public else 'static '}{self.returns} {self.name}({parameters})"

    def call(self, argument: Callable[[Parameter], str]) -> str:
        """A call with what `argument` makes of each parameter."""
        return f"{self.name}({', '.join(map(argument, self.parameters))})"


def own(parameter: Parameter) -> str:
    """The argument from a function that has a parameter of the same name."""
    return parameter.name


def address(parameter: Parameter) -> str:
    """The argument of a caller whose structs are named as the parameters are."""
    return f"&{parameter.name}" if parameter.pointer else parameter.name


def inside(step: Step, section: Section) -> Prototype:
    """The body of a section, once its state is ready: a function of the file's own, where the entry is none."""
    entry = of_section(step, section)
    return prototype(step, replace(entry, name=entry.inner, public=False) if entry.inner else entry)


def readied(step: Step) -> Prototype:
    """The code that makes a state of memory that holds none, and looks for parameters."""
    s, p = (replace(each, constant=each.name == "p") for each in structs(step)[:2])
    meaning = "memory without its mark is not used: the state begins anew, which the status says"
    return Prototype(status_type(step), f"{step.name}_ready", (s, p), meaning, public=False)


def nominal(step: Step) -> Prototype:
    """The code that makes memory nominal parameters, which are not tuned yet."""
    return Prototype("void", f"{step.name}_nominal", structs(step)[1:2], "nominal parameters", public=False)


def status_type(step: Step) -> str:
    """C type of a status: `unsigned`, 16 bits wide on the smallest targets, where that is enough."""
    return "unsigned" if len(step.layout.bits) <= 16 else f"{step.layout.word}_t"


def structs(step: Step) -> tuple[Parameter, ...]:
    """The structs that there are, as parameters: state, parameters, input, output, estimate."""
    kinds = [("state", "s"), ("params", "p"), ("input", "in"), ("output", "measurement"), ("plant", "x")]
    return tuple(Parameter(f"{step.name}_{kind}", short) for kind, short in kinds if kind != "input" or step.inputs)


def assigned(step: Step) -> tuple[tuple[str, Signal], ...]:
    """The signals that a call is given, each with the struct that a caller assigns it in."""
    return (*(("in", s) for s in step.inputs), *(("measurement", s) for s in step.samples))


def prototypes(step: Step) -> dict[str, Prototype]:
    """The interface by names without the prefix, in the order of the header."""
    return {name: prototype(step, entry) for name, entry in entries(step).items()}


def prototype(step: Step, entry: Entry) -> Prototype:
    """The C function of an entry."""
    kinds = {each.name: each for each in structs(step)} | {AT.name: AT}
    read_only = (kinds[name].pointer and name not in entry.written for name in entry.parameters)
    parameters = tuple(replace(kinds[name], constant=c) for name, c in zip(entry.parameters, read_only, strict=True))
    returns = status_type(step) if entry.status else "void"
    return Prototype(returns, f"{step.name}_{entry.name}", parameters, entry.meaning, entry.public)
