"""What a firmware engineer meets first: structs and functions at the top of a header, short functions in the source,
and a manual in the order of use, whose names and numbers are those of the C."""

import re
from pathlib import Path

import emitted
import numpy as np
import pytest

import hgogen as hg

GENERATED = sorted((Path(__file__).parent.parent / "generated").iterdir())
TOP, TOP_OF_TWO = 85, 53  # lines from the include guard to the first prototype
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
        r"(?:#.*|typedef struct \{|\} \w+;| *float \w+;"
        r"| *(?:struct \{|\} \w+; /\*\*<.*\*/|.*; +/\*\*<.*\*/)|extern \"C\" \{|)"
    )
    *before, _ = " ".join(lines).rsplit("/** @brief", 1)
    members = [line for line in lines if not line.lstrip().startswith(("/**", "* "))]
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


# --- comments of the C ----------------------------------------------------------------------------------------

EVERY = pytest.mark.parametrize("folder", GENERATED, ids=lambda folder: folder.name)
HEADED = "guard|suspect|plausible|counts_spoiled|find_signs|clear|beyond_box|value_lost|choose_recovery|fit_"


def source(folder: Path) -> str:
    return (folder / f"{folder.name}.c").read_text()


def manual(folder: Path) -> str:
    return (folder / f"{folder.name}.md").read_text()


@EVERY
def test_a_comment_names_the_macro_and_no_placeholder(folder: Path) -> None:
    assert not re.search(r"\bNAME_", header(folder) + source(folder) + manual(folder))
    assert f"{folder.name.upper()}_SAVED bytes, at any address" in header(folder)


@EVERY
def test_no_comment_is_cut(folder: Path) -> None:
    assert not re.search(r"\.\. \*/", header(folder) + source(folder))


@EVERY
def test_parameters_are_said_to_have_the_members_that_they_have(folder: Path) -> None:
    comment, members = re.search(
        r"/\*\* parameters([^*]*) \*/\n(.*?)\} \w+_params;", header(folder), re.DOTALL
    ).groups()  # type: ignore[union-attr]
    changed = re.search(r"change (.*), then call tune", comment)
    assert (changed[1].split(" or ") if changed else []) == re.findall(r"\} (plant|gain);", members)


@EVERY
def test_the_brief_of_a_step_says_what_nan_is_and_that_the_first_call_takes_no_time(folder: Path) -> None:
    (brief,) = re.findall(r"@brief (one sampling period(?:(?!@).)*)", header(folder), re.DOTALL)
    said = " ".join(brief.replace("\n *", " ").split())
    assert said.endswith("NaN means a missing sample; the first call advances no time")


@EVERY
def test_what_a_restart_keeps_is_said(folder: Path) -> None:
    assert "the whole state restarted" not in header(folder)
    for name in re.findall(r"unsigned used_(\w+);", header(folder)):
        assert f"/**< 0: an update with {name} may come, 1: none before the next predict */" in header(folder)


@EVERY
def test_each_function_of_the_guards_has_a_line_on_what_it_does(folder: Path) -> None:
    headed = re.findall(
        rf"(.*)\n(?:{folder.name.upper()}_\w+\n)?static [\w *]+ {folder.name}_((?:{HEADED})\w*)\(", source(folder)
    )
    assert headed
    assert [name for line, name in headed if not line.endswith("*/")] == []


# --- the manual -----------------------------------------------------------------------------------------------

HEADINGS = ["Use from C", "State, inputs, outputs", "Status bits", "Missing samples and faults", "Changing gains"]
HEADINGS += ["Saving and restoring", "Self-check", "Cost", "Source", "Plant"]


def rows(text: str, heading: str) -> list[list[str]]:
    """The cells of the table below a heading, without its head."""
    body = re.split(r"\n#", text.split(f"{heading}\n", 1)[1], maxsplit=1)[0]
    lines = [line for line in body.splitlines() if line.startswith("| ")][2:]
    return [[cell.replace("\\", "") for cell in line[2:-2].split(" | ")] for line in lines]


