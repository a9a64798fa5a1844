"""The command `design`: gains for wanted rates beside a model's tuning, as JSON, as a table and as a figure."""

import re
from pathlib import Path
from typing import Any

import pytest
from plants import MODELS
from test_cli import as_json, hgogen

import hgogen as hg
from hgogen.model import load

PENDULUM = str(MODELS / "pendulum.py")


def bounds(point: dict[str, Any], of: str) -> dict[str, float]:
    return {one["state"]: one[of] for one in point["noise"]}


def test_the_command(tmp_path: Path) -> None:
    answer = as_json("design", PENDULUM, "-o", str(tmp_path))
    assert (answer["observer"], answer["form"], answer["dt"], answer["refused"]) == (
        "high_gain",
        "triangular",
        1e-3,
        {},
    )
    tuning, slow, same, fast = answer["points"]
    assert (tuning["designed"], tuning["K"], tuning["theta"]) == (None, None, 20)
    assert same["designed"] <= tuning["rate"] < 1.01 * same["designed"] <= 1.01 * same["rate"]
    assert slow["rate"] < same["rate"] < fast["rate"]
    step = load(PENDULUM).step()
    assert bounds(tuning, "continuous") == {x: b for (x, _), b in hg.design.noise_bounds(step.observer).items()}
    known = hg.noise_gain(step)
    assert isinstance(known, hg.NoiseGain)
    assert bounds(tuning, "step") == {x: b for (x, _), b in known.gains.items()}
    assert tuning["longest"] == float(hg.contraction(step).reach.longest or 0)
    for of in ("continuous", "step"):
        assert bounds(slow, of)["w"] < bounds(same, of)["w"] < bounds(tuning, of)["w"] < bounds(fast, of)["w"]
    observer = hg.observers.high_gain(step.observer.form, theta=same["theta"], gains=same["K"])
    again = hg.contraction(hg.sample(observer, hg.methods.rk4, dt=1e-3))
    assert same["longest"] == float(again.reach.longest or 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["design.png", "design.svg"]


@pytest.mark.usefixtures("undrawn")
def test_the_command_in_words(tmp_path: Path) -> None:
    arguments = ("--rates", "5,1e6", "--method", "euler", "--dt", "2e-3", "-o", str(tmp_path))
    table, _ = hgogen("design", PENDULUM, *arguments)
    assert "by Euler at dt = 0.002 s" in " ".join(table.split())
    assert len(re.findall(r"^ .* y .*\s-$|^theta = 1.5e.06 .*\s-$", table, re.MULTILINE)) == 2  # no step so fast at dt
    (call,) = re.findall(r"high_gain\(form, (theta=7\S+, gains=\(.*\))\)", table)
    form = hg.forms.triangular(load(PENDULUM).plant)
    observer = eval(f"hg.observers.high_gain(form, {call})", {"hg": hg, "form": form})
    assert all(check.verdict == "proved" for check in observer.checks)


@pytest.mark.full
def test_beside_another_tuning_and_where_the_model_s_own_has_none(tmp_path: Path) -> None:
    filtered = as_json("design", PENDULUM, "--observer", "filtered", "--rates", "5", "-o", str(tmp_path))
    assert filtered["observer"] == filtered["points"][0]["observer"] == "filtered"
    assert filtered["points"][1]["observer"] == "high_gain"


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_an_argument_of_b_beside_the_tuning(tmp_path: Path) -> None:
    """The disturbed pendulum at the rate of its theta: noise moves the torque by 291 of theta, 211 of a gain alone."""
    plant = str(MODELS / "disturbed_pendulum.py")
    arguments = ("design", plant, "--observer", "high_gain", "--rates", "12", "--argument", "-o", str(tmp_path))
    tuning, both = as_json(*arguments)["points"]
    assert (tuning["argument"], both["observer"]) == (None, "circle_criterion")
    assert bounds(tuning, "continuous")["x3"] > 280
    assert bounds(both, "continuous")["x3"] < 150
    made = called(hgogen(*arguments)[0], load(plant).step("high_gain").observer.form)
    assert (made.name, len(both["argument"])) == ("circle_criterion", 3)
    assert {x: bound for (x, _), bound in hg.design.noise_bounds(made).items()} == pytest.approx(
        bounds(both, "continuous"), rel=0.02
    )


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_an_argument_of_b_where_it_does_better(tmp_path: Path) -> None:
    plant = str(MODELS / "van_der_pol.toml")
    arguments = ("design", plant, "--rates", "1.25", "--argument", "-o", str(tmp_path))
    one = as_json(*arguments)["points"][1]
    assert (one["observer"], one["argument"]) == ("high_gain", [])
    assert called(hgogen(*arguments)[0], load(plant).step().observer.form).name == "high_gain"


def called(text: str, form: hg.Form) -> hg.Observer:
    """The observer of the one line of a gain."""
    (call,) = re.findall(r"hg\.observers\.\w+\(form, .*?\)\)", text, re.DOTALL)
    made: hg.Observer = eval(call, {"hg": hg, "form": form})
    return made


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("pendulum.py", "--rates", "fast"), "'fast' must be up to 20 positive numbers, such as 1,3,10"),
        (("pendulum.py", "--rates", "1,-3"), "must be up to 20 positive numbers"),
        (("pendulum.py", "--rates", "inf"), "must be up to 20 positive numbers"),
        (("pendulum.py", "--rates", ","), "must be up to 20 positive numbers"),
        (("pendulum.py", "--rates", "1e16"), r"rate = 1e\+16 must be from 1e-15 to 1e\+15; take other units"),
        (("pendulum.py", "--observer", "riccati"), "riccati has no constant gain .* take high_gain"),
        (
            ("bioreactor.py",),
            "bioreactor has no gain that is designed: the bound is for an observer .*; gains are designed on a form of "
            "the plant's own states in chains, triangular or block_triangular",
        ),
        (("pmsm.toml",), "high_gain does not take this plant"),
    ],
)
def test_what_cannot_be_designed_is_said(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    name, *rest = arguments
    _, err = hgogen("design", str(MODELS / name), *rest, "-o", str(tmp_path / "out"), status=2)
    assert re.search(said, " ".join(err.replace("│", " ").split()))
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_a_rate_that_is_not_reached_is_named_and_the_others_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("driven.toml").write_text(
        "name = 'driven'\n[states]\nx1 = {low = -1, high = 1, flow = 'u*x2'}\n"
        "x2 = {low = -1, high = 1, flow = 'sin(5*x1)'}\n[inputs]\nu = {low = 0.03, high = 10}\n"
        "[outputs]\ny = {equation = 'x1'}\n[observer]\nkind = 'high_gain'\ntheta = 5\ngains = [2, 1]\ndt = 1e-3\n"
    )
    answer = as_json("design", "driven.toml", "--rates", "1,5")
    (refused,) = answer["refused"].values()
    assert "hinders most" in refused
    assert [point["designed"] for point in answer["points"]] == [None, 1]
    assert answer["files"] == ["build/driven/design.svg", "build/driven/design.png"]
    _, err = hgogen("design", "driven.toml", "--rates", "5", status=2)
    assert "hinders most" in " ".join(err.split())
