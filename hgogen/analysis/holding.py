"""What a step does where a row of its form has no finite value, and its user has accepted that.

A row is the rate of a state, z_i' = A_i z + b_i, or an output y_j = h_j. It is taken where its value at sat(z) is in
its range: a rate in the declared rates of its state, an output within its declared range and once its width beyond;
without these, where it is finite and at most 1e15. Its derivatives are taken where each of them is, too.

    rate       b_i is the last one that was taken at the begin of a call: at each stage of a method at which it is not
               taken now. Its derivatives are 0 there.
    output     a sample is not used where the output is not taken; at a stage at which it is not, it is the last one
               that was. Its derivatives are 0 there.

The last values are fields of the state, `last_NAME`. No number is added to a denominator, nor to an argument.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import casadi as ca
import sympy as sp

from hgogen.analysis.undefined import MAKER, gaps
from hgogen.check import ClaimId
from hgogen.form import Form
from hgogen.graph import Graph
from hgogen.program import sym
from hgogen.signal import Signal

Range = tuple[float, float]


@dataclass(frozen=True)
class Holding:
    """The held rows of a form; `largest`: what is beyond it is not taken, where no range says it."""

    form: Form
    largest: float

    @cached_property
    def rates(self) -> dict[int, Signal]:
        """The rows z_i' that are held, each with the signal of its name."""
        states = {s.name: s for s in self.form.system.states}
        names = [name if name in states else z.name for name, z in zip(self.form.names, self.form.states, strict=True)]
        mixed = not set(names) <= states.keys() and not states.keys().isdisjoint(self.form.held)
        rows = {i: states.get(name, z) for i, (name, z) in enumerate(zip(names, self.form.states, strict=True))}
        return {i: s for i, s in rows.items() if mixed or s.name in self.form.held}

    @cached_property
    def outputs(self) -> dict[int, Signal]:
        """The outputs y_j that are held."""
        return {j: y for j, y in enumerate(self.form.system.outputs) if y.name in self.form.held}

    def rate(self, i: int, b: Graph, whole: Graph) -> Graph:
        """b_i, or its last one where the `whole` rate A_i sat(z) + b_i is not taken."""
        return ca.if_else(self.takes_rate(i, whole), b, last(self.rates[i])) if i in self.rates else b

    def coasting(self, A: Graph) -> Graph:
        """A, sparse (n, n), whose gain of a chain in a row that is held is 0 where it is not taken."""
        coasts = ca.SX(A)
        for i, k in _links(self.form):
            if i in self.rates and self.form.A[i, k].free_symbols:
                coasts[i, k] = ca.if_else(within(A[i, k], (-self.largest, self.largest)), A[i, k], 0)
        return coasts

    def output(self, j: int, h: Graph, whole: Graph) -> Graph:
        """h_j, or its last one where h_j(sat(z)), the `whole`, is not taken."""
        return ca.if_else(self.takes_output(j, whole), h, last(self.outputs[j])) if j in self.outputs else h

    def takes_rate(self, i: int, whole: Graph) -> Graph:
        """Whether the rate i is taken."""
        signal = self.rates[i]
        return within(self.form.signs[i] * whole, signal.rates[0] if signal.rates else (-self.largest, self.largest))

    def takes_output(self, j: int, whole: Graph) -> Graph:
        """Whether the output j is taken."""
        low, high = self.outputs[j].interval
        width = high - low
        ends = (low - width, high + width) if self.outputs[j].bounded else (-self.largest, self.largest)
        return within(whole, ends)

    def takes_slopes(self, row: Graph) -> Graph:
        """Whether each derivative of a row (1, n) is taken."""
        return reduce(ca.logic_and, (within(slope, (-self.largest, self.largest)) for slope in ca.horzsplit(row)))


def within(value: Graph, ends: Range) -> Graph:
    """Whether a value is a number in its range; SX."""
    return ca.logic_and(value >= ends[0], value <= ends[1])


def last(signal: Signal) -> Graph:
    """The place of the last value of a row."""
    return sym("state", f"last_{signal.name}")


def holding(form: Form, accepted: Iterable[str]) -> Form:
    """Return the form, of which the rows whose checks `singular.NAME` are `accepted` are held.

    Coefficients of A in a held row that may have no finite value go into its b; the gains of a chain stay, of which the
    form has checks of their own, and are 0 there (`Holding.coasting`).
    """
    accepted = {id for id in accepted if isinstance(id, str)}
    rows = dict.fromkeys((*form.system.states, *form.system.outputs, *form.states))
    names = tuple(s.name for s in rows if ClaimId(MAKER, s.name) in accepted)
    if not names:
        return form
    held = replace(form, held=names)
    A, b, links = form.A.as_mutable(), list(form.b), _links(form)
    in_z = replace(form.system, states=form.states, flow=form.flow, output=form.output, origin=None)
    for i in Holding(held, 1.0).rates:
        for k in range(form.n):
            if (i, k) not in links and A[i, k] != 0 and gaps([A[i, k]], in_z):
                b[i] = sp.Add(b[i], A[i, k] * form.states[k])
                A[i, k] = 0
    return replace(held, A=sp.ImmutableDenseMatrix(A), b=tuple(b))


def _links(form: Form) -> set[tuple[int, int]]:
    """The entries of A with which a state of a chain enters the row before it; none of a form without chains."""
    if form.kind in ("original", "state_affine"):
        return set()
    chains = zip(form.heads, form.blocks, strict=True)
    return {(i, i + 1) for head, size in chains for i in range(head, head + size - 1)}
