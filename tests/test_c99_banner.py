"""What a header says of claims, where it says the hypotheses are, and what to do when a status bit is raised."""

import re
from collections.abc import Callable

import emitted
import plants
import pytest
from plants import fitzhugh_nagumo, kalman, pendulum, van_der_pol

import hgogen as hg
from hgogen.emit.manual import model_digest
from hgogen.step import StepMayFail
from hgogen.theorem import rows


def words(observer: hg.Observer, dt: float = 1e-3) -> str:
    """The header's comments, and the manual, as one line, without the marks of the fold and of Markdown."""
    step = hg.sample(observer, dt=dt)
    files = hg.targets.c99(step, check=False)
    text = files[f"{step.name}.h"].replace("\n *", "\n") + files[f"{step.name}.md"].replace("\\", "")
    return " ".join(text.split())


def adaptive(**changes: object) -> hg.Observer:
    gains = {"mu": (0.1, 0.2), "innovation": hg.innovation.staggered(1.0), **changes}
    return kalman(van_der_pol(), theta=hg.theta.adaptive(2.0, **gains))


def uncertain() -> hg.Observer:
    """x1' = k x2, x2' = -x1, y = x1, k in [-1, 1]: no input that could show x2 where k = 0."""
    x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
    k, y = hg.Signal("k", "", "", 0.5, low=-1, high=1), hg.Signal("y")
    plant = hg.System("uncertain", states=(x1, x2), outputs=(y,), parameters=(k,), flow=[k * x2, -x1], output=[x1])
    return hg.observers.riccati(hg.forms.triangular(plant), Q=(1, 1), R=1, accept="triangular.a_2")


# --- claims -------------------------------------------------------------------------------------------------


def test_what_was_accepted_says_what_follows() -> None:
    coasts = (
        "the observer predicts without correction while a_2 is near 0: the states behind it are then seen only "
        "through changes of u"
    )
    accepted = "refuted (accepted by the user): triangular.a_2: at u = 0"
    assert f"{accepted}; so {coasts}" in words(fitzhugh_nagumo(), 0.01)
    check = next(check for check in fitzhugh_nagumo().checks if check.id == "triangular.a_2")
    assert check.consequence == coasts
    assert f"knowing that {coasts}." in check.advice


def test_what_was_accepted_without_another_consequence_leaves_no_theorem() -> None:
    accepted = "refuted (accepted by the user): triangular.a_2: at k = 0"
    assert f"{accepted}; so no convergence theorem is in force" in words(uncertain())


def test_theta_below_the_bound_contradicts_nothing() -> None:
    banner = words(pendulum(theta=4))
    assert "unknown: high_gain.theta: not shown: 4 is below the certified 4.4" in banner


def test_a_step_length_is_not_said_to_be_good() -> None:
    """Between the two lengths that are named it may fail, and at other gains so."""
    with pytest.warns(StepMayFail):
        banner = words(pendulum(theta=20), 0.08)
    assert "admitted" not in banner
    assert "judged with gains and parameters at their nominal values, which proves nothing" in banner


def test_a_claim_that_is_not_proved_is_a_line_with_its_number() -> None:
    """Up to the first comma outside of parentheses; the search for it is evidence, and no number of the claim."""
    lines = hg.targets.c99(hg.sample(pendulum(theta=4), dt=1e-3), check=False)["pendulum.h"].splitlines()
    first = lines.index(" * Claims: 5 proved") + 1
    assert (
        re.sub(r"[0-9.]+$", "..", lines[first])
        == " *   unknown: high_gain.theta: not shown: 4 is below the certified .."
    )
    assert lines[first + 1] == " * Hypotheses of its theorem, and the evidence of the claims: pendulum.md"


@pytest.mark.ordinary("pendulum", "cascaded_tanks", "two")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_hypotheses_are_left_to_the_document_that_the_header_names(name: str) -> None:
    step = emitted.step(name)
    head = emitted.files(name)[f"{step.name}.h"]
    (document,) = hg.targets.markdown(step)
    assert f"{document}\n" in head
    said = [row for row in rows(step.observer.theorem, step.observer.checks) if not row.checks and row.reason]
    assert len(said) >= 4
    banner = " ".join(head.replace("\n *", "\n").split())
    assert not [row.claim for row in said if f"{row.claim}; {row.reason}" in banner]


# --- the estimate at its outer box --------------------------------------------------------------------------

LIMITED: dict[str, tuple[Callable[[], hg.Observer], str]] = {
    "high gain": (lambda: pendulum(theta=3), "widen the ranges or lower theta."),
    "proved theta": (lambda: pendulum(theta=50), "widen the ranges."),
    "no high gain": (lambda: pendulum(theta=1), "widen the ranges."),
    "Kalman filter": (lambda: kalman(van_der_pol()), "widen the ranges."),
    "high-gain Kalman filter": (lambda: kalman(van_der_pol(), theta=3), "widen the ranges or lower theta."),
    "adaptive": (adaptive, "widen the ranges or lower theta_1."),
    "decaying": (lambda: kalman(van_der_pol(), theta=hg.theta.decaying(3, 1)), "widen the ranges."),
}


