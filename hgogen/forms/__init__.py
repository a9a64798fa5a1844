"""Observability forms: each file is a case, a function from a System to a Form.

Its docstring gives the equations and the paper. It returns the coordinates, the split z' = A z + b, y = output, and a
`Check` for each hypothesis: `proved` needs exact or outward-rounded arithmetic, `refuted` a witness. `Asking`
(`hgogen/form.py`) above it says how `hgogen check` asks it: its place among the others, the variants, how many outputs
it is for, whether it takes seconds. What proves or refutes a check is a value with `evidence`, in its `proofs` or
`disproof` (`ByForm` where the equations alone show it), and a rule of `hgogen/recheck/rules/` verifies that; a claim
without both is `stated` in a certificate.
"""

from hgogen.form import valued
from hgogen.reading.given import cached, requires_plant, requires_switches
from hgogen.registry import cases_of

__all__, __dir__, __getattr__ = cases_of(__name__, lambda case: requires_plant(requires_switches(cached(valued(case)))))
