"""Bank of N observers in parallel, restarted one after the other, of which the best is the estimate.

    every T: the oldest of the N members is dropped and restarts, with its gain as at the start (theta = theta_0), from
             the selected estimate; just after it the oldest has the age (N - 1) T
    at every sample: a member j takes the place of the selected one s where I_j < hysteresis I_s,
        "window"   I = integral over the last d of |y - yhat|^2, yhat predicted by the model from the estimate d ago
        "newest"   I = |y - h(z)|^2 of the newest sample, the slides' choice, which picks the youngest and noisiest

The bank accepts any member. It suits one whose theta decays: a high-gain observer when it is young and a Kalman filter
when it is old. A member that restarts inherits I of the selected one, so that both are compared over the same past.
When the oldest member is dropped while it is selected, the next oldest is selected. The status bit OUTSIDE_BOX is that
of the selected member; every other bit is set if any member sets it. Source: Busvelle, "Parallel high-gain and non
high-gain extended Kalman filters" (slides), after Boizot, Busvelle, Gauthier 2010; the window and the hysteresis are
ours.
"""

from dataclasses import replace
from typing import Literal

from hgogen.check import Verdict
from hgogen.estimators.innovation import Innovation
from hgogen.observer import Observer, gain
from hgogen.prove.inclusion import Nothing
from hgogen.reading.given import BadGain, among, positive, real
from hgogen.sentence import because, same
from hgogen.starting import starts
from hgogen.stepping.parallel import Parallel, demand_one
from hgogen.system import demand_continuous
from hgogen.theorem import Hypothesis

REFERENCE = "Busvelle, Parallel high-gain and non high-gain extended Kalman filters (slides)"
MOST = 1000  # members
_NONE = (
    "it goes around another observer: tune that one, then name it as the member, with count = 3 and for the period the "
    "time that it takes to settle"
)
HYSTERESIS = {"window": 0.6, "newest": 1.0}
RULES = {"window": "smallest innovation over a window", "newest": "smallest output error of the newest sample"}
SELECTED = Hypothesis(
    "the selected member's estimate has converged",
    verdict=Verdict.UNKNOWN,
    reason="the theorem is of each member from its restart on; that the one with the smallest innovation is near the "
    "plant's state is not proved",
)

_RESTARTS = Nothing(because("a member that restarts keeps its estimate alone, and another member may be selected"))


@starts(
    "the state jumps and no threshold to detect jumps is known",
    "N copies of another observer, at N times its cost",
    "N members",
    lambda s: _NONE,
)
def bank(
    member: Observer,
    *,
    count: int,
    period: float,
    selection: Literal["window", "newest"] = "window",
    innovation: Innovation | None = None,
    hysteresis: float | None = None,
) -> Observer:
    """`count` copies of `member`, the oldest restarted every `period`; the estimate is that of the copy with the
    smallest innovation, an integral of |y - yhat|^2, yhat predicted without correction.

    Args: `count` at least 2; `period` T (s), a whole number of samples; `innovation` of the selection "window", a value
    of `hgogen.innovation`, by default staggered predictors over .3 T; `hysteresis` in [.001, 1], a tunable gain: the
    ratio to the selected member's innovation below which another member is selected, by default .6 for "window", 1 for
    "newest".

    Raises: `BadGain`; `BadPeriod` from `sample` for a period shorter than dt or no whole number of samples.
    """
    demand_one(
        "bank",
        member,
        bank="goes around one observer, not around another bank; give it more members",
        late="goes around an observer whose samples come at once, not around hg.delayed(..)",
    )
    demand_continuous(member.form.system, "bank", "; run one riccati, ukf or iterated_ekf")
    if real("count", count) not in range(2, MOST + 1):
        reason = f"must be a whole number of members, from 2 (one runs while another restarts) to {MOST}"
        raise BadGain(f"count = {count!r}", reason)
    if not among(selection, RULES):
        raise BadGain(f"selection = {selection!r}", 'must be "window" or "newest"')
    if innovation is not None and (selection == "newest" or not isinstance(innovation, Innovation)):
        reason = 'must be innovation.staggered(..) or innovation.window(..), for selection="window"'
        raise BadGain(f"innovation = {innovation!r}", reason)
    share = real("hysteresis", HYSTERESIS[selection] if hysteresis is None else hysteresis)
    part = Parallel(member, int(count), positive("period", period), selection == "newest", innovation)
    every = f"{same(period)} {member.form.system.time}"
    schedule = f"{count} members; every {every} the oldest restarts from the selected estimate, which has the "
    return replace(
        member,
        name="bank",
        parts=(part,),
        gains=(*member.gains, gain("hysteresis", share, 1e-3, 1.0, "share to which another innovation must fall")),
        theorem=member.theorem.under(SELECTED),
        equations=(*member.equations, schedule + RULES[selection]),
        reference=f"{REFERENCE}; member: {member.reference}",
        traces=("selected", *member.traces),
        error=_RESTARTS,
    )
