"""The short answer of `check`: at most ten lines, in the order of a user's questions.

    what is observable, and in which forms the plant is; which state the outputs show least
    which observer to take, and the line that makes it
    what is proved of it, what is not, and what to fix first

An observer with proved convergence is preferred, of those the model's own; where none is proved, the model's own, else
the extended Kalman filter. Only `KINDS` are tried beside the tuned ones, so that the answer takes seconds.
"""

from collections.abc import Iterable, Iterator, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hgogen.analysis.observability import Observability
from hgogen.check import Check, Verdict
from hgogen.commands.advice import KNOWN, Admitted, Advice
from hgogen.commands.claims import Checked, few
from hgogen.run.gramian import Sight, as_share
from hgogen.theorem import Convergence
from hgogen.which_forms import NOT_TRIED, Survey

KINDS = ("high_gain", "uniform_injection", "riccati")
_DETAILS = "--all, --form NAME, --proof NAME, --json"


def line(label: str, text: str) -> RenderableType:
    """Return a line of the answer, whose text is indented where it is wrapped."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(width=10, no_wrap=True)
    grid.add_column(overflow="fold")
    grid.add_row(Text(label, style="bold"), Text(text))
    return grid


def in_forms(observability: Observability, forms: Survey) -> str:
    """Return in which forms the plant is proved to be; without one, for an observable plant, what to take instead."""
    if forms.proved:
        return f"{', '.join(row.kind for row in forms.proved)}, proved"
    rows = [row for row in forms.rows if row.kind != "original"]
    complete = all(row.why != NOT_TRIED for row in rows)
    settled = complete and all(row.verdict in (None, Verdict.REFUTED) for row in rows)
    why = "high-gain observers do not apply" if settled else "no high-gain form is proved of it"
    where = f"(why: --all{'' if complete else '; more forms: --deep'})"
    take = "" if observability.known.rank.unobservable else "take the extended Kalman filter; "
    return f"{take}{why} {where}"


def weakest(least: Sight) -> str:
    """Return by how much the state that the outputs show least moves them."""
    weak = next(iter(least.direction))
    if least.by_motion:
        return f"{weak}, which only the plant's motion shows, not its linearisation at a point"
    over = f"along trial {least.trial}" if least.trial else "over the ranges"
    return f"{weak}: an error as large as its range moves the outputs by {as_share(least.median)} times theirs, {over}"


def preferred(advice: Advice, own: str) -> Admitted | None:
    """Return the observer to take; `own`: the name of the model's observer, or ""."""

    def place(one: Admitted) -> tuple[int, bool, bool, tuple[int, int, int]]:
        return KNOWN[one.convergence][1], one.observer != own, one.observer != "riccati", one.rank

    return min(advice.admitted, key=place, default=None)


def observer_lines(one: Admitted | None, advice: Advice, forms: Survey) -> Iterator[RenderableType]:
    """Yield the line of the observer to take, and the one that makes it; without an observer why there is none."""
    if one is None:
        yield line("take", advice.notes[0] if advice.notes else f"no observer admits {forms.plant.name}")
        return
    gains = "with first gains, untried" if one.proposed else "with the gains of the model"
    name = "riccati, the extended Kalman filter," if one.observer == "riccati" else one.observer
    yield line("take", f"{name} in {one.form} form, {gains}:")
    yield Group(Text(f"{'':12}{one.line}", no_wrap=True, overflow="ignore"))


def standing(observer: str, checks: Sequence[Check]) -> Iterator[RenderableType]:
    """Yield what is proved of an observer and its form, and what is not: the first claim of each in full, its
    convergence if that is among them, and the names of the others."""

    def place(check: Check) -> tuple[bool, bool, bool]:  # a theorem about a form is none about the original
        return check.id.fact != "convergence", check.id.maker != "original", check.id.maker != observer

    ordered = sorted(checks, key=place)
    for label, proved in (("proved", True), ("not proved", False)):
        chosen = [check for check in ordered if (check.verdict is Verdict.PROVED) is proved]
        if not chosen:
            yield line(label, "nothing" if proved else "nothing; what is left to you: --all")
            continue
        first, *others = chosen
        known = first.claim if proved else first.reason
        more = f"; also {few((check.id for check in others), 5)}" if others else ""
        yield line(label, f"{first.id}: {known}{more}")


def to_fix(
    gaps: Iterable[Check], observability: Observability, least: Sight | None, claims: Checked, known: Convergence
) -> str:
    """Return the one thing to fix first."""
    for gap in gaps:
        return f"{gap.id}: {gap.reason}"
    if observability.known.rank.unobservable:
        return observability.known.advice or "ask a trial: its motion may show what the plant at a point hides"
    for check in claims.open if claims.demanded else ():
        return f"{check.id} is refuted: {check.advice or check.reason}"
    if least is not None and least.below_resolution:
        weak = next(iter(least.direction))
        return f"{weak} hardly moves the outputs: measure more, or take its estimate as the model's, not the sensor's"
    if known is Convergence.UNKNOWN:
        return "no proof of convergence: try it on trials (hgogen simulate) or on a log (hgogen run, hgogen inspect)"
    return "nothing"


def details() -> RenderableType:
    """Return the line that names the options for more."""
    return line("details", _DETAILS)
