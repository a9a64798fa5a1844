"""Folders that projects take as they are: what lies where, what the README says, and that it compiles."""

import re
import shutil
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import emitted
import numpy as np
import pytest
from emitted import run, step, tool

import hgogen as hg
from hgogen.extras.costs import MEANINGS, digest
from hgogen.extras.folder import ReservedName, UnknownEcosystem, chosen, folder, known
from hgogen.run.native import WARNINGS

NAMES = ("pendulum", "bank", "no_input", "delayed", "tunable", "wide")
EVERY = {"README.md", "example/main.c", "src/pendulum.h", "src/pendulum.c", "src/pendulum_check.c", "pendulum.md"}
OWN = {
    "cmake": {"CMakeLists.txt"},
    "platformio": {"library.json"},
    "arduino": {"library.properties", "examples/pendulum/pendulum.ino"},
    "zephyr": {"zephyr/module.yml", "zephyr/Kconfig", "zephyr/CMakeLists.txt"},
    "esp-idf": {"CMakeLists.txt", "idf_component.yml"},
}


@cache
def made(name: str, words: str = "all") -> Mapping[str, str]:
    sources = {**emitted.files(name), **hg.targets.markdown(step(name), real="float")}
    return folder(step(name), sources, chosen(words, step(name).name))


def lying(name: str, where: Path, words: str = "all") -> Path:
    """The folder on the disk."""
    hg.write(made(name, words), where / step(name).name)
    return where / step(name).name


# --- what lies where ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("ecosystem", known())
def test_a_folder_has_what_its_ecosystem_asks_for_and_nothing_else(ecosystem: str) -> None:
    assert set(made("pendulum", ecosystem)) == EVERY | OWN[ecosystem]


def test_all_is_every_one_of_them_in_one_folder() -> None:
    assert set(made("pendulum")) == EVERY.union(*OWN.values())
    both = made("pendulum", "zephyr, arduino")
    assert set(both) == EVERY | OWN["zephyr"] | OWN["arduino"]
    assert [line for line in both["README.md"].splitlines() if line.startswith("## ")][:2] == [
        "## Arduino",
        "## Zephyr",
    ]
    assert made("pendulum")["src/pendulum.c"] == emitted.files("pendulum")["pendulum.c"]


@pytest.mark.parametrize("name", NAMES)
def test_no_place_of_a_template_is_left(name: str) -> None:
    assert not {path for path, text in made(name).items() if re.search(r"%\{|%[a-z]", text) and "src/" not in path}


@pytest.mark.parametrize("name", NAMES)
def test_texts_end_with_a_line_and_are_narrow(name: str) -> None:
    for path, text in made(name).items():
        assert text.endswith("\n"), path
        assert not re.search(r"[ \t]$", text, re.MULTILINE), path
        assert path.endswith(".md") or max(map(len, text.splitlines())) <= 120 or path.startswith("src/"), path


def test_what_is_no_ecosystem_is_refused() -> None:
    with pytest.raises(UnknownEcosystem, match=r"--for ardiuno: there is no such ecosystem; did you mean arduino\?"):
        chosen("cmake,ardiuno", "pendulum")
    with pytest.raises(UnknownEcosystem, match="there are cmake, platformio, arduino, zephyr, esp-idf, and all"):
        chosen("", "pendulum")


@pytest.mark.parametrize(("word", "name", "title"), [("cmake", "Test", "CMake"), ("all", "main", "ESP-IDF")])
def test_a_name_that_an_ecosystem_has_for_its_own_is_refused(word: str, name: str, title: str) -> None:
    with pytest.raises(ReservedName, match=f"the name {name} is {title}'s own; take another by --name"):
        chosen(word, name)
    assert chosen("zephyr", name)


# --- what the README says -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_readme_has_every_bit_and_every_member(name: str) -> None:
    readme, header, each = made(name)["README.md"], emitted.files(name)[f"{step(name).name}.h"], step(name)
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \|$", readme, re.MULTILINE)
    macros = re.findall(r"^#define (\w+(?<!_READY)) +(?:UINT\d\d_C\()?0x", header, re.MULTILINE)
    assert [name_ for name_, *_ in rows] == macros
    assert [(said, asked) for _, said, asked in rows] == [
        (bit.meaning, each.action_of(bit)) for bit in each.layout.bits
    ]
    members = re.findall(r"^\| `(\w+)\.([\w.]+)` \|", readme, re.MULTILINE)
    assert [(a, b) for a, b in members if a != "p"] == [
        (short, signal.name)
        for short, signals in (("in", each.inputs), ("measurement", each.samples), ("x", each.states))
        for signal in signals
    ]
    fields = (*each.layout.plant, *each.layout.gains)
    assert {b.partition(".")[2] for a, b in members if a == "p"} == {field.name for field in fields}


