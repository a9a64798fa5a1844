"""What no record tells of parameters, beside what these records do not.

    rank d(y, y', ..)/d(x, p) - rank d(y, y', ..)/dx

sums of the parameters and offsets p are told by the outputs at most, of almost every motion (`analysis/observability`).
Where the Fisher information tells fewer, another record may tell the rest: one that moves the plant more. That no
record tells a parameter is a fact where a symmetry of the whole plant moves it. A rank alone is a number at random
points, and one on a branch of a plant with kinks says nothing of a record that changes the branch, by which a threshold
is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from hgogen.algebra.rank import NothingMeasured, NowhereDefined
from hgogen.algebra.tape import NoTape
from hgogen.analysis.observability import observability
from hgogen.signal import Signal
from hgogen.system import System

Array = np.ndarray
NONE = 1e-6  # of a direction: less of it is rounding


@dataclass(frozen=True)
class Structure:
    """What outputs tell of parameters, lags and offsets."""

    rank: Annotated[int, "how many sums of them the outputs tell at most"]
    count: Annotated[int, "number of parameters, lags and offsets"]
    hidden: Annotated[tuple[str, ...], "those that are proved not to be told by themselves"]
    doubtful: Annotated[tuple[str, ...], "those of which that is not known"]
    unseen: Annotated[tuple[str, ...], "what hides them, in words"]
    repairs: Annotated[tuple[str, ...], "states and parameters, of which measuring one as well would show all"]


def structure(plant: System, free: Sequence[Signal], offset: Sequence[Signal]) -> Structure | None:
    """Of these parameters and the offsets of these outputs; None where derivatives of the outputs say nothing."""
    added = {y: Signal(f"offset_of_{y.name}", y.unit, nominal=0) for y in offset}
    shifted = tuple(h + added.get(y, 0) for y, h in zip(plant.outputs, plant.output, strict=True))
    asked = replace(plant, parameters=(*plant.parameters, *added.values()), output=shifted)
    try:
        whole = observability(asked, unknown=(*(p.name for p in free), *(o.name for o in added.values())))
    except (NothingMeasured, NowhereDefined, NoTape):
        return None
    names = {p.name: p.name for p in free} | {o.name: f"offset of {y.name}" for y, o in added.items()}
    joint = whole.joint
    if joint is None:
        return None
    proved = () if whole.asked else joint.lost
    return Structure(
        joint.rank.rank - whole.rank,
        len(names),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s in proved),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s not in proved),
        tuple(map(str, joint.symmetries)),
        tuple(s.name for s in joint.repairs if s not in added.values()),
    )


def parted(V: Array, hidden: Array) -> Array:
    """The directions V (q, k), orthonormal, turned so that as many as can be have parts of the `hidden` (q) alone."""
    if hidden.all() or not hidden.any():
        return V
    turned = V @ np.linalg.svd(V[~hidden])[2].T
    return np.where(np.abs(turned) > NONE, turned, 0.0)
