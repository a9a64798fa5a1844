"""The innovations of a run, their variances and the covariance of its estimates, by a replay of its samples.

    e = y - h(z),   S = C P C' + R        z, P as they are after the prediction, before any sample corrects them

of all outputs together; s_j = S_jj. For a late sample z and P are those after the prediction of the period of its
measurement, which outputs do not share, so that there is no S. An observer that integrates with the measurement has no
prediction: its z and P of the last sample are predicted by the model, z by classical Runge-Kutta and P <- Phi P Phi' +
h Q_theta.

The covariance is that of a Riccati observer, as its method stores it, at records (N) in the layout of the C structs:

    P = L D L', S S', P itself or the inverse of S
    C = dh/dz,   R = R_theta/h of a sample,   h the output's sampling period
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hgogen.discretisation.runge_kutta import RK4, advance, evaluated
from hgogen.emit.syntax import DTYPE, Real
from hgogen.estimators.factored import FilterStep
from hgogen.estimators.riccati_part import Riccati, SampledFilter
from hgogen.graph import Graph, sx
from hgogen.program import Field, Group, Place, address, sym
from hgogen.reading.given import names_of
from hgogen.run.backends import StepMemory
from hgogen.run.gates import UNUSED, GateShare, gate_shares, gated, raised
from hgogen.run.samples import Engine, at_measurement_time
from hgogen.signal import differences
from hgogen.step import Step
from hgogen.stepping.parallel import Parallel

Array = np.ndarray
CHUNK = 4096  # samples whose memory is stored at a time
PREDICTED = Place("work", "predicted")


@dataclass(frozen=True)
class Evaluated:
    """An SX matrix that depends on places of a step's memory; a call evaluates it at records of the memory."""

    step: Step
    matrix: Graph

    def __call__(self, records: Array, signals: dict[Place, Array] | None = None) -> Array:
        """Return the values (N, rows, columns) of the matrix at records (N) of a step's memory; `signals`: (N, size) by
        place, for places that the records do not have."""
        values = [
            signals[place] if signals and place in signals else values_at(self.step, records, place)
            for place, _ in self._reads
        ]
        rows, columns = self.matrix.shape
        if not values or not len(records):
            wide = np.zeros((rows, 0)) if values else np.array(self._graph()["o0"])
            wide = wide if values else np.tile(wide, len(records))
            return np.asarray(wide.reshape(rows, len(records), columns).swapaxes(0, 1))
        return evaluated(self._graph.map(len(records)), *values).reshape(-1, columns, rows).swapaxes(1, 2)

    @cached_property
    def _reads(self) -> tuple[tuple[Place, int], ...]:
        return tuple(sorted({(place, size) for place, _, size in map(address, ca.symvar(self.matrix))}))

    @cached_property
    def _graph(self) -> ca.Function:
        return ca.Function("at", [sym(*place, size) for place, size in self._reads], [ca.densify(self.matrix)])


def values_at(step: Step, records: Array, place: Place) -> Array:
    """Return the values (N, size) of a place of the state or the parameters in records (N) of a step's memory."""
    if place.struct in ("plant", "gain", "derived"):
        return _columns(records["params"][place.struct][place.name])
    state = records["state"]
    inside = place.name in (state.dtype.names or ())
    return _columns((state if inside else selected(records))[place.name])


def selected(records: Array) -> Array:
    """Return the records (N) of the selected member of a bank of observers, from records (N) of a step's memory."""
    state = records["state"]
    return np.asarray(state["member"][np.arange(len(state)), state["selected"]])


