"""b limited in value: phi_s = sat(phi) of Astolfi, Jungers, Zaccarian, ECC 2018, (3) and (7).

    b_i taken as min(max(b_i, low_i), high_i),   its argument clamped to the declared box as well, or as it is

With the argument clamped, a limit that b keeps within on the box changes nothing, and what is proved of the observer
stays. In all other cases nothing is: a b that is cut is not the plant's, and one of an estimate outside of the box has
slopes that no range bounds.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hgogen.analysis.polytope import span
from hgogen.form import Form
from hgogen.reading.given import BadGain, in_order, real, reals
from hgogen.sentence import NONE, Reason, because

_ANY = (-math.inf, math.inf)
Limits = float | Mapping[str, Any] | None


def saturated(form: Form, saturate: Limits, arguments: bool) -> Form:
    """The form for an observer that limits b in value.

    Args: `saturate`: a limit of |b_i|, or a pair (low, high), by the name of the state whose rate holds b_i; one number
    where b has one row; None for no limit. `arguments`: whether the argument of b is clamped as well.

    Raises: `BadGain`, `BadNames`.
    """
    if saturate is None:
        if not arguments:
            raise BadGain("arguments = False", "leaves b without a bound; give saturate=, the limits of its value")
        return form
    if form.jacobian is not None or form.behind is not None:
        raise BadGain("saturate", "is for a form in whose coordinates b is a function of z, which this one is not")
    named: Any = saturate
    if not isinstance(saturate, Mapping):
        rows = [name for name, row in zip(form.names, form.b, strict=True) if row != 0]
        if len(rows) != 1:
            wanted = f"must be a limit by name, of {', '.join(rows) or 'a b that is not 0'}"
            raise BadGain(f"saturate = {saturate!r}", wanted)
        named = {rows[0]: saturate}
    limits = in_order("saturate", named, form.names, default=dict.fromkeys(form.names, _ANY))
    ends = tuple(map(_ends, form.names, limits, form.signs))
    loose = [name for name, row, end in zip(form.names, form.b, ends, strict=True) if row != 0 and end == _ANY]
    if loose and not arguments:
        raise BadGain("arguments = False", f"wants a limit of every row of b; give one for {', '.join(loose)}")
    return replace(form, limits=ends, free=not arguments)


def _ends(name: str, limit: Any, sign: int) -> tuple[float, float]:
    """The range of a row in the form's coordinates."""
    if limit == _ANY:
        return _ANY
    values = reals(f"saturate of {name}", limit)
    if values.shape == (2,):
        low, high = map(float, values)
    else:
        high = real(f"saturate of {name}", limit)
        low = -high
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadGain(
            f"saturate of {name} = {limit!r}", "must be a positive finite number, or a pair of which low is below high"
        )
    return (low, high) if sign > 0 else (-high, -low)


def cut(form: Form) -> Reason:
    """Why what an observer evaluates in the place of b is not shown to be b with its argument clamped, or `NONE`."""
    if not form.clamped:
        return because("without guards no argument of b is clamped, on which the proof rests")
    if form.free:
        return because("the argument of b is not clamped to the declared ranges, on which the proof rests")
    for i, (row, (low, high)) in enumerate(zip(form.b, form.limits or (), strict=False), 1):
        if (low, high) == _ANY:
            continue
        known = span(row, form)
        if not (known and known.defined and low <= known.low and known.high <= high):
            pattern = "b_{i} is not shown to keep within its limits, {low} to {high}, on the box"
            return because(pattern, i=i, low=low, high=high)
    return NONE


def described(form: Form) -> tuple[str, ...]:
    """The limits of b for the equations of an observer."""
    if not form.limits:
        return ()
    rows = ((i, end) for i, end in enumerate(form.limits, 1) if end != _ANY)
    limited = ", ".join(f"b_{i} in [{low:g}, {high:g}]" for i, (low, high) in rows)
    return (f"b is limited in value, {limited}, and its argument {'is as it is' if form.free else 'clamped'}",)
