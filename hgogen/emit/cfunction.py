"""The functions of emitted C as data: declarations, calls and the record's functions are printed from it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from hgogen.program import Call, Place, Section, places, walk
from hgogen.step import Step

REACHED = {  # the parameter of a function that a place is reached through, or is, and the member of it
    "state": ("s", ""),
    "plant": ("p", "plant."),
    "gain": ("p", "gain."),
    "derived": ("p", "derived."),
    "input": ("in", ""),
    "output": ("out", ""),
    "estimate": ("x", ""),
    "argument": ("at", ""),
}


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


def structs(step: Step) -> tuple[Parameter, ...]:
    """The structs that there are, as parameters: state, parameters, input, output, estimate."""
    kinds = [("state", "s"), ("params", "p"), ("input", "in"), ("output", "out"), ("plant", "x")]
    return tuple(Parameter(f"{step.name}_{kind}", short) for kind, short in kinds if kind != "input" or step.inputs)


def read(parameter: Parameter) -> Parameter:
    """The same, of a function that does not write to it."""
    return replace(parameter, constant=True)


def prototypes(step: Step) -> dict[str, Prototype]:
    """The interface by names without the prefix, in the order of the header, and what it is made of: sections that
    cannot be called apart are none of the caller's."""
    name, status = step.name, status_type(step)
    whole = "one sampling period: " + ", ".join(section.name for section in step.sections)
    limits = "after a change of parameters: limits them to their ranges" + (
        " and computes the derived ones" if step.derived else ""
    )
    s, p, *_, x = structs(step)
    declared = {
        "init": Prototype("void", f"{name}_init", (s, p), "nominal parameters, tuned, and a reset state"),
        "tune": Prototype(status, f"{name}_tune", (p,), limits),
        "reset": Prototype("void", f"{name}_reset", (s,), "the state as before the first call"),
        "step": Prototype(status, f"{name}_step", _parameters(step, {"in", "out"}), whole),
        "estimate": Prototype("void", f"{name}_estimate", (read(s), read(p), x), "the estimate of the plant's state"),
    }
    parts = (*step.sections, *step.timed) if len(step.sections) > 1 else ()
    return declared | {section.name: of_section(step, section) for section in parts}


def of_section(step: Step, section: Section) -> Prototype:
    """The function of a section."""
    called = (s.section.program for s in walk(section.program) if isinstance(s, Call))
    used = reached(place for program in (section.program, *called) for place, _ in places(program))
    meaning = f"part of a step: {section.meaning}"
    return Prototype(status_type(step), f"{step.name}_{section.name}", _parameters(step, used), meaning, step.apart)


def reached(places: Iterable[Place]) -> set[str]:
    """The parameters that places are reached through."""
    return {REACHED[place.struct][0] for place in places if place.struct in REACHED}


def _parameters(step: Step, used: set[str]) -> tuple[Parameter, ...]:
    """The state and the parameters, and what else is used."""
    s, p, *others, _ = structs(step)
    others = [*map(read, others), Parameter("uint16_t", "at", pointer=False)]
    return (s, read(p), *(each for each in others if each.name in used))
