"""How inputs drive an error that keeps to a linear inclusion, in continuous time, by one V = e'P e.

    e' = M e + B v + G diag(d) (H e + E v),   |d_j| <= 1,   z = C e

    [M'P + P M + alpha P + H'S H + C'C, P G, P B; G'P, -S, 0; B'P, 0, -diag(lambda)] < 0,   S, lambda >= 0

At alpha = 0 and lambda_k <= mu^2 the L2 norm of z is at most mu times that of v, beside what the start leaves: the
bounded real lemma with a multiplier for each slope (Boyd, El Ghaoui, Feron, Balakrishnan, "Linear Matrix Inequalities
in System and Control Theory", SIAM (1994), 6.3.2). Without C'C, and with sum lambda_k <= alpha, the inputs |v_k| <= 1
keep V <= 1 (`under_inputs`). Of several systems the same P, S and lambda serve them all, and all between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import fmpq_mat

from hgogen.algebra.definite import fraction, positive, root
from hgogen.guarantees.inclusion import Uncertain
from hgogen.guarantees.inequality import Inputs, flow
from hgogen.guarantees.quadratic import Array, Quadratic, Seen, Weights, even, floats, identity, on_grid
from hgogen.guarantees.semidefinite import cheapest

_WHAT = "a bound of an L2 gain"
_MARGINS = (1e-7, 1e-6, 1e-5, 1e-4)  # by which a form is negative, so that it is when it is rounded
_BITS = 44  # after the point, where the trace of P is 1
_TIMES = np.append(0.0, np.logspace(-4, 4, 400))  # of the speed of the error, at which its response is looked at


@dataclass(frozen=True, eq=False)
class Driven:
    """What the error obeys, `e`, with inputs v (q), and what is counted of it, `C` (r, N); of FLINT's rationals."""

    e: Uncertain
    C: Array

    def form(self, alpha: Fraction = Fraction(0)) -> Quadratic:
        """The form but for C'C; the lambda are the last q of its multipliers."""
        return flow(self.e).driven(alpha, Inputs(self.e.B, self.e.E))

    @property
    def counted(self) -> Array:
        """C'C, as large as the form."""
        size, square = len(self.e.M) + len(self.e.H) + self.e.B.shape[1], self.C.T @ self.C
        whole = 0 * identity(size)
        whole[: len(square), : len(square)] = square
        return whole

    @property
    def seen(self) -> float:
        """The largest response of z to v where each slope is at its middle, at the frequencies that are tried."""
        M, B, C = map(floats, (self.e.M, self.e.B, self.C))
        at = 1j * _TIMES[:, None, None] * np.linalg.norm(M, 2) * np.eye(len(M))
        return float(
            np.linalg.norm(C @ np.linalg.solve(at - M, np.broadcast_to(B, (len(at), *B.shape))), 2, (1, 2)).max()
        )


@dataclass(frozen=True)
class L2Bound:
    """A proof that the L2 gain is at most `mu`: by the `weights`, of which the last of S are the lambda."""

    weights: Weights
    mu: Fraction


def l2_bound(each: Sequence[Driven], W: Array, growing: Array | None = None) -> L2Bound | None:
    """A small bound of the L2 gain that all of the systems have; None where none is proved. `W` (N, N): coordinates x,
    e = W x, in which P is expected to be near the unit matrix; `growing` (N, N), of rationals: D of a term -r D e, r >=
    0 of any size, so that D'P + P D >= 0 is asked for.

    Raises: `NoSolver`.
    """
    forms, q = [one.form() for one in each], each[0].e.B.shape[1]
    of, k = forms[0].floats, len(forms[0].Q)
    back, most = np.linalg.inv(W), max(one.seen for one in each)
    fastest = max(np.linalg.norm(back @ floats(one.e.M) @ W, 2) for one in each)
    scale = max(np.linalg.norm(floats(one.C) @ W, 2) for one in each) ** 2 / fastest  # of P, which is then near 1
    g = np.append(even(of, W)[: k - q], [np.sqrt(scale) / most] * q)  # so that mu is near 1
    view = Seen([form.floats for form in forms], W, g)
    n, others = len(W), list[Quadratic]()
    if growing is not None:
        others = [Quadratic(((np.eye(n), -back @ floats(growing) @ W),), np.zeros((k, n)), np.zeros((k, n)))]
    rewards = []
    for one, form in zip(each, forms, strict=True):
        reward = np.zeros((form.size, form.size))
        reward[:n, :n] = (floats(one.C) @ W).T @ (floats(one.C) @ W) / scale
        rewards.append(reward)
    for by in _MARGINS:
        candidate = cheapest(view.forms, rewards, q, by, _WHAT, others)
        if candidate is None:
            continue
        P, S = view.back(*candidate)
        bits = max(0, _BITS - int(np.floor(np.log2(np.trace(P * scale)))))
        exactly = on_grid(P * scale, bits), on_grid(S * scale, bits)
        if _verified(each, forms, *exactly, growing):
            return L2Bound(Weights.of(*exactly), root(fraction(max(exactly[1][-q:].tolist()))))
    return None


def _verified(each: Sequence[Driven], forms: Sequence[Quadratic], P: Array, S: Array, growing: Array | None) -> bool:
    """Whether the inequality holds for all, in exact arithmetic."""
    if any(value < 0 for value in S) or not positive(fmpq_mat(P.tolist())):
        return False
    if growing is not None:
        half = P @ growing
        if not positive(fmpq_mat((half + half.T).tolist())):
            return False
    values = ((one.counted + form.value(P, S)) for one, form in zip(each, forms, strict=True))
    return all(positive(fmpq_mat((-value).tolist())) for value in values)
