"""What the commands print: checks, metrics, comparisons, predictions and reports as tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import sympy as sp
from rich.console import Group, RenderableType
from rich.text import Text
from sympy.printing.str import StrPrinter

from hgogen.check import Check, Verdict
from hgogen.commands.output import filled, headed
from hgogen.rigor.bounds import Range
from hgogen.run.comparison import Agreement, Measured, Seen
from hgogen.run.gramian import Gramian
from hgogen.run.metrics import ITSELF, Summary
from hgogen.sentence import NONE, Reason, Sentence, because, down, plain, point, up
from hgogen.step import Step
from hgogen.theorem import Row, Theorem
from hgogen.which_forms import Survey

COLOURS = {Verdict.PROVED: "green", Verdict.REFUTED: "red", Verdict.UNKNOWN: "yellow"}
_ALIKE = 4  # rows that say the same, before they are one
_SHORT = 20  # a reason that may be repeated
_ZEROS, _DIGITS = 20, 15  # of a whole number that is written as digits and a power of ten


def checks(head: Iterable[Sentence], listed: Iterable[Check], accepted: Sequence[str]) -> RenderableType:
    """The form's equations, the lines of `head`; the claims with their verdicts; what to do about those that are
    open."""
    listed = tuple(listed)
    title, *lines = head
    table = headed("", "verdict", "check", "claim and reason")
    for called, check in _gathered(listed, accepted):
        pattern = "{claim}\n{reason}; at {point}" if check.witness else "{claim}\n{reason}"
        said = Sentence.of(pattern, claim=check.claim, reason=check.reason, point=point(check.witness))
        verdict = Text(str(check.verdict), style=COLOURS.get(check.verdict, "cyan"))
        if check.id in accepted:
            verdict.append("\naccepted", style="yellow")
        table.add_row(verdict, Text(called), _text(said))
    fixes = [Text(f"{c.id}: {c.advice}") for c in listed if c.fix and c.verdict is Verdict.REFUTED]
    return Group(Text(str(title), style="bold"), *map(_text, lines), table, *fixes, "")


class _Tens(StrPrinter):  # type: ignore[misc]
    """An expression in which a whole number with many zeros at its end has a power of ten in their place."""

    def _print_Integer(self, number: sp.Integer) -> str:
        return _whole(number.p)

    def _print_Rational(self, number: sp.Rational) -> str:
        return f"{_whole(number.p)}/{_whole(number.q)}"


def _short(value: Any) -> str:
    """A value of a sentence as the tables show it."""
    if isinstance(value, sp.Basic):
        return str(_Tens({"order": None}).doprint(value))
    return _whole(value) if isinstance(value, int) else plain(value)


def _whole(number: int) -> str:
    digits = str(number).rstrip("0")
    zeros = len(str(number)) - len(digits)
    return f"{digits}e{zeros}" if zeros >= _ZEROS and len(digits.lstrip("-")) <= _DIGITS else str(number)


def _text(said: Sentence) -> Text:
    return Text(said.written(_short))


def _gathered(listed: Iterable[Check], accepted: Sequence[str]) -> Iterable[tuple[str, Check]]:
    """The checks with what they are called, those that say the same of equal a_1, a_2, .. as one."""

    def kind(check: Check) -> tuple[Any, ...]:
        alone = check.id in accepted or check.subject is None
        return (check.id,) if alone else (check.id.maker, check.id.fact, check.verdict, check.reason, check.subject)

    for _, group in groupby(listed, key=kind):
        first, *others = group
        if 1 + len(others) < _ALIKE:
            yield from ((check.id, check) for check in (first, *others))
        else:
            alike = Sentence.of("{claim}, and so for each up to {last}", claim=first.claim, last=others[-1].id.short)
            yield f"{first.id}..{others[-1].id.short}", replace(first, claim=alike)


def survey(forms: Survey, below: Iterable[Check] = ()) -> RenderableType:
    """Which form the plant is in, in which order of states, or why not; a fix that is not told `below`."""
    table = headed(f"{forms.plant.name}: which form, on the declared ranges", *("", "form", "order", "why"))
    before = NONE
    for row in forms.answered:
        verdict = Text(str(row.verdict), style=COLOURS.get(row.verdict, "cyan") if row.verdict else "")
        why = because("as above") if row.why == before and len(str(row.why)) > _SHORT else row.why
        table.add_row(verdict, Text(row.name), Text(few(row.order)), _text(why))
        before = row.why
    reasons: dict[Reason, list[str]] = {}
    for row in forms.rows:
        if row.verdict is None:
            reasons.setdefault(row.why, []).append(row.name)
    silent = [Text(f"{', '.join(names)}: {why}", style="dim") for why, names in reasons.items()]
    advised = {check.advice for check in below}
    settled = any(row.verdict is Verdict.PROVED for row in forms.answered)
    fixes = {row.fix: f"{row.name}: {row.fix}" for row in forms.answered if row.fix and row.fix not in advised}
    return Group(table, *silent, *map(Text, () if settled else fixes.values()), "")


def ranges(bounds: Mapping[str, Range]) -> RenderableType:
    """The ranges of expressions; nothing without one."""
    rows = (
        (Text(text), down(one.low, 9), up(one.high, 9), str(one.boxes), Text(str(one.note)))
        for text, one in bounds.items()
    )
    title, columns = "ranges on the declared box, outward-rounded", ("expression", "from", "to", "boxes", "")
    return Group(*filled(headed(title, *columns, rows=rows)))


def few(names: Iterable[Any], most: int = 8) -> str:
    """Names with commas, the middle of many left out."""
    names = [str(name) for name in names]
    return ", ".join(names if len(names) <= most else (*names[:3], "..", names[-1]))


def theorem(theorem: Theorem | None, hypotheses: Iterable[Row]) -> RenderableType:
    """What the observer's theorem concludes, and what is known of each hypothesis; nothing without a theorem."""
    if theorem is None:
        return Group()
    head = f"Theorem: {theorem.conclusion}\n({theorem.reference}), if"
    table = headed("", "", "hypothesis", "known by")
    for row in hypotheses:
        standing = Text(row.standing, style=COLOURS.get(row.verdict, "cyan") if row.verdict else "magenta")
        known = "; ".join(said for said in (", ".join(row.checks), str(row.reason)) if said)
        where = f" [{row.reference}]" if row.reference else ""
        table.add_row(standing, Text(row.claim + where), Text(known))
    return Group(Text(head), table, "")


