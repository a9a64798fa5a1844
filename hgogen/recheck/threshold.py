"""That an observer's theta is above the bound of its claim of convergence."""

from collections.abc import Callable
from fractions import Fraction

from .box import NotShown
from .chain import built
from .context import Context, Shown, is_above, short
from .file import Claim, Observer
from .matrix import scalar
from .rule import Verify


def above(threshold: Callable[[Observer, Claim], Fraction], which: str = "theta") -> Verify:
    """The rule that the observer's theta, or the lower one of two, is above the bound, which is another claim's."""

    def shown(context: Context, claim: Claim) -> Shown:
        observer = built(context, claim)
        chosen = scalar(observer.numbers, which)
        if chosen > scalar(observer.numbers, "theta"):
            raise NotShown("theta_low is above theta")
        convergence = context.file.claim(f"{claim.maker}.convergence")
        bound = threshold(observer, convergence) if convergence else None
        if bound is None or not chosen > bound:
            raise NotShown(f"{which} = {short(chosen)} is not above the bound")
        return Shown(f"{which} = {is_above(chosen, bound)}")

    return shown
