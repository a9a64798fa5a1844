"""Derivatives along the flow of a plant: y, y', y'', ..., with the derivatives of the inputs as symbols.

    (L e)(x, u, u', ..) = de/dx f(x, u) + de/du u' + de/du' u'' + ...

The derivatives of an input are Signals of their own (`Signal.derivative`), in the ranges that its `rates` declare.
Source: M. Fliess, "Generalized controller canonical forms for linear and nonlinear dynamics", IEEE TAC 35 (1990).
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import sympy as sp

from hgogen.rigor.box import exact
from hgogen.rigor.slope import JUMPS, KINKS
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal, derived
from hgogen.system import System


def rates(plant: System, orders: int) -> dict[sp.Symbol, sp.Expr]:
    """The rate of each state, of each input, and of the input's derivatives up to the order `orders` - 1."""
    changes = {x: exact(row) for x, row in zip(plant.states, plant.flow, strict=True)}  # no product of floats is exact
    for u in plant.inputs:
        changes |= {u.derivative(k): u.derivative(k + 1) for k in range(orders)}
    return changes


def along(expression: sp.Expr, rates: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """The time derivative of an expression; symbols without a rate are constant. Polynomials come out expanded."""
    moving = sorted(expression.free_symbols & rates.keys(), key=str)
    result = sp.Add(*(expression.diff(symbol) * rates[symbol] for symbol in moving))
    return sp.expand(result) if result.is_polynomial() else result


def derivatives(expression: sp.Expr, rates: Mapping[sp.Symbol, sp.Expr], count: int) -> tuple[sp.Expr, ...]:
    """The expression and its time derivatives, `count` expressions in all."""
    chain = [expression]
    while len(chain) < count:
        chain.append(along(chain[-1], rates))
    return tuple(chain[:count])


def input_derivatives(expressions: Iterable[sp.Expr], plant: System, orders: int) -> tuple[Signal, ...]:
    """The derivatives, up to the given order, of the plant's inputs that the expressions read, input by input."""
    read = set().union(*(e.free_symbols for e in expressions))
    known = (u.derivative(k) for u in plant.inputs for k in range(1, orders + 1))
    return tuple(signal for signal in known if signal in read)


def without_rates(plant: System) -> System:
    """The plant without the derivatives of its inputs that it does not read itself, as a form adds them."""
    read = set().union(*(sp.sympify(e).free_symbols for e in (*plant.flow, *plant.output)))
    known = derived(plant.inputs)
    return replace(plant, inputs=tuple(u for u in plant.inputs if u in read or u.name not in known))


def without_derivative(expressions: Iterable[sp.Expr]) -> Reason:
    """The first function with jumps or kinks, in the alphabet, in words; `NONE` if there is none."""
    node = min((node for e in expressions for node in e.atoms(*JUMPS, *KINKS)), key=str, default=None)
    return NONE if node is None else because("{part} has no derivative somewhere", part=node)


def length(expression: sp.Expr) -> int:
    """Number of nodes of the expression as it is written out, each part as often as it stands there."""
    known: dict[sp.Basic, int] = {}

    def of(node: sp.Basic) -> int:
        if node not in known:
            known[node] = 1 + sum(map(of, node.args))
        return known[node]

    return of(expression)


def size(expressions: Iterable[sp.Expr]) -> int:
    """Number of different nodes of the expressions' trees, a measure of the work they ask for."""
    seen: set[sp.Basic] = set()
    stack: list[sp.Basic] = list(expressions)
    while stack:
        node = stack.pop()
        if node not in seen:
            seen.add(node)
            stack += node.args
    return len(seen)
