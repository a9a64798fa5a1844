"""Oracle: the high-gain extended Kalman filter for several outputs, sampled, in plain numpy, P in full.

    z' = f(z,u),  F = df/dz,  y_i = C_i z
    P  <- Phi P Phi' + h Q_theta,  Phi = I + hF + (hF)^2/2
    z  <- z + K (y_i - C_i z),  K = P C_i'/(R_theta,i/h + C_i P C_i'),  P <- P - K C_i P,  one output after the other
    end   Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)),  Q_theta = theta Delta^-1 Q Delta^-1,
          R_theta = (1/theta) delta R delta,  delta = diag(theta^(n* - n_i))
    top   Delta_i = diag(1, .., theta^-(n_i - 1)),  R_theta = R/theta
    the slides' modified filter:  Q_theta = theta^2 Delta^-1 Q Delta^-1,  R_theta = R  (one output, or delta R delta)

N. Boizot, thesis (2010), chapter 5; E. Busvelle's slides. Written apart from the package; imports nothing of it.
"""

from collections.abc import Callable, Sequence

import numpy as np

Array = np.ndarray


def delta(sizes: Sequence[int], alignment: str, theta: float) -> Array:
    """Delta (n, n)."""
    longest, diagonal = max(sizes), []
    for size in sizes:
        first = longest - size if alignment == "end" else 0
        diagonal += [theta ** -(first + j) for j in range(size)]
    return np.diag(diagonal)


def noises(
    Q: Array, R: Array, sizes: Sequence[int], alignment: str, theta: float, modified: bool
) -> tuple[Array, Array]:
    """Q_theta (n, n) and R_theta (p, p)."""
    inverse = np.linalg.inv(delta(sizes, alignment, theta))
    late = np.diag([theta ** (max(sizes) - size) if alignment == "end" else 1.0 for size in sizes])
    Q_theta, R_theta = theta * inverse @ Q @ inverse, late @ np.diag(R) @ late / theta
    return (theta * Q_theta, theta * R_theta) if modified else (Q_theta, R_theta)


def run(
    f: Callable[[Array, float], Array],
    F: Callable[[Array, float], Array],
    C: Array,
    noise: Callable[[float], tuple[Array, Array]],
    theta: Callable[[int], float],
    P: Array,
    h: float,
    u: Array,
    y: Array,
) -> Array:
    """Estimates (N, n) over u (N,), y (N, p), from z = 0; `theta(k)` is what call k uses."""
    z, estimates = np.zeros(len(P)), []
    for k in range(len(y)):
        Q_theta, R_theta = noise(theta(k))
        if k:
            before, now, middle = u[k - 1], u[k], (u[k - 1] + u[k]) / 2
            k1 = f(z, before)
            k2 = f(z + h / 2 * k1, middle)
            centre = z + h / 2 * k2
            k3 = f(centre, middle)
            hF = h * F(centre, middle)
            Phi = np.eye(len(z)) + hF + hF @ hF / 2
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(z + h * k3, now))
            P = Phi @ P @ Phi.T + h * Q_theta
        for i in range(len(C)):
            PC = P @ C[i]
            K = PC / (R_theta[i, i] / h + C[i] @ PC)
            z = z + K * (y[k, i] - C[i] @ z)
            P = P - np.outer(K, PC)
        estimates.append(z)
    return np.array(estimates)
