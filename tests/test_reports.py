"""Reports of a step on its estimate: ages of samples and the like, in every language with the same bits."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import emitted
import numpy as np
import plants
import pytest
import sympy as sp
from oracle.kalman import kalman, transition
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import app
from hgogen.errors import HgogenError
from hgogen.model import load
from hgogen.reading.given import BadGain
from hgogen.run import native
from hgogen.run.uncertainty import uncertainty
from hgogen.stepping.machine import Machine
from hgogen.stepping.reports import OLDEST

NAN = float("nan")
N = 40
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def pendulum() -> hg.System:
    q, w = hg.Signal("q", "rad", low=-4, high=4), hg.Signal("w", "rad/s", low=-20, high=20)
    u, y, v = hg.Signal("u", "1/s2", low=-1, high=1), hg.Signal("y", "rad"), hg.Signal("v", "rad/s")
    flow = [w, -9 * sp.sin(q) - w / 5 + u]
    return hg.System("pendulum", states=(q, w), inputs=(u,), outputs=(y, v), flow=flow, output=[q, w + q / 4])


def filter_of(plant: hg.System, **options: Any) -> hg.Observer:
    form = hg.forms.original(plant)
    return hg.observers.riccati(form, Q=[0.3] * form.n, R=[0.02] * len(form.output), **options)


def samples(p: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (N, 1) and samples (N, p): of the first output all but 4, of the others every fourth."""
    t = 0.02 * np.arange(N)
    y = np.column_stack([0.3 * np.cos((j + 2) * t) for j in range(p)])
    y[np.arange(N) % 4 != 1, 1:] = NAN
    y[10:14, 0] = NAN
    y[20, 0] = 1e38  # rejected
    return np.sin(t)[:, None], y


def expected_ages(used: np.ndarray) -> np.ndarray:
    """The ages (N, p) by their definition, of samples (N, p) of which some were used."""
    ages = np.full(used.shape, OLDEST, dtype=float)
    for k, row in enumerate(used):
        before = ages[k - 1] if k else np.full(used.shape[1], OLDEST)
        ages[k] = np.where(row, 0, np.minimum(before + 1, OLDEST))
    return ages


METHODS: dict[str, Callable[[], Any]] = {
    "at samples": lambda: hg.methods.continuous_discrete,
    "integrated": lambda: hg.methods.rk4_covariance,
}


REPORTED = {"at samples": ("age", "innovation", "sigma"), "integrated": ("age", "sigma")}


@pytest.mark.parametrize("guards", ["all", "none"])
@pytest.mark.parametrize("method", METHODS)
def test_ages_count_the_calls_since_a_sample_was_used(method: str, guards: Any) -> None:
    u, y = samples()
    y = y if guards == "all" else np.nan_to_num(np.clip(y, -1, 1))
    step = hg.sample(filter_of(pendulum()), METHODS[method](), dt=0.02, report="age", guards=guards, engine="python")
    run = step.run(u=u, y=y)
    assert step.traces == ("age_y", "age_v")
    ages = np.column_stack([run.traces[name] for name in step.traces])
    assert np.array_equal(ages, expected_ages(np.abs(y) < 1e30))


@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("method", METHODS)
def test_every_engine_reports_the_same(method: str, real: Any) -> None:
    u, y = samples()
    step = hg.sample(filter_of(pendulum()), METHODS[method](), dt=0.02, report=REPORTED[method], real=real)
    runs = []
    for engine in ("c", "python"):
        step.reset()
        runs.append(step.run(u=u, y=y, engine=engine))
    step.reset()
    many = step.run_many(u=u, y=np.stack([y, y]), traces=True, engine="c")
    machine = Machine(step)
    _, traces, _ = machine.record(u, y)
    for j, name in enumerate(step.traces):
        assert np.array_equal(runs[0].traces[name], runs[1].traces[name], equal_nan=True)
        assert np.array_equal(runs[0].traces[name], many.traces[name][1], equal_nan=True)
        if real == "double":
            assert np.allclose(traces[:, j], runs[0].traces[name], rtol=1e-12, atol=1e-15, equal_nan=True)
    step.reset()
    single = [step(u=u[k], y=y[k]).traces for k in range(N)]
    assert all(
        single[k][name] == pytest.approx(runs[0].traces[name][k], nan_ok=True) for k in range(N) for name in single[k]
    )


