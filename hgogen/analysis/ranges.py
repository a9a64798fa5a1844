"""Proved ranges on the declared box: of the gains a_i of a form, of its b, and of any expression of the user.

The a_i of a form have ranges on the declared box, with A and C at the ends of these ranges.

z_(i,j)' = a_(i,j+1) z_(i,j+1) + .., y_i = a_(i,1) z_(i,1) + ..: a chain's (A, C) is linear in its a_(i,j). The ends of
their ranges are therefore the vertices of a polytope that contains (A, C) for every input and parameter.

b can be limited in value: phi_s = sat(phi) of Astolfi, Jungers, Zaccarian, ECC 2018, (3) and (7).

    b_i is min(max(b_i, low_i), high_i),   its argument clamped to the declared box as well, or not

With the argument clamped, a limit that b keeps on the box changes nothing, and the observer's proofs stay valid. In all
other cases they do not: a limited b is not the plant's, and at an estimate outside of the box no range bounds the
slopes of b.

The range of a user's expression is rigorous, on the declared box of a plant or on a user's box.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import prod
from numbers import Rational, Real
from typing import Any

import numpy as np
import sympy as sp

from hgogen.check import Verdict
from hgogen.errors import BadArgument
from hgogen.form import Form
from hgogen.reading.expression import Fold, read
from hgogen.reading.given import BadGain, demand_limits, in_order, real, reals, scalar
from hgogen.rigor import bounds
from hgogen.rigor.bounds import LIMIT, Range, Sign
from hgogen.rigor.box import Box, End, box, exact
from hgogen.rigor.tape import NoTape
from hgogen.sentence import NONE, Reason, because, joined
from hgogen.system import System

Corner = tuple[tuple[tuple[Fraction, ...], ...], tuple[Fraction, ...]]  # A (n, n) and C (n) of a chain

VARYING = 8  # a_i of a chain that may vary: their ends have 2^8 combinations


def chains(form: Form) -> tuple[tuple[sp.Expr, ...], ...]:
    """Return the gains a_(i,1), .., a_(i,n_i) of each output's chain, with exact numbers for constants."""
    return tuple(tuple(exact(sp.sympify(a).xreplace(fixed_parameters(form))) for a in chain) for chain in form.gains)


def fixed_parameters(form: Form) -> Mapping[sp.Symbol, sp.Rational]:
    """Return the values of the parameters without a range, by symbol."""
    return form.system.constants


def signals(form: Form) -> tuple[sp.Symbol, ...]:
    """Return the symbols of the form: the states z, the inputs and the parameters."""
    return (*form.states, *form.system.inputs, *form.system.parameters)


def span(expression: sp.Expr, form: Form, boxes: int = LIMIT) -> Range | None:
    """Return the proved range of an expression on the form's declared ranges; None for a function without interval
    arithmetic. `boxes`: the most boxes of a bisection."""
    try:
        return bounds.bound(expression, box(signals(form)), boxes=boxes, relative=0.005)
    except NoTape:
        return None


def extents(chain: Sequence[sp.Expr], form: Form) -> tuple[Range, ...] | Reason:
    """Return the proved ranges of the gains a_1, .., a_n of a chain on the form's declared ranges; or the reason why
    there are none."""
    ranges = []
    for i, a in enumerate(chain, 1):
        known = span(a, form)
        if not (known and known.defined and known.finite):
            return because("a_{i} = {a} has no finite range on the box", i=i, a=a)
        ranges.append(known)
    return tuple(ranges)


def corners(chain: Sequence[sp.Expr], form: Form) -> list[Corner] | Reason:
    """Return the pairs of A (n, n) and C (n) of a chain z_i' = a_(i+1) z_(i+1), y = a_1 z_1, for all combinations of
    the ends of the ranges of its gains a_i on the declared ranges; or the reason why there are none."""
    ranges = extents(chain, form)
    if isinstance(ranges, Reason):
        return ranges
    ends = [
        (Fraction(a),) if a.is_Rational else (Fraction(known.low), Fraction(known.high))
        for a, known in zip(chain, ranges, strict=True)
    ]
    if sum(len(pair) > 1 for pair in ends) > VARYING:
        return because("more than {most} of the a_i vary, whose ranges have too many vertices", most=VARYING)
    n = range(len(ends))
    return [
        (
            tuple(tuple(a[j] if j == i + 1 else Fraction(0) for j in n) for i in n),
            tuple(a[0] if j == 0 else Fraction(0) for j in n),
        )
        for a in product(*ends)
    ]


