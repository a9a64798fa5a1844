"""The hypotheses of an observer's theorem, and what is known of each."""

from typing import Any

import casadi as ca
import pytest
import sympy as sp
from plants import MODELS, fitzhugh_nagumo, kalman, model, pendulum, van_der_pol

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics
from hgogen.check import Check, ClaimId, Claims, Refuted, Verdict
from hgogen.model import load
from hgogen.theorem import YOURS, Beyond, Convergence, Hypothesis, Row, Theorem, rows


def check(id: ClaimId, verdict: Verdict) -> Check:
    return Check(id, "a claim", verdict, "a reason")


def a(i: int) -> ClaimId:
    return ClaimId("form", "a", i)


B = ClaimId("form", "b")
POSITIVE = (Claims("form", "a"),)


def table(observer: hg.Observer) -> dict[str, Row]:
    return {row.claim: row for row in rows(observer.theorem, observer.checks)}


def one(hypothesis: Hypothesis, *checks: Check) -> tuple[Row, ...]:
    return rows(Theorem("it converges", (hypothesis,), "a paper"), checks)


# --- what is known of a hypothesis --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verdicts", "worst"),
    [
        (("proved", "proved"), "proved"),
        (("proved", "generic"), "generic"),
        (("generic", "where"), "where"),
        (("where", "unknown"), "unknown"),
        (("unknown", "refuted", "proved"), "refuted"),
    ],
)
def test_a_hypothesis_is_as_good_as_its_worst_check(verdicts: tuple[str, ...], worst: str) -> None:
    listed = [check(a(i), Verdict(verdict)) for i, verdict in enumerate(verdicts)]
    (row,) = one(Hypothesis("0 < a_i", POSITIVE), *listed, check(B, Verdict.REFUTED))
    assert row.standing == worst
    assert row.checks == tuple(c.id for c in listed)
    if worst != "proved":
        assert str(row.reason) == f"{worst}: " + next(c.id for c in listed if c.verdict == worst)


def test_what_the_checks_do_not_say_stands_beside_them() -> None:
    hypothesis = Hypothesis("0 < a_i", POSITIVE, reason="of the declared value")
    (alone,) = one(hypothesis, check(a(1), Verdict.UNKNOWN))
    (worst,) = one(hypothesis, check(a(1), Verdict.UNKNOWN), check(a(2), Verdict.PROVED))
    assert (str(alone.reason), str(worst.reason)) == (
        "of the declared value",
        "unknown: form.a_1; of the declared value",
    )


def test_what_no_check_knows_is_unknown() -> None:
    (row,) = one(Hypothesis("0 < a_i", POSITIVE, verdict=Verdict.PROVED), check(B, Verdict.PROVED))
    assert (row.standing, row.checks) == ("unknown", ())


def test_an_optional_hypothesis_without_a_check_is_dropped() -> None:
    hypothesis = Hypothesis("coordinates", (Claims("recast"),), optional=True)
    assert one(hypothesis) == ()
    assert one(hypothesis, check(ClaimId("recast", "inverse"), Verdict.REFUTED))[0].verdict is Verdict.REFUTED


def test_what_is_proved_of_the_step_stands_in_the_place_of_what_trials_show() -> None:
    """And an open claim of the step says nothing; the hypothesis is the theorem's, and left to the user as before."""
    hypothesis = Hypothesis("no noise", reason="look", beyond=Beyond(Claims(fact="b"), "bounds what it does"))
    (proved,) = one(hypothesis, check(a(1), Verdict.PROVED), check(B, Verdict.PROVED))
    assert (proved.verdict, str(proved.reason), proved.checks) == (None, "bounds what it does", (B,))
    for verdict in set(Verdict) - {Verdict.PROVED}:
        (open_,) = one(hypothesis, check(a(1), Verdict.PROVED), check(B, verdict))
        assert (open_.verdict, str(open_.reason), open_.checks) == (None, "look", ())


