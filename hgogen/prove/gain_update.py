"""What lets a gain move by L' = L (p_1 (p_2 - L) + p_3 Gamma): inequalities proved in rationals, bounds by intervals.

    N'P + P N <= -I,  N = A - K C,   D = diag(b, .., b + n - 1)
    D P + P D > 0,   N'P + P N + p_1 (D P + P D) < 0,   p_3 (D P + P D) >= 2 lambda_max(P)

and L never passes a cap above p_2 + (p_3/p_1) sup Gamma(cap): there L' < 0. Where they come from: `updated_gain`.
"""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import sympy as sp

from hgogen.analysis.evidence import LOOSE, Grounds, Steep
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.injection import companion
from hgogen.estimators.integrators import Integrators
from hgogen.prove.inclusion import Shown
from hgogen.prove.lmi import Lyapunov, lyapunov
from hgogen.prove.moving import Law, moving_checks
from hgogen.reading.given import BadGain
from hgogen.rigor.bounds import Proof, bound
from hgogen.rigor.box import box
from hgogen.rigor.definite import exact, positive, root
from hgogen.rigor.tape import NoTape
from hgogen.sentence import NONE, Up, because, down, up

BOXES = 500  # sup Gamma need not be the least


def weighted(K: np.ndarray, b: float) -> tuple[Lyapunov, np.ndarray]:
    """P with N'P + P N <= -I, and D P + P D in rationals. Raises: `BadGain` where it is not proved to be positive
    definite."""
    exactly = np.array([Fraction(float(k)) for k in K])
    proof = lyapunov(tuple(map(tuple, companion(exactly))))
    assert proof is not None  # N is Hurwitz
    P, n = np.array(proof.P), len(K)
    spread = _spread(P, [Fraction(b) + i for i in range(n)])
    if not positive(exact(spread)):
        pencil = np.linalg.solve(P.astype(float), _spread(P, [Fraction(i) for i in range(n)]).astype(float))
        least = -np.linalg.eigvals(pencil).real.min() / 2
        raise BadGain(
            f"b = {b:g}", f"leaves D P + P D not positive definite; take b = {up(1.01 * float(least))} or more"
        )
    return proof, spread


def _spread(P: np.ndarray, D: list[Fraction]) -> np.ndarray:
    return np.array([[(D[i] + D[j]) * P[i, j] for j in range(len(D))] for i in range(len(D))])


def checks(
    chain: Integrators, K: np.ndarray, b: float, p_1: float, p_2: float, p_3: float, cap: float
) -> tuple[Check, ...]:
    """`updated_gain.p_1`, `.p_3` and `.cap`, of the gains K (n), and the claims about p_2 alone of `moving`. Raises:
    `BadGain` where D P + P D is not proved to be positive definite."""
    proof, spread = weighted(K, b)
    numbers = {"p_1": p_1, "p_2": p_2, "p_3": p_3, "cap": cap, "gains": K}
    weighted_by = {"P": proof.P, "b": Fraction(b)}
    fall, rise = Shown(None, weighted_by), Shown(None, {**weighted_by, "peak": proof.peak})
    stay = stays(chain, p_1, p_2, p_3, cap)
    each = ((falls(proof, spread, p_1, b), fall), (rises(proof, spread, p_3, b), rise), (stay, *stay.proofs))
    known = (replace(check, proofs=tuple(Grounds(numbers, fact) for fact in facts)) for check, *facts in each)
    moves = Law("p_2", p_2, Fraction(p_1), easing=True, b=Fraction(b))
    return (*known, *moving_checks("updated_gain", chain, [Fraction(k) for k in K.tolist()], moves, numbers))


