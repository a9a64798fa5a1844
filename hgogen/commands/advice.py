"""Advice on observers for `hgogen check`: which observers a plant admits, and which measurements would make it
observable or put it in a form.

A plant admits an observer if its step can be built without accepting a refuted check. The gains are those of the
model's tuning, or the starting gains that the observer's rule computes from the ranges. Each observer comes with the
code that makes the same step. Observers are ordered by what is known of their convergence (`KNOWN`), then by the number
of operations of a call.
"""

import json
import shlex
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from hgogen import forms, observers
from hgogen.analysis.observability import Observability, observability
from hgogen.call import CallableStep
from hgogen.check import Verdict
from hgogen.commands.claims import Checked
from hgogen.emit.cost import Cost, cost
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.model import Model
from hgogen.modelfiles.tuning import First, NoFirst, first, places
from hgogen.reading.text_model import inline
from hgogen.registry import summary
from hgogen.rigor.rank import NowhereDefined
from hgogen.rigor.tape import NoTape
from hgogen.signal import Signal
from hgogen.starting import MANY, Rule, rule
from hgogen.system import System
from hgogen.theorem import Convergence
from hgogen.which_forms import NOT_TRIED, Survey, survey_settings

KNOWN = {  # the verdict on convergence in words, and its rank; None: no theorem covers the observer
    Convergence.PROVED: ("proved", 0),
    Convergence.ABOVE: ("proved for its theta", 0),
    Convergence.BELOW: ("proved for a larger theta", 1),
    Convergence.UNKNOWN: ("open", 2),
    None: ("no theorem", 3),
}


@dataclass(frozen=True)
class Admitted:
    """An observer that the plant admits; `convergence`: the verdict on its convergence, None if no theorem covers
    it."""

    json_keys = "observer name form known where line proposed operations=cost.operations functions=cost.functions"

    observer: Annotated[str, "name of the observer"]
    name: Annotated[str, "name of its tuning, empty for a first proposal"]
    form: Annotated[str, "the form it is built on"]
    convergence: Convergence | None
    cost: Cost
    where: Annotated[str, "where to take it"]
    line: Annotated[str, "code, command or entry of the model that makes its step"]
    step: CallableStep = field(repr=False)

    @property
    def known(self) -> str:
        """The verdict on its convergence, in a word."""
        return KNOWN[self.convergence][0]

    @property
    def rank(self) -> tuple[int, int, int]:
        """The sort key, lowest for the best observer: first by what is known of convergence, then by cost."""
        return KNOWN[self.convergence][1], self.cost.operations, self.cost.functions

    @property
    def proposed(self) -> bool:
        """Whether the gains are a first proposal rather than those of the model's tuning."""
        return not self.name


@dataclass(frozen=True)
class Advice:
    """The advice for a model: the observers that its plant admits, and notes; `plain`: whether the model is a
    plain-text file rather than Python."""

    json_keys = "take=admitted advice=notes"

    plant: str
    admitted: Annotated[tuple[Admitted, ...], "the observers admitted, best first"]
    notes: Annotated[tuple[str, ...], "what else to do"]
    plain: bool = False


def advice(
    model: Model,
    observability: Observability,
    survey: Survey,
    claims: Checked,
    *,
    deep: bool = False,
    kinds: Collection[str] = tuple(observers.__all__),
) -> Advice:
    """Return the observers among `kinds` that a model's plant admits, and further advice. Unless `deep`, what may take
    seconds is skipped: tunings on a slow form, and observers whose proof needs a solver.

    `claims`: the claims about the model's own observer, whose step is then not built again.
    """
    tuned = _Tuned(model, claims, deep, kinds)
    rows = dict(tuned.rows())
    n = len(survey.plant.states)
    others = (kind for kind in observers.__all__ if kind in kinds and kind not in rows)
    untuned = [kind for kind in others if deep or n <= _rule(kind).quick]
    proposed = {kind: first(kind, places(survey)) for kind in untuned}
    rows |= {
        kind: _admitted(kind, "", one.step, _line(one, model), one.row.name)
        for kind, one in proposed.items()
        if isinstance(one, First)
    }
    order = sorted(rows.values(), key=lambda row: row.rank)
    skipped = [
        f"{kind} has no starting gains: {one.reason}."
        for kind, one in proposed.items()
        if rows and isinstance(one, NoFirst) and one.ruled
    ]
    if n > MANY and not deep:
        skipped = ["For a plant of this many states, --deep builds other observers with starting gains too."]
    notes = (*_notes(model, observability, survey), *tuned.omissions(rows), *skipped)
    return Advice(survey.plant.name, tuple(order), notes, model.plain)


