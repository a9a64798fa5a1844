"""The Hamilton-Jacobi inequality of an error system, verified again: its L2 gain mu from w to e while e is in a box.

    e' = F(e, x) + G(e, x) w:   V(0) = 0, V(e) > 0,   S(e, x) = V_e F + |V_e G|^2/(2 mu^2) + |e|^2/2 < 0,   e not 0

With V_e(0) = 0, F(0, x) = 0 both V_e and F are averages of their slopes between 0 and e, so that S <= -e'N e and
V = e'H e/2, N and H averages of H(c) and

    N(c, d, g) = -(H(c) F_e(d) + F_e(d)'H(c) + H(c) G(g) G(g)'H(c)/mu^2 + I)/2,   H = V_ee

over c, d, g in any box around 0 that holds e. They are positive definite on a `share` of the box of errors, by
bisection; on the slabs that this leaves S and V keep off 0. A set {V <= c} keeps off the faces of the box where V is
above c on them: of V = e'P e, where P - c/end_i^2 on its place (i, i) has no negative eigenvalue. The system is that
of the file's plant (`error`, `observed`); a claim tells the observer, V and mu. Source: Alessandri, Mathematical
Problems in Engineering (2020), theorem 1, (21), (38), (39).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ..algebra import Quotient
from ..arithmetic import Dual, Undefined, dual, evaluate
from ..box import Box, NotShown, Try, centre_of, covered, ranged, sides
from ..context import Context, Shown, algebra_of, cut, letters_of, narrowed, on, short, value_of
from ..error import PARTS as ERROR_PARTS
from ..error import ErrorSystem, error_system, smooth
from ..file import Claim, part
from ..interval import intersection, intervals, point
from ..matrix import Matrix, above_zero, demand_nonnegative, entries, matrix, scalar
from ..observed import PARTS as OBSERVED_PARTS
from ..observed import ObservedSystem, observed_system
from ..rule import Rule
from ..slope import mean_value, positive, weights
from ..text import Expression, expression

_MADE: Mapping[tuple[str, ...], Callable[[Context, Mapping[str, Any]], "System"]] = {
    ERROR_PARTS: error_system,
    OBSERVED_PARTS: observed_system,
}
System = ErrorSystem | ObservedSystem
_OF_ALL = ("V", "mu")
_duals = dual(intervals)  # slopes in the names of a box
_seconds = dual(_duals)
_thirds = dual(_seconds)


@dataclass(frozen=True)
class Told:
    """The error system with V and mu, as a claim tells them."""

    system: System
    V: Expression
    mu: Fraction

    @property
    def errors(self) -> tuple[str, ...]:
        """The names of the errors."""
        return self.system.errors

    @property
    def around(self) -> Box:
        """The box of the errors."""
        return self.system.around

    @property
    def box(self) -> Box:
        """The box of all names."""
        return self.system.box

    def shown(self, sentence: str, boxes: int) -> Shown:
        """What was shown of it."""
        return Shown(f"{sentence}; of the error {self.system.sentence}", boxes)


def is_positive(context: Context, claim: Claim) -> Shown:
    """V(0) = 0 and V(e) > 0 for every other e of the box."""
    told = _told(context, claim)
    share, T = _share(claim, told)
    boxes = covered(_copies(told, share, {"c": told.V.names}), ".", _definite(told, T, _hessian))
    for slab, tree, bound in _slabs(claim, told, share):
        if bound <= 0:
            raise NotShown("V is not kept above zero on a slab")
        boxes += covered(narrowed(slab, told.V.names), tree, ranged(told.V, bound, math.inf))
    return told.shown(f"V = {cut(told.V.text)} > 0 for every e but 0{on(told.around)}", boxes)


def inequality(context: Context, claim: Claim) -> Shown:
    """S(e, x) < 0 for every e of the box but 0, and every x."""
    told = _told(context, claim)
    share, T = _share(claim, told)
    reads = {"c": told.V.names, "d": told.system.read_by_flow, "g": told.system.read_by_noise}
    boxes = covered(_copies(told, share, reads), ".", _definite(told, T, _second_order))
    slabs = list(_slabs(claim, told, share))
    if slabs:
        left = expression(part(claim.evidence, "left", str), told.box)
        _left(told, left)
        for slab, tree, bound in slabs:
            if bound >= 0:
                raise NotShown("the left side is not kept below zero on a slab")
            boxes += covered(narrowed(slab, left.names), tree, ranged(left, -math.inf, bound))
    return told.shown(f"inequality (38) holds with V = {cut(told.V.text)}, mu = {short(told.mu)}{on(told.box)}", boxes)


def level(context: Context, claim: Claim) -> Shown:
    """Every set {V <= c} with c below the claim's keeps off the faces of the box."""
    told, floor = _told(context, claim), above_zero(claim.evidence, "floor")
    faces = [(i, end) for i, name in enumerate(told.errors) for end in _ends(told, name)]
    P, boxes = _quadratic(told), 0
    if P is not None:
        for i, end in faces:
            left = [list(entries_) for entries_ in P]
            left[i][i] -= floor / end**2
            demand_nonnegative({f"P - {short(floor)}/{short(end)}^2 on its place ({i + 1}, {i + 1})": left})
    else:
        for i, end in faces:
            face = narrowed({**told.around, told.errors[i]: (end, end)}, told.V.names)
            boxes += covered(face, ".", ranged(told.V, floor, math.inf))
    faced = f"every {{V <= c}} of V = {cut(told.V.text)} with c < {short(floor, -1)} keeps off the faces of the box"
    return told.shown(f"{faced}{on(told.around)}", boxes)


