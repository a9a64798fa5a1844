"""Whether what is nonlinear in a form is bounded on the declared ranges: |a_1 .. a_i b_i| <= mu.

phi of a theorem on x_i' = x_(i+1), x_n' = phi is that of the chain of integrators, c_i = a_1 .. a_i b_i, and not b_n.

The law asks for no slope of phi, so the plant as it is written is asked here: (u x + u)/u is x + 1 in a form, and has
no value at u = 0.

phi of a phase form, at its place in b, is taken as a function of the plant's states where it has poles in the box of z.
"""

from collections.abc import Sequence

import sympy as sp

from hgogen.algebra.tape import NoTape
from hgogen.analysis.written import if_valued
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.intervals.bounds import bound
from hgogen.intervals.box import box
from hgogen.intervals.digits import Up
from hgogen.sentence import because

BOXES = 500  # mu need not be the least


def bounded(id: ClaimId, form: Form, products: Sequence[sp.Expr]) -> Check:
    """The check that every row of b is bounded: it is proved with the bound mu of a_1 .. a_i b_i, or unknown.

    `products` (n): a_1 .. a_i.
    """
    claim = "phi is bounded on the declared ranges of states and inputs"
    rows = form.b if form.behind is None else form.behind
    states = form.states if form.behind is None else form.system.states
    read = {s for row in rows for s in row.free_symbols}
    loose = [s.name for s in (*states, *form.system.inputs) if s in read and not s.bounded]
    if loose:
        fix = f"Declare a range for {', '.join(loose)}; of an input's derivative by rates=((low, high), ..)."
        reason = because("no range is declared for {names}; an input that steps has none", names=loose)
        return Check(id, claim, Verdict.UNKNOWN, reason, fix=fix)
    around = box((*states, *form.system.inputs, *form.system.parameters), form.system.nominal)
    try:
        ranges = [bound(a * row, around, boxes=BOXES) for a, row in zip(products, rows, strict=True) if row != 0]
    except NoTape as missing:
        return Check(id, claim, Verdict.UNKNOWN, because("{what} may be unbounded", what=missing.what))
    if not all(values.finite and values.defined for values in ranges):
        return Check(id, claim, Verdict.UNKNOWN, because("no bound was found; it may have poles on the box"))
    mu = max((max(abs(values.low), abs(values.high)) for values in ranges), default=0.0)
    proved = Check(id, claim, Verdict.PROVED, because("mu <= {mu}, by outward-rounded intervals", mu=Up(mu)))
    return if_valued(proved, form.system)