def _admitted(kind: str, name: str, step: CallableStep, line: str, form: str = "") -> Admitted:
    where = _rule(kind).where or summary("observers", kind)
    observer = step.observer
    return Admitted(kind, name, form or observer.form.kind, observer.convergence, cost(step), where, line, step)


def _rule(kind: str) -> Rule:
    return rule(getattr(observers, kind))


# ---------------------------------------------------------------- with the model's gains


@dataclass(frozen=True)
class _Tuned:
    """The model's tuned observers; `slow`, `refused`: why some tunings are left out."""

    model: Model
    claims: Checked
    deep: bool
    kinds: Collection[str]
    accepting: dict[str, tuple[str, ...]] = field(default_factory=dict)
    slow: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)

    def rows(self) -> Iterator[tuple[str, Admitted]]:
        done: set[str] = set()
        checked_step = self.claims.step
        if checked_step is not None and not checked_step.observer.accepted:
            kind = checked_step.observer.name
            done.add(kind)
            yield kind, _admitted(kind, self.claims.tuning or "step", checked_step, self._line())
        tuning = self.model.tuning
        for name, kind in tuning.kinds.items():
            unasked = kind in observers.__all__ and kind not in self.kinds  # of no kind it is refused
            if kind in done or unasked:
                continue
            step = self._step(name, kind, tuning.tables[name])
            if step is not None:
                done.add(kind)
                yield kind, _admitted(kind, name, step, self._line(name))

    def _line(self, name: str = "") -> str:
        name = name or self.claims.tuning
        if self.model.plain:
            return shlex.join(["hgogen", "generate", self.model.path, *(["--observer", name] if name else [])])
        return f"load({json.dumps(self.model.path)}).step({json.dumps(name) if name else ''})"

    def _step(self, name: str, kind: str, table: Any) -> CallableStep | None:
        accepted = table.get("accept") if isinstance(table, Mapping) else None
        if isinstance(accepted, list | tuple) and accepted:
            self.accepting[kind] = tuple(map(str, accepted))
            return None
        if not self.deep and kind in observers.__all__ and (_rule(kind).costly or self._on_a_slow_form(table)):
            self.slow.append(kind)
            return None
        checked_step = self.claims.step if not self.claims.tuning else None
        try:
            step = self.model.step(name, period=None if checked_step is None else lambda: checked_step.dt)
        except HgogenError as error:
            self.refused[name] = str(error)
            return None
        if step.observer.accepted:
            self.accepting[kind] = step.observer.accepted
            return None
        return step

    def _on_a_slow_form(self, table: Any) -> bool:
        visited: list[Any] = []
        while isinstance(table, Mapping) and "member" in table and table not in visited:
            visited.append(table)
            table = self.model.tuning.tables.get(table["member"], {})
        form = table.get("form") if isinstance(table, Mapping) else None
        return survey_settings(str(form.get("kind") if isinstance(form, Mapping) else form)).slow

    def omissions(self, rows: Mapping[str, Admitted]) -> Iterator[str]:
        slow = [kind for kind in dict.fromkeys(self.slow) if kind not in rows]
        if slow:
            yield f"Built only with --deep, since this may take seconds: {', '.join(slow)}."
        for kind, ids in self.accepting.items():
            if kind not in rows or rows[kind].proposed:
                yield f"The tuning of {kind} needs these refuted checks to be accepted: {', '.join(ids)}."
        for name, error in self.refused.items():
            yield f"The tuning {name} is refused: {error}"


# ---------------------------------------------------------------- with first gains


