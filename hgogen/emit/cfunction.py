"""The functions of emitted C as data: declarations, calls and the record's functions are printed from it."""

from collections.abc import Callable
from dataclasses import dataclass

from hgogen.program import Call, Program, Section, places, scope, walk
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


@dataclass(frozen=True)
class Prototype:
    """A C function: what it `returns`, its name, its parameters; `public` in the interface, else of its file."""

    returns: str
    name: str
    parameters: tuple[Parameter, ...] = ()
    meaning: str = ""
    public: bool = True

    def __str__(self) -> str:
        given = ", ".join(map(str, self.parameters)) or "void"
        return f"{'' if self.public else 'static '}{self.returns} {self.name}({given})"

    def call(self, argument: Callable[[Parameter], str]) -> str:
        """A call with what `argument` makes of each parameter."""
        return f"{self.name}({', '.join(map(argument, self.parameters))})"


def own(parameter: Parameter) -> str:
    """The argument from a function that has a parameter of the same name."""
    return parameter.name


def address(parameter: Parameter) -> str:
    """The argument of a caller whose structs are named as the parameters are."""
    return f"&{parameter.name}" if parameter.pointer else parameter.name


def status_type(step: Step) -> str:
    """C type of a status: `unsigned`, 16 bits wide on the smallest targets, where that is enough."""
    return "unsigned" if len(step.bits) <= 16 else "uint32_t"


def prototypes(step: Step) -> dict[str, Prototype]:
    """The interface by names without the prefix, in the order of the header, and what it is made of: sections that
    cannot be called apart are none of the caller's."""
    name, status = step.name, status_type(step)
    whole = "one sampling period: " + ", ".join(section.name for section in step.sections)
    limits = "after a change of parameters: limits them to their ranges" + (
        " and computes the derived ones" if step.derived else ""
    )
    s, p, x = (
        Parameter(f"{name}_{struct}", short) for struct, short in (("state", "s"), ("params", "p"), ("plant", "x"))
    )
    read = (Parameter(s.type, "s", constant=True), Parameter(p.type, "p", constant=True))
    declared = {
        "init": Prototype("void", f"{name}_init", (s, p), "nominal parameters, tuned, and a reset state"),
        "tune": Prototype(status, f"{name}_tune", (p,), limits),
        "reset": Prototype("void", f"{name}_reset", (s,), "the state as before the first call"),
        "step": Prototype(status, f"{name}_step", _parameters(step, {"input", "output"}), whole),
        "estimate": Prototype("void", f"{name}_estimate", (*read, x), "the estimate of the plant's state"),
    }
    parts = (*step.sections, *step.timed) if len(step.sections) > 1 else ()
    return declared | {section.name: of_section(step, section) for section in parts}


def of_section(step: Step, section: Section) -> Prototype:
    """The function of a section."""
    given, meaning = _parameters(step, _scopes(section.program)), f"part of a step: {section.meaning}"
    return Prototype(status_type(step), f"{step.name}_{section.name}", given, meaning, step.apart)


def _scopes(program: Program) -> set[str]:
    """The structs that a program works on, with the sections that it calls."""
    called = (s.section.program for s in walk(program) if isinstance(s, Call))
    return {scope(place) for each in (program, *called) for place, _ in places(each)}


def _parameters(step: Step, scopes: set[str]) -> tuple[Parameter, ...]:
    """The parameters of a function that works on these structs, beside the state and the parameters."""
    name = step.name
    kinds = [("input", "in", step.inputs), ("output", "out", step.outputs)]
    given = [Parameter(f"{name}_{kind}", short, True) for kind, short, signals in kinds if signals and kind in scopes]
    at = [Parameter("uint16_t", "at", pointer=False)] if "argument" in scopes else []
    return (Parameter(f"{name}_state", "s"), Parameter(f"{name}_params", "p", True), *given, *at)
