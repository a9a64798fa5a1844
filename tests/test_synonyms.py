"""Textbook names of observers, and the points of the unscented transform that are refused."""

from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import hgogen as hg
from hgogen.cli import app
from hgogen.estimators.synonyms import SYNONYMS
from hgogen.form import OneOutput
from hgogen.reading.given import BadGain
from hgogen.reading.text_model import BadModelFile
from hgogen.step import BadStep

DT = 2.0**-6
q, w, y = (hg.Signal(name, low=-5, high=5) for name in ("q", "w", "y"))
plant = hg.System("swing", states=(q, w), outputs=(y,), flow=[w, -2 * q - 0.3 * w], output=[q])
form = hg.forms.triangular(plant)
NOISE = {"Q_per_sample": (0.25, 1), "noise": {"y": 0.5}}
ARGUMENTS: dict[str, dict[str, Any]] = {"ekf": NOISE, "kalman": NOISE, "luenberger": {"poles": (-2, -3)}}


@pytest.mark.parametrize("name", SYNONYMS)
def test_it_is_the_observer_that_it_names(name: str) -> None:
    known, arguments = SYNONYMS[name], ARGUMENTS[name]
    step = hg.sample(getattr(hg.observers, name)(form, **arguments), dt=DT)
    plain = hg.sample(getattr(hg.observers, known.observer)(form, **arguments, **known.fixed), dt=DT)
    assert hg.targets.c99(step) == hg.targets.c99(plain)
    assert step.observer.name == known.observer
    assert not known.fixed.keys() & signature(getattr(hg.observers, name)).parameters.keys()
    assert name not in hg.observers.__all__
    with pytest.raises(BadGain, match="is fixed"):
        getattr(hg.observers, name)(form, **arguments, theta=2.0)
    assert not hasattr(hg.observers, "nobody")


@pytest.mark.parametrize("name", ["ekf", "kalman"])
def test_it_asks_what_the_noise_is(name: str) -> None:
    make = getattr(hg.observers, name)
    for arguments in ({"Q": (1, 1), "R": 1}, {"Q": (1, 1), "noise": {"y": 1}}, {"Q_per_sample": (1, 1), "R": 1}):
        with pytest.raises(BadGain, match="must say what its"):
            make(form, **arguments)
        make(form, **arguments, density=True)


def test_what_a_varying_dt_refuses_names_what_it_takes() -> None:
    dt = (DT / 2, DT)
    with pytest.raises(BadStep, match=r"needs Q, .* ekf and kalman take it with density = True$"):
        hg.sample(hg.observers.ekf(form, **NOISE), dt=dt)
    densities = {"Q": (0.25 / DT, 1 / DT), "noise": {"y": 0.5}}
    step = hg.sample(hg.observers.ekf(form, **densities, density=True), dt=dt)
    assert hg.targets.c99(step) == hg.targets.c99(hg.sample(hg.observers.riccati(form, **densities), dt=dt))


def test_a_text_model_has_the_sentence(tmp_path: Path) -> None:
    path = tmp_path / "swing.toml"
    text = """
name = "swing"
states = {q = {low = -5, high = 5, flow = "w"}, w = {low = -5, high = 5, flow = "-2*q - .3*w"}}
outputs = {y = {equation = "q"}}
[tuning.filter]
kind = "ekf"
dt = 0.015625
"""
    path.write_text(text + "Q_per_sample = [0.25, 1]\nnoise = {y = 0.5}\n")
    sentences = ["tuning.filter: ekf is riccati at theta = 1, the extended Kalman filter"]
    assert list(hg.load(path).tuning.synonyms) == sentences
    assert "ekf is" not in CliRunner().invoke(app, ["generate", str(path), "-o", str(tmp_path / "out")]).output
    assert hg.load(path).step("filter").tuned["R"] == (0.25 * DT,)
    assert hg.load(path).step("filter").observer.form.kind == "original"
    assert hg.load(path).step("riccati").tuned == hg.load(path).step("filter").tuned
    assert "ekf is riccati at theta = 1" in " ".join(CliRunner().invoke(app, ["check", str(path)]).output.split())
    path.write_text(text + "Q = [0.25, 1]\nR = 1\n")
    with pytest.raises(BadModelFile, match="ekf must say what its Q and R are"):
        hg.load(path).step("filter")


def test_where_an_observer_is_named_the_sentence_says_whose_other_name_it_is(tmp_path: Path) -> None:
    for command in (["generate", "duffing", "-o", str(tmp_path)], ["advise", "duffing", "--dt", "0.01"]):
        option = "--observer" if command[0] == "generate" else "--observers"
        done = CliRunner().invoke(app, [*command, option, "ekf"])
        assert done.exit_code == 0
        assert done.output.count("ekf is riccati at theta = 1, the extended Kalman filter") == 1


