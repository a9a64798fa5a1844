"""What code states of its errors as it runs: the proved numbers on the safe side, all that they assume, and else that
nothing is proved."""

import sys
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import emitted
import numpy as np
import pytest
from plants import model
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.call import CallableStep
from hgogen.certificates import contraction
from hgogen.commands.claims import checked
from hgogen.emit.manual import proved_bounds
from hgogen.model import load
from hgogen.prove import questions
from hgogen.prove.questions import Signed
from hgogen.sentence import because, up

INPUTS: dict[str, Any] = {
    "noise": {"y": 1e-3},
    "rounded": {"y": 1e-4},
    "late": {"y": 1e-5},
    "disturbance": {"w": 0.2, "q": 0},
    "parameters": {"a": 0.1},
    "rates": {"tau": 5},
}
UNPROVED = "As it runs: no bound of the error of its estimate is proved; `hgogen check` says why"
KNOWN = Signed(
    bounds={"q": 0.00199, "w": 0.0201},
    settles=0.811,
    begins={"q": 1.39, "w": 6.99},
    everywhere=True,
    assumed={"rates": {"tau": 5}},
    inside={"q": 0.0204, "w": 0.5},
    least=Fraction("4.41"),
    longest=Fraction("0.119"),
)


@cache
def step_of(**options: Any) -> CallableStep:
    observer = hg.observers.high_gain(hg.forms.triangular(model("pendulum")), theta=20, poles=(-1, -1))
    return hg.sample(observer, hg.methods.rk4, dt=1e-3, **options)


def said(**other: Any) -> str:
    """What is stated of numbers that are known."""
    return "\n".join(proved_bounds(replace(step_of(), signed=replace(KNOWN, **other))))


def manual(step: CallableStep) -> str:
    """The text of NAME.md, in one line."""
    return emitted.manual(hg.targets.c99(step, check=False))


def test_a_manual_states_what_is_proved_and_all_that_it_assumes() -> None:
    known, text = hg.error_bound(step_of(), **INPUTS), manual(hg.signed(step_of(), **INPUTS))
    for name, unit in (("q", "rad"), ("w", "rad/s")):
        assert f"|{name} - its estimate| <= {up(1.1 * known.bounds[name], 2)} {unit} " in text
    assert known.settles is not None
    assert f"for ever, from {up(known.settles, 2)} s after the first call on, wherever in its ranges the plant" in text
    for each in (
        "a call comes every 0.001 s, with the samples and the exact inputs of that time;",
        "gains and parameters are the nominal ones of this file;",
        "no call since the start or a reset has returned a status bit but OUTSIDE_BOX;",
        "each sample of y errs by at most 0.001 rad, whatever its course;",
        "a sample of y is rounded to steps of 0.0001 rad;",
        "y is sampled within 1e-05 s of the time of its call;",
        "w' is within 0.2 (rad/s)/s of what the model says;",
        "the plant's a is constant and within 0.1 1/s2 of its declared value;",
        "tau moves by at most 5 (1/s2)/s;",
        "between two calls tau moves on a straight line;",
        "at all times the plant stays in -3.979 <= q <= 3.979, -19.97 <= w <= 19.97;",
        "and its inputs in -1 <= tau <= 1;",
        "nothing else enters",
        "at every constant theta from 4.5 to 20.",
        "at every dt up to 0.11 s",
        "Not included: the rounding of floating-point numbers.",
    ):
        assert each in text
    assert "q' is within" not in text


def test_only_its_head_is_another() -> None:
    files = (hg.targets.c99(each, check=False) for each in (step_of(), replace(step_of(), signed=KNOWN)))
    first, second = files
    assert first["pendulum.c"] == second["pendulum.c"]
    assert "As it runs" not in first["pendulum.h"]
    assert "As it runs, proved" in second["pendulum.h"]
    assert "As it runs, proved" in hg.targets.rust(replace(step_of(), signed=KNOWN), check=False)["pendulum.rs"]


def test_numbers_are_rounded_to_the_safe_side() -> None:
    text = said()
    assert "|q - its estimate| <= 0.0022 rad" in text  # 1.1 of .00199 is .002189
    assert "|w - its estimate| <= 0.023 rad/s" in text
    assert "from 0.82 s after" in text
    assert "-3.979 <= q <= 3.979, -19.5 <= w <= 19.5" in text
    assert "theta from 4.5 to 20" in text
    assert "dt up to 0.11 s" in text


def test_where_the_estimate_has_to_begin_is_stated() -> None:
    text = said(everywhere=False)
    assert "from an estimate with at most q off by 1.3, w off by 6.9 there, which a start alone does not ensure" in text
    assert "wherever" not in text


def test_without_a_time_none_is_stated() -> None:
    text = said(settles=None, unsettled=because("of {n} states", n=9), begins={}, everywhere=False)
    decayed = "for ever, once what is left of the error at its start has decayed"
    assert f"{decayed}, for which no time is proved: of 9 states" in text
    assert "after the first call" not in text