@EVERY
def test_the_manual_has_the_order_of_use_and_short_paragraphs(folder: Path) -> None:
    assert re.findall(r"^## (.*)", manual(folder), re.MULTILINE)[: len(HEADINGS)] == HEADINGS
    text = manual(folder).split("## Plant")[0]
    lines = [line for line in text.splitlines() if line and not line.startswith(("|", "#", "    "))]
    assert [line for line in lines if len(re.findall(r"[a-z0-9`)]\. ", line)) > 4 or len(line) > 600] == []


@EVERY
def test_the_manual_names_what_the_header_has(folder: Path) -> None:
    known = {*re.findall(r"\w+", header(folder)), f"{folder.name}_check"}
    words = set(re.findall(rf"\b{folder.name}_\w+|\b{folder.name.upper()}_\w+", manual(folder).replace("\\", "")))
    assert words - known == set()
    for place, *_ in rows(manual(folder), "### All members of state and parameters"):
        assert {part.split("[")[0] for part in place.strip("`").split(".")[1:]} <= known


@EVERY
def test_status_bits_are_a_table_and_macros_are_to_be_used(folder: Path) -> None:
    bits = re.findall(r"#define (\w+) +(?:UINT\d+_C\()?0x(\w+?)[u)]+\n\n", header(folder))
    printed = [(row[0].strip("`"), int(row[1].strip("`"), 16)) for row in rows(manual(folder), "## Status bits")]
    assert printed == [(name, int(value, 16)) for name, value in bits]
    assert "Use the macros: the number of a bit differs from one model to the next." in manual(folder)
    assert f"The ranges are in {folder.name}.md." in " ".join(header(folder).replace("\n *", " ").split())


def test_the_manual_has_start_ranges_and_resolution_of_each_state() -> None:
    step = emitted.step("pendulum")
    (z,) = (field for field in step.layout.state if field.name == "z")
    for real in ("float", "double"):
        text = hg.targets.c99(step, real=real, check=False)["pendulum.md"]
        table = rows(text, "### State of the observer")
        assert [row[:4] for row in table] == [["`s.z[0]`", "q", "rad", "0"], ["`s.z[1]`", "w", "rad/s", "0"]]
        assert [row[4:6] for row in table] == [
            [f"{s.interval[0]:g} .. {s.interval[1]:g}", f"{low:g} .. {high:g}"]
            for s, (low, high) in zip(step.states, z.box, strict=True)
        ]
        spacing = [[f"{np.spacing(np.float32(s.interval[1])):.1g}"] for s in step.states]
        assert [row[6:] for row in table] == (spacing if real == "float" else [[], []])
        assert ("is lost there" in text) == (real == "float")


@EVERY
def test_the_starts_of_the_manual_are_those_of_reset(folder: Path) -> None:
    """Of numbers that a reset assigns one by one."""
    body = source(folder).split(f"void {folder.name}_reset(", 1)[1].split("\n}\n")[0]
    assigned = {place: float(value.rstrip("fu")) for place, value in re.findall(r"s->(\w+) = ([-\d.e+]+[fu]);", body)}
    assert assigned
    printed = {
        row[0].strip("`").removeprefix("s."): row[2]
        for row in rows(manual(folder), "### All members of state and parameters")
    }
    assert {name: float(printed[name]) for name in assigned} == pytest.approx(assigned, rel=1e-7)


def test_the_manual_has_the_gains_that_init_computes() -> None:
    """Of the pendulum theta = 20 and both poles at -1: 2 theta, theta^2."""
    (folder,) = (each for each in GENERATED if each.name == "pendulum")
    members = {row[0]: row[2] for row in rows(manual(folder), "### All members of state and parameters")}
    assert members["`p.derived.K`"] == "40, 400"
