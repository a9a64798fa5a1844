"""Dissipation of an error system that is rebuilt from the plant.

The error is built from the plant of the certificate and the observer that a claim states. For correction by the output
error:

    x' = f(x, u) + G1(x) w,   y = h(x, u) + G2(x) w,   xhat' = f(xhat, u) + l(xhat, u) (y - h(xhat, u)),   e = x - xhat
    e' = F(e, x) + G(e, x) w,   F = f(x) - f(x - e) - l(x - e) (h(x) - h(x - e)),   G = G1(x) - l(x - e) G2(x)

A claim states the gain l, G1, G2 and the ranges of the errors, never F and G; so F vanishes at e = 0, and another plant
has another F. Nothing is saturated: f, h and l are evaluated as written also outside the ranges of x.

For an observer with any equations:

    x' = f(x, u, w),   y = h(x, u, w),   xhat' = g(xhat, y, u),   e = x - xhat
    e' = f(x, u, w) - g(x - e, h(x, u, w), u) = F(e, x, u) + G(e, x, u) w

A claim states g in the states (for the estimate), y_1, y_2, .. and known inputs, the inputs w unknown to g, and F and
G; it may hold on a set x_k = a_k(x) only, which must be invariant for the plant: f_k = sum_j da_k/dx_j f_j. These are
exact identities, wherever both sides have a value; F vanishes at e = 0.

Source: Alessandri, Mathematical Problems in Engineering (2020), (19), (24), (25), (29), (30).

The Hamilton-Jacobi inequality of an error system bounds its L2 gain mu from w to e while e is in a box:

    e' = F(e, x) + G(e, x) w:   V(0) = 0, V(e) > 0,   S(e, x) = V_e F + |V_e G|^2/(2 mu^2) + |e|^2/2 < 0,   e not 0

With V_e(0) = 0, F(0, x) = 0 both V_e and F are averages of their slopes between 0 and e, so that S <= -e'N e and V =
e'H e/2, N and H averages of H(c) and

    N(c, d, g) = -(H(c) F_e(d) + F_e(d)'H(c) + H(c) G(g) G(g)'H(c)/mu^2 + I)/2,   H = V_ee

over c, d, g in any box around 0 that contains e. Bisection proves them positive definite on a `share` of the box of
errors, and S and V nonzero on the remaining slabs. A set {V <= c} does not reach the faces of the box if V is above c
on them: for V = e'P e, if P - c/end_i^2 on its place (i, i) has no negative eigenvalue. Source: Alessandri,
Mathematical Problems in Engineering (2020), theorem 1, (21), (38), (39).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import chain
from operator import mul
from typing import Any

from ..arithmetic import Arithmetic, Dual, Undefined, Unproved, dual, evaluate, jacobian, seeded, total
from ..box import (
    Box,
    End,
    all_finite,
    by_mean_value,
    covered,
    narrowed,
    points,
    positive,
    ranged,
    shortened,
    sides,
    unbounded,
)
from ..context import Context, Finding, Rule, algebra_of, demand_finite, inner, inside, numbers, on_ranges, printed
from ..file import Claim, Equations, above_zero, entries, fields, matrix, part, scalar, signals
from ..interval import Interval, intervals, point
from ..matrix import Matrix, demand_nonnegative, outer, unit_row
from ..text import Expression, expression

Rows = tuple[tuple[Expression, ...], ...]
PARTS = ("gain", "G1", "G2", "errors")  # of a claim's description of the system


@dataclass(frozen=True)
class ErrorSystem:
    """The error system e' = F + G w of a `plant` and an observer, e = x - xhat (n). `around`: the ranges of e, around
    0; `flow`, `noise`: F (n) and G (n, k) as functions of the names' values in any arithmetic; `read_by_flow`,
    `read_by_noise`: the names that F and G read."""

    plant: Equations
    around: Box
    flow: Callable[[Mapping[str, Any], Arithmetic], list[Any]]
    noise: Callable[[Mapping[str, Any], Arithmetic], list[list[Any]]]
    read_by_flow: set[str]
    read_by_noise: set[str]
    sentence: str


def error_system(context: Context, description: Mapping[str, Any]) -> ErrorSystem:
    """Return the error system e' = F(e, x) + G(e, x) w of the plant and the observer xhat' = f + l (y - h), with the
    gain l (n, p), G1 (n, k) and G2 (p, k) of the `description`. Raises: `Unproved`."""
    plant = context.plant
    around, n, p = around_of(context, description), len(plant.states), len(plant.output)
    texts = entries(description, "G1", n)
    columns = len(texts[0]) if isinstance(texts[0], list) else 0
    gain = matrix_of(description, "gain", n, p, plant.box)
    G1, G2 = (matrix_of(description, key, rows, columns, plant.box) for key, rows in (("G1", n), ("G2", p)))
    demand_smooth((*plant.flow, *plant.output, *flat(gain)))

    def behind(at: Mapping[str, Any]) -> dict[str, Any]:
        return {**at, **{x: at[x] - at[e] for x, e in zip(plant.states, around, strict=True)}}

    def flow(at: Mapping[str, Any], arithmetic: Arithmetic) -> list[Any]:
        before = behind(at)
        rows = (*plant.flow, *plant.output)
        change = [evaluate(row, at, arithmetic) - evaluate(row, before, arithmetic) for row in rows]
        pairs = zip(change[:n], gain, strict=True)
        return [_less(rate, row, change[n:], before, arithmetic) for rate, row in pairs]

    def noise(at: Mapping[str, Any], arithmetic: Arithmetic) -> list[list[Any]]:
        before = behind(at)
        first, second = ([[evaluate(x, at, arithmetic) for x in row] for row in M] for M in (G1, G2))
        return [
            [_less(x, row, [other[k] for other in second], before, arithmetic) for k, x in enumerate(pushed)]
            for pushed, row in zip(first, gain, strict=True)
        ]

    def with_errors(names: set[str]) -> set[str]:
        return names | {e for x, e in zip(plant.states, around, strict=True) if x in names}

    words = ", ".join(f"{name} = {shortened(text_of(rows))}" for name, rows in zip(PARTS, (gain, G1, G2), strict=False))
    return ErrorSystem(
        plant,
        around,
        flow,
        noise,
        with_errors(names_of((*plant.flow, *plant.output, *flat(gain)))),
        with_errors(names_of(flat(gain))) | names_of(flat((*G1, *G2))),
        f"e = x - xhat of xhat' = f(xhat, u) + gain (y - h(xhat, u)), {words}",
    )


def around_of(context: Context, description: Mapping[str, Any]) -> Box:
    """Return the ranges of the errors in the `description` of an error system. Raises: `Unproved`."""
    plant, around = context.plant, signals(description, "errors")
    if tuple(around) != tuple(f"e_{x}" for x in plant.states) or around.keys() & plant.box.keys():
        raise Unproved("its errors are not e_ and the name of each of the plant's states, in their order")
    if not all(-math.inf < low < 0 < high < math.inf for low, high in around.values()):
        raise Unproved("its errors have no finite ranges around 0")
    return around


def demand_smooth(texts: Iterable[Expression]) -> None:
    """Demand that the expressions have no kinks or jumps. Raises: `Unproved`."""
    for text in texts:
        if text.kinked:
            raise Unproved(f"{shortened(text.text)} has kinks or jumps")


def matrix_of(description: Mapping[str, Any], key: str, rows: int, columns: int, names: Box) -> Rows:
    """Return the matrix (rows, columns) of expressions under a key of the `description`; the expressions may read
    `names`. Raises: `Unproved`."""
    texts = entries(description, key, rows)
    return tuple(tuple(expression(cell, names) for cell in entries({key: row}, key, columns)) for row in texts)


def _less(value: Any, row: Sequence[Expression], miss: Sequence[Any], at: Mapping[str, Any], a: Arithmetic) -> Any:
    for gain, each in zip(row, miss, strict=True):
        value = value - evaluate(gain, at, a) * each if gain.text != "0" else value
    return value


def flat(rows: Rows) -> list[Expression]:
    """Return the expressions of a matrix, row by row."""
    return [cell for row in rows for cell in row]


def names_of(texts: Iterable[Expression]) -> set[str]:
    """Return the names that the expressions read."""
    return {name for text in texts for name in text.names}


def text_of(rows: Rows) -> str:
    """Return a matrix of expressions as text, with rows separated by semicolons."""
    return f"({'; '.join(', '.join(cell.text for cell in row) for row in rows)})"


# --- of any equations

OBSERVED = ("observer", "unknown", "along", "flow", "noise", "errors")  # of a claim's description of the system


def observed_system(context: Context, description: Mapping[str, Any]) -> ErrorSystem:
    """Return the error system e' = F(e, x, u) + G(e, x, u) w that the `description` states, once it is proved to be
    that of the plant and the observer xhat' = g(xhat, y, u) there. Raises: `Unproved`."""
    plant, around, n = context.plant, around_of(context, description), len(context.plant.states)
    inputs, parameters = context.file.inputs, context.file.parameters
    unknown, along = tuple(part(description, "unknown", list)), part(description, "along", dict)
    if not unknown or len(set(map(str, unknown))) < len(unknown) or not set(map(str, unknown)) <= {*inputs}:
        raise Unproved("what its observer does not know are not inputs of the plant")
    if not along.keys() < {*plant.states}:
        raise Unproved("it holds along what is not a part of the plant's states")
    outputs = [f"y_{k}" for k in range(1, len(plant.output) + 1)]
    if not plant.box.keys().isdisjoint(outputs):
        raise Unproved("the plant has a name of the form y_1, which here is the first output")
    known = {name: ends for name, ends in plant.box.items() if name not in unknown}
    free = {name: ends for name, ends in known.items() if name not in along}
    fixed = {name: free[name] for name in (*plant.states, *parameters) if name in free}
    observer = _expressions(description, "observer", n, {**known, **dict.fromkeys(outputs)})
    set_ = {name: expression(value, fixed) for name, value in sorted(along.items())}
    rates = _expressions(description, "flow", n, {**free, **around})
    pushed = matrix_of(description, "noise", n, len(unknown), {**free, **around})
    demand_smooth(rates)
    rows = f"xhat' = {shortened(text_of(tuple((row,) for row in observer)))} of xhat and y"
    on = "".join(f", on {x} = {shortened(value.text)}" for x, value in set_.items())
    system = ErrorSystem(
        plant,
        around,
        lambda at, arithmetic: [evaluate(row, at, arithmetic) for row in rates],
        lambda at, arithmetic: [[evaluate(cell, at, arithmetic) for cell in row] for row in pushed],
        names_of(rates),
        names_of(flat(pushed)),
        f"e = x - xhat of {rows}, which does not know {', '.join(unknown)}{on}, wherever it has a value",
    )
    _demand_same(system, set_, observer, unknown, (*rates, *flat(pushed)), outputs)
    return system