def test_the_claims_of_a_step_are_named_by_the_theorem() -> None:
    observer = load(MODELS / "pendulum.py").step().observer
    facts = ("step", "noise", "tuned", "start", "error")
    proofs = [check(ClaimId("high_gain", fact), Verdict.PROVED) for fact in facts]
    named = {row.claim: row.checks for row in rows(observer.theorem, (*observer.checks, *proofs))}
    assert named["y is measured without noise"] == ("high_gain.noise",)
    assert named["y and the input are known at all times"] == ("high_gain.step",)
    assert named["the gains have their declared values"] == ("high_gain.tuned",)
    assert named["the estimate does not touch its outer box"] == ("high_gain.start",)
    assert sum("high_gain.error" in checks for checks in named.values()) == 1


def test_what_only_the_user_knows_is_left_to_him() -> None:
    (row,) = one(Hypothesis("no noise", reason="look"))
    assert (row.verdict, row.standing, row.as_dict()["verdict"]) == (None, YOURS, YOURS)


# --- the observers' theorems --------------------------------------------------------------------------------


def adaptive(**changes: object) -> hg.Observer:
    gains = {"mu": (0.1, 0.2), "innovation": hg.innovation.staggered(1.0), **changes}
    return kalman(van_der_pol(), theta=hg.theta.adaptive(2.0, **gains))


OBSERVERS = {
    "kalman": lambda: kalman(van_der_pol()),
    "high_gain_kalman": lambda: kalman(van_der_pol(), theta=3),
    "decaying": lambda: kalman(van_der_pol(), theta=hg.theta.decaying(3, 1)),
    "adaptive": adaptive,
    "high_gain": pendulum,
}


@pytest.mark.parametrize("name", OBSERVERS)
def test_every_theorem_is_complete(name: str) -> None:
    """A conclusion, a source, the form's hypotheses with their checks, and what is left to the user."""
    observer = OBSERVERS[name]()
    theorem, by_claim = observer.theorem, table(observer)
    assert theorem.conclusion
    assert any(character.isdigit() for character in theorem.reference) or "slides" in theorem.reference
    assert len(by_claim) == len(rows(theorem, observer.checks))
    for part in ("z_i' =", "0 < a_m", "b is Lipschitz"):
        (row,) = (row for claim, row in by_claim.items() if claim.startswith(part))
        assert row.standing == "proved"
        assert row.checks
    yours = [row for row in by_claim.values() if row.verdict is None]
    assert len(yours) >= 5
    assert all(row.reason for row in yours)
    assert all(row.reason or row.checks for row in by_claim.values())


@pytest.mark.parametrize("name", [name for name in OBSERVERS if name != "high_gain"])
def test_no_riccati_theorem_is_proved(name: str) -> None:
    """Their constants are existential: some hypothesis stays open, and the conclusion is unknown."""
    observer = OBSERVERS[name]()
    said = " ".join(str(row.reason) for row in rows(observer.theorem, observer.checks))
    assert "existential" in said
    verdicts = {c.id: c.verdict for c in observer.checks}
    assert verdicts["riccati.convergence"] is Verdict.UNKNOWN


def test_a_refuted_check_refutes_its_hypothesis() -> None:
    """The paper's own example: a_2(u) = -u."""
    observer = fitzhugh_nagumo()
    (row,) = (row for claim, row in table(observer).items() if claim.startswith("0 < a_m"))
    assert (row.standing, str(row.reason)) == ("refuted", "refuted: triangular.a_2")
    assert row.checks == ("triangular.a_1", "triangular.a_2", "triangular.a_3")


def test_the_theorem_asks_mu_and_the_innovation() -> None:
    mu, integral = (
        "mu = 0 up to gamma_0, mu = 1 from gamma_1 on",
        "the innovation is an integral over the last d seconds",
    )
    by_claim = table(adaptive())
    assert (by_claim[mu].standing, by_claim[integral].standing) == ("proved", "unknown")
    other = table(adaptive(mu=hg.theta.logistic(0.1, 100), innovation=hg.innovation.window(1.0)))
    assert (other[mu].standing, other[integral].standing) == ("refuted", "unknown")
    assert "a sum over the samples" in str(other[integral].reason)


