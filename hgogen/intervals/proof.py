"""What was proved by bisection, so that another arithmetic can verify it again."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import sympy as sp

_SLACK = Fraction(1, 2**40)  # of the size, so that another arithmetic, or other roundings of a cut, reach the bounds


@dataclass(frozen=True)
class Proof:
    """A fact on a closed box, on which the `expressions` are defined.

    Of a range: low <= value <= high, of the one expression; of a slope: the spectral norm of the expressions' Jacobian
    in the states is at most `high`, and `low` is None. Both are exact; `variables`, `tree`: the bisection, ("split",
    index, left, right) and "leaf", sides cut in the middle.
    """

    expressions: tuple[sp.Expr, ...]
    low: Fraction | None
    high: Fraction | None
    variables: tuple[sp.Symbol, ...]
    tree: Any = field(hash=False, repr=False)


def ends(low: Fraction | float, high: Fraction | float) -> tuple[Fraction | None, Fraction | None]:
    """Bounds a little outside of these. Each keeps its sign, if it has one, and is None where it is infinite."""
    return _moved(low, -1), _moved(high, 1)


def _moved(value: Fraction | float, way: int) -> Fraction | None:
    if abs(value) == float("inf"):
        return None
    return Fraction(value) + way * abs(Fraction(value)) * _SLACK
