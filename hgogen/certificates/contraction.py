"""The contraction of the error of a discrete step at its own gains and dt, and the limits of dt and theta within which
it holds.

    |e+|_P <= sqrt(1 - alpha dt) |e|_P   over one call of the program, by its method

e is the difference of two estimates with the same samples and inputs, from any start. It is also the error against a
plant whose state, with its output at each stage, moves by the same step; other motion of the plant, and noise, are
bounded inputs. No sample is missing, no guard acts on the estimate, inputs keep to their ranges, gains and parameters
have their declared values, and numbers are real numbers. The slopes of b are anywhere in their ranges, independently in
each stage: this is more than the decay at each constant slope.

The limits of dt and theta are searched in floats by bisection, from the step's own values if it contracts there, else
from the first values at which it does. The end of the search is proved in rationals, at a short number on the near
side.

A proof at (dt, theta) is valid for every (dt', theta') with theta' >= theta and dt' theta' = dt theta: dt M is the same
but for the slopes of b, which are multiplied by dt'/dt theta'^-degree/theta^-degree <= 1, and whose ranges hold 0. So a
proof at theta for every step length up to dt covers every theta' from theta to theta dt/dt' at each shorter dt'.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Annotated

from hgogen.analysis.evidence import Evidence, Grounds
from hgogen.check import Check, ClaimId, Verdict
from hgogen.method import Method, ProvableMethod
from hgogen.observer import Observer
from hgogen.program import INF
from hgogen.prove.convergence import Flow
from hgogen.prove.inclusion import Facts, Inclusion, Nothing
from hgogen.prove.inequality import ROWS, Contracts, Piece, Steps, all_shorter, bisect_towards, unstable
from hgogen.prove.questions import error_inclusion, theta_of
from hgogen.sentence import Down, Reason, Sentence, because, down, point, same, up
from hgogen.step import Step, demand_step

_ROOM = 2**10  # the longest dt of a search over the step's own, without a refused one
_SHARES = 8  # the most shares that are tried, each half of the last one
_HALVINGS, _DOUBLINGS = 10, 6  # of dt, of theta, in the search for a first proof
# of the way from the end of a search back to its start, for proofs
_BACK = tuple(Fraction(k, 100) for k in (0, 1, 5, 20))


@dataclass(frozen=True)
class Reach:
    """The limits of dt and theta within which a step is proved to contract. `longest`: the largest dt at the step's
    theta, None where none is proved; `pieces`: proofs for all dt up to it, () where not proved; `least`: the smallest
    theta at the step's dt, None where none is proved; `tuned`: proofs at the theta `least` for all dt up to one that
    covers each theta from `least` to the step's own, () where not proved."""

    longest: Fraction | None = None
    pieces: tuple[Piece, ...] = ()
    least: Fraction | None = None
    tuned: tuple[Piece, ...] = ()


NOWHERE = Reach()


@dataclass(frozen=True)
class Contraction:
    """The result of the question whether the error of a step contracts, |e+|_P <= sqrt(1 - alpha dt) |e|_P, at every
    call. `checks`: OBSERVER.step at the step's dt and theta; where proved also OBSERVER.shorter, for every dt up to a
    longest one, and OBSERVER.tuned, for every theta from a least one on. `rate` (1/time): of |e|_P, rounded down, None
    where it is not proved; `reach`: the limits of dt and theta; `proof`: that of OBSERVER.step, or None."""

    checks: tuple[Check, ...]
    rate: float | None
    reach: Reach
    proof: Contracts | None = field(default=None, repr=False)

    @property
    def proved(self) -> bool:
        """Whether |e+|_P <= sqrt(1 - alpha dt) |e|_P is proved at the step's dt and theta."""
        return self.rate is not None

    def __str__(self) -> str:
        return "\n".join(map(str, self.checks))


def contraction(step: Step) -> Contraction:
    """Return whether the error of a step is proved to contract at its gains and dt, with the proof, and the limits of
    dt and theta within which it does.

    Proofs exist for the observers `high_gain`, `circle_criterion`, `filtered`, `filtered_injection`, `low_power` and
    `peaking_free`, integrated by an explicit method or by one that integrates a constant linear core exactly; for
    others the check names the reason. Raises: `NoSolver` without Clarabel; `NoStep`.
    """
    demand_step(step, "contraction")
    if step.clock.varying:
        return _unknown(step.observer, step.code.rule, step.dt, VARYING)
    return _contraction(step.observer, step.method, step.code.rule, step.dt, step.limit)