def trials(each: Iterable[Summary], unit: str) -> RenderableType:
    """What followed each event of each trial, over the seeds; `unit`, here and below: that of the model's time."""
    parts: list[RenderableType] = []
    for one in each:
        table = headed(
            f"trial {one.trial}: {one.seeds} seed{'s' * (one.seeds != 1)}, in {_ENGINE[one.engine]}; "
            f"settled: {one.criterion}",
            *(f"event at ({unit})", f"settled after ({unit})", f"worst ({unit})"),
            *("peak theta", f"theta < 1.05 after ({unit})"),
            *("triggered", "still > 1.5"),
            numbers=7,
        )
        for k, time in enumerate(one.times):
            peak = one.peak[k]
            table.add_row(
                f"{time:g}",
                _number(one.settled[k]),
                _number(one.worst[k]),
                "" if peak is None else _range(*peak),
                "" if peak is None else _number(one.calm[k]),
                _percent(one.triggered[k]),
                _percent(one.loud[k]),
            )
        rms = ", ".join(f"{name} {value:.3g}" for name, value in one.rms.items())
        clamped = f"{one.clamped} samples" if one.clamped else "no sample"
        parts += [table, Text(f"steady RMS: {rms}; outside the box after the first 5%: {clamped}")]
        if one.alarm_ratio is not None:
            parts.append(Text(f"alarm ratio: {one.alarm_ratio:.2f}; above {ITSELF:g} an alarm can feed itself"))
        parts.append("")
    return Group(*parts)


def within(each: Sequence[Seen]) -> RenderableType:
    """The worst of each state's error beside its bound."""
    title = f"errors of the first seed, from {each[0].after:g} after each event on, beside what is proved of them"
    table = headed(title, "state", "worst seen", "proved", numbers=2)
    for one in each:
        worst = "-" if one.worst is None else f"{one.worst:.3g} {one.unit}"
        table.add_row(one.state, worst, f"{up(one.bound, 3)} {one.unit}")
    return table


def compared(
    title: str, each: Sequence[Measured], unit: str, estimate: Mapping[str, float], start: Mapping[str, float]
) -> RenderableType:
    """Observers side by side, one a row, from their first `estimate` of the plant's state `start`, by name."""
    states = list(each[0].rms)
    columns = (f"settled after each event ({unit})", "operations", "functions", "bytes of state")
    whole = headed(title, "observer", *columns, numbers=len(columns))
    for one in each:
        settled = ", ".join(map(_number, one.settled))
        whole.add_row(one.name, settled, *map(str, (one.cost.operations, one.cost.functions, one.cost.state)))
    rms = headed("steady error, root mean square", "observer", *states, numbers=len(states))
    peak = headed(
        "peaking: largest rise of the error after an event, over the state's range",
        "observer",
        *states,
        numbers=len(states),
    )
    for one in each:
        rms.add_row(one.name, *(f"{value:.3g}" for value in one.rms.values()))
        peak.add_row(one.name, *(f"{value:.2g}" for value in one.peak.values()))
    begun = f"every observer starts at {_state(estimate)}; the plant at {_state(start)}"
    said = (begun, *_meanings(each, unit), *(f"{one.name}: {one.unproved}" for one in each if one.unproved))
    return Group(whole, "", rms, "", *_proved(each, states), peak, "", *map(Text, said), "")


