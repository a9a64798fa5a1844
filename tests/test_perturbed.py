"""Searches of gains and proofs find the same, whatever rounds: by a perturbed solver, and by other kernels of BLAS."""

from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from perturbed import KERNELS, SEARCHES, Answer, differences, elsewhere, perturbed

pytest.importorskip("clarabel")

ORDINARY = ("common norm", "noise of a filter", "L2 gain")
FIRST = ORDINARY[1]  # whose bound one solve left at anything up to twice the least


@cache
def plain(search: str) -> Answer:
    return SEARCHES[search]()


def marked(some: Any, ordinary: Any) -> list[Any]:
    return [pytest.param(each, marks=() if each in ordinary else pytest.mark.slow) for each in some]


@pytest.mark.ordinary(
    "common norm-constraints", "noise of a filter-constraints", "L2 gain-answers", "L2 gain-constraints"
)
@pytest.mark.parametrize("what", ["answers", "constraints"])
@pytest.mark.parametrize("search", marked(SEARCHES, ORDINARY))
def test_a_perturbed_solver_leads_to_the_same(search: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = plain(search)

    @settings(max_examples=1 if search in ORDINARY else 4)
    @given(st.integers(0, 2**32 - 1))
    def check(seed: int) -> None:
        solver = perturbed(monkeypatch, what, seed)
        assert differences(expected, SEARCHES[search]()) == []
        assert solver.asked

    check()


@pytest.mark.full
@pytest.mark.parametrize("kernel", marked(KERNELS, KERNELS[-1:]))
def test_the_kernels_of_a_processor_do_not_matter(kernel: str) -> None:
    assert differences(plain(FIRST), elsewhere(FIRST, kernel, threads=1)) == []


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("search", [search for search in SEARCHES if search != FIRST])
def test_nor_does_the_number_of_threads(search: str, threads: int) -> None:
    """With the kernels that are farthest from those of today's processors."""
    assert differences(plain(search), elsewhere(search, KERNELS[-1], threads)) == []


def test_differences_are_told() -> None:
    one: Answer = {"w": 1.0, "claim": "proved"}
    assert differences(one, {"w": 1.04, "claim": "proved"}) == []
    assert differences(one, {"w": 0.94, "claim": "unknown"}) != []
    assert len(differences(one, {"w": 0.94, "claim": "unknown"})) == 2
    assert len(differences(one, {"w": 1.0})) == 1
