"""What the files of `rules/` hold, put together: each has `RULES`, and of what another file has nothing twice."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from .errors import RecheckError
from .rule import Rule


@dataclass(eq=False)
class BadRules(RecheckError):
    """A file of rules that is none, or that says again what another one says."""

    file: str
    reason: str

    def __str__(self) -> str:
        return f"{self.file.rpartition('.')[2]}.py in the folder of rules {self.reason}"


def rules_of(files: Iterable[ModuleType]) -> tuple[Rule, ...]:
    """The rules of all files. Raises: `BadRules` for a file that has none."""
    every: list[Rule] = []
    for file in files:
        rules = getattr(file, "RULES", None)
        if not isinstance(rules, tuple) or not all(isinstance(rule, Rule) for rule in rules):
            raise BadRules(file.__name__, "has no RULES, a tuple of Rule: what its claims are verified by")
        every += rules
    return tuple(every)


def merged(files: Iterable[ModuleType], key: str) -> Mapping[str, Any]:
    """The mappings that files have under a name. Raises: `BadRules` where two files have a row of one name."""
    rows: dict[str, Any] = {}
    where: dict[str, str] = {}
    for file in files:
        for name, row in getattr(file, key, {}).items():
            if name in rows:
                other = where[name].rpartition(".")[2]
                raise BadRules(file.__name__, f"has a row {name!r} in {key}, as {other}.py has; keep one of the two")
            rows[name], where[name] = row, file.__name__
    return rows
