"""The kernels of `hgogen.kernels` as C functions with loops; REAL, PREFIX and SIZE are filled in."""

from collections.abc import Collection

from hgogen.cprint import Real, literal

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
}


def kernels(prefix: str, real: Real, used: Collection[tuple[str, int]]) -> list[str]:
    """The C functions of the kernels in `used`, (name, size), in the order of this file."""
    lines: list[str] = []
    for name, text in _C.items():
        for size in sorted(size for used_name, size in used if used_name == name):
            filled = text.strip("\n").replace("REAL", real).replace("SIZE", f"{size}u")
            filled = filled.replace("ZERO", literal(0, real)).replace("ONE", literal(1, real)).replace("PREFIX", prefix)
            lines += [*filled.split("\n"), ""]
    return lines
