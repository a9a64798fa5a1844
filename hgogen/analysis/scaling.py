"""Several outputs of a form: the powers of theta that scale their noise, and weighted means of redundant outputs.

A high gain theta scales the noise of a Riccati observer with one output or several.

    Q_theta = theta^(1+g) Delta^-1 Q Delta^-1,   R_theta = theta^(g-1) delta R delta

    both     g = 0   Boizot, Busvelle, Gauthier, Automatica 46 (2010), (4): theta scales Q and R
    process  g = 1   Busvelle's slides, the modified extended Kalman filter: R is not scaled

With g = 1, P is theta times the P of g = 0 and the gains P C' R_theta^-1 are the same, as long as theta is constant.
With a varying theta they are two observers. Chains of n_1, .., n_p states, n* = max n_i, by their alignment:

    one, or top   Delta_i = diag(1, .., theta^-(n_i - 1)),                     delta = 1
    end           Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)),      delta_i = theta^(n* - n_i)

Source of the ends: Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5.

Redundant outputs measure the first state of a chain as well. The observer corrects by the weighted mean of their
errors:

    y_j = r_j y_i + c(u),  y_i the output that the chain begins with:   e = sum w_j v_j e_j/r_j / sum w_j v_j

e_j = y_j - h_j(z, u) is an output's error, v_j is 1 where its sample can be used, else 0. For any weights w_j > 0 and
any samples, e is the error of y_i for a plant without noise, so that a proof about the injection of y_i holds for e. An
output that measures anything else has weight 0.
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

from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.reading.given import BadGain, in_order, positive
from hgogen.rigor.box import exact

Scaled = Literal["both", "process"]
SCALED: dict[str, int] = {"both": 0, "process": 1}
ALIGNED = ("top", "end")  # alignments for which a high gain is defined


@dataclass(frozen=True)
class Scaling:
    """The powers of theta by which a high-gain observer scales its noise:

        Q_theta = theta^(1+g) Delta^-1 Q Delta^-1,   R_theta = theta^(g-1) delta R delta

    Delta^-1 = diag(theta^`states`) (n), delta = diag(theta^`outputs`) (p), g = `gauge`.
    """

    states: tuple[int, ...]
    outputs: tuple[int, ...]
    gauge: int = 0

    def spread(self, theta: Graph) -> list[Graph]:
        """Return the diagonal (n) of Delta^-1 = diag(theta^states), for a number or an SX scalar theta."""
        return [power(theta, exponent) for exponent in self.states]

    def process(self, theta: Graph) -> Graph:
        """Return theta^(1+g), g the `gauge`: the scalar factor of Q_theta."""
        return power(theta, 1 + self.gauge)

    def variance(self, R: Graph, theta: Graph, output: int, period: float = 1.0) -> Graph:
        """Return the variance R_theta/period of an output (index `output`), from its variance R at theta = 1."""
        exponent = self._exponents[output]
        if exponent < 0:
            return R / (power(theta, -exponent) * period)
        return (R if exponent == 0 else R * power(theta, exponent)) * (1 / period)

    def weight(self, R: Graph, theta: Graph, output: int) -> Graph:
        """Return the weight 1/R_theta of an output (index `output`), from its variance R at theta = 1."""
        exponent = self._exponents[output]
        return power(theta, -exponent) / R if exponent < 0 else 1 / (R * power(theta, exponent))

    def variances(self, R: np.ndarray, theta: float | np.ndarray) -> np.ndarray:
        """Return the diagonal (p) of R_theta from R (p) as numbers, or (d, p) for several theta (d)."""
        return np.stack(np.broadcast_arrays(*(self.variance(r, theta, j) for j, r in enumerate(R))), axis=-1)

    @property
    def _exponents(self) -> tuple[int, ...]:
        """The exponents (p) of R_theta = diag(theta^exponent) R."""
        return tuple(2 * exponent + self.gauge - 1 for exponent in self.outputs)


def scaling(form: Form, scaled: Scaled = "both") -> Scaling:
    """Return the powers of theta by which the noise of a form is scaled; for several outputs without aligned chains
    they are valid at theta = 1 only. `scaled`: "both" scales Q and R, "process" scales Q alone."""
    longest, output_powers = max(form.blocks), [0] * len(form.output)
    if form.alignment == "end":
        output_powers = [longest - size for size in form.blocks]
        for chain in redundant_outputs(form):
            for each in chain:
                output_powers[each.output] = output_powers[chain[0].output]
    return Scaling(exponents(form), tuple(output_powers), SCALED[scaled])


def exponents(form: Form) -> tuple[int, ...]:
    """Return the powers k_i (n) of theta with which the error of z_i overshoots: the exponents of Delta^-1 for one
    output or aligned chains, else the levels of the states in their chains."""
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
    """Return the equations of Q_theta, R_theta and Delta as text for the banner of the generated code."""
    process, output = _NOISE[scaled]
    several = len(form.output) > 1 and form.alignment in ALIGNED
    powers = "1, 1/theta, .."  # in full where the states are not in the order of their levels
    if form.levels != tuple(range(form.n)):
        powers = ", ".join(f"theta^-{level}" if level > 1 else "1/theta" if level else "1" for level in form.levels)
    delta = _DELTA[form.alignment] if several else f"Delta = diag({powers})"
    R = "delta R delta" if several and form.alignment == "end" else "R"
    return f"P = S^-1, Q_theta = {process}, R_theta = {output.format(R)}, {delta}"


def power(theta: Graph, exponent: int) -> Graph:
    """Return theta^exponent, exponent >= 0, as a product, which costs less than pow and is exact at theta = 1."""
    return reduce(operator.mul, [theta] * exponent) if exponent else 1.0


# ---------------------------------------------------------------- spare


@dataclass(frozen=True)
class RedundantOutput:
    """An output y_j, j = `output`, that measures the first state of a chain as well: it is `ratio` times the chain's
    own output plus a known offset."""

    output: int
    ratio: sp.Rational


def redundant_outputs(form: Form) -> tuple[tuple[RedundantOutput, ...], ...]:
    """Return, for each chain, the outputs that measure its first state, beginning with the chain's own output."""
    spare = [j for j, size in enumerate(form.blocks) if not size]

    def of_chain(i: int, z: sp.Symbol) -> tuple[RedundantOutput, ...]:
        ratios = ((j, _ratio(form, j, i, z)) for j in spare)
        return RedundantOutput(i, sp.S.One), *(RedundantOutput(j, ratio) for j, ratio in ratios if ratio)

    return tuple(of_chain(i, form.states[form.heads[i]]) for i in form.leads)


