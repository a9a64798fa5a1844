"""Loops in the place of statements alike: the same bits, whatever is read and written, and a text that stays short."""

import ctypes
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import casadi as ca
import emitted
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.emit.code import Code
from hgogen.emit.printer import LEAST, NEVER, Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.syntaxes import C
from hgogen.run import native

N = 9
ARRAYS = ("a", "z", "w")  # of which the last two are written
Rows = Callable[[Mapping[str, list[ca.SX]], int, float], list[ca.SX]]
compiled = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


def clipped(column: list[ca.SX], k: int) -> ca.SX:
    return column[min(max(k, 0), N - 1)]


# what a row k may be, of arrays, a shift and a number
ROWS: Mapping[str, Rows] = {
    "shifted": lambda at, s, c: [clipped(at["z"], k + s) * at["a"][k] + c for k in range(N)],
    "turned round": lambda at, s, c: [at["z"][N - 1 - k] - c * at["a"][k] for k in range(N)],
    "with its own number": lambda at, s, c: [(c + k) * at["w"][k] + clipped(at["z"], s) for k in range(N)],
    "strided": lambda at, s, c: [at["w"][0], *(clipped(at["z"], 2 * k - 1) + at["a"][k] for k in range(1, N))],
    "a number": lambda at, s, c: [ca.SX(c)] * N,
    "a copy": lambda at, s, c: [clipped(at["w"], k + s) for k in range(N)],
    "of shared values": lambda at, s, c: shared(at, s, c),
    "of one sum": lambda at, s, c: [total(at, c) * at["a"][k] for k in range(N)],
    "of a sum each": lambda at, s, c: [total({**at, "z": at["z"][k:] + at["z"][:k]}, c) for k in range(N)],
    "of the one before": lambda at, s, c: chained(at, c),
    "a choice": lambda at, s, c: [ca.if_else(everywhere(at, c), at["a"][k], clipped(at["z"], k - s)) for k in range(N)],
    "a sum with signs": lambda at, s, c: [ca.sum1(ca.vertcat(*at["z"][: k + 1])) - at["w"][k] for k in range(N)],
}


def shared(at: Mapping[str, list[ca.SX]], s: int, c: float) -> list[ca.SX]:
    values = [a * z + c for a, z in zip(at["a"], at["z"], strict=True)]
    return [values[k] * values[(k + s) % N] + values[0] for k in range(N)]


def total(at: Mapping[str, list[ca.SX]], c: float) -> ca.SX:
    result = ca.SX(c)
    for a, z in zip(at["a"], at["z"], strict=True):
        result = result + a * z
    return result


def chained(at: Mapping[str, list[ca.SX]], c: float) -> list[ca.SX]:
    rows = [at["z"][0]]
    for k in range(1, N):
        rows.append(rows[-1] * at["a"][k] + c)
    return rows


def everywhere(at: Mapping[str, list[ca.SX]], c: float) -> ca.SX:
    result = at["z"][0] < c
    for z in at["z"][1:]:
        result = ca.logic_and(result, z < c)
    return result


def text(function: ca.Function, least: int, size: int = N) -> list[str]:
    """The C function f(a, z, w) that writes the outputs of a function of (a, z, w) to z and w."""
    constants, statements = code(function, least, size)
    return ["void f(const double *a, double *z, double *w)", "{", *constants.lines, *statements.lines, "}"]


def code(function: ca.Function, least: int, size: int = N) -> tuple[Code, Code]:
    """Its constants, and its statements."""
    printer = Printer(
        C,
        real="double",
        prefix="f",
        inputs=lambda argument, element: Operand(f"{ARRAYS[argument]}[{element}]", local=False),
        local=lambda argument, element: f"{ARRAYS[argument]}{element + 1}",
        indexed=lambda argument: ARRAYS[argument],
        least=least,
        reserved=set(ARRAYS),
    )
    targets = [target(argument, element) for argument in (1, 2) for element in range(size)]
    return printer.body(function, targets, hoist=[1, 2])


def target(argument: int, element: int) -> Target:
    def written(number: object, value: str) -> str:
        return f"{ARRAYS[argument]}[{number}] = {value};"

    return Target(
        lambda value: written(element, value),
        array=ARRAYS[argument],
        element=element,
        each=written,
        source=(argument, element),
    )