VARYING = because("the proof is for calls at one dt, and here it varies")


@lru_cache(maxsize=32)
def _contraction(observer: Observer, method: Method, rule: str, dt: float, limit: float) -> Contraction:
    error = error_inclusion(observer)
    if isinstance(error, Nothing):
        return _unknown(observer, rule, dt, error.reason)
    if not isinstance(method, ProvableMethod):
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
        return _unknown(observer, rule, dt, _obstacle(observer, steps, h), _fix(far), far)
    pattern = "|e|_P falls at least like exp(-{rate} t), in {arithmetic} arithmetic"
    rate = because(pattern, rate=Down(proof.rate, 3), arithmetic=steps.at(h).arithmetic)
    facts = {"method": rule, "dt": proof.h, "alpha": proof.alpha, "V": proof.weights}
    known = proved_check(observer, "step", _claim(observer, rule, dt), rate, error, facts)
    return Contraction((known, *_neighbour_checks(observer, rule, steps, far)), proof.rate, far, proof)


def _neighbour_checks(observer: Observer, rule: str, steps: Steps, far: Reach) -> Iterator[Check]:
    reason = because("the inequality is a polynomial in dt, negative on the whole range, in rational arithmetic")
    if far.pieces:
        longest = far.pieces[-1].high
        upto, most = f"{Down(longest, 3)} {observer.form.system.time}", Down(longest * steps.theta, 3)
        claim = f"so they do at every dt up to {upto}, of a larger theta while theta dt is up to {most}"
        yield proved_check(observer, "shorter", claim, reason, steps.error, _facts(rule, steps.theta, far.pieces))
    if far.tuned and far.least is not None:
        ends = f"from {same(float(far.least))} to {same(float(steps.theta))}"
        facts = _facts(rule, far.least, far.tuned)
        yield proved_check(observer, "tuned", f"so they do at every theta {ends}", reason, steps.error, facts)


def _facts(rule: str, theta: Fraction, pieces: Iterable[Piece]) -> Evidence:
    return {"method": rule, "theta": theta, "pieces": pieces}


def _claim(observer: Observer, rule: str, dt: float) -> str:
    return f"{method_phrase(observer, rule, dt)}, any two estimates that are given the same samples come together"


def method_phrase(observer: Observer, rule: str, dt: float) -> str:
    """Return the text "as it runs, by METHOD at dt = .. s", with which claims about a step begin; `rule`: the
    method."""
    return f"as it runs, by {rule} at dt = {same(dt)} {observer.form.system.time}"


def proved_check(observer: Observer, fact: str, claim: str, reason: Reason, error: Inclusion, facts: Evidence) -> Check:
    """Return the proved check OBSERVER.`fact` with the text `claim` and the `reason`; `facts`: its evidence for a
    certificate, which assumes the ranges of slopes in the `error` dynamics."""
    grounds = Grounds({"theta": float(theta_of(observer)), **error.numbers}, Facts(error, facts))
    return Check(ClaimId(observer.name, fact), claim, Verdict.PROVED, reason, proofs=(grounds,))


def _unknown(
    observer: Observer, rule: str, dt: float, why: Reason, fix: str = "Validate by trials.", far: Reach = NOWHERE
) -> Contraction:
    id = ClaimId(observer.name, "step")
    return Contraction((Check(id, _claim(observer, rule, dt), Verdict.UNKNOWN, why, fix=fix),), None, far)


def _obstacle(observer: Observer, steps: Steps, h: Fraction) -> Reason:
    slopes = unstable(steps.at(h))
    if slopes is None:
        known, share = Flow(steps.error, steps.theta).obstacle(observer.form.states), _sufficient_share(steps, h)
        if share is None:
            return known
        return because("{why}; one is with {share} of the ranges of all slopes of b", why=known, share=Down(share, 2))
    values = steps.error.slope_values(observer.form.states, slopes)
    return because("with {slopes}, held there, errors do not decay", slopes=point(values))


def _fix(far: Reach) -> str:
    ways = [f"dt = {Down(far.longest, 3)}"] if far.longest else []
    ways += [f"theta = {same(float(far.least))}"] if far.least else []
    known = f"It is proved with {' or with '.join(ways)}. " if ways else ""
    return f"{known}Narrow the ranges of the states, or validate by trials."


