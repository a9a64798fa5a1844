"""What noise does to estimates: |H| of the linear error core and of its steps, the command `response`, the figure."""

import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import MODELS, fitzhugh_nagumo, pendulum, two_outputs
from test_cli import as_json, hgogen
from test_every_observer import MODELS as EVERY
from test_every_observer import step
from test_hyperjerk import OMEGA, TABLES

import hgogen as hg
from hgogen.model import load
from hgogen.reading.given import BadGain, Misfit
from hgogen.run import figures as figure
from hgogen.run.continuous import BadFrequency, NoResponse

HYPERJERK = str(MODELS / "hyperjerk.py")
POLES = (-1 + 1j, -1 - 1j, -2 + 1j, -2 - 1j)


@cache
def integrators(n: int) -> hg.Form:
    """x_i' = x_(i+1), x_n' = u, y = x_1 + u: nothing is nonlinear, so that H is the whole of an observer."""
    x = [hg.Signal(f"x{i}", low=-1e6, high=1e6) for i in range(1, n + 1)]
    u, y = hg.Signal("u", low=-1, high=1), hg.Signal("y", low=-1e6, high=1e6)
    return hg.forms.triangular(
        hg.System(f"integrators{n}", states=x, inputs=(u,), outputs=(y,), flow=[*x[1:], u], output=[x[0] + u])
    )


# --- continuous ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "rel"), [("filtered", 3e-3), ("high_gain", 3.5e-2)])
def test_tables_1_and_2_through_the_linear_chain(name: str, rel: float) -> None:
    """x_1 .. x_3 of the simulation; at omega = 300 .00666, .00220 have three digits."""
    response = hg.response(load(HYPERJERK).step(name).observer, OMEGA)
    assert response.gain[:, :3, 0] == pytest.approx(np.array(TABLES[name])[:, :3], rel=rel)
    assert (response.states, response.outputs, response.dt, response.coordinates) == (
        ("x1", "x2", "x3", "x4"),
        ("y",),
        None,
        "plant",
    )


@given(st.integers(1, 4), st.floats(1.0, 20.0), st.floats(0.1, 500.0))
@settings(deadline=None, max_examples=20)
def test_the_standard_observer_by_hand(n: int, theta: float, omega: float) -> None:
    """From y to x_i: s^(i-1) (K_i s^(n-i) + .. + K_n)/(s^n + K_1 s^(n-1) + .. + K_n), the denominator (s + theta)^n."""
    K = np.poly([-theta] * n)[1:]
    s = 1j * omega
    whole = np.polyval([1, *K], s)
    expected = [s**i * np.polyval(K[i:], s) / whole for i in range(n)]
    response = hg.response(hg.observers.high_gain(integrators(n), theta=theta, poles=[-1] * n), omega)
    assert response.H[0, :, 0] == pytest.approx(np.array(expected), rel=1e-8)


def test_the_filtered_observer_rolls_off_one_power_faster_from_each_estimate_to_the_next() -> None:
    """y passes i filters to l_i eta_i: |H_i| ~ omega^-(i+1), while the standard one's all fall as 1/omega."""
    form = integrators(4)
    filtered = hg.observers.filtered(form, theta=10, alpha=3, beta=1, poles=POLES)
    standard = hg.observers.high_gain(form, theta=10, poles=POLES)
    ends = np.array([1e5, 1e6])
    slopes = [np.log10(hg.response(each, ends).gain[:, :, 0]) @ np.eye(4) for each in (filtered, standard)]
    assert slopes[0][1] - slopes[0][0] == pytest.approx([-2, -3, -4, -5], abs=1e-3)
    assert slopes[1][1] - slopes[1][0] == pytest.approx([-1] * 4, abs=1e-3)


