"""The constant gain of a high-gain observer, chain by chain: from poles, or as given.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)

Poles make K_j = p_j/(a_1..a_j), p the coefficients of their polynomial: the linear error core has theta times them,
whatever the parameters. A gain K as given serves an A(u) and C(u) as well: A - K C is Hurwitz at the ends of the ranges
of all a_j, by exact test; that one quadratic function decays for every u is what `common_norm` proves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.algebra.hurwitz import demand_hurwitz
from hgogen.chains.gains import coefficients
from hgogen.chains.injection import companion
from hgogen.chains.integrators import Integrators, demand_divisor, no_chain
from hgogen.form import Form
from hgogen.graph import to_casadi
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.inclusion import Inclusion, on_companion, with_gains
from hgogen.intervals.digits import same
from hgogen.program import sym
from hgogen.reading.given import BadGain, reals
from hgogen.sentence import Reason
from hgogen.structure.polytope import Corner, chains, corners


@dataclass(frozen=True, eq=False)
class ConstantGain:
    """The gain `K` (n), of parameters, for chains of the `sizes`.

    `driven` says whether A or C depends on an input: then `vertices` (k, n, n) are A - K C at the ends of the ranges.
    `error` is what the error obeys.
    """

    K: tuple[sp.Expr, ...]
    sizes: tuple[int, ...]
    driven: bool
    vertices: np.ndarray
    error: Inclusion | Nothing

    def __str__(self) -> str:
        heads = [sum(self.sizes[:i]) for i in range(len(self.sizes))]
        numbers = {x: sp.Symbol(same(float(x))) for k in self.K for x in k.atoms(sp.Float)}
        texts = [str(k.xreplace(numbers)) for k in self.K]
        each = (", ".join(texts[head : head + size]) for head, size in zip(heads, self.sizes, strict=True))
        return ", ".join(f"({chain})" for chain in each)

    @property
    def labels(self) -> tuple[str, ...]:
        """theta K_1, theta^2 K_2, ..; chain by chain of several."""
        place = "K_({0},{1})" if len(self.sizes) > 1 else "K_{1}"
        powers = [(i, j) for i, size in enumerate(self.sizes, 1) for j in range(1, size + 1)]
        return tuple(f"theta{f'^{j}' if j > 1 else ''} {place.format(i, j)}" for i, j in powers)

    def scaled(self, form: Form) -> Any:
        """theta^j K_(i,j) (n), SX of the places of gains and parameters."""
        constants = {s: v for s, v in form.system.nominal.items() if not s.bounded}
        parameters = {s: sym("plant", s.name) for s in form.system.parameters if s.bounded}
        values: list[Any] = to_casadi([k.subs(constants) for k in self.K], parameters)
        powered: list[Any] = []
        for size in self.sizes:
            power = ca.SX(1)
            for _ in range(size):
                power = power * sym("gain", "theta")
                powered.append(power * values[len(powered)])
        return ca.vertcat(*powered)

    def onto(self, e: Any) -> Any:
        """The place derived.K (n) times the error (q) of each chain's output."""
        K = sym("derived", "K", len(self.K))
        chain = [i for i, size in enumerate(self.sizes) for _ in range(size)]
        return ca.vertcat(*(K[row] * e[i] for row, i in enumerate(chain)))


def constant_gain(observer: str, form: Form, poles: Any, gains: Any) -> ConstantGain:
    """The gain on a form in chains, from `poles` or `gains`: a sequence (n), or for several outputs one for each.

    Raises: `BadGain`, `BadPoles`, `NotHurwitz`.
    """
    if (poles is None) == (gains is None):
        raise BadGain(observer, "takes either the poles of A - K C or the gains K; give one of the two")
    each = _chains(observer, form)
    return _placed(form, each, poles) if gains is None else _from_gains(form, each, gains)


def _placed(form: Form, each: tuple[tuple[sp.Expr, ...], ...], poles: Any) -> ConstantGain:
    for names, chain in zip(form.gain_names, each, strict=True):
        for name, a in zip(names, chain, strict=True):
            if a.free_symbols & {*form.system.inputs}:
                raise BadGain(
                    f"{name} = {a}", "depends on the input, poles want it constant; give gains, or use riccati"
                )
            demand_divisor(name, a, form)
    sizes = tuple(len(chain) for chain in each if chain)
    per_chain = zip(_split("poles", poles, sizes), sizes, strict=True)
    p = [x for chain_poles, n in per_chain for x in _polynomial(chain_poles, n)]
    products = [sp.prod(chain[: j + 1]) for chain in each for j in range(len(chain))]
    K = tuple(sp.Float(x) / a for x, a in zip(p, products, strict=True))
    error = on_companion(Integrators(form, form.gains), tuple(p))
    return ConstantGain(K, sizes, False, np.empty((0, form.n, form.n)), error)