def test_the_readme_names_the_parts_that_may_be_called_apart() -> None:
    said = " ".join(made("bank")["README.md"].split())
    functions = ("bank_predict", "bank_update_y", "bank_update_v", "bank_adapt", "bank_update_y_at", "bank_update_v_at")
    assert f"call the parts of a step: {', '.join(f'`{name}`' for name in functions)}. The header says how." in said
    assert all(f" {name}(" in made("bank")["src/bank.h"] for name in functions)
    assert "parts of a step" not in made("pendulum")["README.md"]


def test_a_bar_in_a_meaning_ends_no_cell() -> None:
    y = hg.Signal("y", "m", "what | is measured\nat once", low=-1, high=1)
    x = hg.Signal("x", low=-1, high=1)
    plant = hg.System("barred", states=(x,), outputs=(y,), flow=[-x], output=[x])
    one = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=0.1)
    readme = folder(one, hg.targets.c99(one, check=False), ())["README.md"]
    assert "| `measurement.y` | what \\| is measured at once [m], -1 .. 1 |" in readme


@pytest.mark.parametrize("name", NAMES)
def test_the_lines_to_write_compile(name: str, tmp_path: Path) -> None:
    where, own = lying(name, tmp_path), step(name).name
    (lines,) = re.findall(r"^```c\n(.*?)^```", made(name)["README.md"], re.MULTILINE | re.DOTALL)
    include, structs, rest = re.fullmatch(r'(#include "\w+\.h")\n\n(.*?)\n\n(.*)', lines, re.DOTALL).groups()
    assert structs.count(";") == structs.count("\n") + 1
    text = f"{include}\n{structs}\nvoid use(void);\nvoid use(void)\n{{\n{rest.replace('...', '0')}\n(void)status;\n}}\n"
    (where / "use.c").write_text(text)
    run([tool("gcc"), "-std=c99", *WARNINGS, "-Isrc", "-c", "use.c"], where)
    (order,) = re.findall(r"^`\w+_step` takes (.*), in this order; ", made(name)["README.md"], re.MULTILINE)
    arguments = ", ".join(f"&{each}" for each in re.findall(r"`(\w+)`", order))
    assert f" = {own}_step({arguments});" in lines


def test_costs_are_told_of_the_same_source_only() -> None:
    numbers = dict(zip(MEANINGS, (410, 516, 2448, 56, 76), strict=True))
    files, ways = emitted.files("pendulum"), chosen("cmake", "pendulum")
    source = {"machine": "Cortex-M4F", "compiler": "gcc 1", "flags": "-O2", "source": digest(files["pendulum.c"])}
    readme = folder(step("pendulum"), files, ways, costs={**numbers, **source})["README.md"]
    assert "On a Cortex-M4F, compiled by gcc 1 with `-O2`:" in readme
    assert all(f" | {value} |\n" in readme for value in numbers.values())
    another = {**numbers, **source, "source": digest("of another")}
    for other in (another, source, {**numbers, "source": source["source"]}):  # the others lack numbers, or the tools
        unknown = folder(step("pendulum"), files, ways, costs=other)["README.md"]
        assert unknown == made("pendulum", "cmake")["README.md"]
        assert "`hgogen cost` measures" in unknown


# --- by plain compilers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_example_runs_on_a_host_without_a_warning(name: str, tmp_path: Path) -> None:
    where = lying(name, tmp_path)
    sources = [f"src/{step(name).name}.c", "example/main.c"]
    run([tool("gcc"), "-std=c99", *WARNINGS, "-Isrc", *sources, "-o", "program", "-lm"], where)
    run([str(where / "program")], where)


def test_the_example_counts_every_interrupt_and_shows_the_last_estimate(tmp_path: Path) -> None:
    """With a measurement that moves, and what main reads printed."""
    text = made("pendulum")["example/main.c"]
    text = text.replace("return 0.0f;", "return 0.001f*(float)samples;").replace("(void)x.q;", 'printf("%g\\n", x.q);')
    (tmp_path / "main.c").write_text("#include <stdio.h>\n" + text)
    where = lying("pendulum", tmp_path)
    run([tool("gcc"), "-std=c99", "-Isrc", "../main.c", "src/pendulum.c", "-o", "program"], where)
    shown = [float(line) for line in run([str(where / "program")], where).split()]
    ramp = 1e-3 * np.arange(1000)
    follower = step("pendulum")
    follower.reset()  # other tests may have run it
    wanted = follower.run(u=ramp, y=ramp, engine="python")["q"]
    assert shown == pytest.approx(wanted.tolist(), abs=1e-5)


