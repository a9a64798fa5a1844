"""Matrix operations as loops, for states too many to unroll; see `discretisation.notation`.

Each function is written once, here. Every language prints it and Python runs it in the same order of operations, so
that all give the same bits.

On P = L D L', with the columns of L in the members of a group: `L[k].v[i]` is row i of column k. Only i > k is read,
the diagonal is 1.

    expand         unit diagonal and zeros above it, so that a column can be multiplied by Phi
    triangularise  L, D of M diag(D) M' for a matrix M with `band` >= 1 diagonals above the main one, by rotations of
                   two columns without square roots (Gentleman 1973), which leave M diag(D) M' as it is
    add            L, D of L D L' + diag(w), by n rank-one updates (Gill, Golub, Murray, Saunders 1974, method C1)
    disturb        L, D of L D L' + r w w' (method C1)
    correct        L, D after a scalar measurement with row c, whose elements from `read` on are 0, and variance r, and
                   its gain (Bierman)
    cap            rows of L scaled where a variance exceeds its cap, a congruence
    renew          L, D with the information diag(c)^2 added, by a measurement of each state (Bierman)
    project        f = L'c, so that c P c' is the sum of the f_k^2 D_k
    decouple       L, D of P after P_ii = w_i, and 0 in the rest of row and column i, where w_i > 0 (method C1 again)

On a matrix X (n, n) by rows, in one array:

    balance        X <- S^-1 X S, S diagonal of powers of two, so that row i and column i are of about the same size
                   (Parlett, Reinsch 1969); a high gain enters X by its powers, which S takes out
    exponential    phi_0 = exp X, phi_1 = (phi_0 - 1)/X, phi_2 = (phi_1 - 1)/X by scaling and squaring
    resolvent      (1 - X)^-1 by Gauss-Jordan with row pivots

A loop that begins at an `aligned` row may pass over the diagonal of L and the zeros above it and does not change them:
the number that it would subtract from such a row is 0. A column that is NaN makes its diagonal NaN as well.
"""

from collections.abc import Callable, Mapping
from typing import Any

from hgogen.discretisation.notation import (
    DEGREE,
    HALVINGS,
    SWEEPS,
    Columns,
    FixedColumns,
    FixedMatrix,
    FixedVector,
    Matrix,
    Vector,
    aligned,
    array,
    half,
    line,
    n,
    on_arrays,
    real,
    square,
)


@on_arrays
def expand(L: Columns) -> None:
    """set the diagonal of L to 1 and the entries above it to 0"""
    for k in range(n):
        for i in range(k):
            L[k].v[i] = 0.0
        L[k].v[k] = 1.0


@on_arrays
def triangularise(L: Columns, D: Vector, band: int) -> None:
    """replace M in L, with band diagonals above the main one, and D by L, D with L D L' = M diag(D) M', by rotations
    without square roots"""
    for i in range(n):
        pivot = L[i].v[i]
        for step in range(band):
            k = i + 1 + step
            if k < n:
                other = L[k].v[i]
                a = D[i] * pivot
                b = D[k] * other
                sum = a * pivot + b * other
                f = a / sum
                g = b / sum
                D[k] = D[i] * (D[k] / sum)
                D[i] = sum
                for m in range(aligned(i + 1), n):
                    x = L[i].v[m]
                    y = L[k].v[m]
                    L[i].v[m] = f * x + g * y
                    L[k].v[m] = pivot * y - other * x
                L[k].v[i] = 0.0
                pivot = 1.0
        D[i] = D[i] * pivot * pivot
        L[i].v[i] = 1.0


@on_arrays
def add(L: Columns, D: Vector, w: FixedVector) -> None:
    """replace L, D by the factors of L D L' + diag(w), by rank-one updates, two at a time"""
    first = array(n)
    second = array(n)
    first[0] = 0.0
    second[0] = 0.0
    for pair in range(half):
        k = 2 * pair
        pivot = D[k] + w[k]
        share = w[k] / pivot
        weight = w[k] * D[k] / pivot
        other = w[k + 1]
        D[k] = pivot
        for i in range(k + 1, n):
            first[i] = 0.0 - L[k].v[i]
            second[i] = 0.0
            L[k].v[i] = L[k].v[i] + share * first[i]
        second[k + 1] = 1.0
        for j in range(k + 1, n):
            a = first[j]
            b = second[j]
            grown = D[j] + weight * a * a
            f = weight * a / grown
            weight = weight * D[j] / grown
            sum = grown + other * b * b
            g = other * b / sum
            other = other * grown / sum
            D[j] = sum
            for i in range(aligned(j + 1), n):
                first[i] = first[i] - a * L[j].v[i]
                x = L[j].v[i] + f * first[i]
                second[i] = second[i] - b * x
                L[j].v[i] = x + g * second[i]
    for i in range(2 * half, n):
        D[i] = D[i] + w[i]