def test_casadi_reports_the_same() -> None:
    u, y = samples()
    step = hg.sample(filter_of(pendulum()), dt=0.02, report=("age",), engine="python")
    f = hg.targets.casadi(step)
    assert [vector.names for vector in f.reports.values()] == [["age_y", "age_v"]]
    run, memory = step.run(u=u, y=y), f.memory.initial
    for k in range(N):
        memory, _, _, age = f.step(memory, u[k], y[k], f.p.initial)
        assert np.array_equal(np.ravel(age), [run.traces[name][k] for name in step.traces])


def test_a_sample_that_a_gate_rejects_renews_no_age() -> None:
    step = hg.sample(filter_of(pendulum(), gate={"y": 0.999}), dt=0.02, report=("age",), engine="python")
    ages = [step(u=0.0, y=(y, NAN)).traces["age_y"] for y in (0.1, 0.1, 0.1, 1e3, 1e3, 0.1)]
    assert ages == [0, 0, 0, 1, 2, 0]


def test_an_age_is_that_of_the_measurement_of_a_late_sample() -> None:
    plant = plants.chain(2)
    observer = hg.delayed(hg.observers.riccati(hg.forms.triangular(plant), Q=[0.1, 0.1], R=0.1), y=3)
    step = hg.sample(observer, dt=0.02, report=("age",), engine="python")
    ages = [step(u=0.0, y=(y, age)).traces["age_y"] for y, age in [(0.1, 0), (NAN, 0), (NAN, 0), (0.1, 1), (0.1, 0)]]
    assert ages == [0, 1, 2, 1, 0]
    assert step(u=0.0, y=(0.1, 3)).traces["age_y"] == 1  # older than the newest one


def test_an_age_counts_calls_of_predict_where_sensors_have_periods() -> None:
    step = hg.sample(filter_of(pendulum()), dt=0.02, periods={"v": 0.04}, report=("age",), engine="python")
    step.predict(u=0.0)
    step.update(0, y=0.1, v=0.2)
    assert step.predict(u=0.0).traces == {"age_y": 1, "age_v": 1}
    assert step.update(0, y=0.1).traces == {"age_y": 1, "age_v": 1}  # late, so that it is not used
    assert step.update(1, y=0.1).traces == {"age_y": 0, "age_v": 1}


def test_a_restart_changes_no_age_and_a_reset_does() -> None:
    u, y = samples()
    step = hg.sample(filter_of(pendulum()), dt=0.02, report=("age",), engine="python")
    step.run(u=u, y=y)
    saved = step.save()
    step.reset()
    assert step.run(u=u[:1], y=np.full((1, 2), NAN)).traces == {"age_y": OLDEST, "age_v": OLDEST}
    step.restore(saved)
    step._kept.record["state"]["z"][:] = 1e35  # a lost value: all memory of the filter starts anew
    sample = step(u=0.0, y=(NAN, NAN))
    assert "RESTARTED" in sample.flags
    assert sample.traces == {"age_y": 1, "age_v": 3}


def test_a_step_without_reports_is_as_it_was() -> None:
    with_, without = (hg.sample(filter_of(pendulum()), dt=0.02, report=names) for names in (("age",), ()))
    assert without.code.reports == ()
    assert without.traces == ()
    assert "age" not in hg.targets.c99(without, check=False)["pendulum.h"]
    assert "pendulum_age" in hg.targets.c99(with_, check=False)["pendulum.h"]
    assert with_.rebuilt(dt=0.01).traces == with_.traces
    assert with_.rebuilt(report=()).traces == ()


@pytest.mark.parametrize("report", [("ages",), "sigmas", 3, None, (1,)])
def test_names_of_no_report_are_refused(report: Any) -> None:
    with pytest.raises(HgogenError, match="report"):
        hg.sample(filter_of(pendulum()), dt=0.02, report=report)


TEXT = """
name = "oscillator"

[states.x]
flow = "v"
low = -2
high = 2

[states.v]
flow = "-x"
low = -2
high = 2

[outputs.y]
equation = "x"

[observer]
kind = "riccati"
Q = [1, 1]
R = 0.1
dt = 0.01
report = ["age"]
"""


