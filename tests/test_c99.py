"""Emitted C: no compiler warns, every compiler computes the recorded bits, and the text is the same everywhere."""

import operator
import os
import platform
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from datetime import UTC, datetime
from io import StringIO
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import casadi as ca
import emitted
import plants
import pytest
import sympy as sp
from emitted import compiled, files, parsed, run, step, tool
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.emit.code import COLUMNS
from hgogen.emit.node import CHOOSE, Node, ordered, read
from hgogen.emit.printer import Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.syntax import BeyondFloat
from hgogen.emit.syntaxes import C
from tests.sweep import by_turns

NAMES = list(emitted.STEPS)
REALS = ("float", "double")


def check(compiler: str, name: str, real: str, folder: Path, *flags: str) -> str:
    """What the self-check prints, compiled with `flags`."""
    program = compiled(tool(compiler), files(name, real), folder, *flags)
    return subprocess.run([program], capture_output=True, text=True, check=False).stdout


def passed(name: str) -> str:
    return f"{step(name).name}: 64 samples as recorded\n"


def exact(name: str) -> str:
    return f"-D{step(name).name.upper()}_EXACT"


# --- compilers ----------------------------------------------------------------------------------------------


@pytest.mark.ordinary("window_held-double", "one_state-float", "chained_in_x-float")
@pytest.mark.parametrize(("name", "real"), by_turns(NAMES, REALS))
def test_gcc_has_no_warning_and_every_bit_is_as_recorded(name: str, real: str, tmp_path: Path) -> None:
    assert check("gcc", name, real, tmp_path, "-O2", exact(name)) == passed(name)


@pytest.mark.ordinary("cascaded_tanks", "bent", "chained_in_x")
@pytest.mark.parametrize("name", NAMES)
def test_clang_has_no_warning_and_every_bit_is_as_recorded(name: str, tmp_path: Path) -> None:
    assert check("clang", name, "float", tmp_path, "-O2", exact(name)) == passed(name)


@pytest.mark.ordinary("pendulum--D__FRAMAC__", "cascaded_tanks--U__FLT_EVAL_METHOD__")
@pytest.mark.parametrize("other", ["-U__FLT_EVAL_METHOD__", "-D__FRAMAC__"])
@pytest.mark.parametrize("name", ["pendulum", "cascaded_tanks", "functions"])
def test_what_other_compilers_and_analysers_read_has_the_same_bits(name: str, other: str, tmp_path: Path) -> None:
    """The nearest whole number where the compiler may compute in more digits, the test of a number's size, and powers
    of two."""
    assert check("gcc", name, "float", tmp_path, "-O2", exact(name), other) == passed(name)


@pytest.mark.slow
@pytest.mark.parametrize("optimisation", ["-O0", "-O1", "-O3", "-Os"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", NAMES)
def test_no_optimisation_changes_a_bit(name: str, real: str, compiler: str, optimisation: str, tmp_path: Path) -> None:
    assert check(compiler, name, real, tmp_path, optimisation, exact(name)) == passed(name)


@pytest.mark.ordinary("fitzhugh_nagumo-float", "functions-float", "no_input-double")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "functions", "no_input"])
def test_the_library_s_functions_stay_within_the_tolerance(name: str, real: str, tmp_path: Path) -> None:
    macro = f"-D{step(name).name.upper()}_USE_LIBM"
    assert check("gcc", name, real, tmp_path, "-O2", macro) == passed(name)


@pytest.mark.ordinary("fitzhugh_nagumo-float", "fitzhugh_nagumo-double", "functions-float", "many_states-float")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "functions", "many_states"])
def test_contraction_stays_within_the_tolerance(name: str, real: str, tmp_path: Path) -> None:
    flags = ("-O3", "-march=native", "-ffp-contract=fast")
    assert check("gcc", name, real, tmp_path, *flags) == passed(name)