# --- the claim's system


def _told(context: Context, claim: Claim) -> Told:
    """The system with V and V_e zero at e = 0, all smooth; the claims of one file are about one system."""
    told = part(claim.evidence, "system", dict)
    own = next((made for made in _MADE if told.keys() == {*made, *_OF_ALL}), None)
    if own is None:
        raise NotShown("its system has not the parts " + ", or ".join(", ".join((*made, *_OF_ALL)) for made in _MADE))
    for other in context.file.claims:
        if other.maker == claim.maker and other.evidence.get("system", told) != told:
            raise NotShown(f"it is about another system than {other.id}")
    system = _MADE[own](context, told)
    found = Told(system, expression(told["V"], system.around), above_zero(told, "mu"))
    _vanishing(found)
    return found


def _vanishing(told: Told) -> None:
    """V(0) = 0, V_e(0) = 0 by exact algebra; V without kinks, and finite slopes on the whole box."""
    algebra = algebra_of(told.around)
    zero, one = algebra.number(Fraction(0)), algebra.number(Fraction(1))
    smooth((told.V,))
    if not algebra.is_zero(value_of(told.V, dict.fromkeys(told.errors, zero), algebra)):
        raise NotShown(f"{cut(told.V.text)} is not shown to vanish at e = 0")
    moving = {name: Dual(zero, {i: one}) for i, name in enumerate(told.errors)}
    slopes = evaluate(told.V, moving, dual(algebra.arithmetic)).slopes
    if not all(algebra.is_zero(slope) for slope in slopes.values()):
        raise NotShown("dV/de is not shown to vanish at e = 0")
    covered(narrowed(told.box, told.system.read_by_flow | told.system.read_by_noise), ".", _regular(told.system))
    covered(narrowed(told.around, told.V.names), ".", _smooth(told))


def _regular(system: System) -> Any:
    """The statement that F has finite slopes in e, and that G is finite."""
    one = point(Fraction(1))

    def attempt(box: Box) -> Try:
        at = {**dict.fromkeys(system.box, point(Fraction(0))), **sides(box)}  # what is not read may be anything
        moving = {
            name: Dual(side, {system.errors.index(name): one} if name in system.around else {})
            for name, side in at.items()
        }
        try:
            rates, noise = system.flow(moving, _duals), system.noise(at, intervals)
        except Undefined:
            return Try(False)
        slopes = (x for rate in rates for x in rate.slopes.values())
        return Try(all(x.finite for x in (*slopes, *(x for row in noise for x in row))))

    return attempt


