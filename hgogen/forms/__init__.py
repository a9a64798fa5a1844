"""Observability forms: each file is a case, a function from a System to a Form.

Its docstring gives the equations and the paper. It returns the coordinates, the split z' = A z + b, y = output, and a
`Check` for each hypothesis: `proved` needs exact or outward-rounded arithmetic, `refuted` a witness. `Asking`
(`hgogen/form.py`) above it says how `hgogen check` asks it: its place among the others, the variants, how many outputs
it is for, whether it takes seconds. What proves or refutes a check is a value with `evidence`, in its `proofs` or
`disproof` (`ByForm` where the equations alone show it), and a rule of `hgogen/recheck/rules/` verifies that; a claim
without both is `stated` in a certificate.
"""

from typing import TYPE_CHECKING, Any

from hgogen.form import valued
from hgogen.reading.given import asks_a_plant, remembers, switches
from hgogen.registry import load

if TYPE_CHECKING:

    def __getattr__(name: str) -> Any: ...


_cases = {name: asks_a_plant(switches(remembers(valued(case)))) for name, case in load(__name__).items()}
globals().update(_cases)
__all__ = list(_cases)


def __dir__() -> list[str]:
    return __all__