def test_several_outputs() -> None:
    """Two chains of a high-gain observer: each is the standard one of its length, and takes up nothing of the other's
    noise."""
    gains = {"theta": 5, "poles": ((-1, -2), (-1,))}
    observer = hg.observers.high_gain(hg.forms.block_triangular(two_outputs()), **gains)
    response = hg.response(observer, [3.0, 30.0])
    assert (response.states, response.outputs) == (("x1", "x2", "x3"), ("y1", "y2"))
    for rows, column, poles in ((slice(0, 2), 0, (-1, -2)), (slice(2, 3), 1, (-1,))):
        alone = hg.observers.high_gain(integrators(len(poles)), theta=5, poles=poles)
        assert response.H[:, rows, column] == pytest.approx(hg.response(alone, [3.0, 30.0]).H[:, :, 0], rel=1e-12)
        assert not response.H[:, rows, 1 - column].any()
    span = np.geomspace(0.1, 300, 20)
    drawn = figure.response(
        hg.response(observer, span), hg.response(hg.sample(observer, hg.methods.rk4, dt=0.01), span), "s"
    )
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == [
        *("y1, continuous", "y1, step", "y2, continuous", "y2, step")
    ]


def test_estimates_in_other_coordinates_are_told() -> None:
    """The Van der Pol oscillator measured in its velocity has a phase form that is nonlinear in its states; a system
    whose states are the form's in another order, or with another sign, keeps the plant's."""
    x = [hg.Signal(name, low=0.5, high=2) for name in ("a", "b")]
    plant = hg.System("curved", states=x, outputs=(hg.Signal("y"),), flow=[x[0] * x[1], -x[0]], output=[x[0]])
    response = hg.response(hg.observers.high_gain(hg.forms.phase(plant), theta=3, poles=(-1, -2)), 5.0)
    assert response.coordinates == "form"
    assert response.states == tuple(s.name for s in hg.forms.phase(plant).states)
    assert response.H[0, :, 0] == pytest.approx(
        hg.response(hg.observers.high_gain(integrators(2), theta=3, poles=(-1, -2)), 5.0).H[0, :, 0]
    )
    z = [hg.Signal(name, low=-2, high=2) for name in ("slow", "fast")]
    turned = hg.System("turned", states=z, outputs=(hg.Signal("y"),), flow=[-z[0], -4 * z[0]], output=[z[1]])
    other = hg.response(hg.observers.high_gain(hg.forms.triangular(turned), theta=3, poles=(-1, -2)), 5.0)
    assert (other.coordinates, other.states) == ("plant", ("slow", "fast"))
    assert other.H[0, [1, 0], 0] == pytest.approx(response.H[0, :, 0] * [1, -1 / 4])


def test_a_gain_that_adapts_is_taken_where_the_core_is_the_fastest() -> None:
    """The updated gain at its cap is the standard one at theta = cap; the command says so."""
    gains = {"p_1": 0.15, "p_2": 2, "p_3": 6, "cap": 10, "poles": (-1, -2)}
    updated = hg.response(hg.observers.updated_gain(pendulum().form, **gains), 5.0)
    standard = hg.response(pendulum(theta=10, poles=(-1, -2)), 5.0)
    assert dict(updated.held) == {"L": (10.0,)}
    assert not standard.held
    assert np.abs(updated.H / standard.H - 1).max() < 1e-12
    _, err = hgogen("response", str(MODELS / "pendulum.py"), "--observer", "updated_gain")
    assert "hgogen: L adapts: the gains are those at 100, where the core is the fastest" in err


# --- as discretised -----------------------------------------------------------------------------------------

OBSERVERS: dict[str, Any] = {
    "filtered": {"theta": 4, "alpha": 3, "beta": 1, "poles": POLES},
    "high_gain": {"theta": 4, "poles": POLES},
    "low_power": {"theta": 4},
    "peaking_free": {"theta": 4},
    "cascade": {"theta": 4},
}


