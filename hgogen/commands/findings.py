"""What `check` prints of a plant: what the outputs show, and which observers to take."""

from collections.abc import Iterable
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hgogen.analysis.observability import Answer, Observability
from hgogen.check import Check
from hgogen.commands.advice import Advice
from hgogen.commands.tables import COLOURS, few
from hgogen.sentence import Sentence, point
from hgogen.trials.sight import Sight

_PLAIN: Any = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
_LINES = {False: "with the gains of the model's tuning", True: "with first gains, read off the ranges, untried"}
_WHERE = {  # by whether the gains are proposed, and whether the model is plain text
    (False, False): ", after `from hgogen.model import load`:",
    (False, True): ", by the command:",
    (True, False): ", beside the model's plant, after `import hgogen as hg`:",
    (True, True): ", an entry that goes above the first [table] of the model, or into its object:",
}


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
