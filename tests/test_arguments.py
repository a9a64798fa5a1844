"""What the keys of a tuning's table stand for: poles, tables with a kind, and what a bank takes of its member."""

from pathlib import Path
from typing import Any

import pytest

import hgogen as hg
from hgogen.model import load
from hgogen.modelfiles.tuning import faults, poles
from hgogen.reading.text_model import BadModelFile

CART = """
name = "cart"
states.x = {low = -3, high = 3, flow = "v"}
states.v = {low = -6, high = 6, flow = "-4*x - 0.2*v**3 + d"}
states.d = {low = -5, high = 5, flow = "0"}
outputs.y = {equation = "x"}
outputs.g = {equation = "v"}
[tuning.riccati]
form = "block_triangular"
Q = [1e-6, 1e-3, 1e-2]
R = [1e-8, 1e-7]
method = "cholesky"
between = "hold"
dt = 1e-3
periods = {g = 0.02}
"""
BANK = '[tuning.bank]\nmember = "riccati"\ncount = 3\nperiod = 0.5\n'


def tuned(folder: Path, text: str) -> Any:
    path = folder / "cart.toml"
    path.write_text(CART + text)
    return load(path)


@pytest.mark.parametrize(
    ("listed", "chains", "meant"),
    [
        ([-1, -2], 1, [-1, -2]),
        ([[-1, 0.5], [-1, -0.5]], 1, [-1 + 0.5j, -1 - 0.5j]),
        ([[-1, 0.5], [-1, -0.5], -2], 1, [-1 + 0.5j, -1 - 0.5j, -2]),
        ([[-1], [-1, -2]], 2, [[-1], [-1, -2]]),
        ([[-1, -2], [-3, -4]], 2, [[-1, -2], [-3, -4]]),
        ([[-1], [[-1, 0.5], [-1, -0.5]]], 2, [[-1], [-1 + 0.5j, -1 - 0.5j]]),
        ([-1, -2, -3], 2, [-1, -2, -3]),  # which the observer refuses
        ((-1, -2), 1, (-1, -2)),
        ("-1", 1, "-1"),
    ],
)
def test_a_pair_of_a_chains_list_is_two_real_poles(listed: Any, chains: int, meant: Any) -> None:
    assert poles(listed, chains) == meant


def test_real_poles_of_two_chains(tmp_path: Path) -> None:
    """(s + 1) and (s + 1)(s + 2) = s^2 + 3 s + 2; block_triangular takes y's chain (x) and g's chain (v, d)."""
    text = '[tuning.high_gain]\nform = "block_triangular"\ntheta = 10\ndt = 1e-3\npoles = [[-1], [-1, -2]]\n'
    assert "K = (1), (3, 2)" in tuned(tmp_path, text).step("high_gain").observer.equations
    flat = tuned(tmp_path, text.replace("[[-1], [-1, -2]]", "[-1, -1, -2]"))
    with pytest.raises(BadModelFile, match=r"poles = \[-1, -1, -2\] must be 2 sequences, one for each output"):
        flat.step("high_gain")


def test_a_bank_is_sampled_as_its_member(tmp_path: Path) -> None:
    step = tuned(tmp_path, BANK).step("bank")
    assert (step.dt, step.clock.periods, step.clock.between) == (1e-3, (1e-3, 0.02), "hold")
    assert step.method is hg.methods.cholesky
    own = tuned(tmp_path, BANK + 'dt = 2e-3\nmethod = "continuous_discrete"\nbetween = "line"\n').step("bank")
    assert (own.dt, own.clock.periods, own.clock.between) == (2e-3, (2e-3, 0.02), "line")
    assert own.method is hg.methods.continuous_discrete


def test_a_bank_around_itself_is_refused(tmp_path: Path) -> None:
    loaded = tuned(tmp_path, BANK.replace('"riccati"', '"bank"'))
    with pytest.raises(BadModelFile, match=r"tuning\.bank\.member: is 'bank', which must be the name of another"):
        loaded.step("bank")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'theta = {kind = "decaying", theta0 = 3, rate = 1}',
            "in theta, decaying has no argument 'theta0'; did you mean ",
        ),
        ('theta = {kind = "decaying", theta_0 = 3}', "in theta, the key 'rate' is missing; decaying needs it"),
        (
            'theta = {kind = "adaptive", theta_1 = 4, mu = [1, 2], innovation = {kind = "window", dd = 1}}',
            "in innovation, window has no argument 'dd'; did you mean d?",
        ),
        (
            'form = {kind = "triangular", measurd = true}',
            "slip.form.measurd: triangular has no argument 'measurd'; did",
        ),
        ("form = 3", "not callable"),
    ],
)
def test_a_key_within_a_table_has_its_near_one(tmp_path: Path, text: str, said: str) -> None:
    loaded = tuned(tmp_path, f'[tuning.slip]\nkind = "riccati"\nQ = [1, 1, 1]\nR = 1\n{text}\n')
    with pytest.raises(BadModelFile) as caught:
        loaded.step("slip")
    assert said in str(caught.value)


def test_what_takes_nothing_lists_nothing() -> None:
    assert list(faults(lambda plant: plant, ["x"], first=1)) == [("x", "<lambda> has no argument 'x'; it takes none")]
