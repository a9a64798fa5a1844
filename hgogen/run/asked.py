"""What many records are asked for with: their signals, what each starts from, the parameters of each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hgogen.program import Field, Place
from hgogen.reading.given import unmasked
from hgogen.run.readers import Kept
from hgogen.run.samples import BadShape, Engine, listed, reals, table
from hgogen.signal import Signal
from hgogen.step import Step

Array = np.ndarray
Starts = Mapping[str, Any] | Sequence[bytes]
Started = Callable[[Mapping[str, float]], bytes]  # of the plant's state by name: the state of a step that starts there


@dataclass(frozen=True, eq=False)
class Asked:
    """The signals of many records on a step with this memory: `given_u`, `given_y`, `parameters` and `starts` as a
    caller gives them; `limited`: what tuning says, by the number of a record whose parameters are out of their ranges.

    Raises: `BadShape`, `BadNames` when they are looked at.
    """

    step: Step
    memory: Kept
    given_u: Any
    given_y: Any
    parameters: Any
    starts: Any
    limited: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """None is no parameters, and no starts."""
        for name, nothing in (("parameters", {}), ("starts", ())):
            if getattr(self, name) is None:
                object.__setattr__(self, name, nothing)

    @cached_property
    def y(self) -> Array:
        """The measurements (B, N, p), or (N, p) for all."""
        return _signals("y", self.given_y, self.step.samples, None)

    @cached_property
    def u(self) -> Array:
        """The inputs (B, N, m), or (N, m) for all."""
        return _signals("u", self.given_u, self.step.inputs, self.y.shape[-2])

    @cached_property
    def count(self) -> int:
        """How many records there are: one where nothing says."""
        lengths = {name: len(array) for name, array in (("u", self.u), ("y", self.y)) if array.ndim == 3}
        varied = {place.name: array for place, array in self._parameters.items()} | self._numbers
        lengths |= {name: len(array) for name, array in varied.items() if array.ndim > 1}
        if not isinstance(self.starts, Mapping) and len(self.starts) > 0:
            lengths["starts"] = len(self.starts)
        if len(set(lengths.values())) > 1:
            listing = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise BadShape(f"different numbers of records ({listing})", "must be one for all")
        return next(iter(lengths.values()), 1)

    def firsts(self, own: Kept, engine: Engine, started: Started) -> Callable[[int], bytes]:
        """The memory that a record starts from, by its number, which `own` makes. Raises: what `started` raises."""
        base, states = bytes(self.memory.whole), self._states(started)
        if not states and not self._parameters:
            return lambda _: base
        tune = own.entries(engine)["tune"]

        def first(k: int) -> bytes:
            own.whole[:] = base
            if states:
                own.state[:] = states[k % len(states)]
            for place, values in self._parameters.items():
                own.places[place][:] = values[k] if values.ndim == 2 else values
            if self._parameters and (status := tune()):
                self.limited[k] = status
            return bytes(own.whole)

        return first

    @cached_property
    def _parameters(self) -> dict[Place, Array]:
        """The values (B, size), or (size) for all, of what varies."""
        known = tunable(self.step)
        if not isinstance(self.parameters, Mapping):
            wanted = f"is no mapping from some of {', '.join(known)} to numbers"
            raise BadShape(f"parameters = {self.parameters!r}", wanted)
        for name in self.parameters:
            if name not in known:
                raise BadShape(f"parameters {name!r}", f"names nothing tunable; that is {', '.join(known)}")
        return {known[name][0]: _values(name, value, known[name][1].size) for name, value in self.parameters.items()}

    @cached_property
    def _numbers(self) -> dict[str, Array]:
        """The values (B, 1), or (1) for all, of the plant's states that are named."""
        named = self.starts if isinstance(self.starts, Mapping) else {}
        return {f"starts {name}": _values(f"starts {name}", value, 1) for name, value in named.items()}

    def _states(self, started: Started) -> list[bytes]:
        """The state of each record, or one for all; none where they go on from that of the step."""
        if not isinstance(self.starts, Mapping):
            if not isinstance(self.starts, Sequence):
                wanted = "is no mapping from states to numbers, and no list of saved states, such as many.states"
                raise BadShape(f"starts = {self.starts!r}", wanted)
            return [self.memory.saved(state) for state in self.starts]
        columns = [np.broadcast_to(values.reshape(-1), self.count).tolist() for values in self._numbers.values()]
        rows, made = list(zip(*columns, strict=True)), dict[tuple[float, ...], bytes]()
        for row in rows:
            if row not in made:
                made[row] = self.memory.saved(started(dict(zip(self.starts, row, strict=True))))
        return [made[row] for row in rows]


def tunable(step: Step) -> dict[str, tuple[Place, Field]]:
    """What can be tuned, by name: where it lies, and what it is."""
    kinds = [("plant", item) for item in step.layout.plant] + [("gain", item) for item in step.layout.gains]
    return {item.name: (Place(kind, item.name), item) for kind, item in kinds}


def _signals(name: str, value: Any, signals: Sequence[Signal], rows: int | None) -> Array:
    """Signals (B, N, number), or (N, number) for all records, which may be given as for one. Raises: `BadShape`."""
    if not isinstance(value, np.ndarray | list | tuple) or np.ndim(value) != 3:
        return table(name, value, signals, rows)
    array, width = unmasked(value), len(signals)
    count, length, last = np.shape(array)
    if last != width or rows not in (None, length):
        wanted = f"must have shape (B, {'N' if rows is None else rows}, {width}), or that without B for all records"
        raise BadShape(f"{name} of shape {(count, length, last)}", f"{wanted}{listed(signals)}")
    return table(name, np.reshape(array, (count * length, width)), signals, None).reshape(count, length, width)


def _values(name: str, value: Any, size: int) -> Array:
    """Numbers (B, size), or (size) for all records. Raises: `BadShape`."""
    array = reals(name, value)
    array = array[..., None] if size == 1 else array
    if array.ndim not in (1, 2) or array.shape[-1] != size:
        wanted = "a number, or one for each record (B)" if size == 1 else f"({size}), or (B, {size})"
        raise BadShape(f"{name} of shape {np.shape(value)}", f"must be {wanted}")
    return array
