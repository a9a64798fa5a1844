"""The design of a constant gain with a small effect of noise at a requested decay rate: a cone program over P and Y = P
K, and the proof of its gain.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)
    e' = (M - K C) e + (B + K) v + (G - K D) diag(d) (H e + E v),   |d_j| <= 1,   |v_j| <= 1,   V = e'P e

    minimise t:   V' <= -2 rate V where v = 0,   V' <= -alpha V + sum_j lambda_j v_j^2,   sum_j lambda_j <= alpha,
                  c P^-1 c' <= t for every c,   K'P K <= fastest^2 I

for all d at the corners, or with multipliers for many slopes. Everything is linear in P, Y, the multipliers and t: P (M
- K C) is [P, Y] times the rows of M and -C, so that the forms are those of `inequality`, with [P, Y] for P. The last
row limits the speed of e under noise alone to `fastest` per unit of time, in the norm in which e is at most 1. Without
it the gain of a single state, for example, would be unbounded. Source: Boyd, El Ghaoui, Feron, Balakrishnan, "Linear
Matrix Inequalities in System and Control Theory", SIAM (1994), 6.1.3, 7.1.

The program has one P for the rate and for noise, but a proof may have one for each. So the program demands less than
the rate, as little as gives a gain for which another P proves the whole rate, and noise at a rate that is searched. The
gain with the least bound is selected in floats. Its digits are rounded, and rationals prove the rate, and the bound of
each state with its own P. Where no gain reaches the rate, the error names the slope that hinders most. theta is only
the unit of time in which K is written: by default numbers are near 1, or a proof is accurate.

b may read e_j - N_j (C e - v) in the place of e_j. With N given, all else is the convex program of `Search`. N itself
is searched without derivatives, in floats, from where samples replace the measured states (N_1 = 1/a_1), in steps as
large as the effect of noise on a state. Where slopes are at their corners, N reduces the remaining slopes. With a
multiplier for each slope K has the same effect as N (Arcak, Kokotovic, Automatica 37 (2001), have slopes of one sign).
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.estimators.gains import as_matrix, columns
from hgogen.form import Form
from hgogen.prove.constant_gain import argument_obstacle, entries_of, injected, numbers_in_place
from hgogen.prove.convergence import DecayProof, Flow
from hgogen.prove.error_models import with_gains
from hgogen.prove.inclusion import Inclusion, Nothing, Slope, Uncertain
from hgogen.prove.inequality import driven_by_multipliers, flow, vertex_systems
from hgogen.prove.quadratic import Array, Quadratic
from hgogen.prove.questions import Bounds, bounds, bounds_by_name, joint_bound_in_floats
from hgogen.prove.semidefinite import (
    CLOSER,
    Rows,
    coefficient_matrices,
    definite_cone,
    definite_cones,
    extent_cone,
    solve_cone_program,
    symmetric,
)
from hgogen.reading.given import BadGain, Each, cached, each_by_name, names_of, positive, requires_form
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, same

_WHAT = "the design of a gain"
_LESS = 1 - 1e-6  # sum of the lambda over alpha
_BY = 1e-7  # margin of the negative forms
_DOUBLINGS = 60  # the most doublings of the pace
_SMALL = 1e-12
_SLOW, _FAST, _SEARCHED = 1 / 8, 6, 8  # ends of the rates of noise over the wanted rate, and their number
_OF_PACE = 1 / 10  # of the pace of slopes: lower limit of the rates of noise
_LARGE = 1e30  # the bound of a missing gain
_PARTS = (1.02, 0.7, 0.4)  # first parts of the rate for the common P
_LEAST, _HALVINGS = 0.0, 6
_DIGITS = 6
_ONE = Fraction(1)
_BACK, _STEPS = 12, 5  # halvings of an unreached rate; steps between it and the reached one
_NOISY = 0.5  # the rate of noise over the rate of decay


@dataclass(frozen=True, eq=False)
class Open:
    """An error system whose constant gain K (n, p) is the unknown of a design:

        e' = (M - K C) e + (B + K) v + (G - K D) diag(d) (H e + E v),   |d_j| <= 1

    `M` (n, n), `G` (n, m), `H` (m, n), `C` (p, n), `D` (p, m), `B` (n, p), `E` (m, p); v (p): noise in units of its
    largest size; `chain` (n): for each state, the index of the output to whose chain it belongs.
    """

    M: Array
    G: Array
    H: Array
    C: Array
    D: Array
    B: Array
    E: Array
    chain: tuple[int, ...]

    @property
    def with_gain(self) -> Uncertain:
        """The system with the matrices [M; -C], [G; -D] and [B; I], each with n + p rows: multiplied from the left by
        [P, Y], Y = P K, they are P times the matrices of the system with gain K, so that conditions are linear in P and
        Y."""
        M, G = np.vstack([self.M, -self.C]), np.vstack([self.G, -self.D])
        B = np.vstack([self.B, np.eye(len(self.C))])
        return Uncertain(M, G, self.H, B, self.E, M, B)

    def scaled(self, T: Array, pace: float) -> "Open":
        """Return the system in coordinates x, e = diag(`T`) x, with time in units of 1/`pace`. Each column of G has the
        same length as its row of H."""
        G, H = self.G / T[:, None] / pace, self.H * T
        columns, reads = np.linalg.norm(G, axis=0), np.linalg.norm(H, axis=1)
        g = np.sqrt(np.divide(reads, columns, out=np.ones_like(reads), where=(reads > _SMALL) & (columns > _SMALL)))
        M, B = self.M * T / T[:, None] / pace, self.B / T[:, None] / pace
        return Open(M, G * g, H / g[:, None], self.C * T, self.D * g, B, self.E / g[:, None], self.chain)

    def scale(self, pace: float) -> Array:
        """Return scales T (n) of coordinates x, e = diag(T) x, in which noise of 1 is an error of 1 in the first state
        of a chain, and x_(i-1)' contains `pace` x_i."""
        T = np.zeros(len(self.M))
        for i, j in enumerate(self.chain):
            head = i == 0 or self.chain[i - 1] != j
            T[i] = 1 / abs(self.C[j, i]) if head else T[i - 1] * pace / abs(self.M[i - 1, i])
        return T

    def pace(self, rate: float) -> float:
        """Return the speed `rate` 2^k (1/time) with the least k >= 0 for which no entry of M and of |G| |H| exceeds 1
        in the coordinates `scale` of this speed and in its unit of time."""
        pace = rate
        for _ in range(_DOUBLINGS):
            x = self.scaled(self.scale(pace), pace)
            if max(np.abs(x.M).max(), (np.abs(x.G) @ np.abs(x.H)).max(initial=0.0)) <= 1 + _SMALL:
                break
            pace *= 2
        return pace