def _columns(values: Array) -> Array:
    return np.asarray(values, dtype=float).reshape(len(values), -1)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The covariance of the estimate of a step with a Riccati observer; with a group of `members`, a bank of observers,
    that of the selected member."""

    step: Step
    part: Riccati
    members: Group | None = None

    def covariance(self, records: Array) -> Array:
        """Return the covariance P (N, n, n) in the form's coordinates, from records (N) of the step's memory."""
        if "P" in self._fields:
            return self._triangle("P", records, symmetric=True)
        if "S" in self._fields:
            return np.asarray(np.linalg.inv(self._triangle("S", records, symmetric=True)))
        if "root" in self._fields:
            root = self._triangle("root", records)
            return np.asarray(root @ root.swapaxes(1, 2))
        L, D = np.eye(self.part.dynamics.n), values_at(self.step, records, Place("state", "D"))[:, None, :]
        if "L" in self._fields:
            L = self._triangle("L", records) + L
        elif any(group.name == "column" for group in (self.members or self.step.layout).groups):
            state = selected(records) if self.members else records["state"]
            L = np.tril(np.asarray(state["column"]["v"], dtype=float).swapaxes(1, 2), -1) + L
        return np.asarray((L * D) @ L.swapaxes(-2, -1))

    @cached_property
    def rows(self) -> Evaluated:
        """The output Jacobian dh/dz as a matrix (N, p, n) to be evaluated at records (N) of the step's memory."""
        return Evaluated(self.step, self.part.dynamics.output_jacobian(self.step.observer.z, self.step.clock.u_now))

    @cached_property
    def noise(self) -> Evaluated:
        """The covariance R of the noise of a sample as a matrix (N, p, p) to be evaluated at records (N) of the step's
        memory."""
        filter_step = FilterStep(self.part, self.step.clock)
        return Evaluated(self.step, filter_step.sample_noise(range(len(self.step.outputs))))

    def innovation(self, C: Array, P: Array, records: Array) -> Array:
        """Return the innovation covariance C P C' + R (N, p, p), with the output Jacobian C (N, p, n) and the predicted
        covariance P (N, n, n), at records (N) of the step's memory."""
        return np.asarray(C @ P @ C.swapaxes(1, 2) + self.noise(records))

    def predicted(self, P: Array, records: Array, signals: dict[Place, Array]) -> Array:
        """Return the predicted covariance exp(rho h) Phi P Phi' + h Q_theta (N, n, n), with h the period, rho the
        forgetting rate; `signals`: values by place, for places that the records do not have."""
        transition, noise, rho = self._motion
        Phi = transition(records, signals)
        growth = np.exp(self.step.dt * rho(records))
        return np.asarray(growth * (Phi @ P @ Phi.swapaxes(1, 2)) + noise(records, signals))

    @cached_property
    def _fields(self) -> dict[str, Field]:
        return {field.name: field for field in (self.members.fields if self.members else self.step.layout.state)}

    def _triangle(self, name: str, records: Array, symmetric: bool = False) -> Array:
        packed, n = values_at(self.step, records, Place("state", name)), self.part.dynamics.n
        whole = np.zeros((len(packed), n, n))
        for k, (i, j) in enumerate(self._fields[name].entries):
            whole[:, i - 1, j - 1] = packed[:, k]
            if symmetric:
                whole[:, j - 1, i - 1] = packed[:, k]
        return whole

    @cached_property
    def _motion(self) -> tuple[Evaluated, ...]:
        """Phi, h Q_theta and rho of the predicted covariance exp(rho h) Phi P Phi' + h Q_theta."""
        n, filter_step = self.part.dynamics.n, FilterStep(self.part, self.step.clock)
        stages = filter_step.stages()
        W, w = filter_step.noise(stages)
        noise = W @ ca.diag(w) @ W.T if self.part.factor.size else ca.SX(n, n)
        graphs = (filter_step.transition(filter_step.jacobian(stages)), noise, sx(self.part.rho))
        return tuple(Evaluated(self.step, graph) for graph in graphs)


def uncertainty(step: Step) -> Uncertainty | None:
    """Return the covariance of a step's estimate; None where the step has not exactly one. For a sigma-point filter the
    innovation variance s uses the Jacobian of h, which is exact for an output linear in the state."""
    parts, members = step.observer.parts, None
    if len(parts) == 1 and isinstance(parts[0], Parallel):
        parts, members = parts[0].member.parts, next(group for group in step.layout.groups if group.name == "member")
    plain = [part.plain if isinstance(part, SampledFilter) else part for part in parts]
    filters = [part for part in plain if isinstance(part, Riccati)]
    return Uncertainty(step, filters[0], members) if len(filters) == 1 else None


def used(step: Step, status: Array) -> Array:
    """Return the mask (N, p) of the samples of outputs that a step used, from its status (N)."""
    usable = ~raised(step, status, UNUSED, names_of(step.outputs))
    for group in gated(step):
        usable[:, group.outputs] &= ~raised(step, status, ("GATED",), (group.name,))
    return usable


@dataclass(frozen=True)
class Innovations:
    """The innovations e (N, p) of a log, NaN where a sample was not used; their `variances` (N, p), and `joint` (N, p,
    p), their covariance, None for late samples; the `covariance` (N, n, n) of the estimates after each sample, in the
    plant's states; None without a covariance."""

    e: Array
    variances: Array | None
    joint: Array | None
    covariance: Array | None


