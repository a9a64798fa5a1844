"""The error of an observer that corrects by its output error, rebuilt from the plant of the certificate.

    x' = f(x, u) + G1(x) w,   y = h(x, u) + G2(x) w,   xhat' = f(xhat, u) + l(xhat, u) (y - h(xhat, u)),   e = x - xhat

    e' = F(e, x) + G(e, x) w,   F = f(x) - f(x - e) - l(x - e) (h(x) - h(x - e)),   G = G1(x) - l(x - e) G2(x)

A claim states the gain l, G1, G2 and the ranges of the errors, never F and G; so F vanishes at e = 0, and another plant
has another F. Nothing is saturated: beyond the ranges of x, f, h and l are as they are written. Source: Alessandri,
Mathematical Problems in Engineering (2020), (19), (24), (25).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .arithmetic import Arithmetic, evaluate
from .box import Box, NotShown
from .context import Context, cut
from .file import Equations, signals
from .matrix import entries
from .tables import is_table
from .text import Expression, expression

Rows = tuple[tuple[Expression, ...], ...]
PARTS = ("gain", "G1", "G2", "errors")  # of a claim's description of the system
_KINKS = ("Abs", "sign", "Min", "Max")


@dataclass(frozen=True)
class ErrorSystem:
    """The system of `plant`: `errors` e (n), their ranges `around` 0, the `box` of every name; `gain` (n, p),
    `disturbed` G1 (n, k), `measured` G2 (p, k)."""

    plant: Equations
    errors: tuple[str, ...]
    around: Box
    box: Box
    gain: Rows
    disturbed: Rows
    measured: Rows

    def flow(self, at: Mapping[str, Any], arithmetic: Arithmetic) -> list[Any]:
        """F (n), the names at these values."""
        behind, n = self._behind(at), len(self.errors)
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
        parts = [f"{name} = {cut(text_of(rows))}" for name, rows in zip(PARTS, self._rows, strict=False)]
        return f"e = x - xhat of xhat' = f(xhat, u) + gain (y - h(xhat, u)), {', '.join(parts)}"

    @property
    def _rows(self) -> tuple[Rows, Rows, Rows]:
        return self.gain, self.disturbed, self.measured

    def _behind(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """The values `at`, with x - e in the place of each state x."""
        return {**at, **{x: at[x] - at[e] for x, e in zip(self.plant.states, self.errors, strict=True)}}

    def _with_errors(self, names: set[str]) -> set[str]:
        return names | {e for x, e in zip(self.plant.states, self.errors, strict=True) if x in names}


def error_system(context: Context, description: Mapping[str, Any]) -> ErrorSystem:
    """The error system of the file's plant, by a claim's description of it. Raises: `NotShown`."""
    plant = context.plant
    around, n, p = around_of(context, description), len(plant.states), len(plant.output)
    texts = entries(description, "G1", n)
    columns = len(texts[0]) if isinstance(texts[0], list) else 0
    system = ErrorSystem(
        plant=plant,
        errors=tuple(around),
        around=around,
        box={**plant.box, **around},
        gain=matrix_of(description, "gain", n, p, plant.box),
        disturbed=matrix_of(description, "G1", n, columns, plant.box),
        measured=matrix_of(description, "G2", p, columns, plant.box),
    )
    smooth((*plant.flow, *plant.output, *flat(system.gain)))
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
        if any(step.op in _KINKS or is_table(step.op) for step in text.instructions):
            raise NotShown(f"{cut(text.text)} has kinks or jumps")


def matrix_of(description: Mapping[str, Any], key: str, rows: int, columns: int, names: Box) -> Rows:
    """A matrix (rows, columns) of expressions that read these names. Raises: `NotShown`."""
    texts = entries(description, key, rows)
    return tuple(tuple(expression(cell, names) for cell in entries({key: row}, key, columns)) for row in texts)


def _less(value: Any, row: Sequence[Expression], miss: Sequence[Any], at: Mapping[str, Any], a: Arithmetic) -> Any:
    """A value less the row of the gain times what is missed."""
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