@dataclass(frozen=True, eq=False)
class Task:
    """A gain design for the error system `open`: errors have to decay at least at `rate` (1/time), the largest |c e|
    under noise over the `rows` c (r, n) is minimised, and noise alone may change the error at a speed of at most
    `fastest` (1/time)."""

    open: Open
    rate: float
    rows: Array
    fastest: float

    @cached_property
    def pace(self) -> float:
        """The speed (1/time) that is the unit of time of the semidefinite program, so that its numbers are close to 1.
        The factor 1 + n/4 is there because long chains have fast poles."""
        return self.open.pace(self.rate) * (1 + len(self.open.M) / 4)

    def gain(self, rate: float, noisy: float) -> Array | None:
        """Return a gain K (n, p) for which one P proves the decay at `rate`, and a small bound of the effect of noise
        by the noise inequality with alpha = 2 `noisy` (both 1/time); None where the solver finds none. Raises:
        `NoSolver`."""
        T = self.open.scale(self.pace)
        rows = self.rows * T
        rows = rows / np.linalg.norm(rows, axis=1).max()
        program = _Program(self.open.scaled(T, self.pace), rate / self.pace, 2 * noisy / self.pace)
        K = program.gain(rows, self.fastest / self.pace)
        return None if K is None else K * T[:, None] * self.pace