@dataclass(frozen=True, eq=False)
class Replay:
    """A replay of the samples u (N, m), y (N, p) of a run, which had the statuses `status` (N), from the `memory`
    before the first sample; y also has the columns of ages for outputs that may be late."""

    step: Step
    memory: bytes
    u: Array
    y: Array
    status: Array
    engine: Engine
    real: Real

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the outputs."""
        return tuple(y.name for y in self.step.outputs)

    def gates(self, status: Array) -> tuple[GateShare, ...]:
        """Return the share of the samples beyond each gate in calls with this status (N)."""
        return gate_shares(self.step, status)

    @cached_property
    def innovations(self) -> Innovations:
        """The innovations of the run, with their variances."""
        parts = list(self._parts())
        e = np.concatenate([one.e for one in parts]) if parts else np.zeros((0, len(self.step.outputs)))
        usable = used(self.step, self.status) & np.isfinite(self.y[:, : len(self.outputs)])

        def whole(arrays: list[Array | None]) -> Array | None:
            there = [array for array in arrays if array is not None]
            return np.concatenate(there) if there else None

        variances = whole([one.variances for one in parts])
        return Innovations(
            np.where(usable, e, np.nan),
            None if variances is None else np.where(usable, variances, np.nan),
            whole([one.joint for one in parts]),
            whole([one.covariance for one in parts]),
        )

    def _parts(self) -> Iterator[Innovations]:
        memory = StepMemory(self.step, self.real)
        memory.entries(self.engine)
        memory.whole[:] = self.memory
        for first in range(0, len(self.y), CHUNK):
            u, y = self.u[first : first + CHUNK], self.y[first : first + CHUNK]
            with np.errstate(all="ignore"):  # a number beyond a float becomes infinite, a missing sample
                rows = np.hstack([u, y]).astype(DTYPE[self.real])
                if self.step.code.separable:
                    yield self._by_sections(y[:, : len(self.outputs)], *self._sections(memory, rows))
                else:
                    yield self._integrated(y, *self._calls(memory, rows))

    def _sections(self, memory: StepMemory, rows: Array) -> tuple[Array, Array]:
        entries, sections = memory.entries(self.engine), self.step.code.sections[1:]
        before, after = (np.zeros(len(rows), memory.record.dtype) for _ in range(2))
        for k, row in enumerate(rows):
            memory.signals[:] = row
            entries["predict"]()
            before[k] = memory.record[0]
            for section in sections:
                entries[section.name]()
            after[k] = memory.record[0]
        return before, after

    def _calls(self, memory: StepMemory, rows: Array) -> tuple[Array, Array]:
        call = memory.entries(self.engine)["step"]
        records = np.zeros(len(rows) + 1, memory.record.dtype)
        records[0] = memory.record[0]
        for k, row in enumerate(rows, 1):
            memory.signals[:] = row
            call()
            records[k] = memory.record[0]
        return records[:-1], records[1:]

    @cached_property
    def _uncertainty(self) -> Uncertainty | None:
        return uncertainty(self.step)

    def _by_sections(self, y: Array, before: Array, after: Array) -> Innovations:
        each, late = [at_measurement_time(self.step, before, j) for j in range(y.shape[1])], bool(self.step.ages)
        predicted = np.column_stack([self._read(records)[:, j, 0] for j, records in enumerate(each)])
        e = differences(self.step.outputs, y, predicted)
        if (known := self._uncertainty) is None:
            return Innovations(e, None, None, None)
        every = [known.innovation(known.rows(at), known.covariance(at), at) for at in (each if late else each[:1])]
        s = np.column_stack([every[j * late][:, j, j] for j in range(y.shape[1])])
        return Innovations(e, s, None if late else every[0], self._plant_covariance(after))

    def _integrated(self, y: Array, before: Array, after: Array) -> Innovations:
        fields = {field.name for field in self.step.layout.state}
        pairs = [("u", "u", after), ("y", "y", after), ("y_last", "y", before), ("valid", "y_valid", after)]
        pairs += [("h", "elapsed", after)]
        signals = {
            Place("work", name): values_at(self.step, records, Place("state", field))
            for name, field, records in pairs
            if field in fields
        }
        at, onward, read, slopes = self._model
        first = (values_at(self.step, before, Place("state", "calls"))[:, 0] == 0)[:, None]
        z = np.where(first, at(before)[:, :, 0], onward(before, signals)[:, :, 0])
        signals |= {PREDICTED: z}
        e, C = (
            differences(self.step.outputs, y[:, : len(self.outputs)], read(after, signals)[:, :, 0]),
            slopes(after, signals),
        )
        if self._uncertainty is None:
            return Innovations(e, None, None, None)
        P = self._uncertainty.covariance(before)
        P = np.where(first[:, :, None], P, self._uncertainty.predicted(P, before, signals))
        S = self._uncertainty.innovation(C, P, before)
        return Innovations(e, np.diagonal(S, axis1=1, axis2=2), S, self._plant_covariance(after))

    def _plant_covariance(self, after: Array) -> Array:
        assert self._uncertainty is not None
        J = self._slope(after)
        return np.asarray(J @ self._uncertainty.covariance(after) @ J.swapaxes(1, 2))

    @cached_property
    def _read(self) -> Evaluated:
        observer = self.step.observer
        return Evaluated(self.step, observer.dynamics.output(observer.z, self.step.clock.u_now))

    @cached_property
    def _model(self) -> tuple[Evaluated, ...]:
        observer, clock = self.step.observer, self.step.clock
        z, dynamics = sym(*PREDICTED, observer.z.numel()), observer.dynamics
        if self._uncertainty:
            stages = FilterStep(self._uncertainty.part, clock).stages()
        else:
            flow = dynamics.flow
            stages = advance(RK4, lambda v, c: {"z": flow(v["z"], clock.u(c))}, {"z": observer.z}, clock.h)
        read = dynamics.output(z, clock.u_now), dynamics.output_jacobian(z, clock.u_now)
        return tuple(Evaluated(self.step, graph) for graph in (observer.z, stages.result["z"], *read))

    @cached_property
    def _slope(self) -> Evaluated:
        """The Jacobian dx/dz (n, n) of the plant's states x by the
        form's coordinates z, at z clamped to its ranges."""
        observer = self.step.observer
        return Evaluated(self.step, observer.dynamics.estimate_jacobian(observer.z, self.step.clock.u_now))
