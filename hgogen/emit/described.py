"""What is said of a field or a signal beside its declaration, in every language."""

from hgogen.program import INF, Field, scalar
from hgogen.signal import Signal
from hgogen.step import Step

MEANINGS = {  # of the members of the parameters
    "plant": "parameters of the plant",
    "gain": "gains of the observer",
    "derived": "what `tune` computes of the others",
}


def described(item: Field) -> str:
    """Meaning, elements, unit and range of a field."""
    parts = [item.meaning] if item.meaning else []
    if elements := item.labels or tuple(entry(item.name, each) for each in item.entries):
        parts.append(", ".join(elements))
    text = ": ".join(parts)
    ranges = {(low, high) for low, high in item.box if low > -INF and high < INF}
    if item.unit:
        text += f" [{item.unit}]"
    if item.kind == "real" and len(ranges) == 1 and all(low > -INF for low, _ in item.box):
        low, high = ranges.pop()
        text += f", {low:g} .. {high:g}" if low < high else f", fixed at {low:g}"
    return text.strip(", ")


def of_signal(step: Step, signal: Signal) -> Field:
    """A signal as the field of one number, of which the same is said."""
    low, high = signal.interval
    derivatives = (u.derivative(k, step.time) for u in step.inputs for k in range(1, len(step.inputs)))
    units = {each.name: each.unit for each in derivatives}  # in the model's time
    unit = units.get(signal.name, signal.unit)
    return scalar(signal.name, 0, low=low, high=high, unit=unit, meaning=signal.meaning)


def entry(name: str, place: tuple[int, int]) -> str:
    """`L21` of row 2, column 1."""
    return f"{name}{place[0]}{place[1]}"


def parameters(step: Step) -> tuple[tuple[str, tuple[Field, ...]], ...]:
    """The members of the parameters: kind and fields, those that there are."""
    kinds = (("plant", step.layout.plant), ("gain", step.layout.gains), ("derived", step.layout.derived))
    return tuple((kind, fields) for kind, fields in kinds if fields)