@dataclass(frozen=True, eq=False)
class _Program:
    """The semidefinite program for a gain K in scaled units. Its variables (N) are
    the entries of P and Y = P K, multipliers of the partial derivatives for the
    rate and again for noise, and the lambda_j; then t, the largest c P^-1 c'."""

    open: Open
    rate: float
    alpha: float

    def gain(self, rows: Array, fastest: float) -> Array | None:
        """Return K = P^-1 Y (n, p) with the least t over the `rows` c; None if the solver finds none."""
        (p, n), (of_P, of_Y, k) = self.open.C.shape, self._sizes
        size, one = self._size, np.eye(self._size + 1)

        def norm(x: Array) -> tuple[Array, Array]:
            return symmetric(x[:of_P], n), x[of_P : of_P + of_Y].reshape(n, p)

        def limited(x: Array) -> list[Array]:
            """Return [P, Y; Y', fastest^2 I], which is >= 0 where K'P K <= fastest^2 I, Y = P K."""
            P, Y = norm(x)
            return [np.block([[P, Y], [Y.T, fastest**2 * np.eye(p)]])]

        multipliers = slice(of_P + of_Y, size)  # at least 0, the lambda together at most alpha
        together = one[size - p : size].sum(axis=0)
        ends = np.append([_LESS * self.alpha], np.zeros(2 * k + p))
        signs: Rows = np.vstack([together, -one[multipliers]]), ends, False
        reach = (extent_cone(c, size) for c in rows)
        solution = solve_cone_program(
            one[-1], [*self._falling(), *reach, *definite_cones(limited, size + 1), signs], CLOSER, _WHAT
        )
        if solution is None:
            return None
        P, Y = norm(solution[0])
        return np.linalg.solve(P, Y) if np.linalg.eigvalsh(P).min() > 0 else None

    @cached_property
    def _ends(self) -> tuple[Uncertain, ...]:
        return vertex_systems(self.open.with_gain)

    @cached_property
    def _sizes(self) -> tuple[int, int, int]:
        n = len(self.open.M)
        return n * (n + 1) // 2, self.open.C.size, len(self._ends[0].H)

    @cached_property
    def _size(self) -> int:
        of_P, of_Y, k = self._sizes
        return of_P + of_Y + 2 * k + len(self.open.C)

    def _falling(self) -> Iterator[Rows]:
        """Yield, for each error system, the cones of V' <= -2
        rate V and of V' <= -alpha V + sum_j lambda_j v_j^2."""
        of_P, of_Y, k = self._sizes
        for e in self._ends:
            yield self._negative(flow(e).falls(2 * self.rate), of_P + of_Y)
            yield self._negative(driven_by_multipliers(e, self.alpha), of_P + of_Y + k)

    def _negative(self, form: Quadratic, first: int) -> Rows:
        brings, shared = coefficient_matrices(form), sum(self._sizes[:2])
        whole = np.zeros((self._size, form.size, form.size))
        whole[:shared], whole[first : first + len(form.Q)] = brings[:shared], brings[shared:]
        return definite_cone(whole, np.zeros((1, form.size, form.size)), -_BY * np.eye(form.size))


@dataclass(frozen=True)
class Candidate:
    """A gain K (n, p) with a proof `falls` that errors decay at the requested rate, by the search `flow`. `argument`:
    the entries of N in b(z + N (y - C z)), () for none; `noise_bound`: the largest |c e| under noise, in floats."""

    K: tuple[tuple[float, ...], ...]
    argument: tuple[float, ...]
    flow: Flow
    falls: DecayProof
    noise_bound: float = _LARGE


