"""SX matrices of a form: by entries, a choice of two, and one that has an inverse wherever it is evaluated."""

from collections.abc import Iterable, Sequence

import casadi as ca

from hgogen.graph import Graph


def filled(places: Iterable[tuple[int, int]], values: Sequence[Graph], n: int) -> Graph:
    """The SX matrix (n, n), sparse, with these values at (row, column)."""
    matrix = ca.SX(n, n)
    for place, value in zip(places, values, strict=True):
        matrix[place] = value
    return ca.sparsify(matrix)


def either(test: Graph, yes: Graph, no: Graph) -> Graph:
    """The matrix `yes` where the test holds, elsewhere `no`; an entry that is the same in both does not ask."""
    chosen = ca.densify(yes)
    for k in range(chosen.numel()):
        if not ca.is_equal(chosen[k], no[k]):
            chosen[k] = ca.if_else(test, chosen[k], no[k])
    return chosen


def regular_at(matrix: Graph, test: Graph) -> Graph:
    """The matrix where the test holds, elsewhere one that has an inverse as well: nothing is divided by 0.

    Its pivots are 1 there, and what is off them 0 but for one that is triangular in an order.
    """
    blocks, rows, columns, *_ = matrix.sparsity().btf()
    pivots = set(zip(rows, columns, strict=True))
    regular = ca.SX(matrix)
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        pivot = (i, j) in pivots
        moves = not matrix[i, j].is_constant() if pivot else blocks < len(rows)
        if moves:
            regular[i, j] = ca.if_else(test, matrix[i, j], float(pivot))
    return regular