@on_arrays
def disturb(L: Columns, D: Vector, w: FixedVector, r: float) -> None:
    """replace L, D by the factors of L D L' + r w w'"""
    x = array(n)
    weight = r
    for i in range(n):
        x[i] = w[i]
    for j in range(n):
        a = x[j]
        grown = D[j] + weight * a * a
        f = weight * a / grown
        weight = weight * D[j] / grown
        D[j] = grown
        for i in range(aligned(j + 1), n):
            x[i] = x[i] - a * L[j].v[i]
            L[j].v[i] = L[j].v[i] + f * x[i]


@on_arrays
def correct(L: Columns, D: Vector, c: FixedVector, r: float, gain: Vector, read: int) -> None:
    """replace L, D by the factors after a scalar measurement of row c and variance r, and compute its gain; c[i] is 0
    for i >= read"""
    alpha = r
    for i in range(n):
        gain[i] = 0.0
    for k in range(read):
        j = read - 1 - k
        f = c[j]
        for i in range(j + 1, read):
            f = f + L[j].v[i] * c[i]
        v = D[j] * f
        before = alpha
        alpha = before + v * f
        D[j] = D[j] * before / alpha
        for i in range(j + 1, n):
            old = L[j].v[i]
            L[j].v[i] = old - f * gain[i] / before
            gain[i] = gain[i] + old * v
        gain[j] = v
    for i in range(n):
        gain[i] = gain[i] / alpha


@on_arrays
def cap(L: Columns, D: Vector, caps: FixedVector) -> bool:
    """scale row i of L and D so that P_ii = caps_i where P_ii exceeds caps_i; return whether a P_ii did so or is not a
    number, or a D_i is negative; a D_i that is then invalid becomes caps_i"""
    scale = array(n)
    capped = False
    for i in range(n):
        variance = D[i]
        for k in range(i):
            variance = variance + L[k].v[i] * L[k].v[i] * D[k]
        scale[i] = caps[i] / variance if variance > caps[i] else 1.0
        capped = capped if variance <= caps[i] and D[i] >= 0.0 else True
    if capped:
        for k in range(n):
            for i in range(k + 1, n):
                L[k].v[i] = L[k].v[i] * scale[i] / scale[k]
            L[k].v[k] = 1.0
            d = D[k] * scale[k] * scale[k]
            D[k] = d if d >= 0.0 and d <= caps[k] else caps[k]
    return capped


@on_arrays
def renew(L: Columns, D: Vector, caps: FixedVector, c: FixedVector) -> bool:
    """replace L, D by the factors after a measurement of each state i with the variance 1/c_i^2; return whether the sum
    of P_ii/caps_i exceeds 1/2 or is not a number"""
    gain = array(n)
    share = 0.0
    for i in range(n):
        alpha = 1.0
        for k in range(n):
            gain[k] = 0.0
        for k in range(i + 1):
            j = i - k
            f = c[i] if j == i else L[j].v[i] * c[i]
            v = D[j] * f
            before = alpha
            alpha = before + v * f
            D[j] = D[j] * before / alpha
            for m in range(j + 1, n):
                old = L[j].v[m]
                L[j].v[m] = old - f * gain[m] / before
                gain[m] = gain[m] + old * v
            gain[j] = v
    for i in range(n):
        variance = D[i]
        for k in range(i):
            variance = variance + L[k].v[i] * L[k].v[i] * D[k]
        share = share + variance / caps[i]
    return not share <= 0.5


@on_arrays
def project(L: FixedColumns, c: FixedVector, f: Vector) -> None:
    """f = L'c"""
    for k in range(n):
        sum = c[k]
        for i in range(k + 1, n):
            sum = sum + L[k].v[i] * c[i]
        f[k] = sum


@on_arrays
def decouple(L: Columns, D: Vector, w: FixedVector) -> None:
    """replace L, D by the factors of P with P_ii = w_i and 0 elsewhere in row and column i, for each i with w_i > 0"""
    x = array(n)
    for i in range(n):
        weight = D[i] if w[i] > 0.0 else 0.0
        D[i] = w[i] if w[i] > 0.0 else D[i]
        for k in range(i):
            L[k].v[i] = 0.0 if w[i] > 0.0 else L[k].v[i]
        for m in range(i + 1, n):
            x[m] = L[i].v[m]
            L[i].v[m] = 0.0 if w[i] > 0.0 else x[m]
        for j in range(i + 1, n):
            a = x[j]
            grown = D[j] + weight * a * a
            f = weight * a / grown
            weight = weight * D[j] / grown
            D[j] = grown
            for m in range(j + 1, n):
                x[m] = x[m] - a * L[j].v[m]
                L[j].v[m] = L[j].v[m] + f * x[m]


