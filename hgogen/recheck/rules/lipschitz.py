"""How steep a form is in its states on the box: the Jacobian of some rows, in the spectral norm."""

from collections.abc import Callable, Mapping, Sequence

from ..chain import jacobian_bound
from ..context import Context, Shown
from ..file import Claim
from ..rule import STEEP, Rule
from ..text import Expression


def lipschitz(context: Context, claim: Claim) -> Shown:
    """|d rows/dz| <= bound, of the rows that the kind of the form has in `_ROWS`."""
    name, rows = _ROWS[context.form.kind]
    return jacobian_bound(context, claim, rows(context), name)


def _nonlinear(context: Context) -> Sequence[Expression]:
    """b, with the terms of A z whose factor reads a state."""
    return context.nonlinear


def _every(context: Context) -> Sequence[Expression]:
    """F, h."""
    return (*context.rates, *context.form.output)


_ROWS: Mapping[str, tuple[str, Callable[[Context], Sequence[Expression]]]] = {
    "triangular": ("db/dz", _nonlinear),
    "block_triangular": ("db/dz", _nonlinear),
    "state_affine": ("d(A z + b)/dz", lambda context: context.rates),
    "uniform": ("d(F, h)/dz", _every),
    "original": ("d(F, h)/dz", _every),
}
RULES = (Rule((), ("lipschitz",), lipschitz, STEEP, (*_ROWS,)),)