def run(lines: Sequence[str], folder: Path, arrays: Sequence[np.ndarray]) -> None:
    (folder / "f.c").write_text("\n".join(["#include <stdbool.h>", *lines, ""]))
    flags = (
        "-std=c99",
        "-O1",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        "-Wall",
        "-Wextra",
        "-Wno-unused-parameter",
        "-Werror",
    )
    subprocess.run([native.compiler(), *flags, "f.c", "-o", "f.so"], cwd=folder, check=True)
    pointers = [array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in arrays]
    library = ctypes.CDLL(str(folder / "f.so"))
    library.f(*pointers)
    handle = library._handle
    del library
    ctypes.CDLL(None).dlclose(ctypes.c_void_p(handle))


shifts, numbers = st.integers(-2, 2), st.sampled_from([0.5, -1.25, 0.0])


@pytest.mark.ordinary("shifted", "turned round", "with its own number")
@compiled
@pytest.mark.parametrize("kind", ROWS)
@given(st.sampled_from(sorted(ROWS)), st.tuples(shifts, shifts), st.tuples(numbers, numbers), st.integers(0, 1000))
@settings(deadline=None, max_examples=6)
def test_loops_write_the_bits_of_the_block(
    tmp_path_factory: pytest.TempPathFactory,
    kind: str,
    other: str,
    shifts: tuple[int, int],
    numbers: tuple[float, float],
    seed: int,
) -> None:
    """Every right-hand side is evaluated before anything is written, whichever way the rows read each other."""
    symbols = {name: ca.SX.sym(name, N) for name in ARRAYS}
    at = {name: ca.vertsplit(symbol) for name, symbol in symbols.items()}
    values = [ca.vertcat(*ROWS[each](at, *of)) for each, *of in zip((kind, other), shifts, numbers, strict=True)]
    function = ca.Function("block", list(symbols.values()), ca.cse(values))
    draw = np.random.default_rng(seed)
    arrays = [draw.normal(size=N) for _ in ARRAYS]
    expected = [np.array(value).ravel() for value in function(*arrays)]
    run(text(function, LEAST["flash"]), tmp_path_factory.mktemp("rolled"), arrays)
    assert [array.tobytes() for array in arrays[1:]] == [value.tobytes() for value in expected]


def either_twice(at: Mapping[str, list[ca.SX]]) -> list[ca.SX]:
    """Alike but for which of two values comes again."""
    pairs = [(a + 1.5, w - 0.5) for a, w in zip(at["a"], at["w"], strict=True)]
    return [pair[0] * pair[1] + pair[k % 2] for k, pair in enumerate(pairs)]


def either_array(at: Mapping[str, list[ca.SX]]) -> list[ca.SX]:
    """Alike but for which of two arrays of shared values is read first."""
    pairs = [(a * z + 0.5, a - w) for a, z, w in zip(*at.values(), strict=True)]
    return [(pair[k % 2] - pair[1 - k % 2]) * sum(pairs[(k + 1) % N]) for k, pair in enumerate(pairs)]


@compiled
@pytest.mark.parametrize("rows", [either_twice, either_array])
def test_values_that_are_nearly_alike_are_told_apart(rows: Callable[..., list[ca.SX]], tmp_path: Path) -> None:
    a, z, w = symbols = [ca.SX.sym(name, N) for name in ARRAYS]
    at = dict(zip(ARRAYS, map(ca.vertsplit, symbols), strict=True))
    function = ca.Function("block", [a, z, w], ca.cse([ca.vertcat(*rows(at)), w]))
    lines, arrays = text(function, LEAST["flash"]), [*np.random.default_rng(0).normal(size=(len(ARRAYS), N))]
    expected = np.array(function(*arrays)[0]).ravel()
    assert any("for (" in line for line in lines)
    run(lines, tmp_path, arrays)
    assert arrays[1].tobytes() == expected.tobytes()


def test_a_loop_begins_with_the_row_after_one_that_is_elsewhere() -> None:
    a, z, w = (ca.SX.sym(name, N + 1) for name in ARRAYS)
    rows = [0.5 * a[3], *(0.5 * a[k + 1] for k in range(1, N))]
    function = ca.Function("block", [a, z, w], [ca.vertcat(*rows, z[N]), w])
    assert text(function, N - 1, N + 1)[2:-1] == [
        "z[0] = 0.5*a[3];",
        "for (unsigned j = 1u; j < 9u; ++j) {",
        "    z[j] = 0.5*a[j + 1u];",
        "}",
    ]