def test_a_form_that_is_not_triangular_proves_nothing_of_the_theorem() -> None:
    plant = van_der_pol()
    observer = hg.observers.riccati(hg.forms.original(plant), Q=(1, 1), R=1)
    (row,) = (row for claim, row in table(observer).items() if claim.startswith("z_i' ="))
    assert (row.standing, str(row.reason)) == ("unknown", "the form makes no such check")


def test_no_sampled_step_has_the_measurement_at_all_times() -> None:
    for build in OBSERVERS.values():
        by_claim = table(build())
        assert by_claim["y and the input are known at all times"].standing == "unknown"
        assert by_claim["the gains have their declared values"].standing == YOURS


@pytest.mark.parametrize("name", [name for name in OBSERVERS if name != "high_gain"])
def test_the_cap_is_no_part_of_the_riccati_equation(name: str) -> None:
    row = table(OBSERVERS[name]())["the covariance does not touch its cap"]
    assert row.standing == YOURS
    assert "COVARIANCE_LIMITED" in str(row.reason)


def test_theta_is_large_enough_at_its_declared_value() -> None:
    """The gain's range goes down to 1, below the bound."""
    observer = pendulum(theta=50)
    row, (theta,) = table(observer)["theta is large enough"], observer.gains
    assert (row.standing, theta.low) == ("proved", (1.0,))
    assert str(row.reason) == "of its declared value; it can be tuned down to 1"


def test_a_decaying_theta_is_its_theorems_where_it_scales_the_process_noise_alone() -> None:
    """And its rate cannot be tuned to 0, which the theorem excludes."""
    observer, claim = OBSERVERS["decaying"](), "R is not scaled, and Q_theta = theta^2 Delta^-1 Q Delta^-1"
    by_claim = table(observer)
    assert by_claim[claim].standing == "proved"
    other = table(kalman(van_der_pol(), theta=hg.theta.decaying(3, 1, scaled="both")))[claim]
    assert other.standing == "unknown"
    assert "rate (theta - 1)/theta S" in str(other.reason)
    assert any(claim.startswith("0 < rate") for claim in by_claim)
    (rate,) = (gain for gain in observer.gains if gain.name == "rate")
    assert rate.low[0] > 0


# --- other coordinates --------------------------------------------------------------------------------------


def contois(low: float, high: float) -> hg.System:
    """Contois growth on a range, y = m; substrate is lost by a cubic law as well."""
    m, s = hg.Signal("m", low=low, high=high), hg.Signal("s", low=low, high=high)
    growth = m * s / (m + s)
    flow = [growth, -growth - sp.Rational(3, 10) * s**3]
    return hg.System("contois", states=(m, s), outputs=(hg.Signal("y"),), flow=flow, output=[m])


@pytest.mark.ordinary("riccati")
@pytest.mark.parametrize("observer", ["high_gain", "riccati"])
def test_b_is_lipschitz_where_it_is_evaluated_or_not_proved(observer: str) -> None:
    """On the image of a wide box phi is Lipschitz, but in the box of z it has a pole; on a narrow one it has none."""
    gains = {"high_gain": {"theta": 5, "poles": (-1, -1)}, "riccati": {"Q": (1, 1), "R": 1}}[observer]
    build, claim = getattr(hg.observers, observer), "b is Lipschitz in the state, uniformly in the input"
    wide = hg.forms.phase(contois(0.1, 2))
    narrow = hg.forms.phase(contois(0.9, 1))
    assert {c.verdict for c in (*wide.checks, *narrow.checks) if c.id == "phase.lipschitz"} == {Verdict.PROVED}
    assert wide.behind is not None
    open_, proved = (table(build(form, **gains))[claim] for form in (wide, narrow))
    assert open_.checks == proved.checks == ("phase.lipschitz", f"{observer}.lipschitz")
    assert (open_.standing, proved.standing) == ("unknown", "proved")
    (reason,) = (c.reason for c in build(wide, **gains).checks if c.id == f"{observer}.lipschitz")
    assert "may have poles in the box of z" in str(reason)


