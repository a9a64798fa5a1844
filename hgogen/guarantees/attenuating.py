"""The L2 gain under a high gain gamma that moves, by one V for all of its course.

    e_i = units_i (w_i - what_i)/gamma^i,   e' = gamma (N - r D) e + T^-1 (dc/dw) T e + (gamma^-i G_1 - K G_2) v,
    r = gamma'/gamma^2 >= -sigma,   D = diag(1, .., n)

Where D P + P D >= 0, a larger r takes from V' what a smaller leaves. At r = -sigma, V' + |w - what|^2 - mu^2 |v|^2 is
for each e and v a sum of what is convex in gamma, linear in the gamma^-i, and linear in the slopes of c, whose ranges
shrink as gamma grows: it is negative where it is at both ends of gamma, and of each gamma^-i by itself, with the slopes
at the lowest gamma.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np

from hgogen.algebra.definite import Matrix, number
from hgogen.guarantees.inclusion import Inclusion
from hgogen.guarantees.lmi import NoSolver
from hgogen.guarantees.quadratic import Array, floats, identity, inverse_root, rational
from hgogen.guarantees.questions import Driven, L2Bound, l2_bound


@dataclass(frozen=True, eq=False)
class MovingGain:
    """A gamma in [`low`, `high`] that falls at most like -`sigma` gamma^2, of an observer whose error at a constant one
    obeys `error`; `plant` (n, m) and `measurement` (m): by what a disturbance v enters w' and y."""

    error: Inclusion
    low: Fraction
    high: Fraction
    sigma: Fraction
    plant: Matrix
    measurement: tuple[Fraction, ...]

    def attenuation(self, P: Matrix) -> L2Bound | None:
        """A small bound of the gain from v to w - what; `P`: what V may be near to. None where none is proved, or there
        is no solver."""
        try:
            return l2_bound([*self._systems()], inverse_root(floats(rational(P))), self._powers)
        except NoSolver:
            return None

    @property
    def _powers(self) -> Array:
        """D."""
        return np.asarray(identity(len(self.plant)) * rational([p + 1 for p in self.error.layout.power]))

    def _systems(self) -> Iterator[Driven]:
        """Those at the ends of gamma and of each gamma^-i that enters."""
        e, units, D, one = self.error.at(self.low), rational(self.error.units), self._powers, identity(len(self.plant))
        falling = e.core * (1 / number(self.low)) + D * number(self.sigma)
        noise = e.driven_by(rational([self.measurement]) / number(self.low))
        entering = [any(row) for row in self.plant]
        ends = [(self.low**-p, self.high**-p) if enters else (self.low**-p,) for p, enters in enumerate(entering, 1)]
        for gamma, powers in product((self.low, self.high), product(*ends)):
            M = falling * number(gamma) + (e.M - e.core)
            pushed = rational(self.plant) * (units * rational(powers))[:, None]
            counted = one * (rational([gamma**p for p in range(1, len(ends) + 1)]) / units)
            yield Driven(replace(noise, M=M, B=noise.B - pushed), counted)