def test_a_text_model_and_the_command_line_name_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.toml").write_text(TEXT)
    assert load(Path("model.toml")).step().traces == ("age_y",)
    Path("model.toml").write_text(TEXT.replace('report = ["age"]', ""))
    assert load(Path("model.toml")).step().traces == ()
    Path("log.csv").write_text("t,y\n" + "".join(f"{k / 100},{k / 1000 if k % 3 else ''}\n" for k in range(9)))
    words = ["--data", "log.csv", "--time", "t", "--report", "age", "-o", "out"]
    assert CliRunner().invoke(app, ["run", "model.toml", *words]).exit_code == 0
    (table,) = (path.read_text().split() for path in Path("out").glob("*estimates*.csv"))
    assert table[0].split(",")[-2:] == ["age_y", "status"]
    assert [row.split(",")[-2] for row in table[1:]] == ["65535", "0", "0", "1", "0", "0", "1", "0", "0"]
    refused = CliRunner().invoke(app, ["generate", "model.toml", "--report", "ages", "-o", "out"])
    assert refused.exit_code != 0


def test_names_that_c_reserves_are_changed_in_the_structs_of_reports() -> None:
    a, b, y = hg.Signal("a", low=-1, high=1), hg.Signal("b", low=-1, high=1), hg.Signal("float")
    plant = hg.System("reserved", states=(a, b), outputs=(y,), flow=[b, -a], output=[a])
    header = hg.targets.c99(hg.sample(filter_of(plant), dt=0.02, report=("age",)), check=False)["reserved.h"]
    assert "unsigned float_;" in header


# --- sigma ----------------------------------------------------------------------------------------------------------

A = np.array([[0, 1, 0], [-4, -0.3, 1], [0, 0, -0.5]])
C = np.array([[1, 0, 0.2], [0.5, 1, 0]])
Q = np.array([[0.2, 0.05, 0], [0.05, 0.3, 0.1], [0, 0.1, 0.4]])
R = np.diag([0.02, 0.05])  # of a sample
START = np.array([[0.5, 0, 0.1], [0, 0.4, 0], [0.1, 0, 0.3]])
H = 0.02


def linear(observer: Any = hg.observers.riccati, **options: Any) -> hg.Observer:
    x = [hg.Signal(name, low=-50, high=50) for name in "abc"]
    y = [hg.Signal(name, low=-80, high=80) for name in ("y", "v")]
    flow, output = (list(sp.Matrix(matrix) * sp.Matrix(x)) for matrix in (A, C))
    plant = hg.System("linear", states=x, outputs=y, flow=flow, output=output)
    covariance = {"Q": Q.tolist(), "R_per_sample": np.diag(R).tolist(), "covariance": START.tolist()}
    return observer(hg.forms.original(plant), **covariance, **options)


def measured() -> np.ndarray:
    """Samples (N, 2) of the linear plant's outputs, some of which are missing."""
    draw = np.random.default_rng(3)
    y = draw.normal(size=(60, 2)) * [0.5, 0.8]
    y[draw.random(y.shape) < 0.2] = NAN
    return y


def known(y: np.ndarray, observer: Any) -> list[tuple[np.ndarray, ...]]:
    """What the Kalman filter has after each sample; sigma points take the whole Runge-Kutta step for P as well."""
    Phi, short = transition(A, H)
    short = Phi if observer is hg.observers.ukf else short
    return list(kalman(Phi, C, H * Q, R, np.zeros(3), START, y, short))


FILTERS = pytest.mark.parametrize("observer", [hg.observers.riccati, hg.observers.ukf, hg.observers.iterated_ekf])


@FILTERS
def test_sigma_of_a_linear_plant_is_the_kalman_filter_s(observer: Any) -> None:
    y = measured()
    step = hg.sample(linear(observer), dt=H, report=("sigma",), engine="python")
    run = step.run(y=y)
    assert step.traces == ("sigma_a", "sigma_b", "sigma_c")
    for k, (x, P, *_) in enumerate(known(y, observer)):
        assert run.x[k] == pytest.approx(x, rel=1e-12, abs=1e-12)
        assert [run.traces[name][k] for name in step.traces] == pytest.approx(np.sqrt(np.diag(P)), rel=1e-12)