@dataclass(frozen=True, eq=False)
class Search:
    """A search over gains K of a form for a design `task`, under noise of at most `sizes` (p). The gain is written for
    the observer's gain `theta`; `argument`: the entries of N in b(z + N (y - C z)) at theta = 1, () for none."""

    form: Form
    task: Task
    sizes: Array
    theta: float
    argument: tuple[float, ...] = ()

    def best(self) -> Candidate | None:
        """Return the candidate with the smallest noise bound among those designed for several alpha of the noise
        inequality; None where no gain is proved. Raises: `NoSolver`."""
        tried = list[Candidate]()

        def noise_bound(noisy: float) -> float:
            one = self._slowest(math.exp(noisy))
            tried.extend([one] if one else [])
            return one.noise_bound if one else _LARGE

        from scipy.optimize import minimize_scalar  # which the solver needs as well

        ends = math.log(self.task.rate * _SLOW), math.log(self._fast * _FAST)
        minimize_scalar(noise_bound, bounds=ends, method="bounded", options={"maxiter": _SEARCHED})
        return min(tried, key=lambda one: one.noise_bound, default=None)

    @property
    def _fast(self) -> float:
        return max(self.task.rate, _OF_PACE * self.task.pace)

    @property
    def written(self) -> tuple[float, ...]:
        """The entries of N as arguments of the observer at `theta`: divided by their powers of theta, rounded to six
        digits."""
        places = columns(self.form, len(self.argument)) if self.argument else ()
        return tuple(self._rounded(x, at.power - 1) for x, at in zip(self.argument, places, strict=True))

    def _rounded(self, value: float, power: int) -> float:
        return float(f"{value / self.theta**power:.{_DIGITS}g}")

    def promise(self) -> float:
        """Return the noise bound of the gain designed for noise at half of the rate
        of decay, to two digits; 1e30 without a gain. Raises: `NoSolver`."""
        one = self.middle()
        return float(f"{one.noise_bound:.2g}") if one else _LARGE

    def middle(self) -> Candidate | None:
        """Return the gain designed for noise at about half of
        the rate of decay, or None. Raises: `NoSolver`."""
        return self._slowest(math.sqrt(self.task.rate * self._fast) / 2)

    def _slowest(self, noisy: float) -> Candidate | None:
        """Return the gain of the program that demands the smallest part of the rate for which a
        second P still proves all of it, with noise at the rate `noisy`; None if there is none."""
        start = next(((less, one) for less in _PARTS if (one := self._at(less, noisy))), None)
        if start is None:
            return None
        (high, best), low = start, _LEAST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            one = self._at(middle, noisy)
            low, high, best = (low, middle, one) if one else (middle, high, best)
        noise_bound = joint_bound_in_floats(
            best.flow.error, self.sizes, self.task.rows, best.falls, 2 * noisy, self.task.fastest
        )
        return replace(best, noise_bound=min(noise_bound, _LARGE))

    def _at(self, less: float, noisy: float) -> Candidate | None:
        """Return the gain of the program that demands `less`
        times the rate, if a second P proves the whole rate."""
        K = self.task.gain(less * self.task.rate, noisy)
        if K is None or not np.isfinite(K).all():
            return None
        K = K / self.sizes
        entries = [self._rounded(K[at.row, at.chain], at.power) for at in columns(self.form, K.size)]
        error = error_of(self.form, [*map(Fraction, entries)], self.written)
        if isinstance(error, Nothing):
            return None
        flow = Flow(error, Fraction(self.theta))
        falls = flow.at(flow.theta, 2 * Fraction(self.task.rate))
        rows = tuple(map(tuple, np.reshape(entries, K.shape).tolist()))
        return Candidate(rows, self.written, flow, falls) if falls else None


def error_of(form: Form, K: Sequence[Fraction], argument: Sequence[float]) -> Inclusion | Nothing:
    """Return the error dynamics of an observer with the constant gain `K` (n, or n p), and with N in b(z + N (y - C
    z)), whose entries are `argument`, () for none; or the reason why there are none."""
    error = with_gains(form, K)
    return injected(error, form, [sp.Rational(Fraction(x)) for x in argument]) if argument else error


def plain(form: Form, sizes: Array, narrower: int | None = None, argument: Sequence[float] = ()) -> Open | Reason:
    """Return the error system of a form without its gain, noise in units of `sizes` (p); or the reason why no gain can
    be designed. `narrower`: the index of an uncertain slope that gets half of its range, None for none; `argument`: the
    entries of N in b(z + N (y - C z)), () for none."""
    if len(form.leads) < len(form.blocks):
        return because("it is for outputs of which each has a chain of its own")
    without, ones = (error_of(form, [Fraction(k)] * form.n, argument) for k in (0, 1))
    if isinstance(without, Nothing) or isinstance(ones, Nothing):
        return because("{why}", why=without)
    chain = [k for k, size in enumerate(form.blocks) for _ in range(size)]
    parts = list[Uncertain]()
    for error in (without, ones):
        slopes = tuple(_half(slope) if k == narrower else slope for k, slope in enumerate(error.slopes))
        parts.append(replace(error, slopes=slopes).at(_ONE).floats)
    e, with_ones = parts  # for gains of 0 and of ones: their difference is what the gain reads
    heads, read = list(form.heads), sizes[:, None]
    C, D = (e.M - with_ones.M)[heads] / read, (e.G - with_ones.G)[heads] / read
    return Open(e.M, e.G, e.H, C, D, e.B * sizes, e.E * sizes, tuple(chain))


