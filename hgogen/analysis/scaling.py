"""How a high gain theta enters the noise of a Riccati observer, for one output or several.

    Q_theta = theta^(1+g) Delta^-1 Q Delta^-1,   R_theta = theta^(g-1) delta R delta

    both     g = 0   Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4): theta scales Q and R
    process  g = 1   Busvelle's slides, the modified extended Kalman filter: R is not scaled

With g = 1, P is theta times the P of g = 0 and the gains P C' R_theta^-1 are the same, as long as theta is constant;
while theta moves they are two observers. Chains of n_1, .., n_p states, n* = max n_i, by their alignment:

    one, or top   Delta_i = diag(1, .., theta^-(n_i - 1)),                     delta = 1
    end           Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)),      delta_i = theta^(n* - n_i)

Source of the ends: Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5.
"""

import operator
from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np

from hgogen.analysis.spare import shown
from hgogen.form import Form
from hgogen.graph import Graph

Scaled = Literal["both", "process"]
SCALED: dict[str, int] = {"both": 0, "process": 1}
ALIGNED = ("top", "end")  # alignments for which a high gain is defined


@dataclass(frozen=True)
class Scaling:
    """The powers of theta by which a form is scaled: Delta^-1 = diag(theta^states) of its `states` (n), and delta =
    diag(theta^outputs) of its `outputs` (p); g is the `gauge`."""

    states: tuple[int, ...]
    outputs: tuple[int, ...]
    gauge: int = 0

    def spread(self, theta: Graph) -> list[Graph]:
        """The diagonal of Delta^-1; of a number, or an SX scalar."""
        return [power(theta, exponent) for exponent in self.states]

    def process(self, theta: Graph) -> Graph:
        """The factor theta^(1+g) of Q_theta."""
        return power(theta, 1 + self.gauge)

    def variance(self, R: Graph, theta: Graph, output: int, period: float = 1.0) -> Graph:
        """The variance R_theta/period of an output with the variance R at theta = 1."""
        exponent = self._exponents[output]
        if exponent < 0:
            return R / (power(theta, -exponent) * period)
        return (R if exponent == 0 else R * power(theta, exponent)) * (1 / period)

    def weight(self, R: Graph, theta: Graph, output: int) -> Graph:
        """The weight 1/R_theta of an output."""
        exponent = self._exponents[output]
        return power(theta, -exponent) / R if exponent < 0 else 1 / (R * power(theta, exponent))

    def variances(self, R: np.ndarray, theta: float | np.ndarray) -> np.ndarray:
        """The diagonal R_theta (p) as numbers, or (d, p) of several theta (d)."""
        return np.stack(np.broadcast_arrays(*(self.variance(r, theta, j) for j, r in enumerate(R))), axis=-1)

    @property
    def _exponents(self) -> tuple[int, ...]:
        """R_theta = diag(theta^_exponents) R."""
        return tuple(2 * exponent + self.gauge - 1 for exponent in self.outputs)


def scaling(form: Form, scaled: Scaled = "both") -> Scaling:
    """The scaling of a form; of several outputs without aligned chains, that of theta = 1."""
    longest, late = max(form.blocks), [0] * len(form.output)
    if form.alignment == "end":
        late = [longest - size for size in form.blocks]
        for chain in shown(form):
            for each in chain:
                late[each.output] = late[chain[0].output]
    return Scaling(exponents(form), tuple(late), SCALED[scaled])


def exponents(form: Form) -> tuple[int, ...]:
    """The power of a high gain with which each state may overshoot: those of Delta^-1; of states in no aligned chains,
    their levels."""
    if form.alignment not in ALIGNED:
        return form.levels
    longest = max(form.blocks)
    return tuple(
        level + (longest - size if form.alignment == "end" else 0) for size in form.blocks for level in range(size)
    )


_NOISE = {"both": ("theta Delta^-1 Q Delta^-1", "{}/theta"), "process": ("theta^2 Delta^-1 Q Delta^-1", "{}")}
_DELTA = {
    "top": "Delta_i = diag(1, 1/theta, ..) for each output",
    "end": "Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)), delta_i = theta^(n* - n_i), n* the longest chain",
}


def noise_equation(form: Form, scaled: Scaled) -> str:
    """Q_theta, R_theta and Delta, for the banner."""
    process, output = _NOISE[scaled]
    several = len(form.output) > 1 and form.alignment in ALIGNED
    powers = "1, 1/theta, .."  # in full where the states do not stand in the order of their levels
    if form.levels != tuple(range(form.n)):
        powers = ", ".join(f"theta^-{level}" if level > 1 else "1/theta" if level else "1" for level in form.levels)
    delta = _DELTA[form.alignment] if several else f"Delta = diag({powers})"
    R = "delta R delta" if several and form.alignment == "end" else "R"
    return f"P = S^-1, Q_theta = {process}, R_theta = {output.format(R)}, {delta}"


def power(theta: Graph, exponent: int) -> Graph:
    """theta^exponent for exponent >= 0 as products, which cost less than pow and are exact at theta = 1."""
    return reduce(operator.mul, [theta] * exponent) if exponent else 1.0
