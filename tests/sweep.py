"""Random examples, few in the ordinary run and many in the slow one."""

from collections.abc import Callable
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
