"""NAME.md: the manual of C, in the order of use, and the mathematics of a step in any language, for people.

The mathematics are equations as LaTeX, gains, claims, hypotheses and references.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

from hgogen.check import Check, Verdict
from hgogen.emit import pystep
from hgogen.emit.code import indented
from hgogen.emit.cost import cost
from hgogen.emit.formula import formulas, plain, prose, table
from hgogen.emit.interface import (
    address,
    entry,
    of_section,
    parameters,
    prototype,
    prototypes,
    reported,
    status_type,
    structs,
)
from hgogen.emit.manual import (
    UNTIMELY,
    between_calls,
    calls,
    consequence,
    faults,
    gains,
    late,
    marks,
    names_preference,
    parts,
    proved_above,
    proved_bounds,
    rates,
    refuted_and_accepted,
    reports,
    result,
    sample_noise,
    state,
    title,
    verdict,
)
from hgogen.emit.naming import c_name
from hgogen.emit.structs import ONE_TURN, described
from hgogen.emit.syntax import Real, shortest
from hgogen.form import Form
from hgogen.method import equations
from hgogen.observer import Observer
from hgogen.program import INF, Field, Place, Section, lines_of
from hgogen.program import address as place_of
from hgogen.registry import version
from hgogen.sentence import same
from hgogen.signal import TURNS, Signal
from hgogen.step import Step
from hgogen.stepping.guards import MARK, OF_PARAMETERS
from hgogen.stepping.machine import Interpreter
from hgogen.stepping.sections import ROUND
from hgogen.system import System
from hgogen.theorem import rows


def document(step: Step, manual: Sequence[str] = ()) -> list[str]:
    """Return the lines of a step's Markdown document NAME.md; `manual`: the lines on how to call the step, which follow
    the title."""
    first, *others = title(step, "")
    observer = step.observer
    works = dict.fromkeys(filter(None, (observer.reference, observer.theorem.reference, observer.form.reference)))
    bounds = proved_bounds(step)
    parts_ = [
        plant_equations(observer.form.system.declared),
        form_equations(observer.form),
        observer_equations(observer),
        gains_table(step),
        method_equations(step),
        ["## Claims", "", *claims_table(observer.checks, observer.accepted)],
        ["## As it runs", "", "```text", *bounds, "```"] if bounds else [],
        _hypotheses(step),
        ["## References", "", *(f"- {plain(each)}" for each in works)],
    ]
    lines = [f"# {plain(first)}", "", *(f"{line}." for line in others)]
    lines += ["", *manual] if manual else []
    for part in parts_:
        lines += ["", *part]
        while lines[-1] == "":
            lines.pop()
    return lines


# --- the manual of C


def manual(step: Step, real: Real, check: bool) -> list[str]:
    """Return the lines of a step's C manual in Markdown: how C calls the step, struct members, status bits, faults,
    gains and saved states.

    `check`: whether a self-check program is emitted too, which the manual then describes.
    """
    delays, costs = _list(late(step, real)), vars(cost(step, real))
    files = ", ".join(f"`{step.name}{end}`" for end in (".h", ".c", *["_check.c"] * check))
    sections = {
        "Use from C": _use(step),
        "State, inputs, outputs": _signals(step, real),
        "Status bits": _status(step),
        "Missing samples and faults": [
            *_list(faults(step)),
            *(["", "### Late samples", "", *delays] if delays else []),
        ],
        **({"How sure the estimate is": _list(reports(step, f"{step.name}_{{name}}"))} if step.code.reports else {}),
        "Changing gains": _list(gains(step, f"{step.name}_tune")),
        "Saving and restoring": _list([*state(step, "after init or reset and before the first call"), *marks(step)]),
        "Self-check": _list([*[_CHECK.format(name=step.name, upper=step.name.upper())] * check, *_COMPILED]),
        "Cost": _list(each.format(**costs) for each in _COST),
        "Source": _list(each.format(version(), files, step.observer.reference) for each in _SOURCE),
    }
    lines = [line for name, inner in sections.items() for line in (f"## {name}", "", *inner, "")]
    return lines[:-1]


def _list(sentences: Iterable[str]) -> list[str]:
    return [f"- {prose(each)}" for each in sentences]


_SHARED = (
    "No heap, no recursion, no static data that changes, for tables are constant; every loop is bounded. One set "
    "of structs for each instance, shared between threads only under a lock of yours."
)
_CHECK = (
    "`{name}_check.c` has recorded samples: compile it with the flags of the observer and `-D{upper}_CHECK_MAIN`, and "
    "run it. With `-D{upper}_EXACT` as well it compares every bit."
)
_COMPILED = (
    "Compile with `-std=c99 -ffp-contract=off` for the recorded bits, where FLT_EVAL_METHOD of `<float.h>` is 0: "
    "elsewhere intermediate results are rounded otherwise.",
    "Never compile with `-ffast-math` or `-ffinite-math-only`, which remove the guards against NaN: the source refuses "
    "them.",
    "Nor with `-funsafe-math-optimizations` or `-fassociative-math`, which spoil the bundled functions: the source "
    "refuses them with GCC 12 and later.",
    "In clang no macro shows these options, nor `-fno-honor-nans`, with which the self-check fails.",
)
_WHOLE = (
    "`{name}_step` is all of the calls above at once, for a period in which every output has a sample; an output "
    "without one then needs NaN."
)
_TIMED = (
    f"`{{call}}`, and the function of each other output, takes the number of the period in which the sample was "
    "taken: 0 for "
    f"that of the first predict after init or reset, modulo {ROUND}, which is (uint16_t)k of a counter k of 16 bits or "
    "more.",
    f"The counter may wrap round: differences are taken modulo {ROUND}. {UNTIMELY} A sample older by a multiple of "
    f"{ROUND} periods looks like one of the present period. Before the first predict every sample is early.",
)


_COST = (
    "A call takes up to {operations} operations and {functions} functions (root, sine, ..).",
    "RAM: {state} bytes of state and {params} bytes of parameters, where unsigned has 4 bytes.",
    "Flash, stack and instructions depend on the compiler: `hgogen cost` measures them on a Cortex-M4F, and writes "
    "them to `cost.json`. Its worst call is the slowest of a hostile log, and no proven bound.",
)
_SOURCE = (
    "hgogen {0} generated {1} from the model.",
    "Observer: {2}.",
    "The sections below have the plant, the form, the observer and the method as equations, the claims with their "
    "evidence, and the hypotheses of the theorem.",
)


def _use(step: Step) -> list[str]:
    name, every = step.name, step.pace
    what = "predict, and update where a sample came," if step.code.timed else "one step"
    lines = [f"One init, then {what} a sampling period of {every}.", "", "```c"]
    lines += [each.local for each in (*structs(step), *reported(step))]
    lines += [f"{prototypes(step)['init'].call(address)};", f"for (;;) {{                      /* every {every} */"]
    lines += [*indented(_body(step)), f"    {name}_estimate(&s, &p, &x);"]
    lines += [f"    {prototypes(step)[each.name].call(address)};" for each in step.code.reports]
    lines += ["}", "```", ""]
    rules = [*calls(step, by_parts=bool(step.code.timed)), f"The status {result(step, 'the bits below')}.", _SHARED]
    rules += [f"{between_calls(step)}."] * bool(step.inputs)
    rules += parts(step, f"{name}_step")
    if step.code.timed:
        call = _call(step, step.code.timed[-1])
        rules += [rates(step), _WHOLE.format(name=name), *(each.format(call=call) for each in _TIMED)]
    return lines + _list(rules)


def _body(step: Step) -> list[str]:
    assigned = [f"in.{c_name(s.name)} = ...;" for s in step.given]
    status = f"{status_type(step)} status"
    if not step.code.timed:
        assigned += [f"measurement.{c_name(s.name)} = ...;" for s in step.samples]
        return [" ".join(assigned), f"{status} = {prototypes(step)['step'].call(address)};"]
    first, *others = step.code.sections
    lines = [*assigned, f"{status} = {_call(step, first)};"]
    for section in others:
        call, y = f"status |= {_call(step, section)};", section.corrects
        lines += (
            [f"if ({y} has a sample now) {{", f"    measurement.{c_name(y)} = ...;", f"    {call}", "}"]
            if y
            else [call]
        )
    return lines


def _call(step: Step, section: Section) -> str:
    return prototype(step, of_section(step, section)).call(address)


_MARKS = {"s": MARK.meaning, "p": OF_PARAMETERS}
_RANGES = {  # by the bit that a call raises there
    "OUTSIDE_BOX": "Outside the declared range of a state a call raises OUTSIDE_BOX.",
    "STATE_LIMITED": "A call keeps the state in its outer box, and raises STATE_LIMITED where it would leave it.",
}
_RESOLUTION = (
    "Float resolution is the distance of two floats at the end of the declared range, else of the outer box. A change "
    "of less than half of it in one call is lost there: a smaller rate times dt does not accumulate."
)


def _signals(step: Step, real: Real) -> list[str]:
    lines = list[str]()
    head = ("member", "meaning", "unit", "range")
    for title_, struct, signals in (("Inputs", "in", step.given), ("Outputs", "measurement", step.samples)):
        if signals:
            lines += [f"### {title_}", "", *table(head, (_signal(struct, s, real) for s in signals)), ""]
    lines += [*_list(_angles(step, real)), ""] if _angles(step, real) else []
    tuned = pystep.tuned(step, real)
    starts = zip(step.states, _first_estimate(step, tuned), strict=True)
    estimate = ([*_signal("x", s, real), shortest(start, real)] for s, start in starts)
    lines += ["### Estimate", "", *table((*head[:3], "declared range", "start"), estimate), ""]
    coordinates, columns = _coordinates(step, real), ["member", "coordinate", "unit", "start"]
    columns += ["declared range", "outer box", *["float resolution"] * (real == "float")]
    lines += ["### State of the observer", "", *table(columns, coordinates), ""] if coordinates else []
    bits = {bit.place.name for bit in step.layout.bits}
    notes = [text for name, text in _RANGES.items() if name in bits] + [_RESOLUTION] * (real == "float")
    lines += [*_list(notes), ""] if coordinates else []
    above = {f"p.gain.{name}": note for name, note in proved_above(step).items()}
    mark, ready = step.layout.mark, f"`{step.name.upper()}_READY`"
    members = [(f"`{struct}.{mark.name}`", plain(meaning), ready) for struct, meaning in _MARKS.items()] if mark else []
    members += [
        (f"`{place}`", plain(f"{described(item, real)}{above.get(place, '')}"), _numbers(item.initial, real))
        for place, item in _members(step, tuned)
    ]
    return [*lines, "### All members of state and parameters", "", *table(("member", "meaning", "start"), members)]


def _angles(step: Step, real: Real) -> list[str]:
    turning = [s.name for s in (*step.inputs, *step.samples, *step.states) if s.period is not None]
    if not turning:
        return []
    notes = [
        f"Angles: {', '.join(turning)}. Values that differ by whole turns are equal, and every "
        "difference is taken the short way round. An estimate is reported in its turn.",
        f"An input or a sample of an angle may be up to {TURNS} turns off; beyond that an input is replaced by the "
        "last valid one, and a sample is rejected.",
    ]
    lost = f"G{ONE_TURN[1:]}, so that an angle that counts its turns has lost its digits before it arrives."
    return [*notes, lost] if real == "float" else notes


def _signal(struct: str, signal: Signal, real: Real) -> list[str]:
    name = f"`{struct}.{c_name(signal.name)}`"
    turn = "one turn, " if signal.period is not None else ""
    return [name, plain(signal.meaning), plain(signal.unit), f"{turn}{_range(*signal.interval, real)}"]


def _range(low: float, high: float, real: Real) -> str:
    return f"{shortest(low, real)} .. {shortest(high, real)}" if -INF < low < high < INF else ""


def _numbers(values: Sequence[float], real: Real) -> str:
    return ", ".join(shortest(value, real) for value in (values if len(set(values)) > 1 else values[:1]))


def _first_estimate(step: Step, tuned: np.ndarray) -> list[float]:
    reading = Interpreter(step.code.estimate, step.layout.groups, step.layout.bits)
    values = {Place(struct, item.name): item.initial for struct, _, item in _state(step)}
    values |= {Place(kind, f.name): tuned[kind][f.name][0] for kind, fields in parameters(step) for f in fields}
    reading.set(values)
    reading.action(step.code.estimate)()
    return [float(reading.memory[Place("estimate", s.name)][0]) for s in step.states]


def _state(step: Step) -> Iterator[tuple[str, str, Field]]:
    yield from (("state", f"s.{item.name}", item) for item in step.layout.state)
    for line in lines_of(step.layout.groups):
        start = ".".join(["s", *(f"{group.name}[{k}]" for group, k in zip(line, "kj", strict=False))])
        yield from ((line[-1].name, f"{start}.{item.name}", item) for item in line[-1].fields)


def _members(step: Step, tuned: np.ndarray) -> Iterator[tuple[str, Field]]:
    for _, place, item in _state(step):
        yield place, replace(item, unit=step.unit(item))
    for kind, fields in parameters(step):
        for item in fields:
            name = c_name(item.name) if kind == "plant" else item.name
            begun = item.initial if kind != "derived" else tuple(np.atleast_1d(tuned[kind][item.name][0]).tolist())
            yield f"p.{kind}.{name}", replace(item, unit=step.unit(item), initial=begun)


def _coordinates(step: Step, real: Real) -> list[list[str]]:
    z, declared = step.observer.z, step.observer.dynamics.box
    boxes = {place_of(z[i])[:2]: box for i, box in enumerate(declared) if z[i].is_symbolic()}
    units = {signal.name: signal.unit for signal in step.states}
    lines = list[list[str]]()
    for struct, place, item in _state(step):
        for k, (outer, start) in enumerate(zip(item.box, item.initial, strict=True)) if item.outer else ():
            label = item.labels[k] if item.labels else ""
            ends = boxes.get((Place(struct, item.name), k), (-INF, INF))
            row = [
                f"`{place}{f'[{k}]' * (item.size > 1)}`",
                plain(label),
                plain(units.get(label, "")),
                shortest(start, real),
            ]
            turn = "one turn, " if item.turns[k] else ""
            row += [_range(*ends, real), f"{turn}{_range(*outer, real)}"]
            largest = max(map(abs, ends if ends[1] < INF else outer))
            resolution = f"{np.spacing(np.float32(largest)):.1g}" if largest < INF else ""
            lines.append([*row, *[resolution] * (real == "float")])
    return lines


def _status(step: Step) -> list[str]:
    if not step.layout.bits:
        return ["The status is 0 in any case."]
    numbers = "Use the macros: the number of a bit differs from one model to the next."
    upper = step.name.upper()
    bits = (
        (f"`{upper}_{bit.name}`", f"`0x{1 << k:04X}`", plain(bit.meaning), plain(step.action_of(bit)))
        for k, bit in enumerate(step.layout.bits)
    )
    return [numbers, "", *table(("bit", "value", "what happened", "what to do"), bits)]


def _displayed(lines: Iterable[str]) -> list[str]:
    return [text for line in lines for formula in formulas(line) for text in ("$$", formula, "$$", "")]


def _aligned(equations: Sequence[str]) -> list[str]:
    rows = [f"{line} \\\\" for line in equations[:-1]] + list(equations[-1:])
    return ["$$", r"\begin{aligned}", *rows, r"\end{aligned}", "$$", ""]


def plant_equations(plant: System) -> list[str]:
    """Return the Markdown lines of a plant: its equations as LaTeX and its signals."""
    kinds = {"state": plant.states, "input": plant.inputs, "output": plant.outputs, "parameter": plant.parameters}
    left, rows = "{}^+" if plant.discrete else r"\dot{{{}}}", zip(plant.states, plant.flow, strict=True)
    lines = list[list[str]]()
    for kind, signals in kinds.items():
        for signal in signals:
            digits = same if signal.period is None else "{:.6g}".format
            range_ = " .. ".join(map(digits, signal.interval)) if signal.bounded else ""
            value = "" if signal.nominal is None else same(float(signal.nominal))
            lines.append([f"`{signal.name}`", kind, plain(signal.meaning), plain(signal.unit), range_, value])
    head = ("signal", "kind", "meaning", "unit", "range", "value")
    return [
        "## Plant",
        "",
        *_aligned([f"{left.format(sp.latex(s))} &= {sp.latex(e)}" for s, e in rows]),
        *_aligned([f"{sp.latex(y)} &= {sp.latex(e)}" for y, e in zip(plant.outputs, plant.output, strict=True)]),
        *table(head, lines),
    ]


def form_equations(form: Form) -> list[str]:
    """Return the Markdown lines of a form: its coordinates and its equations as LaTeX."""
    origin = form.system.origin
    recast = zip(form.system.states, origin.forward, strict=True) if origin else ()
    new = [f"{sp.latex(w)} &= {sp.latex(e)}" for w, e in recast]
    behind = form.b if form.behind is None else form.behind
    left = "z^+" if form.system.discrete else r"\dot z"
    system = [
        rf"{left} &= {sp.latex(form.A)}\,z + {sp.latex(sp.ImmutableDenseMatrix(behind))}",
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
        f"z{form.system.next_mark} = A z + b, y = h:",
        "",
        *_aligned(system),
        *inverse,
    ]


def observer_equations(observer: Observer) -> list[str]:
    """Return the Markdown lines of an observer: its equations as LaTeX."""
    return [f"## Observer: {plain(observer.name)}", "", *_displayed(observer.equations)]


def gains_table(step: Step) -> list[str]:
    """Return the Markdown lines of a step's gains, with their ranges, units and meanings."""
    lines = list[list[str]]()
    for field in step.layout.gains:
        for k, (low, high) in enumerate(field.box):
            name = field.name if field.size == 1 else f"{field.name}[{k}]"
            label = field.labels[k] if field.labels else entry(field.name, field.entries[k]) if field.entries else ""
            meaning = f"{field.meaning}: {label}" if label and field.size > 1 else field.meaning
            range_ = f"{same(low)} .. {same(high)}" if low > -INF and high < INF else ""
            lines.append([f"`{name}`", same(field.initial[k]), range_, plain(step.unit(field)), plain(meaning)])
    if not lines:
        return ["There are no gains to tune."]
    return [
        *table(("gain", "value", "range", "unit", "meaning"), lines),
        *(f"\n{plain(line)}." for line in sample_noise(step)),
    ]