@pytest.mark.ordinary(
    "filtered-heun",
    "high_gain-heun",
    "low_power-heun",
    "peaking_free-heun",
    "cascade-euler",
    "cascade-heun",
    "cascade-rk4",
)
@pytest.mark.parametrize("method", ["euler", "heun", "rk4"])
@pytest.mark.parametrize("name", OBSERVERS)
def test_a_steps_response_is_what_the_step_does(name: str, method: str) -> None:
    """Where nothing is nonlinear: y = sin(omega t), the transient gone, the estimate is |H| sin(omega t + arg H) to
    rounding (|z| is some 1e2)."""
    dt, omega = 0.02, 20.0
    observer = getattr(hg.observers, name)(integrators(4), **OBSERVERS[name])
    step = hg.sample(observer, getattr(hg.methods, method), dt=dt)
    t = np.arange(2000) * dt
    response = hg.response(step, omega)
    run = step.run(u=0 * t, y=np.sin(omega * t), engine="python")
    expected = (response.H[0, :, 0] * np.exp(1j * omega * t)[:, None]).imag
    assert run.x[-200:] == pytest.approx(expected[-200:], abs=1e-9 * np.abs(expected).max())
    assert response.dt == dt


def test_a_steps_response_tends_to_the_continuous_one() -> None:
    """With the order 2 of y on the line between samples: y is multiplied by (sin(a)/a)^2, a = omega dt/2, at least."""
    observer = hg.observers.filtered(integrators(4), **OBSERVERS["filtered"])
    exact = hg.response(observer, 20.0).H
    errors = [
        np.abs(hg.response(hg.sample(observer, hg.methods.rk4, dt=dt), 20.0).H / exact - 1).max() for dt in (2e-2, 1e-2)
    ]
    assert errors[0] == pytest.approx((20 * 2e-2) ** 2 / 12, rel=0.05)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


@pytest.mark.slow
def test_the_observers_of_three_models_have_a_response_or_are_refused() -> None:
    """Where a step is short, h omega = .01, its response is the continuous one to (h omega)^2/12 and little more."""
    done = []
    for model in ("bioreactor", "hyperjerk", "pendulum"):
        for tuned in EVERY[model].tuning.tables:
            made = step(model, tuned)
            omega = 0.01 / made.dt
            try:
                exact, response = hg.response(made.observer, omega), hg.response(made, omega)
            except NoResponse:
                continue
            assert np.abs(response.H / exact.H - 1).max() < 2e-4
            done.append(made.observer.name)
    assert set(done) >= {"cascade", "filtered", "high_gain", "low_power", "peaking_free", "updated_gain"}


# --- the command --------------------------------------------------------------------------------------------