def _expressions(
    description: Mapping[str, Any], key: str, count: int, names: Mapping[str, Any]
) -> tuple[Expression, ...]:
    return tuple(expression(text, names) for text in entries(description, key, count))


def _demand_same(
    system: ErrorSystem,
    along: Mapping[str, Expression],
    observer: Sequence[Expression],
    unknown: Sequence[str],
    rows: Sequence[Expression],
    outputs: Sequence[str],
) -> None:
    """Demand that the set of states with x_k = a_k(x) (`along`) is invariant, that F and G of the error system there
    are those of plant and observer, and that F = 0 at e = 0. Raises: `Unproved`."""
    plant, algebra = system.plant, algebra_of({**system.plant.box, **system.around})
    at = {**algebra.names, **{name: algebra.read(value) for name, value in along.items()}}
    f = [algebra.read(row, at) for row in plant.flow]
    speeds = dict(zip(plant.states, f, strict=True))
    for name, value in along.items():  # x_k = a_k(x) is invariant: a_k is continuous, and x_k' its derivative
        demand_finite(value, plant.box)
        if not algebra.is_zero(speeds[name] - algebra.speed(value, speeds, at)):
            raise Unproved(f"the plant is not shown to keep to {name} = {shortened(value.text)}")
    y = {name: algebra.read(row, at) for name, row in zip(outputs, plant.output, strict=True)}
    estimate = {x: at[x] - at[e] for x, e in zip(plant.states, system.around, strict=True)}
    _demand_values(plant, system.around, along, observer, rows, outputs)
    claimed = zip(system.flow(at, algebra.arithmetic), system.noise(at, algebra.arithmetic), strict=True)
    still = system.flow({**at, **dict.fromkeys(system.around, algebra.zero)}, algebra.arithmetic)
    for name, rate, g, (drift, pushed), at_zero in zip(plant.states, f, observer, claimed, still, strict=True):
        e = rate - algebra.read(g, {**at, **estimate, **y}) - drift
        for cell, w in zip(pushed, unknown, strict=True):
            e = e - cell * at[w]
        if not algebra.is_zero(e):
            raise Unproved(f"e_{name}' is not shown to be that of the plant and the observer")
        if not algebra.is_zero(at_zero):
            raise Unproved(f"e_{name}' is not shown to vanish at e = 0")