def several_corners(each: Sequence[Sequence[sp.Expr]], form: Form) -> list[tuple[np.ndarray, np.ndarray]] | Reason:
    """Return the block diagonal matrices A (n, n) and C (q, n) of q chains for all combinations of the ends of the
    ranges of their a_i, as arrays of fractions; or the reason why there are none."""
    ends = [corners(chain, form) for chain in each]
    known = [end for end in ends if not isinstance(end, Reason)]
    if len(known) < len(ends):
        return next(end for end in ends if isinstance(end, Reason))
    if prod(map(len, known)) > 2**VARYING:
        return because("more than {most} of the a_i vary, whose ranges have too many vertices", most=VARYING)
    pairs = []
    for one in product(*known):  # the block-diagonal A and C of all chains
        sizes = [len(C) for _, C in one]
        A, C = (np.full((rows, sum(sizes)), Fraction(0), dtype=object) for rows in (sum(sizes), len(sizes)))
        for k, ((inner, row), end) in enumerate(zip(one, np.cumsum(sizes).tolist(), strict=True)):
            at = slice(end - sizes[k], end)
            A[at, at], C[k, at] = inner, row
        pairs.append((A, C))
    return pairs


# ---------------------------------------------------------------- saturation


_ANY = (-math.inf, math.inf)
Limits = float | Mapping[str, Any] | None


def saturated(form: Form, saturate: Limits, arguments: bool) -> Form:
    """Return the form with limits of the values of b, for an observer.

    Args: `saturate`: a limit of |b_i|, or a pair (low, high), by the name of the state whose rate contains b_i; one
    number where b has one nonzero row; None for no limit. `arguments`: whether the argument of b is clamped as well.
    Raises: `BadGain`, `BadNames`.
    """
    if saturate is None:
        if not arguments:
            raise BadGain("arguments = False", "leaves b without a bound; give saturate=, the limits of its value")
        return form
    if form.jacobian is not None or form.behind is not None:
        raise BadGain("saturate", "is for a form in whose coordinates b is a function of z, which this one is not")
    named: Any = saturate
    if not isinstance(saturate, Mapping):
        rows = [name for name, row in zip(form.names, form.b, strict=True) if row != 0]
        if len(rows) != 1:
            wanted = f"must be a limit by name, of {', '.join(rows) or 'a b that is not 0'}"
            raise BadGain(f"saturate = {saturate!r}", wanted)
        named = {rows[0]: saturate}
    limits = in_order("saturate", named, form.names, default=dict.fromkeys(form.names, _ANY))
    ends = tuple(map(_ends, form.names, limits, form.signs))
    loose = [name for name, row, end in zip(form.names, form.b, ends, strict=True) if row != 0 and end == _ANY]
    if loose and not arguments:
        raise BadGain("arguments = False", f"needs a limit of every row of b; give one for {', '.join(loose)}")
    return replace(form, limits=ends, free=not arguments)


def _ends(name: str, limit: Any, sign: int) -> tuple[float, float]:
    if limit == _ANY:
        return _ANY
    values = reals(f"saturate of {name}", limit)
    if values.shape == (2,):
        low, high = map(float, values)
    else:
        high = real(f"saturate of {name}", limit)
        low = -high
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadGain(
            f"saturate of {name} = {limit!r}", "must be a positive finite number, or a pair of which low is below high"
        )
    return (low, high) if sign > 0 else (-high, -low)


def cut_reason(form: Form) -> Reason:
    """Return the reason why the b of an observer is not proved to equal b(sat(z), u) on the box, such as limits that
    cut its values; `NONE` where it is."""
    if not form.clamped:
        return because("without guards no argument of b is clamped, on which the proof rests")
    if form.free:
        return because("the argument of b is not clamped to the declared ranges, on which the proof rests")
    for i, (row, (low, high)) in enumerate(zip(form.b, form.limits or (), strict=False), 1):
        if (low, high) == _ANY:
            continue
        known = span(row, form)
        if not (known and known.defined and low <= known.low and known.high <= high):
            pattern = "b_{i} is not shown to keep within its limits, {low} to {high}, on the box"
            return because(pattern, i=i, low=low, high=high)
    return NONE


def limit_lines(form: Form) -> tuple[str, ...]:
    """Return lines of text with the limits of b_i, for the equations of an observer; () without limits."""
    if not form.limits:
        return ()
    rows = ((i, end) for i, end in enumerate(form.limits, 1) if end != _ANY)
    limited = ", ".join(f"b_{i} in [{low:g}, {high:g}]" for i, (low, high) in rows)
    return (f"b is limited in value, {limited}, and its argument {'is as it is' if form.free else 'clamped'}",)


