"""NAME.md: the mathematics of a step, for people: its equations as LaTeX, gains, claims, hypotheses and references."""

from collections.abc import Iterable

import sympy as sp

from hgogen.check import Verdict
from hgogen.emit.claims import consequence, refuted_and_accepted, verdict
from hgogen.emit.described import entry
from hgogen.emit.displayed import aligned, displayed, plain, table
from hgogen.emit.manual import BETWEEN, said_what_for, title
from hgogen.intervals.digits import same
from hgogen.method import equations
from hgogen.program import INF, Field
from hgogen.reading.time_unit import pace
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.theorem import rows


def document(step: Step) -> list[str]:
    """Its lines."""
    first, *others = title(step, "")
    parts = [_plant, _form, _observer, _gains, _method, _claims, _hypotheses, _references]
    lines = [f"# {plain(first)}", "", *(f"{line}." for line in others)]
    for part in parts:
        lines += ["", *part(step)]
        while lines[-1] == "":
            lines.pop()
    return lines


def _plant(step: Step) -> list[str]:
    plant = step.observer.form.system.declared
    kinds = {"state": plant.states, "input": plant.inputs, "output": plant.outputs, "parameter": plant.parameters}
    lines = [_signal(kind, signal) for kind, signals in kinds.items() for signal in signals]
    head = ("signal", "kind", "meaning", "unit", "range", "value")
    return [
        "## Plant",
        "",
        *aligned([rf"\dot{{{sp.latex(s)}}} &= {sp.latex(e)}" for s, e in zip(plant.states, plant.flow, strict=True)]),
        *aligned([f"{sp.latex(y)} &= {sp.latex(e)}" for y, e in zip(plant.outputs, plant.output, strict=True)]),
        *table(head, lines),
    ]


def _signal(kind: str, signal: Signal) -> list[str]:
    range_ = f"{signal.low:g} .. {signal.high:g}" if signal.bounded else ""
    value = "" if signal.nominal is None else same(float(signal.nominal))
    return [f"`{signal.name}`", kind, plain(signal.meaning), plain(signal.unit), range_, value]


def _form(step: Step) -> list[str]:
    form, origin = step.observer.form, step.observer.form.system.origin
    recast = zip(form.system.states, origin.forward, strict=True) if origin else ()
    new = [f"{sp.latex(w)} &= {sp.latex(e)}" for w, e in recast]
    behind = form.b if form.behind is None else form.behind
    system = [
        rf"\dot z &= {sp.latex(form.A)}\,z + {sp.latex(sp.ImmutableDenseMatrix(behind))}",
        *(f"{sp.latex(y)} &= {sp.latex(e)}" for y, e in zip(form.system.outputs, form.output, strict=True)),
    ]
    z = [f"{sp.latex(z)} &= {sp.latex(e)}" for z, e in zip(form.states, form.to_form, strict=True)]
    back = [f"{sp.latex(s)} &= {sp.latex(e)}" for s, e in form.estimates]
    same_states = all(sp.sympify(e).is_Symbol for _, e in form.estimates)
    inverse = [] if same_states else ["The plant's state from it:", "", *aligned(back)]
    return [
        f"## Form: {plain(form.kind)}",
        "",
        *(["In the states", "", *aligned(new)] if new else []),
        *aligned(z),
        "z' = A z + b, y = h:",
        "",
        *aligned(system),
        *inverse,
    ]


def _observer(step: Step) -> list[str]:
    observer = step.observer
    return [f"## Observer: {plain(observer.name)}", "", *displayed(observer.equations)]


def _gains(step: Step) -> list[str]:
    lines = [_gain(step, field, k) for field in step.gains for k in range(field.size)]
    if not lines:
        return ["There are no gains to tune."]
    return table(("gain", "value", "range", "unit", "meaning"), lines)


def _gain(step: Step, field: Field, k: int) -> list[str]:
    """A row of one element of a gain."""
    low, high = field.box[k]
    name = field.name if field.size == 1 else f"{field.name}[{k}]"
    label = field.labels[k] if field.labels else entry(field.name, field.entries[k]) if field.entries else ""
    meaning = f"{field.meaning}: {label}" if label and field.size > 1 else field.meaning
    range_ = f"{low:g} .. {high:g}" if low > -INF and high < INF else ""
    return [f"`{name}`", same(field.initial[k]), range_, plain(step.unit(field)), plain(meaning)]


def _method(step: Step) -> list[str]:
    between = f" Between two calls the input is taken to {BETWEEN[step.between]}." if step.inputs else ""
    period = f"A step every {pace(step.dt, step.time)}, which is h.{between}"
    what_for = [f"It is made for {step.prefer}{f': {step.choice}' * bool(step.choice)}.", ""] * said_what_for(step)
    equations_ = displayed(equations(step.method, step.rule))
    return [f"## Method: {plain(step.rule)}", "", period, "", *what_for, *equations_]


def _claims(step: Step) -> list[str]:
    observer = step.observer
    lines = []
    for check in observer.checks:
        at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
        follows = f"so {consequence(check)}" if refuted_and_accepted(check, observer.accepted) else ""
        evidence = "; ".join(filter(None, (str(check.reason), f"at {at}" if at else "", follows)))
        lines.append([verdict(check, observer.accepted), f"`{check.id}`", *map(plain, (str(check.claim), evidence))])
    return ["## Claims", "", *table(("verdict", "claim", "what it says", "evidence"), lines)]


def _hypotheses(step: Step) -> list[str]:
    theorem = step.observer.theorem
    known = sorted(rows(theorem, step.observer.checks), key=lambda row: row.verdict is Verdict.PROVED)
    lines = [
        [row.standing, *map(plain, (row.claim, str(row.reason), row.reference)), _ids(row.checks)] for row in known
    ]
    return [
        "## Hypotheses of the theorem",
        "",
        f"It says: {plain(theorem.conclusion)}.",
        "",
        *table(("standing", "hypothesis", "what is known", "where", "claims behind it"), lines),
    ]


def _ids(checks: Iterable[str]) -> str:
    return ", ".join(f"`{id}`" for id in checks)


def _references(step: Step) -> list[str]:
    observer = step.observer
    works = dict.fromkeys(filter(None, (observer.reference, observer.theorem.reference, observer.form.reference)))
    return ["## References", "", *(f"- {plain(each)}" for each in works)]