def _demand_values(
    plant: Equations,
    around: Box,
    along: Mapping[str, Expression],
    observer: Sequence[Expression],
    rows: Sequence[Expression],
    outputs: Sequence[str],
) -> None:
    """Demand that plant, observer and error system have a value at an interior point with e = 0: an identity between
    undefined expressions proves nothing. Raises: `Unproved`."""
    zero = dict.fromkeys(around, Fraction(0))
    at = points({**{name: inside(*ends, Fraction(1, 3)) for name, ends in plant.box.items()}, **zero})
    at |= {name: evaluate(value, at, intervals) for name, value in along.items()}
    at |= {name: evaluate(row, at, intervals) for name, row in zip(outputs, plant.output, strict=True)}
    for texts, whose in (
        (along.values(), "the set that it holds on"),
        (plant.flow, "the plant"),
        (observer, "its observer"),
        (rows, "its system"),
    ):
        try:
            known = all(evaluate(row, at, intervals).finite for row in texts)
        except Undefined:
            known = False
        if not known:
            raise Unproved(f"{whose} is not shown to have a value")


_SYSTEMS: Mapping[tuple[str, ...], Callable[[Context, Mapping[str, Any]], ErrorSystem]] = {
    PARTS: error_system,
    OBSERVED: observed_system,
}
_OF_ALL = ("V", "mu")
_duals = dual(intervals)  # slopes in the names of a box


