"""The search of a table's cell in emitted code, along one of its axes; see `hgogen.algebra.lookup`.

The words are those of `emit.notation`, and what stands for a lookup's argument, array and cell.
"""

Array = list[float]
FIRST = n = 0  # the largest power of two that is not above the number n of breakpoints
start: Array = []  # the breakpoint below each cell


def search(x: float) -> float:
    """The distance of x from the start of its cell k: as many breakpoints are at or below x, which steps of powers of
    two find."""
    k = 0
    probe = FIRST
    while probe > 0:
        if k + probe <= n and start[k + probe] <= x:
            k = k + probe
        probe = probe // 2
    return x - start[k]
