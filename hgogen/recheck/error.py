"""The errors of observers, rebuilt from the plant of the certificate by what a claim states of the observer.

An observer that corrects by its output error:

    x' = f(x, u) + G1(x) w,   y = h(x, u) + G2(x) w,   xhat' = f(xhat, u) + l(xhat, u) (y - h(xhat, u)),   e = x - xhat
    e' = F(e, x) + G(e, x) w,   F = f(x) - f(x - e) - l(x - e) (h(x) - h(x - e)),   G = G1(x) - l(x - e) G2(x)

A claim states the gain l, G1, G2 and the ranges of the errors, never F and G; so F vanishes at e = 0, and another plant
has another F. Nothing is saturated: beyond the ranges of x, f, h and l are as they are written.

An observer of any equations:

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u),   e = x - xhat
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

A claim states g, of the states (for the estimate), of y_1, y_2, .. and known inputs, the inputs w that g does not know,
and F and G; it may hold on a set x_k = a_k(x) alone, which the plant has to keep to: f_k = sum_j da_k/dx_j f_j. These
are exact identities, wherever both sides have a value; F vanishes at e = 0.

Source: Alessandri, Mathematical Problems in Engineering (2020), (19), (24), (25), (29), (30).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from .arithmetic import Arithmetic, Undefined, evaluate
from .box import Box, NotShown, points
from .context import Context, algebra_of, cut, finite, inside
from .file import Equations, entries, part, signals
from .interval import intervals
from .text import Expression, expression

Rows = tuple[tuple[Expression, ...], ...]
PARTS = ("gain", "G1", "G2", "errors")  # of a claim's description of the system


@dataclass(frozen=True)
class ErrorSystem:
    """The system of `plant`: the ranges of the errors (n) `around` 0; `gain` (n, p), `disturbed` G1 (n, k), `measured`
    G2 (p, k)."""

    plant: Equations
    around: Box
    gain: Rows
    disturbed: Rows
    measured: Rows

    def flow(self, at: Mapping[str, Any], arithmetic: Arithmetic) -> list[Any]:
        """F (n), the names at these values."""
        behind, n = self._behind(at), len(self.around)
        rows = (*self.plant.flow, *self.plant.output)
        change = [evaluate(row, at, arithmetic) - evaluate(row, behind, arithmetic) for row in rows]
        return [
            _less(rate, row, change[n:], behind, arithmetic) for rate, row in zip(change[:n], self.gain, strict=True)
        ]

    def noise(self, at: Mapping[str, Any], arithmetic: Arithmetic) -> list[list[Any]]:
        """G (n, k), the names at these values."""
        behind = self._behind(at)
        G1, G2 = ([[evaluate(x, at, arithmetic) for x in row] for row in M] for M in (self.disturbed, self.measured))
        return [
            [_less(x, row, [other[k] for other in G2], behind, arithmetic) for k, x in enumerate(first)]
            for first, row in zip(G1, self.gain, strict=True)
        ]

    @property
    def read_by_flow(self) -> set[str]:
        """The names that F reads, an error with its state."""
        return self._with_errors(names_of((*self.plant.flow, *self.plant.output, *flat(self.gain))))

    @property
    def read_by_noise(self) -> set[str]:
        """The names that G reads."""
        reads = self._with_errors(names_of(flat(self.gain)))
        return reads | names_of(flat((*self.disturbed, *self.measured)))

    @property
    def sentence(self) -> str:
        """The words that say which observer has this error."""
        each = zip(PARTS, (self.gain, self.disturbed, self.measured), strict=False)
        parts = [f"{name} = {cut(text_of(rows))}" for name, rows in each]
        return f"e = x - xhat of xhat' = f(xhat, u) + gain (y - h(xhat, u)), {', '.join(parts)}"

    def _behind(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """The values `at`, with x - e in the place of each state x."""
        return {**at, **{x: at[x] - at[e] for x, e in zip(self.plant.states, self.around, strict=True)}}

    def _with_errors(self, names: set[str]) -> set[str]:
        return names | {e for x, e in zip(self.plant.states, self.around, strict=True) if x in names}


def error_system(context: Context, description: Mapping[str, Any]) -> ErrorSystem:
    """The error system of the file's plant, by a claim's description of it. Raises: `NotShown`."""
    plant = context.plant
    around, n, p = around_of(context, description), len(plant.states), len(plant.output)
    texts = entries(description, "G1", n)
    columns = len(texts[0]) if isinstance(texts[0], list) else 0
    gain, disturbed = (
        matrix_of(description, "gain", n, p, plant.box),
        matrix_of(description, "G1", n, columns, plant.box),
    )
    system = ErrorSystem(plant, around, gain, disturbed, matrix_of(description, "G2", p, columns, plant.box))
    smooth((*plant.flow, *plant.output, *flat(gain)))
    return system


def around_of(context: Context, description: Mapping[str, Any]) -> Box:
    """The ranges of the errors in a claim's description. Raises: `NotShown`."""
    plant, around = context.plant, signals(description, "errors")
    if tuple(around) != tuple(f"e_{x}" for x in plant.states) or around.keys() & plant.box.keys():
        raise NotShown("its errors are not e_ and the name of each of the plant's states, in their order")
    if not all(-math.inf < low < 0 < high < math.inf for low, high in around.values()):
        raise NotShown("its errors have no finite ranges around 0")
    return around