def _smooth(told: Told) -> Any:
    """The statement that V has finite second derivatives."""

    def attempt(box: Box) -> Try:
        try:
            return Try(
                all(x.value.finite for row in _hessian(told, {f"c.{k}": v for k, v in box.items()}) for x in row)
            )
        except Undefined:
            return Try(False)

    return attempt


def _text(tree: Any) -> str:
    if not isinstance(tree, str):
        raise NotShown("a bisection is no text")
    return tree


def _ends(told: Told, name: str) -> tuple[Fraction, Fraction]:
    """The finite range of an error."""
    low, high = told.around[name]
    return Fraction(low), Fraction(high)


def _share(claim: Claim, told: Told) -> tuple[Fraction, Matrix]:
    share, n = above_zero(claim.evidence, "share"), len(told.errors)
    if share > 1:
        raise NotShown("its share is above 1")
    return share, matrix(claim.evidence, "basis", n, n)


def _slabs(claim: Claim, told: Told, share: Fraction) -> Iterator[tuple[Box, str, Fraction]]:
    """What the share of the box leaves, slab by slab, each with its bisection and bound."""
    given = entries(claim.evidence, "slabs", 0 if share == 1 else 2 * len(told.errors))
    inner = dict(told.around)
    for k, name in enumerate(told.errors if given else ()):
        low, high = _ends(told, name)
        for side, slab in enumerate(((low, low * share), (high * share, high))):
            found = given[2 * k + side]
            if not isinstance(found, Mapping) or found.keys() != {"tree", "bound"}:
                raise NotShown("a slab has not a tree and a bound")
            yield {**told.box, **inner, name: slab}, _text(found["tree"]), scalar(found, "bound")
        inner[name] = (low * share, high * share)


def _left(told: Told, left: Expression) -> None:
    """That a text is S."""
    algebra = algebra_of(told.box)
    letters, one = letters_of(algebra, told.box), algebra.number(Fraction(1))
    moving = {name: Dual(letters[name], {i: one}) for i, name in enumerate(told.errors)}
    slopes = evaluate(told.V, moving, dual(algebra.arithmetic)).slopes
    zero, half = algebra.number(Fraction(0)), algebra.number(Fraction(1, 2))
    p = [slopes.get(i, zero) for i in range(len(told.errors))]
    total: Quotient = zero
    for slope, rate, name in zip(p, told.system.flow(letters, algebra.arithmetic), told.errors, strict=True):
        total = total + slope * rate + half * letters[name] * letters[name]
    noise = told.system.noise(letters, algebra.arithmetic)
    for k in range(len(noise[0])):
        pushed = zero
        for slope, cells in zip(p, noise, strict=True):
            pushed = pushed + slope * cells[k]
        total = total + algebra.number(1 / (2 * told.mu**2)) * pushed * pushed
    if not algebra.is_zero(value_of(left, letters, algebra) - total):
        raise NotShown("its left side is not that of (38)")


def _quadratic(told: Told) -> Matrix | None:
    """P of V = e'P e; None where V is another function."""
    algebra, n = algebra_of(told.around), range(len(told.errors))
    letters = letters_of(algebra, told.around)
    one, zero = algebra.number(Fraction(1)), algebra.number(Fraction(0))
    inner = [Dual(letters[name], {i: one}) for i, name in enumerate(told.errors)]
    moving = {name: Dual(inner[i], {i: Dual(one, {})}) for i, name in enumerate(told.errors)}
    slopes = evaluate(told.V, moving, dual(dual(algebra.arithmetic))).slopes
    half = algebra.number(Fraction(1, 2))
    H = [[half * slopes.get(i, Dual(zero, {})).slopes.get(j, zero) for j in n] for i in n]
    numbers = [[entry.number for entry in row] for row in H]
    found = [[value for value in row if value is not None] for row in numbers]
    return found if all(len(row) == len(n) for row in found) else None


# --- definite matrices on boxes


def _copies(told: Told, share: Fraction, reads: Mapping[str, Any]) -> Box:
    """The box of the copies c, d, g of the errors, a share of their box, and of the signals that are read."""
    box: dict[str, Any] = {}
    for copy, names in reads.items():
        for name in sorted(names):
            low, high = told.box[name]
            if name in told.around:
                box[f"{copy}.{name}"] = (Fraction(low) * share, Fraction(high) * share)
            else:
                box[name] = (low, high)
    return box


