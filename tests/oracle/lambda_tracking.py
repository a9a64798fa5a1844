"""The bioreactor (15) of Bullinger, Ilchmann, Allgoewer 1998 and its lambda-tracking observer (2), (4), (5).

Plain numpy and scipy's DOP853, from change to change of the inflow; time in hours.
"""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

START = (0.075, 0.03)  # m(0), s(0)
CHANGES = ((0.0, 0.08), (30.0, 0.02), (50.0, 0.08))  # of the inflow u
P, K_0, GAMMA, STRIP, REACH = (1.0, 0.2), 0.1, 100.0, 0.02, 0.5


def law(e: float) -> float:
    """k'."""
    return GAMMA * min(max(abs(e) - STRIP, 0.0), REACH - STRIP) ** 2


def rate(x: np.ndarray, u: float, noise: float = 0.0) -> np.ndarray:
    """x' of (m, s, xhat_1, xhat_2, k)."""
    m, s, first, second, k = x
    growth, e = m * s / (m + s), m + noise - first
    return np.array([growth - u * m, -growth - u * s + 0.1 * u, second + P[0] * k * e, P[1] * k * k * e, law(e)])


def exact(start: tuple[float, float], until: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and states (N, 5) from xhat(0) = `start`, tolerances 1e-12."""
    times, states = [np.zeros(1)], [np.array([[*START, *start, K_0]])]
    ends = [*(time for time, _ in CHANGES if time < until), until]
    for (begin, end), (_, u) in zip(pairwise(ends), CHANGES, strict=False):
        t = np.linspace(begin, end, round((end - begin) * 1000) + 1)[1:]
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "max_step": 0.1}
        solution = solve_ivp(lambda t, x, u=u: rate(x, u), (begin, end), states[-1][-1], t_eval=t, **options)
        times.append(t)
        states.append(solution.y.T)
    return np.concatenate(times), np.concatenate(states)


def noisy(noise: np.ndarray, dt: float = 0.01) -> np.ndarray:
    """The final k (seeds) with `noise` (seeds, N), each value held over a sample, by Runge-Kutta."""
    x = np.tile(np.array([[*START, 0.0, 0.0, K_0]]).T, len(noise))
    for i in range(noise.shape[1]):
        u = [u for time, u in CHANGES if time <= i * dt + 1e-9][-1]

        def f(x: np.ndarray, n: np.ndarray = noise[:, i], u: float = u) -> np.ndarray:
            m, s, first, second, k = x
            growth, e = m * s / (m + s), m + n - first
            grown = GAMMA * np.clip(np.abs(e) - STRIP, 0.0, REACH - STRIP) ** 2
            return np.array([growth - u * m, -growth - u * s + 0.1 * u, second + P[0] * k * e, P[1] * k * k * e, grown])

        k1 = f(x)
        k2 = f(x + dt / 2 * k1)
        k3 = f(x + dt / 2 * k2)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + dt * k3))
    return np.asarray(x[4])
