"""What is said of a member of a struct where a model says little of it."""

import pytest

from hgogen.emit.structs import described
from hgogen.program import Field


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ({"low": (0.7,), "high": (1.2,)}, "0.7 .. 1.2"),
        ({"unit": "1/m", "low": (0.0,), "high": (0.3,)}, "[1/m], 0 .. 0.3"),
        ({"unit": "1/m", "low": (2.0,), "high": (2.0,)}, "[1/m], fixed at 2"),
        ({"meaning": "drag", "unit": "1/m", "low": (0.0,), "high": (0.3,)}, "drag [1/m], 0 .. 0.3"),
        ({"low": (0.0,), "high": (4e9 / 9,)}, "0 .. 4.4444445e+08"),
        ({}, ""),
    ],
)
def test_what_is_said_begins_with_the_first_thing_that_is_known(said: dict, text: str) -> None:
    assert described(Field("c", (0.1,), **said), "float") == text