METHODS_OF_COVARIANCE = ("continuous_discrete", "cholesky", "rk4_covariance", "rk4")


@pytest.mark.parametrize("method", METHODS_OF_COVARIANCE)
def test_sigma_is_the_root_of_the_diagonal_of_the_covariance_of_the_states(method: str) -> None:
    """Of a level h as first declared, whose root w the filter estimates, sigma_h = 2 w sigma_w."""
    q, h = hg.Signal("q", low=-9, high=9), hg.Signal("h", low=0.25, high=9)
    w, y = hg.Signal("w", low=0.5, high=3), hg.Signal("y", low=-9, high=9)
    plant = hg.System("tank", states=(h, q), outputs=(y,), flow=[1 - sp.sqrt(h), h - q], output=[q])
    form = hg.forms.original(hg.recast(plant, {w: sp.sqrt(h)}, {h: w**2}))
    observer = hg.observers.riccati(form, Q=[0.1, 0.1], R=0.01, initial={"h": 2, "q": 1})
    step = hg.sample(observer, getattr(hg.methods, method), dt=0.01, report=("sigma",), engine="python")
    run = step.run(y=1 + 0.3 * np.cos(0.02 * np.arange(40)))
    assert step.traces == ("sigma_h", "sigma_q")
    known = uncertainty(step)
    assert known is not None
    (P,), root = known.covariance(step._kept.record), np.sqrt(run["h"][-1])
    assert step.observer.form.names == ("w", "q")
    assert run.traces["sigma_q"][-1] == pytest.approx(np.sqrt(P[1, 1]), rel=1e-12)
    assert run.traces["sigma_h"][-1] == pytest.approx(2 * root * np.sqrt(P[0, 0]), rel=1e-9)


def test_sigma_of_a_bank_is_that_of_the_selected_member() -> None:
    u, y = samples()
    member = filter_of(pendulum())
    step = hg.sample(hg.observers.bank(member, count=3, period=0.1), dt=0.02, report=("sigma",), engine="python")
    run = step.run(u=u, y=y)
    assert len(set(run.traces["selected"])) > 1
    for i, name in enumerate(run.names):
        assert run.traces[f"sigma_{name}"] == pytest.approx(np.sqrt(run.covariance[:, i, i]), rel=1e-12)


def test_sigma_of_many_states_is_read_from_the_columns() -> None:
    step = emitted.step("sure_columns")
    assert any(group.name == "column" for group in step.layout.groups[0].groups)
    run = step.rebuilt(real="double").run(u=np.zeros(30), y=0.1 * np.sin(np.arange(30) / 5), engine="python")
    for i, name in enumerate(run.names):
        assert run.traces[f"sigma_{name}"] == pytest.approx(np.sqrt(run.covariance[:, i, i]), rel=1e-12)


def test_sigma_respects_invariants() -> None:
    """The unit vector (c, s) has no variance across the circle: c sigma_c = s sigma_s up to sign."""
    step = emitted.step("unit_vector")
    step = hg.sample(step.observer, dt=step.dt, report=("sigma",), engine="python")
    draw = np.random.default_rng(2)
    run = step.run(u=np.full((50, len(step.inputs)), 0.3), y=draw.normal(size=(50, len(step.outputs))) / 9)
    c, s = run.names[:2]
    across = np.abs(run[c]) * run.traces[f"sigma_{c}"] - np.abs(run[s]) * run.traces[f"sigma_{s}"]
    assert np.abs(across).max() < 1e-9
    assert run.traces[f"sigma_{c}"].max() > 1e-3


