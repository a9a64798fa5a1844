"""Columns of a form that push in one direction are one: what is left of the form, and what a solver finds with it."""

import numpy as np
import pytest

from hgogen.prove.quadratic import Quadratic
from hgogen.prove.semidefinite import margin, merge_parallel_columns

Array = np.ndarray


def pushed(weights: Array, rng: np.random.Generator) -> Quadratic:
    """e' = M e + g u + h w + v, of which u = weights p; what a p reads, e alone; an input v that reads nothing."""
    n, k = 3, len(weights) + 2
    M, one = rng.standard_normal((n, n)) - 5 * np.eye(n), np.eye(n + k)
    push = np.outer(rng.standard_normal(n), weights)
    rates = np.hstack([M, push, rng.standard_normal((n, 2))])
    reads = np.hstack([0.3 * rng.standard_normal((k, n)), np.zeros((k, k))])
    reads[-1] = 0
    return Quadratic(((one[:n], rates),), reads, one[n:])


@pytest.mark.parametrize("seed", range(5))
def test_the_form_that_is_left_is_the_largest_of_the_whole(seed: int) -> None:
    """Of all p that add to the same u; what is alone stays as it is."""
    rng, weights = np.random.default_rng(seed), np.array([2.0, -0.5, 1.0])
    form = pushed(weights, rng)
    (less,), (group,) = merge_parallel_columns(form)
    assert less.size == form.size - 2
    assert sorted(group.places) == [0, 1, 2]
    assert group.weights[0] == 1
    assert np.array(group.weights) * 2 == pytest.approx(weights[list(group.places)])
    P, S = np.eye(3), rng.uniform(0.5, 2, len(form.Q))
    T = 1 / (np.array(group.weights) ** 2 / S[list(group.places)]).sum()
    whole, left = form.value(P, S), less.value(P, S)
    left[group.column, group.column] -= T
    for _ in range(20):
        v = rng.standard_normal(less.size)
        p = T * v[group.column] * np.array(group.weights) / S[list(group.places)]  # the least that adds to u
        full = np.zeros(form.size)
        full[:3], full[3 + np.array(group.places)] = v[:3], p
        full[6:] = [v[column] for place in (3, 4) for column in range(3, less.size) if less.Z[place, column]]
        assert full @ whole @ full == pytest.approx(v @ left @ v)
        others = rng.standard_normal(3)
        others -= others @ group.weights / (np.array(group.weights) @ group.weights) * np.array(group.weights)
        full[3 + np.array(group.places)] += others
        assert full @ whole @ full <= v @ left @ v


@pytest.mark.parametrize("seed", range(5))
def test_with_it_a_solver_finds_weights_of_the_whole(seed: int) -> None:
    form = pushed(np.array([0.5, -0.25, 1.0]), np.random.default_rng(seed))
    best, known = margin([form], "a test"), margin([form], "a test", priced=True)
    assert best is not None
    assert known is not None
    assert (best.margin > 0) == (known.margin > 0)
    if best.margin > 0:
        assert np.linalg.eigvalsh(form.value(best.P, best.S)).max() <= -best.margin * (1 - 1e-3)


def test_columns_that_push_alike_and_read_otherwise_are_two() -> None:
    form = pushed(np.array([1.0, 1.0]), np.random.default_rng(0))
    reads = form.Q.copy()
    reads[:, 3] = 1.0  # what the first p brings into what others read
    assert not merge_parallel_columns(Quadratic(form.pairs, reads, form.Z))[1]