def _definite(told: Told, T: Matrix, made: Any) -> Any:
    """The statement that T'M T is positive definite, M of `made`."""

    def moved(box: Box) -> list[list[Dual]]:
        M, n = made(told, box), range(len(T))
        MT = [[_sum(M[i][k] * _number(T[k][j]) for k in n) for j in n] for i in n]
        return [[_sum(_number(T[k][i]) * MT[k][j] for k in n) for j in n] for i in n]

    def attempt(box: Box) -> Try:
        try:
            varying = moved(box)
        except Undefined:
            return Try(False)
        if positive([[x.value for x in row] for row in varying]):
            return Try(True)
        if any(math.inf in (abs(low), abs(high)) for low, high in box.values()):
            return Try(False)
        centre = centre_of(box)
        away = {k: side - point(Fraction(centre[name][0])) for k, (name, side) in enumerate(sides(box).items())}
        tight = [
            [intersection(x.value, mean_value(at.value, x.slopes, away)) for x, at in zip(*rows, strict=True)]
            for rows in zip(varying, moved(centre), strict=True)
        ]
        return Try(positive(tight), weights([x for row in varying for x in row]))

    return attempt


def _number(value: Fraction) -> Dual:
    return Dual(point(value), {})


def _sum(terms: Any) -> Dual:
    total = _number(Fraction(0))
    for term in terms:
        total = total + term
    return total


def _values(told: Told, box: Box, copy: str) -> dict[str, Dual]:
    """A copy's values of the errors, and the signals, each with its slope in the names of the box."""
    one = point(Fraction(1))
    every = {name: Dual(side, {k: one}) for k, (name, side) in enumerate(sides(box).items())}
    return {
        name: every.get(f"{copy}.{name}" if name in told.around else name, _number(Fraction(0))) for name in told.box
    }


def _hessian(told: Told, box: Box) -> list[list[Dual]]:
    """H(c)."""
    n, values, one = range(len(told.errors)), _values(told, box, "c"), _number(Fraction(1))
    nothing = Dual(_number(Fraction(0)), {})
    inner = {name: Dual(values[name], {i: one}) for i, name in enumerate(told.errors)}
    moving = {name: Dual(inner[name], {i: Dual(one, {})}) for i, name in enumerate(told.errors)}
    slopes = evaluate(told.V, moving, _thirds).slopes
    return [[slopes.get(i, nothing).slopes.get(j, _number(Fraction(0))) for j in n] for i in n]


def _second_order(told: Told, box: Box) -> list[list[Dual]]:
    """2 N(c, d, g)."""
    n, one, zero = range(len(told.errors)), _number(Fraction(1)), _number(Fraction(0))
    H, values = _hessian(told, box), _values(told, box, "d")
    moving = {
        name: Dual(value, {told.errors.index(name): one} if name in told.around else {})
        for name, value in values.items()
    }
    rows = [rate.slopes for rate in told.system.flow(moving, _seconds)]
    G = told.system.noise(_values(told, box, "g"), _duals)
    HF = [[_sum(H[i][k] * rows[k].get(j, zero) for k in n) for j in n] for i in n]
    HG = [[_sum(H[i][k] * G[k][j] for k in n) for j in range(len(G[0]))] for i in n]
    level_ = _number(1 / told.mu**2)

    def entry(i: int, j: int) -> Dual:
        squares = _sum(_duals.power(a, 2) if i == j else a * b for a, b in zip(HG[i], HG[j], strict=True))
        return -(HF[i][j] + HF[j][i] + level_ * squares + (one if i == j else zero))

    return [[entry(i, j) for j in n] for i in n]


_SECOND = ("system", "share", "basis", "slabs")
_ABOUT = "the plant"
RULES = (
    Rule("dissipation", "positive", is_positive, _SECOND, about=_ABOUT),
    Rule("dissipation", "inequality", inequality, (*_SECOND, "left"), about=_ABOUT),
    Rule("dissipation", "level", level, ("system", "floor"), about=_ABOUT),
)