def test_what_is_alike_is_a_loop_from_so_many_on() -> None:
    a, z, w = (ca.SX.sym(name, N) for name in ARRAYS)
    function = ca.Function("block", [a, z, w], [z + 0.5 * a, w])
    assert text(function, N + 1)[2:-1] == text(function, NEVER)[2:-1] != text(function, N)[2:-1]
    assert text(function, N)[2:-1] == [
        "for (unsigned j = 0u; j < 9u; ++j) {",
        "    z[j] = z[j] + 0.5*a[j];",
        "}",
    ]


def test_a_number_that_differs_is_one_of_a_table() -> None:
    a, z, w = (ca.SX.sym(name, N) for name in ARRAYS)
    numbers = [0.0, -2.0] * 4 + [1.5]
    function = ca.Function("block", [a, z, w], [ca.vertcat(*map(ca.SX, numbers)), w])
    assert text(function, 8)[2:-1] == [
        "static const double t1[9] = {0.0, -2.0, 0.0, -2.0, 0.0, -2.0, 0.0, -2.0, 1.5};",
        "for (unsigned j = 0u; j < 9u; ++j) {",
        "    z[j] = t1[j];",
        "}",
    ]


def test_ranges_about_zero_need_one_table() -> None:
    a, z, w = (ca.SX.sym(name, N) for name in ARRAYS)
    limited = [ca.fmin(ca.fmax(a[k], -1 - k), 1 + k) for k in range(N)]
    lines = text(ca.Function("block", [a, z, w], [ca.vertcat(*limited), w]), 8)[2:-1]
    assert lines == [
        "static const double t1[9] = {1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0};",
        "for (unsigned j = 0u; j < 9u; ++j) {",
        "    z[j] = f_limit(a[j], t1[j]);",
        "}",
    ]


def test_ranges_of_which_only_the_first_is_about_zero_need_both_ends() -> None:
    a, z, w = (ca.SX.sym(name, N) for name in ARRAYS)
    limited = [ca.fmin(ca.fmax(a[k], -1 - 2 * k), 1 + k) for k in range(N)]
    lines = text(ca.Function("block", [a, z, w], [ca.vertcat(*limited), w]), 8)[2:-1]
    assert lines == [
        "static const double t1[9] = {1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0};",
        "static const double t2[9] = {-1.0, -3.0, -5.0, -7.0, -9.0, -11.0, -13.0, -15.0, -17.0};",
        "for (unsigned j = 0u; j < 9u; ++j) {",
        "    z[j] = f_clamp(a[j], t2[j], t1[j]);",
        "}",
    ]


def test_a_loop_counts_up_to_its_last_element() -> None:
    """Which says how wide a counter must be."""
    a, z, w = (ca.SX.sym(name, N) for name in ARRAYS)
    function = ca.Function("block", [a, z, w], [ca.vertcat(z[0], 0.5 * a[1:]), w])
    _, statements = code(function, N - 1)
    assert statements.uses.widest == N


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
@pytest.mark.parametrize("prefer", ["speed", "flash"])
def test_few_lines_come_with_a_state(prefer: str) -> None:
    """Entries of tables, what the covariance's columns cost for speed, powers of theta, the estimate: no guard.

    Over many states, since where lines are broken and which block repeats often enough for a loop changes in steps.
    """
    few, many = 12, 40
    steps = (emitted.coupled(n, prefer=prefer) for n in (few, many))
    lines = [len(hg.targets.c99(each, check=False)["coupled.c"].splitlines()) for each in steps]
    assert lines[1] - lines[0] <= (many - few) * {"speed": 11, "flash": 9}[prefer]


@pytest.mark.full
def test_for_flash_triangles_are_gone_through() -> None:
    """What is alike in four elements is a loop for flash, and for speed in eight, of no triangle."""
    speed, flash = (hg.targets.c99(emitted.coupled(5, prefer=p), check=False)["coupled.c"] for p in ("speed", "flash"))
    assert speed.count("for (unsigned j") < 4 < flash.count("for (unsigned j")
