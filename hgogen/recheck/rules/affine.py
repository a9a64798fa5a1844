"""A form that is affine in the states: A and b read only states that an output shows alone.

z' = A(s, u) z + b(s, u),   y = C(u) z + d(u),   s the states that outputs show alone
"""

from fractions import Fraction

from ..box import NotShown
from ..context import Context, Shown, only, value_of
from ..file import Claim
from ..rule import Needed, Rule
from ..structure import ranges_kept


def _structure(context: Context, claim: Claim) -> Shown:
    """y = d + sum c_k z_k with d = y(0), c_k = y(z_k = 1) - y(0) for every z, so that both are of no state; A, b read
    states that an output shows alone, with a number for c_k."""
    _ = context.equations
    z, measured = context.z, list[str]()
    zero, one = context.algebra.number(Fraction(0)), context.algebra.number(Fraction(1))
    rest = {**context.letters, **dict.fromkeys(z, zero)}
    for j, output in enumerate(context.form.output, 1):
        d = value_of(output, rest, context.algebra)
        slopes = {name: value_of(output, {**rest, name: one}, context.algebra) - d for name in z}
        line = sum((slopes[name] * context.letters[name] for name in z), start=d)
        if not context.algebra.is_zero(context.value(output) - line):
            raise NotShown(f"output {j} is not affine in the states")
        seen = [name for name in z if not context.algebra.is_zero(slopes[name])]
        measured += seen if len(seen) == 1 and slopes[seen[0]].number is not None else []
    for i, (entries, rest_) in enumerate(zip(context.form.A, context.form.b, strict=True), 1):
        for row in (*entries, rest_):
            only(row.names & set(z), measured, f"row {i} of A or b")
    ranges_kept(context)
    return Shown(f"A and b read {', '.join(measured) or 'no state'}, and the form's equations are the plant's")


NEEDED = {"state_affine": Needed("state_affine.structure", lambda form: ("state_affine.lipschitz",))}
RULES = (Rule((), ("structure",), _structure, kinds=("state_affine",)),)