@pytest.mark.ordinary("fitzhugh_nagumo-float", "fitzhugh_nagumo-double")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "functions", "many_states", "integrated"])
def test_where_bits_differ_by_a_wider_format_it_is_said(name: str, real: str, tmp_path: Path) -> None:
    """FLT_EVAL_METHOD is 2 with the x87 unit: intermediate results have 64 bits."""
    if platform.machine() != "x86_64":
        pytest.skip("no x87 unit here")
    said = (
        f"{step(name).name}: 64 samples within the tolerance, for FLT_EVAL_METHOD is not 0 here and bits may differ\n"
    )
    assert check("gcc", name, real, tmp_path, "-O1", "-mfpmath=387", exact(name)) == said


# CMSIS-DSP's sine: linear interpolation between 512 values
_ARM_MATH = """
#include <math.h>
static inline float arm_between(float x, int quarter)
{
    const float at = 512.0f*(0.15915494f*x - floorf(0.15915494f*x));
    const int k = (int)at + quarter;
    const float a = sinf(0.012271846f*(float)k);
    const float b = sinf(0.012271846f*(float)(k + 1));
    return a + (b - a)*(at - floorf(at));
}
#define arm_sin_f32(x) arm_between(x, 0)
#define arm_cos_f32(x) arm_between(x, 128)
"""


@pytest.mark.ordinary("fitzhugh_nagumo")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "functions"])
def test_an_interpolated_sine_stays_within_its_tolerance(name: str, tmp_path: Path) -> None:
    (tmp_path / "arm_math.h").write_text(_ARM_MATH)
    assert check("gcc", name, "float", tmp_path, "-O2", f"-D{step(name).name.upper()}_USE_CMSIS") == passed(name)


@pytest.mark.ordinary("for_flash", "integrated", "redundant")
@pytest.mark.parametrize("name", NAMES)
def test_the_header_is_c_and_c_plus_plus_included_twice(name: str, tmp_path: Path) -> None:
    header = f"{step(name).name}.h"
    (tmp_path / header).write_text(files(name)[header])
    twice = f'#include "{header}"\n#include "{header}"\n{step(name).name}_state s;\n'
    for suffix, compiler, standard in ((".cpp", "g++", "-std=c++11"), (".c", "gcc", "-std=c99")):
        (tmp_path / f"twice{suffix}").write_text(twice)
        flags = ["-fsyntax-only", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", standard]
        run([tool(compiler), *flags, f"twice{suffix}"], tmp_path)


@pytest.mark.full
def test_two_systems_link_together(tmp_path: Path) -> None:
    texts = {**files("sin"), **files("x")}
    compiled(tool("gcc"), texts, tmp_path, "-O0", "-UX_CHECK_MAIN")


# --- text ---------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "two")
@pytest.mark.parametrize("name", NAMES)
def test_lines_are_short_and_tell_nothing_of_this_machine(name: str) -> None:
    for real in REALS:
        for file, text in files(name, real).items():
            assert text.endswith("\n")
            assert "\t" not in text
            for line in text.splitlines():
                assert line == line.rstrip()
                assert len(line) <= COLUMNS or line.startswith(("#", "    {")) or file.endswith(".md"), (
                    f"{file}: {line}"
                )
            for word in (str(Path.cwd()), str(Path.home()), socket.gethostname(), datetime.now(UTC).strftime("%Y-%m")):
                assert len(word) < 4 or word not in text


_EMIT = """
import hashlib, emitted
for name in ("fitzhugh_nagumo", "two", "no_input", "sin"):
    for real in ("float", "double"):
        for file, text in emitted.files(name, real).items():
            print(name, real, file, hashlib.sha256(text.encode()).hexdigest())
"""


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks")
@pytest.mark.parametrize("name", NAMES)
def test_the_end_of_a_comment_stands_with_its_words(name: str) -> None:
    """Alone on its line it ends a banner only, which begins alone."""
    for text in files(name).values():
        lines = text.splitlines()
        begun = [line.strip() for line in lines if line.strip().startswith("/*")]
        alone = [line for line in lines if line.strip() in ("*/", "* */")]
        assert len(alone) == begun.count("/*") + begun.count("/**")
        assert "* */" not in "".join(lines)


@pytest.mark.parametrize("name", ["two", "bank", "pendulum"])
def test_what_is_said_of_a_function_stands_right_above_it(name: str) -> None:
    """Its meaning, and that it runs rarely: no line is empty between them and its head."""
    text = files(name)[f"{step(name).name}.c"]
    assert "_RARELY\n" in text
    assert re.findall(r"(?:_RARELY|\*/)\n\n(?:static )?\w+ \w+\(.*", text) == []
    meaning = "/* memory without its mark is not used: the state begins anew, which the status says */\n"
    assert f"{meaning}{step(name).name.upper()}_RARELY\nstatic " in text


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", NAMES)
def test_the_self_check_s_banner_is_not_wrapped(name: str) -> None:
    """Its lines are broken where they mean to be, and what is to be defined stands in a column."""
    banner = files(name)[f"{step(name).name}_check.c"].partition(" */")[0].splitlines()[1:]
    assert len(banner) == 8
    upper = step(name).name.upper()
    assert [line.find("to ") for line in banner if f"{upper}_" in line] == [len(f" *   {upper}_CHECK_MAIN  ")] * 2
    assert banner[6].startswith(f" *   {' ' * len(upper)}             FLT_EVAL_METHOD of <float.h> 0")
    assert banner[7].startswith(f" *   {' ' * len(upper)}             rounded otherwise")


@pytest.mark.full
def test_the_same_bytes_in_every_process(tmp_path: Path) -> None:
    """In one that orders sets by another seed as in this one."""
    seed = "4294967295" if os.environ.get("PYTHONHASHSEED") == "0" else "0"
    environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(emitted.HERE)}
    listed = subprocess.run(
        [sys.executable, "-c", _EMIT], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert listed.count("\n") == 32
    with redirect_stdout(StringIO()) as here:
        exec(_EMIT, {})
    assert here.getvalue() == listed


def test_words_of_the_user_stay_in_their_comments(tmp_path: Path) -> None:
    a = hg.Signal("a", "*/ int i; /*", "a */ b /* c\n#error d ??/", low=-1, high=1)
    y = hg.Signal("y", "V \\", "\\")
    plant = hg.System("words", states=(a,), outputs=(y,), flow=[-a], output=[a])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)
    texts = hg.targets.c99(made, command="hgogen generate models/*.py */ #error")
    program = compiled(tool("gcc"), texts, tmp_path, "-O1", "-DWORDS_EXACT")
    assert subprocess.run([program], check=False).returncode == 0