def smooth(texts: Iterable[Expression]) -> None:
    """That none has kinks or jumps. Raises: `NotShown`."""
    for text in texts:
        if text.kinked:
            raise NotShown(f"{cut(text.text)} has kinks or jumps")


def matrix_of(description: Mapping[str, Any], key: str, rows: int, columns: int, names: Box) -> Rows:
    """A matrix (rows, columns) of expressions that read these names. Raises: `NotShown`."""
    texts = entries(description, key, rows)
    return tuple(tuple(expression(cell, names) for cell in entries({key: row}, key, columns)) for row in texts)


def _less(value: Any, row: Sequence[Expression], miss: Sequence[Any], at: Mapping[str, Any], a: Arithmetic) -> Any:
    for gain, each in zip(row, miss, strict=True):
        value = value - evaluate(gain, at, a) * each if gain.text != "0" else value
    return value


def flat(rows: Rows) -> list[Expression]:
    """The expressions of a matrix, row by row."""
    return [cell for row in rows for cell in row]


def names_of(texts: Iterable[Expression]) -> set[str]:
    """The names that the expressions read."""
    return {name for text in texts for name in text.names}


def text_of(rows: Rows) -> str:
    """A matrix as it is printed."""
    return f"({'; '.join(', '.join(cell.text for cell in row) for row in rows)})"


# --- of any equations

OBSERVED = ("observer", "unknown", "along", "flow", "noise", "errors")  # of a claim's description of the system


@dataclass(frozen=True)
class ObservedSystem:
    """The system of `plant` and the `observer`: the ranges of the errors (n) `around` 0; `rates` F (n), `pushed` G
    (n, k)."""

    plant: Equations
    around: Box
    observer: tuple[Expression, ...]
    unknown: tuple[str, ...]
    along: Mapping[str, Expression]
    rates: tuple[Expression, ...]
    pushed: Rows

    def flow(self, at: Mapping[str, Any], arithmetic: Arithmetic) -> list[Any]:
        """F (n), the names at these values."""
        return [evaluate(row, at, arithmetic) for row in self.rates]

    def noise(self, at: Mapping[str, Any], arithmetic: Arithmetic) -> list[list[Any]]:
        """G (n, k), the names at these values."""
        return [[evaluate(cell, at, arithmetic) for cell in row] for row in self.pushed]

    @property
    def read_by_flow(self) -> set[str]:
        """The names that F reads."""
        return names_of(self.rates)

    @property
    def read_by_noise(self) -> set[str]:
        """The names that G reads."""
        return names_of(flat(self.pushed))

    @property
    def sentence(self) -> str:
        """Whose error it is, and where."""
        rows = f"xhat' = {cut(text_of(tuple((row,) for row in self.observer)))} of xhat and y"
        on = "".join(f", on {x} = {cut(value.text)}" for x, value in self.along.items())
        return f"e = x - xhat of {rows}, which does not know {', '.join(self.unknown)}{on}, wherever it has a value"


