"""The function of a table in emitted code: `search`, then the `return` of its degree; see `hgogen.algebra.lookup`.

The words are those of `emit.notation`, and the arrays of the table.
"""

Array = list[float]
FIRST = n = 0  # the largest power of two that is not above the number n of breakpoints
start: Array = []  # the breakpoint below each cell
c0: Array = []
c1: Array = []
c2: Array = []
c3: Array = []
k, d = 0, 0.0


def search(x: float) -> float:
    """How many breakpoints are at or below x, by steps of powers of two; what it returns is left to the degree."""
    k = 0
    probe = FIRST
    while probe > 0:
        if k + probe <= n and start[k + probe] <= x:
            k = k + probe
        probe = probe // 2
    d = x - start[k]
    return c0[k] + d


def degree_0() -> float:
    """A step, which is not a number where x is none."""
    return c0[k] + d * 0.0


def degree_1() -> float:
    """A line."""
    return c0[k] + d * c1[k]


def degree_2() -> float:
    """A parabola."""
    return c0[k] + d * (c1[k] + d * c2[k])


def degree_3() -> float:
    """A cubic."""
    return c0[k] + d * (c1[k] + d * (c2[k] + d * c3[k]))