def heads(form: Form) -> dict[int, int]:
    """Return, by index of each output that measures the first state of a chain, the index of this state in z."""
    first = ((form.heads[chain[0].output], chain) for chain in redundant_outputs(form))
    return {each.output: head for head, chain in first for each in chain}


def sizes_of_used(form: Form, sizes: Sequence[Fraction]) -> list[Fraction]:
    """Return the `sizes` of the outputs' errors (p), with 0 in place of that of an output that no chain uses."""
    used = heads(form)
    return [size if j in used else Fraction(0) for j, size in enumerate(sizes)]


def error_shares(form: Form, weights: Sequence[float]) -> np.ndarray:
    """Return the weights (q, p) with which the errors of p outputs enter the errors of q chains, when all outputs have
    a sample: for each chain the mean over its redundant outputs with the `weights` (p)."""
    rows = np.full((len(form.leads), len(form.output)), Fraction(0), dtype=object)
    for row, chain in zip(rows, redundant_outputs(form), strict=True):
        whole = sum(Fraction(weights[each.output]) for each in chain)
        for each in chain:
            row[each.output] = Fraction(weights[each.output]) * each.ratio.q / (each.ratio.p * whole)
    return rows


def unused(form: Form) -> tuple[int, ...]:
    """Return the indices of the outputs that no chain uses: each is neither a chain's own output nor redundant to such
    an output."""
    used = heads(form)
    return tuple(j for j in range(len(form.blocks)) if j not in used)


def sharing(form: Form) -> frozenset[int]:
    """Return the indices of the outputs that measure the first state of a chain together with another output."""
    return frozenset(each.output for chain in redundant_outputs(form) if len(chain) > 1 for each in chain)


def _ratio(form: Form, j: int, i: int, z: sp.Symbol) -> sp.Rational | None:
    """Return r, not 0, if y_j depends on no state but z and y_j - r y_i does not depend on z;
    else None. A constant ratio of the partial derivatives is not enough: y_j may jump."""
    if form.output[j].free_symbols & {*form.states} != {z}:
        return None
    one, other = (exact(sp.sympify(form.output[k]).xreplace(form.system.constants)) for k in (i, j))
    ratio = sp.cancel(sp.diff(other, z) / sp.diff(one, z))
    alike = ratio.is_Rational and ratio and not sp.cancel(other - ratio * one).has(z)
    return ratio if alike else None


def output_weights(form: Form, weights: Any) -> tuple[float, ...]:
    """Return the weights (p) of the outputs in the means of redundant outputs, from a mapping by name, 1 for a missing
    name; None gives 1 for all. Raises: `BadGain`, also where no output is redundant; `BadNames`."""
    names = tuple(y.name for y in form.system.outputs)
    if weights is None:
        return (1.0,) * len(names)
    shared = sharing(form)
    if not shared:
        raise BadGain("weights", "are of outputs that show the same state, and here there are none; leave them out")
    if not isinstance(weights, Mapping):
        raise BadGain(f"weights = {weights!r}", f"must be positive numbers by name, such as {{{names[-1]!r}: 2}}")
    unshared = {
        name: "which alone shows its state, or is not used, and has no weight"
        for k, name in enumerate(names)
        if k not in shared
    }
    defaults = dict.fromkeys((name for name in names if name not in unshared), 1.0)
    values = in_order("weights", weights, defaults, default=defaults, elsewhere=unshared)
    ordered = dict(zip(defaults, values, strict=True))
    return tuple(positive(f"weight of {name}", ordered[name]) if name in ordered else 1.0 for name in names)


def chain_errors(form: Form, weights: Sequence[float], e: Graph, valid: Graph) -> Graph:
    """Return the error (q) of each chain: the weighted mean, with the `weights` (p), of the errors `e` (p) of its
    redundant outputs that are `valid` (p); 0 where none is."""
    errors = []
    for chain in redundant_outputs(form):
        if len(chain) == 1:
            errors.append(valid[chain[0].output] * e[chain[0].output])
            continue
        counted = [weights[each.output] * valid[each.output] for each in chain]
        terms = [w * (e[each.output] * each.ratio.q / each.ratio.p) for w, each in zip(counted, chain, strict=True)]
        least = min(weights[each.output] for each in chain)  # of no sample at all the sum of the weights is 0
        errors.append(sum(terms[1:], terms[0]) / ca.fmax(sum(counted[1:], counted[0]), least))
    return ca.vertcat(*errors)
