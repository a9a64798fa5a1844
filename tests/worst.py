"""What is worst for an error whose slopes are held, and what is proved of it call by call, as numbers in floats."""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product

import numpy as np

from hgogen.call import CallableStep
from hgogen.certificates.contraction import contraction
from hgogen.certificates.start_set import _in_form, start_of
from hgogen.emit import layout
from hgogen.emit.saved import sealed
from hgogen.program import Field
from hgogen.prove.inclusion import state_row
from hgogen.prove.inequality import Inputs, corners
from hgogen.prove.plant_step import Sizes, heads_of
from hgogen.prove.quadratic import floats, rational
from hgogen.prove.questions import peak_errors
from hgogen.signal import LOST

Array = np.ndarray
SLOPES = 16  # corners of the slopes whose responses are taken
DIED, MOST = 0.02, 500  # of a response, where it is cut; and after how many calls


@dataclass(frozen=True, eq=False)
class Response:
    """Of one state to what came `age` calls before, its slopes held: of its error to a `sample` (J, p), to what is
    `beside` a row of the form (J, n) in the call that began then, and to first errors of each state (J, n)."""

    sample: Array
    beside: Array
    first: Array


class Worst:
    """Of a step that is proved."""

    def __init__(self, step: CallableStep) -> None:
        known, self.form = contraction(step), step.observer.form
        assert known.proof is not None
        self.step, self.observer, self.steps, self.proof = step, step.observer, known.proof.steps, known.proof
        self.error, self.at = known.proof.steps.error, known.proof.step
        start = start_of(step.observer, known.proof.steps)
        assert start is not None
        self.start = start
        self.first = np.array([float(x) for x in start.first])
        self.scales = np.array([float(x) for x in start.scales])
        ones = [1.0] * len(self.scales)
        self.fields = np.array([float(x) for x in _in_form(step.observer, self.error, ones)])  # in units of states
        self._kind = layout.state_type(step)
        self.fed, self.index = np.array(self.error.layout.fed), np.array(self.error.layout.index)

    @property
    def _fields(self) -> list[Field]:
        """Those of the estimator, in the order of its errors."""
        return [field for part in self.observer.parts for field in getattr(part, "fields", ())]

    def saved(self, z: Array) -> list[bytes]:
        """The states of programs before their first call that begin at estimates z (B, n)."""
        self.step.reset()
        return self._with(np.frombuffer(bytes(self.step._kept.state) * len(z), self._kind), self.fed * z[:, self.index])

    def between(self, fields: Array, u: Array, y: Array) -> list[bytes]:
        """Those between two calls, at fields (B, N) in units of the states, that were given u (B, m) and y (B, p)."""
        self.step.reset()
        states = np.frombuffer(bytes(self.step._kept.state) * len(fields), self._kind).copy()
        for name, values in {"u": u, "y": y, "y_valid": np.ones_like(y)}.items():
            if values.shape[1]:
                states[name] = values.reshape(states[name].shape)
        states["calls"] = 1
        return self._with(states, fields)

    def _with(self, states: Array, fields: Array) -> list[bytes]:
        states, rows = states.copy(), iter((fields / self.fields).T)
        for field in self._fields:
            values = np.array([next(rows) for _ in range(field.size)])
            states[field.name] = values[0] if field.size == 1 else values.T
        return [sealed(self.step, self.step.real, state.tobytes()) for state in states]

    def fields_of(self, memory: Array) -> Array:
        """The fields (B, N) in states as bytes (B, size), in units of the states."""
        states = memory.copy().view(self._kind)[:, 0]
        return np.hstack([states[field.name].reshape(len(states), -1) for field in self._fields]) * self.fields

    def norm(self, errors: Array) -> Array:
        """|e|_P^2 (B) of errors of fields (B, N)."""
        e, P = errors * self.scales, floats(rational(self.proof.weights.P))
        return np.asarray(((e @ P) * e).sum(axis=1))

    def pairs(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Two estimates each, (2 count, N): some anywhere in their box, near ones or far ones; others apart in the
        direction that a step shrinks least, its slopes held at their ends."""
        ends = np.array([ends for field in self._fields for ends in field.box_within(LOST)]).T * self.fields
        states = np.array([x.interval for x in self.form.states], dtype=float).T[:, self.index]
        wide = (np.ptp(states, axis=0) * self.scales)[self.fed].max() / self.scales  # of a filter, which has no box
        low, high = np.where(self.fed, np.sort(ends, axis=0), [-wide, wide])
        inner = np.where(self.fed, states, [-wide / 9, wide / 9])
        one = np.vstack([rng.uniform(*each, (count, len(low))) for each in ((low, high), inner)])
        beside = np.vstack([self._directions(rng, count // 2, way) * (high - low).max() for way in (False, True)] * 2)
        other = one + beside * 10 ** rng.uniform(-4, 0, (2 * count, 1))
        return one, np.clip(other, low, high)

    def _directions(self, rng: np.random.Generator, count: int, worst: bool) -> Array:
        """Directions (count, N) of the largest size 1."""
        way = rng.standard_normal((count, len(self.scales)))
        if worst:
            P = floats(rational(self.proof.weights.P))
            root = np.linalg.cholesky(P).T
            T = root @ self.at.frozen(self.slopes) @ np.linalg.inv(root)
            worst_ones = np.linalg.svd(T)[2][:, 0] @ np.linalg.inv(root).T
            way = worst_ones[rng.integers(len(T), size=count)] * (1 + 0.02 * way)
        way = way / self.scales
        return np.asarray(way / np.abs(way).max(axis=1)[:, None])

    def left(self, calls: int) -> Array:
        """How far first errors go (calls, n) as their norm falls."""
        rows = {k: state_row(self.start.scales, k) for k in self.error.layout.picks}
        far = peak_errors(rational(self.proof.weights.P), self.start.corners, rows)
        falls = (1 - float(self.proof.alpha * self.proof.h)) ** (np.arange(calls) / 2)
        return falls[:, None] * np.array([float(far[k]) for k in self.error.layout.picks])

    @cached_property
    def slopes(self) -> Array:
        """Corners of them (k, m), those with which errors decay slowest first."""
        d = corners(self.at.slopes)
        slow = np.abs(np.linalg.eigvals(self.at.frozen(d))).max(axis=1)
        self.slowest = float(slow.max())
        return d[slow.argsort()[::-1][:SLOPES]]

    @property
    def calls(self) -> int:
        """After which the slowest response has died."""
        _ = self.slopes
        return min(MOST, math.ceil(math.log(DIED) / math.log(self.slowest)))

    @cached_property
    def responses(self) -> list[Response]:
        """Of each state, of each of the corners."""
        p, n = len(self.form.output), self.form.n
        each = [Sizes(samples=tuple(Fraction(i == j) for i in range(p))) for j in range(p)]
        each += [Sizes(deviation=tuple(Fraction(i == j) for i in range(n))) for j in range(n)]
        shown = heads_of(self.form)
        assert shown is not None
        inputs = Inputs.of([size.inputs(self.at, self.error, self.start.scales, shown) for size in each])
        return [self._response(d, inputs, i, p) for d, i in product(self.slopes, range(n))]

    def _response(self, d: Array, inputs: Inputs, state: int, p: int) -> Response:
        T, B = self._held(d, inputs)
        row = np.zeros(len(T))
        row[self.error.layout.picks[state]] = 1 / self.scales[self.error.layout.picks[state]]
        rows = [row]
        for _ in range(self.calls):
            rows.append(rows[-1] @ T)
        R = np.array(rows)  # (J + 1, N)
        ends, beside = (R @ B[:, : 2 * p]).reshape(len(R), p, 2), R @ B[:, 2 * p :]
        sample, before = ends[:, :, 1].copy(), np.zeros((1, B.shape[1] - 2 * p))
        sample[1:] += ends[:-1, :, 0]
        begins = np.array([[scale * (fed and i == j) for j in range(self.form.n)] for scale, fed, i in self._of])
        return Response(sample, np.vstack([before, beside[:-1]]), R @ begins)

    @property
    def _of(self) -> list[tuple[float, bool, int]]:
        return list(zip(self.scales.tolist(), self.fed.tolist(), self.index.tolist(), strict=True))

    def _held(self, d: Array, inputs: Inputs) -> tuple[Array, Array]:
        """e+ = T e + B v of slopes d (m) that are the same at all stages."""
        n, size = self.at.D.shape
        D, Q, q = floats(self.at.D), floats(self.at.Q), inputs.D.shape[1]
        v, enters = np.zeros((size, n + q)), np.hstack([np.zeros((len(Q), n)), floats(inputs.Q)])
        v[:n, :n] = np.eye(n)
        for i, row in enumerate(Q):
            v[n + i] = d[i % self.at.slopes] * (row @ v + enters[i])
        step = float(self.at.h) * (D @ v + np.hstack([np.zeros((n, n)), floats(inputs.D)]))
        return np.eye(n) + step[:, :n], step[:, n:]
