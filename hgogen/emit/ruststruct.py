"""The structs of emitted Rust, with what is said of their members, and the values that they begin with."""

from collections.abc import Iterable
from dataclasses import replace

from hgogen.emit.code import indented
from hgogen.emit.described import MEANINGS, described, of_signal, own_name, parameters
from hgogen.emit.manual import remembered
from hgogen.emit.rustsyntax import RUST, line, rust_name, type_name
from hgogen.emit.syntax import Real
from hgogen.program import Field, Group, lines_of
from hgogen.signal import Signal
from hgogen.step import Step

Member = tuple[str, str, str]  # name, type, and what is said of it
_SIGNALS = {
    "Inputs": "The inputs now.",
    "Outputs": "The measurements now.",
    "Estimate": "The estimate of the plant's state; ranges are the declared ones, beyond which it may peak.",
}


def structs(step: Step, real: Real) -> list[str]:
    """All structs of a step."""
    signals = {"Inputs": step.inputs, "Outputs": step.samples, "Estimate": step.states}
    made = [
        _struct(name, _SIGNALS[name], (_signal(step, real, signal) for signal in named))
        for name, named in signals.items()
        if named
    ]
    made += [
        _struct(
            type_name(kind),
            f"{MEANINGS[kind][0].upper()}{MEANINGS[kind][1:]}.",
            (_member(step, real, item) for item in fields),
        )
        for kind, fields in parameters(step)
    ]
    kinds = ((kind, type_name(kind), MEANINGS[kind]) for kind, _ in parameters(step))
    made.append(_struct("Parameters", "Change `plant` or `gain`, then call `tune`.", kinds))
    for *_, group in lines_of(step.groups):
        made.append(_struct(type_name(group.name), group.meaning, _inner(step, real, group.fields, group.groups)))
    made.append(_struct("State", f"{remembered(step).capitalize()}.", _inner(step, real, step.state, step.groups)))
    return [text for lines in made for text in (*lines, "")]


def doc(text: str) -> list[str]:
    """A documentation comment of one line, which is folded later."""
    return [f"/// {line(text)}"] if text else []


def initial(fields: Iterable[Field], groups: Iterable[Group], real: Real) -> list[str]:
    """The members of a struct with the values after a reset."""
    lines = [f"{rust_name(item.name)}: {_values(item, real)}," for item in fields]
    for group in groups:
        inner = indented(initial(group.fields, group.groups, real))
        lines += [f"{group.name}: [{type_name(group.name)} {{", *inner, f"}}; {group.count}],"]
    return lines


def nominal(step: Step, real: Real) -> list[str]:
    """The members of the parameters with their nominal values, and zeros for what `tune` computes."""
    lines: list[str] = []
    for kind, fields in parameters(step):
        values = (replace(item, initial=(0.0,) * item.size) if kind == "derived" else item for item in fields)
        lines += [f"{kind}: {type_name(kind)} {{", *indented(initial(values, (), real)), "},"]
    return lines


def zeros(signals: Iterable[Signal]) -> str:
    """The members of an estimate that says nothing yet."""
    return ", ".join(f"{rust_name(signal.name)}: 0.0" for signal in signals)


def _struct(name: str, meaning: str, items: Iterable[Member]) -> list[str]:
    inner = [text for member, kind, said in items for text in (*doc(said), f"pub {member}: {kind},")]
    return [*doc(meaning), "#[derive(Clone, Copy, Debug, PartialEq)]", f"pub struct {name} {{", *indented(inner), "}"]


def _signal(step: Step, real: Real, signal: Signal) -> Member:
    name = rust_name(signal.name)
    return name, RUST.types[real], of_signal(step, signal, name)


def _member(step: Step, real: Real, item: Field) -> Member:
    name, kind = rust_name(item.name), RUST.types["unsigned" if item.kind == "index" else real]
    text = described(replace(item, unit=step.unit(item)))
    size = kind if item.size == 1 else f"[{kind}; {item.size}]"
    return name, size, text if name == item.name else own_name(item.name, text)


def _inner(step: Step, real: Real, fields: Iterable[Field], groups: Iterable[Group]) -> list[Member]:
    arrays = [(group.name, f"[{type_name(group.name)}; {group.count}]", group.meaning) for group in groups]
    return [*(_member(step, real, item) for item in fields), *arrays]


def _values(item: Field, real: Real) -> str:
    texts = [RUST.literal(value, "unsigned" if item.kind == "index" else real) for value in item.initial]
    if item.size == 1:
        return texts[0]
    return f"[{texts[0]}; {item.size}]" if len(set(texts)) == 1 else f"[{', '.join(texts)}]"
