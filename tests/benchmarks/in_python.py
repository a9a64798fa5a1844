"""The same filter in Python, a sample at a time: microseconds a sample, of hgogen and of what else there is.

`same`: the mathematics is the same, so that the estimates agree to rounding; the others integrate, or linearise,
otherwise, and agree to what that leaves.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise

import casadi as ca
import mathematics
import numpy as np
from cases import Case
from peers import Missing, casadi_function, start
from scipy.integrate import solve_ivp

RECORDS = 256  # at once
CLOSE, ROUGH = 1e-12, 2e-2  # of the largest estimate
Run = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rival:
    """A way to run a filter over rows (N, m + p), which gives the estimates (N, n) from the second row on; over so many
    `records` of them at once, of which it gives those of the first."""

    make: Callable[[Case], Run]
    samples: int
    same: bool = True
    records: int = 1


def hgogen_run(case: Case) -> Run:
    """`step.run` on the whole record, in C."""
    m = len(case.inputs)

    def run(rows: np.ndarray) -> np.ndarray:
        case.step.reset()
        return case.step.run(u=rows[:, :m], y=rows[:, m:], engine="c").x[1:]

    return run


def hgogen_many(case: Case) -> Run:
    """`step.run_many` on one core."""
    m = len(case.inputs)

    def run(rows: np.ndarray) -> np.ndarray:
        case.step.reset()
        u, y = (np.broadcast_to(each, (RECORDS, *each.shape)) for each in (rows[:, :m], rows[:, m:]))
        return case.step.run_many(u=u, y=y, jobs=1, engine="c").x[0, 1:]

    return run


def hgogen_calls(case: Case) -> Run:
    """A call of the step for each sample, as in a loop that controls."""
    m = len(case.inputs)

    def run(rows: np.ndarray) -> np.ndarray:
        case.step.reset()
        return np.array([case.step(row[:m], row[m:]).x for row in rows])[1:]

    return run


def casadi_calls(case: Case) -> Run:
    """A call of a CasADi function for each sample."""
    function = casadi_function(case)

    def run(rows: np.ndarray) -> np.ndarray:
        w, ends = ca.DM(start(case)), []
        for before, row in pairwise(rows):
            w = function(w, before, row)
            ends.append(w[: case.n])
        return np.array(ends)[:, :, 0]

    return run


def casadi_mapaccum(case: Case) -> Run:
    """CasADi's loop over the record."""
    function, loops = casadi_function(case), {}

    def run(rows: np.ndarray) -> np.ndarray:
        N = len(rows) - 1
        loop = loops.setdefault(N, function.mapaccum(N))
        return np.array(loop(start(case), rows[:-1].T, rows[1:].T))[: case.n].T

    return run


def filterpy(case: Case) -> Run:
    """FilterPy's extended Kalman filter, with the model and its Jacobian as functions of Python."""
    if find_spec("filterpy") is None:
        raise Missing("filterpy is not installed")
    if case.method != "continuous_discrete":
        raise Missing("it corrects at samples")
    from filterpy.kalman import ExtendedKalmanFilter

    n, m, h = case.n, len(case.inputs), case.step.dt
    model = mathematics.model(case, math)

    def run(rows: np.ndarray) -> np.ndarray:
        w = np.array(start(case))
        filter_ = ExtendedKalmanFilter(dim_x=n, dim_z=len(case.R))
        filter_.x, filter_.Q, filter_.R = w[:n], h * np.diag(case.Q), np.diag(case.R) / h
        filter_.P = np.array(mathematics.symmetric(w[n:].tolist(), n))
        ends = []
        for before, row in pairwise(rows.tolist()):
            at = [mathematics.line(before[:m], row[:m], part) for part in (0.0, 0.5, 1.0)]
            z, third = mathematics.runge_kutta(
                lambda v, c, at=at: model.flow(v, at[round(2 * c)]), filter_.x.tolist(), h
            )
            G = h * np.array([[e or 0.0 for e in line] for line in model.jacobian(third, at[1])])
            filter_.F = np.eye(n) + G + G @ G / 2
            filter_.predict_x = lambda u=0, z=z: setattr(filter_, "x", np.array(z))
            filter_.predict()
            slope = lambda x, u=row[:m]: np.array([[e or 0.0 for e in line] for line in model.slope(x.tolist(), u)])  # noqa: E731
            read = lambda x, u=row[:m]: np.array(model.output(x.tolist(), u))  # noqa: E731
            filter_.update(np.array(row[m:]), slope, read)
            ends.append(filter_.x)
        return np.array(ends)

    return run