@pytest.mark.ordinary("fitzhugh_nagumo-float", "fitzhugh_nagumo-double", "pendulum-float")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", NAMES)
def test_headers_and_casts_are_those_that_the_code_needs(name: str, real: str) -> None:
    source = re.sub(r"/\*.*?\*/", "", files(name, real)[f"{step(name).name}.c"], flags=re.DOTALL)
    included = set(re.findall(r"<(std\w+|limits)\.h>", source))
    words = set(re.findall(r"\w+", re.sub(r"#include.*", "", source)))
    wide = any(int(word[:-1]) > 0xFFFF for word in words if re.fullmatch(r"\d+u", word))
    integers = {"int32_t", "int64_t", "uint32_t", "__builtin_memcpy"}  # the last onto bits
    needed = {"stdbool": bool(words & {"bool", "true", "false"}), "stdint": bool(words & integers)}
    assert included == {header for header, there in (needed | {"limits": wide}).items() if there}
    for head, inner in re.findall(r"^([^\n]+)\n\{\n(.*?)^\}$", source, flags=re.DOTALL | re.MULTILINE):
        for pointer in re.findall(r"\*(\w+)[,)]", head):
            uses = len(re.findall(rf"(?<!->)(?<!\.)\b{pointer}\b", inner))
            assert uses == 1 if f"(void){pointer};" in inner else uses > 0, f"{pointer} of {head}"