@dataclass(frozen=True)
class ClaimedGain:
    """The error system e' = F + G w of a claim, with the storage function V(e) and the L2 gain mu from w to e that the
    claim states."""

    system: ErrorSystem
    V: Expression
    mu: Fraction

    @property
    def around(self) -> Box:
        """The ranges of the errors."""
        return self.system.around

    @property
    def errors(self) -> tuple[str, ...]:
        """The names of the errors."""
        return tuple(self.around)

    @property
    def box(self) -> Box:
        """The ranges of all names, the errors included."""
        return {**self.system.plant.box, **self.around}

    def finding(self, sentence: str, boxes: int) -> Finding:
        """Return a finding whose sentence also describes the error system."""
        return Finding(f"{sentence}; of the error {self.system.sentence}", boxes)


def is_positive(context: Context, claim: Claim) -> Finding:
    """Prove V(0) = 0 and V(e) > 0 for every other e in the box of errors."""
    claimed = _claimed_gain(context, claim)
    share, T = _share(claim, claimed)
    boxes = covered(_copies(claimed, share, {"c": claimed.V.names}), ".", _definite(claimed, T, _hessian))
    for slab, tree, bound in _slabs(claim, claimed, share):
        if bound <= 0:
            raise Unproved("V is not kept above zero on a slab")
        boxes += covered(narrowed(slab, claimed.V.names), tree, ranged(claimed.V, bound, math.inf))
    return claimed.finding(f"V = {shortened(claimed.V.text)} > 0 for every e but 0{on_ranges(claimed.around)}", boxes)


