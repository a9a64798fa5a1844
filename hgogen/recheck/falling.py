"""That a norm falls whatever the slopes of an inclusion: V = e'P e, V' <= -alpha V for e' = (M + G diag(d) H) e.

M is affine in each |d_j| <= 1, so that the corners stand for all, where there are no multipliers (`inequality`). A
slope without an end enters M by that which it has; what is beyond, -onto d reads e, d >= 0, takes from V' where P
onto = lambda reads', lambda >= 0.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

from .box import NotShown
from .chain import CARRIED, built, jacobian_bound
from .context import Context, Shown, is_above, on, short
from .file import Claim, Observer, above_zero, matrix, scalar, signless
from .inequality import FLOW, NOW, Parts, demand_falls, demand_negative
from .matrix import Matrix, demand_positive, plus, scaled, times, twice
from .rule import STEEP, STRUCTURE, Keys, Rule, of_observer, on_chains

# V' <= -alpha V at a theta, by the claim's V, whatever the slopes that the second evidence bounds; in how many boxes
Falls = Callable[[Context, Claim, Mapping[str, Any], Fraction, Fraction], int]
WORK = 2**16  # corners times fields^3


def demand_decays(parts: Parts, alpha: Fraction, evidence: Mapping[str, Any]) -> None:
    """V' <= -alpha V by the evidence's P, and its S where it has one. Raises: `NotShown`."""
    n, m = len(parts.M), len(parts.H)
    P = matrix(evidence, "P", n, n)
    for onto, reads in parts.endless:  # P onto is what is read times a number >= 0: V' loses by a slope of any size
        (pushed,) = times([onto], P)
        share = sum(x * y for x, y in zip(pushed, reads, strict=True)) / sum(x * x for x in reads)
        if share < 0 or pushed != [share * x for x in reads]:
            raise NotShown("a slope without an end is not shown to take from V")
    if "S" in evidence:
        demand_falls(parts, FLOW, NOW, alpha, evidence)
        return
    demand_positive({"P": P})
    if 2**m * n**3 > WORK:
        raise NotShown("it has no S, and more corners of its slopes than are tried one by one")
    for corner in corners_of(parts):
        demand_negative("its inequality", plus(twice(P, corner), scaled(alpha, P)))


def corners_of(parts: Parts) -> Iterator[Matrix]:
    """M + G diag(d) H at all corners of the slopes."""
    for d in product((-1, 1), repeat=len(parts.H)):
        signed = [[x * sign for x, sign in zip(row, d, strict=True)] for row in parts.G]
        yield plus(parts.M, times(signed, parts.H)) if d else parts.M


@dataclass(frozen=True)
class Decay:
    """Decay of an observer's error at every gain from a least one on: how it `falls`, the name and the value of the
    least `gain` that an observer has, and what is `said` of its error at every gain above a bound."""

    falls: Falls
    gain: Callable[[Observer], tuple[str, Fraction]] = lambda observer: ("theta", scalar(observer.numbers, "theta"))
    said: Callable[[Observer], str] = lambda observer: "the error converges exponentially for every theta above {}"

    def converges(self, context: Context, claim: Claim) -> Shown:
        """The bound above which every gain converges, by a V of the claim; the structure of the form is another."""
        observer, least = built(context, claim), above_zero(claim.evidence, "least")
        boxes = self.falls(context, claim, claim.evidence, least, Fraction(0))
        said = self.said(observer).format(short(least, 1))
        return Shown(f"in continuous time, without noise, {said}{on(context.form.box)}", boxes)

    def chosen(self, context: Context, claim: Claim) -> Shown:
        """The observer's gain is above that bound; V falls there, where the claim says at which rate."""
        (name, chosen), bound = self.gain(built(context, claim)), context.file.claim(f"{claim.maker}.convergence")
        if bound is None or not chosen > scalar(bound.evidence, "least"):
            raise NotShown(f"{name} = {short(chosen)} is not above the bound")
        known = f"{name} = {is_above(chosen, scalar(bound.evidence, 'least'))}"
        if not claim.evidence:
            return Shown(known)
        alpha = signless(claim.evidence, "alpha")
        boxes = self.falls(context, claim, bound.evidence, chosen, alpha)
        return Shown(f"{known}, where V' <= -{short(alpha, -1)} V", boxes)


def decays(makers: Keys, decay: Decay, slopes: Keys, norm: Keys) -> tuple[Rule, Rule]:
    """The rules that observers on a form in chains decay: the evidence of their `slopes`, and of a V, its `norm`."""
    return (
        on_chains(makers, ("convergence",), decay.converges, (*slopes, "least", *norm)),
        on_chains(makers, ("theta",), decay.chosen, ("alpha", *norm), "{maker}.convergence"),
    )


def clamped(makers: Keys) -> Rule:
    """The rule of |db/dz| <= bound on the whole box of z of a form in other coordinates, to which observers clamp the
    argument of b."""

    def steep(context: Context, claim: Claim) -> Shown:
        return jacobian_bound(context, claim, context.form.b, "db/dz")

    return of_observer(makers, ("lipschitz",), steep, STEEP, STRUCTURE, kinds=CARRIED)