# --- how far


def reach(steps: Steps, h: Fraction, limit: float) -> Reach:
    """Return the limits of dt and theta, around a step of length h, within which it is proved to contract; `limit`: the
    step length above which `sample` refuses a step. Raises: `NoSolver`."""
    theta, far = steps.theta, h * _ROOM if limit == float("inf") else Fraction(limit)

    def at(level: Fraction) -> Steps:
        return replace(steps, theta=level)

    def by_theta(level: Fraction) -> bool:
        return at(level).may_contract(h)

    contracts = steps.may_contract(h)  # else the searches begin where it first does, and end at h and theta
    short = h if contracts else _first(steps.may_contract, (h / 2**k for k in range(1, _HALVINGS + 1)))
    high = theta if contracts else _first(by_theta, (theta * 2**k for k in range(1, _DOUBLINGS + 1)))
    ends = (far, min(theta, Fraction(1))) if contracts else (h, theta)
    longest = short and _proved(steps.certain, short, bisect_towards(steps.may_contract, short, ends[0]))
    least = high and _proved(lambda level: at(level).certain(h), high, bisect_towards(by_theta, high, ends[1]))
    pieces = all_shorter(steps, longest) if longest else ()
    tuned = all_shorter(at(least), h * theta / least) if least and least < theta else ()
    return Reach(longest, pieces, least, tuned)


def _sufficient_share(steps: Steps, h: Fraction) -> Fraction | None:
    """Return a share s, close to the largest, such that the step of length h is proved to contract if the ranges of all
    partial derivatives of b are multiplied by s; None where none is proved. Raises: `NoSolver`."""

    def narrowed(share: Fraction) -> Steps:
        return replace(steps, error=steps.error.narrowed(share))

    first = _first(lambda share: narrowed(share).may_contract(h), (Fraction(1, 2**k) for k in range(1, _SHARES)))
    if first is None:
        return None
    end = bisect_towards(lambda share: narrowed(share).may_contract(h), first, Fraction(1))
    return _proved(lambda share: narrowed(share).certain(h), first, end)


def _first(holds: Callable[[Fraction], bool], values: Iterable[Fraction]) -> Fraction | None:
    return next(filter(holds, values), None)


def _proved(certain: Callable[[Fraction], object], start: Fraction, end: Fraction) -> Fraction | None:
    towards = up if start > end else down
    for share in _BACK:
        value = Fraction(towards(end + (start - end) * share, 3))
        if certain(value):
            return value
    return None


@dataclass(frozen=True)
class Admitted:
    """The limits of a step's dt: `certified`, `advised` and `refused`."""

    dt: Annotated[float, "the step's own dt"]
    time: Annotated[str, "unit of time"]
    certified: Annotated[float | None, "largest dt at which its error is proved to contract; null: none"]
    throughout: Annotated[bool, "whether that holds at every dt up to it"]
    advised: Annotated[float | None, "dt up to which nothing was seen to fail at points of the box; null: none"]
    refused: Annotated[float | None, "dt above which there is no step; null: none"]

    @property
    def sentence(self) -> Sentence:
        """The limits as a sentence, in ascending order; the advised one only if it is above the certified one."""
        limits = []
        if self.certified is None:
            limits.append(Sentence.of("certified at none"))
        else:
            pattern = "certified up to {most}" if self.throughout else "certified at {most}"
            typed = Fraction(repr(self.certified))  # the decimal number, such as 0.147, not its float
            limits.append(Sentence.of(pattern, most=Down(typed, 3)))
        if self.advised is not None and not (self.throughout and self.advised <= (self.certified or 0)):
            limits.append(Sentence.of("tried without failure up to {most}", most=Down(self.advised, 3)))
        if self.refused is not None:
            limits.append(Sentence.of("refused above {most}", most=Down(self.refused, 3)))
        return Sentence.of("dt = {dt} {time}: {limits:; }", dt=self.dt, time=self.time, limits=tuple(limits))


def admitted(step: Step, known: Contraction) -> Admitted:
    """Return the limits of a step's dt: certified by its contraction `known`, advised, and refused."""
    far = known.reach
    certified = float(far.longest) if far.longest else step.dt if known.proved else None
    advised, refused = (None if most == INF else most for most in (step.advised, step.limit))
    return Admitted(step.dt, step.time, certified, bool(far.pieces), advised, refused)