def test_phi_may_be_read_at_the_recovered_state() -> None:
    """Beyond the image of the plant's box, phi is that of the plant at an end of its ranges, and Lipschitz."""
    plant = contois(0.9, 1)
    direct, recovered = hg.forms.phase(plant), hg.forms.phase(plant, recovered=True)
    assert direct.behind is None
    assert recovered.behind is not None
    assert recovered.b == direct.b
    z1, z2 = direct.states
    m, s = z1.interval[0], direct.from_form[1].subs({z1: z1.interval[0], z2: z2.interval[1]})
    assert s > 1.1
    z = ca.DM([m, z2.interval[1]])
    values = [float(Dynamics(form).nonlinear(z, ca.DM(0, 1))[1]) for form in (direct, recovered)]
    phi = [float(recovered.behind[1].subs(dict(zip(plant.states, (m, at), strict=True)))) for at in (s, 1)]
    assert values == pytest.approx(phi)
    assert abs(phi[0] - phi[1]) > 0.01
    checks = hg.observers.high_gain(recovered, theta=5, poles=(-1, -1)).checks
    assert {c.id: c.verdict for c in checks}["high_gain.lipschitz"] is Verdict.PROVED


def test_an_observer_in_the_plants_coordinates() -> None:
    """The high gain acts through dPhi/dx, at an estimate within the ranges; the filter has no such map."""
    form = hg.forms.phase(contois(0.9, 1), original=True)
    inside = table(hg.observers.high_gain(form, theta=5, poles=(-1, -1)))["the estimate keeps to the declared ranges"]
    assert inside.standing == YOURS
    filtered = table(hg.observers.riccati(form, Q=(1, 1), R=1))["the filter works in the coordinates z = Phi(x)"]
    assert filtered.standing == "refuted"
    assert "the estimate keeps to the declared ranges" not in table(pendulum())
    assert "the filter works in the coordinates z = Phi(x)" not in table(OBSERVERS["kalman"]())


@pytest.mark.parametrize(
    ("rate", "observer", "known"),
    [
        ("-2*x1", hg.observers.riccati, Convergence.PROVED),
        ("-x1**3", hg.observers.riccati, None),
        ("-2*x1", hg.observers.ukf, None),
    ],
)
def test_in_the_plants_own_states_no_theorem_is_about_a_plant_that_is_not_linear(
    rate: str, observer: Any, known: Convergence | None
) -> None:
    x = hg.Signal("x1", low=-1, high=1), hg.Signal("x2", low=-1, high=1)
    y = hg.Signal("y")
    plant = hg.System("p", states=x, outputs=(y,), flow=[x[1], sp.sympify(rate, {"x1": x[0]})], output=[x[0]])
    assert observer(hg.forms.original(plant), Q=(1, 1), R=1.0).convergence is known
    assert observer(hg.forms.triangular(plant), Q=(1, 1), R=1.0).convergence is Convergence.UNKNOWN


def test_recast_coordinates_are_a_hypothesis() -> None:
    observer = load(MODELS / "cascaded_tanks.py").step().observer
    (row,) = (row for claim, row in table(observer).items() if claim.startswith("z is a change"))
    assert row.checks == ("recast.inverse", "recast.range")
    assert not any(claim.startswith("z is a change") for claim in table(pendulum()))


def test_a_refusal_keeps_its_form() -> None:
    form = hg.forms.triangular(model("fitzhugh_nagumo"))
    with pytest.raises(Refuted) as caught:
        hg.observers.riccati(form, Q=(1, 1, 1), R=1, accept="triangular.a_1")
    assert caught.value.form is form
    assert caught.value.accepted == ("triangular.a_1",)
    assert [c.id for c in caught.value.checks] == ["triangular.a_2"]