def inequality(context: Context, claim: Claim) -> Finding:
    """Prove S = V_e F + |V_e G|^2/(2 mu^2) + |e|^2/2 < 0 for every e != 0 in the box of errors, and every x in its
    ranges."""
    claimed = _claimed_gain(context, claim)
    share, T = _share(claim, claimed)
    reads = {"c": claimed.V.names, "d": claimed.system.read_by_flow, "g": claimed.system.read_by_noise}
    boxes = covered(_copies(claimed, share, reads), ".", _definite(claimed, T, _second_order))
    slabs = list(_slabs(claim, claimed, share))
    if slabs:
        lhs = expression(part(claim.evidence, "left", str), claimed.box)
        _demand_lhs(claimed, lhs)
        for slab, tree, bound in slabs:
            if bound >= 0:
                raise Unproved("the left side is not kept below zero on a slab")
            boxes += covered(narrowed(slab, lhs.names), tree, ranged(lhs, -math.inf, bound))
    at = f"with V = {shortened(claimed.V.text)}, mu = {printed(claimed.mu)}{on_ranges(claimed.box)}"
    return claimed.finding(f"inequality (38) holds {at}", boxes)


def level(context: Context, claim: Claim) -> Finding:
    """Prove that no set {V <= c} with c below the claim's `floor` reaches a face of the box of errors."""
    claimed, floor = _claimed_gain(context, claim), above_zero(claim.evidence, "floor")
    faces = [(i, end) for i, name in enumerate(claimed.errors) for end in _ends(claimed, name)]
    algebra, boxes = algebra_of(claimed.around), 0
    hessian = numbers(_second(claimed, algebra.names, algebra.arithmetic))
    if hessian is not None:
        P = Fraction(1, 2) * Matrix(hessian)
        for i, end in faces:
            shell = floor / end**2 * outer(*[unit_row(i, len(P))] * 2)
            demand_nonnegative({f"P - {printed(floor)}/{printed(end)}^2 on its place ({i + 1}, {i + 1})": P - shell})
    else:
        for i, end in faces:
            face = narrowed({**claimed.around, claimed.errors[i]: (end, end)}, claimed.V.names)
            boxes += covered(face, ".", ranged(claimed.V, floor, math.inf))
    levels = f"every {{V <= c}} of V = {shortened(claimed.V.text)} with c < {printed(floor, -1)}"
    return claimed.finding(f"{levels} keeps off the faces of the box{on_ranges(claimed.around)}", boxes)


# --- the claim's system


def _claimed_gain(context: Context, claim: Claim) -> ClaimedGain:
    description = part(claim.evidence, "system", dict)
    known_keys = next((keys for keys in _SYSTEMS if description.keys() == {*keys, *_OF_ALL}), None)
    if known_keys is None:
        raise Unproved(
            "its system has not the parts " + ", or ".join(", ".join((*keys, *_OF_ALL)) for keys in _SYSTEMS)
        )
    for other in context.file.claims:
        if other.maker == claim.maker and other.evidence.get("system", description) != description:
            raise Unproved(f"it is about another system than {other.id}")
    system = _SYSTEMS[known_keys](context, description)
    claimed = ClaimedGain(system, expression(description["V"], system.around), above_zero(description, "mu"))
    _vanishing(claimed)
    return claimed


