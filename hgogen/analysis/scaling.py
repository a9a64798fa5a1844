"""Several outputs of a form: how theta scales their noise, and the weighted mean of redundant ones.

How a high gain theta enters the noise of a Riccati observer, for one output or several.

    Q_theta = theta^(1+g) Delta^-1 Q Delta^-1,   R_theta = theta^(g-1) delta R delta

    both     g = 0   Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4): theta scales Q and R
    process  g = 1   Busvelle's slides, the modified extended Kalman filter: R is not scaled

With g = 1, P is theta times the P of g = 0 and the gains P C' R_theta^-1 are the same, as long as theta is constant;
while theta moves they are two observers. Chains of n_1, .., n_p states, n* = max n_i, by their alignment:

    one, or top   Delta_i = diag(1, .., theta^-(n_i - 1)),                     delta = 1
    end           Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)),      delta_i = theta^(n* - n_i)

Source of the ends: Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5.

Outputs beside the chains of a form: which of them show the first state of a chain, and the weighted mean of these.

    y_j = r_j y_i + c(u),  y_i the output that the chain begins with:   e = sum w_j v_j e_j/r_j / sum w_j v_j

e_j = y_j - h_j(z, u) is an output's error, v_j is 1 where its sample can be used, else 0. Whatever the weights w_j > 0
and the samples that are there, e is the error of y_i for a plant without noise: what is proved of an injection of that
holds of e. An output that shows anything else does not enter.
"""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any, Literal

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.analysis.ranges import fixed
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.reading.given import BadGain, in_order, positive
from hgogen.rigor.box import exact

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


# ---------------------------------------------------------------- spare


@dataclass(frozen=True)
class Shown:
    """An output, by its number, that is the `ratio` times that of a chain, up to what is known."""

    output: int
    ratio: sp.Rational


def shown(form: Form) -> tuple[tuple[Shown, ...], ...]:
    """The outputs that show the first state of each chain, the one that it begins with first."""
    spare = [j for j, size in enumerate(form.blocks) if not size]
    chains = ((i, form.states[form.heads[i]]) for i in form.leads)
    return tuple(
        (Shown(i, sp.S.One), *(Shown(j, ratio) for j in spare if (ratio := _ratio(form, j, i, z)))) for i, z in chains
    )


def heads(form: Form) -> dict[int, int]:
    """The place of the first state of a chain, by output that shows it."""
    first = ((form.heads[chain[0].output], chain) for chain in shown(form))
    return {each.output: head for head, chain in first for each in chain}


def of_used(form: Form, sizes: Sequence[Fraction]) -> list[Fraction]:
    """Sizes (p) by output, 0 of one that enters nowhere."""
    used = heads(form)
    return [size if j in used else Fraction(0) for j, size in enumerate(sizes)]


def entering(form: Form, weights: Sequence[float]) -> np.ndarray:
    """The share of the error of each output (p) in those of the chains' outputs (q, p), where all samples are there, as
    fractions."""
    rows = np.full((len(form.leads), len(form.output)), Fraction(0), dtype=object)
    for row, chain in zip(rows, shown(form), strict=True):
        whole = sum(Fraction(weights[each.output]) for each in chain)
        for each in chain:
            row[each.output] = Fraction(weights[each.output]) * each.ratio.q / (each.ratio.p * whole)
    return rows


def unused(form: Form) -> tuple[int, ...]:
    """The outputs that no chain begins with and that show the first state of none."""
    used = heads(form)
    return tuple(j for j in range(len(form.blocks)) if j not in used)


def sharing(form: Form) -> frozenset[int]:
    """The outputs that show a state with others."""
    return frozenset(each.output for chain in shown(form) if len(chain) > 1 for each in chain)


def _ratio(form: Form, j: int, i: int, z: sp.Symbol) -> sp.Rational | None:
    """r, not 0, where y_j reads no other state and is r y_i up to what does not read z; else None. That the slopes have
    the ratio r is not enough: y_j may jump."""
    if form.output[j].free_symbols & {*form.states} != {z}:
        return None
    known = dict(fixed(form))
    one, other = (exact(sp.sympify(form.output[k]).xreplace(known)) for k in (i, j))
    ratio = sp.cancel(sp.diff(other, z) / sp.diff(one, z))
    alike = ratio.is_Rational and ratio and not sp.cancel(other - ratio * one).has(z)
    return ratio if alike else None


def weighted(form: Form, weights: Any) -> tuple[float, ...]:
    """The weights (p), by the names of the outputs, 1 for one that is not named; without any all are alike.

    Raises: `BadGain`, also where no output is in a mean; `BadNames`.
    """
    names = tuple(y.name for y in form.system.outputs)
    if weights is None:
        return (1.0,) * len(names)
    shared = sharing(form)
    if not shared:
        raise BadGain("weights", "are of outputs that show the same state, and here there are none; leave them out")
    if not isinstance(weights, Mapping):
        raise BadGain(f"weights = {weights!r}", f"must be positive numbers by name, such as {{{names[-1]!r}: 2}}")
    alone = {
        name: "which alone shows its state, or is not used, and has no weight"
        for k, name in enumerate(names)
        if k not in shared
    }
    rest = dict.fromkeys((name for name in names if name not in alone), 1.0)
    ordered = dict(zip(rest, in_order("weights", weights, rest, default=rest, elsewhere=alone), strict=True))
    return tuple(positive(f"weight of {name}", ordered[name]) if name in ordered else 1.0 for name in names)


def mean(form: Form, weights: Sequence[float], e: Graph, valid: Graph) -> Graph:
    """The error of each chain's output (q): the mean of those (p) that show it, of samples that can be used; else 0."""
    errors = []
    for chain in shown(form):
        if len(chain) == 1:
            errors.append(valid[chain[0].output] * e[chain[0].output])
            continue
        counted = [weights[each.output] * valid[each.output] for each in chain]
        terms = [w * (e[each.output] * each.ratio.q / each.ratio.p) for w, each in zip(counted, chain, strict=True)]
        least = min(weights[each.output] for each in chain)  # of no sample at all the sum of the weights is 0
        errors.append(sum(terms[1:], terms[0]) / ca.fmax(sum(counted[1:], counted[0]), least))
    return ca.vertcat(*errors)