def test_a_model_without_such_a_tuning_takes_first_gains_by_a_textbook_name() -> None:
    model = hg.load("geared_motor")  # two outputs; its riccati has a theta of its own
    assert (model.step("ekf").observer.name, model.tuned("ekf").tables["ekf"]["density"]) == ("riccati", True)
    assert model.step("luenberger").observer.name == "high_gain"
    alone = hg.load("van_der_pol").plant
    first = hg.starting_gains(hg.forms.triangular(alone), hg.observers.luenberger)
    numbers = hg.starting_gains(hg.forms.triangular(alone), hg.observers.high_gain).gains
    assert dict(first.gains) == {"poles": tuple(numbers["theta"] * pole for pole in numbers["poles"])}
    assert numbers["theta"] > 1


def test_the_tuning_that_is_the_named_observer_is_taken() -> None:
    model = hg.load("duffing")
    assert model.tuned("ekf").tables["ekf"] == {"kind": "riccati", **model.tuning.tables["riccati"]}
    assert model.step("ekf").tuned["R"] == model.step("riccati").tuned["R"]


def test_first_gains_of_a_discrete_plant_have_no_density() -> None:
    x1, x2 = (hg.Signal(name, low=-5, high=5) for name in ("x1", "x2"))
    map = hg.System("map", states=(x1, x2), outputs=(y,), flow=[x1 + 0.1 * x2, x2], output=[x1], discrete=True)
    gains = hg.starting_gains(hg.forms.original(map), hg.observers.kalman).gains
    assert hg.observers.kalman(hg.forms.original(map), **gains).name == "riccati"


@pytest.mark.parametrize(("wrong", "right"), [("efk", "ekf"), ("luenbeger", "luenberger"), ("riccatti", "riccati")])
def test_a_mistyped_observer_has_the_textbook_name_as_its_hint(wrong: str, right: str) -> None:
    for command in (["check", "sir", "--observer", wrong], ["advise", "sir", "--dt", "0.1", "--observers", wrong]):
        done = CliRunner().invoke(app, command)
        assert done.exit_code != 0
        assert f"did you mean {right}?" in " ".join(done.output.split())


def test_a_filter_without_form_on_several_outputs_names_the_key() -> None:
    plane = hg.System("plane", states=(q, w), outputs=(y, hg.Signal("v")), flow=[w, -q], output=[q, w])
    with pytest.raises(OneOutput, match='form = "original"'):
        hg.forms.triangular(plane)


def test_a_negative_kappa_is_refused_with_a_way_out() -> None:
    """Julier's kappa = 3 - n is negative from 4 states on; with alpha = 1 and beta = 0 the sums may be indefinite."""
    x = [hg.Signal(f"x{i}", low=-5, high=5) for i in range(5)]
    chain = hg.System("chain", states=x, outputs=(y,), flow=[*x[1:], -x[0]], output=[x[0]])
    make = hg.observers.ukf
    arguments = {"Q": (1,) * 5, "R": 1, "alpha": 1.0, "kappa": -2.0}
    with pytest.raises(
        BadGain, match=r"= 0\.4 to 1e6, .* with a negative kappa, such as Julier's 3 - n, it may not: take"
    ):
        make(hg.forms.original(chain), **arguments, beta=0.0)
    make(hg.forms.original(chain), **arguments, beta=0.4)
    make(hg.forms.original(chain), **arguments | {"kappa": 0.0}, beta=0.0)
    make(hg.forms.original(chain), **arguments | {"alpha": 0.1}, beta=0.004)  # 0.1^2 2/5, though not of binary numbers


@pytest.mark.parametrize(("alpha", "said"), [(1e-3, "rounds the estimate by some 1e-02 of it"), (1.0, "beta = 2")])
def test_a_filter_says_what_single_precision_loses_between_near_points(alpha: float, said: str) -> None:
    x = [hg.Signal(f"x{i}", low=-5, high=5) for i in range(5)]
    chain = hg.System("chain", states=x, outputs=(y,), flow=[*x[1:], -x[0]], output=[x[0]])
    observer = hg.observers.ukf(hg.forms.original(chain), Q=(1,) * 5, R=1, alpha=alpha)
    assert any(line.endswith(said) for line in observer.equations)


@pytest.mark.parametrize(("alpha", "kappa", "n"), [(1.0, -2.0, 5), (0.5, 1.0, 3), (1.0, -0.5, 2), (2.0, 3.0, 4)])
def test_the_limit_of_beta_is_exact(alpha: float, kappa: float, n: int) -> None:
    """Of |z|^2, whose pairs of points do not differ, the variance by the textbook's weights is 0 at the limit."""
    reach2, least = alpha**2 * (n + kappa), -(alpha**2) * kappa / n
    values = np.array([0.0, *[reach2] * (2 * n)])

    def variance(beta: float) -> float:
        mean = np.array([1 - n / reach2, *[1 / (2 * reach2)] * (2 * n)])
        weights = mean + np.eye(1, 2 * n + 1)[0] * (1 - alpha**2 + beta)
        return float(weights @ (values - mean @ values) ** 2)

    assert variance(least) == pytest.approx(0, abs=1e-12)
    assert variance(least - 0.01) < 0 < variance(least + 0.01)
