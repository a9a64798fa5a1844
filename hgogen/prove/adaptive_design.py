"""Convex programs for an adaptive gain: K and P in floats, rounded, with their proofs.

    minimise gamma = (4 k lambda_max(P) + 1)/(2 lambda)                                                         (88)
    or       mu = sqrt(2 s) gamma^n                                                                             (89)
    over P > 0, Y = P K, lambda, s:   D P + P D >= 0,   |Y| <= largest,
    Phi = A'P + P A - Y C - C'Y' + sigma (D P + P D) + lambda I <= 0,                                           (54)
    and for (89)   Phi + (delta_1 P P + delta_2 Y Y')/s <= 0                                               (85), (87)

in the notation of `varying_gain`. (88) is linear-fractional: one semidefinite program in P/t, Y/t. (89) is one program
at each gamma with 2 lambda gamma >= 4 k lambda_max(P) + 1, and gamma is searched. Source: Alessandri, "On
Hamilton-Jacobi approaches to state reconstruction for dynamic systems" (2020); Boyd, Vandenberghe, "Convex
Optimization", 4.3.2.

Without |Y| <= largest the cone (54) has no bound. `varying_gain` proves the claims about the rounded K and P. The slope
k(gamma) of a form, for every gamma from that one on, decreases as gamma grows, and the bound on gamma with it. k is
taken where the two meet, by bisection: the bound for k(1) can be many times too large (section 4 of the first source).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from hgogen.check import Check, Verdict
from hgogen.errors import HgogenError
from hgogen.estimators.integrators import companion, integrators
from hgogen.form import Form
from hgogen.prove.inclusion import Nothing
from hgogen.prove.quadratic import Array
from hgogen.prove.semidefinite import solve_semidefinite_program, symmetric
from hgogen.prove.varying_gain import Disturbance, candidate, candidate_checks, share_of, steepness
from hgogen.prove.varying_gain import disturbance as as_disturbance
from hgogen.reading.given import BadGain, Misfit, positive, real, reals, requires_form
from hgogen.rigor.definite import demand_hurwitz, root
from hgogen.sentence import down, up

_REACH = 1e3  # the largest gamma that is searched, over the smallest
_STEPS = 12  # points of a grid, and of a finer one inside its best cells


@dataclass(frozen=True)
class Task:
    """The data of a design problem: a gain K (n) and a Lyapunov matrix P (n, n) for the observer `adaptive_lmi`, whose
    high gain gamma varies, on a chain of `n` integrators with a nonlinear part of the Lipschitz constant `slope`.

    `bounds` by name: "sigma", the largest relative rate of decrease of gamma; "largest", an upper bound of |P K|;
    "gamma" and "mu", upper bounds of the least gamma and of the L2 gain, inf for none. `deltas`: delta_1 and delta_2 of
    a disturbance (`Disturbance.deltas`), or None. `K` (n, 1): a fixed gain, for which only P is searched. `margin`: the
    factor m of the constraint D P + P D >= m lambda I, D = diag(1, .., n). `least`: the gamma above which `slope` is
    valid.
    """

    n: int
    slope: float
    bounds: Mapping[str, float]
    deltas: tuple[float, float] | None
    K: np.ndarray | None
    margin: float
    least: float = 1.0

    def bounded(self, name: str, value: float) -> "Task":
        """Return a copy of the task in which the bound `name` of `bounds` has the new `value`."""
        return replace(self, bounds={**self.bounds, name: value})

    def unknown(self, x: Array) -> tuple[Array, Array]:
        """Return P (n, n) and Y = P K (n, 1) from the vector x of variables of the semidefinite program, whose first
        entries they are."""
        p = self.n * (self.n + 1) // 2
        P = symmetric(x[:p], self.n)
        return P, x[p : p + self.n, None] if self.K is None else P @ self.K


@dataclass(frozen=True)
class Optimum:
    """A solution of the design problem, in floats: P (n, n), Y = P K (n, 1), the least sufficient gain `gamma`, and the
    bound `mu` of the L2 gain from the disturbance to the error, inf without a disturbance."""

    P: np.ndarray
    Y: np.ndarray
    gamma: float
    mu: float


def best(task: Task) -> Optimum | None:
    """Return the solution of the design problem with the smallest `gamma`, or with a disturbance the one with the
    smallest L2 gain `mu`, within the bounds of the task; None where the solver finds none. Raises: `NoSolver`."""
    optimum = _optimum(task)
    if optimum is None or optimum.gamma > task.bounds["gamma"]:
        return None
    if task.deltas is None:
        return optimum
    low = max(task.least, optimum.gamma * (1 + 1e-6))
    high = min(task.bounds["gamma"], _REACH * low)
    if low > high:
        return None
    at = partial(_optimum, task)
    grid = np.geomspace(low, high, _STEPS).tolist()
    tried = [at(gamma) for gamma in grid]
    place = int(np.argmin([math.inf if one is None else one.mu for one in tried]))
    inside = np.geomspace(grid[max(place - 1, 0)], grid[min(place + 1, _STEPS - 1)], _STEPS + 1).tolist()
    each = [one for one in (tried[place], *map(at, inside)) if one is not None and one.mu <= task.bounds["mu"]]
    return min(each, key=lambda one: one.mu, default=None)


def _optimum(task: Task, gamma: float | None = None) -> Optimum | None:
    """Return the design with the least gamma (88), by one semidefinite program in P/t, Y/t,
    lambda/t = 1/2; or at a given `gamma` the one with the least mu (89) of Alessandri (2020)."""
    n, p = task.n, task.n * (task.n + 1) // 2
    A, C, D, one = np.diag(np.ones(n - 1), 1), np.eye(1, n), np.diag(np.arange(1.0, n + 1)), np.eye(n)
    largest, free = task.bounds["largest"], 0 if task.K is not None else n

    def blocks(x: Array) -> list[Array]:
        """Return the matrices that must be >= 0: (54), D P + P
        D, peak I - P, |Y| <= largest; for (89) also (87)."""
        (P, Y), (peak, decay, last) = task.unknown(x), (x[-2], 0.5, x[-1]) if gamma is None else x[-3:]
        turned, scale = D @ P + P @ D, last if gamma is None else 1.0
        phi = A.T @ P + P @ A - Y @ C - C.T @ Y.T + task.bounds["sigma"] * turned + decay * one
        limits = [P, -phi, turned - task.margin * decay * one, peak * one - P, np.full((1, 1), last)]
        if largest < math.inf:
            limits.append(largest * scale * np.eye(n + 1) + np.block([[0 * one, Y], [Y.T, np.zeros((1, 1))]]))
        if gamma is not None and task.deltas is not None:
            first, second = map(math.sqrt, task.deltas)
            columns = np.hstack([first * P, second * Y])
            above = np.full((1, 1), 2 * gamma * decay - 4 * task.slope * peak - 1)
            limits += [above, np.block([[-phi, columns], [columns.T, last * np.eye(n + 1)]])]
        return limits

    goal = np.array([*[0.0] * (p + free), *((4 * task.slope, 1.0) if gamma is None else (0.0, 0.0, 1.0))])
    x = solve_semidefinite_program(goal, blocks, "the design of an adaptive gain")
    if x is None or not x[-1] > 0:
        return None
    P, Y = task.unknown(x)
    if gamma is None:
        return Optimum(P / x[-1], Y / x[-1], max(1.0, float(goal @ x)), math.inf)
    return Optimum(P, Y, gamma, math.sqrt(2 * float(x[-1])) * gamma**n)


_MARGINS = (1e-6, 1e-4, 1e-2)  # of D P + P D >= 0, so that it remains true after rounding
_DIGITS = ((6, 9), (9, 12), (17, 17))  # of K and P
_FACTORS, _BISECTIONS = 6, 6  # factors of 10 to relax a bound; bisections
_STARTS = (1.0, 1e2, 1e4)  # from which gamma on a form's slope is taken first: a huge one is more than a solver takes
_SLOPES = 12  # number of further gammas


@dataclass(frozen=True)
class Design:
    """A designed gain of the observer `adaptive_lmi`, with its proofs: K (n), P (n, n) and sigma are its arguments.

    `gamma`: the least sufficient high gain, (88) of Alessandri (2020) rounded up; the observer's lower limit gamma_inf
    may be any number from it on. `mu`: a bound of the L2 gain from the disturbance to the error where the upper limit
    is gamma_sup = `gamma`, rounded up; a larger gamma_sup has the bound mu (gamma_sup/gamma)^n; None without a
    disturbance. `checks`: P > 0, D P + P D >= 0, D = diag(1, .., n), and (A - K C)'P + P (A - K C) + sigma (D P + P D)
    < 0 (54).
    """

    K: tuple[float, ...]
    P: tuple[tuple[float, ...], ...]
    sigma: float
    gamma: Fraction
    mu: Fraction | None
    checks: tuple[Check, ...]

    def __str__(self) -> str:
        K = ", ".join(f"{k:g}" for k in self.K)
        least, n = f"gamma_inf >= {up(self.gamma, 6)}", len(self.K)
        gain = "" if self.mu is None else f", mu <= {up(self.mu / self.gamma**n, 6)} gamma_sup^{n}"
        return f"K = ({K}), sigma = {self.sigma:g}: {least}{gain}"


@dataclass(eq=False)
class Infeasible(HgogenError):
    """The error that no gain K and matrix P satisfy all requested bounds. `bounds`: the requested values by name;
    `enough`: for each name the value that would be feasible if this bound alone were relaxed."""

    n: int
    bounds: dict[str, float]
    enough: dict[str, str]

    def __str__(self) -> str:
        limits = ", ".join(f"{name} = {value:g}" for name, value in self.bounds.items())
        ways = ", or ".join(f"{name} = {value}" for name, value in self.enough.items())
        fix = f"with the others kept, {ways} would do" if ways else "relax several of them, none alone is in the way"
        return f"no K and P were found for a chain of {self.n} integrators with {limits}: {fix}"


def adaptive_gain(
    n: int | Form,
    *,
    slope: float | None = None,
    sigma: float = 0.05,
    largest: float = 10.0,
    gamma: float = math.inf,
    mu: float = math.inf,
    disturbance: tuple[Any, Any] | None = None,
    K: Any = None,
) -> Design:
    """Return K and P of the observer `adaptive_lmi` for a chain of n integrators with a nonlinear part, designed for a
    small least gain gamma, or with a `disturbance` for a small L2 gain mu.

    Args: `n`: the number of integrators, together with `slope`; or a form, whose Lipschitz constant is then computed at
    the gamma above which it is needed; `slope`: a bound k >= |T^-1 dc/dw T|, T = diag(g, .., g^n), of the nonlinear
    part c in the coordinates w of integrators, valid for all g >= gamma_inf, as `slope(form, gamma)` returns it;
    `sigma` > 0: the fastest permitted decrease of gamma; `largest`: an upper bound of |P K|: a larger one permits a
    smaller gamma, with a larger K; `gamma`, `mu`: upper bounds of the results; `disturbance`: (G_1 (n, m), G_2 (m)) in
    w' = .. + G_1 v, y = w_1 + G_2 v; `K` (n): a fixed gain, for which only P is searched.

    Raises: `Infeasible`, which names the bound to relax; `NoSolver`; `NotHurwitz` for a fixed K; `BadGain`, also for a
    form that is no chain of integrators, or whose Lipschitz constant has no proved bound.
    """
    count = _count(n, slope)
    disturbed = None if disturbance is None else as_disturbance(disturbance, count)
    if disturbed is None and mu != math.inf:
        raise BadGain(f"mu = {mu!r}", "bounds the gain from a disturbance; give the disturbance")
    bounds = {"sigma": positive("sigma", sigma)}
    limits = {"largest": largest, "gamma": gamma, "mu": mu}
    bounds |= {name: math.inf if x == math.inf else positive(name, x) for name, x in limits.items()}
    deltas = None if disturbed is None else (float(disturbed.deltas[0]), float(disturbed.deltas[1]))
    steep = 0.0 if slope is None else float(slope)
    task = Task(count, steep, bounds, deltas, None if K is None else _column(K, count), _MARGINS[0])
    task = _where_needed(n, task, disturbed) if isinstance(n, Form) else task
    design = _designed(task, disturbed)
    if design is None:
        finite = {name: value for name, value in bounds.items() if value < math.inf}
        raise Infeasible(count, finite, _enough(task, disturbed, finite))
    return design


def _count(n: Any, slope: Any) -> int:
    if isinstance(n, Form):
        if slope is not None:
            raise BadGain("slope", f"is found of {n.system.name} itself; leave it out, or give n in place of the form")
        if n.n < 2:
            raise BadGain(f"{n.system.name} of one state", "needs no design: K = P = 1 do")
        return n.n
    if isinstance(n, bool) or not isinstance(n, int | float):
        raise Misfit("adaptive_gain", n, "a form, or a whole number of integrators with slope=")
    if not isinstance(n, int) or n < 2:
        raise BadGain(f"n = {n!r}", "must be a whole number of integrators, at least 2; K = P = 1 do for one")
    if slope is None:
        raise BadGain("slope", "must be given with n; or give the form in place of n")
    if isinstance(slope, Form):
        raise BadGain(f"slope = the form of {slope.system.name}", "must be a number; adaptive_gain(form) finds it")
    if not 0 <= real("slope", slope) < math.inf:
        raise BadGain(f"slope = {slope!r}", "must be a finite number, at least 0")
    return n


def _where_needed(form: Form, task: Task, disturbance: Disturbance | None) -> Task:
    """Return the task with the form's Lipschitz constant k(gamma) at the gamma
    of the best design. k decreases as gamma grows: if a design's bound is
    above its gamma, a larger gamma is valid, else a smaller one may be."""
    free = task.bounded("mu", math.inf)

    def at(gamma: float) -> tuple[Task, Design | None]:
        variant = replace(free, slope=slope(form, gamma), least=gamma)
        return variant, _designed(variant, disturbance)

    starts = _STARTS if math.isinf(task.bounds["gamma"]) else (max(1.0, task.bounds["gamma"]),)
    tried = map(at, starts)
    chosen, design = next((one for one in tried if one[1] is not None), (replace(task, slope=slope(form)), None))
    if design is None:
        return chosen
    low, high = 1.0, float(design.gamma)
    for _ in range(_SLOPES):
        middle = _to_digits(math.sqrt(low * high), 4)
        variant, tried_design = at(middle)
        if tried_design is None:
            low = middle
            continue
        if _objective(tried_design) < _objective(design):
            chosen, design = variant, tried_design
        low, high = (low, middle) if tried_design.gamma <= middle else (middle, min(high, float(tried_design.gamma)))
    return replace(chosen, bounds=task.bounds)


def _objective(design: Design) -> Fraction:
    return design.gamma if design.mu is None else design.mu


def _designed(task: Task, disturbance: Disturbance | None) -> Design | None:
    for margin in _MARGINS:
        optimum = best(replace(task, margin=margin))
        if optimum is None:
            return None
        rounded = (_rounded(task, optimum, disturbance, digits) for digits in _DIGITS)
        design = next((one for one in rounded if one is not None), None)
        if design is not None:
            return design
    return None


@requires_form
def slope(form: Form, gamma: float = 1.0) -> float:
    """Return a proved Lipschitz constant k of the nonlinear part of a form, scaled by a high gain: k >= |T^-1 dc/dw T|,
    T = diag(g, .., g^n), for every g >= `gamma`, rounded up; c is the nonlinear part in the coordinates w of
    integrators, w_i' = w_(i+1) + c_i. A larger `gamma` gives a smaller k; `adaptive_gain(form)` searches the gamma
    itself. Raises: `BadGain` for a form that is no chain of integrators, or has no proved bound k; `Misfit` for an
    argument that is no form."""
    if not 1 <= real("gamma", gamma) < math.inf:
        raise BadGain(f"gamma = {gamma!r}", "must be a finite number, at least 1")
    steep = steepness(integrators("adaptive_lmi", form), gamma)
    if isinstance(steep, Nothing) or steep.proof.high is None:
        raise BadGain(f"the slope of {form.system.name}", f"has no bound: {steep}")
    rounded = float(steep.proof.high)
    return rounded if rounded >= steep.proof.high else math.nextafter(rounded, math.inf)


def _column(K: Any, n: int) -> np.ndarray:
    values = reals("K", K)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise BadGain(f"K = {K!r}", f"must be {n} finite numbers, one for each integrator")
    demand_hurwitz("K", companion(values), "take the coefficients of a polynomial whose roots decay, or leave K out")
    return values[:, None]


def _rounded(task: Task, optimum: Optimum, disturbance: Disturbance | None, digits: tuple[int, int]) -> Design | None:
    """Return K and P of a solution, rounded to `digits` (of K, of P),
    with their proofs; None if rounding breaks one."""
    P = [[_to_digits(value, digits[1]) for value in row] for row in optimum.P.tolist()]
    if task.K is None:
        K = [_to_digits(k, digits[0]) for k in np.linalg.solve(optimum.P, optimum.Y).ravel().tolist()]
    else:
        K = task.K.ravel().tolist()
    known = candidate(K, P, task.bounds["sigma"])
    proved = candidate_checks("adaptive_gain", known)
    if any(check.verdict is not Verdict.PROVED for check in proved):
        return None
    slope, least, mu = Fraction(task.slope), Fraction(task.least), None
    if disturbance is None:
        gamma = max(known.least(slope), least)
    else:
        gamma = max(Fraction(optimum.gamma), least)
        share = share_of(known, (4 * slope * known.peak + 1) / (2 * gamma), disturbance)
        if share is None:
            return None
        mu = root(2 * share, bits=52) * gamma**task.n
    if gamma > task.bounds["gamma"] or (mu is not None and mu > task.bounds["mu"]):
        return None
    return Design(tuple(K), tuple(map(tuple, P)), task.bounds["sigma"], gamma, mu, proved)


def _to_digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _enough(task: Task, disturbance: Disturbance | None, names: Iterable[str]) -> dict[str, str]:
    enough = {}
    for name in names:

        def at(value: float, name: str = name) -> Design | None:
            return _designed(task.bounded(name, value), disturbance)

        loosest = at(0.0 if name == "sigma" else math.inf)
        if loosest is None:
            continue
        if name == "mu" or (name == "gamma" and disturbance is None):
            enough[name] = up(getattr(loosest, name))
            continue
        value = _edge(at, task.bounds[name], 0.1 if name == "sigma" else 10.0)
        if value is not None:
            enough[name] = (down if name == "sigma" else up)(value)
    return enough


def _edge(at: Callable[[float], Design | None], refused: float, factor: float) -> float | None:
    """Return a value of a bound at which the function `at` returns a design, close to the value `refused` at which it
    returns None: the bound is multiplied by powers of `factor`, then bisected; None after six failures."""
    good = next((refused * factor**k for k in range(1, _FACTORS + 1) if at(refused * factor**k)), None)
    if good is None:
        return None
    bad = good / factor
    for _ in range(_BISECTIONS):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if at(middle) else (good, middle)
    return good