def _half(slope: Slope) -> Slope:
    """Return a partial derivative d in [low, high] with half of its
    range, around its middle, or around 0 if it is a db_i/dz_j."""
    centre = (slope.low + slope.high) / 2 if slope.entry is None else Fraction(0)
    return replace(slope, low=(slope.low + centre) / 2, high=(slope.high + centre) / 2)


@dataclass(eq=False)
class NoGain(HgogenError):
    """The error that no gain is proved to make errors decay at `rate` (1/time). `reached`: the largest smaller rate
    that was tried and is reached, 0.0 for none; `hindrance`: the reason, such as the partial derivative of b whose
    range is too large."""

    plant: str
    rate: float
    reached: float
    hindrance: Reason

    def __str__(self) -> str:
        most = "nor at any smaller one that is tried"
        if self.reached:
            most = str(because("at {reached} there is one", reached=Down(self.reached, 2)))
        what = f"no gain is found with which errors of {self.plant} decay at rate = {self.rate:g}"
        return f"{what}; {most}; {self.hindrance}"


def unreached(form: Form, task: Task, sizes: Array) -> NoGain:
    """Return the error for a `task` whose rate no gain reaches, with the partial derivative of b whose halved range
    allows the largest rate. `sizes` (p): the largest noise of each output. Raises: `NoSolver`."""
    error = with_gains(form, [Fraction(0)] * form.n)
    slopes = () if isinstance(error, Nothing) else error.slopes
    reached = _reached(task, (task.rate / 2**k for k in range(1, _BACK)))
    step = (task.rate / reached) ** (1 / _STEPS) if reached else 2.0
    rates = [task.rate / step**k for k in range(_STEPS if reached else _BACK)]
    narrower = {}
    for k, slope in enumerate(slopes):
        open_ = plain(form, sizes, k)
        if slope.low < slope.high and not isinstance(open_, Reason):
            narrower[k] = _reached(replace(task, open=open_), rates)
    best = max(narrower, key=narrower.__getitem__, default=None)
    if best is None or narrower[best] <= reached:
        return NoGain(form.system.name, task.rate, reached, because("no slope hinders, but the solver gets no further"))
    slope = slopes[best]
    if slope.entry is None:
        called = [name for chain in form.gain_names for name in chain][slope.reads.index(1)]
    else:
        i, j = slope.entry
        called = f"db_{i + 1}/d{form.states[j]}"
    low, high = float(slope.low), float(slope.high)
    pattern = "{slope} in [{low:.3g}, {high:.3g}] hinders most: in half of that {more} is reached"
    more = Down(narrower[best], 2)
    why = because(pattern, slope=called, low=low, high=high, more=more)
    return NoGain(form.system.name, task.rate, reached, why)


def _reached(task: Task, rates: Iterable[float]) -> float:
    return next((rate for rate in rates if task.gain(rate, rate * _NOISY) is not None), 0.0)


_FASTEST = 10  # times the number of states and the pace of rate and slopes
_FAR = 1e15  # limit of moderate numbers, and its inverse
_FIRST, _MORE = 12, 8  # evaluations of a search for N, and more for each entry
_NO_GAIN = 1e30  # the noise bound of a missing gain
_FROM_RANGE: Any = object()  # the measure that a state's range gives


