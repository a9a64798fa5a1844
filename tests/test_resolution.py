"""A dt is refused with which a state stands still in its precision, or a count does not fit; the dt named is taken."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.step import BadStep
from hgogen.stepping.discretise import StepTooShort, demand_motion
from hgogen.stepping.recovery import LONGEST

pytestmark = pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")


def charge(low: float = 0, high: float = 1, hours: float = 1) -> hg.Observer:
    """A charge s' = -i/(3600 h), |i| <= 1, and a voltage that relaxes, both measured."""
    s, v = hg.Signal("s", low=low, high=high), hg.Signal("v", low=-1, high=1)
    i = hg.Signal("i", low=-1, high=1)
    outputs = (hg.Signal("a"), hg.Signal("b"))
    flow = [-i / (3600 * hours), i - v]
    plant = hg.System("cell", states=(s, v), inputs=(i,), outputs=outputs, flow=flow, output=[s, v])
    return hg.observers.riccati(hg.forms.original(plant), Q=(1e-4, 1e-4), R=(1e-3, 1e-3), covariance=(1, 1))


def named(error: Exception) -> float:
    (dt,) = re.findall(r"take dt >= ([0-9.e+-]+)", str(error))
    return float(dt.rstrip("."))


def test_a_charge_that_float_does_not_count_is_refused() -> None:
    """1e-4/3600 is less than 2^-25, half the distance of two floats below 1."""
    with pytest.raises(StepTooShort, match=r"moves s by at most 2\.78e-08 in a step, .* is 2\.98e-08") as caught:
        hg.sample(charge(), dt=1e-4, real="float")
    take = named(caught.value)
    assert take == pytest.approx(3600 * 2**-25, rel=0.01)
    assert hg.sample(charge(), dt=take, real="float").dt == take


@pytest.mark.parametrize("target", [hg.targets.c99, hg.targets.rust, hg.targets.lanes], ids=lambda one: one.__name__)
def test_files_in_float_are_refused_of_a_step_in_double(target) -> None:  # type: ignore[no-untyped-def]
    step = hg.sample(charge(), dt=1e-4)
    with pytest.raises(StepTooShort, match="or estimate s as the difference from a constant"):
        target(step, real="float")
    assert target(step, real="double")


@given(
    end=st.floats(1e-6, 1e6), rate=st.floats(1e-6, 1e6), real=st.sampled_from(["float", "double"]), sign=st.booleans()
)
def test_what_is_refused_stands_still_and_what_is_named_moves(end: float, rate: float, real: str, sign: bool) -> None:
    x, u = hg.Signal("x", low=-end * sign, high=end), hg.Signal("u", low=-1, high=1)
    plant = hg.System("p", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=[rate * u], output=[x])
    form = hg.forms.triangular(plant)
    with pytest.raises(StepTooShort) as caught:
        demand_motion(form, 1e-18 * end / rate, real)
    take = named(caught.value)
    demand_motion(form, take, real)
    kind = {"float": np.float32, "double": np.float64}[real]
    below = np.nextafter(kind(end), kind(0))
    assert below - kind(1.01 * take * rate) < below
    assert below - kind(0.97 * take * rate) == below


def test_a_state_that_rests_or_has_no_range_limits_nothing() -> None:
    x, w = hg.Signal("x", low=0, high=1), hg.Signal("w")
    plant = hg.System("p", states=(x, w), outputs=(hg.Signal("y"),), flow=[0, -w], output=[x + w])
    demand_motion(hg.forms.original(plant), 1e-30, "float")


@pytest.mark.parametrize("dt", [1e-9, 1e-12, 1e-300])
def test_a_dt_with_which_the_fault_counts_overflow_is_refused(dt: float) -> None:
    """The charge moves by up to 1/3.6 a second, the voltage by 2: a tenth of its range takes .1 s."""
    observer = charge(hours=1e-3)
    with pytest.raises(StepTooShort, match=f"in the {LONGEST // 2} samples that can be counted") as caught:
        hg.sample(observer, dt=dt)
    take = named(caught.value)
    assert take == pytest.approx(0.1 / (LONGEST // 2), rel=0.01)
    assert hg.sample(observer, dt=take).dt == take
    with pytest.raises(StepTooShort):
        hg.sample(observer, dt=0.98 * take)
    assert hg.sample(observer, dt=1e-10, guards="none").clock.guards == "none"  # has no counts


def test_a_filter_that_follows_slowly_is_no_reason_to_refuse_a_dt() -> None:
    """Of a constant, with next to no noise: an average over all samples."""
    x = hg.Signal("x", low=-2, high=2)
    plant = hg.System("rest", states=(x,), outputs=(hg.Signal("y"),), flow=[0], output=[x])
    observer = hg.observers.riccati(hg.forms.triangular(plant), Q=(1e-12,), R=1e12, covariance=(1e-12,))
    assert hg.sample(observer, dt=1e-3).dt == 1e-3


@pytest.mark.parametrize(
    "flow",
    [
        lambda a, b: [-a / 14400, -b],  # four hours are no time in which an error settles
        lambda a, b: [a / 10 + 3 * b / 10, -a / 30 - b / 10],  # nilpotent: its eigenvalues are 0 but for rounding
    ],
)
def test_a_slow_plant_is_no_reason_to_refuse_a_dt(flow) -> None:  # type: ignore[no-untyped-def]
    a, b = hg.Signal("a", low=-5, high=5), hg.Signal("b", low=-5, high=5)
    outputs = (hg.Signal("y"), hg.Signal("z"))
    plant = hg.System("slow", states=(a, b), outputs=outputs, flow=flow(a, b), output=[a, b])
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1, 1), R=(1e-3, 1e-3))
    assert hg.sample(observer, dt=1e-4).dt == 1e-4


def test_a_filter_that_forgets_as_fast_as_its_plant_decays_is_sampled() -> None:
    """F + rho/2 has no rate there, and errors decay at rho/2."""
    a, b = hg.Signal("a", low=-2, high=2), hg.Signal("b", low=-2, high=2)
    plant = hg.System("ring", states=(a, b), outputs=(hg.Signal("y"),), flow=[b, -a - b], output=[a])
    observer = hg.observers.kalman_like(hg.forms.state_affine(plant), rho=1, R=1e-3)
    assert hg.sample(observer, dt=1e-2).dt == 1e-2


def test_a_dt_that_is_no_normal_number_is_refused() -> None:
    with pytest.raises(BadStep, match="dt = 5e-324 must be a positive time in seconds"):
        hg.sample(charge(), dt=5e-324)