@pytest.mark.ordinary("65536")
@pytest.mark.parametrize("periods", [65535, 65536])
def test_a_count_beyond_16_bits_is_refused_where_int_has_no_more(periods: int) -> None:
    member = hg.observers.high_gain(hg.forms.triangular(plants.chain(2)), theta=2, poles=(-1, -1))
    made = hg.sample(hg.observers.bank(member, count=2, period=periods * 2**-6), dt=2**-6)
    source = hg.targets.c99(made, check=False)[f"{made.name}.c"]
    guard = ("#include <limits.h>", "#if UINT_MAX <= 0xFFFF", "counts beyond 65535")
    assert f" >= {periods}u" in source
    assert [line in source for line in guard] == [periods > 65535] * 3


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["no_input", "window_held", "bank"])
def test_counters_are_computed_in_whole_numbers(name: str, real: str) -> None:
    """No place in a ring, member's number or time of a sample is read as a real number to be counted with."""
    source = files(name, real)[f"{step(name).name}.c"]
    assert "const unsigned t1 = " in source
    assert not re.search(rf"= \({real}\)[a-z]", source)


@pytest.mark.full
def test_few_bits_are_unsigned_and_more_have_32_or_64() -> None:
    assert (
        len(step("fitzhugh_nagumo").layout.bits)
        <= 16
        < len(step("wide").layout.bits)
        <= 32
        < len(step("wider").layout.bits)
    )
    assert "unsigned fitzhugh_nagumo_step(" in files("fitzhugh_nagumo")["fitzhugh_nagumo.h"]
    assert "uint32_t wide_step(" in files("wide")["wide.h"]
    assert "uint64_t wider_step(" in files("wider")["wider.h"]


@pytest.mark.parametrize("constant", [1e-60, 1e60])
def test_a_number_beyond_float_is_refused_in_float_only(constant: float) -> None:
    a, y = hg.Signal("a"), hg.Signal("y")
    plant = hg.System("beyond", states=(a,), outputs=(y,), flow=[-a + constant], output=[a])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)
    with pytest.raises(BeyondFloat, match="beyond the range of float"):
        hg.targets.c99(made)
    assert hg.targets.c99(made, real="double")


@pytest.mark.parametrize("compare", [operator.lt, operator.le, operator.eq, operator.ne])
def test_a_negated_comparison_of_counters_is_the_opposite_one(compare: Any) -> None:
    """Counters are never NaN, so that no ! is needed; such a comparison reads the same in Python."""
    symbols = [ca.SX.sym(name) for name in "ab"]
    graph = ca.Function("graph", symbols, [ca.logic_not(compare(*symbols))])
    names = {"inputs": lambda argument, _: Operand("ab"[argument]), "local": lambda argument, _: "ab"[argument]}
    printer = Printer(C, "unsigned", "x", **names)
    constants, result = printer.body(graph, [Target(lambda text: text, flag=True)])
    assert not constants.lines
    (line,) = result.lines
    for a, b in product(range(3), repeat=2):
        assert eval(line, {"a": a, "b": b}) is not compare(a, b)


def test_what_a_test_has_decided_is_not_asked_again() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    test, zero = a < b, ca.OP_IF_ELSE_ZERO
    twice = ca.SX.binary(zero, test, ca.SX.binary(zero, test, a))
    other = ca.SX.binary(zero, test, ca.SX.binary(zero, b < a, a))
    truths = (ca.logic_or(test, test), ca.logic_and(test, ca.SX(1)), ca.logic_or(ca.SX(0), test))
    graph = ca.Function("graph", [a, b], [twice, other, ca.logic_or(a, a), *truths])
    printer = Printer(C, "float", "x", inputs=lambda k, _: Operand("ab"[k]), local=lambda k, _: "ab"[k])
    targets = [Target(lambda text: text) for _ in range(3)] + [Target(lambda text: text, flag=True) for _ in truths]
    constants, result = printer.body(graph, targets)
    assert constants.lines == ("const bool t1 = a < b;",)
    once, inner, number, *flags = result.lines
    assert (once, inner) == ("t1 ? a : 0.0f", "t1 ? ((b < a) ? a : 0.0f) : 0.0f")
    assert number != "a"  # it is 0 or 1
    assert flags == ["t1"] * 3
    opposite = ca.SX.binary(zero, test, a - ca.SX.binary(zero, ca.logic_not(test), b))
    deep = ca.SX.binary(zero, test, a * ca.sin(ca.if_else(ca.logic_and(test, a < 0), b, a)))
    graph = ca.Function("graph", [a, b], [opposite, deep])
    printer = Printer(C, "float", "x", inputs=lambda k, _: Operand("ab"[k]), local=lambda k, _: "ab"[k])
    _, result = printer.body(graph, targets[:2])
    assert result.lines[0] == "t1 ? a - 0.0f : 0.0f"
    assert result.lines[1] == "t1 ? a*x_sin((a < 0.0f) ? b : a) : 0.0f"


