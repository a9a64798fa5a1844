"""The innovations of a run, their variances and the covariance of its estimates, by its samples taken once more.

    e_j = y_j - h_j(z),   s_j = c P c' + r        z, P as they are just before y_j corrects them

so that an output counts with those before it in the same sample; of a step for late samples, as the prediction left
them of the period in which the sample was taken, when it came. An observer that integrates with the measurement has
no such moment: there z and P are those of the last sample, moved on by the model, z by classical Runge-Kutta and
P <- Phi P Phi' + h Q_theta, and corrected by the outputs before it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hgogen.emit.syntax import DTYPE, Real
from hgogen.program import Place, sym
from hgogen.run.covariances import Evaluated, Uncertainty, clock_of, motion, shown, uncertainty, used, values_at
from hgogen.run.late import remembered
from hgogen.run.readers import Kept
from hgogen.run.samples import Engine
from hgogen.step import Step

Array = np.ndarray
CHUNK = 4096  # samples whose memory is held at a time
PREDICTED = Place("work", "predicted")


@dataclass(frozen=True)
class Innovations:
    """Of a record: e (N, p), NaN where a sample was not used; their `variances` (N, p) and the `covariance` (N, n, n)
    of the estimates after each sample, in the plant's states; None of an observer that holds none."""

    e: Array
    variances: Array | None
    covariance: Array | None


@dataclass(frozen=True, eq=False)
class Replay:
    """The samples u (N, m), y (N, p) of a run that gave `status` (N), and the memory before the first of them; with y
    go the ages of samples that may be late."""

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

    @cached_property
    def innovations(self) -> Innovations:
        """What it shows."""
        parts = list(self._parts())
        e = np.concatenate([one.e for one in parts]) if parts else np.zeros((0, len(self.step.outputs)))
        taken = used(self.step, self.status) & np.isfinite(self.y[:, : len(self.outputs)])

        def whole(arrays: list[Array | None]) -> Array | None:
            there = [array for array in arrays if array is not None]
            return np.concatenate(there) if there else None

        variances = whole([one.variances for one in parts])
        return Innovations(
            np.where(taken, e, np.nan),
            None if variances is None else np.where(taken, variances, np.nan),
            whole([one.covariance for one in parts]),
        )

    def _parts(self) -> Iterator[Innovations]:
        memory = Kept(self.step, self.real)
        memory.entries(self.engine)
        memory.whole[:] = self.memory
        look = _Look(self.step, uncertainty(self.step))
        for first in range(0, len(self.y), CHUNK):
            u, y = self.u[first : first + CHUNK], self.y[first : first + CHUNK]
            with np.errstate(all="ignore"):
                if self.step.code.apart:
                    yield look.apart(y[:, : len(self.outputs)], *self._sections(memory, u, y))
                else:
                    yield look.moved(y, *self._calls(memory, u, y))

    def _sections(self, memory: Kept, u: Array, y: Array) -> tuple[list[Array], Array]:
        """The memory before each output corrects, and after each sample."""
        entries, sections = memory.entries(self.engine), self.step.code.sections[1:]
        before = [np.zeros(len(y), memory.record.dtype) for _ in self.step.outputs]
        after = np.zeros(len(y), memory.record.dtype)
        number = {signal.name: j for j, signal in enumerate(self.step.outputs)}
        correcting = {section.corrects for section in sections}
        silent = [j for name, j in number.items() if name not in correcting]  # their innovation is the prediction's
        for k, row in enumerate(self._rows(u, y)):
            memory.signals[:] = row
            entries["predict"]()
            for j in silent:
                before[j][k] = memory.record[0]
            for section in sections:
                if section.corrects:
                    before[number[section.corrects]][k] = memory.record[0]
                entries[section.name]()
            after[k] = memory.record[0]
        return [remembered(self.step, records, j) for j, records in enumerate(before)], after

    def _calls(self, memory: Kept, u: Array, y: Array) -> tuple[Array, Array]:
        call = memory.entries(self.engine)["step"]
        records = np.zeros(len(y) + 1, memory.record.dtype)
        records[0] = memory.record[0]
        for k, row in enumerate(self._rows(u, y), 1):
            memory.signals[:] = row
            call()
            records[k] = memory.record[0]
        return records[:-1], records[1:]

    def _rows(self, u: Array, y: Array) -> Array:
        with np.errstate(over="ignore"):  # what is beyond a float is infinite, and no sample
            return np.hstack([u, y]).astype(DTYPE[self.real])


