"""The cases that others stand for in the ordinary run, made of the times of a run:

    .venv/bin/python -m pytest -q -m "not slow" --junitxml=times.xml
    .venv/bin/python tests/full_cases.py times.xml > tests/full_cases.txt

Of a test with several cases these are the ones above `LONG` seconds that no seeded bug names, but the quickest where
none is named. `conftest.py` marks them as `full`.
"""

import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

LONG = 0.3
HERE = Path(__file__).resolve().parent


def named() -> set[str]:
    """The tests that seeded bugs name, of all cases or of one."""
    rows = tomllib.loads((HERE / "mutations.toml").read_text(encoding="utf-8"))["mutation"]
    return {test for row in rows for test in row.get("tests", ())}


def long_cases(times: str, known: set[str]) -> Iterator[str]:
    """The names of the cases, of a file of times in JUnit's format."""
    families = defaultdict(list)
    for case in ElementTree.parse(times).getroot().iter("testcase"):
        name = f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}"
        families[name.partition("[")[0]].append((float(case.attrib["time"]), name))
    for family, cases in families.items():
        stand = {name for _, name in cases} & known or {min(cases)[1]}
        if family not in known:
            yield from (name for time, name in cases if time >= LONG and name not in stand)


if __name__ == "__main__":
    print(*sorted(long_cases(sys.argv[1], named())), sep="\n")
