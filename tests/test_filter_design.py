"""A filter for the injection, of little noise at a wanted rate: what is proved of it, against runs and as it runs."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from plants import MODELS, chain, model, two_outputs
from scipy.linalg import expm

import hgogen as hg
from hgogen.estimators.integrators import integrators
from hgogen.model import load
from hgogen.prove.filter_design import InjectionFilter, _Search, injected
from hgogen.reading.given import BadGain, Misfit

pytest.importorskip("clarabel")


@cache
def form() -> hg.Form:
    return hg.forms.triangular(model("pendulum"))


@cache
def designed(size: int = 2, state: str = "w") -> InjectionFilter:
    return hg.design.injection_filter(form(), theta=20, rate=2, size=size, state=state)


@pytest.mark.full
def test_a_filter_is_better_than_the_first_one_and_proved() -> None:
    one = designed()
    assert float(one.bound) < 0.85 * float(one.before)
    observer = hg.observers.filtered_injection(form(), **one.gains)
    known = {check.id.fact: check for check in observer.checks if check.id.maker == "filtered_injection"}
    assert known["theta"].proofs[0].fact.falls.rate >= 2 * 0.99
    assert str(one).endswith("before")


@pytest.mark.full
def test_the_bound_of_the_step_is_close_to_that_of_continuous_time() -> None:
    """With its own rate in the place of the wanted one, a sample on the line between two."""
    step = hg.sample(hg.observers.filtered_injection(form(), **designed().gains), hg.methods.rk4, dt=1e-3)
    as_it_runs = hg.noise_gain(step)
    assert isinstance(as_it_runs, hg.NoiseGain)
    (value,) = (bound for (state, _), bound in as_it_runs.gains.items() if state == "w")
    assert value < 1.1 * float(designed().bound)


@pytest.mark.ordinary("1-w", "2-w")
@pytest.mark.parametrize(("size", "state"), [(1, "w"), (2, "w"), (2, "q")])
def test_no_slope_that_is_held_lets_more_noise_through(size: int, state: str) -> None:
    """The largest gain from noise to the state is the integral of |c exp(M t) B|, at every corner of the slopes."""
    one = designed(size, state)
    error = injected(integrators("it", form()), *(np.array(part) for part in (one.F, one.G, one.H)))
    e, scales = error.at(20).floats, error.scales(20)
    at = form().names.index(state)
    for d in np.random.default_rng(0).choice([-1.0, 1.0], size=(6, e.G.shape[1])):
        M = e.M + (e.G * d) @ e.H
        assert np.linalg.eigvals(M).real.max() < -2
        h, response, total = 2e-4, e.B[:, 0], 0.0
        E = expm(M * h)
        for _ in range(20_000):
            total += abs(response[at]) * h
            response = E @ response
        assert total / float(scales[at]) < float(one.bound)


@pytest.mark.full
def test_a_filter_of_few_states_may_be_enough() -> None:
    assert float(designed(1).bound) < float(designed(1).before) / 1.5


def test_a_search_that_leads_nowhere_leaves_the_first_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Search, "improved", lambda self, first: iter(()))
    one = hg.design.injection_filter(form(), theta=20, rate=2)
    assert one.bound == one.before
    assert one.state == "w"


def test_what_floats_find_counts_only_once_it_is_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    """A filter that is told to be better, and does not decay."""
    wild = (np.diag([1.0, 1.0]), np.array([1.0, 0.0]), np.eye(2))
    monkeypatch.setattr(_Search, "improved", lambda self, first: iter([wild]))
    one = hg.design.injection_filter(form(), theta=20, rate=2)
    assert one.bound == one.before


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"theta": 0}, "theta = 0 must be a positive finite number"),
        ({"rate": -1}, "rate = -1 must be a positive finite number"),
        (
            {"rate": 1000},
            "rate = 1000 is not shown to be reached at theta = 20 by a first filter; raise theta",
        ),
        ({"state": "v"}, "state = 'v' is none of q, w"),
        ({"size": 9}, "size = 9 must be a whole number, from 1 to 6"),
    ],
)
def test_what_it_does_not_take(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadGain, match=f"^{said}"):
        hg.design.injection_filter(form(), **{"theta": 20, "rate": 2, **changes})


def test_forms_that_are_no_chain() -> None:
    with pytest.raises(BadGain, match="takes one output"):
        hg.design.injection_filter(hg.forms.original(two_outputs()), theta=5, rate=1)
    with pytest.raises(BadGain, match="for a chain of at most 6 states, not of 7"):
        hg.design.injection_filter(hg.forms.triangular(chain(7)), theta=5, rate=1)
    with pytest.raises(Misfit, match="injection_filter"):
        hg.design.injection_filter(load(MODELS / "pendulum.py").plant, theta=5, rate=1)  # type: ignore[arg-type]