def falls(proof: Lyapunov, spread: np.ndarray, p_1: float, b: float) -> Check:
    """N'P + P N + p_1 (D P + P D) < 0."""
    P, N = np.array(proof.P), np.array(proof.vertices[0])
    gap = -(N.T @ P + P @ N)
    most = 1 / np.linalg.eigvals(np.linalg.solve(gap.astype(float), spread.astype(float))).real.max()
    claim, fix = "p_1 is small enough: N'P + P N + p_1 (D P + P D) < 0", f"Take p_1 <= {down(0.99 * float(most))}."
    return _positive("p_1", claim, gap - Fraction(p_1) * spread, b, "not {about}; another P or b may do", fix)


def rises(proof: Lyapunov, spread: np.ndarray, p_3: float, b: float) -> Check:
    """p_3 (D P + P D) >= 2 lambda_max(P)."""
    least = 2 * float(proof.peak) / np.linalg.eigvalsh(spread.astype(float))[0]
    claim, fix = "p_3 is large enough: p_3 (D P + P D) >= 2 lambda_max(P)", f"Take p_3 >= {up(1.01 * float(least))}."
    room = Fraction(p_3) * spread - 2 * proof.peak * np.eye(len(spread), dtype=int)
    pattern = "not {about}; another P or b may do, or a gain that stays far above Gamma"
    return _positive("p_3", claim, room, b, pattern, fix)


def _positive(fact: str, claim: str, M: np.ndarray, b: float, pattern: str, fix: str) -> Check:
    """Whether M > 0: said of this P and D, as with another b it is another."""
    about = because("for the P of N'P + P N = -I and D = diag(b, .., b + n - 1), b = {b}", b=float(b))
    id = ClaimId("updated_gain", fact)
    if positive(exact(M)):
        return Check(id, claim, Verdict.PROVED, because("in rational arithmetic, {about}", about=about))
    return Check(id, claim, Verdict.UNKNOWN, because(pattern, about=about), fix=fix)


def stays(chain: Integrators, p_1: float, p_2: float, p_3: float, cap: float) -> Check:
    """p_1 (p_2 - cap) + p_3 Gamma(cap) < 0 at every point of the declared ranges, to which Gamma is clamped."""
    id, claim = (
        ClaimId("updated_gain", "cap"),
        "in continuous time L' < 0 at the cap: p_2 + (p_3/p_1) sup Gamma(cap) < cap",
    )
    form, n = chain.form, chain.n
    unknown = Check(id, claim, Verdict.UNKNOWN, NONE, fix="Raise cap, or watch the status GAIN_LIMITED.")
    if form.behind is not None:
        not_sought = because("c is taken at Psi(z), in the plant's ranges: no bound of its slope was sought there")
        return replace(unknown, reason=not_sought)
    units = tuple(Fraction(cap) ** -(i + 1) for i in range(n))
    scale = tuple(product * sp.Rational(s) for product, s in zip(chain.products, units, strict=True))
    slopes = (scale[i] * form.b[i].diff(form.states[j]) / scale[j] for i in range(n) for j in range(n))
    around = box((*form.states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    try:
        squares = bound(sp.Add(*(slope**2 for slope in slopes)), around, boxes=BOXES)
    except NoTape as missing:
        return replace(unknown, reason=because("{what} may jump or be singular", what=missing.what))
    if not (squares.defined and math.isfinite(squares.high)):
        return replace(unknown, reason=because("no bound of Gamma was found"))
    above = Fraction(p_1) * (Fraction(cap) - Fraction(p_2)) / Fraction(p_3)
    gamma = Up(math.sqrt(max(squares.high, 0.0)) * (1 + 1e-12))
    most = Fraction(max(squares.high, 0.0))
    if above > 0 and above**2 > most:
        steep = Proof(form.b, None, root(most), squares.variables, squares.tree)
        reason = because("Gamma(cap) <= {gamma}, by outward-rounded intervals", gamma=gamma)
        proofs = (Steep(units, scale, steep, LOOSE),)
        return replace(unknown, verdict=Verdict.PROVED, reason=reason, fix="", proofs=proofs)
    return replace(unknown, reason=because("Gamma(cap) may be {gamma}", gamma=gamma))
