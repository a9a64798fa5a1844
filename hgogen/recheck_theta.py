"""The convergence of an observer with a constant gain, verified again for a triangular form.

    z' = A z + b(sat z, u) + diag(theta, .., theta^n) K (y - C z)   converges exponentially for every
    theta > max(1, 2 peak L),   N'P + P N <= -I,   0 < P <= peak I,   N = S (A - K C) S^-1,   L >= |S db/dz S^-1|

S diagonal, constant in time, N a matrix of numbers. In e = diag(1, 1/theta, ..) S (z - x), V = e'P e has the derivative
V' <= -(theta - 2 peak L) |e|^2: theta turns b's Jacobian, which is lower triangular, into one of no larger norm, and
clamping brings each component nearer to the plant's. Source of the observer: Gauthier, Hammouri, Othman, IEEE TAC 37
(1992).
"""

from fractions import Fraction
from typing import Any

from hgogen.recheck_box import NotShown, covered
from hgogen.recheck_context import Context, Shown, declared_box, finite, on, only, short
from hgogen.recheck_file import Claim, part
from hgogen.recheck_slope import steep
from hgogen.recheck_text import Expression, expression, number

Matrix = list[list[Fraction]]


def convergence(context: Context, claim: Claim, row: tuple[int, ...]) -> Shown:
    """Every theta above the bound converges; the structure of the form is another claim."""
    _ = context.equations
    evidence, z, n = claim.evidence, context.z, len(context.z)
    _, gains = _tuned(context)
    scale = [expression(text, context.form.box) for text in _list(evidence, "scale", n)]
    for constant in (*scale, *gains):
        only(constant.names, context.file.parameters, f"the constant {constant.text}")
    box = context.form.box
    boxes = sum(finite(expression(f"1/({s.text})", box), box) for s in scale)
    boxes += sum(finite(k, box) for k in gains)
    N, P = _matrix(evidence, "core", n), _matrix(evidence, "P", n)
    _core(context, [context.value(s) for s in scale], [context.value(k) for k in gains], N)
    _lyapunov(N, P, number(evidence.get("peak")))
    names = {name for read in (*context.form.b, *scale) for name in read.names}
    where = declared_box(evidence, context.form.box, names)
    bound = number(evidence.get("bound"))
    if bound < 0:
        raise NotShown("its bound is negative")
    boxes += covered(where, part(evidence, "tree", str), steep(context.form.b, z, bound, scale))
    above = f"the error converges exponentially for every theta above {short(threshold(claim), 1)}"
    return Shown(f"in continuous time, without noise, {above}{on(box)}", boxes)


def theta(context: Context, claim: Claim, row: tuple[int, ...]) -> Shown:
    """The observer's theta is above the bound; the bound is another claim."""
    chosen, _ = _tuned(context)
    bound = next((threshold(other) for other in context.file.claims if other.id == "high_gain.convergence"), None)
    if bound is None or not chosen > bound:
        raise NotShown(f"theta = {short(chosen)} is not above the bound")
    return Shown(f"theta = {short(chosen)} is above {short(bound, 1)}")


def threshold(claim: Claim) -> Fraction:
    """max(1, 2 peak L) of a claim of convergence."""
    return max(Fraction(1), 2 * number(claim.evidence.get("peak")) * number(claim.evidence.get("bound")))


def _tuned(context: Context) -> tuple[Fraction, tuple[Expression, ...]]:
    """theta and the gains of the file's observer."""
    observer = context.file.observer
    if observer is None or observer.name != "high_gain" or observer.theta is None:
        raise NotShown("the file has no high_gain observer with its theta and gains")
    return observer.theta, observer.gains


def _list(evidence: Any, key: str, count: int) -> list[Any]:
    found: list[Any] = part(evidence, key, list)
    if len(found) != count:
        raise NotShown(f"its {key} has not {count} entries")
    return found


def _matrix(evidence: Any, key: str, n: int) -> Matrix:
    rows = _list(evidence, key, n)
    if any(not isinstance(row, list) or len(row) != n for row in rows):
        raise NotShown(f"its {key} is no square matrix")
    return [[number(value) for value in row] for row in rows]


def _core(context: Context, S: list[Any], K: list[Any], N: Matrix) -> None:
    """S (A - K C) = N S, C = (a_1, 0, ..)."""
    algebra, form, n = context.algebra, context.form, len(S)
    for i in range(n):
        for j in range(n):
            entry = context.value(form.A[i][j])
            if j == 0:
                entry = entry - K[i] * context.first_gain(0)
            if not algebra.is_zero(S[i] * entry - algebra.number(N[i][j]) * S[j]):
                raise NotShown(f"its core[{i + 1},{j + 1}] is not that of S (A - K C) S^-1")


def _lyapunov(N: Matrix, P: Matrix, peak: Fraction) -> None:
    """P > 0, peak I - P > 0, -I - N'P - P N > 0, in exact fractions."""
    n = range(len(N))
    if any(P[i][j] != P[j][i] for i in n for j in n):
        raise NotShown("its P is not symmetric")
    decay = [[Fraction(-int(i == j)) - sum(N[k][i] * P[k][j] + P[i][k] * N[k][j] for k in n) for j in n] for i in n]
    above = [[Fraction(peak * int(i == j)) - P[i][j] for j in n] for i in n]
    matrices: dict[str, Matrix] = {"P": P, "peak I - P": above, "-I - N'P - P N": decay}
    for name, M in matrices.items():
        if not _positive(M):
            raise NotShown(f"its {name} is not positive definite")


def _positive(M: Matrix) -> bool:
    """Whether a symmetric matrix is positive definite, by the pivots of its elimination."""
    M = [[Fraction(value) for value in row] for row in M]
    for k, row in enumerate(M):
        if row[k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            factor = M[i][k] / row[k]
            M[i] = [x - factor * y for x, y in zip(M[i], row, strict=True)]
    return True
