"""A zero of several functions next to a point, enclosed in balls: it is proved to exist.

    K(X) = x - Y c(x) + (1 - Y C(X)) (X - x),   C = dc/dx,   Y about C(x)^-1

The box X around x contains a zero of c, and only one, if K(X) lies in its interior: Krawczyk's test. It is asked of as
many unknowns as C has independent rows; the other unknowns keep their values, and the other functions, which depend on
these as two equal constraints do, are checked to be small there. Source: R. Krawczyk, Computing 4 (1969).
"""

from collections.abc import Callable, Sequence
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat

from hgogen.rigor.series import Undecided

_PASSES = 32  # of Newton's iteration, which doubles the digits
_DEPENDENT = 1e-4  # share of a row of C, below which it depends on the others

Values = tuple[list[Any], list[list[Any]]]  # c and dc/dx


def zero_near(functions: Callable[[Sequence[Any]], Values], start: Sequence[Any]) -> list[Any]:
    """Return balls x (n) around a proved zero of functions near `start` (n); `functions`: c (k) and dc/dx (k, n) at
    balls x. Raises: `Undecided` where no zero is proved."""
    x = [_middle(v) for v in start]
    rows, columns = _pivots(functions(x)[1])
    for _ in range(_PASSES):
        c, C = functions(x)
        Y = _inverse(C, rows, columns)
        change = (Y * arb_mat([[c[i]] for i in rows])).mid().entries()
        for j, one in zip(columns, change, strict=True):
            x[j] = _middle(x[j] - one)
        if all(abs(one) < _unit(x[j], 7 / 8) for j, one in zip(columns, change, strict=True)):
            break
    wide = [v + arb(0, _unit(v, 3 / 4)) if j in columns else v for j, v in enumerate(x)]
    c, (_, C) = functions(x)[0], functions(wide)
    unit = arb_mat([[int(i == j) for j in columns] for i in columns])
    contraction = unit - Y * arb_mat([[C[i][j] for j in columns] for i in rows])
    offsets = contraction * arb_mat([[wide[j] - x[j]] for j in columns]) - Y * arb_mat([[c[i]] for i in rows])
    for j, offset in zip(columns, offsets.entries(), strict=True):
        x[j] += offset
        if not wide[j].contains_interior(x[j]):
            raise Undecided
    c, C = functions(x)
    if not all(v.contains(0) and v.abs_upper() < _unit(max(map(abs, row)), 1 / 3) for v, row in zip(c, C, strict=True)):
        raise Undecided
    return x


def _middle(value: Any) -> Any:
    if not value.is_finite():
        raise Undecided
    return value.mid()


def _unit(value: Any, share: float) -> Any:
    """Return the unit in the last place of a number of the size max(|value|, 1), at a `share` of the working
    precision."""
    return max(abs(value).mid(), arb(1)) * arb(2) ** -int(flint.ctx.prec * share)


def _inverse(C: Sequence[Sequence[Any]], rows: Sequence[int], columns: Sequence[int]) -> Any:
    try:
        return arb_mat([[_middle(C[i][j]) for j in columns] for i in rows]).inv().mid()
    except ZeroDivisionError:
        raise Undecided from None


def _pivots(C: Sequence[Sequence[Any]]) -> tuple[list[int], list[int]]:
    """Return the indices of the independent rows of a matrix and of as many independent columns, by elimination with
    the largest pivots."""
    floats = np.array([[float(_middle(entry)) for entry in row] for row in C])
    size = np.abs(floats).max(axis=1, keepdims=True)
    if not (size > 0).all():
        raise Undecided
    left, chosen = floats / size, list[tuple[int, int]]()
    for _ in range(len(left)):
        i, j = divmod(int(np.abs(left).argmax()), left.shape[1])
        if abs(left[i, j]) < _DEPENDENT:
            break
        chosen.append((i, j))
        left = left - np.outer(left[:, j], left[i]) / left[i, j]
    return [i for i, _ in chosen], [j for _, j in chosen]