def _proved(each: Sequence[Measured], states: Sequence[str]) -> list[RenderableType]:
    """What is proved of the errors, beside the worst of the seeds; nothing where it was not asked of any."""
    if not any(one.proved or one.unproved for one in each):
        return []
    title = "proved: no error above, once the start has decayed; behind it the worst of all seeds from then on"
    table = headed(title, "observer", *states, numbers=len(states))
    for one in each:
        cells = []
        for bound, worst in ((one.proved.get(x), one.worst.get(x)) for x in states):
            seen = "-" if worst is None else f"{worst:.3g}"
            cells.append("-" if bound is None else f"{up(bound, 3)} ({seen})")
        table.add_row(one.name, *cells)
    return filled(table)


def _state(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())


def _meanings(each: Sequence[Measured], unit: str) -> Iterable[str]:
    """What the columns of a comparison mean, and which methods it compares, if several."""
    yield f"steady: from {each[0].first.trial.steady_from:g} {unit} on, the median of the seeds; peaking: of all seeds"
    yield "operations, functions (sine, exponential, root, ..): of one call; settled: the median of the seeds"
    methods: dict[str, list[str]] = {}
    for one in each:
        methods.setdefault(one.method, []).append(one.name)
    if len(methods) > 1:
        yield "; ".join(f"by {method}: {', '.join(names)}" for method, names in methods.items())


_ENGINE = {"c": "C", "python": "Python"}


def _number(value: float | None) -> str:
    """A time; two decimals tell nothing of a short one."""
    if value is None:
        return "never"
    return f"{value:g}" if abs(value) < 0.01 else f"{value:.2f}"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.0f}%"


def _range(low: float, high: float) -> str:
    return f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} .. {high:.2f}"


def agreements(each: Iterable[Agreement], unit: str) -> RenderableType:
    """C against Python."""
    table = headed(
        "C against Python, double precision, relative to each state's peak",
        *(
            "trial",
            "seed",
            f"until ({unit})",
            "difference until then",
            "afterwards",
            f"settled after ({unit}), both",
            "agreed",
        ),
        numbers=5,
    )
    for one in each:
        pairs = [(_number(first), _number(second)) for first, second in one.settled]
        settled = ", ".join(first if first == second else f"{first}/{second}" for first, second in pairs)
        agreed = Text("yes", style="green") if one.agreed else Text("no", style="red")
        difference = f"{one.before:.1e}", f"{one.after:.1e}"
        table.add_row(one.trial, str(one.seed), f"{one.until:g}", *difference, settled, agreed)
    return Group(table, "")


def status(step: Step, counts: Mapping[str, int], samples: int) -> RenderableType:
    """How often each status bit was raised, and what it asks for."""
    if not step.layout.bits:
        return Text("status: none, of a step without guards\n")
    raised = [bit for bit in step.layout.bits if counts.get(bit.name)]
    if not raised:
        return Text(f"status: 0 (ok) in all {samples} samples\n")
    rows = ((str(counts[bit.name]), bit.name, Text(bit.meaning), Text(step.asked(bit))) for bit in raised)
    table = headed(f"status over {samples} samples", "samples", "bit", "meaning", "what to do", rows=rows)
    return Group(table, "")


def windows(trial: str, gramians: Iterable[Gramian], unit: str) -> RenderableType:
    """What windows of several lengths show along a trial."""
    names = (f"d ({unit})", "smallest eigenvalue", "median", "weakest direction", "its share")
    table = headed(f"what a window d shows along trial {trial}: its observability Gramian", *names)
    for one in gramians:
        (low, high), (name, share) = one.range, one.weakest
        table.add_row(f"{one.d:g}", f"{low:.2g} .. {high:.2g}", f"{one.median:.2g}", name, f"{share:.0%}")
    advice = (
        "The innovation of a small initial error, per its squared length, is at least the smallest eigenvalue, to "
        "first order: take a window at which an error that matters stands out of sigma^2 d, the innovation of the "
        "noise."
    )
    return Group(table, Text(advice), "")
