"""The error of an observer of any equations, rebuilt from the plant of the certificate.

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u),   e = x - xhat
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

A claim states g, of the states (for the estimate), of y_1, y_2, .. and known inputs, the inputs w that g does not know,
and F and G; it may hold on a set x_k = a_k(x) alone, which the plant has to keep to: f_k = sum_j da_k/dx_j f_j. These
are exact identities, wherever both sides have a value; F vanishes at e = 0. Source: Alessandri, Mathematical Problems
in Engineering (2020), (19), (29), (30).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from .algebra import Algebra, Quotient
from .arithmetic import Arithmetic, Dual, Undefined, dual, evaluate
from .box import Box, NotShown
from .context import Context, algebra_of, cut, finite, letters_of, value_of
from .error import Rows, around_of, flat, matrix_of, names_of, smooth, text_of
from .file import Equations, part
from .interval import intervals, point
from .matrix import entries
from .text import Expression, expression

PARTS = ("observer", "unknown", "along", "flow", "noise", "errors")  # of a claim's description of the system
Values = dict[str, Quotient]


@dataclass(frozen=True)
class ObservedSystem:
    """The system of `plant` and the `observer`: `errors` e (n), their ranges `around` 0, the `box` of every name;
    `rates` F (n), `pushed` G (n, k)."""

    plant: Equations
    errors: tuple[str, ...]
    around: Box
    box: Box
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
    unknown = tuple(entries(description, "unknown", len(part(description, "unknown", list))))
    if (
        not unknown
        or len(set(map(str, unknown))) < len(unknown)
        or not set(map(str, unknown)) <= {*context.file.inputs}
    ):
        raise NotShown("what its observer does not know are not inputs of the plant")
    along = part(description, "along", dict)
    if not along.keys() < {*plant.states}:
        raise NotShown("it holds along what is not a part of the plant's states")
    outputs = [f"y_{k}" for k in range(1, len(plant.output) + 1)]
    if not plant.box.keys().isdisjoint(outputs):
        raise NotShown("the plant has a name of the form y_1, which here is the first output")
    known = {name: ends for name, ends in plant.box.items() if name not in unknown}
    free = {name: ends for name, ends in known.items() if name not in along}
    fixed = {name: free[name] for name in (*plant.states, *context.file.parameters) if name in free}
    read = {**free, **around}
    system = ObservedSystem(
        plant=plant,
        errors=tuple(around),
        around=around,
        box={**plant.box, **around},
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

    Raises: `NotShown`.
    """
    plant, algebra = system.plant, algebra_of(system.box)
    at = letters_of(algebra, system.box)
    at |= {name: value_of(value, at, algebra) for name, value in system.along.items()}
    f = [value_of(row, at, algebra) for row in plant.flow]
    _invariant(system, at, dict(zip(plant.states, f, strict=True)), algebra)
    y = {name: value_of(row, at, algebra) for name, row in zip(outputs, plant.output, strict=True)}
    estimate = {x: at[x] - at[e] for x, e in zip(plant.states, system.errors, strict=True)}
    _somewhere(system, outputs)
    claimed = zip(system.flow(at, algebra.arithmetic), system.noise(at, algebra.arithmetic), strict=True)
    zero = {**at, **dict.fromkeys(system.errors, algebra.number(Fraction(0)))}
    still = system.flow(zero, algebra.arithmetic)
    for name, rate, g, (drift, pushed), rest in zip(plant.states, f, system.observer, claimed, still, strict=True):
        e = rate - value_of(g, {**at, **estimate, **y}, algebra) - drift
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
    at = {name: point(_inside(*ends)) for name, ends in plant.box.items()}
    at |= {name: evaluate(value, at, intervals) for name, value in system.along.items()}
    at |= {name: point(Fraction(0)) for name in system.errors}
    at |= {name: evaluate(row, at, intervals) for name, row in zip(outputs, plant.output, strict=True)}
    for rows, whose in (
        (system.along.values(), "the set that it holds on"),
        (plant.flow, "the plant"),
        (system.observer, "its observer"),
        ((*system.rates, *flat(system.pushed)), "its system"),
    ):
        try:
            finite = all(evaluate(row, at, intervals).finite for row in rows)
        except Undefined:
            finite = False
        if not finite:
            raise NotShown(f"{whose} is not shown to have a value")


def _inside(low: Any, high: Any) -> Fraction:
    """A third of the way into a range; of an unbounded one near its end or 0."""
    if math.inf in (abs(low), abs(high)):
        return Fraction(low) + 1 if abs(low) < math.inf else Fraction(high) - 1 if high < math.inf else Fraction(1, 3)
    return Fraction(low) + (Fraction(high) - Fraction(low)) / 3


def _invariant(system: ObservedSystem, at: Values, speeds: Values, algebra: Algebra) -> None:
    """Shows that the set x_k = a_k(x) is invariant: a_k is continuous, and x_k' the derivative of a_k(x).

    Raises: `NotShown`.
    """
    moving = {name: Dual(value, {0: speeds[name]} if name in speeds else {}) for name, value in at.items()}
    for name, value in system.along.items():
        finite(value, system.plant.box)
        slope = evaluate(value, moving, dual(algebra.arithmetic)).slopes.get(0, algebra.number(Fraction(0)))
        if not algebra.is_zero(speeds[name] - slope):
            raise NotShown(f"the plant is not shown to keep to {name} = {cut(value.text)}")


__all__ = ["PARTS", "ObservedSystem", "observed_system"]
