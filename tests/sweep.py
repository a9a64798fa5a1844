"""Sweeps, a part of them in the ordinary run and the whole, or the rest, in the slow one."""

from collections.abc import Callable, Iterable
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import SearchStrategy

Check = Callable[..., None]


def sweep(few: int, many: int, *strategies: SearchStrategy[Any]) -> Callable[[Check], Check]:
    """A decorator that tries a check on `few` examples of the strategies, and in the slow run on `many`."""

    def decorated(check: Check) -> Check:
        @pytest.mark.parametrize("examples", [few, pytest.param(many, marks=pytest.mark.slow)])
        def test(examples: int) -> None:
            settings(max_examples=examples, deadline=None)(given(*strategies)(check))()

        test.__name__, test.__doc__, test.__module__ = check.__name__, check.__doc__, check.__module__
        return test

    return decorated


def by_turns(names: Iterable[str], variants: Iterable[str]) -> list[Any]:
    """All pairs of a name and a variant; in the ordinary run each name with one variant, by turns."""
    names, variants = list(names), list(variants)
    pairs = product(enumerate(names), enumerate(variants))
    ordinary = {(name, variant): j == k % len(variants) for (k, name), (j, variant) in pairs}
    return [pytest.param(*pair, marks=() if now else pytest.mark.slow) for pair, now in ordinary.items()]
