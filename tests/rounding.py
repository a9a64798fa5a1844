"""How far a float step can be from exact arithmetic: a running error analysis of its operation graph.

Each value v of the program carries a bound e on |v - w|, w what exact arithmetic makes of the same inputs and the
unrounded constants. With u = 2^-24 and the computed v, round to nearest gives |fl(x) - x| <= u |v|, so

    v = a + b   e = e_a + e_b + u |v|                      v = a b   e = |a| e_b + |b| e_a + e_a e_b + u |v|
    v = a / b   e = (e_a + |v| e_b)/(|b| - e_b) + u |v|    sin, cos  e = e_a + 2 ulp,  exp  e = v (exp(e_a) - 1) + 2 ulp

min, max and |.| do not enlarge errors. A choice or a statement that hangs on a comparison which rounding can turn
raises `Uncertain`. Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 3.3;
the ulps are those that `hgogen.emit.elementary` states.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

import casadi as ca
import numpy as np
from exact import evaluate

from hgogen.emit.elementary import elementary
from hgogen.program import Block
from hgogen.rigor.lookup import called, instructions
from hgogen.step import Step
from hgogen.stepping.machine import Bound, Machine

U = 2.0**-24
TINY = 2.0**-150  # half the smallest subnormal number, for results that underflow
ULPS = 2  # of sin, cos and exp


class Uncertain(Exception):
    """Something hangs on a comparison that rounding can turn."""


@dataclass(frozen=True, eq=False)
class Rounded:
    """A float and a bound on its error; of a truth value, 1 where it could be the other."""

    value: np.float32
    error: float = 0.0

    def __ne__(self, other: object) -> bool:
        """Raises: `Uncertain`."""
        if self.error:
            raise Uncertain
        return bool(self.value != other)

    def __int__(self) -> int:
        return int(self.value)

    def __float__(self) -> float:
        return float(self.value)


ZERO = Rounded(np.float32(0))


def rounded(number: Any) -> Rounded:
    """A number as the float that C holds, with what rounding it costs."""
    if isinstance(number, Rounded):
        return number
    value = np.float32(number)
    return Rounded(value, abs(float(value) - float(number)))


# --- arithmetic ---------------------------------------------------------------------------------------------


def _computed(value: np.float32, inherited: float) -> Rounded:
    # (1 + 1e-12): the bound is itself computed, in double precision
    return Rounded(value, (inherited + U * abs(float(value)) + TINY) * (1 + 1e-12))


def _sum(a: Rounded, b: Rounded) -> Rounded:
    if any(x.value == 0 and x.error == 0 for x in (a, b)):
        return a if b.value == 0 and b.error == 0 else b
    value, inherited = a.value + b.value, a.error + b.error
    if inherited == 0 and a.value.is_integer() and b.value.is_integer() and abs(value) <= 1 / U:
        return Rounded(value)  # counters
    return _computed(value, inherited)


def _product(a: Rounded, b: Rounded) -> Rounded:
    size_a, size_b = abs(float(a.value)), abs(float(b.value))
    return _computed(a.value * b.value, size_a * b.error + size_b * a.error + a.error * b.error)


def _quotient(a: Rounded, b: Rounded) -> Rounded:
    value, least = a.value / b.value, abs(float(b.value)) - b.error
    size = abs(float(value)) * (1 + 2 * U)  # of the quotient before it was rounded
    return _computed(value, (a.error + size * b.error) / least if least > 0 else math.inf)


def _negative(a: Rounded) -> Rounded:
    return Rounded(-a.value, a.error)


def _least(a: Rounded, b: Rounded) -> Rounded:
    taken = a if a.value < b.value else b
    return taken if _sure(a, b) else Rounded(taken.value, max(a.error, b.error))


def _greatest(a: Rounded, b: Rounded) -> Rounded:
    taken = a if a.value > b.value else b
    return taken if _sure(a, b) else Rounded(taken.value, max(a.error, b.error))


def _function(name: str, inherited: Callable[[float, float], float]) -> Callable[[Rounded], Rounded]:
    """`inherited(v, e)`: the error of the result v that comes from that of the argument, e."""

    def run(a: Rounded) -> Rounded:
        value = evaluate(elementary("float")[name], [[a.value]], "float")[0][0]
        size = abs(float(value))
        ulp = 2 * U * size * 1.01 + 2 * TINY  # at most, for the exact result too
        return Rounded(value, inherited(size, a.error) + ULPS * ulp)

    return run


# --- truth --------------------------------------------------------------------------------------------------


def _sure(a: Rounded, b: Rounded) -> bool:
    """Whether rounding cannot change how a and b compare."""
    error = a.error + b.error
    return a is b or error == 0 or abs(float(a.value) - float(b.value)) > error


def _test(compare: Callable[[Any, Any], Any]) -> Callable[[Rounded, Rounded], Rounded]:
    return lambda a, b: Rounded(np.float32(compare(a.value, b.value)), 0.0 if _sure(a, b) else 1.0)


def _not(a: Rounded) -> Rounded:
    return Rounded(np.float32(not a.value), a.error)


def _and(a: Rounded, b: Rounded) -> Rounded:
    known = any(not x.error and not x.value for x in (a, b)) or not (a.error or b.error)
    return Rounded(np.float32(bool(a.value and b.value)), 0.0 if known else 1.0)


def _chosen(test: Rounded, value: Rounded) -> Rounded:
    return value if test != 0 else ZERO


_OPERATIONS: Mapping[int, Callable[..., Rounded]] = {
    ca.OP_ADD: _sum,
    ca.OP_SUB: lambda a, b: _sum(a, _negative(b)),
    ca.OP_MUL: _product,
    ca.OP_SQ: lambda a: _product(a, a),
    ca.OP_TWICE: lambda a: Rounded(a.value + a.value, 2 * a.error),
    ca.OP_DIV: _quotient,
    ca.OP_INV: lambda a: _quotient(Rounded(np.float32(1)), a),
    ca.OP_NEG: _negative,
    ca.OP_FABS: lambda a: Rounded(abs(a.value), a.error),
    ca.OP_FMIN: _least,
    ca.OP_FMAX: _greatest,
    ca.OP_LT: _test(lambda a, b: a < b),
    ca.OP_LE: _test(lambda a, b: a <= b),
    ca.OP_EQ: _test(lambda a, b: a == b),
    ca.OP_NE: _test(lambda a, b: a != b),
    ca.OP_NOT: _not,
    ca.OP_AND: _and,
    ca.OP_OR: lambda a, b: _not(_and(_not(a), _not(b))),
    ca.OP_IF_ELSE_ZERO: _chosen,
    ca.OP_SIN: _function("sin", lambda _, error: error),
    ca.OP_COS: _function("cos", lambda _, error: error),
    ca.OP_EXP: _function("exp", lambda size, error: size * math.expm1(error)),
}


# --- programs -----------------------------------------------------------------------------------------------

Instruction = tuple[int, tuple[int, ...], tuple[int, ...], Any]


@lru_cache(maxsize=1000)
def _instructions(graph: Any) -> list[Instruction]:
    """(operation, what it takes, what it gives, its constant or what it calls) of each instruction."""
    rows, texts = [], instructions(graph)
    for k in range(graph.n_instructions()):
        op = graph.instruction_id(k)
        more = graph.instruction_constant(k) if op == ca.OP_CONST else called(texts[k]) if op == ca.OP_CALL else None
        rows.append((op, tuple(graph.instruction_input(k)), tuple(graph.instruction_output(k)), more))
    return rows


def run(graph: Any, arguments: list[Any]) -> list[list[Rounded]]:
    """The outputs of an SX function at arrays of numbers or `Rounded`. Raises: `Uncertain`."""
    slots: dict[int, Rounded] = {}
    outputs = [[ZERO] * graph.nnz_out(i) for i in range(graph.n_out())]
    for op, take, give, more in _instructions(graph):
        if op == ca.OP_INPUT:
            slots[give[0]] = rounded(arguments[take[0]][take[1]])
        elif op == ca.OP_OUTPUT:
            outputs[give[0]][give[1]] = slots[take[0]]
        elif op == ca.OP_CONST:
            slots[give[0]] = rounded(more)
        elif op == ca.OP_CALL:
            rest = iter(slots[i] for i in take)
            columns = [list(islice(rest, more.numel_in(k))) for k in range(more.n_in())]
            slots |= zip(give, (value for result in run(more, columns) for value in result), strict=True)
        else:
            slots[give[0]] = _OPERATIONS[op](*(slots[i] for i in take))
    return outputs


def machine(step: Step) -> Machine:
    """A machine whose memory holds `Rounded`; a plain number put there is exact but for its rounding to float."""

    def bind(block: Block, arguments: list[np.ndarray]) -> Bound:
        results = [np.zeros(block.graph.numel_out(i), object) for i in range(len(block.writes))]

        def action() -> None:
            with np.errstate(all="ignore"):
                values = run(block.graph, arguments)
            for array, numbers in zip(results, values, strict=False):
                array[:] = numbers

        return action, results

    return Machine(step, bind, object)