_ARDUINO = """
#pragma once
#define DEC 10
#define HEX 16
#define OCT 8
unsigned long micros();
struct Port { void begin(long); void print(double); void print(unsigned long, int); void print(char); void println(); };
extern Port Serial;
"""
_BOARD = """
#include <Arduino.h>
#include <cstdio>
void setup();
void loop();
Port Serial;
static unsigned long now;
unsigned long micros() { return now; }
void Port::begin(long) {}
void Port::print(double) { std::printf("x"); }
void Port::print(unsigned long, int) { std::printf("s"); }
void Port::print(char) {}
void Port::println() { std::printf("\\n"); }
int main() { setup(); for (now = 0; now < 2500000; now += 100) loop(); }
"""


@pytest.mark.parametrize("name", ["pendulum", "delayed", "wide"])
def test_a_sketch_compiles_with_all_of_src_and_keeps_the_period(name: str, tmp_path: Path) -> None:
    """As the IDE does: every source of src/, the sketch as C++ behind Arduino's header, of which this is a stub."""
    where, own = lying(name, tmp_path, "arduino"), step(name).name
    (where / "Arduino.h").write_text(_ARDUINO)
    (where / "board.cpp").write_text(_BOARD)
    shutil.copy(where / "examples" / own / f"{own}.ino", where / "sketch.cpp")
    run(
        [
            tool("gcc"),
            "-std=gnu11",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-Isrc",
            "-c",
            *map(str, (where / "src").glob("*.c")),
        ],
        where,
    )
    objects = [path.name for path in where.glob("*.o")]
    assert len(objects) == 2
    flags = ["-std=gnu++11", "-Wall", "-Wextra", "-Werror", "-I.", "-Isrc"]
    run([tool("g++"), *flags, "sketch.cpp", "board.cpp", *objects, "-o", "program"], where)
    shown = run([str(where / "program")], where).splitlines()
    assert shown == ["s" + "x" * len(step(name).states)] * 2  # in two and a half seconds


def test_a_signal_may_have_the_name_of_a_macro_of_arduino_s_header(tmp_path: Path) -> None:
    x, y = hg.Signal("DEC", "deg", "declination", low=-1, high=1), hg.Signal("HEX", low=-1, high=1)
    plant = hg.System("star", states=(x,), outputs=(y,), flow=[-x], output=[x])
    one = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=0.1)
    hg.write(folder(one, hg.targets.c99(one, check=False), chosen("arduino", "star")), tmp_path)
    (tmp_path / "Arduino.h").write_text(_ARDUINO)
    flags = ["-std=gnu++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-x", "c++", "-I.", "-Isrc"]
    run([tool("g++"), *flags, "examples/star/star.ino"], tmp_path)


@pytest.mark.parametrize(("time", "dt", "counted"), [("s", 0.5, "micros 500000"), ("d", 0.05, "millis 4320000")])
def test_a_sketch_counts_a_period_that_its_clock_can_hold(time: str, dt: float, counted: str) -> None:
    x, y = hg.Signal("x", low=-1, high=1), hg.Signal("y", low=-1, high=1)
    plant = hg.System("slow", states=(x,), outputs=(y,), flow=[-x], output=[x], time=time)
    one = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=dt)
    sketch = folder(one, hg.targets.c99(one, check=False), chosen("arduino", "slow"))["examples/slow/slow.ino"]
    clock, ticks = counted.split()
    assert f"{clock}() - next" in sketch
    assert f"next += {ticks}ul;" in sketch
    assert "if (++count >= 2u)" in sketch if time == "s" else "if (++count >= 1u)" in sketch


def test_a_library_for_arduino_says_what_its_specification_asks() -> None:
    lines = made("pendulum")["library.properties"].splitlines()
    values = dict(line.split("=", 1) for line in lines)
    asked = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url", "architectures"}
    assert set(values) == asked | {"includes"}
    assert re.fullmatch(r"[A-Za-z0-9][\w .-]{0,62}", values["name"])
    assert re.fullmatch(r"\d+\.\d+\.\d+", values["version"])
    assert values["category"] in (
        *("Display", "Communication", "Signal Input/Output", "Sensors", "Device Control", "Timing"),
        *("Data Storage", "Data Processing", "Other"),
    )
