"""What notebooks show of the values of the pipeline, and their plots."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from matplotlib import pyplot

import hgogen as hg
from hgogen.model import load
from hgogen.run.samples import BadShape
from hgogen.system import valued
from hgogen.trial import Trial, simulate

q = hg.Signal("q", "rad", "angle | of a_b", low=-4, high=4)
w, y = hg.Signal("w", "rad/s", low=-20, high=20), hg.Signal("y", "rad")
PLANT = hg.System("swing_", states=(q, w), outputs=(y,), flow=[w, -sp.sqrt(q**2 + 1) * sp.sin(q)], output=[q])
FORM = hg.forms.triangular(PLANT)
STEP = hg.sample(hg.observers.high_gain(FORM, theta=20, poles=(-1, -1)), hg.methods.rk4, dt=1e-3)
SAMPLES = np.where(np.arange(300) % 100 == 7, np.nan, np.sin(np.arange(300) * 4e-3))
SAMPLES[50] = 1e9


@pytest.fixture(autouse=True)
def closed() -> Any:
    pyplot.switch_backend("agg")
    yield
    pyplot.close("all")


def markdown(value: Any) -> str:
    text: str = value._repr_markdown_()
    lines = text.splitlines()
    assert lines.count("$$") % 2 == 0
    assert not [line for line in lines if line.startswith("#")]  # a cell is no chapter
    for k, line in enumerate(lines):
        if line.startswith("| ---"):  # a table has as many cells in each row
            rows = [line, lines[k - 1], *lines[k + 1 :]]
            rows = rows[: 2 + next((j for j, row in enumerate(lines[k + 1 :]) if not row.startswith("|")), len(lines))]
            assert len({row.replace("\\|", "").count("|") for row in rows}) == 1
    return text


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        (PLANT, [r"\dot{q} &= w", "| `q` | state | angle \\| of a\\_b | rad | -4 .. 4 |"]),
        (FORM, ["**Form: triangular**", r"\dot z &=", "| proved | `triangular.structure` |"]),
        (FORM.checks[0], ["| proved | `triangular.structure` |"]),
        (STEP.observer, [r"\dot{z} = A z", "`high_gain.convergence`"]),
        (
            STEP,
            ["**swing\\_**: high_gain observer, one call every 0.001 s", "| `theta` | 20 | 1 .. 20 |", "k_{1} = f(z)"],
        ),
        (load("duffing"), ["**duffing**", r"- \delta v + u - x^{3} + x", "tunings: `high_gain`"]),
    ],
)
def test_a_value_is_equations_and_tables(value: Any, parts: list[str]) -> None:
    text = markdown(value)
    assert [part for part in parts if part not in text] == []


def test_a_run_is_its_states_and_status_bits() -> None:
    STEP.reset()
    run = STEP.run(y=SAMPLES)
    text = markdown(run)
    assert "300 samples" in text
    assert "MISSING_Y in 3" in text
    assert run.raised == {"MISSING_Y": 3, "REJECTED_Y": 1}
    assert f"| `q` | {run['q'][0]:.4g} | {run['q'].min():.4g} | {run['q'].max():.4g} | {run['q'][-1]:.4g} |" in text
    assert "0 samples" in markdown(STEP.run(y=np.zeros((0, 1))))


def test_a_fit_and_a_calibration_are_tables() -> None:
    """The estimates by kind, and the row to take with the table of its tuning."""
    a = hg.Signal("a", "1/s2", "gravity over length", 12, low=5, high=40)
    free = hg.System("free_", states=(q, w), outputs=(y,), parameters=(a,), flow=[w, -a * sp.sin(q)], output=[q])
    truth = simulate(valued(free, {"a": 19.6}), Trial("swing", 2, {"q": 0.4, "w": 0}), 0.01)
    noise = 1e-3 * np.random.default_rng(1).normal(size=(len(truth.t), 1))
    log = hg.Log(np.zeros((len(truth.t), 0)), truth.x[:, :1] + noise, 0.01)
    fit = hg.fit(free, log, starts=1, offset=["y"])
    text = markdown(fit)
    assert f"| parameter | `a` | {fit.values['a']:.5g} | {fit.deviation['a']:.5g} | 12 | 1/s2 |  |" in text
    assert "| offset | `y` |" in text
    assert f"| `y` | {fit.error['y']:.4g} | {fit.unfitted['y']:.4g} | {fit.spread['y']:.4g} |" in text
    tuned = hg.tune(fit.plant, log, observers=["riccati", "high_gain"], segments=2)
    text = markdown(tuned)
    assert f"| **riccati** | triangular | {tuned['riccati'].error:.3g} |" in text
    assert f"To take: riccati, `form` = `triangular`, `Q` = `{tuned['riccati'].table['Q']}`" in text


def test_a_run_is_drawn_with_its_samples_and_the_truth() -> None:
    STEP.reset()
    run = STEP.run(y=SAMPLES)
    axes = run.plot({"w": np.cos(run.t)})
    assert len(axes) == 2
    assert axes[0].figure is pyplot.gcf()  # a notebook shows it
    labels = [[line.get_label() for line in axis.get_lines()] for axis in axes]
    assert labels == [["measured", "estimate"], ["estimate", "truth"]]
    assert axes[0].get_lines()[1].get_ydata()[-1] == run["q"][-1]
    later = run.since(100).plot()[0].get_lines()[0]
    assert later.get_xdata()[0] == run.t[100]
    assert later.get_ydata()[0] == SAMPLES[100]
    with pytest.raises(BadShape, match="names no state"):
        run.plot({"v": run.t})
    with pytest.raises(BadShape, match=r"truth of w of shape \(3,\)"):
        run.plot({"w": [1, 2, 3]})


def test_the_response_is_drawn_around_the_poles() -> None:
    axes = STEP.plot_response()
    continuous, sampled = axes[0].get_lines()[:2]
    assert continuous.get_xdata()[[0, -1]] == pytest.approx([2, 200])  # the poles are -20
    assert continuous.get_ydata() == pytest.approx(hg.response(STEP.observer, continuous.get_xdata()).gain[:, 0, 0])
    assert sampled.get_xdata()[-1] == continuous.get_xdata()[-1]
    continuous, sampled = STEP.plot_response([1, 10, 4000])[1].get_lines()[:2]
    assert list(continuous.get_xdata()) == [1, 10, 4000]
    assert list(sampled.get_xdata()) == [1, 10]  # below pi/dt


def test_the_least_observable_direction_is_drawn() -> None:
    (axis,) = FORM.plot_observability()
    assert sum(bar.get_width() ** 2 for bar in axis.patches) == pytest.approx(1)
    assert "over points of the ranges" in axis.get_title(loc="left")
    (axis,) = FORM.plot_observability(Trial("fall", 2.0, {"q": 1, "w": 0}))
    assert "along trial fall" in axis.get_title(loc="left")


def test_a_run_and_its_consistency_print_in_a_few_lines() -> None:
    model = hg.load("pendulum")
    y = 1e-3 * np.random.default_rng(0).normal(size=400)
    run = model.step("riccati").run(u=np.zeros(400), y=y)
    head, q, w = str(run).splitlines()
    assert head == f"400 samples, computed by {run.engine}; status bits: none"
    assert q.startswith("q: first ")
    assert w.endswith(f"last {run['w'][-1]:.4g}")
    known = hg.consistency(run)
    (output,) = known.outputs
    assert str(known) == "\n".join((str(output), *known.sentences()))
    assert str(output).startswith(
        f"y: {output.count} innovations, RMS {output.rms:.3g}, NIS {output.nis:.3g}, 95 % band "
    )
    plain = hg.consistency(model.step("high_gain").run(u=np.zeros(400), y=y))
    assert ", no covariance" in str(plain)
