"""What each claim about an observer needs: the rules by which it is verified against the certificate's own numbers.

The claims of a bound are of continuous time, without noise, while the plant keeps to its ranges, its input and output
are known, and the estimate keeps to its outer box.
"""

import re
from collections.abc import Callable
from fractions import Fraction

from hgogen.recheck.box import NotShown
from hgogen.recheck.chain import built
from hgogen.recheck.context import Context, Shown, short
from hgogen.recheck.core import convergence as core_convergence
from hgogen.recheck.core import threshold as core_threshold
from hgogen.recheck.file import OBSERVERS, Claim, Observer
from hgogen.recheck.matrix import scalar
from hgogen.recheck.moving import attenuation, decay, definite, falls, held, rises, shrink, stays
from hgogen.recheck.moving import convergence as moving_convergence
from hgogen.recheck.sector import NAMES as LIMITED
from hgogen.recheck.sector import convergence as sector_convergence
from hgogen.recheck.sector import core as sector_core
from hgogen.recheck.sector import threshold as sector_threshold
from hgogen.recheck.theta import convergence as gain_convergence
from hgogen.recheck.theta import threshold as gain_threshold

Row = tuple[int, ...]
Rule = Callable[[Context, Claim, Row], Shown]
Keys = tuple[str, ...]
STEEP: Keys = ("box", "bound", "tree")
_SLOPED: Keys = (*STEEP, "units", "scale", "P", "peak")
_RESTS = {"theta": "{}.convergence", "hold": "{}.theta"}  # what a claim rests on in the place of the form's structure
_CORES = "filtered|filtered_injection|low_power|peaking_free"
_SECTORS = "|".join(LIMITED)
_THRESHOLDS: dict[str, Callable[[Observer, Claim], Fraction]] = {
    **dict.fromkeys(("high_gain", "switched_gain"), gain_threshold),
    **dict.fromkeys(_CORES.split("|"), core_threshold),
    **dict.fromkeys(LIMITED, sector_threshold),
}


def _theta(context: Context, claim: Claim, row: Row) -> Shown:
    """The observer's theta, or the lower one of two, is above the bound; the bound is another claim."""
    name = claim.id.partition(".")[0]
    observer = built(context, claim)
    which = "theta_low" if name == "switched_gain" else "theta"
    chosen = scalar(observer.numbers, which)
    if chosen > scalar(observer.numbers, "theta"):
        raise NotShown("theta_low is above theta")
    other = context.file.claim(f"{name}.convergence")
    bound = _THRESHOLDS[name](observer, other) if other else None
    if bound is None or not chosen > bound:
        raise NotShown(f"{which} = {short(chosen)} is not above the bound")
    return Shown(f"{which} = {short(chosen)} is above {short(bound, 1)}")


# The claim's id, and what its evidence has: each a rule for "proved". On a form in chains:
OF_CHAINS: tuple[tuple[str, Rule, Keys], ...] = (
    (r"(?:high_gain|switched_gain)\.convergence", gain_convergence, (*STEEP, "scale", "core", "ranges", "P", "peak")),
    (rf"(?:{_CORES})\.convergence", core_convergence, (*STEEP, "units", "scale", "P", "push")),
    (
        rf"(?:{_SECTORS})\.convergence",
        sector_convergence,
        (*STEEP, "units", "scale", "P", "mu", "tau", "peak", "margin"),
    ),
    (rf"(?:high_gain|switched_gain|{_CORES}|{_SECTORS})\.theta", _theta, ()),
    (r"switched_gain\.hold", held, ("least",)),
    (r"updated_gain\.cap", stays, (*STEEP, "units", "scale")),
    (r"adaptive_lmi\.convergence", moving_convergence, (*_SLOPED, "decay")),
    (r"adaptive_lmi\.attenuation", attenuation, (*_SLOPED, "G_1", "G_2", "delta_1", "share", "mu")),
)
# On any form, since they are about the observer's numbers alone:
OF_NUMBERS: tuple[tuple[str, Rule, Keys], ...] = (
    (rf"(?:{_SECTORS})\.core", sector_core, ("units", "P", "mu", "tau")),
    (r"updated_gain\.p_1", falls, ("P", "b")),
    (r"updated_gain\.p_3", rises, ("P", "b", "peak")),
    (r"adaptive_lmi\.definite", definite, ("P",)),
    (r"adaptive_lmi\.shrink", shrink, ("P",)),
    (r"adaptive_lmi\.decay", decay, ("P",)),
)


def rests(id: str, kind: str) -> tuple[str, ...]:
    """The ids of the claims that a claim about an observer rests on."""
    name, _, what = id.partition(".")
    if name not in OBSERVERS or any(re.fullmatch(pattern, id) for pattern, *_ in OF_NUMBERS):
        return ()
    if what in _RESTS:
        return (_RESTS[what].format(name),)
    return () if kind == "phase" else (f"{kind}.structure",)  # of a phase form the rules show it themselves
