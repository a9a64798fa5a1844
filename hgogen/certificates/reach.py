"""How far the step length and theta of a step may go for its error to contract still.

Looked for in floats by halving, from the step's own values where it contracts there, else from the first that are
found, and proved in rationals where the search ends, at a short number on the near side.

A proof at (dt, theta) serves every (dt', theta') with theta' >= theta and dt' theta' = dt theta: dt M is the same but
for the slopes of b, which dt'/dt theta'^-degree/theta^-degree makes smaller, and whose ranges hold 0. So what is proved
at theta of every step length up to dt is proved of every theta' from theta to theta dt/dt' at each shorter dt'.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction

from hgogen.guarantees.all_shorter import Piece, all_shorter
from hgogen.guarantees.contracting import Steps, farthest
from hgogen.intervals.digits import down, up

_ROOM = 2**10  # how much longer a dt is looked for where nothing is refused
_SHARES = 8  # that are tried, each half of the one before
_HALVINGS, _DOUBLINGS = 10, 6  # of dt, of theta, where there is no proof at the step's own
_BACK = tuple(Fraction(k, 100) for k in (0, 1, 5, 20))  # of the way to the start: where a proof is tried


@dataclass(frozen=True)
class Reach:
    """`longest`: the largest dt at the step's theta, and `pieces`: proofs of all dt up to it; `least`: the smallest
    theta at the step's dt, and `tuned`: proofs at it of all dt that serve each theta up to the step's own. None, or no
    pieces, where nothing was proved."""

    longest: Fraction | None = None
    pieces: tuple[Piece, ...] = ()
    least: Fraction | None = None
    tuned: tuple[Piece, ...] = ()


NOWHERE = Reach()


def reach(steps: Steps, h: Fraction, limit: float) -> Reach:
    """The reach of a step of length h, which is refused above `limit`.

    Raises: `NoSolver`.
    """
    theta, far = steps.theta, h * _ROOM if limit == float("inf") else Fraction(limit)

    def at(level: Fraction) -> Steps:
        return replace(steps, theta=level)

    def by_theta(level: Fraction) -> bool:
        return at(level).may_contract(h)

    if steps.may_contract(h):
        longest = _proved(steps.certain, h, farthest(steps.may_contract, h, far))
        least = _proved(lambda level: at(level).certain(h), theta, farthest(by_theta, theta, min(theta, Fraction(1))))
    else:
        short = _first(steps.may_contract, (h / 2**k for k in range(1, _HALVINGS + 1)))
        longest = short and _proved(steps.certain, short, farthest(steps.may_contract, short, h))
        high = _first(by_theta, (theta * 2**k for k in range(1, _DOUBLINGS + 1)))
        least = high and _proved(lambda level: at(level).certain(h), high, farthest(by_theta, high, theta))
    pieces = all_shorter(steps, longest) if longest else ()
    tuned = all_shorter(at(least), h * theta / least) if least and least < theta else ()
    return Reach(longest, pieces, least, tuned)


def enough(steps: Steps, h: Fraction) -> Fraction | None:
    """Of a step that is not proved, the largest share of the ranges of its slopes with which it is; None of none.

    Raises: `NoSolver`.
    """

    def of(share: Fraction) -> Steps:
        return replace(steps, error=steps.error.narrowed(share))

    first = _first(lambda share: of(share).may_contract(h), (Fraction(1, 2**k) for k in range(1, _SHARES)))
    if first is None:
        return None
    end = farthest(lambda share: of(share).may_contract(h), first, Fraction(1))
    return _proved(lambda share: of(share).certain(h), first, end)


def _first(holds: Callable[[Fraction], bool], values: Iterable[Fraction]) -> Fraction | None:
    return next(filter(holds, values), None)


def _proved(certain: Callable[[Fraction], object], start: Fraction, end: Fraction) -> Fraction | None:
    """The value nearest to the end that is proved, a short number between it and the start."""
    towards = up if start > end else down
    for share in _BACK:
        value = Fraction(towards(end + (start - end) * share, 3))
        if certain(value):
            return value
    return None