def _polynomial(poles: Any, n: int) -> np.ndarray:
    """The coefficients of the polynomial of the poles, as doubles. It is proved that these decay as well, since poles
    at the edge may not survive rounding."""
    p = coefficients(poles, n)
    demand_hurwitz("poles, rounded to doubles", companion(p), "take them further to the left")
    return p


def _from_gains(form: Form, each: tuple[tuple[sp.Expr, ...], ...], gains: Any) -> ConstantGain:
    if isinstance(gains, Nothing):
        raise BadGain("gains", f"were not found: {gains.reason}")
    sizes, K, ends = tuple(len(chain) for chain in each if chain), [], []
    for chain_gains, chain in zip(_split("gains", gains, sizes), filter(None, each), strict=True):
        k = reals("gains", chain_gains)
        if k.shape != (len(chain),) or not np.isfinite(k).all():
            raise BadGain(f"gains = {gains!r}", f"must be {' and '.join(map(str, sizes))} finite numbers")
        vertices = corners(chain, form)
        if isinstance(vertices, Reason):
            raise BadGain(f"gains = {gains!r}", f"cannot be judged: {vertices}; declare ranges, or use riccati")
        closed = [_closed(corner, k) for corner in vertices]
        fix = "take others for the ranges of the a_i, such as hg.design.constant_gain(form)"
        for matrix in closed:
            demand_hurwitz("gains", matrix, fix)
        K.extend(k.tolist())
        ends.append(np.array(closed, dtype=float))
    driven = any(a.free_symbols & {*form.system.inputs} for chain in each for a in chain)
    error = with_gains(form, [*map(Fraction, K)])
    return ConstantGain(tuple(map(sp.Float, K)), sizes, driven, _stacked(ends), error)


def _closed(corner: Corner, k: np.ndarray) -> np.ndarray:
    """A - K C in fractions."""
    (A, C), gain = corner, [Fraction(x) for x in k.tolist()]
    return np.array([[a - gain[i] * c for a, c in zip(row, C, strict=True)] for i, row in enumerate(A)], dtype=object)


def _stacked(ends: list[np.ndarray]) -> np.ndarray:
    """Each chain's matrices (k_i, n_i, n_i) along the diagonal; all eigenvalues are there, not all combinations."""
    n, most = sum(each.shape[1] for each in ends), max(map(len, ends))
    stacked = np.zeros((most, n, n))
    for each, (head, end) in zip(ends, pairwise(np.cumsum([0, *(each.shape[1] for each in ends)])), strict=True):
        stacked[:, head:end, head:end] = each[np.arange(most) % len(each)]
    return stacked


def _split(what: str, values: Any, sizes: tuple[int, ...]) -> Sequence[Any]:
    """The values for each chain. Raises: `BadGain` where they are not one sequence for each."""
    if len(sizes) == 1:
        return (values,)
    count = len(values) if isinstance(values, Sequence | np.ndarray) and not isinstance(values, str) else 0
    if count != len(sizes) or any(np.ndim(each) != 1 for each in values):
        raise BadGain(f"{what} = {values!r}", f"must be {len(sizes)} sequences, one for each output with a chain")
    return tuple(values)


def _chains(observer: str, form: Form) -> tuple[tuple[sp.Expr, ...], ...]:
    """a_(i,1), .. of each output, free of states; those of the phase coordinates are 1."""
    if len(form.output) != len(form.blocks):
        reason = f"takes a chain for each output, {form.system.name} has {len(form.output)} outputs and no chains"
        raise BadGain(observer, f"{reason}; use the form block_triangular if the plant is in it, else riccati")
    if form.kind == "uniform":
        raise BadGain(observer, "wants constant slopes, those of a uniform form vary with the state; use riccati")
    if form.jacobian is not None:
        return ((sp.S.One,) * form.n,)
    each = chains(form)
    off = [
        (i, j) for i in range(form.n) for j in range(form.n) if form.A[i, j] != 0 and (j != i + 1 or j in form.heads)
    ]
    if off or any(a == 0 for chain in each for a in chain):
        raise no_chain(observer, form)
    for names, chain in zip(form.gain_names, each, strict=True):
        for name, a in zip(names, chain, strict=True):
            if a.free_symbols & {*form.states}:
                raise BadGain(f"{name} = {a}", "depends on the state, a constant gain wants it constant; use riccati")
    return each