_OPS: dict[int, Callable[..., float]] = {
    ca.OP_LT: operator.lt,
    ca.OP_NOT: operator.not_,
    ca.OP_AND: lambda a, b: a and b,
    ca.OP_OR: lambda a, b: a or b,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_NEG: operator.neg,
    ca.OP_IF_ELSE_ZERO: lambda test, yes: yes if test else 0.0,
    CHOOSE: lambda test, yes, no: yes if test else no,
}


def same_values(graph: ca.Function) -> bool:
    """Whether the nodes that are read from a graph of three inputs have its values."""
    outputs = [node for output in read(graph) for node in output]
    for values in product((-1.0, 0.0, 2.0), repeat=3):
        results = dict[Node, float]()
        for node in ordered(outputs):
            if node.op == ca.OP_INPUT:
                results[node] = values[node.source[0]]
            elif node.op == ca.OP_CONST:
                results[node] = node.constant
            else:
                results[node] = _OPS[node.op](*(results[arg] for arg in node.args))
        if [results[node] for node in outputs] != [float(value) for value in graph(*values)]:
            return False
    return True


def test_a_branch_that_is_also_used_elsewhere_is_not_decided() -> None:
    inputs = [ca.SX.sym(name) for name in "abc"]
    first, second = inputs[0] < inputs[1], inputs[1] < inputs[2]
    inner = ca.SX.binary(ca.OP_IF_ELSE_ZERO, second, inputs[0] * inputs[2])
    shared = ca.SX.binary(ca.OP_IF_ELSE_ZERO, first, inputs[1] - inner)
    both = ca.SX.binary(ca.OP_IF_ELSE_ZERO, ca.logic_and(first, second), inputs[0] + shared)
    assert same_values(ca.Function("graph", inputs, [both, shared]))


@settings(max_examples=300, deadline=None)
@given(st.randoms(use_true_random=False))
def test_choices_within_choices_have_the_values_of_the_graph(random: Random) -> None:
    numbers = [*(inputs := [ca.SX.sym(name) for name in "abc"])]
    tests = [inputs[0] < inputs[1], inputs[1] < inputs[2]]
    for _ in range(12):
        test, other = random.choice(tests), random.choice(tests)
        tests.append(random.choice([ca.logic_not(test), ca.logic_and(test, other), ca.logic_or(test, other)]))
        yes, no = random.choice(numbers[-4:]), random.choice(numbers)
        kinds = [ca.SX.binary(ca.OP_IF_ELSE_ZERO, test, yes), ca.if_else(test, yes, no), yes + no, -yes]
        numbers.append(random.choice(kinds))
    assert same_values(ca.Function("graph", inputs, numbers[-2:]))


def test_a_bit_that_is_never_raised_is_not_printed() -> None:
    graph = ca.Function("graph", [], [ca.SX(0), ca.SX(1)])
    never, always = (
        Target(lambda _, line=f"raise {name};": line, raised=lambda test: (test,)) for name in ("never", "always")
    )
    printer = Printer(C, "float", "x", inputs=lambda *_: Operand(""), local=lambda *_: "")
    constants, result = printer.body(graph, [never, always])
    assert (constants.lines, result.lines) == ((), ("raise always;",))


# --- the self-check -----------------------------------------------------------------------------------------