@pytest.mark.full
def test_the_command(tmp_path: Path) -> None:
    answer = as_json("response", HYPERJERK, "--omega", "50,100,300", "-o", str(tmp_path))
    assert (answer["observer"], answer["coordinates"], answer["dt"]) == ("filtered", "plant", 1e-3)
    assert answer["omega"] == [50, 100, 300]
    first = answer["gains"][0]
    assert (first["output"], first["state"]) == ("y", "x1")
    assert first["continuous"] == pytest.approx([0.2285, 0.0594, 0.00666], rel=3e-3)
    assert first["step"] == pytest.approx(first["continuous"], rel=8e-3)  # (300 x 1e-3)^2/12
    assert first["step"] != first["continuous"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["response.png", "response.svg"]
    assert answer["files"] == [str(tmp_path / "response.svg"), str(tmp_path / "response.png")]


def test_the_command_in_words() -> None:
    """By default at six frequencies about the core's poles, and nothing is drawn."""
    table, _ = hgogen("response", HYPERJERK, "--observer", "high_gain")
    rows = [line.split() for line in table.splitlines() if re.search(r"\d\s*$", line)]
    assert len(rows) == 4 * 6
    assert [row[:2] for row in rows if len(row) == 5] == [["y", f"x{i}"] for i in (1, 2, 3, 4)]
    assert "files" not in table


def test_beyond_half_the_sampling_rate_a_step_has_no_gain_of_its_own() -> None:
    """Samples of a tone at 2 pi/dt - omega are those of one at omega: what the step makes of them is no answer."""
    arguments = ("response", HYPERJERK, "--observer", "high_gain", "--omega", "3141,3142,6273.185,1e9")
    for one in as_json(*arguments)["gains"]:
        assert one["step"][0] > 0
        assert one["step"][1:] == [None] * 3
        assert min(one["continuous"]) > 0
    table, err = hgogen(*arguments)
    cells = [line.split()[-3:] for line in table.splitlines()]
    assert [row[0] for row in cells if row[-1:] == ["-"]] == ["3142", "6273.19", "1e+09"] * 4
    assert "3142, 6273.19, 1e+09 rad/s are beyond the Nyquist frequency pi/dt = 3141.59 rad/s" in " ".join(err.split())
    assert "Nyquist" not in hgogen(*arguments[:-1], "3141")[1]


@pytest.mark.parametrize("columns", ["60", "80", "200"])
def test_no_number_is_broken(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    omega = "1,2,5,10,20,50,100,200,500,1000,2000,3000"
    arguments = ("response", HYPERJERK, "--observer", "high_gain", "--omega", omega)
    answer = as_json(*arguments)
    rows = [line.split()[-3:] for line in hgogen(*arguments)[0].splitlines() if re.search(r"\d\s*$", line)]
    wanted = [
        row for one in answer["gains"] for row in zip(answer["omega"], one["continuous"], one["step"], strict=True)
    ]
    assert [tuple(map(float, row)) for row in rows] == [tuple(float(f"{v:.4g}") for v in row) for row in wanted]


@pytest.mark.parametrize(
    ("omega", "said"),
    [
        ("fast", "'fast' must be numbers in rad/s, such as 50,100,300"),
        ("0", r"omega = \(0\.0,\) must be positive numbers \(rad/s\)"),
        ("1,nan", "must be positive numbers"),
    ],
)
def test_bad_frequencies_of_the_command(omega: str, said: str) -> None:
    _, err = hgogen("response", HYPERJERK, "--omega", omega, status=2)
    assert re.search(said, " ".join(err.replace("│", " ").split()))


# --- what has none ------------------------------------------------------------------------------------------


def test_an_observer_without_a_linear_core_has_no_response() -> None:
    with pytest.raises(NoResponse, match=r"^the riccati observer has no frequency response: it has no linear"):
        hg.response(fitzhugh_nagumo(), 1.0)
    with pytest.raises(NoResponse, match="no linear error core"):
        hg.response(hg.observers.riccati(hg.forms.original(two_outputs()), Q=(1, 1, 1), R=1), 1.0)
    original = hg.forms.phase(load(MODELS / "pendulum.py").plant, original=True)
    with pytest.raises(NoResponse, match=r"in other coordinates only; build it on the form phase without original"):
        hg.response(hg.observers.high_gain(original, theta=4, poles=(-1, -1)), 1.0)


@pytest.mark.parametrize("omega", [0, -1.0, float("nan"), float("inf"), [], [[1.0]]])
def test_bad_frequencies(omega: Any) -> None:
    with pytest.raises(BadFrequency, match=r"must be positive numbers \(rad/s\), such as \(50, 100, 300\)"):
        hg.response(hg.observers.high_gain(integrators(2), theta=2, poles=(-1, -1)), omega)


def test_a_response_is_of_an_observer() -> None:
    with pytest.raises(Misfit, match="give an observer or a step"):
        hg.response("high_gain", 1.0)


def test_frequencies_are_numbers() -> None:
    with pytest.raises(BadGain, match="omega = 'a' must be a number or an array of numbers"):
        hg.response(hg.observers.high_gain(integrators(2), theta=2, poles=(-1, -1)), "a")