# ---------------------------------------------------------------- query


class NotInBox(BadArgument):
    """The error that an expression contains a symbol for which the box declares no range and no value."""


class BadRange(BadArgument):
    """The error that `where` is no box (a mapping from symbols to ranges), or contains a value that is no range (low,
    high)."""

    text = "the box: {what} {reason}; give a plant, or a mapping such as {{'u': (-1, 1)}}"


def bound(expression: Any, where: System | Box, *, boxes: int = LIMIT, relative: float = 0.02) -> Range:
    """Return the proved range of an expression on a closed box. It is wider than the true range by at most `relative`
    of its width, or its `note` gives the reason; the note also names places without a value that SymPy removed from a
    text.

    Args: `expression`: SymPy, or text in the names of the box, read by the grammar of plain-text models; `where`: a
    plant, for the box of its declared ranges, with parameters without a range at their values and outputs replaced by
    their equations; or a mapping from symbols or names to closed ranges (low, high), exact or float, infinite if
    unbounded; `boxes`: the most boxes of a bisection. Raises: `BadExpression` for text outside the grammar; `Misfit`
    for a value that is no expression, and for limits out of range; `NotInBox`; `BadRange`; `EmptyBox`; `NoTape` for a
    function without interval arithmetic.
    """
    demand_limits("bound", boxes, relative)
    resolved, box, folded = _resolved("bound", expression, where)
    extent = bounds.bound(resolved, box, boxes=boxes, relative=relative)
    return replace(extent, defined=False, note=joined(folded, extent.note)) if folded else extent


def nonzero(expression: Any, where: System | Box, *, boxes: int = LIMIT) -> Sign:
    """Return whether an expression is finite and has one sign on the whole closed box, as a proved or refuted `Sign`;
    arguments and errors as of `bound`.

    The verdict is `unknown` for a text in which SymPy cancelled a singularity on the box, such as x/x at 0.
    """
    demand_limits("nonzero", boxes)
    resolved, box, folded = _resolved("nonzero", expression, where)
    answer = bounds.nonzero(resolved, box, boxes=boxes)
    if folded and answer.verdict is Verdict.PROVED:
        return replace(answer, verdict=Verdict.UNKNOWN, sign=0, margin=0.0, reason=folded, exact=None)
    return answer


def _resolved(what: str, source: Any, where: System | Box) -> tuple[sp.Expr, Box, Reason]:
    plant = where if isinstance(where, System) else None
    around = plant.box_with(plant.states) if plant else _ranges(where)
    equations = dict(zip(plant.outputs, plant.output, strict=True)) if plant else {}
    names: dict[str, sp.Symbol] = {s.name: s for s in (*around, *equations)}
    tables = {cells.name: cells for cells in plant.tables} if plant else {}
    fold = read(source, names, tables) if isinstance(source, str) else Fold("", scalar(source, what), ())
    expression = fold.reading
    for symbol in sorted(expression.free_symbols - {*around, *equations}, key=str):
        if symbol.name in names:
            raise NotInBox(
                str(symbol), "is not the symbol declared with that name; use the Signal itself, or write text"
            )
        raise NotInBox(
            str(symbol), f"is not in the box, which has {', '.join(names) or 'no symbols'}; declare it there"
        )
    written = replace(
        fold, lost=tuple(one._replace(expression=one.expression.xreplace(equations)) for one in fold.lost)
    )
    return expression.xreplace(equations), around, written.on(around)


def _ranges(where: Any) -> Box:
    if not isinstance(where, Mapping):
        raise BadRange(str(where), "is neither a plant nor a mapping")
    ranges: dict[sp.Symbol, tuple[End, End]] = {}
    for key, value in where.items():
        if not isinstance(key, sp.Symbol | str):
            raise BadRange(str(key), "is no name")
        if not isinstance(value, Sequence) or len(value) != 2:
            raise BadRange(str(key), f"has {value!r} for its range")
        low, high = (_end(key, end) for end in value)
        ranges[key if isinstance(key, sp.Symbol) else sp.Symbol(key)] = low, high
    return ranges


def _end(key: Any, end: Any) -> End:
    """Return the end of a range as a number; a float has the value of its shortest decimal: 0.1 is 1/10."""
    if isinstance(end, sp.Rational):
        return Fraction(end)
    if isinstance(end, bool) or not isinstance(end, Real):
        raise BadRange(str(key), f"has the end {end!r}, which is no number")
    if isinstance(end, float) and math.isfinite(end):
        return Fraction(repr(float(end)))
    return Fraction(end) if isinstance(end, Rational) else float(end)
