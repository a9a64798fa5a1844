"""How far the plant's own states err behind a change of coordinates, of bounds of the errors of a form's states.

    |x_i - xhat_i| <= sum_j sup |dx_i/dz_j| |z_j - zhat_j|

The supremum is over where an observer takes the map back, between a z of the plant, in its ranges, and an estimate that
errs by no more than the bounds allow: by outward-rounded intervals, of a map that bends but does not jump. What is
linear in z is taken at z, the rest where it is clamped; a clamp leaves a share of an error, one to the ranges as well.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import sympy as sp

from hgogen.analysis.coordinates import linear_terms
from hgogen.analysis.dynamics import moved, reach
from hgogen.analysis.inverse import sided
from hgogen.analysis.polytope import signals
from hgogen.form import Form
from hgogen.prove.plant_step import Unbounded, steepness_in
from hgogen.rigor.box import Box, box

Slopes = Mapping[str, tuple[Fraction, ...]]


def slopes_of_states(form: Form, errors: Sequence[Fraction]) -> Slopes:
    """By the name of a state of the plant that is none of the form's, the sup |dx/dz_j| (n), where the states of the
    form err by at most these `errors` (n); without those of which no slope is known."""
    slopes = {}
    for state, expression in form.estimates:
        if state.name in form.names:
            continue
        try:
            slopes[state.name] = _of_plant(form, state) if moved(form) else _of_form(form, expression, errors)
        except Unbounded:
            continue
    return slopes


def _of_form(form: Form, expression: sp.Expr, errors: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Of a state that is reported as an expression of z, clamped to where it turns round. Raises: `Unbounded`."""
    where, (_, rest) = box(signals(form), form.system.nominal), linear_terms(expression, form.states)
    for z, error in zip(form.states, errors, strict=True):
        (low, high), (least, most) = map(Fraction, z.interval), reach([rest], z, form.states)
        where[z] = max(low - error, _end(least, low - error)), min(high + error, _end(most, high + error))
    return _steepest(expression, form, where)


def _of_plant(form: Form, state: sp.Symbol) -> tuple[Fraction, ...]:
    """Of a state that is reported as an expression of the states of the form's system, which are recovered of z clamped
    to its ranges, and are then clamped to theirs. Raises: `Unbounded`."""
    system, inverse = form.system, sided(form)
    (reported,) = (expression for signal, expression in system.reported if signal == state)
    around = box((*system.states, *system.inputs, *system.parameters), system.nominal)
    total = [Fraction(0)] * form.n
    for x, row, finite in zip(system.states, inverse.rows, inverse.finite, strict=True):
        share = steepness_in(reported, x, around)
        if not share:
            continue
        if not finite:
            raise Unbounded
        own = _steepest(row, form, box(signals(form), system.nominal))
        total = [y + share * s for y, s in zip(total, own, strict=True)]
    return tuple(total)


def _steepest(expression: sp.Expr, form: Form, where: Box) -> tuple[Fraction, ...]:
    """sup |l_j + c r_j|, c in [0, 1], of what is linear in z, with slopes l, and the rest, with slopes r: at an end of
    c. Raises: `Unbounded`."""
    linear, _ = linear_terms(expression, form.states)
    return tuple(max(steepness_in(linear, z, where), steepness_in(expression, z, where)) for z in form.states)


def _end(end: float, otherwise: Fraction) -> Fraction:
    return Fraction(end) if abs(end) < float("inf") else otherwise
