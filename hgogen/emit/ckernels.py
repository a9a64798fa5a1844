"""The kernels of `discretisation.kernels` as C functions with loops; words in capitals are filled in."""

from collections.abc import Collection

from hgogen.discretisation.kernels import DEGREE, HALVINGS, SWEEPS
from hgogen.emit.cprint import Real, literal

_VALUES = {"ZERO": 0, "ONE": 1, "TWO": 2, "FOUR": 4, "HALF": 0.5}
_C: dict[str, str] = {
    "expand": """
/* unit diagonal and zeros above it in the columns of L */
static void PREFIX_expand(PREFIX_column L[SIZE])
{
    for (unsigned k = 0u; k < SIZE; ++k) {
        for (unsigned i = 0u; i < k; ++i) {
            L[k].v[i] = ZERO;
        }
        L[k].v[k] = ONE;
    }
}
""",
    "triangularise": """
/* L, D of M diag(D) M', M in L, by weighted Gram-Schmidt on the rows of M; row j, done with, takes column j of L */
static void PREFIX_triangularise(PREFIX_column L[SIZE], REAL D[SIZE])
{
    REAL weights[SIZE];
    REAL row[SIZE];
    for (unsigned k = 0u; k < SIZE; ++k) {
        weights[k] = D[k];
    }
    for (unsigned j = 0u; j < SIZE; ++j) {
        REAL sum = ZERO;
        for (unsigned k = 0u; k < SIZE; ++k) {
            row[k] = L[k].v[j];
            sum = sum + row[k]*(weights[k]*row[k]);
        }
        D[j] = sum;
        for (unsigned i = j + 1u; i < SIZE; ++i) {
            REAL dot = ZERO;
            for (unsigned k = 0u; k < SIZE; ++k) {
                dot = dot + L[k].v[i]*(weights[k]*row[k]);
            }
            const REAL factor = dot/sum;
            for (unsigned k = 0u; k < SIZE; ++k) {
                L[k].v[i] = L[k].v[i] - factor*row[k];
            }
            L[i].v[j] = factor;
        }
    }
    for (unsigned k = 0u; k < SIZE; ++k) {
        L[k].v[k] = ONE;
        for (unsigned i = k + 1u; i < SIZE; ++i) {
            L[k].v[i] = L[i].v[k];
            L[i].v[k] = ZERO;
        }
    }
}
""",
    "add": """
/* L, D of L D L' + diag(w), by rank-one updates */
static void PREFIX_add(PREFIX_column L[SIZE], REAL D[SIZE], const REAL w[SIZE])
{
    REAL vector[SIZE];
    for (unsigned k = 0u; k < SIZE; ++k) {
        REAL weight = w[k];
        for (unsigned i = 0u; i < SIZE; ++i) {
            vector[i] = ZERO;
        }
        vector[k] = ONE;
        for (unsigned j = k; j < SIZE; ++j) {
            const REAL pivot = vector[j];
            const REAL grown = D[j] + weight*pivot*pivot;
            const REAL factor = weight*pivot/grown;
            weight = weight*D[j]/grown;
            D[j] = grown;
            for (unsigned i = j + 1u; i < SIZE; ++i) {
                vector[i] = vector[i] - pivot*L[j].v[i];
                L[j].v[i] = L[j].v[i] + factor*vector[i];
            }
        }
    }
}
""",
    "correct": """
/* L, D after a measurement of row c and variance r; its gain */
static void PREFIX_correct(PREFIX_column L[SIZE], REAL D[SIZE], const REAL c[SIZE], REAL r, REAL gain[SIZE])
{
    REAL alpha = r;
    for (unsigned i = 0u; i < SIZE; ++i) {
        gain[i] = ZERO;
    }
    for (unsigned k = 0u; k < SIZE; ++k) {
        const unsigned j = SIZE - 1u - k;
        REAL f = c[j];
        for (unsigned i = j + 1u; i < SIZE; ++i) {
            f = f + L[j].v[i]*c[i];
        }
        const REAL v = D[j]*f;
        const REAL before = alpha;
        alpha = before + v*f;
        D[j] = D[j]*before/alpha;
        for (unsigned i = j + 1u; i < SIZE; ++i) {
            const REAL old = L[j].v[i];
            L[j].v[i] = old - f*gain[i]/before;
            gain[i] = gain[i] + old*v;
        }
        gain[j] = v;
    }
    for (unsigned i = 0u; i < SIZE; ++i) {
        gain[i] = gain[i]/alpha;
    }
}
""",
    "cap": """
/* scale row i of L where P_ii exceeds its cap; whether one did */
static bool PREFIX_cap(PREFIX_column L[SIZE], REAL D[SIZE], const REAL caps[SIZE])
{
    REAL scale[SIZE];
    bool capped = false;
    for (unsigned i = 0u; i < SIZE; ++i) {
        REAL variance = D[i];
        for (unsigned k = 0u; k < i; ++k) {
            variance = variance + L[k].v[i]*L[k].v[i]*D[k];
        }
        scale[i] = ONE;
        if (variance > caps[i]) {
            scale[i] = caps[i]/variance;
            capped = true;
        }
    }
    if (capped) {
        for (unsigned k = 0u; k < SIZE; ++k) {
            for (unsigned i = k + 1u; i < SIZE; ++i) {
                L[k].v[i] = L[k].v[i]*scale[i]/scale[k];
            }
            D[k] = D[k]*scale[k]*scale[k];
        }
    }
    return capped;
}
""",
    "renew": """
/* L, D after a measurement of each state to the variance 1/c_i^2; whether the P_ii/caps_i then add up to over 1/2 */
static bool PREFIX_renew(PREFIX_column L[SIZE], REAL D[SIZE], const REAL caps[SIZE], const REAL c[SIZE])
{
    REAL gain[SIZE];
    REAL share = ZERO;
    for (unsigned i = 0u; i < SIZE; ++i) {
        REAL alpha = ONE;
        for (unsigned k = 0u; k < SIZE; ++k) {
            gain[k] = ZERO;
        }
        for (unsigned k = 0u; k <= i; ++k) {
            const unsigned j = i - k;
            const REAL f = (j == i) ? c[i] : L[j].v[i]*c[i];
            const REAL v = D[j]*f;
            const REAL before = alpha;
            alpha = before + v*f;
            D[j] = D[j]*before/alpha;
            for (unsigned m = j + 1u; m < SIZE; ++m) {
                const REAL old = L[j].v[m];
                L[j].v[m] = old - f*gain[m]/before;
                gain[m] = gain[m] + old*v;
            }
            gain[j] = v;
        }
    }
    for (unsigned i = 0u; i < SIZE; ++i) {
        REAL variance = D[i];
        for (unsigned k = 0u; k < i; ++k) {
            variance = variance + L[k].v[i]*L[k].v[i]*D[k];
        }
        share = share + variance/caps[i];
    }
    return share > HALF;
}
""",
    "balance": """
/* X <- S^-1 X S, S diagonal of powers of two: row i and column i of about the same size */
static void PREFIX_balance(REAL x[SQUARE], REAL scale[SIZE])
{
    for (unsigned i = 0u; i < SIZE; ++i) {
        scale[i] = ONE;
    }
    for (unsigned sweep = 0u; sweep < SWEEPS; ++sweep) {
        for (unsigned i = 0u; i < SIZE; ++i) {
            REAL f = ONE;
            REAL column = ZERO;
            REAL row = ZERO;
            for (unsigned j = 0u; j < SIZE; ++j) {
                if (j != i) {
                    const REAL above = x[SIZE*j + i];
                    const REAL beside = x[SIZE*i + j];
                    column = column + ((above < ZERO) ? -above : above);
                    row = row + ((beside < ZERO) ? -beside : beside);
                }
            }
            if (column > ZERO && row > ZERO) {
                for (unsigned k = 0u; k < HALVINGS && column < row/TWO; ++k) {
                    f = f*TWO;
                    column = column*TWO;
                    row = row/TWO;
                }
                for (unsigned k = 0u; k < HALVINGS && column >= row*TWO; ++k) {
                    f = f/TWO;
                    column = column/TWO;
                    row = row*TWO;
                }
                for (unsigned j = 0u; j < SIZE; ++j) {
                    x[SIZE*i + j] = x[SIZE*i + j]/f;
                }
                for (unsigned j = 0u; j < SIZE; ++j) {
                    x[SIZE*j + i] = x[SIZE*j + i]*f;
                }
                scale[i] = scale[i]*f;
            }
        }
    }
}
""",
    "exponential": """
/* c = a b */
static void PREFIX_product(REAL c[SQUARE], const REAL a[SQUARE], const REAL b[SQUARE])
{
    for (unsigned i = 0u; i < SIZE; ++i) {
        for (unsigned j = 0u; j < SIZE; ++j) {
            REAL sum = ZERO;
            for (unsigned k = 0u; k < SIZE; ++k) {
                sum = sum + a[SIZE*i + k]*b[SIZE*k + j];
            }
            c[SIZE*i + j] = sum;
        }
    }
}

/* phi_0 = exp X, phi_1 = (phi_0 - 1)/X, phi_2 = (phi_1 - 1)/X: series of phi_2 for X/2^k, then k doublings */
static void PREFIX_exponential(REAL x[SQUARE], REAL phi_0[SQUARE], REAL phi_1[SQUARE], REAL phi_2[SQUARE])
{
    REAL norm = ZERO;
    unsigned doublings = 0u;
    REAL c[SQUARE];
    for (unsigned i = 0u; i < SIZE; ++i) {
        REAL row = ZERO;
        for (unsigned j = 0u; j < SIZE; ++j) {
            const REAL v = x[SIZE*i + j];
            row = row + ((v < ZERO) ? -v : v);
            phi_2[SIZE*i + j] = (i == j) ? ONE : ZERO;
        }
        norm = (row > norm) ? row : norm;
    }
    while (doublings < HALVINGS && norm > HALF) {
        norm = norm/TWO;
        ++doublings;
        for (unsigned i = 0u; i < SQUARE; ++i) {
            x[i] = x[i]/TWO;
        }
    }
    for (unsigned j = DEGREE + 2u; j > 2u; --j) {
        PREFIX_product(c, x, phi_2);
        for (unsigned i = 0u; i < SQUARE; ++i) {
            phi_2[i] = ((i % LINE == 0u) ? ONE : ZERO) + c[i]/(REAL)j;
        }
    }
    for (unsigned i = 0u; i < SQUARE; ++i) {
        phi_2[i] = phi_2[i]/TWO;
    }
    PREFIX_product(c, x, phi_2);
    for (unsigned i = 0u; i < SQUARE; ++i) {
        phi_1[i] = ((i % LINE == 0u) ? ONE : ZERO) + c[i];
    }
    PREFIX_product(c, x, phi_1);
    for (unsigned i = 0u; i < SQUARE; ++i) {
        phi_0[i] = ((i % LINE == 0u) ? ONE : ZERO) + c[i];
    }
    for (unsigned k = 0u; k < doublings; ++k) {
        PREFIX_product(c, phi_0, phi_2);
        for (unsigned i = 0u; i < SQUARE; ++i) {
            phi_2[i] = (c[i] + phi_1[i] + phi_2[i])/FOUR;
        }
        PREFIX_product(c, phi_0, phi_1);
        for (unsigned i = 0u; i < SQUARE; ++i) {
            phi_1[i] = (c[i] + phi_1[i])/TWO;
        }
        PREFIX_product(c, phi_0, phi_0);
        for (unsigned i = 0u; i < SQUARE; ++i) {
            phi_0[i] = c[i];
        }
    }
}
""",
    "resolvent": """
/* (1 - X)^-1 by Gauss-Jordan with row pivots; x is left in pieces */
static void PREFIX_resolvent(REAL x[SQUARE], REAL inverse[SQUARE])
{
    for (unsigned i = 0u; i < SQUARE; ++i) {
        inverse[i] = (i % LINE == 0u) ? ONE : ZERO;
        x[i] = inverse[i] - x[i];
    }
    for (unsigned k = 0u; k < SIZE; ++k) {
        unsigned best = k;
        REAL most = ZERO;
        for (unsigned i = k; i < SIZE; ++i) {
            const REAL v = x[SIZE*i + k];
            const REAL size = (v < ZERO) ? -v : v;
            if (size > most) {
                best = i;
                most = size;
            }
        }
        const REAL pivot = x[SIZE*best + k];
        for (unsigned j = 0u; j < SIZE; ++j) {
            const REAL mine = x[SIZE*best + j]/pivot;
            const REAL other = inverse[SIZE*best + j]/pivot;
            x[SIZE*best + j] = x[SIZE*k + j];
            inverse[SIZE*best + j] = inverse[SIZE*k + j];
            x[SIZE*k + j] = mine;
            inverse[SIZE*k + j] = other;
        }
        for (unsigned i = 0u; i < SIZE; ++i) {
            if (i != k) {
                const REAL factor = x[SIZE*i + k];
                for (unsigned j = 0u; j < SIZE; ++j) {
                    x[SIZE*i + j] = x[SIZE*i + j] - factor*x[SIZE*k + j];
                    inverse[SIZE*i + j] = inverse[SIZE*i + j] - factor*inverse[SIZE*k + j];
                }
            }
        }
    }
}
""",
}


def kernels(prefix: str, real: Real, used: Collection[tuple[str, int]]) -> list[str]:
    """The C functions of the kernels in `used`, (name, size), in the order of this file."""
    lines: list[str] = []
    for name, text in _C.items():
        for size in sorted(size for used_name, size in used if used_name == name):
            numbers = {"SIZE": size, "SQUARE": size * size, "LINE": size + 1}
            numbers |= {"SWEEPS": SWEEPS, "HALVINGS": HALVINGS, "DEGREE": DEGREE}
            filled = text.strip("\n").replace("REAL", real).replace("PREFIX", prefix)
            for word, number in numbers.items():
                filled = filled.replace(word, f"{number}u")
            for word, value in _VALUES.items():
                filled = filled.replace(word, literal(value, real))
            lines += [*filled.split("\n"), ""]
    return lines