@dataclass(frozen=True)
class Gain:
    """A designed constant gain with its proofs: `theta` and `K` are arguments of the observer `observer`; K has a
    number for each state, or for several outputs a row for each state.

    `rate` (1/time): |e|_P decays at least like exp(-rate t), in continuous time without noise; `bounds`: by (name of a
    state of the form, name of an output), the largest error of the state for noise of at most 1 in the output, in their
    units; the bounds of several outputs add up. Rate and bounds are proved in rational arithmetic. `argument`: N for
    `hg.observers.circle_criterion`; empty for a gain of `hg.observers.high_gain`.
    """

    theta: float
    K: Annotated[tuple[Any, ...], "injection gains; null for the tuning"]
    rate: float
    bounds: Bounds
    time: str
    argument: Annotated[tuple[Any, ...], "gains N in the argument of b; empty for high_gain"] = ()

    @property
    def observer(self) -> str:
        """The name of the observer for which the gain is designed: "circle_criterion" with an N, else "high_gain"."""
        return "circle_criterion" if self.argument else "high_gain"

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments theta, gains and, with an N, argument of the observer, by name."""
        optional = {"argument": self.argument} if self.argument else {}
        return {"theta": self.theta, "gains": self.K, **optional}

    def bound(self, state: str, noise: Mapping[str, float]) -> float:
        """Return the largest error of a state of the form under noise of at most the sizes in `noise`, by name of the
        output: the sum of bound times size. Raises: `KeyError` for a state or an output that does not exist."""
        return sum(self.bounds[state, output] * size for output, size in noise.items())

    def __str__(self) -> str:
        effects = [
            Sentence.of("{state} by at most {bound} for 1 of {output}", state=x, bound=Up(bound, 3), output=y)
            for (x, y), bound in self.bounds.items()
        ]
        pattern = (
            "theta = {theta}, K = {K}{N}: errors decay at least like exp(-{rate} t), t in {time}, and noise moves "
            "{moved}; in continuous time, by rational arithmetic"
        )
        argument = Sentence.of(", N = {N}", N=_numbers(self.argument)) if self.argument else ""
        theta, decay = same(self.theta), Down(self.rate, 3)
        return str(
            because(pattern, theta=theta, K=_numbers(self.K), N=argument, rate=decay, time=self.time, moved=effects)
        )


@requires_form
@cached
@np.errstate(all="ignore")
def gain(
    form: Form,
    *,
    rate: float,
    noise: Each = None,
    per: Each = None,
    fastest: float | None = None,
    theta: float | None = None,
    argument: Any = None,
) -> Gain:
    """Return a constant gain of `observers.high_gain` for a form in chains, with a small bound of the effect of noise;
    with an `argument` a gain of `observers.circle_criterion`.

    Args: `rate` (1/time) > 0: errors decay at least this fast; `noise`: the largest noise of each output, by name, by
    default 1; for several outputs only the ratios count; `per`: the unit of the error of each state of the form, by
    name, by default half of its range; the largest bound in these units is minimised; `fastest` (1/time): the largest
    speed of the estimate under noise alone, over its largest deviation: by default 10 n rate, or the speed that the
    partial derivatives of b require; `theta` > 0: the observer's gain, by whose powers K is divided; `argument`: an
    output error in the argument of b, b(z + N (y - C z)), on a form whose a_i are numbers: True to search N, or its
    entries at theta = 1, as `circle_criterion` accepts them.

    Raises: `NoGain` for a rate that is not reached; `NoSolver`; `Misfit` for an argument that is no form; `BadGain` for
    a form without chains of constant gains, and for arguments that are no numbers or not positive; `BadNames`.
    """
    if form.system.wraps:
        fix = "design on the plant without its periods or invariants, for small errors"
        raise BadGain(form.system.name, f"has no gain that is designed: {form.system.wraps}", fix=fix)
    task, sizes = _task(form, _moderate("rate", rate), noise, per, fastest)
    if theta is None:  # the pace, unless a smaller level is more accurate
        levels = tuple(float(f"{level:.2g}") for level in (task.pace, math.sqrt(task.pace), 1.0))
    else:
        levels = (_moderate("theta", theta),)
    tried = list[Candidate | None]()
    for read in _arguments(form, task, sizes, argument):
        one = searched(form, task, sizes, read)
        tried.append(min((replace(one, theta=level) for level in levels), key=Search.promise).best())
    best = min(filter(None, tried), key=lambda one: one.noise_bound, default=None)
    if best is None:
        raise unreached(form, task, sizes)
    return _stated(form, best)


def _task(form: Form, rate: float, noise: Each, per: Each, fastest: float | None) -> tuple[Task, np.ndarray]:
    """Return what is searched, and the largest noise of each output (p)."""
    names = names_of(form.system.outputs)
    each = zip(names, each_by_name("noise", noise, names, 1.0), strict=True)
    sizes = np.array([_moderate(f"noise of {name}", value) for name, value in each])
    measures, open_ = _measures(form, per), plain(form, sizes)
    if isinstance(open_, Reason):
        fix = "gains are designed on a form of the plant's own states in chains, triangular or block_triangular"
        raise BadGain(form.system.name, f"has no gain that is designed: {open_}", fix=fix)
    pace = open_.pace(rate)
    rows = np.diag([1 / (size or natural) for size, natural in zip(measures, open_.scale(pace), strict=True)])
    quickest = _FASTEST * form.n * pace if fastest is None else _moderate("fastest", fastest)
    return Task(open_, rate, rows, quickest), sizes


def _arguments(form: Form, task: Task, sizes: np.ndarray, argument: Any) -> Sequence[tuple[float, ...]]:
    if argument is None or argument is False:
        return ((),)
    moving = because("its {a} moves in a range", a=form.gain_names[0][0]) if task.open.D.any() else NONE
    if why := argument_obstacle(form) or moving:
        raise BadGain("argument", f"is not designed for {form.system.name}: {why}; leave it out")
    if argument is True:
        return (), _least_noise(form, task, sizes)
    entries = entries_of("argument", argument, form)
    return (entries if any(entries) else (),)


def _least_noise(form: Form, task: Task, sizes: Array) -> tuple[float, ...]:
    """Return the entries of N (n, or n q in the order of `columns`) in b(z + N (y - C z)) with the smallest noise
    bound; () where b depends on no state. `sizes` (p): the largest noise of each output. Raises: `NoSolver`."""
    start = np.array(numbers_in_place(form))
    places, reads = columns(form, len(start)), np.abs(task.open.H).sum(axis=0)
    free = [k for k, at in enumerate(places) if reads[at.row]]
    steps = task.open.scale(task.pace)[[places[k].row for k in free]]

    def entries(x: Array) -> tuple[float, ...]:
        values = start.copy()
        values[free] += x * steps
        return tuple(map(float, values))

    def noise_bound(x: Array) -> float:
        one = searched(form, task, sizes, entries(x)).middle()
        return one.noise_bound if one else _NO_GAIN

    if not free:
        return ()

    from scipy.optimize import minimize  # which the solver needs as well

    simplex = np.vstack([np.zeros(len(free)), np.eye(len(free))])
    most = {"maxfev": _FIRST + _MORE * len(free), "initial_simplex": simplex}
    return entries(minimize(noise_bound, simplex[0], method="Nelder-Mead", options=most).x)


def searched(form: Form, task: Task, sizes: Array, argument: Sequence[float]) -> Search:
    """Return the `Search` for a gain K of a form with N = `argument` in b(z + N (y - C z)), at theta = 1; `task` and
    `sizes` (p) as in `Search`."""
    open_ = plain(form, sizes, argument=argument)
    assert not isinstance(open_, Reason)
    return Search(form, replace(task, open=open_), sizes, 1.0, tuple(argument))


def _measures(form: Form, per: Any) -> list[float]:
    each = each_by_name("per", per, form.names, _FROM_RANGE)
    halves = ((z.high - z.low) / 2 if z.low is not None and z.high is not None else 0.0 for z in form.states)
    return [
        float(half) if value is _FROM_RANGE else _moderate(f"per of {name}", value)
        for name, value, half in zip(form.names, each, halves, strict=True)
    ]


def _moderate(what: str, value: Any) -> float:
    size = positive(what, value)
    if not 1 / _FAR <= size <= _FAR:
        raise BadGain(f"{what} = {size:g}", f"must be from {1 / _FAR:g} to {_FAR:g}; take other units")
    return size


def _stated(form: Form, best: Candidate) -> Gain:
    fastest = max(filter(None, (best.flow.fastest, best.falls)), key=lambda one: one.alpha)
    known = bounds(best.flow, fastest)
    if isinstance(known, Reason):
        raise BadGain(form.system.name, f"has a gain whose noise is not bounded: {known}")
    one = len(form.blocks) == 1
    K: tuple[Any, ...] = tuple(k for (k,) in best.K) if one else best.K
    N: tuple[Any, ...] = best.argument
    if N and not one:
        N = tuple(map(tuple, as_matrix(form, N).tolist()))
    return Gain(float(best.flow.theta), K, fastest.rate, bounds_by_name(form, known), form.system.time, N)


def _numbers(K: Any) -> str:
    return f"({', '.join(map(_numbers, K))})" if isinstance(K, tuple) else same(K)