def _line(one: First, model: Model) -> str:
    kind, row = one.observer, one.row
    if not model.plain:
        options = "".join(f", {key}={value!r}" for key, value in row.options.items())
        gains = ", ".join(f"{key}={value!r}" for key, value in one.starting.gains.items())
        return f"hg.sample(hg.observers.{kind}(hg.forms.{row.kind}(plant{options}), {gains}), dt={one.starting.dt!r})"
    known = kind in model.tuning.tables  # a tuning that accepts a refutation keeps its name
    name = f"{kind}_first" if known else kind
    table = one.table(name)
    if model.path.endswith(".json"):
        return f'"tuning": {json.dumps({name: table})}'
    return f"tuning.{name} = {inline(table)}"


# ---------------------------------------------------------------- other advice


def unobservable_note(plant: System, form: Form) -> Iterator[str]:
    """Yield a sentence on the states that are proved to be unobservable, if there are any, and what to do. Nothing is
    computed for a plant that is proved to be in a `form` of observable plants."""
    if survey_settings(form.kind).candidate and all(check.verdict is Verdict.PROVED for check in form.checks):
        return
    try:
        yield from _lost(plant, observability(plant, unknown=()))
    except (NowhereDefined, NoTape):  # nothing is proved
        return


def _lost(plant: System, observability: Observability) -> Iterator[str]:
    known = observability.known
    if not known.lost:
        return
    names = ", ".join(s.name for s in known.lost)
    condition = ", on the branches asked" if observability.scope else ""
    hidden, alternative = set(known.lost), ""
    other_rates = [rate for x, rate in zip(plant.states, plant.flow, strict=True) if x not in hidden]
    if other_rates and not any(e.free_symbols & hidden for e in (*other_rates, *plant.output)):
        alternative = ", or leave it out of the model, since the other states form a complete plant"
    yield f"No observer can estimate {names} from these outputs{condition}: {known.advice}{alternative}."


def _notes(model: Model, observability: Observability, survey: Survey) -> Iterator[str]:
    yield from _lost(survey.plant, observability)
    if observability.known.rank.unobservable:
        return
    if any(row.verdict is Verdict.PROVED for row in survey.candidates):
        return
    best = list(_measurements(survey.plant))
    if best:
        form = "another form" if survey.proved else "a form"
        yield f"With another measurement the plant is in {form}, proved: {'; '.join(best)}."
    if not survey.proved:
        yield _advice_without_form(model, survey)


def _advice_without_form(model: Model, survey: Survey) -> str:
    """Return the advice for a plant that is proved to be in none of the surveyed forms. If the plant
    is observable for every input, an output and its derivatives are coordinates of a form."""
    plant, phase = survey.plant, survey["phase"]
    for_any_input = not plant.inputs or survey["Gauthier-Bornard"].verdict is Verdict.GENERIC
    if len(plant.outputs) == 1 and for_any_input and phase.why == NOT_TRIED:
        y = plant.outputs[0].name
        ask = f"`hgogen check {model.path} --deep` tests whether this holds on the whole ranges (form phase)"
        return f"Almost everywhere {y} and its derivatives can serve as the states of a form: {ask}."
    return (
        "No requested form is proved for the plant, and no theorem covers an observer in the plant's own states: test "
        "the observer by simulation (`hgogen simulate`)."
    )


def _measurements(plant: System) -> Iterator[str]:
    known = {e for e in plant.output if e in plant.states}
    for x in plant.states if len(plant.states) <= MANY else ():
        if x in known:
            continue
        new = Signal(f"measured_{x.name}", x.unit, low=x.low, high=x.high, period=x.period)
        replaced = replace(plant, outputs=(new,), output=(x,))
        extended = replace(plant, outputs=(*plant.outputs, new), output=(*plant.output, x))
        if name := _form(replaced) if len(plant.outputs) == 1 else "":
            yield f"{x.name} in place of {plant.outputs[0].name} ({name})"
        elif name := _form(extended):
            yield f"{x.name} as well ({name})"


def _form(plant: System) -> str:
    kinds = ("triangular", "uniform") if len(plant.outputs) == 1 else ("block_triangular",)
    for name in kinds:
        try:
            form: Form = getattr(forms, name)(plant)
        except HgogenError:
            continue
        if all(check.verdict is Verdict.PROVED for check in form.checks):
            return name
    return ""
