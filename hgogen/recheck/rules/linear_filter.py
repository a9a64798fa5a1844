"""The convergence of a Kalman filter of a linear plant with constant coefficients, verified again.

    z' = A z + b(u),  y = C z + d(u):   sum_k (A')^k C'C A^k > 0,  sum_k A^k Q Q' (A')^k > 0,  k < n,  R > 0

A and C are those of the certificate's form, which no b reads a state of. With (C, A) observable and (A, Q) controllable
P of the Riccati equation converges to the one for which A - P C' R^-1 C is Hurwitz. A constant `theta` above 1 scales Q
by rows and columns, so that it must be positive definite. Source: R. E. Kalman, R. S. Bucy, J. Basic Engineering 83
(1961), section 7.
"""

from ..box import NotShown
from ..chain import built
from ..context import Context, Shown, inner, only
from ..file import Built, Claim, column, matrix, scalar
from ..matrix import Matrix, demand_nonnegative, demand_positive, plus, times, transposed
from ..rule import Rule

_NAME = "riccati"


def convergence(context: Context, claim: Claim) -> Shown:
    """The error converges exponentially from everywhere."""
    observer, form, n = built(context, claim), context.form, len(context.z)
    A, C = matrix(claim.evidence, "A", n, n), matrix(claim.evidence, "C", len(form.output), n)
    _linear(context, A, C)
    Q, R = matrix(observer.numbers, "Q", n, n), column(observer.numbers, "R", len(form.output))
    theta = scalar(observer.numbers, "theta")
    if theta <= 0 or any(r <= 0 for r in R):
        raise NotShown("its theta or R is not positive")
    demand_positive({"sum of (A')^k C'C A^k": _gramian(transposed(A), times(transposed(C), C))})
    if theta != 1:
        demand_positive({"Q": Q})
    demand_nonnegative({"Q": Q})
    demand_positive({"sum of A^k Q Q (A')^k": _gramian(A, times(Q, Q))})
    known = "(C, A) is observable, (A, Q) is controllable"
    return Shown(f"in continuous time, without noise, the error converges exponentially from everywhere: {known}")


def _linear(context: Context, A: Matrix, C: Matrix) -> None:
    """That the form is z' = A z + b(u), y = C z + d(u). Raises: `NotShown`."""
    _ = context.equations
    form, algebra = context.form, context.algebra
    for entries, row in zip(form.A, A, strict=True):
        for entry, number in zip(entries, row, strict=True):
            context.same(entry, algebra.number(number), "A is not that of the form")
    for rest in form.b:
        only(rest.names & set(context.z), (), "b")
    letters = algebra.names
    still = {**letters, **dict.fromkeys(context.z, algebra.zero)}
    for output, row in zip(form.output, C, strict=True):
        shown = inner(algebra, [algebra.number(each) for each in row], [letters[name] for name in context.z])
        context.same(output, algebra.read(output, still) + shown, "C is not that of the form")


def _gramian(A: Matrix, start: Matrix) -> Matrix:
    """The sum of A^k M (A')^k for k < n."""
    total, term = start, start
    for _ in range(len(A) - 1):
        term = times(times(A, term), transposed(A))
        total = plus(total, term)
    return total


OBSERVERS = {_NAME: Built(("theta", "Q", "R"))}
RULES = (Rule((_NAME,), ("convergence",), convergence, ("A", "C"), about="the filter of a linear plant"),)