@pytest.mark.parametrize("name", ["high_gain", "low_power", "hamilton_jacobi"])
def test_an_observer_without_a_covariance_refuses_sigma(name: str) -> None:
    q, w, y = (hg.Signal(name, low=-2, high=2) for name in ("q", "w", "y"))
    output = q + q**2 / 9 if name == "hamilton_jacobi" else q  # with a second derivative, P is not a covariance
    plant = hg.System("chain", states=(q, w), outputs=(y,), flow=[w, -q], output=[output])
    form = hg.forms.original(plant) if name == "hamilton_jacobi" else hg.forms.triangular(plant)
    gains: dict[str, dict[str, Any]] = {
        "high_gain": {"theta": 5, "poles": (-1, -1)},
        "low_power": {"theta": 5},
        "hamilton_jacobi": {"Q": [1, 1], "R": 1, "P0": [1, 1], "curvature": 1},
    }
    observer = getattr(hg.observers, name)(form, **gains[name])
    with pytest.raises(BadGain, match=f"report 'sigma' needs a covariance, which {name} has not; take an observer"):
        hg.sample(observer, dt=0.01, report=("sigma",))
    assert hg.sample(observer, dt=0.01, report=("age",)).traces[-1] == "age_y"


# --- innovation -----------------------------------------------------------------------------------------------------


def joint_of(run: hg.Run, outputs: tuple[str, ...] = ("y", "v")) -> tuple[np.ndarray, np.ndarray]:
    """The innovations e (N, p) of a run and their covariance S (N, p, p), as the step reports them."""
    e = np.column_stack([run.traces[f"innovation_{name}"] for name in outputs])
    S = np.zeros((*e.shape, len(outputs)))
    for j, b in enumerate(outputs):
        for i, a in list(enumerate(outputs))[j:]:
            S[:, i, j] = S[:, j, i] = run.traces[f"innovation_S_{a}_{b}"]
    return e, S


@FILTERS
def test_innovations_of_a_linear_plant_are_the_kalman_filter_s(observer: Any) -> None:
    """All at the prediction: an output after another is not predicted from its sample."""
    y = measured()
    step = hg.sample(linear(observer), dt=H, report=("innovation",), engine="python")
    e, S = joint_of(run := step.run(y=y))
    for k, (_, _, known_e, known_S) in enumerate(known(y, observer)):
        assert e[k] == pytest.approx(known_e, rel=1e-11, abs=1e-12, nan_ok=True)
        assert S[k] == pytest.approx(known_S, rel=1e-12)
    assert np.array_equal(run.traces["innovation_count"], np.isfinite(y).sum(axis=1))


def test_a_rejected_sample_has_an_innovation() -> None:
    observer = filter_of(pendulum(), gate={"y": 0.9})
    step = hg.sample(observer, dt=0.02, report=("innovation",), engine="python")
    step(u=0.0, y=(0.1, NAN))
    sample = step(u=0.0, y=(9.0, -1e20))
    assert {"GATED_Y", "REJECTED_V"} <= set(sample.flags)
    assert sample.traces["innovation_y"] == pytest.approx(9, abs=0.5)
    assert sample.traces["innovation_v"] == pytest.approx(-1e20)
    assert sample.traces["innovation_count"] == 2
    sample = step(u=0.0, y=(np.inf, NAN))
    assert np.isnan([sample.traces["innovation_y"], sample.traces["innovation_v"]]).all()
    assert sample.traces["innovation_count"] == 0
    assert sample.traces["innovation_S_y_y"] > 0


def test_a_prediction_alone_has_no_innovation() -> None:
    step = hg.sample(filter_of(pendulum()), dt=0.02, report=("innovation",), engine="python")
    step(u=0.0, y=(0.1, 0.1))
    assert step.predict(u=0.0).traces["innovation_count"] == 0
    sample = step.update(v=0.3)
    assert sample.traces["innovation_count"] == 1
    assert np.isnan(sample.traces["innovation_y"])
    assert np.isfinite(sample.traces["innovation_v"])


def test_an_innovation_of_an_angle_is_the_shorter_way_round() -> None:
    period = 2 * np.pi
    a, w = hg.Signal("a", "rad", period=period), hg.Signal("w", low=-2, high=2)
    plant = hg.System("turn", states=(a, w), outputs=(hg.Signal("y", "rad", period=period),), flow=[w, -w], output=[a])
    step = hg.sample(filter_of(plant, initial={"a": 3.1}), dt=0.02, report=("innovation",), engine="python")
    assert step(y=-3.1).traces["innovation_y"] == pytest.approx(period - 6.2)


