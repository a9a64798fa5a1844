"""The kernels of `discretisation.kernels` as C functions with loops; their holes are filled in."""

from collections.abc import Collection
from string import Template

from hgogen.discretisation.kernels import DEGREE, HALVINGS, SWEEPS
from hgogen.emit.ccode import Code, code, filled, joined
from hgogen.emit.cprint import Real, literal

_VALUES = {"zero": 0, "one": 1, "two": 2, "four": 4, "half": 0.5}
_C = {
    "expand": Template("""
/* unit diagonal and zeros above it in the columns of L */
static void ${prefix}_expand(${prefix}_column L[$n])
{
    for (unsigned k = 0u; k < $n; ++k) {
        for (unsigned i = 0u; i < k; ++i) {
            L[k].v[i] = $zero;
        }
        L[k].v[k] = $one;
    }
}
"""),
    "triangularise": Template("""
/* L, D of M diag(D) M', M in L, by weighted Gram-Schmidt on the rows of M; row j, done with, takes column j of L */
static void ${prefix}_triangularise(${prefix}_column L[$n], $real D[$n])
{
    $real weights[$n];
    $real row[$n];
    for (unsigned k = 0u; k < $n; ++k) {
        weights[k] = D[k];
    }
    for (unsigned j = 0u; j < $n; ++j) {
        $real sum = $zero;
        for (unsigned k = 0u; k < $n; ++k) {
            row[k] = L[k].v[j];
            sum = sum + row[k]*(weights[k]*row[k]);
        }
        D[j] = sum;
        for (unsigned i = j + 1u; i < $n; ++i) {
            $real dot = $zero;
            for (unsigned k = 0u; k < $n; ++k) {
                dot = dot + L[k].v[i]*(weights[k]*row[k]);
            }
            const $real factor = dot/sum;
            for (unsigned k = 0u; k < $n; ++k) {
                L[k].v[i] = L[k].v[i] - factor*row[k];
            }
            L[i].v[j] = factor;
        }
    }
    for (unsigned k = 0u; k < $n; ++k) {
        L[k].v[k] = $one;
        for (unsigned i = k + 1u; i < $n; ++i) {
            L[k].v[i] = L[i].v[k];
            L[i].v[k] = $zero;
        }
    }
}
"""),
    "add": Template("""
/* L, D of L D L' + diag(w), by rank-one updates */
static void ${prefix}_add(${prefix}_column L[$n], $real D[$n], const $real w[$n])
{
    $real vector[$n];
    for (unsigned k = 0u; k < $n; ++k) {
        $real weight = w[k];
        for (unsigned i = 0u; i < $n; ++i) {
            vector[i] = $zero;
        }
        vector[k] = $one;
        for (unsigned j = k; j < $n; ++j) {
            const $real pivot = vector[j];
            const $real grown = D[j] + weight*pivot*pivot;
            const $real factor = weight*pivot/grown;
            weight = weight*D[j]/grown;
            D[j] = grown;
            for (unsigned i = j + 1u; i < $n; ++i) {
                vector[i] = vector[i] - pivot*L[j].v[i];
                L[j].v[i] = L[j].v[i] + factor*vector[i];
            }
        }
    }
}
"""),
    "correct": Template("""
/* L, D after a measurement of row c and variance r; its gain */
static void ${prefix}_correct(${prefix}_column L[$n], $real D[$n], const $real c[$n], $real r, $real gain[$n])
{
    $real alpha = r;
    for (unsigned i = 0u; i < $n; ++i) {
        gain[i] = $zero;
    }
    for (unsigned k = 0u; k < $n; ++k) {
        const unsigned j = $n - 1u - k;
        $real f = c[j];
        for (unsigned i = j + 1u; i < $n; ++i) {
            f = f + L[j].v[i]*c[i];
        }
        const $real v = D[j]*f;
        const $real before = alpha;
        alpha = before + v*f;
        D[j] = D[j]*before/alpha;
        for (unsigned i = j + 1u; i < $n; ++i) {
            const $real old = L[j].v[i];
            L[j].v[i] = old - f*gain[i]/before;
            gain[i] = gain[i] + old*v;
        }
        gain[j] = v;
    }
    for (unsigned i = 0u; i < $n; ++i) {
        gain[i] = gain[i]/alpha;
    }
}
"""),
    "cap": Template("""
/* scale row i of L where P_ii exceeds its cap; whether one did */
static $bool ${prefix}_cap(${prefix}_column L[$n], $real D[$n], const $real caps[$n])
{
    $real scale[$n];
    $bool capped = false;
    for (unsigned i = 0u; i < $n; ++i) {
        $real variance = D[i];
        for (unsigned k = 0u; k < i; ++k) {
            variance = variance + L[k].v[i]*L[k].v[i]*D[k];
        }
        scale[i] = $one;
        if (variance > caps[i]) {
            scale[i] = caps[i]/variance;
            capped = true;
        }
    }
    if (capped) {
        for (unsigned k = 0u; k < $n; ++k) {
            for (unsigned i = k + 1u; i < $n; ++i) {
                L[k].v[i] = L[k].v[i]*scale[i]/scale[k];
            }
            D[k] = D[k]*scale[k]*scale[k];
        }
    }
    return capped;
}
"""),
    "renew": Template("""
/* L, D after a measurement of each state to the variance 1/c_i^2; whether the P_ii/caps_i then add up to over 1/2 */
static $bool ${prefix}_renew(${prefix}_column L[$n], $real D[$n], const $real caps[$n], const $real c[$n])
{
    $real gain[$n];
    $real share = $zero;
    for (unsigned i = 0u; i < $n; ++i) {
        $real alpha = $one;
        for (unsigned k = 0u; k < $n; ++k) {
            gain[k] = $zero;
        }
        for (unsigned k = 0u; k <= i; ++k) {
            const unsigned j = i - k;
            const $real f = (j == i) ? c[i] : L[j].v[i]*c[i];
            const $real v = D[j]*f;
            const $real before = alpha;
            alpha = before + v*f;
            D[j] = D[j]*before/alpha;
            for (unsigned m = j + 1u; m < $n; ++m) {
                const $real old = L[j].v[m];
                L[j].v[m] = old - f*gain[m]/before;
                gain[m] = gain[m] + old*v;
            }
            gain[j] = v;
        }
    }
    for (unsigned i = 0u; i < $n; ++i) {
        $real variance = D[i];
        for (unsigned k = 0u; k < i; ++k) {
            variance = variance + L[k].v[i]*L[k].v[i]*D[k];
        }
        share = share + variance/caps[i];
    }
    return share > $half;
}
"""),
    "balance": Template("""
/* X <- S^-1 X S, S diagonal of powers of two: row i and column i of about the same size */
static void ${prefix}_balance($real x[$square], $real scale[$n])
{
    for (unsigned i = 0u; i < $n; ++i) {
        scale[i] = $one;
    }
    for (unsigned sweep = 0u; sweep < $sweeps; ++sweep) {
        for (unsigned i = 0u; i < $n; ++i) {
            $real f = $one;
            $real column = $zero;
            $real row = $zero;
            for (unsigned j = 0u; j < $n; ++j) {
                if (j != i) {
                    const $real above = x[$n*j + i];
                    const $real beside = x[$n*i + j];
                    column = column + ((above < $zero) ? -above : above);
                    row = row + ((beside < $zero) ? -beside : beside);
                }
            }
            if (column > $zero && row > $zero) {
                for (unsigned k = 0u; k < $halvings && column < row/$two; ++k) {
                    f = f*$two;
                    column = column*$two;
                    row = row/$two;
                }
                for (unsigned k = 0u; k < $halvings && column >= row*$two; ++k) {
                    f = f/$two;
                    column = column/$two;
                    row = row*$two;
                }
                for (unsigned j = 0u; j < $n; ++j) {
                    x[$n*i + j] = x[$n*i + j]/f;
                }
                for (unsigned j = 0u; j < $n; ++j) {
                    x[$n*j + i] = x[$n*j + i]*f;
                }
                scale[i] = scale[i]*f;
            }
        }
    }
}
"""),
    "exponential": Template("""
/* c = a b */
static void ${prefix}_product($real c[$square], const $real a[$square], const $real b[$square])
{
    for (unsigned i = 0u; i < $n; ++i) {
        for (unsigned j = 0u; j < $n; ++j) {
            $real sum = $zero;
            for (unsigned k = 0u; k < $n; ++k) {
                sum = sum + a[$n*i + k]*b[$n*k + j];
            }
            c[$n*i + j] = sum;
        }
    }
}

/* phi_0 = exp X, phi_1 = (phi_0 - 1)/X, phi_2 = (phi_1 - 1)/X: series of phi_2 for X/2^k, then k doublings */
static void ${prefix}_exponential($real x[$square], $real phi_0[$square], $real phi_1[$square], $real phi_2[$square])
{
    $real norm = $zero;
    unsigned doublings = 0u;
    $real c[$square];
    for (unsigned i = 0u; i < $n; ++i) {
        $real row = $zero;
        for (unsigned j = 0u; j < $n; ++j) {
            const $real v = x[$n*i + j];
            row = row + ((v < $zero) ? -v : v);
            phi_2[$n*i + j] = (i == j) ? $one : $zero;
        }
        norm = (row > norm) ? row : norm;
    }
    while (doublings < $halvings && norm > $half) {
        norm = norm/$two;
        ++doublings;
        for (unsigned i = 0u; i < $square; ++i) {
            x[i] = x[i]/$two;
        }
    }
    for (unsigned j = $degree + 2u; j > 2u; --j) {
        ${prefix}_product(c, x, phi_2);
        for (unsigned i = 0u; i < $square; ++i) {
            phi_2[i] = ((i % $line == 0u) ? $one : $zero) + c[i]/($real)j;
        }
    }
    for (unsigned i = 0u; i < $square; ++i) {
        phi_2[i] = phi_2[i]/$two;
    }
    ${prefix}_product(c, x, phi_2);
    for (unsigned i = 0u; i < $square; ++i) {
        phi_1[i] = ((i % $line == 0u) ? $one : $zero) + c[i];
    }
    ${prefix}_product(c, x, phi_1);
    for (unsigned i = 0u; i < $square; ++i) {
        phi_0[i] = ((i % $line == 0u) ? $one : $zero) + c[i];
    }
    for (unsigned k = 0u; k < doublings; ++k) {
        ${prefix}_product(c, phi_0, phi_2);
        for (unsigned i = 0u; i < $square; ++i) {
            phi_2[i] = (c[i] + phi_1[i] + phi_2[i])/$four;
        }
        ${prefix}_product(c, phi_0, phi_1);
        for (unsigned i = 0u; i < $square; ++i) {
            phi_1[i] = (c[i] + phi_1[i])/$two;
        }
        ${prefix}_product(c, phi_0, phi_0);
        for (unsigned i = 0u; i < $square; ++i) {
            phi_0[i] = c[i];
        }
    }
}
"""),
    "resolvent": Template("""
/* (1 - X)^-1 by Gauss-Jordan with row pivots; x is left in pieces */
static void ${prefix}_resolvent($real x[$square], $real inverse[$square])
{
    for (unsigned i = 0u; i < $square; ++i) {
        inverse[i] = (i % $line == 0u) ? $one : $zero;
        x[i] = inverse[i] - x[i];
    }
    for (unsigned k = 0u; k < $n; ++k) {
        unsigned best = k;
        $real most = $zero;
        for (unsigned i = k; i < $n; ++i) {
            const $real v = x[$n*i + k];
            const $real size = (v < $zero) ? -v : v;
            if (size > most) {
                best = i;
                most = size;
            }
        }
        const $real pivot = x[$n*best + k];
        for (unsigned j = 0u; j < $n; ++j) {
            const $real mine = x[$n*best + j]/pivot;
            const $real other = inverse[$n*best + j]/pivot;
            x[$n*best + j] = x[$n*k + j];
            inverse[$n*best + j] = inverse[$n*k + j];
            x[$n*k + j] = mine;
            inverse[$n*k + j] = other;
        }
        for (unsigned i = 0u; i < $n; ++i) {
            if (i != k) {
                const $real factor = x[$n*i + k];
                for (unsigned j = 0u; j < $n; ++j) {
                    x[$n*i + j] = x[$n*i + j] - factor*x[$n*k + j];
                    inverse[$n*i + j] = inverse[$n*i + j] - factor*inverse[$n*k + j];
                }
            }
        }
    }
}
"""),
}


def kernels(prefix: str, real: Real, used: Collection[tuple[str, int]]) -> Code:
    """The C functions of the kernels in `used`, (name, size), in the order of this file."""
    values = {name: literal(value, real) for name, value in _VALUES.items()}
    values |= {"real": real, "prefix": prefix, "bool": "bool"}

    def holes(size: int) -> dict[str, str | int]:
        counts = {"n": size, "square": size * size, "line": size + 1}
        return values | counts | {"sweeps": SWEEPS, "halvings": HALVINGS, "degree": DEGREE}

    wanted = [(text, size) for name, text in _C.items() for other, size in sorted(used) if other == name]
    return joined(filled(text, holes(size)) + code("") for text, size in wanted)
