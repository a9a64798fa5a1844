"""Whether the error of an estimate contracts as the step runs, at its own gains and dt: the step's own certificate.

    |e+|_P <= sqrt(1 - alpha dt) |e|_P   over one call of the program, by its method

e is the difference of two estimates that are given the same samples and inputs, from anywhere; it is also the error
against a plant whose state, with its output at each stage, moves by the same step: what a plant does otherwise, noise
among it, enters as bounded inputs. Every sample is there, no guard acts on the estimate, inputs keep to their ranges,
gains and parameters have their declared values, and numbers are real numbers. The slopes of b lie anywhere in their
ranges, in each stage by themselves, so that the proof needs more than that each frozen slope decays.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import Any

from hgogen.certificates.reach import NOWHERE, Reach, enough, reach
from hgogen.check import Check, ClaimId, Verdict
from hgogen.evidence.grounds import Grounds
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.common_norm import Flow
from hgogen.guarantees.contracting import ROWS, Contracts, Steps, unstable
from hgogen.guarantees.inclusion import Inclusion
from hgogen.guarantees.step_evidence import AtOneLength, Throughout
from hgogen.intervals.digits import Down, same
from hgogen.method import Method, OnErrors
from hgogen.observer import Observer
from hgogen.sentence import Reason, because, point
from hgogen.step import Step, demand_step


@dataclass(frozen=True)
class Contraction:
    """What is proved of the error of a step, call by call.

    `checks`: OBSERVER.step, that it contracts at its dt and theta; OBSERVER.shorter, that it does at every dt up to a
    longest; OBSERVER.tuned, that it does at every theta from a least one to its own: of the last two only what is
    proved. `rate` (1/s), at which |e|_P falls at its dt and theta, rounded down, None where that is not proved;
    `reach`: how far dt and theta may go; `proof`: of the first, and `steps`: of which it is one.
    """

    checks: tuple[Check, ...]
    rate: float | None
    reach: Reach
    proof: Contracts | None = field(default=None, repr=False)
    steps: Steps | None = field(default=None, repr=False)

    @property
    def proved(self) -> bool:
        """Whether it contracts at its dt and theta."""
        return self.rate is not None

    def __str__(self) -> str:
        return "\n".join(map(str, self.checks))


def contraction(step: Step) -> Contraction:
    """What is proved of the error of a step at its gains and dt, and how far dt and theta may go.

    Of `high_gain`, `circle_criterion`, `filtered`, `filtered_injection`, `low_power` and `peaking_free` by an explicit
    method, or by one that realises a core that does not move; of others the check says why nothing is proved.

    Raises: `NoSolver` without cvxpy; `NoStep`.
    """
    demand_step(step, "contraction")
    return _contraction(step.observer, step.method, step.rule, step.dt, step.limit)


@lru_cache(maxsize=32)
def _contraction(observer: Observer, method: Method, rule: str, dt: float, limit: float) -> Contraction:
    error = _error(observer)
    if isinstance(error, Reason):
        return _unknown(observer, rule, dt, error)
    if not isinstance(method, OnErrors):
        return _unknown(observer, rule, dt, because("the proof is not made for {rule}", rule=rule))
    obstacle = method.obstacle(error)
    if obstacle:
        return _unknown(observer, rule, dt, obstacle)
    steps, h = Steps(error, method.error_step, theta_of(observer)), Fraction(dt)
    if steps.at(h).rows > ROWS:
        pattern = "{slopes} slopes at each stage make an inequality of {rows} rows, more than the {most} that are tried"
        many = because(pattern, slopes=steps.at(h).slopes, rows=steps.at(h).rows, most=ROWS)
        return _unknown(observer, rule, dt, many, "Take a method of fewer stages, or validate by trials.")
    proof, far = steps.proved(h), reach(steps, h, limit)
    if proof is None:
        return _unknown(observer, rule, dt, _why(observer, steps, h), _fix(far), far)
    pattern = "|e|_P falls at least like exp(-{rate} t), in {arithmetic} arithmetic"
    rate = because(pattern, rate=Down(proof.rate, 3), arithmetic=steps.at(h).arithmetic)
    known = claimed(observer, "step", _claim(observer, rule, dt), rate, error, AtOneLength(error, rule, proof))
    return Contraction((known, *_beyond(observer, rule, steps, far)), proof.rate, far, proof, steps)


def _beyond(observer: Observer, rule: str, steps: Steps, far: Reach) -> Iterator[Check]:
    """The checks of other step lengths and of other thetas, those that are proved."""
    reason = because("the inequality is a polynomial in dt, negative on the whole range, in rational arithmetic")
    if far.pieces:
        longest = far.pieces[-1].high
        upto, most = f"{Down(longest, 3)} {observer.form.system.time}", Down(longest * steps.theta, 3)
        claim = f"so they do at every dt up to {upto}, of a larger theta while theta dt is up to {most}"
        shown = Throughout(steps.error, rule, steps.theta, far.pieces)
        yield claimed(observer, "shorter", claim, reason, steps.error, shown)
    if far.tuned and far.least is not None:
        ends = f"from {same(float(far.least))} to {same(float(steps.theta))}"
        shown = Throughout(steps.error, rule, far.least, far.tuned)
        yield claimed(observer, "tuned", f"so they do at every theta {ends}", reason, steps.error, shown)


def _claim(observer: Observer, rule: str, dt: float) -> str:
    return f"{running(observer, rule, dt)}, any two estimates that are given the same samples come together"


def running(observer: Observer, rule: str, dt: float) -> str:
    """How a claim about a step begins."""
    return f"as it runs, by {rule} at dt = {same(dt)} {observer.form.system.time}"


def claimed(observer: Observer, fact: str, claim: str, reason: Reason, error: Inclusion, shown: Any) -> Check:
    """A proved claim about an observer's step, with its evidence `shown`."""
    grounds = Grounds({"theta": float(theta_of(observer)), **error.numbers}, shown)
    return Check(ClaimId(observer.name, fact), claim, Verdict.PROVED, reason, proofs=(grounds,))


