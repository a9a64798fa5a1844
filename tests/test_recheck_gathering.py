"""The files of rules are put together, and one that does not fit is told of by a sentence."""

from types import ModuleType
from typing import Any

import pytest

from hgogen.recheck.file import ObserverKeys
from hgogen.recheck.rules import OBSERVERS, RULES, BadRules, merged, rules_of
from hgogen.recheck.rules import continuous_time as rules


def file(name: str, **parts: Any) -> ModuleType:
    """A module of these names, as a file of rules is."""
    module = ModuleType(f"hgogen.recheck.rules.{name}")
    vars(module).update(parts)
    return module


def test_what_the_files_hold_is_put_together() -> None:
    assert set(rules.RULES) < set(RULES)
    assert rules.OBSERVERS.items() < OBSERVERS.items()
    assert rules_of((file("one", RULES=rules.RULES[:2]), file("two", RULES=rules.RULES[2:]))) == (rules.RULES)


@pytest.mark.parametrize("parts", [{}, {"RULES": None}, {"RULES": ("margin.convergence",)}])
def test_a_file_without_rules(parts: dict[str, Any]) -> None:
    said = r"^margin\.py in the folder of rules has no RULES, a tuple of Rule: what its claims are verified by$"
    with pytest.raises(BadRules, match=said):
        rules_of((rules, file("margin", **parts)))


@pytest.mark.parametrize("key", ["OBSERVERS", "NEEDED"])
def test_one_name_in_two_files(key: str) -> None:
    """The later one would take the place of the other, whose rules then read numbers that no file has."""
    files = (
        file(name, **{key: {"low_power": ObserverKeys((number,))}}) for name, number in (("one", "gains"), ("two", "L"))
    )
    said = rf"^two\.py in the folder of rules has a row 'low_power' in {key}, as one\.py has; keep one of the two$"
    with pytest.raises(BadRules, match=said):
        merged(files, key)
