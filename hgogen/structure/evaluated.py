"""Whether the derivatives that an observer evaluates at its estimate are finite on the declared ranges."""

from dataclasses import replace
from functools import lru_cache

from hgogen.analysis.undefined import FIX, MAKER, undefined_slopes
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.sentence import Sentence, because
from hgogen.structure.dynamics import Dynamics
from hgogen.structure.jacobians import not_finite


@lru_cache(maxsize=32)
def evaluated(form: Form) -> tuple[Check, ...]:
    """Return the checks `singular.NAME` of rows whose derivatives by the states may not be finite on the box, for an
    observer that evaluates them at the estimate; rows whose values may not be are among the form's own checks.

    Derivatives are those of the form's equations, as they are written, and, at points, of the program's.
    """
    sampled = {}
    for row, point in not_finite(Dynamics(replace(form, held=()))).items():
        id, reason = ClaimId(MAKER, row), because("one of {row} is not", row=row)
        pattern = "the program's derivatives of {row} by the states are finite on the declared ranges"
        claim = Sentence.of(pattern, row=row)
        sampled[id] = Check(id, claim, Verdict.REFUTED, reason, point, FIX, "it is taken for 0 there")
    known = undefined_slopes(form.system)
    settled = {check.id for check in (*form.checks, *known) if check.verdict is Verdict.REFUTED}
    new = {id: check for id, check in sampled.items() if id not in settled}
    return (*(check for check in known if check.id not in new), *new.values())
