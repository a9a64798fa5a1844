"""What an observer claims whose gain l moves: by one norm for every value of l, every rate that its law permits, and
all slopes of b in their ranges.

    e_k = error of w_k over l^(b+k-1):   e'/l = (N - r D + J(l)/l) e,   r = l'/l^2,   D = diag(b, .., b + n - 1)

J(l)/l shrinks as l grows: 0 is in the ranges of its slopes, each over a power of l that is at least 1. With r >= -s,
e'/l at a l >= least is a mean of M_j e, less a share >= 0 of D e, and V = e'P e falls where it does by these:

    adaptive_lmi   s = sigma:                          N + sigma D + J(least)/least
    updated_gain   s = p_1 (1 - p_2/l), p_2 >= least:  N + J(least)/least,   N + p_1 D
                   in the shares least/l, 1 - least/l: l may fall fast only where it is far above p_2

    M_j'P + P M_j + alpha/least P < 0,   D P + P D > 0:   V' <= -alpha l/least V

How fast l rises does not count, nor by which law: nor whether it comes to rest at an upper end. So `updated_gain` needs
no bound of slopes by those at the estimate, as the paper does, but a p_2 that is enough alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.columns import as_matrix
from hgogen.estimators.integrators import Integrators
from hgogen.prove.bounded_theta import Nothing, nothing
from hgogen.prove.common_norm import Flow, Moved
from hgogen.prove.continuous_time import claims
from hgogen.prove.inclusion import Inclusion, on_integrators, plain
from hgogen.prove.quadratic import floats, rational
from hgogen.prove.steepness import companions
from hgogen.rigor.definite import number
from hgogen.sentence import same

_OWN = Fraction(1, 4)  # b of D: the least bounds of two to four states are close to those of the best b
_HOW = "one norm at every rate of the gain"


@dataclass(frozen=True)
class Law:
    """How fast a gain may fall: r >= -`fall`, at its `least` value too; or, `easing`, not at all there, and r >= -fall
    (1 - least/l). `name`: of the least value; `P` (n, n) that may serve, in errors of w, with this `b` of D."""

    name: str
    least: float
    fall: Fraction
    easing: bool
    b: Fraction
    P: np.ndarray | None = None


def moving_checks(
    maker: str, chain: Integrators, K: Sequence[Fraction], law: Law, numbers: dict[str, Any]
) -> tuple[Check, Check]:
    """`MAKER.convergence`, that there is a bound on the least value of the gain; `MAKER.theta`, that it is above it."""
    form = chain.form
    error = on_integrators(chain, plain(form), companions(K, form.blocks), as_matrix(form, K), numbers)
    if isinstance(error, Nothing):
        return _named(law, nothing(maker, law.least, error.reason))
    flows = [_at_b(error, law, b) for b in (_OWN, law.b)]
    try:
        flow = next((flow for flow in flows if flow.least is not None), flows[0])
    except OverflowError:  # which the claims say
        flow = flows[0]
    return _named(law, claims(maker, form, flow, numbers, law.name))


def _at_b(error: Inclusion, law: Law, b: Fraction) -> Flow:
    """The error over powers of the gain, by this b of D."""
    D = rational(np.diag([b + p for p in error.layout.power]))
    fall = D * number(law.fall)
    moved = Moved(0 * D, (error.N + fall,), (-D,)) if law.easing else Moved(fall, (), (-D,))
    first = law.P
    if first is not None:  # in the errors of the inclusion, where it is positive definite
        t = floats(rational([error.units]))[0]
        first = None if np.linalg.eigvalsh(first).min() <= 0 else np.asarray(first / np.outer(t, t))
    return Flow(replace(error, own={**error.own, "b": b}), Fraction(law.least), _HOW, moved, first)


def _named(law: Law, checks: tuple[Check, Check]) -> tuple[Check, Check]:
    """The claims about the gain's least value, by its name."""
    convergence, above = checks
    name, value = law.name, same(law.least)
    exists = f"in continuous time, without noise, the error converges exponentially for every {name} above a bound"
    return (
        replace(convergence, claim=f"{exists}, at every rate of the gain that its law permits"),
        replace(above, claim=f"{name} = {value} is above that bound"),
    )


def proved_above(checks: Sequence[Check], maker: str) -> bool:
    """Whether the least value of the gain is proved to be above its bound."""
    return any(check.id == ClaimId(maker, "theta") and check.verdict is Verdict.PROVED for check in checks)
