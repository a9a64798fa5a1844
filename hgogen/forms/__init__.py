"""Observability forms: each file is a case, a function from a System to a Form.

The docstring of a file gives the equations and the paper. The function returns the coordinates, the split z' = A z + b,
y = output, and a `Check` for each hypothesis: `proved` needs exact or outward-rounded arithmetic, `refuted` a witness.
The decorator `Asking` (`hgogen/form.py`) says how `hgogen check` tries the form: its place among the others, the
variants, the number of outputs, and whether it takes seconds. The proof of a check is a value with `evidence` in its
`proofs` or `disproof` (`ByForm` where the equations alone prove it), and a rule of `hgogen/recheck/rules/` verifies it.
A claim without evidence and rule is `stated` in a certificate.
"""

from typing import Any

from hgogen.form import SurveySettings, valued
from hgogen.reading.given import cached, requires_any_plant, requires_plant, requires_switches
from hgogen.registry import cases_of


def _prepared(case: Any) -> Any:
    of_plant = requires_any_plant if vars(case).get("survey_settings", SurveySettings()).discrete else requires_plant
    return of_plant(requires_switches(cached(valued(case))))


__all__, __dir__, __getattr__ = cases_of(__name__, _prepared)
