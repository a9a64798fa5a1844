"""Whether a flow keeps constraints c(x) = 0, exactly.

    grad c_i f = sum_j g_ij c_j with finite g_ij   =>   x' = f keeps c = 0

Along a motion c' = G c is a linear differential equation, whose solution from c = 0 is 0. The quotients g_ij come from
division of polynomials in the expressions' symbols and functions, and an exact zero test confirms the remainder 0.
"""

from collections.abc import Mapping, Sequence

import sympy as sp

from hgogen.rigor.field import vanishes


def remainder(constraint: sp.Expr, constraints: Sequence[sp.Expr], flow: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Return the rate of change of a constraint modulo all constraints: 0 where the flow is proved to keep it. `flow`:
    the rate of each state."""
    rate = sp.Add(*(sp.diff(constraint, x) * f for x, f in flow.items()))
    left = modulo(sp.numer(sp.together(rate)), constraints)
    return sp.S.Zero if vanishes(left) else left


def opposites(
    constraints: Sequence[sp.Expr], flow: Mapping[sp.Symbol, sp.Expr], output: Sequence[sp.Expr]
) -> tuple[tuple[int, ...], ...]:
    """Return the sets v of states, by their indices, of which v and -v are the same state of the plant, as q and -q of
    a quaternion: with -v for v no output and no constraint changes, nor the rate of another state, and v' becomes -v'.
    """
    states, groups = list(flow), list[tuple[int, ...]]()
    for constraint in constraints:
        turned = {x: -x for x in states if x in constraint.free_symbols}
        changes = (row.xreplace(turned) - row for row in (*constraints, *output))
        rates = (f.xreplace(turned) - (-f if x in turned else f) for x, f in flow.items())
        if all(vanishes(change) for change in (*changes, *rates)):
            groups.append(tuple(states.index(x) for x in turned))
    return tuple(dict.fromkeys(groups))


def modulo(expression: sp.Expr, constraints: Sequence[sp.Expr]) -> sp.Expr:
    """Return an expression that equals the given one where all constraints are 0: the remainder of its division by
    them, as polynomials."""
    if not constraints:
        return expression
    try:
        return sp.reduced(expression, list(constraints))[1]
    except sp.PolynomialError:
        return expression
