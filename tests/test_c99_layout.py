"""What a firmware engineer meets first: structs and functions at the top of a header, short functions in the source."""

import re
from pathlib import Path

import pytest

GENERATED = sorted((Path(__file__).parent.parent / "generated").iterdir())
TOP, TOP_OF_TWO = 85, 50  # lines from the include guard to the first prototype
MOST = 20  # paths through a function
BUNDLED = "_log"  # a chain of choices without a branch, one for each power of two


def header(folder: Path) -> str:
    return (folder / f"{folder.name}.h").read_text()


def top(text: str) -> list[str]:
    """The lines from the include guard to the first prototype."""
    lines = text.splitlines()
    guard = next(k for k, line in enumerate(lines) if re.match(r"#define \w+_H$", line))
    first = next(k for k, line in enumerate(lines) if re.match(r"(?:void|unsigned|uint\d+_t) \w+\(", line))
    return lines[guard:first]


def functions(text: str) -> dict[str, int]:
    """The cyclomatic complexity of each function."""
    text = re.sub(r"/\*.*?\*/|^#.*?$", " ", text, flags=re.DOTALL | re.MULTILINE)
    bodies = re.findall(r"^(?:\w+[ *]+)+(\w+)\([^;{}]*\)\n\{\n(.*?)^\}", text, flags=re.DOTALL | re.MULTILINE)
    return {name: 1 + len(re.findall(r"\b(?:if|for|while|case)\b|&&|\|\||\?", body)) for name, body in bodies}


@pytest.mark.parametrize("folder", GENERATED, ids=lambda folder: folder.name)
def test_structs_and_functions_come_first(folder: Path) -> None:
    lines = top(header(folder))
    assert len(lines) <= TOP
    short = re.compile(
        r"(?:#.*|typedef struct \{|\} \w+;| *(?:struct \{|\} \w+; /\*\*<.*\*/|.*; +/\*\*<.*\*/)|extern \"C\" \{|)"
    )
    *before, _ = " ".join(lines).rsplit("/** @brief", 1)
    members = [line for line in lines if not line.startswith(("/**", " *"))]
    assert before
    assert [line for line in members if not short.fullmatch(line)] == []


@pytest.mark.parametrize("name", ["van_der_pol", "pendulum", "duffing", "stribeck", "lotka_volterra"])
def test_of_two_states_a_screen_is_enough(name: str) -> None:
    (folder,) = (each for each in GENERATED if each.name == name)
    assert len(top(header(folder))) <= TOP_OF_TWO


@pytest.mark.parametrize("folder", GENERATED, ids=lambda folder: folder.name)
def test_no_function_has_many_paths(folder: Path) -> None:
    counted = functions((folder / f"{folder.name}.c").read_text())
    assert {f"{folder.name}_step", f"{folder.name}_restore"} <= counted.keys()
    assert {name: paths for name, paths in counted.items() if paths > MOST and not name.endswith(BUNDLED)} == {}


def test_paths_are_counted() -> None:
    assert functions("static int f(int a)\n{\n    if (a && a > 1) {\n        return a ? 1 : 2;\n    }\n}\n") == {"f": 4}