def do_mpc(case: Case) -> Run:
    """do-mpc's extended Kalman filter on the model by one Runge-Kutta step."""
    if find_spec("do_mpc") is None:
        raise Missing("do_mpc is not installed")
    if case.method != "continuous_discrete":
        raise Missing("it corrects at samples")
    from do_mpc.estimator import EKF
    from do_mpc.model import Model

    n, m, h = case.n, len(case.inputs), case.step.dt
    known, model = Model("discrete"), mathematics.model(case, ca)
    x = [known.set_variable("_x", f"x{i}") for i in range(n)]
    u0, u1 = ([known.set_variable("_u", f"{name}{i}") for i in range(m)] for name in ("before", "now"))
    z, _ = mathematics.runge_kutta(lambda v, c: model.flow(v, mathematics.line(u0, u1, c)), x, h)
    for i, e in enumerate(z):
        known.set_rhs(f"x{i}", e)
    for j, e in enumerate(model.output(x, u1)):
        known.set_meas(f"y{j}", e, meas_noise=True)
    known.setup()
    Q, R = h * np.diag(case.Q), np.diag(case.R) / h

    def run(rows: np.ndarray) -> np.ndarray:
        w = np.array(start(case))
        filter_ = EKF(known)
        filter_.settings.t_step = h
        filter_.P0 = np.array(mathematics.symmetric(w[n:].tolist(), n))
        filter_.setup()
        filter_.x0 = w[:n]
        filter_.set_initial_guess()
        ends = []
        for before, row in pairwise(rows):
            inputs = np.concatenate([before[:m], row[:m]])[:, None]
            ends.append(filter_.make_step(row[m:, None], inputs, Q, R)[:, 0])
        return np.array(ends)

    return run


def scipy(case: Case) -> Run:
    """SciPy's `solve_ivp` from sample to sample, on z and P."""
    if case.method != "rk4_covariance":
        raise Missing("what it integrates is the filter that integrates with the measurement")
    n, h, model = case.n, case.step.dt, mathematics.model(case, math)
    rate = mathematics.rate(case, model)

    def run(rows: np.ndarray) -> np.ndarray:
        w, ends = start(case), []
        for before, row in pairwise(rows.tolist()):
            line = lambda t, v, a=before, b=row: rate(v.tolist(), mathematics.line(a, b, t / h))  # noqa: E731
            w = solve_ivp(line, (0.0, h), w, rtol=1e-6, atol=1e-9).y[:, -1]
            ends.append(w[:n])
        return np.array(ends)

    return run


RIVALS: Mapping[str, Rival] = {
    "hgogen run": Rival(hgogen_run, 1200),
    "hgogen run_many": Rival(hgogen_many, 1200, records=RECORDS),
    "hgogen calls": Rival(hgogen_calls, 1200),
    "casadi mapaccum": Rival(casadi_mapaccum, 1200),
    "casadi calls": Rival(casadi_calls, 1200),
    "filterpy": Rival(filterpy, 300),
    "do-mpc": Rival(do_mpc, 300, same=False),
    "scipy": Rival(scipy, 100, same=False),
}


def microseconds(case: Case, repeats: int) -> Iterator[tuple[str, list[float] | str]]:
    """Of a sample by each rival, all of them in turn `repeats` times; or why there is none.

    Raises: `Differs`.
    """
    runs: dict[str, Run] = {}
    times: dict[str, list[float]] = {}
    for name, rival in RIVALS.items():
        try:
            runs[name] = rival.make(case)
        except Missing as error:
            yield name, str(error)
            continue
        rows = case.quiet[: rival.samples]
        demand_agreement(name, runs[name](rows), hgogen_run(case)(rows), CLOSE if rival.same else ROUGH)
    for _ in range(repeats):
        for name, run in runs.items():
            rival = RIVALS[name]
            rows = case.quiet[: rival.samples]
            begin = time.perf_counter()
            run(rows)
            times.setdefault(name, []).append((time.perf_counter() - begin) / (len(rows) * rival.records) * 1e6)
    yield from times.items()


class Differs(AssertionError):
    """Estimates that are not those of the step."""


def demand_agreement(name: str, estimates: np.ndarray, ours: np.ndarray, tolerance: float) -> None:
    """Raise `Differs` where estimates differ by more, of the largest."""
    off = float(np.abs(estimates - ours).max() / np.abs(ours).max())
    if not off <= tolerance:
        raise Differs(f"{name} differs from the step by {off:.2g} of the largest estimate, more than {tolerance:g}")