def _vanishing(claimed: ClaimedGain) -> None:
    """Prove V(0) = 0 and V_e(0) = 0 by exact algebra, that V has no kinks, and that the derivatives of F and V are
    finite on the whole box."""
    algebra = algebra_of(claimed.around)
    still = dict.fromkeys(claimed.errors, algebra.zero)
    demand_smooth((claimed.V,))
    if not algebra.is_zero(algebra.read(claimed.V, still)):
        raise Unproved(f"{shortened(claimed.V.text)} is not shown to vanish at e = 0")
    (slopes,) = jacobian((claimed.V,), still, claimed.errors, algebra.arithmetic)
    if not all(map(algebra.is_zero, slopes)):
        raise Unproved("dV/de is not shown to vanish at e = 0")
    covered(narrowed(claimed.box, claimed.system.read_by_flow | claimed.system.read_by_noise), ".", _regular(claimed))

    def curvatures(box: Box) -> Iterable[Interval]:
        return [x.value for x in chain(*_hessian(claimed, {f"c.{k}": side for k, side in box.items()}))]

    covered(narrowed(claimed.around, claimed.V.names), ".", all_finite(curvatures))


def _regular(claimed: ClaimedGain) -> Any:
    """Return a function that attempts to prove on a box that F has finite partial derivatives in e, and that G is
    finite."""
    system = claimed.system

    def values(box: Box) -> Iterable[Interval]:
        at = {**dict.fromkeys(claimed.box, point(Fraction(0))), **sides(box)}  # names that are not read have any value
        rates, noise = system.flow(seeded(at, claimed.errors, intervals), _duals), system.noise(at, intervals)
        return *(x for rate in rates for x in rate.slopes.values()), *chain(*noise)

    return all_finite(values)


def _ends(claimed: ClaimedGain, name: str) -> tuple[Fraction, Fraction]:
    low, high = claimed.around[name]
    return Fraction(low), Fraction(high)


def _share(claim: Claim, claimed: ClaimedGain) -> tuple[Fraction, Matrix]:
    share, n = above_zero(claim.evidence, "share"), len(claimed.errors)
    if share > 1:
        raise Unproved("its share is above 1")
    return share, matrix(claim.evidence, "basis", n, n)


def _slabs(claim: Claim, claimed: ClaimedGain, share: Fraction) -> Iterator[tuple[Box, str, Fraction]]:
    covers = entries(claim.evidence, "slabs", 0 if share == 1 else 2 * len(claimed.errors))
    inner = dict(claimed.around)
    for k, name in enumerate(claimed.errors if covers else ()):
        low, high = _ends(claimed, name)
        for side, slab in enumerate(((low, low * share), (high * share, high))):
            cover = fields(covers[2 * k + side], "a slab", ("tree", "bound"))
            yield {**claimed.box, **inner, name: slab}, part(cover, "tree", str), scalar(cover, "bound")
        inner[name] = (low * share, high * share)


def _demand_lhs(claimed: ClaimedGain, lhs: Expression) -> None:
    """Demand that the expression `lhs` equals S = V_e F + |V_e G|^2/(2 mu^2) + |e|^2/2. Raises: `Unproved`."""
    algebra = algebra_of(claimed.box)
    e, arithmetic, half = algebra.names, algebra.arithmetic, algebra.number(Fraction(1, 2))
    (p,) = jacobian((claimed.V,), {name: e[name] for name in claimed.errors}, claimed.errors, arithmetic)
    pushed = (inner(algebra, p, column) for column in zip(*claimed.system.noise(e, arithmetic), strict=True))
    loud = algebra.number(1 / (2 * claimed.mu**2))
    terms = [
        *map(mul, p, claimed.system.flow(e, arithmetic)),
        *(half * e[name] * e[name] for name in claimed.errors),
        *(loud * each * each for each in pushed),
    ]
    if not algebra.is_zero(algebra.read(lhs) - total(terms)):
        raise Unproved("its left side is not that of (38)")