def _unknown(
    observer: Observer, rule: str, dt: float, why: Reason, fix: str = "Validate by trials.", far: Reach = NOWHERE
) -> Contraction:
    id = ClaimId(observer.name, "step")
    return Contraction((Check(id, _claim(observer, rule, dt), Verdict.UNKNOWN, why, fix=fix),), None, far)


def _error(observer: Observer) -> Inclusion | Reason:
    """What the error obeys, or why that is not known."""
    if observer.error is None:
        return because("the proof is for a constant injection: high_gain, filtered and the like, on chains")
    error: Inclusion | Nothing = observer.error
    return error.reason if isinstance(error, Nothing) else error


def theta_of(observer: Observer) -> Fraction:
    """The declared theta."""
    (theta,) = (gain.initial[0] for gain in observer.gains if gain.name == "theta")
    return Fraction(theta)


def _why(observer: Observer, steps: Steps, h: Fraction) -> Reason:
    """Why there is no proof at a step length: slopes that are held, else what hinders most, and by how much."""
    held = unstable(steps.at(h))
    if held is None:
        known, share = Flow(steps.error, steps.theta).obstacle(observer.form.states), enough(steps, h)
        if share is None:
            return known
        return because("{why}; one is with {share} of the ranges of all slopes of b", why=known, share=Down(share, 2))
    values = steps.error.named(observer.form.states, held)
    return because("with {slopes}, held there, errors do not decay", slopes=point(values))


def _fix(far: Reach) -> str:
    """What can be changed, each with the number at which it is proved."""
    ways = [f"dt = {Down(far.longest, 3)}"] if far.longest else []
    ways += [f"theta = {same(float(far.least))}"] if far.least else []
    known = f"It is proved with {' or with '.join(ways)}. " if ways else ""
    return f"{known}Narrow the ranges of the states, or validate by trials."
