"""Oracle: filters with innovation gates, sampled, in plain numpy, with a full P.

    z, P      by classical Runge-Kutta, P <- Phi P Phi' + h Q, Phi = I + hF + (hF)^2/2 at the third stage
    gate      of a group, over its finite samples: r = y - h(z), S = H P H' + R/h, d = r' S^-1 r, before corrections
    d > gamma the count rises, and the samples are left out, or corrected with R_jj/h + (d/gamma - 1) S_jj
              after so many in a row: rows and columns of the states read are cleared, P_ii raised until H P H' >= r_j^2
    update    K = P c'/(r + c P c'), one output after the other, h and c at the estimate so far

Bar-Shalom, Li, Kirubarajan (2001). Written apart from the package; imports nothing of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

Array = np.ndarray


@dataclass
class Group:
    """The outputs of a gate; `count`: samples beyond it in a row."""

    outputs: tuple[int, ...]
    probability: float
    accept_after: int = 10
    inflate: bool = False
    count: int = 0


def run(
    f: Callable[[Array], Array],
    F: Callable[[Array], Array],
    h: Callable[[Array], Array],
    H: Callable[[Array], Array],
    reads: Sequence[Sequence[int]],
    noises: tuple[Array, Array],
    start: tuple[Array, Array],
    cap: Array,
    dt: float,
    y: Array,
    groups: Sequence[Group],
) -> tuple[Array, Array]:
    """The estimates (N, n), and 1 where a gate left a sample out (N, p); `reads`: the states of each output."""
    (Q, R), (z, P) = noises, start
    estimates, rejected = [], np.zeros(y.shape, int)
    for k, sample in enumerate(y):
        if k:
            k1 = f(z)
            k2 = f(z + dt / 2 * k1)
            centre = z + dt / 2 * k2
            k3 = f(centre)
            hF = dt * F(centre)
            Phi = np.eye(len(z)) + hF + hF @ hF / 2
            z = z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + dt * k3))
            P = Phi @ P @ Phi.T + dt * Q
        there, r = np.isfinite(sample), R / dt
        innovation, slopes = sample - h(z), H(z)
        admitted, noise, reacquired = there.copy(), r.copy(), []
        for group in groups:
            those = [j for j in group.outputs if there[j]]
            if not those:
                continue
            e, C = innovation[those], slopes[those]
            S = C @ P @ C.T + np.diag(r[those])
            d, gamma = e @ np.linalg.solve(S, e), chi2.ppf(group.probability, len(those))
            if d <= gamma:
                group.count = 0
            elif group.count >= group.accept_after:
                group.count = 0
                reacquired.append(those)
            else:
                group.count += 1
                if group.inflate:
                    noise[those] += (d / gamma - 1) * np.diag(S)
                else:
                    admitted[those] = False
                    rejected[k, those] = 1
        for those in reacquired:
            prior, factors = np.diag(P).copy(), np.ones(len(z))
            for j in those:
                spread = sum(slopes[j, i] ** 2 * prior[i] for i in reads[j])
                for i in reads[j]:
                    factors[i] = max(factors[i], innovation[j] ** 2 / spread)
            for i in {i for j in those for i in reads[j]}:
                P[i, :] = P[:, i] = 0
                P[i, i] = min(prior[i] * factors[i], max(cap[i], prior[i]))
        for j in np.flatnonzero(admitted):
            c = H(z)[j]
            PC = P @ c
            K = PC / (noise[j] + c @ PC)
            z = z + K * (sample[j] - h(z)[j])
            P = P - np.outer(K, PC)
        estimates.append(z)
    return np.array(estimates), rejected