@pytest.mark.parametrize("least", [None, Fraction("19.95")])
def test_theta_is_its_declared_one_where_no_interval_is_proved(least: Fraction | None) -> None:
    text = said(least=least, longest=None)
    assert "the error decays at theta = 20; at any other theta nothing is proved." in text
    assert "every dt" not in text


def test_ends_without_what_is_between_are_not_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contraction, "all_shorter", lambda *_: ())
    observer = hg.observers.high_gain(hg.forms.triangular(model("pendulum")), theta=19, poles=(-1, -1))
    step = hg.signed(hg.sample(observer, hg.methods.rk4, dt=1e-3), rates={"tau": 5})
    assert hg.contraction(step).reach.least is not None
    text = "\n".join(proved_bounds(step))
    assert "the error decays at theta = 19; at any other theta nothing is proved." in text
    assert "every dt" not in text


@pytest.mark.parametrize(
    ("options", "rates", "expected"),
    [
        ({"between": "hold"}, {}, "between two calls tau is held"),
        ({}, {"tau": 5}, "between two calls tau moves on a straight line"),
        ({}, {}, "tau never moves"),
    ],
)
def test_how_an_input_moves_is_stated(options: dict[str, str], rates: dict[str, float], expected: str) -> None:
    text = "\n".join(proved_bounds(replace(step_of(**options), signed=replace(KNOWN, assumed={"rates": rates}))))
    assert [each for each in ("held", "straight", "never") if each in text] == [
        word for word in ("held", "straight", "never") if word in expected
    ]
    assert expected in text


@pytest.mark.parametrize(
    "sizes",
    [{}, {"noise": {"y": 1e-3}}],  # how fast tau moves is not known
)
def test_what_is_not_proved_is_said_not_to_be(sizes: dict[str, Any]) -> None:
    assert proved_bounds(hg.signed(step_of(), **sizes)) == [UNPROVED]
    assert proved_bounds(hg.signed(step_of(guards="none"), rates={"tau": 5}, **sizes)) == [UNPROVED]


@pytest.mark.full
def test_digits_that_a_solver_leaves_open_are_not_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights that are off by a millionth are as good to it."""
    before, solved, random = manual(hg.signed(step_of(), **INPUTS)), questions.best_solution, np.random.default_rng(1)
    bounds = hg.error_bound(step_of(), **INPUTS).bounds

    def otherwise(*arguments: Any) -> Any:
        known = solved(*arguments)
        if known is None:
            return None
        off = 1 + 1e-6 * random.random(known[0].shape)
        return known[0] * (off + off.T) / 2, known[1] * (1 + 1e-6 * random.random(known[1].shape))

    monkeypatch.setattr(questions, "best_solution", otherwise)
    assert hg.error_bound(step_of(), **INPUTS).bounds != bounds
    assert manual(hg.signed(step_of(), **INPUTS)) == before


BOUNDS = "[bounds]\nnoise = {y = 1e-3}\n"


def plain(tmp_path: Path, bounds: str) -> str:
    file = tmp_path / "swing.toml"
    signals = "[states.q]\nflow = 'w'\nlow = -4\nhigh = 4\n[states.w]\nflow = '-19.6*sin(q)'\nlow = -20\nhigh = 20\n"
    observer = "[observer]\nkind = 'high_gain'\ntheta = 20\npoles = [-1, -1]\ndt = 1e-3\n"
    file.write_text(f"name = 'swing'\n{signals}[outputs.y]\nequation = 'q'\n{observer}{bounds}")
    return str(file)


def generated(tmp_path: Path, bounds: str, *more: str) -> str:
    result = CliRunner().invoke(cli.app, ["generate", plain(tmp_path, bounds), "--out", str(tmp_path), *more])
    assert result.exit_code == 0, result.output
    (header,) = tmp_path.glob("swing*/swing.h")
    return header.read_text() + header.with_suffix(".md").read_text().replace("\\", "")


@pytest.mark.full
def test_generate_states_what_a_model_asks_for(tmp_path: Path) -> None:
    assert "As it runs" not in generated(tmp_path, "")
    text = generated(tmp_path, BOUNDS)
    assert "each sample of y errs by at most 0.001, whatever its course" in " ".join(text.replace("\n *", "").split())
    assert "as it runs" not in text.partition("As it runs, proved:")[2].partition("```")[0].lower()
    assert text == generated(tmp_path, BOUNDS)


def test_without_a_solver_nothing_is_stated_as_proved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    text = generated(tmp_path, "[bounds]\nnoise = {y = 1.5e-3}\n")
    assert UNPROVED in text
    assert "As it runs, proved" not in text


def test_who_is_sent_to_a_check_is_told_there(tmp_path: Path) -> None:
    """Also of an observer of which no step is proved."""
    path = plain(tmp_path, f"[tuning.cascade]\ntheta = 100\ndt = 1e-3\n{BOUNDS}")
    assert UNPROVED in generated(
        tmp_path, f"[tuning.cascade]\ntheta = 100\ndt = 1e-3\n{BOUNDS}", "--observer", "cascade"
    )
    (check,) = (check for check in checked(load(path), name="cascade").checks if check.id == "cascade.error")
    assert "the proof is for a constant injection" in str(check.reason)