# what an engineer may mistype: a coefficient of the model, of the method, of the guards; a sign; an index
SEEDED = [
    ("2.4f*", "2.5f*"),
    ("0.0016666667f", "0.00167f"),
    ("0.005f", "0.0051f"),
    ("0.33333334f", "0.3334f"),
    ("(reading, 15.0f)", "(reading, 1.5f)"),
    ("100.0f", "99.0f"),
    ("s->L[1] = l31", "s->L[1] = l21"),
    ("const float d2 = w2_1*t", "const float d2 = -w2_1*t"),
    ("|= FITZHUGH_NAGUMO_REUSED_U", "|= FITZHUGH_NAGUMO_CLAMPED_U"),
]


@pytest.mark.full
def test_the_self_check_catches_what_is_mistyped(tmp_path: Path) -> None:
    name, source = "fitzhugh_nagumo", files("fitzhugh_nagumo")["fitzhugh_nagumo.c"]
    for right, wrong in SEEDED:
        assert right in source, right
        texts = {**files(name), f"{name}.c": source.replace(right, wrong, 1)}
        program = compiled(tool("gcc"), texts, tmp_path, "-O0", exact(name))
        returncode = subprocess.run([program], check=False).returncode
        assert returncode == 1, f"{right} became {wrong}"


def test_fast_math_is_refused(tmp_path: Path) -> None:
    """It assumes away what is not a number, and so the guards; the self-check alone would not always notice."""
    with pytest.raises(AssertionError, match="ffast-math drops the guards"):
        compiled(tool("gcc"), files("fitzhugh_nagumo"), tmp_path, "-O2", "-ffast-math")


@pytest.mark.full
def test_sums_in_another_order_are_refused(tmp_path: Path) -> None:
    """The nearest whole number is had by a sum and a difference, which then cancel: exp(2.2) would be 8. A macro
    tells of it in GCC, in clang the self-check."""
    flags = ("-O2", "-funsafe-math-optimizations")
    with pytest.raises(AssertionError, match="spoils the bundled functions"):
        compiled(tool("gcc"), files("fitzhugh_nagumo"), tmp_path, *flags)
    said = check("clang", "fitzhugh_nagumo", "float", tmp_path, *flags)
    assert said == "fitzhugh_nagumo: sample 2 differs\n"


@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "two"])
def test_clang_without_nan_is_found_out_by_the_self_check(name: str, tmp_path: Path) -> None:
    """No macro tells of it, and the recorded samples alone do not always notice."""
    said = check("clang", name, "float", tmp_path, "-O2", "-fno-honor-nans", exact(name))
    assert said == f"{step(name).name}: sample 21 differs\n"
    assert "not a number" in files(name)[f"{step(name).name}_check.c"]


@pytest.mark.ordinary(
    "float-fitzhugh_nagumo-gcc",
    "float-pendulum-gcc",
    "float-two-gcc",
    "float-bank-gcc",
    "double-functions-gcc",
    "double-functions-clang",
    "double-tables-gcc",
)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "two", "functions", "tables", "bank"])
@pytest.mark.parametrize("real", ["float", "double"])
def test_no_comparison_of_floats_is_warned_of(compiler: str, name: str, real: str, tmp_path: Path) -> None:
    parsed(tool(compiler), files(name, real), tmp_path, "-Wfloat-equal", "-fsyntax-only")


@pytest.mark.ordinary("clang")
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_equal_numbers_are_equal_as_in_python(compiler: str, tmp_path: Path) -> None:
    """A model that asks whether two numbers are one: by a function of ours, 0 and -0 among them; no warning."""
    x, u = hg.Signal("x", low=-2, high=2), hg.Signal("u", low=-2, high=2)
    rest = sp.Piecewise((1, sp.Eq(u, 1)), (2, sp.Ne(sp.floor(x), 0)), (0, True))
    plant = hg.System("same", states=(x,), inputs=(u,), outputs=(hg.Signal("y"),), flow=[rest - x], output=[x])
    made = hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1], R=1), dt=0.01)
    texts = hg.targets.c99(made, real="double")
    assert "same_equal(" in texts["same.c"]
    assert " != 0.0" not in texts["same.c"]
    program = compiled(tool(compiler), texts, tmp_path, "-O2", "-DSAME_EXACT", "-Wfloat-equal")
    assert subprocess.run([program], check=False).returncode == 0
