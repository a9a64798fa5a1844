"""The interface of a step: its functions with their parameters, in any language and as C prototypes, and the comments
of the members of its structs.

A parameter is one of `s` (the state), `p` (the parameters), `in`, `measurement` (what a call is given), `x` (the
estimate), `at` (a counter) and `t` (the time).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from hgogen.program import Call, Field, Place, Section, places, scalar, walk
from hgogen.signal import Signal
from hgogen.step import Step

REACHED = {  # the parameter of a function that leads to a place, and the member of it
    "state": ("s", ""),
    "plant": ("p", "plant"),
    "gain": ("p", "gain"),
    "derived": ("p", "derived"),
    "input": ("in", ""),
    "output": ("measurement", ""),
    "estimate": ("x", ""),
    "argument": ("at", ""),
    "time": ("t", ""),
    "deviations": ("sigma", ""),
    "ages": ("age", ""),
    "innovations": ("innovation", ""),
}
MEANINGS = {  # of the parameters of functions
    "s": "the state: the memory of the observer between calls",
    "p": "the parameters",
    "in": "the input now",
    "measurement": "the measurement now",
    "x": "the estimate of the plant's state",
    "at": "the number of the period in which the sample was taken",
    "t": "the time of the next call, or where dt varies of the last one",
    "sigma": "the standard deviations of the estimate",
    "age": "the samples since the last used one of each output",
    "innovation": "the joint innovations of all samples",
}

MEMBERS = {  # of the struct of parameters
    "plant": "parameters of the plant",
    "gain": "gains of the observer",
    "derived": "what `tune` computes of the others",
}


FIRST_CALL = {"update": "advances no time", "predict": "predicts"}


@dataclass(frozen=True)
class Entry:
    """A function that a step offers in every language: name, parameters, meaning; `written`: the parameters that it
    changes, `anew`: those of them that it sets without reading them; `status`: whether it returns a status, `public`:
    whether callers may call it. `inner`: the function that does the work after the marks of initialised memory are
    checked, "" without such a check."""

    name: str
    parameters: tuple[str, ...]
    written: tuple[str, ...]
    meaning: str
    status: bool = True
    public: bool = True
    anew: tuple[str, ...] = ()
    inner: str = ""


def entries(step: Step) -> dict[str, Entry]:
    """Return the functions of a step by name, in the order of the header: first those of every step, such as init, then
    one for each section (predict, correct ..), public where a step may be called by sections."""
    whole = f"one sampling period: {', '.join(section.name for section in step.code.sections)}"
    whole += f"{'; NaN means a missing sample' * step.clock.guarded}; the first call {FIRST_CALL[step.clock.first]}"
    does = ["limits them to their ranges"] * step.clock.guarded
    does += ["computes the derived ones"] * bool(step.layout.derived)
    limits = f"after a change of parameters: {' and '.join(does) or 'there is nothing to do'}"
    both, nominal, time = ("s", "p"), "nominal parameters, tuned, and a reset state", ("t",) * len(step.code.time)
    every = (
        Entry("init", (*both, *time), both, nominal, status=False, anew=both),
        Entry("tune", ("p",), ("p",), limits),
        Entry("reset", ("s", *time), ("s",), "the state as before the first call", status=False, anew=("s",)),
        *(Entry(each.name, ("s", *time), ("s",), each.meaning, status=False) for each in step.code.time),
        Entry("step", _parameters(step, {"in", "measurement"}), ("s",), whole),
        Entry("estimate", ("s", "p", "x"), ("x",), "the estimate of the plant's state", status=False, anew=("x",)),
        *(
            Entry(each.name, ("s", "p", each.name), (each.name,), each.meaning, status=False, anew=(each.name,))
            for each in step.code.reports
        ),
    )
    parts = (*step.code.inner, *step.code.parts, *step.code.timed)
    return {entry.name: entry for entry in (*every, *(of_section(step, section) for section in parts))}


def of_section(step: Step, section: Section) -> Entry:
    """Return the function that runs one section of a step, such as predict or correct."""
    called = (s.section.program for s in walk(section.program) if isinstance(s, Call))
    used = reached(place for program in (section.program, *called) for place, _ in places(program))
    public = step.code.separable and section.name not in {
        each.name for each in step.code.inner
    }  # a call may hold another
    meaning = f"part of a step: {section.meaning}"
    inner = f"run_{section.name}" if public and step.layout.mark and section in step.code.sections else ""
    return Entry(section.name, _parameters(step, used), ("s",), meaning, public=public, inner=inner)


def reached(places: Iterable[Place]) -> set[str]:
    """Return the names of the function parameters (s, p, in, x ..) through which C code reaches these places of
    memory."""
    return {REACHED[place.struct][0] for place in places if place.struct in REACHED}


def direction(entry: Entry, name: str) -> str:
    """Return how a function uses its parameter `name`: "in" (read), "out" (set) or "in,out"."""
    return "in" if name not in entry.written else "out" if name in entry.anew else "in,out"


def _parameters(step: Step, used: set[str]) -> tuple[str, ...]:
    others = (*(["in"] if step.given else []), "measurement", "at")
    return ("s", "p", *(name for name in others if name in used))


@dataclass(frozen=True)
class Parameter:
    """A parameter of a C function, with its type and name; `pointer`: whether it is a pointer, `constant`: whether its
    target is const."""

    type: str
    name: str
    constant: bool = False
    pointer: bool = True

    def __str__(self) -> str:
        return f"{'const ' * self.constant}{self.type} {'*' * self.pointer}{self.name}"

    @property
    def local(self) -> str:
        """The C declaration of a local variable with the type and name of this parameter."""
        return f"{self.type} {self.name};"


AT = Parameter("uint16_t", "at", pointer=False)


@dataclass(frozen=True)
class Prototype:
    """A C function: the type that it `returns`, name, parameters and meaning; `public`: whether it is visible outside
    of its file (not static)."""

    returns: str
    name: str
    parameters: tuple[Parameter, ...] = ()
    meaning: str = ""
    public: bool = True

    def __str__(self) -> str:
        parameters = ", ".join(map(str, self.parameters)) or "void"
        return f"{'' if self.public else 'static '}{self.returns} {self.name}({parameters})"

    def call(self, argument: Callable[[Parameter], str]) -> str:
        """Return the C text of a call of this function; `argument` gives the text of the argument for each
        parameter."""
        return f"{self.name}({', '.join(map(argument, self.parameters))})"


def same_name(parameter: Parameter) -> str:
    """Return the C text of the argument for a parameter, where the calling function has a parameter of the same name
    and type."""
    return parameter.name


def address(parameter: Parameter) -> str:
    """Return the C text of the argument for a parameter, where the caller has a variable of its name: &name for a
    pointer, 0 for the time t."""
    return f"&{parameter.name}" if parameter.pointer else "0" if parameter.name == "t" else parameter.name


def inside(step: Step, section: Section) -> Prototype:
    """Return the C function that runs a section (predict, correct ..) after a check that the memory is marked as
    initialised."""
    entry = of_section(step, section)
    return prototype(step, replace(entry, name=entry.inner, public=False) if entry.inner else entry)


def readied(step: Step) -> Prototype:
    """Return the C function that initialises a state without the mark of initialised memory, or with such
    parameters."""
    s, p = (replace(each, constant=each.name == "p") for each in structs(step)[:2])
    meaning = "memory without its mark is not used: the state begins anew, which the status says"
    return Prototype(status_type(step), f"{step.name}_ready", (s, p), meaning, public=False)


def nominal(step: Step) -> Prototype:
    """Return the C function that sets the parameters to their nominal values, not tuned yet."""
    return Prototype("void", f"{step.name}_nominal", structs(step)[1:2], "nominal parameters", public=False)


def status_type(step: Step) -> str:
    """Return the C type of a step's status: `unsigned`, which has at least 16 bits on every target, as many as a status
    needs."""
    return "unsigned" if len(step.layout.bits) <= 16 else f"{step.layout.word}_t"


def structs(step: Step) -> tuple[Parameter, ...]:
    """Return the structs of a step as C parameters, in the order state, parameters, input, output, estimate."""
    kinds = [("state", "s"), ("params", "p"), ("input", "in"), ("output", "measurement"), ("plant", "x")]
    return tuple(Parameter(f"{step.name}_{kind}", name) for kind, name in kinds if kind != "input" or step.given)


def reported(step: Step) -> tuple[Parameter, ...]:
    """Return the structs of a step's reports (such as standard deviations) as C parameters."""
    return tuple(Parameter(f"{step.name}_{report.struct}", report.name) for report in step.code.reports)


