"""The subset of Python in which kernels are written: `emit.portable` prints it, `on_arrays` runs it.

A literal with a point is a real number, one without is a count. Sizes and limits are compile-time constants. A function
has assignments, loops over `range`, `while`, `if`, and expressions of numbers and elements.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, wraps
from math import isqrt
from types import FunctionType, SimpleNamespace
from typing import Any, Protocol, cast

import numpy as np

Vector = list[float]  # n numbers, which the function may write
FixedVector = list[float]  # n numbers that it only reads
Matrix = list[float]  # n by n numbers, row after row
FixedMatrix = list[float]


class Column(Protocol):
    """A column of a matrix, as a kernel accesses it: a struct with the vector v as its only member in emitted code."""

    v: Vector


Columns = list[Column]  # n of them
FixedColumns = list[Column]  # which are only read

n = square = line = half = 0  # n, n^2, n + 1, n/2 or the whole number below
SWEEPS = 12  # of balancing, more than it needs; the result is valid without convergence, too
HALVINGS = 64  # at most, of a norm or in a scale: no gain that is a float is as large as 2^64
DEGREE = 13  # of the series of phi_2: (1/2)^14/16! is below the rounding of a double
FIRST = 0  # of a search: the largest power of two that is not above the number n of breakpoints
start: FixedVector = []  # of a search: the breakpoint below each cell
LARGE = 0.0  # so that its square is infinite
ALL_WHOLE = 0.0  # numbers from here on are whole
ROUNDS = 0.0  # three halves of it: added to a number, it rounds it to a whole one


def array(size: int) -> list[float]:
    """Return a local array of numbers, which has no initial values in emitted code."""
    return [0.0] * size


def real(count: int) -> float:
    """Return a count as a real number."""
    return float(count)


def aligned(first: int) -> int:
    """Return `first`, the first index of a loop; emitted code may begin earlier, at a multiple of the width of a vector
    instruction."""
    return first


def sizes(n: int) -> dict[str, int]:
    """Return the constants, by name, that are compiled into a kernel for matrices (n, n)."""
    counts = {"n": n, "square": n * n, "line": n + 1, "half": n // 2}
    return counts | {"SWEEPS": SWEEPS, "HALVINGS": HALVINGS, "DEGREE": DEGREE}


_WRITTEN: dict[str, FunctionType] = {}  # the functions that `on_arrays` runs, by name


def _product(c: list[Any], a: list[Any], b: list[Any]) -> None:
    """Compute c = a b (n n) in the order of operations of `kernels.product`, but ten times as fast."""
    size = isqrt(len(a))
    A, B = np.array(a).reshape(size, size), np.array(b).reshape(size, size)
    total = np.zeros_like(B)
    for k in range(size):
        total = total + A[:, k, None] * B[k]
    c[:] = total.ravel().tolist() if type(a[0]) is float else list(total.ravel())


def on_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel as a function on numpy arrays; each operation is rounded to the type of the arrays. The first
    argument is either the columns of a matrix, an array (n, n) with column k in row k, or a matrix, an array (n n) by
    rows; a number is an array (1)."""
    written = _WRITTEN[function.__name__] = cast(FunctionType, function)
    numbers = [kind is float for name, kind in written.__annotations__.items() if name != "return"]

    @wraps(function)
    def run(*arguments: Any) -> Any:
        first = arguments[0]
        size = len(first) if first.ndim == 2 else isqrt(len(first))
        for kind in _KINDS.get(first.dtype.type, (first.dtype.type,)):
            values = [_elements(each, one, kind) for each, one in zip(arguments, numbers, strict=True)]
            with suppress(ZeroDivisionError):  # a division that Python refuses and numpy carries out
                result = _bound(written.__name__, size, kind)(*values)
                break
        for argument, value, one in zip(arguments, values, numbers, strict=True):
            if isinstance(argument, np.ndarray) and not one:
                argument[:] = [column.v for column in value] if argument.ndim == 2 else value
        return result

    return run


_KINDS: dict[Any, tuple[Any, ...]] = {np.float64: (float, np.float64), np.object_: (object,)}  # in this order


def _elements(argument: Any, one: bool, kind: Any) -> Any:
    if not isinstance(argument, np.ndarray):
        return argument
    values = argument.tolist() if kind is float else list(argument)
    if argument.ndim == 2:
        return [SimpleNamespace(v=list(row)) for row in values]
    return values[0] if one else values


@cache
def _bound(name: str, size: int, kind: Any) -> Any:
    real = float if kind is object else kind
    words = {**sizes(size), "aligned": aligned, "array": lambda size: [real(0)] * size, "product": _product}
    return bound(_WRITTEN, words, real)[name]


def bound(functions: Mapping[str, Any], words: Mapping[str, Any], real: Any) -> dict[str, Any]:
    """Return the functions of kernels, by name, so that they may call each other, with real constants converted to the
    type `real`; `words`: values of the other names that they use."""
    names: dict[str, Any] = {**words, "real": real}
    for name, written in functions.items():
        constants = (real(value) if isinstance(value, float) else value for value in written.__code__.co_consts)
        names[name] = FunctionType(written.__code__.replace(co_consts=tuple(constants)), names)
    return {name: names[name] for name in functions}
