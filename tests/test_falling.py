"""How e' S e falls along a trial, and the eigenvalues of scaled S: by hand, across jumps, in other coordinates."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import eigvalsh

import hgogen as hg
from hgogen.run.comparison import SMALL, lyapunov_decay
from hgogen.trial import Jump, OrnsteinUhlenbeck, Trial, simulate


def plant() -> hg.System:
    x1, x2 = hg.Signal("x1", low=-4, high=4), hg.Signal("x2", low=-4, high=4)
    flow = [2 * x2, -sp.sin(x1) - x2 / 5]
    return hg.System("plant", states=(x1, x2), outputs=(hg.Signal("y"),), flow=flow, output=[x1])


TRIAL = Trial("swing", 6.0, {"x1": 1.0, "x2": 0.5}, noise={"y": OrnsteinUhlenbeck(0.1)}, jumps=(Jump(3.0, "x2", -1.0),))


def step_of(theta: object = 1.0, form: hg.Form | None = None) -> hg.Step:
    made = hg.observers.riccati(form or hg.forms.triangular(plant()), Q=(0.1, 1), R=0.1, theta=theta)
    return hg.sample(made, dt=5e-3)


@pytest.mark.parametrize(("theta", "g"), [(1.0, 0), (4.0, 0), (hg.theta.decaying(5.0, rate=1.0), 1)])
def test_it_is_what_the_definitions_give(theta: object, g: int) -> None:
    step = step_of(theta)
    known = lyapunov_decay(step, TRIAL)
    assert known is not None
    truth = simulate(plant(), TRIAL, 5e-3)
    step.reset()
    run = step.run(y=truth.y)
    e, S = run.x - truth.x, np.linalg.inv(run.covariance)
    V = np.einsum("ki,kij,kj->k", e, S, e)
    ratios = []
    for part, t in ((V[:600], truth.t[:600]), (V[600:], truth.t[600:])):
        small = np.flatnonzero(part <= SMALL * part.max())
        ratios += [(part[k + 1] / part[k], t[k]) for k in range(small[0] if len(small) else len(part) - 1)]
    assert len(ratios) == known.calls > 100
    assert (known.ratio, known.time) == pytest.approx(max(ratios), rel=1e-6)
    assert 0.5 < known.ratio < 1
    level = run.traces.get("theta", np.full(len(S), theta if g == 0 else np.nan))
    spread = [q**g * eigvalsh(each * np.outer([1, q], [1, q])) for q, each in zip(level, S, strict=True)]
    assert known.eigenvalues == pytest.approx((np.min(spread), np.max(spread)), rel=1e-6)


def test_noise_and_jumps_are_not_in_it() -> None:
    """Across a jump V rises a thousandfold, and noise makes it rise at many calls."""
    quiet, still = replace(TRIAL, noise={}), replace(TRIAL, jumps=())
    assert lyapunov_decay(step_of(), quiet) == lyapunov_decay(step_of(), TRIAL)
    assert lyapunov_decay(step_of(), still).ratio < 1


def test_other_coordinates_have_the_same_v() -> None:
    """z2 = 2 x2 in the phase form, whose first covariance is made the same; S is another one."""
    form = hg.forms.phase(plant())
    assert form.to_form[1] != form.system.states[1]
    start = {"Q": (0.1, 4), "R": 0.1, "covariance": (1, 4)}
    moved = lyapunov_decay(hg.sample(hg.observers.riccati(form, **start), dt=5e-3), TRIAL)
    known = lyapunov_decay(step_of(), TRIAL)
    assert moved.ratio == pytest.approx(known.ratio, rel=1e-2)
    assert moved.eigenvalues != pytest.approx(known.eigenvalues, rel=0.1)


def test_of_a_gain_there_is_none() -> None:
    observer = hg.observers.high_gain(hg.forms.triangular(plant()), theta=4, poles=(-1, -1))
    assert lyapunov_decay(hg.sample(observer, dt=5e-3), TRIAL) is None


def test_it_says_that_it_proves_nothing() -> None:
    known = lyapunov_decay(step_of(), TRIAL)
    said = known.sentence("s")
    assert said.startswith("shown in trials, not proved: without noise V = e' S e at a call is at most 0.9")
    assert "scaled S has eigenvalues from" in said
    exact = replace(TRIAL, start={"x1": 0.0, "x2": 0.0}, jumps=())  # no error at all
    assert lyapunov_decay(step_of(), exact).sentence("s").startswith("shown in trials, not proved: scaled S has")
