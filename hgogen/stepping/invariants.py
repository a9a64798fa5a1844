"""The estimate and its covariance on the plant's invariants, c(x) = 0.

    z <- p(z),   P <- N P N',   N = dp/dz,   V = diag(width of the outer box)^2
    v <- r v/|v|,   N_v = (1 - v v'/|v|^2) r/|v|           for c = a (|v|^2 - r^2), v some of the coordinates
    z <- z - V g c/(g' V g),   N = 1 - V g g'/(g' V g)     for another c, g = dc/dz: one Newton step

after each prediction and correction, at the start and after a restart; several invariants one after the other. N P N'
is singular: it has no variance across c = 0, so that the smallest value of an entry of a factor of P is 0. Variances
along c = 0 do not shrink. A measurement of c = 0 in place of the projection would shrink them: a yaw that no sensor
observes would look known.

Source: Simon, "Optimal State Estimation" (2006), 7.5.2, with the covariance by the Jacobian of the projection.
"""

from dataclasses import replace

import casadi as ca
import sympy as sp

from hgogen.graph import Graph
from hgogen.observer import Observer
from hgogen.part import Pieces
from hgogen.program import Block, Call, Program, Section, address, column, stacked, sym
from hgogen.reading.given import BadGain
from hgogen.stepping.projection import estimate_fields, placed, weights

SMALL = 1e-3  # of the radius: a shorter vector has no direction


def constrained(observer: Observer, pieces: Pieces) -> Pieces:
    """Return the pieces with a projection of the estimate onto the plant's invariants after each prediction and
    correction; `pieces` itself for a plant without any. Raises: `BadGain` for a covariance that would become singular
    and is stored inverted, and for a bank."""
    system = observer.form.system
    if not system.invariants:
        return pieces
    if pieces.project:
        raise BadGain("bank", f"does not keep the invariants of {system.name}; take its member")
    fields = estimate_fields(observer, pieces.fields)
    x = stacked(fields)
    projected, N = _projected(observer, x, weights(fields))
    program: Program = ()
    memory = pieces.fields
    if pieces.covariance is not None:
        if pieces.congruence is None:
            reason = f"of {observer.name} has no inverse on the invariants of {system.name}, and this method stores it"
            raise BadGain("the covariance", reason, fix="take continuous_discrete or cholesky")
        program = pieces.congruence(N)
        factors = {address(symbol)[0].name for symbol in ca.symvar(pieces.covariance)}
        memory = tuple(
            replace(each, low=tuple(min(low, 0.0) for low in each.low)) if each.name in factors else each
            for each in pieces.fields
        )
    program = (*program, Block("the estimate onto the invariants of the plant", placed(fields, projected)))
    section = Section("keep_invariants", "project the estimate onto the invariants of the plant", program)
    call = (Call(section),)
    return replace(
        pieces,
        fields=memory,
        predict=(*pieces.predict, *call),
        update=tuple((*each, *call) if each and not pieces.correct else each for each in pieces.update),
        correct=(*pieces.correct, *call) if pieces.correct else (),
        inner=(*pieces.inner, section),
        constrain=call,
    )


def _projected(observer: Observer, x: Graph, V: Graph) -> tuple[Graph, Graph]:
    """Return the projection p (n) of an estimate onto the invariants and its Jacobian N (n, n), SX of the fields x
    (n)."""
    dynamics, u = observer.dynamics, sym("state", "u", len(observer.form.system.inputs))
    plain = ca.is_equal(ca.SX(observer.z), x, 1)
    value, N = x, ca.SX.eye(x.numel())
    for constraint in dynamics.invariants:
        part, square = sphere(constraint, observer.form.states) if plain else ((), sp.S.Zero)
        if part:
            (radius,) = dynamics.values([sp.sqrt(square)], x, u)
            v = ca.sparsify(column(value[i] if i in part else 0 for i in range(x.numel())))
            length = ca.fmax(ca.norm_2(v), SMALL * radius)
            scale: Graph = ca.diag(column(radius / length if i in part else 1 for i in range(x.numel())))
            value, across = scale @ value, (v / length) @ (v / length).T
        else:
            (c,) = dynamics.values([constraint], observer.z, u)
            c, g = ca.substitute([c, ca.jacobian(c, x).T], [x], [value])
            toward = V * g / ca.fmax(ca.dot(g, V * g), 1e-30)
            value, across, scale = value - toward * c, toward @ g.T, ca.SX.eye(x.numel())
        N = scale @ (ca.SX.eye(x.numel()) - across) @ N
    return value, ca.sparsify(N)


def sphere(constraint: sp.Expr, states: tuple[sp.Symbol, ...]) -> tuple[tuple[int, ...], sp.Expr]:
    """Return the indices of the coordinates v and the expression r^2 of a constraint a (|v|^2 - r^2) = 0; () for
    another constraint."""
    try:
        terms = sp.Poly(constraint, *states).as_dict()
    except sp.PolynomialError:
        return (), sp.S.Zero
    constant = terms.pop((0,) * len(states), sp.S.Zero)
    squares = [powers.index(2) for powers in terms if 2 in powers and sum(powers) == 2]
    factors = set(terms.values())
    if len(squares) < len(terms) or len(factors) != 1:
        return (), sp.S.Zero
    square = sp.simplify(-constant / factors.pop())
    return (tuple(sorted(squares)), square) if square.is_positive or not square.is_number else ((), sp.S.Zero)
