"""The evidence of bounds on a box: of an expression, and of the slopes of rows."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.evidence.grammar import end, outward, text, tree
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.intervals.bounds import Proof, Range

Sides = Mapping[sp.Symbol, tuple[Fraction | float, Fraction | float]]
LOOSE = 2.0**-10  # what a Lipschitz bound is wider here than the proof's, so that a weaker arithmetic reaches it


def enclosure(form: Form, expression: sp.Expr, bounds: Range | Proof, where: Sides | None = None) -> Evidence | None:
    """The evidence of low <= expression <= high on the form's box, or on the box `where` of the plant; None where the
    bounds are not finite."""
    low, high = bounds.low, bounds.high
    if isinstance(bounds, Range) and not bounds.defined:
        return None
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return None
    number = Fraction(str(expression)) if expression.is_Rational else None
    return {
        "expression": text(form, expression),
        "box": _sides(sides(form, expression.free_symbols) if where is None else where),
        "low": outward(low, -1) if number is None else number,
        "high": outward(high, 1) if number is None else number,
        "tree": tree(bounds, form if where is None else None),
    }


def steep(form: Form, rows: Iterable[sp.Expr], proof: Proof, wider: float = 1e-9) -> Evidence | None:
    """A bound of the rows' Jacobian in the spectral norm, which an order and signs of the states do not change."""
    if proof.high is None:
        return None
    names = set().union(*(exact(sp.sympify(row)).free_symbols for row in rows))
    bound = outward(float(proof.high) * (1 + wider), 1)
    return {"box": _sides(sides(form, names)), "bound": bound, "tree": tree(proof, form)}


def sides(form: Form, names: Iterable[sp.Symbol]) -> Sides:
    """The ranges of these of a form's states, inputs and parameters."""
    every = form.box
    return {s: every[s] for s in sorted(names, key=str)}


def point(place: Mapping[sp.Symbol, Fraction], names: Iterable[sp.Symbol]) -> Mapping[str, str]:
    """The place by these names, those that it gives."""
    return {s.name: str(place[s]) for s in names if s in place}


def _sides(where: Sides) -> dict[str, list[str | None]]:
    return {s.name: [end(low), end(high)] for s, (low, high) in where.items()}


@dataclass(frozen=True)
class Slopes:
    """A `proof` of a slope of rows in the plant's states."""

    proof: Proof = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """The bound of the same rows in the form's coordinates, whatever part of it they are."""
        back = dict(zip(form.system.states, form.from_form, strict=True))
        return steep(form, [row.xreplace(back) for row in self.proof.expressions], self.proof, LOOSE)


@dataclass(frozen=True)
class Steep:
    """How |S dc/dw S^-1| was bounded on the box, S = diag(`units`) in the coordinates w of integrators; `scale` (n):
    the same from z, of parameters. A certificate's bound is `wider` by that share, so that it is reached again."""

    units: tuple[Fraction, ...]
    scale: tuple[sp.Expr, ...]
    proof: Proof
    wider: float = 1e-9

    def evidence(self, form: Form) -> Evidence | None:
        """The bound of dc/dw in scaled coordinates of integrators."""
        slope = steep(form, (*form.b, *self.scale), self.proof, self.wider)
        return slope and {"units": self.units, "scale": self.scale, **slope}
