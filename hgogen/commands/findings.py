"""What `check` prints of a plant: the answer in one line, what the outputs show, and which observers to take.

In the line stand what is observable, which forms the plant is in, and whether the observer converges. The forms are the
rows of the survey, which the table under it prints; the observer's own form is named where it is none of those that are
proved.
"""

from collections.abc import Iterable, Iterator
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hgogen.analysis.observability import Answer, Observability
from hgogen.analysis.undefined import MAKER
from hgogen.check import Check, ClaimId, Verdict
from hgogen.commands.advice import Advice
from hgogen.commands.checked import Checked
from hgogen.commands.tables import COLOURS, few
from hgogen.form import Form
from hgogen.run.gramian import Sight, as_share
from hgogen.sentence import Sentence, point
from hgogen.theorem import convergence
from hgogen.which_forms import Survey

_PLAIN: Any = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
_LINES = {False: "with the gains of the model's tuning", True: "with first gains, read off the ranges, untried"}
_WHERE = {  # by whether the gains are proposed, and whether the model is plain text
    (False, False): ", after `from hgogen.model import load`:",
    (False, True): ", by the command:",
    (True, False): ", beside the model's plant, after `import hgogen as hg`:",
    (True, True): ", an entry that goes above the first [table] of the model, or into its object:",
}


def headline(seen: Observability, survey: Survey, claims: Checked, least: Sight | None = None) -> str:
    """As "pendulum: locally observable; triangular, uniform, state_affine, proved; convergence unknown"."""
    said = [_observed(seen, least), *_forms(survey, claims)]
    if claims.observer:
        said.append(str(convergence(claims.observer, claims.checks)))
    else:
        said.append("its observer is refused" if claims.demanded else "no observer")
    for check in claims.checks:
        if check.id == ClaimId(claims.observer, "step"):  # of an observer of which that is asked
            said.append(f"{'' if check.verdict is Verdict.PROVED else 'not '}proved as it runs")
    return f"{claims.plant}: " + "; ".join(said)


def _observed(seen: Observability, least: Sight | None) -> str:
    known = seen.known
    if known.rank.unobservable:
        hidden, doubtful = (few((s.name for s in names), 4) for names in (known.hidden, known.doubtful))
        said = [f"{hidden} not observable"] if hidden else []
        said += [f"whether {doubtful} can be observed is unknown"] if doubtful else []
        return ", ".join(said) + (f", where {known.condition}" if known.where else "")
    if known.elsewhere:
        first, *more = known.exceptions
        return f"locally observable, but {first}" + (", ..." if more else "")
    if least is not None and least.by_motion:
        return f"locally observable, {next(iter(least.direction))} by its motion alone"
    if least is not None and least.hopeless:
        return f"locally observable, but {next(iter(least.direction))} hopelessly little ({as_share(least.median, 1)})"
    return "locally observable"


def _forms(survey: Survey, claims: Checked) -> Iterator[str]:
    """The forms in which the plant is proved to be, else the one that comes nearest; then the observer's, if that is
    another one."""
    proved = [row.kind for row in survey.proved]
    recast = claims.form.system.origin is not survey.plant.origin
    known = claims.demanded and not recast and claims.form.kind in (proved or [row.kind for row in survey.candidates])
    if proved:
        yield f"{', '.join(proved)}, proved"
    elif known:
        yield _form(claims.form, claims.accepted)
    else:
        yield _form(survey.best, ()) if survey.candidates else "in none of the forms asked"
    if claims.demanded and not known:
        yield f"its observer's form{', of the recast plant' * recast}: {_form(claims.form, claims.accepted)}"


def _form(form: Form, accepted: Iterable[str]) -> str:
    """A form with what is not proved of it."""
    failed = [check for check in form.checks if check.verdict is Verdict.REFUTED]
    if failed:
        known = "accepted" if all(check.id in accepted for check in failed) else "refuted"
        return f"{form.kind} but for {_names(failed)} ({known})"
    doubtful = [check for check in form.checks if check.verdict is not Verdict.PROVED]
    if doubtful:
        return f"{form.kind} as far as is known: {_names(doubtful)} not proved"
    return f"{form.kind}, proved"


def _names(checks: Iterable[Check]) -> str:
    return few((check.id if check.id.maker == MAKER else check.id.short for check in checks), 4)


def undefined(checks: Iterable[Check]) -> RenderableType:
    """The rows of the plant that have no finite value somewhere in the declared ranges, or may have none, line by
    line."""
    lines = []
    for check in checks:
        pattern = "{id}: {reason}; at {point}" if check.witness else "{id}: {reason}"
        said = Sentence.of(pattern, id=check.id, reason=check.reason, point=point(check.witness))
        lines.append(Text(f"{check.verdict:10}", style=COLOURS.get(check.verdict, "cyan")).append(str(said), "default"))
    return Group(*lines)


def observed(seen: Observability, least: Sight | None = None) -> RenderableType:
    """What the outputs tell of the states, and of the parameters that have a range; how much at `least`."""
    title = f"{seen.system.name}: observability, at almost every state, parameter value and input"
    loose = few(s for s in seen.system.parameters if s.bounded)
    whose = ("the states", f"the states and {loose}") if loose else ("the states",)
    table = Table(show_header=False, **_PLAIN)
    for check, answer, what in zip(seen.checks, (seen.known, seen.joint), whose, strict=False):
        verdict = Text(str(check.verdict), style=COLOURS.get(check.verdict, "cyan"))
        table.add_row(verdict, Text(_answered(answer, what)) if answer else "")
    if least is not None:
        table.add_row(Text("hopeless", style="red") if least.hopeless else Text("measured"), Text(str(least)))
    return Group(Text(title, style="bold"), table, *([Text(str(seen.asked))] if seen.asked else []), "")


def _answered(answer: Answer, what: str) -> str:
    """What is observable of the states; advice on measurements only where it is proved that something is not."""
    rank = answer.rank
    count = f"rank {rank.rank} of {rank.dimension}, by derivatives of the outputs up to order {rank.order}"
    if not rank.unobservable:
        but = "".join(f"\nbut {exception}" for exception in answer.exceptions)
        return f"{what} are locally observable: {count}{but}"
    said = [f"of {what}, {', and '.join(map(str, answer.unseen))}: {count}"]
    said += [f"no output sees {symmetry}" for symmetry in answer.symmetries if symmetry.proved]
    said += map(str, answer.exceptions)
    return "\n".join([*said, *([answer.advice] if answer.advice else [])])


def taking(advice: Advice) -> RenderableType:
    """The observers that the plant admits, best first, with a line for each, and what else to do."""
    said = "each built without accepting anything, with what is known of its convergence in continuous time"
    head = Text(f"{advice.plant}: what to take, {said}", style="bold")
    parts: list[RenderableType] = [head]
    if advice.admitted:
        table = Table(*("observer", "form", "convergence", "cost", "take it where"), **_PLAIN)
        for one in advice.admitted:
            count = f"{one.cost.operations} + {one.cost.functions}"
            table.add_row(*map(Text, (one.observer, one.form, one.known, count, one.where.replace("`", ""))))
        parts.append(table)
    for proposed, title in _LINES.items():
        lines = [
            Text(f"  {one.line}", no_wrap=True, overflow="ignore")
            for one in advice.admitted
            if one.proposed is proposed
        ]
        parts += [Text(title + _WHERE[proposed, advice.plain]), *lines] if lines else []
    return Group(*parts, *map(Text, advice.notes), "")
