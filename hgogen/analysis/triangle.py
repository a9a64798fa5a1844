"""A plant whose states stand in chains, as the triangular forms take it, with what is to be proved of it.

    z_(i,j)' = a_(i,j+1) z_(i,j+1) + b_(i,j),   z_(i,n_i)' = b_(i,n_i),   y_i = a_(i,1) z_(i,1) + c_i

z is the plant's state chain by chain, in the signs that make the a_(i,j) positive. A row that is not shown to be linear
in the state that it brings in has a difference quotient in the middle of the box for its a_(i,j).
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from typing import Any

import sympy as sp

from hgogen.analysis.chain import Chains, Link, Shape
from hgogen.analysis.coordinates import coordinates, form_in
from hgogen.analysis.hypotheses import defined, positive, sign
from hgogen.analysis.lipschitz import lipschitz
from hgogen.check import Check, ClaimId
from hgogen.form import Form
from hgogen.rigor.box import STRANGE, exact, points
from hgogen.system import System

_VALUES = 12  # of the state


def triangle(structure: Check, reference: str, plant: System, chains: Chains, shape: Shape, **more: Any) -> Form:
    """The plant in z, each link of the chains in the `shape`.

    Checks of the maker of `structure`, after that: `a_i` of one chain, `a_i_j` of several (0 < a_m <= a <= a_M on the
    box of what a varies with); `offset`, `offset_i` (c_i is defined there) of an output with one; `lipschitz`, of b and
    the a z whose a varies with a state. `more`: further fields of the form.
    """
    maker, several = structure.id.maker, "blocks" in more
    every = [[settled(link, shape, plant, links[0].state) for link in links] for links in chains.links]
    signs = [signs_of(links, plant) for links in every]
    z = coordinates(plant, chains.order, [t for each in signs for t in each])
    A, b, output, head = sp.zeros(len(z.states), len(z.states)), [*z.flow], [*z.output], 0
    gains, offsets = list[Check](), list[Check]()
    for i, links in enumerate(every):
        before = (1, *signs[i])
        for j, (link, s, t) in enumerate(zip(links, before, signs[i], strict=False)):
            a, rest = s * link.gain * t, s * z.carry(link.rest)
            at = (i + 1, j + 1) if several else (j + 1,)
            name = "a_({},{})" if several else "a_{}"
            gains.append(positive(ClaimId(maker, "a", *at), name.format(*at), a, plant))
            if j:
                A[head + j - 1, head + j], b[head + j - 1] = z.carry(a), rest
            else:
                output[i] = z.carry(a) * z.states[head] + rest
        c = links[0].rest if links else sp.S.Zero
        if c != 0 and c.free_symbols.isdisjoint(plant.states):
            id = ClaimId(maker, "offset", i + 1) if several else ClaimId(maker, "offset")
            offsets.append(defined(id, f"c_{i + 1}" if several else "c", c, plant))
        head += len(links)
    parts = sp.ImmutableDenseMatrix(A), tuple(b), tuple(output)
    form = form_in(z, maker, (structure, *gains, *offsets), reference, parts=parts, **more)
    name = "b" if form.nonlinear == form.b else "b, with the a_i(z_1) z_i,"
    steep = lipschitz(maker, map(z.back, form.nonlinear), plant, name)
    return replace(form, checks=(*form.checks, steep))


def settled(link: Link, shape: Shape, plant: System, measured: sp.Symbol | None = None) -> Link:
    """The link; where it is not shown to have the shape, a chord for the gain, and what that leaves of the row for the
    rest."""
    if link.answer(shape, measured)[0]:
        return link
    gain = _chord(link.row, link.state, plant)
    return replace(link, gain=gain, rest=link.row - gain * link.state)


def _chord(row: sp.Expr, state: sp.Symbol, plant: System) -> sp.Expr:
    """(row(b) - row(a))/(b - a) for the first values a, b of the state at which it is finite, the other states in the
    middle of their ranges; or 0."""
    middle, row = dict(next(points(plant.states))), exact(row)
    values = list(dict.fromkeys(point[state] for point in islice(points((state,)), _VALUES)))
    for i, a in enumerate(values[:2]):
        for b in values[i + 1 :]:
            try:
                slope = (row.xreplace({state: b}) - row.xreplace({state: a})) / (b - a)
            except (ValueError, TypeError):  # a comparison of numbers that SymPy cannot make
                continue
            slope = slope.xreplace(middle)
            if not slope.has(*STRANGE):
                return slope
    return sp.S.Zero


def signs_of(links: Iterable[Link], plant: System) -> list[int]:
    """The sign of each z_i that makes a_i positive; an a_i without one sign stays as it is."""
    signs = [1]
    for link in links:
        signs.append(signs[-1] * (sign(link.gain, plant) or 1))
    return signs[1:]
