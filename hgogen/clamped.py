"""Whether b is Lipschitz where an observer evaluates it: with its argument clamped to the box of z.

z = Phi(x) takes the plant's box to a part of the box of z. What is shown on that image says nothing of the rest of the
box of z, through which the estimate may pass. A clamp of each component is Lipschitz, so b is after it if it is on the
box.
"""

import math

from hgogen.box import box
from hgogen.check import Check, Verdict
from hgogen.digits import up
from hgogen.form import Form
from hgogen.slope import lipschitz_bound
from hgogen.tape import NoTape

BOXES = 500  # the bound need not be the least


def clamped(observer: str, form: Form, *, boxes: int = BOXES) -> tuple[Check, ...]:
    """`OBSERVER.lipschitz`, of a form in coordinates other than the plant's states in an order, with signs; there the
    form's own check is of the same box, and none is made. None either where b is 0.
    """
    if not any(form.b) or all(any(z in (x, -x) for x in form.system.states) for z in form.to_form):
        return ()
    verdict, reason = _found(form, boxes)
    claim = "b is Lipschitz in z on the whole box of z, to which its argument is clamped"
    return (Check(f"{observer}.lipschitz", claim, verdict, reason),)


def _found(form: Form, boxes: int) -> tuple[Verdict, str]:
    """PROVED or UNKNOWN: beyond the image of the plant's box b is not the plant's, and nothing there refutes."""
    if form.behind is not None:
        reason = (
            "b may have poles in the box of z: it is taken at Psi(z), clamped to the plant's ranges, which may jump"
        )
        return Verdict.UNKNOWN, reason
    around = box((*form.states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    try:
        found = lipschitz_bound(form.b, form.states, around, boxes=boxes)
    except NoTape as missing:
        return Verdict.UNKNOWN, f"{missing.what} may jump or be singular"
    if found.verdict is Verdict.PROVED and math.isfinite(found.high):
        return Verdict.PROVED, f"L_b <= {up(found.high)}, by outward-rounded intervals"
    return Verdict.UNKNOWN, found.reason
