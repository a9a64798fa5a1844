"""The words in which functions are written once, as Python that `emit.portable` prints in every language.

A number with a point is real, one without counts. Sizes and limits are compiled in. The text of such a function is read
and never run: it has assignments, loops over `range`, `while`, `if`, and expressions of numbers and elements.
"""

from typing import Protocol

Vector = list[float]  # n numbers, which the function may write
FixedVector = list[float]  # n numbers that it only reads
Matrix = list[float]  # n by n numbers, row after row
FixedMatrix = list[float]


class Column(Protocol):
    """A column of a matrix: the member of a group."""

    v: Vector


Columns = list[Column]  # n of them

n = square = line = half = 0  # n, n^2, n + 1, n/2 or the whole number below
SWEEPS = HALVINGS = DEGREE = 0  # those of `discretisation.kernels`
FIRST = 0  # of a search: the largest power of two that is not above the number n of breakpoints
start: FixedVector = []  # of a search: the breakpoint below each cell
LARGE = 0.0  # so that its square is infinite
ALL_WHOLE = 0.0  # numbers from here on are whole
ROUNDS = 0.0  # three halves of it: added to a number, it rounds it to a whole one


def array(size: int) -> list[float]:
    """A local array of numbers, which hold nothing yet."""
    return [0.0] * size


def real(count: int) -> float:
    """A count as a real number."""
    return float(count)


def aligned(first: int) -> int:
    """Where a loop begins that may begin earlier, at a multiple of the numbers that an instruction takes at once."""
    return first
