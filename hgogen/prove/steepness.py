"""How steep b is in scaled coordinates of a form in chains, and what stands in the way of a proof there.

    |S db/dz S^-1| <= L_b on the box,   S diagonal, positive, of numbers and parameters: constant in time

The box is convex and b Lipschitz on it, so that b(sat z) - b(x) = J (sat z - x) with J in the closed convex hull of the
values of db/dz, lower triangular; sat clamps each component to an interval that holds x_i. J_ij turns into theta^(j-i)
J_ij, j <= i, by Delta J Delta^-1, Delta = diag(1, 1/theta, .., 1/theta^(n-1)); for a triangular J it is analytic in
1/theta, with the norm |J| on the unit circle, so that its norm is at most |J| for theta >= 1 (maximum modulus). Of
several outputs Delta is that of their chains' alignment (`scaling`), and rows read states of no higher power of theta.
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache

import sympy as sp

from hgogen.analysis.polytope import chains, fixed, span
from hgogen.analysis.saturation import cut
from hgogen.analysis.scaling import ALIGNED, exponents
from hgogen.analysis.written import valueless
from hgogen.check import Verdict
from hgogen.form import Form
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.lmi import STATES
from hgogen.rigor.bounds import Proof
from hgogen.rigor.definite import Matrix, root
from hgogen.rigor.points import exact
from hgogen.sentence import NONE, Reason, because

GROWTHS = (Fraction(1), Fraction(1, 2), Fraction(1, 4), Fraction(1, 8))  # of scales from state to state
_BOXES = 500  # L_b need not be the least: more boxes would cost more than they bring


def slope(form: Form, scale: Sequence[sp.Expr]) -> Proof | Nothing:
    """|S db/dz S^-1| on the box from above, S the diagonal `scale` (n) of numbers and parameters, b_i of z_1, .., z_i;
    or why there is no bound, or no such form."""
    reason = obstacle(form)
    if reason:
        return Nothing(reason)
    slopes = jacobian(form)  # the Frobenius norm of S J S^-1 is at least the spectral one
    square = sp.Add(*((scale[i] * slopes[i, j] / scale[j]) ** 2 for i in range(form.n) for j in range(form.n)))
    enclosure = span(square, form, _BOXES)
    if not (enclosure and enclosure.defined and enclosure.finite):
        return Nothing(because("no bound L_b on the slope of b was found on the box"))
    return Proof(form.b, None, root(Fraction(max(enclosure.high, 0.0))), enclosure.variables, enclosure.tree)


@lru_cache(maxsize=32)  # a search asks it of each gain
def obstacle(form: Form, endless: bool = False) -> Reason:
    """Why the theorem does not apply as it stands, or `NONE`; `endless`: whether b need not be Lipschitz."""
    if len(form.output) > 1 and (form.alignment not in ALIGNED or len(form.blocks) != len(form.output)):
        return because("the bound of several outputs is for chains aligned at the top or at the end")
    if limited := cut(form):
        return limited
    if form.jacobian is not None:
        return because("the bound is for an observer in the coordinates of the form, this one stays in the plant's")
    if form.behind is not None:
        return because("the bound is for a gain that acts on z itself, with b a function of z")
    if form.n > STATES:
        return because("the bound is computed for up to {most} states", most=STATES)
    others = (check for check in form.checks if not (endless and check.id.fact == "lipschitz"))
    open_ = [check.id for check in others if check.verdict is not Verdict.PROVED]
    if open_:
        return because("the bound rests on {check}, which is not proved", check=open_[0])
    part = valueless(form.system) if endless else None  # at a pole of it b may jump, which its slope does not see
    if part is not None:
        return because("{part} of the plant is not shown to have a value on the box", part=part)
    known, power, heads = {*form.system.inputs, *form.system.parameters}, exponents(form), form.heads
    for i in range(form.n):
        for j in range(form.n):
            if form.A[i, j] != 0 and (j != i + 1 or j in heads or form.A[i, j].free_symbols - known):
                pattern = "A[{i}, {j}] = {entry} has no place in the triangular form"
                return because(pattern, i=i + 1, j=j + 1, entry=form.A[i, j])
        if not form.b[i].free_symbols <= {z for z, k in zip(form.states, power, strict=True) if k <= power[i]} | known:
            return because("b_{i} = {row} reads more than z_1..z_{i}", i=i + 1, row=form.b[i])
    for k, first in ((k, chain[0]) for k, chain in enumerate(chains(form)) if chain):
        output, head = form.output[k], heads[k]
        offset = output - sp.diff(output, form.states[head]) * form.states[head]
        if (sp.expand(offset).free_symbols | first.free_symbols) & {*form.states}:
            return because("the output {output} is not a_1 z_1 + c(u)", output=output)
    return NONE


def jacobian(form: Form) -> sp.Matrix:
    """The Jacobian db/dz, with constants at their values."""
    b = sp.Matrix([exact(sp.sympify(row).xreplace(fixed(form))) for row in form.b])
    return b.jacobian(sp.Matrix(form.states))


def companions(p: Sequence[Fraction], blocks: Sequence[int]) -> Matrix:
    """The companion matrices of the blocks' polynomials along the diagonal."""
    n, heads = range(len(p)), [sum(blocks[:i]) for i, size in enumerate(blocks) for _ in range(size)]
    inner = [[Fraction(int(j == i + 1 and heads[i] == heads[j])) for j in n] for i in n]
    return tuple(tuple(inner[i][j] - (p[i] if j == heads[i] else 0) for j in n) for i in n)
