"""Which discretisations survive: FitzHugh-Nagumo by every method, and what is said of a step length beforehand.

"Survives" is finite and positive definite, no more. The table was first computed apart from this project, for the
reference trial's Q, R and P(0) = I.
"""

import warnings
from collections.abc import Iterator
from typing import Any

import neuron
import numpy as np
import pytest
from native_step import NativeStep
from oracle import fitzhugh_nagumo as oracle

import hgogen as hg
from hgogen import method
from hgogen.discretisation.stability import Limit
from hgogen.emit import layout
from hgogen.run import native
from hgogen.step import StepMayFail, StepTooLong
from hgogen.stepping import recovery

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

INFORMATION, COVARIANCE, FACTORED = hg.methods.rk4, hg.methods.rk4_covariance, hg.methods.continuous_discrete
ROOT = hg.methods.cholesky
TABLE = {  # dt: the largest theta that survives, and one that does not
    INFORMATION: {0.005: (16, 18), 0.01: (14, 16), 0.02: (12, 14), 0.05: (10, 12), 0.1: (8, 10)},
    COVARIANCE: {0.005: (100, None), 0.01: (100, None), 0.02: (80, 100), 0.05: (32, 40), 0.1: (16, 24)},
    FACTORED: dict.fromkeys((0.005, 0.01, 0.02, 0.05, 0.1), (100, None)),
    ROOT: dict.fromkeys((0.005, 0.01, 0.02, 0.05, 0.1), (100, None)),
}


def rows(*quick: tuple[Any, float]) -> Any:
    """The table's rows; all but those of `quick` are slow."""
    return pytest.mark.parametrize(
        ("how", "dt", "largest", "beyond"),
        [
            pytest.param(how, dt, *thetas, marks=() if (how, dt) in quick else pytest.mark.slow, id=f"{how.name}-{dt}")
            for how, row in TABLE.items()
            for dt, thetas in row.items()
        ],
    )


def forced(monkeypatch: pytest.MonkeyPatch, theta: float, how: Any, dt: float, **options: Any) -> Any:
    """The step, even where it would be refused, and by itself: nothing restarts it from a sample."""
    with monkeypatch.context() as patch:
        patch.setattr(recovery.Recovery, "signs", ())
        patch.setattr(method, "covariance_limits", lambda *_: [Limit(np.inf, "")])
        return neuron.step(float(theta), how, dt, **options)


def survives(step: Any, real: Any = None, duration: float = 30.0) -> bool:
    """Whether nothing is lost and the covariance stays positive definite, in Python's double or compiled as `real`."""
    scenario = oracle.Scenario((), duration)
    t = oracle.times(scenario, step.dt)
    x1 = oracle.truth(scenario, step.dt, substeps=max(1, round(step.dt / 0.002)))[:, 0]
    y = x1 + oracle.noise(range(1), len(t), dt=step.dt)[0]
    states = compiled(step, np.sin(t), y, real) if real else called(step, np.sin(t), y)
    floors = {field.name: field.low for field in step.layout.state if field.name in ("D", "root")}
    return all(not lost and definite(state, floors) for lost, state in states)


def called(step: Any, u: np.ndarray, y: np.ndarray) -> Iterator[tuple[bool, np.ndarray]]:
    """(whether a value was lost, the state) after each sample."""
    step.reset()
    for sample in zip(u, y, strict=True):
        flags = step(*sample).flags
        yield "RESTARTED" in flags, np.frombuffer(bytes(step._kept.state), layout.state_type(step))


def compiled(step: Any, u: np.ndarray, y: np.ndarray, real: Any) -> Iterator[tuple[bool, np.ndarray]]:
    """The same by the C."""
    native_step = NativeStep(step, real)
    for k in range(len(y)):
        status = native_step.run(u[k : k + 1], y[k : k + 1]).status[0]
        yield "RESTARTED" in step.flags(status), native_step.state