def test_innovations_of_a_bank_are_those_of_the_selected_member() -> None:
    u, y = samples()
    bank = hg.observers.bank(filter_of(pendulum()), count=3, period=0.1)
    step = hg.sample(bank, dt=0.02, report=("innovation", "sigma"), engine="python")
    run = step.run(u=u, y=y)
    e, S = joint_of(run)
    assert np.array_equal(np.isnan(e), np.isnan(y))
    assert len(set(run.traces["selected"])) > 1
    k = np.flatnonzero(np.diff(run.traces["selected"]) == 0)[3] + 1
    alone = hg.sample(filter_of(pendulum()), dt=0.02, report=("innovation",), engine="python")
    assert joint_of(alone.run(u=u[:1], y=y[:1]))[1][0] == pytest.approx(S[0], rel=1e-12)
    assert (np.linalg.eigvalsh(S[k]) > 0).all()


def test_nis_of_a_healthy_linear_plant_has_the_mean_of_its_degrees_of_freedom() -> None:
    draw, Phi, n = np.random.default_rng(5), transition(A, H)[0], 20_000
    x, noise = draw.multivariate_normal(np.zeros(3), START), draw.multivariate_normal(np.zeros(3), H * Q, n)
    y = np.zeros((n, 2))
    for k in range(n):
        x = Phi @ x + noise[k] if k else x
        y[k] = C @ x + draw.normal(size=2) * np.sqrt(np.diag(R))
    y[draw.random(y.shape) < 0.1] = NAN
    run = hg.sample(linear(), dt=H, report=("innovation",)).run(y=y, engine="python")
    e, S = joint_of(run)
    there = np.isfinite(e)
    S = np.where(there[:, :, None] & there[:, None, :], S, np.eye(2))
    nis = np.einsum("ki,kij,kj->k", np.nan_to_num(e), np.linalg.inv(S), np.nan_to_num(e))
    freedom = run.traces["innovation_count"].sum()
    assert abs(nis.sum() / freedom - 1) < 4 * np.sqrt(2 / freedom)
    assert np.abs(S[:, 0, 1] / np.sqrt(S[:, 0, 0] * S[:, 1, 1])).max() > 0.2  # correlated


@pytest.mark.parametrize(
    ("method", "options", "says"),
    [
        ("rk4", {}, "needs a prediction with a covariance, which riccati by this method has not"),
        ("rk4_covariance", {}, "needs a prediction with a covariance"),
        ("continuous_discrete", {"periods": {"v": 0.04}}, "leave periods and delays out"),
    ],
)
def test_what_has_no_joint_innovation_refuses_it(method: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(BadGain, match=says):
        hg.sample(filter_of(pendulum()), getattr(hg.methods, method), dt=0.02, report=("innovation",), **options)


def test_late_samples_have_no_joint_innovation() -> None:
    observer = hg.delayed(filter_of(pendulum()), y=2)
    with pytest.raises(BadGain, match="leave periods and delays out"):
        hg.sample(observer, dt=0.02, report=("innovation",))


@pytest.mark.parametrize("constrained", [False, True])
def test_a_replayed_run_has_the_innovations_that_the_step_reports(constrained: bool) -> None:
    """Before any output corrects, so that no projection onto invariants comes between two of them."""
    c, s, w = (hg.Signal(name, low=-2, high=2) for name in ("c", "s", "w"))
    outputs = (hg.Signal("x"), hg.Signal("y"))
    invariants = (c**2 + s**2 - 1,) if constrained else ()
    plant = hg.System(
        "wheel", states=(c, s, w), outputs=outputs, flow=[-s * w, c * w, -w / 9], output=[c, s], invariants=invariants
    )
    observer = filter_of(plant, initial={"c": 1})
    step = hg.sample(observer, dt=0.02, report=("innovation",), engine="python")
    angle = 0.02 * np.arange(50)
    y = np.column_stack([np.cos(angle), np.sin(angle)]) + np.random.default_rng(4).normal(size=(50, 2)) / 9
    run = step.run(y=y)
    e, S = joint_of(run, ("x", "y"))
    assert run.innovations == pytest.approx(e, rel=1e-9, abs=1e-12)
    assert run.joint == pytest.approx(S, rel=1e-9)
