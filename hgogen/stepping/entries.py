"""The numbers of a function of a step as vectors, whose elements have names, first values, units and meanings."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from hgogen.program import INF, Field, Group
from hgogen.reading.given import BadGain, BadNames, in_order, real, reals
from hgogen.signal import Signal, resting


@dataclass(frozen=True)
class Entry:
    """One element of a vector; `array`: what it is an element of, itself where it stands alone, and `label` what it is
    called there."""

    name: str
    initial: float
    unit: str = ""
    low: float = -INF
    high: float = INF
    meaning: str = ""
    array: str = ""
    label: str = ""

    def __str__(self) -> str:
        return f"{self.name} = {self.initial:g} {self.unit}".rstrip() + f": {self.meaning}" * bool(self.meaning)


@dataclass(frozen=True, repr=False)
class Vector:
    """The elements of an input or output of a function, in order; `title` says of what."""

    title: str
    entries: tuple[Entry, ...]

    @property
    def names(self) -> list[str]:
        """The names of the elements, in their order."""
        return [entry.name for entry in self.entries]

    @property
    def initial(self) -> np.ndarray:
        """The first values (n) of the elements."""
        return np.array([entry.initial for entry in self.entries])

    def filled(self, values: Mapping[str, Any]) -> np.ndarray:
        """The first values (n), with others for some elements, or arrays of them, by name: {"theta": 30, "Q": [1, 2]}
        or, where its elements have labels, {"Q": {"q": 1, "w": 2}}.

        Raises: `BadNames` for an unknown name; `BadGain` for what is no real number, or are not as many as there are.
        """
        elements: dict[str, float] = {}
        for name, value in values.items():
            own = [entry for entry in self.entries if entry.array == name != entry.name]
            elements |= _several(name, value, own) if own else {name: value}
        default = dict(zip(self.names, self.initial, strict=True))
        ordered = in_order(f"the {self.title}", elements, self.names, default=default)
        return np.array([real(name, value) for name, value in zip(self.names, ordered, strict=True)])

    def index(self, name: str) -> int:
        """Where an element stands. Raises: `BadNames`."""
        if any(entry.array == name != entry.name for entry in self.entries):
            raise BadNames(f"the {self.title}", f"names {name!r}, which is an array; name one of its elements")
        self.filled({name: 0.0})
        return self.names.index(name)

    def __len__(self) -> int:
        return len(self.entries)

    def __str__(self) -> str:
        return "\n".join([f"{self.title}:", *(f"  {entry}" for entry in self.entries)])

    def __repr__(self) -> str:
        return f"<{self.title}: {', '.join(self.names)}>"


def _several(name: str, value: Any, own: list[Entry]) -> dict[str, float]:
    elements = reals(name, in_order(name, value, (entry.label for entry in own))).reshape(-1)
    if len(elements) != len(own):
        raise BadGain(f"{name} of {len(elements)} numbers", f"must have {len(own)}")
    return {entry.name: float(element) for entry, element in zip(own, elements, strict=True)}


def of_signals(title: str, signals: Iterable[Signal]) -> Vector:
    """Signals, each at rest."""
    return Vector(title, tuple(Entry(s.name, resting(s), s.unit, *s.interval, s.meaning, s.name) for s in signals))


def of_field(field: Field, unit: str, name: str = "") -> Iterator[Entry]:
    """The elements of a field; of one that has several, `name[0]` and so on."""
    name = name or field.name
    labels = field.labels or tuple(f"row {i}, column {j}" for i, j in field.entries) or ("",) * field.size
    for k, (value, (low, high), label) in enumerate(zip(field.initial, field.box, labels, strict=True)):
        several = field.size > 1
        meaning = f"{field.meaning} ({label})" if several and label else field.meaning
        yield Entry(f"{name}[{k}]" if several else name, float(value), unit, low, high, meaning, name, label)


def of_line(line: tuple[Group, ...], field: Field, unit: str) -> Iterator[Entry]:
    """A field of a group in the order of memory: for each member of the outermost group those in it, one by one."""
    for members in product(*(range(group.count) for group in line)):
        path = ".".join(f"{group.name}[{k}]" for group, k in zip(line, members, strict=True))
        yield from of_field(field, unit, f"{path}.{field.name}")


def distinct(entries: Iterable[Entry], taken: Iterable[str], prefix: str) -> tuple[Entry, ...]:
    """Entries with a prefix where another one has the name."""
    taken = set(taken)
    return tuple(
        replace(e, name=f"{prefix}.{e.name}", array=f"{prefix}.{e.array}") if e.array in taken else e for e in entries
    )
