"""How far an error goes that begins in a box, while a step contracts.

    |e+|_P < |e|_P,   |e(0)|_P <= 1 at every corner of the box:   |c e| <= sqrt(c P^-1 c') for ever

A norm is convex, so that its corners speak for the whole box, one of each two that are opposite. P is sought for the
least of that, or of the largest over several c.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hgogen.algebra.definite import fraction, root
from hgogen.guarantees.contracting import Steps
from hgogen.guarantees.quadratic import Array, Quadratic, Seen, Weights, confirmed, even, extent, floats
from hgogen.guarantees.semidefinite import Solution, holding, settled, shortest

_WHAT = "a bound of the errors from a start"
_NOTHING = Fraction(0)


@dataclass(frozen=True)
class Confined:
    """A proof by the `weights` that an error from the box stays within the `bounds` of |c e|, each by the place of its
    c."""

    weights: Weights
    bounds: Mapping[int, Fraction]


def confined(steps: Steps, h: Fraction, corners: Array, rows: Mapping[int, Array]) -> Confined | None:
    """A proof that makes the largest |c e| small, each c (N) of the `rows` in the unit in which it counts, from the
    `corners` (k, N) of a box, one of each two that are opposite; of FLINT's rationals. None where none is found.

    Raises: `NoSolver`.
    """
    form, W = steps.at(h).falls(_NOTHING), steps.coordinates
    if W is None:
        return None
    asked = form.floats, floats(corners), floats(np.array(list(rows.values())))
    exactly = confirmed((form,), lambda margin: settled(lambda W: _sought(*asked, W, margin), W))
    return Confined(Weights.of(*exactly), reached(exactly[0], corners, rows)) if exactly else None


def reached(P: Array, corners: Array, rows: Mapping[int, Array]) -> dict[int, Fraction]:
    """How far |c e| goes at most: the root of c P^-1 c' times the largest |e(0)|_P^2."""
    begins = fraction(max(corner @ P @ corner for corner in corners))
    return {place: root(extent(P, c) * begins) for place, c in rows.items()}


def _sought(of: Quadratic, corners: Array, rows: Array, W: Array, margin: float) -> Solution | None:
    """P and S in floats with |e|_P <= 1 at the corners and a small largest c P^-1 c', sought in coordinates x, e = W x,
    with corners near 1."""
    begins = corners @ np.linalg.inv(W).T
    far = float(np.linalg.norm(begins, axis=1).max())
    return shortest(Seen((of,), W, even(of, W)), rows @ W, holding(of, begins / far), margin, 1 / far, _WHAT)