def assigned(step: Step) -> tuple[tuple[str, Signal], ...]:
    """Return the signals whose values a caller assigns before a call of a step, each with the name of its struct (u or
    y)."""
    return (*(("in", s) for s in step.given), *(("measurement", s) for s in step.samples))


def prototypes(step: Step) -> dict[str, Prototype]:
    """Return the C functions of a step in the order of the header, by their names without the step's prefix."""
    return {name: prototype(step, entry) for name, entry in entries(step).items()}


def prototype(step: Step, entry: Entry) -> Prototype:
    """Return the C declaration of a function of a step, as the target c99 has it."""
    time = Parameter(f"{step.name}_time", "t", pointer=False)
    kinds = {each.name: each for each in (*structs(step), *reported(step), AT, time)}
    read_only = (kinds[name].pointer and name not in entry.written for name in entry.parameters)
    parameters = tuple(replace(kinds[name], constant=c) for name, c in zip(entry.parameters, read_only, strict=True))
    returns = status_type(step) if entry.status else "void"
    return Prototype(returns, f"{step.name}_{entry.name}", parameters, entry.meaning, entry.public)


# --- the comments of members


def of_signal(step: Step, signal: Signal) -> Field:
    """Return the struct member of an input, output or state: one number, with the signal's meaning, unit and range."""
    low, high = signal.interval
    derivatives = (u.derivative(k, step.time) for u in step.inputs for k in range(1, len(step.inputs)))
    units = {each.name: each.unit for each in derivatives}  # in the model's time
    unit = units.get(signal.name, signal.unit)
    turn = {} if signal.period is None else {"periods": (signal.period,)}
    return scalar(signal.name, 0, low=low, high=high, unit=unit, meaning=signal.meaning, **turn)


def entry(name: str, place: tuple[int, int]) -> str:
    """Return the name of an entry of a matrix: `name` and the row and column in `place`, from 1 on, such as L21."""
    return f"{name}{place[0]}{place[1]}"


def parameters(step: Step) -> tuple[tuple[str, tuple[Field, ...]], ...]:
    """Return the members of a step's parameter struct by kind (plant, gain, derived), without empty kinds."""
    kinds = (("plant", step.layout.plant), ("gain", step.layout.gains), ("derived", step.layout.derived))
    return tuple((kind, fields) for kind, fields in kinds if fields)