@dataclass(frozen=True, eq=False)
class _Look:
    """Innovations of samples from what the step remembers."""

    step: Step
    uncertainty: Uncertainty | None

    def apart(self, y: Array, before: list[Array], after: Array) -> Innovations:
        """Of a step that corrects at samples: `before` each output, and `after` all."""
        e = np.column_stack([y[:, j] - self._read(records)[:, j, 0] for j, records in enumerate(before)])
        if self.uncertainty is None:
            return Innovations(e, None, None)
        s = np.zeros_like(e)
        for j, records in enumerate(before):
            c, P = self.uncertainty.rows(records)[:, j, :], self.uncertainty.covariance(records)
            s[:, j] = np.einsum("ki,kij,kj->k", c, P, c) + self.uncertainty.variances(records)[:, j, 0]
        return Innovations(e, s, self._of_plant(after))

    def moved(self, y: Array, before: Array, after: Array) -> Innovations:
        """Of a step that integrates with the measurement: `before` and `after` each sample."""
        fields = {field.name for field in self.step.layout.state}
        pairs = [("u", "u", after), ("y", "y", after), ("y_last", "y", before), ("valid", "y_valid", after)]
        signals = {
            Place("work", name): values_at(self.step, records, Place("state", field))
            for name, field, records in pairs
            if field in fields
        }
        at, onward, read, slopes = self._model
        first = (values_at(self.step, before, Place("state", "calls"))[:, 0] == 0)[:, None]
        z = np.where(first, at(before)[:, :, 0], onward(before, signals)[:, :, 0])
        signals |= {PREDICTED: z}
        e, C = y - read(after, signals)[:, :, 0], slopes(after, signals)
        if self.uncertainty is None:
            return Innovations(e, None, None)
        P = self.uncertainty.covariance(before)
        P = np.where(first[:, :, None], P, self.uncertainty.predicted(P, before, signals))
        r, s, shift = self.uncertainty.variances(before)[:, :, 0], np.zeros_like(e), np.zeros_like(z)
        for j in range(e.shape[1]):
            c = C[:, j, :]
            e[:, j] -= np.einsum("ki,ki->k", c, shift)
            s[:, j] = np.einsum("ki,kij,kj->k", c, P, c) + r[:, j]
            gain = np.where(np.isfinite(e[:, j : j + 1]), np.einsum("kij,kj->ki", P, c) / s[:, j : j + 1], 0.0)
            shift += gain * np.where(np.isfinite(e[:, j : j + 1]), e[:, j : j + 1], 0.0)
            P = P - np.einsum("ki,kj->kij", gain, np.einsum("ki,kij->kj", c, P))
        return Innovations(e, s, self._of_plant(after))

    def _of_plant(self, after: Array) -> Array:
        assert self.uncertainty is not None
        J = self._slope(after)
        return np.asarray(J @ self.uncertainty.covariance(after) @ J.swapaxes(1, 2))

    @cached_property
    def _read(self) -> Evaluated:
        observer = self.step.observer
        return Evaluated(self.step, observer.dynamics.output(observer.z, clock_of(self.step).u_now))

    @cached_property
    def _model(self) -> tuple[Evaluated, ...]:
        """z, z a sample on, and h and dh/dz at a z that is predicted."""
        observer, u = self.step.observer, clock_of(self.step).u_now
        z, dynamics = sym(*PREDICTED, observer.z.numel()), observer.dynamics
        graphs = (
            observer.z,
            motion(self.step, self.uncertainty),
            dynamics.output(z, u),
            dynamics.output_jacobian(z, u),
        )
        return tuple(Evaluated(self.step, graph) for graph in graphs)

    @cached_property
    def _slope(self) -> Evaluated:
        return Evaluated(self.step, shown(self.step))
