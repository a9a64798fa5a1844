"""No analysis goes on without end: what is beyond its limit of work is left out, and it says so."""

import time

import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.prove.error_models import slopes_on
from hgogen.rigor.box import sign_at
from hgogen.rigor.field import TooLarge, quotients, ring_of

SECONDS = 60  # of processor time, of what takes well below one; without the limits it takes minutes
x, z, w = (hg.Signal(name, low=1, high=2) for name in "xzw")
y = hg.Signal("y")


def plant(*flow: sp.Expr, output: sp.Expr = x) -> hg.System:
    return hg.System("large", states=(x, z, w)[: len(flow)], outputs=(y,), flow=flow, output=[output])


def test_the_sign_of_a_high_power_is_not_asked_of_exact_numbers() -> None:
    start = time.process_time()
    assert sign_at(-(x**-100000), {x: sp.Rational(1234567, 1000000)}) == "?"
    assert sign_at(-(x**-100), {x: sp.Rational(1234567, 1000000)}) == "< 0"
    assert time.process_time() - start < SECONDS


@pytest.mark.parametrize("exponent", [50_000, 10**6])
def test_a_high_power_of_a_sum_is_too_large_for_exact_algebra(exponent: int) -> None:
    ring = ring_of((x, z))
    with pytest.raises(TooLarge):
        quotients([(x + z) ** exponent], (x, z), ring)
    assert quotients([x**exponent], (x, z), ring)[0][0].total_degree() == exponent
    assert len(quotients([(x + z) ** 1000], (x, z), ring)[0][0]) == 1001


@pytest.mark.full
def test_a_slope_of_high_degree_is_left_as_it_is() -> None:
    form = hg.forms.uniform(plant((x**2 + z) ** 100000, -z))
    start = time.process_time()
    assert slopes_on(form)[0].has(sp.Pow)
    assert time.process_time() - start < SECONDS


@pytest.mark.full
def test_slopes_of_long_derivatives_with_roots_are_left_out_and_it_says_so() -> None:
    """A growth law with a power and a root of the sum of all states, read through that sum, whose fourth derivative
    has 27,000 nodes."""
    states = [hg.Signal(f"s{k}", low=sp.Rational(1, 1000), high=5) for k in range(5)]
    c, *cells = states
    total = sp.Add(*cells)
    growth = cells[0] / (1 + total**20 / 3) ** sp.Rational(1, 20)
    flow = [-c, growth - c * cells[0], c * cells[0] - cells[1], cells[1] - cells[2], cells[2] - cells[3]]
    start = time.process_time()
    answer = hg.singularity(hg.System("growth", states=states, outputs=(y,), flow=flow, output=[total]))
    assert time.process_time() - start < SECONDS
    assert (answer.jets, answer.checks[0].verdict) == ((), Verdict.UNKNOWN)
    assert "more than 2000, is too large" in str(answer.checks[0].reason)


@pytest.mark.full
def test_a_point_without_a_slope_is_no_traceback() -> None:
    """x**-100000 leaves the doubles next to 0, where step lengths are judged as well."""
    p, q = hg.Signal("p", low=-1, high=1), hg.Signal("q", low=-1, high=1)
    pole = hg.System("pole", states=(p, q), outputs=(y,), flow=[p**-100000 + q, -q], output=[p])
    observer = hg.observers.cascade(hg.forms.triangular(pole), theta=4.0, accept=["singular.p"])
    assert hg.sample(observer, dt=0.01).dt == 0.01
