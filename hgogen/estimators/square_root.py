"""Filters on P = S S', S lower triangular: the Riccati observer, the unscented and the iterated filter.

The Riccati observer on P = S S' as straight-line statements, S lower triangular with a positive diagonal.

    time         S S' = [Phi S, sqrt(h) W] [Phi S, sqrt(h) W]',  W W' = Q_theta, by Gram-Schmidt on the rows of the
                 stack, each orthogonalised against the previous rows: the triangle of a QR factorisation without its Q
    measurement  of row c and variance r, f = S' c', from the last column to the first, b = 0 and alpha = r at first:
                 beta = sqrt(alpha/(alpha + f_j^2)), S_ij <- beta (S_ij - f_j b_i/alpha), b_i <- b_i + f_j S_ij (with S
                 before), alpha <- alpha + f_j^2; the gain is b/alpha

The entries have the size of standard deviations and span half the decades of P, at the cost of n square roots per step,
n per sample and, with forgetting, n (n + 1)/2 per step for the prior. Source: Carlson, "Fast triangular formulation of
the square root filter", AIAA Journal 11 (1973); Potter's update (Battin 1964) keeps no triangle; Kaminski, Bryson,
Schmidt, IEEE TAC 16 (1971).

The unscented filter on P = S S' as straight-line statements, with sigma points instead of Jacobians.

    points       z and z +- g s_i, s_i the columns of S, g = alpha sqrt(n + kappa)
    of a map m   a_i = (m(z + g s_i) - m(z - g s_i))/2g,  b_i = (m(z + g s_i) + m(z - g s_i) - 2 m(z))/2g,
                 d = sum b_i/g:  the mean m(z) + d,  the covariance sum a_i a_i' + sum b_i b_i' + (beta - alpha^2) d d'
    time         m is one classical Runge-Kutta step of f; S S' = that covariance + h Q, by Gram-Schmidt
    angles       z +- g_i s_i with g_i <= g, so that no point is half a turn off; g_i in place of g in a_i, b_i and d.
                 m(z +- g_i s_i) of a periodic output is the value nearest to m(z): m(z) + sum of W_i wrap(.. - m(z))
    measurement  m = h_j:  f = (a_1, .., a_n),  r = R_j/h + sum b_i^2 + (beta - alpha^2) d^2,  then Carlson's update of
                 S with f and r, and z <- z + K (y_j - h_j(z) - d)

These are the sums of the scaled unscented transform, grouped by pairs of points. Its weight of the middle point is
negative for a small alpha. Here every term is positive while alpha^2 <= beta, so that S needs no downdate and is
positive definite by construction. For a smaller beta, with c = (alpha^2 - beta)/g^2 and B = sum b_i, a part of B is
subtracted from each b_i: sum b_i b_i' - c B B' = sum (b_i - s B)(b_i - s B)', s = (1 - sqrt(1 - n c))/n. This requires
n c <= 1, that is beta >= -alpha^2 kappa/n. An output that is linear in the state has f = S'c' without a difference,
which avoids cancellation in floats for a point near the estimate. Source: Julier, "The scaled unscented
transformation", ACC 2002; van der Merwe, Wan, "The square-root unscented Kalman filter for state and
parameter-estimation", ICASSP 2001; the sums by pairs as in Norgaard, Poulsen, Ravn, Automatica 36 (2000).

The iterated correction of an extended Kalman filter on P = S S': it minimises the cost of a sample.

    minimise  J(w) = |w|^2 + (y_j - h_j(z + S w))^2/r,   r = R_j/h,   from w = 0
    by        w <- w + s (f rho/(r + |f|^2) - w),  f = S'c',  c = dh_j/dz at z + S w,  rho = y_j - h_j(z + S w) + f w

|w|^2 is the squared distance from the prediction in P^-1. With s = 1 it is the Gauss-Newton method, whose first pass is
the extended Kalman filter's correction; s is halved where J does not decrease, so that no pass increases this cost.
Then z <- z + S w, and P is corrected by the row at that estimate. For an output that is linear in the state one pass is
exact. Source: Bell, Cathey, "The iterated Kalman filter update as a Gauss-Newton method", IEEE TAC 38 (1993); the
halved steps, Skoglund, Hendeby, Axehill, "Extended Kalman filter modifications based on an optimization view point",
FUSION 2015.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import product
from math import sqrt
from typing import Any

import casadi as ca
import numpy as np

from hgogen.analysis.dynamics import HUGE, at_nearest_turn
from hgogen.estimators.factored import Unrolled, Writes, decorrelated, largest, used_block, whitened
from hgogen.estimators.riccati_part import factor, lower, pack, packed_triangle, solve, unpack_lower
from hgogen.graph import Graph
from hgogen.part import Joint, Pieces
from hgogen.program import Bit, Block, Field, Place, Program, sym
from hgogen.reading.given import BadGain

RULE = "continuous-discrete, S S'"
POINTS_LIMITED = Bit(
    "POINTS_LIMITED",
    "the angle is so uncertain that sigma points would lie half a turn or more off: they were drawn nearer",
    "none while the estimate settles; if it stays, lower alpha or the covariance of the angle",
)
LARGEST = 7  # states; more would need too much flash as straight-line code


def triangle(stack: Graph, least: Graph | None = None) -> tuple[Graph, dict[str, Graph]]:
    """Return the lower triangular SX matrix S (n, n) with a positive diagonal and S S' = A A', A = `stack` (n, k), and
    the intermediate values by the names that they get in the code. A square S_jj^2 below `least` (n) counts as 0, for a
    singular A."""
    n = stack.shape[0]
    rows, S, names = [stack[i, :].T for i in range(n)], ca.SX(n, n), dict[str, Graph]()
    for j in range(n):
        S[j, j] = ca.sqrt(ca.dot(rows[j], rows[j]))
        inverse = 1 / (S[j, j] if least is None else ca.sqrt(ca.fmax(S[j, j] ** 2, least[j])))
        unit = rows[j] * inverse
        names |= {f"s{j + 1}{j + 1}": S[j, j]} | ({f"s{j + 1}{j + 1}_inverse": inverse} if j < n - 1 else {})
        names |= {f"q{j + 1}_{k + 1}": unit[k] for k in range(unit.shape[0])}
        for i in range(j + 1, n):
            S[i, j] = ca.dot(rows[i], unit)
            names[f"s{i + 1}{j + 1}"] = S[i, j]
            rows[i] = rows[i] - S[i, j] * unit
    return S, names


def root_of(W: Graph, w: Graph) -> Graph:
    """Return W diag(sqrt(w)) (n, k), a factor of W diag(w) W', SX."""
    return W @ ca.diag(ca.sqrt(w))


