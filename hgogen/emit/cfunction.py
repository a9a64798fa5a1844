"""The functions of emitted C as data: declarations, calls and the record's functions are printed from it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from hgogen.emit.interface import Entry, entries, of_section
from hgogen.program import Section
from hgogen.signal import Signal
from hgogen.step import Step


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
        """What a caller declares whose structs are named as the parameters are."""
        return f"{self.type} {self.name};"


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
    """What is done of a section once its state is ready: a function of the file's own, where the entry is none."""
    entry = of_section(step, section)
    return prototype(step, replace(entry, name=entry.inner, public=False) if entry.inner else entry)


def readied(step: Step) -> Prototype:
    """What makes memory a state that is none yet, and looks for parameters."""
    s, p = (replace(each, constant=each.name == "p") for each in structs(step)[:2])
    meaning = "memory without its mark is not used: the state begins anew, which the status says"
    return Prototype(status_type(step), f"{step.name}_ready", (s, p), meaning, public=False)


def nominal(step: Step) -> Prototype:
    """What makes memory nominal parameters, which are not tuned yet."""
    return Prototype("void", f"{step.name}_nominal", structs(step)[1:2], "nominal parameters", public=False)


def status_type(step: Step) -> str:
    """C type of a status: `unsigned`, 16 bits wide on the smallest targets, where that is enough."""
    return "unsigned" if len(step.layout.bits) <= 16 else f"{step.layout.word}_t"


def structs(step: Step) -> tuple[Parameter, ...]:
    """The structs that there are, as parameters: state, parameters, input, output, estimate."""
    kinds = [("state", "s"), ("params", "p"), ("input", "in"), ("output", "out"), ("plant", "x")]
    return tuple(Parameter(f"{step.name}_{kind}", short) for kind, short in kinds if kind != "input" or step.inputs)


def assigned(step: Step) -> tuple[tuple[str, Signal], ...]:
    """The signals that a call is given, each with the struct that a caller assigns it in."""
    return (*(("in", s) for s in step.inputs), *(("out", s) for s in step.samples))


def prototypes(step: Step) -> dict[str, Prototype]:
    """The interface by names without the prefix, in the order of the header."""
    return {name: prototype(step, entry) for name, entry in entries(step).items()}


def prototype(step: Step, entry: Entry) -> Prototype:
    """The C function of an entry."""
    kinds = {each.name: each for each in structs(step)} | {"at": Parameter("uint16_t", "at", pointer=False)}
    read_only = (kinds[name].pointer and name not in entry.written for name in entry.parameters)
    parameters = tuple(replace(kinds[name], constant=c) for name, c in zip(entry.parameters, read_only, strict=True))
    returns = status_type(step) if entry.status else "void"
    return Prototype(returns, f"{step.name}_{entry.name}", parameters, entry.meaning, entry.public)
