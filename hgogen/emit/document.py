"""NAME.md: the mathematics of a step, for people: its equations as LaTeX, gains, claims, hypotheses and references."""

from collections.abc import Iterable, Sequence

import sympy as sp

from hgogen.check import Verdict
from hgogen.emit.described import entry
from hgogen.emit.formula import formulas, plain, table
from hgogen.emit.manual import BETWEEN, consequence, refuted_and_accepted, said_what_for, title, verdict
from hgogen.emit.promised import promised
from hgogen.method import equations
from hgogen.program import INF
from hgogen.sentence import same
from hgogen.signal import pace
from hgogen.step import Step
from hgogen.theorem import rows


def document(step: Step, manual: Sequence[str] = ()) -> list[str]:
    """Return its lines, with the manual of a language behind the title, where one is given."""
    first, *others = title(step, "")
    parts = [_plant, _form, _observer, _gains, _method, _claims, _as_it_runs, _hypotheses, _references]
    lines = [f"# {plain(first)}", "", *(f"{line}." for line in others)]
    lines += ["", *manual] if manual else []
    for part in parts:
        lines += ["", *part(step)]
        while lines[-1] == "":
            lines.pop()
    return lines


def _displayed(lines: Iterable[str]) -> list[str]:
    return [text for line in lines for formula in formulas(line) for text in ("$$", formula, "$$", "")]


def _aligned(equations: Sequence[str]) -> list[str]:
    rows = [f"{line} \\\\" for line in equations[:-1]] + list(equations[-1:])
    return ["$$", r"\begin{aligned}", *rows, r"\end{aligned}", "$$", ""]


def _plant(step: Step) -> list[str]:
    plant = step.observer.form.system.declared
    kinds = {"state": plant.states, "input": plant.inputs, "output": plant.outputs, "parameter": plant.parameters}
    lines = list[list[str]]()
    for kind, signals in kinds.items():
        for signal in signals:
            range_ = f"{signal.low:g} .. {signal.high:g}" if signal.bounded else ""
            value = "" if signal.nominal is None else same(float(signal.nominal))
            lines.append([f"`{signal.name}`", kind, plain(signal.meaning), plain(signal.unit), range_, value])
    head = ("signal", "kind", "meaning", "unit", "range", "value")
    return [
        "## Plant",
        "",
        *_aligned([rf"\dot{{{sp.latex(s)}}} &= {sp.latex(e)}" for s, e in zip(plant.states, plant.flow, strict=True)]),
        *_aligned([f"{sp.latex(y)} &= {sp.latex(e)}" for y, e in zip(plant.outputs, plant.output, strict=True)]),
        *table(head, lines),
    ]


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
    inverse = [] if same_states else ["The plant's state from it:", "", *_aligned(back)]
    return [
        f"## Form: {plain(form.kind)}",
        "",
        *(["In the states", "", *_aligned(new)] if new else []),
        *_aligned(z),
        "z' = A z + b, y = h:",
        "",
        *_aligned(system),
        *inverse,
    ]


def _observer(step: Step) -> list[str]:
    observer = step.observer
    return [f"## Observer: {plain(observer.name)}", "", *_displayed(observer.equations)]


def _gains(step: Step) -> list[str]:
    lines = list[list[str]]()
    for field in step.layout.gains:
        for k, (low, high) in enumerate(field.box):
            name = field.name if field.size == 1 else f"{field.name}[{k}]"
            label = field.labels[k] if field.labels else entry(field.name, field.entries[k]) if field.entries else ""
            meaning = f"{field.meaning}: {label}" if label and field.size > 1 else field.meaning
            range_ = f"{low:g} .. {high:g}" if low > -INF and high < INF else ""
            lines.append([f"`{name}`", same(field.initial[k]), range_, plain(step.unit(field)), plain(meaning)])
    if not lines:
        return ["There are no gains to tune."]
    return table(("gain", "value", "range", "unit", "meaning"), lines)


def _method(step: Step) -> list[str]:
    between = f" Between two calls the input is taken to {BETWEEN[step.clock.between]}." if step.inputs else ""
    period = f"A step every {pace(step.dt, step.time)}, which is h.{between}"
    purpose = f"It is made for {step.clock.prefer}{f': {step.choice}' * bool(step.choice)}."
    what_for = [purpose, ""] * said_what_for(step)
    equations_ = _displayed(equations(step.method, step.code.rule))
    return [f"## Method: {plain(step.code.rule)}", "", period, "", *what_for, *equations_]


def _claims(step: Step) -> list[str]:
    observer = step.observer
    lines = []
    for check in observer.checks:
        at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
        follows = f"so {consequence(check)}" if refuted_and_accepted(check, observer.accepted) else ""
        evidence = "; ".join(filter(None, (str(check.reason), f"at {at}" if at else "", follows)))
        lines.append([verdict(check, observer.accepted), f"`{check.id}`", *map(plain, (str(check.claim), evidence))])
    return ["## Claims", "", *table(("verdict", "claim", "what it says", "evidence"), lines)]


def _as_it_runs(step: Step) -> list[str]:
    lines = promised(step)
    return ["## As it runs", "", "```text", *lines, "```"] if lines else []


def _hypotheses(step: Step) -> list[str]:
    theorem = step.observer.theorem
    known = sorted(rows(theorem, step.observer.checks), key=lambda row: row.verdict is Verdict.PROVED)
    lines = list[list[str]]()
    for row in known:
        ids = ", ".join(f"`{id}`" for id in row.checks)
        lines.append([row.standing, *map(plain, (row.claim, str(row.reason), row.reference)), ids])
    return [
        "## Hypotheses of the theorem",
        "",
        f"It says: {plain(theorem.conclusion)}.",
        "",
        *table(("standing", "hypothesis", "what is known", "where", "claims behind it"), lines),
    ]


def _references(step: Step) -> list[str]:
    observer = step.observer
    works = dict.fromkeys(filter(None, (observer.reference, observer.theorem.reference, observer.form.reference)))
    return ["## References", "", *(f"- {plain(each)}" for each in works)]