def _second(claimed: ClaimedGain, values: Mapping[str, Any], arithmetic: Arithmetic) -> Matrix:
    """Return the Hessian V_ee (n, n) at the `values` of the errors, in any arithmetic."""
    inner_ = seeded(values, claimed.errors, arithmetic)
    zero = arithmetic.number(Fraction(0))
    (slopes,) = jacobian((claimed.V,), inner_, claimed.errors, dual(arithmetic))
    return Matrix([[slope.slopes.get(j, zero) for j in range(len(slopes))] for slope in slopes])


# --- definite matrices on boxes


def _copies(claimed: ClaimedGain, share: Fraction, reads: Mapping[str, Any]) -> Box:
    box: dict[str, Any] = {}
    for copy, names in reads.items():
        for name in sorted(names):
            low, high = claimed.box[name]
            if name in claimed.around:
                box[f"{copy}.{name}"] = (Fraction(low) * share, Fraction(high) * share)
            else:
                box[name] = (low, high)
    return box


def _definite(claimed: ClaimedGain, T: Matrix, keys: Callable[[ClaimedGain, Box], Matrix]) -> Any:
    """Return a function that attempts to prove on a box that T'M T is positive definite, for the matrix M =
    keys(claimed, box)."""
    basis = T.mapped(_number)

    @lru_cache(maxsize=2)
    def transformed(sides: tuple[tuple[str, tuple[End, End]], ...]) -> Matrix:
        return basis.T @ (keys(claimed, dict(sides)) @ basis)

    def values(box: Box) -> list[list[Interval]]:
        return transformed(tuple(box.items())).mapped(lambda x: x.value).rows

    def varying(box: Box) -> list[list[Dual]]:
        if unbounded(box):
            raise Undefined("an unbounded side")
        return transformed(tuple(box.items())).rows

    return by_mean_value(values, varying, positive)


def _number(value: Fraction) -> Dual:
    return Dual(point(value), {})


def _values(claimed: ClaimedGain, box: Box, copy: str) -> dict[str, Dual]:
    every = seeded(sides(box), box, intervals)
    names = {name: f"{copy}.{name}" if name in claimed.around else name for name in claimed.box}
    return {name: every.get(copied, _number(Fraction(0))) for name, copied in names.items()}


def _hessian(claimed: ClaimedGain, box: Box) -> Matrix:
    return _second(claimed, _values(claimed, box, "c"), _duals)


def _second_order(claimed: ClaimedGain, box: Box) -> Matrix:
    """Return the matrix 2 N(c, d, g) = -(H F_e + F_e'H + H G G'H/mu^2 + I) over a box, H = V_ee at e = c, F_e at e = d,
    G at e = g."""
    n, one, zero = range(len(claimed.errors)), _number(Fraction(1)), _number(Fraction(0))
    H, values = _hessian(claimed, box), seeded(_values(claimed, box, "d"), claimed.errors, _duals)
    rates = [rate.slopes for rate in claimed.system.flow(values, dual(_duals))]
    HF = H @ Matrix([[rate.get(j, zero) for j in n] for rate in rates])
    HG = H @ Matrix(claimed.system.noise(_values(claimed, box, "g"), _duals))
    level_ = _number(1 / claimed.mu**2)

    def entry(i: int, j: int) -> Dual:
        pairs = zip(HG[i], HG[j], strict=True)
        squares = total((zero, *(_duals.power(a, 2) if i == j else a * b for a, b in pairs)))
        value: Dual = -(HF[i][j] + HF[j][i] + level_ * squares + (one if i == j else zero))
        return value

    return Matrix([[entry(i, j) for j in n] for i in n])


_SECOND = ("system", "share", "basis", "slabs")
_ABOUT = "the plant"
RULES = (
    Rule(("dissipation",), ("positive",), is_positive, _SECOND, about=_ABOUT, turning=None),
    Rule(("dissipation",), ("inequality",), inequality, (*_SECOND, "left"), about=_ABOUT, turning=None),
    Rule(("dissipation",), ("level",), level, ("system", "floor"), about=_ABOUT, turning=None),
)