@on_arrays
def balance(x: Matrix, scale: Vector) -> None:
    """X <- S^-1 X S, S a diagonal matrix of powers of two, so that row i and column i get about the same size"""
    for i in range(n):
        scale[i] = 1.0
    for sweep in range(SWEEPS):  # noqa: B007
        for i in range(n):
            f = 1.0
            column = 0.0
            row = 0.0
            for j in range(n):
                if j != i:
                    above = x[n * j + i]
                    across = x[n * i + j]
                    column = column + (-above if above < 0.0 else above)
                    row = row + (-across if across < 0.0 else across)
            if column > 0.0 and row > 0.0:
                for k in range(HALVINGS):  # noqa: B007
                    if not column < row / 2.0:
                        break
                    f = f * 2.0
                    column = column * 2.0
                    row = row / 2.0
                for k in range(HALVINGS):  # noqa: B007
                    if not column >= row * 2.0:
                        break
                    f = f / 2.0
                    column = column / 2.0
                    row = row * 2.0
                for j in range(n):
                    x[n * i + j] = x[n * i + j] / f
                for j in range(n):
                    x[n * j + i] = x[n * j + i] * f
                scale[i] = scale[i] * f


def product(c: Matrix, a: FixedMatrix, b: FixedMatrix) -> None:
    """c = a b"""
    for i in range(n):
        for j in range(n):
            sum = 0.0
            for k in range(n):
                sum = sum + a[n * i + k] * b[n * k + j]
            c[n * i + j] = sum


@on_arrays
def exponential(x: Matrix, phi_0: Matrix, phi_1: Matrix, phi_2: Matrix) -> None:
    """phi_0 = exp X, phi_1 = (phi_0 - 1)/X, phi_2 = (phi_1 - 1)/X: series of phi_2 for X/2^k, then k doublings"""
    norm = 0.0
    doublings = 0
    c = array(square)
    for i in range(n):
        row = 0.0
        for j in range(n):
            v = x[n * i + j]
            row = row + (-v if v < 0.0 else v)
            phi_2[n * i + j] = 1.0 if i == j else 0.0
        norm = row if row > norm else norm
    while doublings < HALVINGS and norm > 0.5:
        norm = norm / 2.0
        doublings += 1
        for i in range(square):
            x[i] = x[i] / 2.0
    for j in range(DEGREE + 2, 2, -1):
        product(c, x, phi_2)
        for i in range(square):
            phi_2[i] = (1.0 if i % line == 0 else 0.0) + c[i] / real(j)
    for i in range(square):
        phi_2[i] = phi_2[i] / 2.0
    product(c, x, phi_2)
    for i in range(square):
        phi_1[i] = (1.0 if i % line == 0 else 0.0) + c[i]
    product(c, x, phi_1)
    for i in range(square):
        phi_0[i] = (1.0 if i % line == 0 else 0.0) + c[i]
    for k in range(doublings):  # noqa: B007
        product(c, phi_0, phi_2)
        for i in range(square):
            phi_2[i] = (c[i] + phi_1[i] + phi_2[i]) / 4.0
        product(c, phi_0, phi_1)
        for i in range(square):
            phi_1[i] = (c[i] + phi_1[i]) / 2.0
        product(c, phi_0, phi_0)
        for i in range(square):
            phi_0[i] = c[i]


@on_arrays
def resolvent(x: Matrix, inverse: Matrix) -> None:
    """inverse = (1 - X)^-1 by Gauss-Jordan elimination with row pivots; x is overwritten"""
    for i in range(square):
        inverse[i] = 1.0 if i % line == 0 else 0.0
        x[i] = inverse[i] - x[i]
    for k in range(n):
        best = k
        most = 0.0
        for i in range(k, n):
            v = x[n * i + k]
            size = -v if v < 0.0 else v
            if size > most:
                best = i
                most = size
        pivot = x[n * best + k]
        for j in range(n):
            mine = x[n * best + j] / pivot
            other = inverse[n * best + j] / pivot
            x[n * best + j] = x[n * k + j]
            inverse[n * best + j] = inverse[n * k + j]
            x[n * k + j] = mine
            inverse[n * k + j] = other
        for i in range(n):
            if i != k:
                factor = x[n * i + k]
                for j in range(n):
                    x[n * i + j] = x[n * i + j] - factor * x[n * k + j]
                    inverse[n * i + j] = inverse[n * i + j] - factor * inverse[n * k + j]


_ON_COLUMNS = (expand, triangularise, add, disturb, correct, cap, renew, project, decouple)
KERNELS: Mapping[str, Callable[..., Any]] = {
    each.__name__: each for each in (*_ON_COLUMNS, balance, exponential, resolvent)
}