def definite(state: np.ndarray, floors: dict[str, tuple[float, ...]]) -> bool:
    """By the eigenvalues of S or P scaled to a unit diagonal; of L D L' and S S' by the diagonal, which must not lie on
    its floor."""
    for name, floor in floors.items():
        return bool((state[name][0] > np.array(floor, state[name].dtype)).all())
    (name,) = {"S", "P"} & set(state.dtype.names or ())
    packed, matrix = state[name][0].astype(float), np.empty((3, 3))
    rows, columns = np.triu_indices(3)
    matrix[columns, rows] = matrix[rows, columns] = packed
    diagonal = np.diag(matrix)
    if not np.isfinite(matrix).all() or diagonal.min() <= 0:
        return False
    return bool(np.linalg.eigvalsh(matrix / np.sqrt(np.outer(diagonal, diagonal)))[0] > 0)


@pytest.mark.ordinary("continuous-discrete, S S'-0.1")
@rows((INFORMATION, 0.01), (COVARIANCE, 0.05), (FACTORED, 0.1), (ROOT, 0.1))
def test_survival(monkeypatch: pytest.MonkeyPatch, how: Any, dt: float, largest: float, beyond: float | None) -> None:
    """Finite and positive definite over the first 30 time units of the trial."""
    assert survives(forced(monkeypatch, largest, how, dt))
    assert beyond is None or not survives(forced(monkeypatch, beyond, how, dt))


@needs_compiler
@rows()
def test_survival_in_float(
    monkeypatch: pytest.MonkeyPatch, how: Any, dt: float, largest: float, beyond: float | None
) -> None:
    assert survives(forced(monkeypatch, largest, how, dt), "float")
    assert beyond is None or not survives(forced(monkeypatch, beyond, how, dt), "float")


def test_a_large_initial_covariance_kills_rk4_on_p(monkeypatch: pytest.MonkeyPatch) -> None:
    """P(0) = 100 I: refused, and rightly; the factored step takes it."""
    large = {"covariance": (100.0,) * 3}
    assert not survives(forced(monkeypatch, 4, COVARIANCE, 0.01, **large), duration=5)
    with pytest.raises(StepTooLong):
        neuron.step(4.0, COVARIANCE, 0.01, **large)
    assert survives(neuron.step(4.0, FACTORED, 0.01, **large), duration=5)


@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
@rows((INFORMATION, 0.01), (FACTORED, 0.1), (ROOT, 0.02))
def test_what_the_table_has_is_admitted_and_what_it_has_not_refused(
    how: Any, dt: float, largest: float, beyond: float | None
) -> None:
    assert neuron.step(float(largest), how, dt).dt == dt
    if beyond is not None:
        with pytest.raises(StepTooLong):
            neuron.step(float(beyond), how, dt)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "theta"),
    [
        *((INFORMATION, theta) for theta in (4, 8, 10, 12, 14, 16)),
        *((COVARIANCE, theta) for theta in (4, 8, 12, 16, 20, 32, 80, 100)),
    ],
)
def test_refused_means_that_it_fails_and_admitted_that_it_survives(
    monkeypatch: pytest.MonkeyPatch, how: Any, theta: float
) -> None:
    """Admitted without a warning: at .95 of that length it survives. Refused: at 1.15 of the limit it fails.

    The limit is that of frozen Jacobians, and the trial's turns; up to some 10% beyond the limit it can survive.
    """
    part = neuron.observer(float(theta)).parts[0]
    limits = sorted(limit.dt for limit in method.covariance_limits(part, how.tableau, how.view))
    with warnings.catch_warnings():
        warnings.simplefilter("error", StepMayFail)
        assert survives(neuron.step(float(theta), how, 0.95 * limits[0]))
    with pytest.raises(StepTooLong) as refused:
        neuron.step(float(theta), how, 1.15 * limits[-1])
    assert refused.value.limit == limits[-1]
    assert not survives(forced(monkeypatch, theta, how, 1.15 * limits[-1]))