def carlson(S: Graph, f: Graph, r: Graph) -> tuple[Graph, Graph]:
    """Return S, the factor of P = S S', after Carlson's update by a sample of variance r with row c (1, n), f = S'c'
    (n), and the gain (n)."""
    n, after = S.shape[0], ca.SX(S)
    alpha, b = r, ca.SX(n, 1)
    for j in reversed(range(n)):
        if f[j].is_zero():
            continue
        grown = alpha + f[j] * f[j]
        beta, share = ca.sqrt(alpha / grown), f[j] / alpha
        for i in range(j, n):
            after[i, j] = beta * (S[i, j] - share * b[i])
            b[i] = b[i] + f[j] * S[i, j]
        alpha = grown
    return after, b / alpha


class SquareRoot(Unrolled):
    """A Riccati filter on P = S S', S lower triangular and packed by columns (Carlson), up to 7 states."""

    name = "S S'"

    def pieces(self) -> Pieces:
        """Return memory fields and statements of the filter. Raises: `BadGain` for more than 7 states."""
        n = self.part.dynamics.n
        if n > LARGEST:
            raise BadGain(
                "cholesky", f"takes up to {LARGEST} states, there are {n}; take continuous_discrete, which loops"
            )
        return super().pieces()

    @property
    def root(self) -> Graph:
        """The SX symbols of the stored S (n, n)."""
        n = self.part.dynamics.n
        return unpack_lower(sym("state", "root", n * (n + 1) // 2), n)

    @staticmethod
    def writes(S: Graph) -> Writes:
        """Return the assignment of S (n, n) to the state."""
        return {Place("state", "root"): pack(S)}

    @property
    def fields(self) -> tuple[Field, ...]:
        """The memory field of S; each S_ii is at least the root of the smallest D_i of P = L D L'."""
        n, deviation = self.part.dynamics.n, np.sqrt(largest(self.part))
        start = np.linalg.cholesky(self.part.covariance)
        floor = np.sqrt(self.smallest(factor(self.part.covariance)[1]))
        ends = [(floor[i] if i == j else -deviation[i], deviation[i]) for i, j in lower(n)]
        low, high = (tuple(map(float, each)) for each in zip(*ends, strict=True))
        meaning = "S of the covariance P = S S', lower triangle"
        return (packed_triangle("root", start, meaning, low=low, high=high),)

    @property
    def covariance(self) -> Graph:
        """P = S S' (n, n), SX."""
        return self.root @ self.root.T

    @property
    def variances(self) -> list[Graph]:
        """The diagonal entries P_ii = sum_j S_ij^2, n SX scalars."""
        S = self.root
        return [ca.dot(S[i, :], S[i, :]) for i in range(self.part.dynamics.n)]

    def scaled(self, scale: Graph) -> Writes:
        """Return the assignment of S of diag(s) P diag(s), with s = `scale` (n)."""
        return self.writes(ca.diag(scale) @ self.root)

    def sample_update(self, row: Graph, r: Graph) -> tuple[Writes, Graph]:
        """Return S, as an assignment, after Carlson's update by y = c z, c = `row` (1, n), of variance `r`, and K
        (n)."""
        S, gain = carlson(self.root, self.root.T @ row.T, r)
        return self.writes(S), gain

    def projected(self, rows: Graph) -> tuple[Program, Graph]:
        """Return C P C' (k, k), C = `rows` (k, n), SX, by S'C'."""
        f = self.root.T @ rows.T
        return (), f.T @ f

    def time_update(
        self, transition: Graph, growth: Graph | None, noise: tuple[Graph, Graph]
    ) -> tuple[Writes, dict[str, Graph]]:
        """Return S, as an assignment, of growth Phi P Phi' + W diag(w) W' by Gram-Schmidt, and intermediate values."""
        S = self.root if growth is None else ca.sqrt(growth) * self.root
        S, names = triangle(ca.horzcat(transition @ S, root_of(*noise)), self.least)
        return self.writes(S), names

    def congruent(self, N: Graph, least: Graph) -> tuple[Writes, dict[str, Graph]]:
        """Return the assignment of S of N P N' by Gram-Schmidt, and intermediate values."""
        S, names = triangle(N @ self.root, least)
        return self.writes(S), names

    def together(self, rows: Graph, r: Graph, error: Graph | None = None) -> Program:
        """Return the statements that correct by all stored samples, with S' = S T and z' = z + S w for T (n, n) and w
        (n) that begin at I and 0: T always, w only where the innovations `error` (p) are given. `rows` (p, n): c S of
        each output; `r` (p): variances of independent noises."""
        n = self.part.dynamics.n
        root, offset = Place("work", "relative_root"), Place("work", "offset")
        T, w = unpack_lower(sym(*root, n * (n + 1) // 2), n), sym(*offset, n)
        none = {} if error is None else {offset: ca.SX.zeros(n)}
        each = list[Program]()
        for j in range(rows.shape[0]):
            a = rows[j, :].T
            after, gain = carlson(T, T.T @ a, r[j])
            step = {} if error is None else {offset: w + gain * (error[j] - ca.dot(a, w))}
            each.append((Block("correct by the scalar update", {root: pack(after), **step}),))
        z = {Place("state", self.part.z.name): self.z + self.root @ w}
        return (
            Block("units of the prediction", {root: pack(ca.SX.eye(n)), **none}),
            *self.where_waiting(each),
            Block("correct by the offset", {**z, **self.writes(self.root @ T)}),
        )

    def linear(self, output: int) -> bool:
        """Return whether the output with index `output` is linear in z: its row c = dh/dz is free of z."""
        return not ca.depends_on(self.row(output), self.z)

    def output(self, z: Graph, output: int) -> Graph:
        """Return h_j(z) of the output j = `output` as an SX scalar."""
        return self.part.dynamics.output(z, self.clock.u_now)[output]


@dataclass(frozen=True)
class Transformed:
    """Sums of a map m at sigma points z +- g s_i: `middle` m(z) (k), `slopes` a_i = (m(z + g s_i) - m(z - g s_i))/2g
    and `curvatures` b_i = (m(z + g s_i) + m(z - g s_i) - 2 m(z))/2g (k, n), `drift` d = sum b_i/g (k)."""

    middle: Graph
    slopes: Graph
    curvatures: Graph
    drift: Graph


@dataclass(frozen=True)
class Unscented(SquareRoot):
    """The unscented Kalman filter on P = S S', with sigma points z +- g s_i, s_i the columns of S: `reach` g > 0, and
    `more` = beta - alpha^2 >= -g^2/n, the weight of the square of the mean's shift, d d', in the covariance."""

    reach: float
    more: float
    rule = RULE

    @property
    def angles(self) -> list[tuple[int, float]]:
        """The index of each periodic coordinate of the estimate, with half its period."""
        return [(k, period / 2) for k, period in enumerate(self.part.z.turns) if period is not None]

    @property
    def reaches(self) -> list[Graph]:
        """The distances of the n pairs of sigma points, in units of s_i: g, or less if a point would be half a turn or
        more from the estimate."""
        reaches: list[Graph] = [self.reach] * self.part.dynamics.n
        for (k, half), i in product(self.angles, range(self.part.dynamics.n)):
            if not self.root[k, i].is_zero():
                reaches[i] = ca.fmin(reaches[i], half / ca.fmax(ca.fabs(self.root[k, i]), half / HUGE))
        return reaches

    def points(self) -> tuple[list[Graph], list[Graph]]:
        """Return the sigma points z + g s_i and z - g s_i, i = 1..n, s_i the columns of S."""
        steps = [reach * self.root[:, i] for i, reach in enumerate(self.reaches)]
        return [self.z + step for step in steps], [self.z - step for step in steps]

    def common(self) -> dict[str, Any]:
        """The keyword arguments of `Pieces` of the base class, with the status bit POINTS_LIMITED if the estimate has
        angles."""
        known = super().common()
        return known | {"bits": (*known["bits"], POINTS_LIMITED)} if self.angles else known

    @property
    def limited(self) -> Program:
        """The block that sets the bit POINTS_LIMITED while a pair of sigma points is nearer than g; () for an estimate
        without angles."""
        nearer = [reach < self.reach for reach in self.reaches if isinstance(reach, ca.SX)]
        raised = {Place("status", "POINTS_LIMITED"): reduce(ca.logic_or, nearer)} if nearer else {}
        return (Block("are sigma points half a turn off?", raised),) if nearer else ()

    def transformed(self, middle: Graph, above: list[Graph], below: list[Graph]) -> Transformed:
        """Return the sums of a map m, from m(z) = `middle`, m(z + g s_i) = `above` and m(z - g s_i) = `below`."""
        pairs = list(zip(above, below, strict=True))
        halves = [1 / (2 * reach) for reach in self.reaches]
        slopes = ca.horzcat(*(half * (up - down) for half, (up, down) in zip(halves, pairs, strict=True)))
        sums = (half * (up - middle + (down - middle)) for half, (up, down) in zip(halves, pairs, strict=True))
        curvatures = ca.horzcat(*sums)
        drift = ca.sum2(curvatures) * (1 / self.reach)
        if self.angles:
            drift = sum(curvatures[:, i] / reach for i, reach in enumerate(self.reaches))
        if self.more < 0:
            n = len(pairs)
            share = (1 - sqrt(max(0.0, 1 + n * self.more / self.reach**2))) / n
            curvatures = ca.horzcat(*(curvatures[:, i] - share * self.reach * drift for i in range(n)))
        return Transformed(middle, slopes, curvatures, drift)

    def nearest_value(self, middle: Graph, point: Graph, output: int) -> Graph:
        """Return the value (scalar) of an output at a sigma point; for a periodic output the whole turn nearest to the
        value `middle` at the estimate."""
        return at_nearest_turn(self.part.dynamics.form.system.outputs[output], self.output(point, output), middle)

    def prediction(self) -> Program:
        """Return the statements that advance each sigma point by a model step, then compute z and S from all points."""
        n, sides = self.part.dynamics.n, {"above": "z + g s_", "below": "z - g s_"}
        points = {"middle": ("z", self.z)}
        for (side, title), drawn in zip(sides.items(), self.points(), strict=True):
            points |= {f"{side}_{i + 1}": (f"{title}{i + 1}", z) for i, z in enumerate(drawn)}
        read = {name: sym("work", name, n) for name in points}
        sums = self.transformed(read["middle"], *([read[f"{side}_{i + 1}"] for i in range(n)] for side in sides))
        drift = sqrt(max(0.0, self.more)) * sums.drift
        added = root_of(*self.noise(self.stages()))
        S, names = triangle(ca.horzcat(sums.slopes, sums.curvatures, drift, added), self.least)
        after = {Place("state", self.part.z.name): sums.middle + sums.drift, **self.writes(S)}
        blocks, noise = [], "Q" if self.motion.map else "h Q"
        for name, (title, point) in points.items():
            stages = self.stages(point)
            result = {Place("work", name): stages.result["z"]}
            blocks.append(Block(f"{title} by {self.motion.name}", result, stages.names))
        return (
            *self.limited,
            *blocks,
            Block(f"the mean of the points, and P = S S' of their covariance + {noise}", after, names),
        )

    def sums(self, output: int) -> Transformed:
        """Return the sums of an output that is not linear at the sigma points."""
        middle = self.output(self.z, output)
        above, below = ([self.nearest_value(middle, z, output) for z in side] for side in self.points())
        return self.transformed(middle, above, below)

    def observed(self, outputs: Sequence[int]) -> tuple[Graph, Graph, Graph]:
        """Return three sums over the sigma points for several outputs: the slopes (k, n), the part of the covariance
        (k, k) that these do not explain, and the drift (k). An output that is linear in z needs no sigma points."""
        n, rows = self.part.dynamics.n, []
        for j in outputs:
            if self.linear(j):
                slopes = (self.root.T @ self.row(j).T).T
                rows.append(Transformed(ca.SX(0), slopes, ca.SX.zeros(1, n), ca.SX(0)))
            else:
                rows.append(self.sums(j))
        drift = ca.vertcat(*(row.drift for row in rows))
        a, b = (ca.vertcat(*parts) for parts in zip(*((row.slopes, row.curvatures) for row in rows), strict=True))
        return a, b @ b.T + max(0.0, self.more) * (drift @ drift.T), drift

    def joint(self, outputs: tuple[int, ...]) -> Joint:
        """Return the joint innovations of these outputs."""
        a, curved, drift = self.observed(outputs)
        return Joint((), drift, a @ a.T + curved + self.sample_noise(outputs))

    def joint_correction(self) -> Program:
        """Return the statements that correct by all samples that wait, from the sigma points of the prediction."""
        n, every = self.part.dynamics.n, range(self.clock.outputs)
        a, curved, drift = self.observed(every)
        L, d = decorrelated(self.used_noise() + curved, self.waiting)
        error = whitened(L, self.errors(self.part.dynamics.output(self.z, self.clock.u_now), drift))
        rows, values = Place("work", "rows"), {Place("work", "errors"): error, Place("work", "variances"): d}
        values[rows] = ca.densify(ca.vec(whitened(L, a)))
        read = ca.reshape(sym(*rows, n * len(every)), len(every), n)
        limited = () if all(map(self.linear, every)) else self.limited
        return (
            *limited,
            Block("what the sigma points read, with independent noises", values),
            *self.together(read, sym("work", "variances", len(every)), sym("work", "errors", len(every))),
        )

    def correction(self, output: int) -> Program:
        """Return the update by a sample of an output; a nonlinear output is evaluated at the sigma points."""
        r, e = self.used_variance(output), sym("work", "e")
        if self.linear(output):
            f, title = self.root.T @ self.row(output).T, "correct by the scalar update"
        else:
            sums = self.sums(output)
            f, title = sums.slopes.T, "correct by what the sigma points read"
            r = r + ca.sumsqr(sums.curvatures) + max(0.0, self.more) * sums.drift**2
            e = self.part.dynamics.output_error(output, e, sums.drift)
        S, gain = carlson(self.root, f, r)
        limited = () if self.linear(output) else self.limited
        return (*limited, *self.corrected(gain, e, self.writes(S), title))


@dataclass(frozen=True)
class Iterated(SquareRoot):
    """An iterated extended Kalman filter on P = S S', with `passes` >= 1 Gauss-Newton passes at each sample."""

    passes: int
    rule = RULE

    def scaled_row(self, w: Graph, output: int) -> Graph:
        """Return f = S'c' (n), c = dh/dz of an output at z + S w."""
        slope = self.part.dynamics.output_jacobian(self.z + self.root @ w, self.clock.u_now)
        return self.root.T @ slope[output, :].T

    def error(self, w: Graph, output: int) -> Graph:
        """Return y - h(z + S w), with y - h(z) the innovation."""
        measured = sym("work", "e") + self.output(self.z, output)
        return self.part.dynamics.output_error(output, measured, self.output(self.z + self.root @ w, output))

    def cost(self, w: Graph, output: int) -> Graph:
        """Return the cost J(w) = |w|^2 + (y - h(z + S w))^2/r of a sample of an output of variance r, SX scalar."""
        return ca.sumsqr(w) + self.error(w, output) ** 2 / self.used_variance(output)

    def joint_correction(self) -> Program:
        """Return the Gauss-Newton passes on the cost of all samples that wait, then z and S."""
        n, every, used = self.part.dynamics.n, range(self.clock.outputs), self.waiting
        if all(map(self.linear, every)):
            return super().joint_correction()
        w, dynamics = sym("work", "offset", n), self.part.dynamics
        noise = self.used_noise()
        L, d = decorrelated(noise, used)

        def rows(w: Graph) -> Graph:
            return dynamics.output_jacobian(self.z + self.root @ w, self.clock.u_now) @ self.root

        def error(w: Graph) -> Graph:
            return self.errors(dynamics.output(self.z + self.root @ w, self.clock.u_now))

        def cost(w: Graph) -> Graph:
            return ca.sumsqr(w) + ca.dot(whitened(L, error(w)) ** 2, 1 / d)

        a = ca.vertcat(*(ca.if_else(ok, 1, 0) * rows(w)[j, :] for j, ok in enumerate(used)))
        target = a.T @ solve(a @ a.T + used_block(noise, used), error(w) + a @ w)
        passes = self.by_halved_steps(target, cost)
        at = {Place("work", "rows"): ca.densify(ca.vec(whitened(L, rows(w)))), Place("work", "variances"): d}
        read = ca.reshape(sym("work", "rows", n * len(every)), len(every), n)
        return (
            *passes,
            Block("the rows at the estimate, with independent noises", at),
            *self.together(read, sym("work", "variances", len(every))),
        )

    def by_halved_steps(self, target: Graph, cost: Callable[[Graph], Graph]) -> Program:
        """Return the passes w <- w + s (target - w), from w = 0 and s = 1; a pass that would not decrease the `cost`
        J(w) leaves w and halves s."""
        n = self.part.dynamics.n
        w, share, before = sym("work", "offset", n), sym("work", "share"), sym("work", "cost")
        begin = {Place("work", "offset"): ca.SX.zeros(n), Place("work", "share"): ca.SX(1)}
        tried = w + share * (target - w)
        value = cost(tried)
        better = value < before
        again = {
            Place("work", "offset"): ca.if_else(better, tried, w),
            Place("work", "cost"): ca.if_else(better, value, before),
            Place("work", "share"): ca.if_else(better, 1, share / 2),
        }
        return (
            Block("begin at the prediction", {**begin, Place("work", "cost"): cost(ca.SX.zeros(n))}),
            *(Block(f"pass {k + 1}", again) for k in range(self.passes)),
        )

    def correction(self, output: int) -> Program:
        """Return the Gauss-Newton passes as blocks, then z and S; for a linear output the scalar update."""
        if self.linear(output):
            return super().correction(output)
        w, root = sym("work", "offset", self.part.dynamics.n), self.root
        f, r = self.scaled_row(w, output), self.used_variance(output)
        target = f * (self.error(w, output) + ca.dot(f, w)) / (r + ca.sumsqr(f))
        S, _ = carlson(root, f, r)
        after = {Place("state", self.part.z.name): self.z + root @ w, **self.writes(S)}
        return (
            *self.by_halved_steps(target, partial(self.cost, output=output)),
            Block("correct by the offset, and P at the estimate", after),
        )