def observed_system(context: Context, description: Mapping[str, Any]) -> ObservedSystem:
    """The error system of the file's plant, by a claim's description of it. Raises: `NotShown`."""
    plant, around, n = context.plant, around_of(context, description), len(context.plant.states)
    inputs, parameters = context.file.inputs, context.file.parameters
    unknown, along = tuple(part(description, "unknown", list)), part(description, "along", dict)
    if not unknown or len(set(map(str, unknown))) < len(unknown) or not set(map(str, unknown)) <= {*inputs}:
        raise NotShown("what its observer does not know are not inputs of the plant")
    if not along.keys() < {*plant.states}:
        raise NotShown("it holds along what is not a part of the plant's states")
    outputs = [f"y_{k}" for k in range(1, len(plant.output) + 1)]
    if not plant.box.keys().isdisjoint(outputs):
        raise NotShown("the plant has a name of the form y_1, which here is the first output")
    known = {name: ends for name, ends in plant.box.items() if name not in unknown}
    free = {name: ends for name, ends in known.items() if name not in along}
    fixed = {name: free[name] for name in (*plant.states, *parameters) if name in free}
    read = {**free, **around}
    system = ObservedSystem(
        plant=plant,
        around=around,
        observer=_expressions(description, "observer", n, {**known, **dict.fromkeys(outputs)}),
        unknown=unknown,
        along={name: expression(value, fixed) for name, value in sorted(along.items())},
        rates=_expressions(description, "flow", n, read),
        pushed=matrix_of(description, "noise", n, len(unknown), read),
    )
    smooth(system.rates)
    _same(system, outputs)
    return system


def _expressions(
    description: Mapping[str, Any], key: str, count: int, names: Mapping[str, Any]
) -> tuple[Expression, ...]:
    return tuple(expression(text, names) for text in entries(description, key, count))


def _same(system: ObservedSystem, outputs: list[str]) -> None:
    """Shows that the plant stays in the set, that the claimed system is that of plant and observer, and that F(0) = 0.
    Raises: `NotShown`."""
    plant, algebra = system.plant, algebra_of({**system.plant.box, **system.around})
    at = {**algebra.names, **{name: algebra.read(value) for name, value in system.along.items()}}
    f = [algebra.read(row, at) for row in plant.flow]
    speeds = dict(zip(plant.states, f, strict=True))
    for name, value in system.along.items():  # x_k = a_k(x) is invariant: a_k is continuous, and x_k' its derivative
        finite(value, plant.box)
        if not algebra.is_zero(speeds[name] - algebra.speed(value, speeds, at)):
            raise NotShown(f"the plant is not shown to keep to {name} = {cut(value.text)}")
    y = {name: algebra.read(row, at) for name, row in zip(outputs, plant.output, strict=True)}
    estimate = {x: at[x] - at[e] for x, e in zip(plant.states, system.around, strict=True)}
    _somewhere(system, outputs)
    claimed = zip(system.flow(at, algebra.arithmetic), system.noise(at, algebra.arithmetic), strict=True)
    still = system.flow({**at, **dict.fromkeys(system.around, algebra.zero)}, algebra.arithmetic)
    for name, rate, g, (drift, pushed), rest in zip(plant.states, f, system.observer, claimed, still, strict=True):
        e = rate - algebra.read(g, {**at, **estimate, **y}) - drift
        for cell, w in zip(pushed, system.unknown, strict=True):
            e = e - cell * at[w]
        if not algebra.is_zero(e):
            raise NotShown(f"e_{name}' is not shown to be that of the plant and the observer")
        if not algebra.is_zero(rest):
            raise NotShown(f"e_{name}' is not shown to vanish at e = 0")


def _somewhere(system: ObservedSystem, outputs: list[str]) -> None:
    """Shows that plant, observer and claimed system have a value at a point inside of the ranges where e = 0: about it,
    the identities say something. Raises: `NotShown`."""
    plant = system.plant
    zero = dict.fromkeys(system.around, Fraction(0))
    at = points({**{name: inside(*ends, Fraction(1, 3)) for name, ends in plant.box.items()}, **zero})
    at |= {name: evaluate(value, at, intervals) for name, value in system.along.items()}
    at |= {name: evaluate(row, at, intervals) for name, row in zip(outputs, plant.output, strict=True)}
    for rows, whose in (
        (system.along.values(), "the set that it holds on"),
        (plant.flow, "the plant"),
        (system.observer, "its observer"),
        ((*system.rates, *flat(system.pushed)), "its system"),
    ):
        try:
            there = all(evaluate(row, at, intervals).finite for row in rows)
        except Undefined:
            there = False
        if not there:
            raise NotShown(f"{whose} is not shown to have a value")
