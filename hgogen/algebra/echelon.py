"""Which rows of a matrix are new, and its kernel, modulo a prime and with balls.

With balls, a pivot is an entry whose ball excludes zero: so the rank is at least the number of pivots, for certain at
this point. What is left counts as zero when its ball contains zero and is tiny; a ball that contains zero and is not
tiny raises `Blurred`: more bits may decide.
"""

from collections.abc import Sequence
from typing import Any

import flint

Row = Sequence[Any]

SURE_BITS = 1024  # at which a zero is believed: then it is smaller than 2^-341


class Blurred(ArithmeticError):
    """The precision does not tell whether an entry is zero."""


def believe_zeros(modulus: int) -> None:
    """Raise `Blurred` for balls of few bits: a deficiency rests on what counts as zero, so it is asked again."""
    if not modulus and flint.ctx.prec < SURE_BITS:
        raise Blurred


def new_rows(rows: Sequence[Row], modulus: int) -> list[int]:
    """Indices of the rows that are no combination of the rows before; `modulus` 0 for balls."""
    if not rows or not rows[0]:
        return []
    if not modulus:
        return [i for i, _, _ in _eliminated(rows)]
    entries = [e for row in rows for e in row]
    reduced, rank = flint.nmod_mat(len(rows), len(rows[0]), entries, modulus).transpose().rref()
    pivots: list[int] = []
    for i in range(rank):
        start = pivots[-1] + 1 if pivots else 0
        pivots.append(next(j for j in range(start, len(rows)) if reduced[i, j] != 0))
    return pivots


def kernel(rows: Sequence[Row], width: int, modulus: int) -> list[list[Any]]:
    """A basis v_1, v_2, .. of the vectors v with rows v = 0; an entry that counts as zero is 0.

    Raises: `Blurred`.
    """
    if not rows:
        return [[int(i == j) for i in range(width)] for j in range(width)]
    if modulus:
        matrix = flint.nmod_mat(len(rows), width, [e for row in rows for e in row], modulus)
        nullspace, nullity = matrix.nullspace()
        return [[int(nullspace[i, j]) for i in range(width)] for j in range(nullity)]
    reduced = _eliminated(rows)
    columns = [column for _, column, _ in reduced]
    free = [j for j in range(width) if j not in columns]
    basis = []
    for j in free:  # by back substitution
        vector = [flint.arb(int(i == j)) for i in range(width)]
        for _, column, pivot in reversed(reduced):  # a row's pivot column is zero in the rows after it
            vector[column] = -sum((pivot[k] * vector[k] for k in range(width) if k != column), flint.arb(0))
        basis.append([flint.arb(0) if _zero(entry) else entry for entry in vector])
    return basis


def _eliminated(rows: Sequence[Row]) -> list[tuple[int, int, list[Any]]]:
    """For each new row its index, the column of its pivot, and the reduced row with 1 there; a pivot is the largest
    entry of its row."""
    reduced: list[tuple[int, int, list[Any]]] = []
    for i, row in enumerate(rows):
        left = _normal(row)
        for _, column, pivot in reduced:
            factor = left[column]
            if not factor.is_zero():
                left = [a - factor * b for a, b in zip(left, pivot, strict=True)]
                left[column] = flint.arb(0)
        sure = [j for j, entry in enumerate(left) if not _zero(entry)]
        if sure:
            best = max(sure, key=lambda j: abs(float(left[j].mid())))
            reduced.append((i, best, [entry / left[best] for entry in left]))
    return reduced


def _normal(row: Row) -> list[Any]:
    """The row times a power of two, so that its largest entry that is not zero is about 1."""
    largest = max((entry.abs_lower() for entry in row), default=flint.arb(0))
    if largest.is_zero():
        return list(row)
    shift = largest.mid().man_exp()
    exponent = int(shift[1]) + int(shift[0]).bit_length()
    scale = flint.arb(2) ** -exponent
    return [entry * scale for entry in row]


def _zero(entry: Any) -> bool:
    """Whether it counts as zero: False only for a ball that excludes zero."""
    if not entry.contains(0):
        return False
    if entry.abs_upper() > flint.arb(2) ** -(flint.ctx.prec // 3):
        raise Blurred
    return True