@pytest.mark.parametrize("name", LIMITED)
def test_a_gain_is_to_be_lowered_only_where_there_is_one_to_lower(name: str) -> None:
    make, advice = LIMITED[name]
    banner = words(make(), 0.01 if name == "adaptive" else 1e-3)
    suspended = "the convergence theorem, where it applies, is suspended"
    assert f"{suspended}. To do: none if brief; if it stays, {advice}" in banner


@pytest.mark.parametrize(
    ("observer", "rule"),
    [
        (pendulum(theta=5), "classical Runge-Kutta"),
        (hg.observers.bank(pendulum(theta=5), count=2, period=1.0), "classical Runge-Kutta"),
        (adaptive(), "continuous-discrete, L D L'"),
    ],
)
def test_the_method_is_the_one_that_carries_it_out(observer: hg.Observer, rule: str) -> None:
    """An observer without a covariance goes by classical Runge-Kutta under the default method, too."""
    assert f"Method: {rule}, dt = " in words(observer, dt=0.01 if rule[0] == "c" else 1e-3)


def test_in_a_bank_a_member_restarts_alone() -> None:
    bank = words(hg.observers.bank(pendulum(theta=5), count=2, period=1.0))
    assert "a value of a member was lost (not finite, or beyond 1e30), and all of that member restarted. To do" in bank
    assert "(not finite, or beyond 1e30): all of the state restarted but the last input" in words(pendulum())
    assert "all of the state restarted" not in bank


def test_without_a_model_there_is_nothing_to_predict_by() -> None:
    held = "y is not finite: the estimate continues at its last rates, without the model. To do: use"
    form, tracking = hg.forms.triangular(plants.chain(2)), {"k_0": 1, "k_max": 9, "gamma": 1, "strip": 0.1, "reach": 1}
    without = [hg.observers.cascade(form, theta=5), hg.observers.lambda_tracking(form, poles=(-1, -1), **tracking)]
    assert [held in words(observer) for observer in without] == [True, True]
    modelled = hg.observers.lambda_tracking(form, poles=(-1, -1), model=True, **tracking)
    assert "y is not finite: predicted only" in words(modelled)


@pytest.mark.parametrize("theta", [4.0, 20.0])
def test_the_comment_of_theta_has_the_bound_above_which_convergence_is_proved(theta: float) -> None:
    """In the header and in the manual, also where the declared theta is below it."""
    comment = f"high-gain parameter, 1 .. {theta:g}; convergence is proved above "
    (header, manual) = re.findall(rf"{comment}(\S+)", words(pendulum(theta=theta)))
    assert header == manual
    assert 4.3 < float(header) <= 4.5


def test_nothing_is_said_of_a_theta_without_a_bound() -> None:
    assert "convergence is proved above" not in words(adaptive(), 0.01)


# --- gains --------------------------------------------------------------------------------------------------


def test_the_banner_holds_what_makes_the_same_c_again() -> None:
    """Gains and a dt that six digits do not hold."""
    first = pendulum(theta=20 + 1 / 3, poles=(-1 / 3, -1 / 7))
    head = words(first, dt=1 / 3000).split("Claims")[0]
    K = re.search(r"K = \((\S+), (\S+)\)", head)
    theta, dt = (float(re.search(rf"\b{name} = (\S+)", head)[1]) for name in ("theta", "dt"))
    again = pendulum(theta=theta, poles=None, gains=(float(K[1]), float(K[2])))
    made = [hg.targets.c99(hg.sample(o, dt=dt), real="double", check=False)["pendulum.c"] for o in (first, again)]
    assert made[0] == made[1]
    assert (theta, dt) == (20 + 1 / 3, 1 / 3000)


# --- what firmware compares ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pendulum", "bank", "fitzhugh_nagumo", "functions"])
def test_a_header_defines_its_period_its_version_and_its_model(name: str) -> None:
    """No certificate carries all that `functions` has, so it has no digest."""
    step, upper = emitted.step(name), emitted.step(name).name.upper()
    text = emitted.files(name)[f"{step.name}.h"]
    defined = dict(re.findall(rf"^#define {upper}_(DT|VERSION|MODEL) +(\S+) +/", text, re.MULTILINE))
    assert float(defined["DT"].removesuffix("f")) == pytest.approx(step.dt, rel=2**-24)
    assert defined["VERSION"] == f'"{hg.__version__}"'
    digest = model_digest(step.observer)
    assert defined.get("MODEL", "") == f'"{digest}"' * bool(digest)
    assert bool(digest) is (name != "functions")