def method_equations(step: Step) -> list[str]:
    """Return the Markdown lines of a step's method: its period and its equations as LaTeX."""
    between, h = between_calls(step), "" if step.observer.form.system.discrete else ", which is h"
    period = f"A step every {step.pace}{h}.{f' {between}.' * bool(between)}"
    purpose = f"It is made for {step.clock.prefer}{f': {step.choice}' * bool(step.choice)}."
    preference = [purpose, ""] * names_preference(step)
    equations_ = _displayed(equations(step.method, step.code.rule))
    return [f"## Method: {plain(step.code.rule)}", "", period, "", *preference, *equations_]


def claims_table(checks: Iterable[Check], accepted: Collection[str] = ()) -> list[str]:
    """Return the Markdown table of claims with their verdicts and evidence; `accepted`: the ids of refuted claims that
    the user accepted."""
    lines = []
    for check in checks:
        at = ", ".join(f"{name} = {value:g}" for name, value in check.witness.items())
        follows = f"so {consequence(check)}" if refuted_and_accepted(check, accepted) else ""
        evidence = "; ".join(filter(None, (str(check.reason), f"at {at}" if at else "", follows)))
        lines.append([verdict(check, accepted), f"`{check.id}`", *map(plain, (str(check.claim), evidence))])
    return table(("verdict", "claim", "what it says", "evidence"), lines)


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
