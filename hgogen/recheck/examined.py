"""What of a certificate its claims leave unexamined: the form, where no claim rests on it, and the observer.

    dZ/dx f + dZ/du u' = A(Z) Z + b(Z),   output(Z) = h,   X(Z) = x,   Z = to_form(x, u), X = from_form

as exact identities in x, wherever both sides have a value, and at points of the plant's box. A form that is shown to be
another's plant at a point fails; what is shown neither way is said to be unexamined.
"""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from typing import Any

from .algebra import TooLarge
from .arithmetic import Arithmetic, Undefined, along, evaluate, total
from .box import NotShown, points
from .context import Context, algebra_of, inside, short
from .file import words
from .interval import intervals
from .rules import FORMS
from .rules.phase import box_of_rates

_OWN = ("phase, original coordinates", "uniform_chain, original coordinates", "original")  # the plant's coordinates
UNMODELLED = "lambda_tracking"  # an observer that may have no model of the last row, whose b is then 0
_POINTS = 5


def faults(context: Context) -> Iterator[str]:
    """What the form is shown not to be."""
    form = context.form
    if form.kind in _OWN and sorted(row.text for row in form.to_form) != sorted(context.plant.states):
        yield "its states are not those of the plant, as its kind says"
    if not _shown(context):
        yield from _differences(context)


def unexamined(context: Context, verified: Iterable[str]) -> Iterator[str]:
    """Sentences on what no verified claim is about, and what is not shown."""
    form, observer = context.form, context.file.observer
    if form.kind not in FORMS:
        yield f"no rule knows the form {words(form.kind)}: that the plant is in it"
    if not _shown(context) and (reason := _unshown(context)):
        yield f"the form's equations: {reason}"
    if _unmodelled(context):
        yield f"what the last row of the form adds to A z: the {UNMODELLED} observer has no model of it"
    if observer is not None and not any(id.startswith(f"{observer.name}.") for id in verified):
        yield f"the {observer.name} observer: no verified claim is about it"


def _shown(context: Context) -> bool:
    """Whether the form's equations are the plant's on the form's whole box."""
    try:
        _ = context.equations
    except NotShown:
        return False
    return True


def _unmodelled(context: Context) -> bool:
    """Whether the file has an observer that leaves b out of its last row, and such a form."""
    observer = context.file.observer
    return observer is not None and observer.name == UNMODELLED and all(row.text == "0" for row in context.form.b)


def _unshown(context: Context) -> str:
    """Why the identities in x are not shown, or ""."""
    try:
        box, speeds = _moving(context)
        algebra = algebra_of(box)
        for name, residual in _residuals(context, algebra.names, speeds, algebra.arithmetic):
            if not algebra.is_zero(residual):
                return f"{name} is not shown to be the plant's"
    except NotShown as error:
        return str(error)
    except Undefined:
        return "an expression of it has no value"
    except (TooLarge, RecursionError):
        return "its identity is too large to verify"
    return ""


def _differences(context: Context) -> Iterator[str]:
    """A sentence on the first of some points of the plant's box where the sides of an equation differ."""
    try:
        box, speeds = _moving(context)
    except NotShown:
        return
    for k in range(_POINTS):
        at = {
            name: inside(*ends, Fraction((3 * (k + i) + 5) % 11 + 1, 13)) for i, (name, ends) in enumerate(box.items())
        }
        try:
            differing = [name for name, x in _residuals(context, points(at), speeds, intervals) if x.sign]
        except Undefined:
            continue
        if differing:
            place = ", ".join(f"{name} = {short(value)}" for name, value in at.items())
            yield f"its equations are not the plant's: {differing[0]} differs at {place}"
            return


def _moving(context: Context) -> tuple[Mapping[str, tuple[Any, Any]], Mapping[str, str]]:
    """The plant's box with derivatives of inputs, and which is whose. Raises: `NotShown`."""
    box, rates = box_of_rates(context)
    read = {name for row in context.form.to_form for name in row.names}
    return box, {u: rate for u, rate in rates.items() if u in read}


def _residuals(
    context: Context, at: Mapping[str, Any], rates: Mapping[str, str], arithmetic: Arithmetic
) -> Iterator[tuple[str, Any]]:
    """Each equation's name and the difference of its sides, at these values."""
    form, plant = context.form, context.plant
    speeds = {name: evaluate(row, at, arithmetic) for name, row in zip(plant.states, plant.flow, strict=True)}
    speeds |= {u: at[rate] for u, rate in rates.items()}
    Z = [along(row, at, speeds, arithmetic) for row in form.to_form]
    z = {**at, **{name: image for name, (image, _) in zip(form.states, Z, strict=True)}}
    known = len(Z) - 1 if _unmodelled(context) else len(Z)
    for name, (_, speed), row, rest in zip(form.states[:known], Z, form.A, form.b, strict=False):
        driven = (evaluate(entry, z, arithmetic) * z[other] for entry, other in zip(row, form.states, strict=True))
        yield f"{name}'", total((evaluate(rest, z, arithmetic), *driven)) - speed
    for k, (measured, output) in enumerate(zip(plant.output, form.output, strict=True), 1):
        yield f"output {k}", evaluate(output, z, arithmetic) - evaluate(measured, at, arithmetic)
    for name, inverse in zip(plant.states, form.from_form, strict=True):
        yield name, evaluate(inverse, z, arithmetic) - at[name]
