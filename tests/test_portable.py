"""Functions that are written once and printed in every language: all of them are there, and have the bits of Python."""

import ast
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import emitted
import plants
import pytest

import hgogen as hg
from hgogen.discretisation import kernels as matrix_loops
from hgogen.discretisation import notation
from hgogen.discretisation.kernels import KERNELS
from hgogen.emit import helpers
from hgogen.emit.portable import functions_of, kernels, passed, small_functions
from hgogen.emit.statements import Writer, routines
from hgogen.emit.syntax import Number, Syntax
from hgogen.emit.syntaxes import RUST, C
from hgogen.program import Kernel, walk
from hgogen.run import native


@cache
def forgetting() -> hg.Step:
    """The information of each state is renewed."""
    form = hg.forms.state_affine(plants.chain(12))
    return hg.sample(hg.observers.kalman_like(form, rho=1.0, R=1.0), dt=0.01)


@cache
def bilinear() -> hg.Step:
    """A resolvent of a balanced matrix."""
    observer = hg.observers.high_gain(hg.forms.triangular(plants.chain(3)), theta=5, poles=(-1, -1, -1))
    return hg.sample(observer, hg.methods.bilinear, dt=0.01)


STEPS: dict[str, Callable[[], hg.Step]] = {
    "forgetting": forgetting,
    "bilinear": bilinear,
    "many_states": lambda: emitted.step("many_states"),
    "exponential": lambda: emitted.step("exponential"),
    "gated_columns": lambda: emitted.step("gated_columns"),
    "noisy_inputs": lambda: emitted.step("noisy_inputs"),
}


def used(made: hg.Step) -> set[str]:
    programs = (*made.code.program, *made.code.tuning)
    return {statement.name for statement in walk(programs) if isinstance(statement, Kernel)}


@pytest.mark.full
def test_every_kernel_is_written_as_loops_and_run_below() -> None:
    assert set(KERNELS) <= set(functions_of(matrix_loops))
    assert set().union(*(used(make()) for make in STEPS.values())) == set(KERNELS)


@pytest.mark.ordinary("forgetting-float", "bilinear-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", ["forgetting", "bilinear"])
def test_its_loops_have_the_bits_of_python_in_c(name: str, real: str) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    made = STEPS[name]()
    files = hg.targets.c99(made, real=real)
    assert "samples as recorded" in native.run_check(files, ("-O2", f"-D{made.name.upper()}_EXACT"))


@pytest.mark.ordinary("flags0-double", "flags1-float", "flags2-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("flags", [("-O3", "-march=native"), ("-O2",), ("-O2", "-D__clang__")])
def test_loops_over_whole_vectors_have_the_same_bits(real: str, flags: tuple[str, ...]) -> None:
    """GCC makes them; of what says that it is another compiler they are as for a board."""
    if native.compiler() is None:
        pytest.skip("no C compiler")
    made, files = emitted.step("many_states"), emitted.files("many_states", real)
    upper = made.name.upper()
    assert f"{upper}_VECTOR*{upper}_VECTOR" in files[f"{made.name}.c"]
    assert f"static {upper}_OFTEN {real} {made.name}_abs" in files[f"{made.name}.c"]
    exact = ("-ffp-contract=off", f"-D{upper}_EXACT")
    assert "samples as recorded" in native.run_check(files, (*flags, *exact))


@pytest.mark.ordinary("bilinear-float", "bilinear-double")
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("name", ["forgetting", "bilinear"])
def test_its_loops_have_the_bits_of_python_in_rust(name: str, real: str) -> None:
    try:
        assert "samples as recorded" in native.run_recipe(hg.targets.rust(STEPS[name](), real=real))
    except native.NoTool as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("syntax", [C, RUST], ids=["c", "rust"])
def test_what_a_function_calls_comes_before_it(syntax: object) -> None:
    lines = "\n".join(kernels(syntax, "p", "float", {("exponential", 3)}).lines)
    assert 0 < lines.index("p_product(") < lines.index("p_exponential(")
    lines = "\n".join(small_functions(syntax, "p", "float", {"whole", "floor", "within"}).lines)
    assert 0 < lines.index("p_within(") < lines.index("p_whole(") < lines.index("p_floor(")


def test_arrays_are_lent_and_numbers_are_given() -> None:
    assert passed(RUST, "correct") == ["&mut {}", "&mut {}", "&{}", "{}", "&mut {}", "{}"]
    assert passed(C, "correct") == ["{}"] * 6


@pytest.mark.parametrize("module", [helpers, matrix_loops])
def test_its_words_are_those_of_the_notation(module: object) -> None:
    """And its own functions, parameters and locals."""
    known = {*vars(notation), *functions_of(module), "range", "int", "float", "bool"}
    for tree in functions_of(module).values():
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
        own = {each.arg for each in tree.args.args} | {node.id for node in nodes if isinstance(node.ctx, ast.Store)}
        assert {node.id for node in nodes} <= known | own


# --- what C and Rust leave as it is, and another language may not


class Bracketed(Syntax):
    """A language whose literals are calls."""

    def marked(self, digits: str, kind: Number) -> str:
        return f"<{kind} {digits}>"


def test_every_literal_is_written_by_the_syntax() -> None:
    language = Bracketed(**vars(C))
    lines = "\n".join(small_functions(language, "p", "float", {"floor", "inf"}).lines)
    assert "<float 3e38>" in lines
    assert "<float 8388608.0>" in lines
    assert language.literal(0.5, "double") == "<double 0.5>"


def test_a_member_is_copied_as_the_language_does_it() -> None:
    made = emitted.step("bank")
    program = [statement for section in made.code.sections for statement in section.program]
    lines = Writer(replace(C, copied="copy({target}, {source});"), made, "float").function(program).lines
    assert any(re.fullmatch(r" *copy\(s->\w+\[.*\], s->\w+\[.*\]\);", line) for line in lines)


def rounded_alone(line: str) -> bool:
    """Whether each sum, difference, product and quotient on the right of a line stands in a call of r."""
    text = (
        re.sub(r"(?<=\d)f\b", "", line.rpartition(" = ")[2].strip().rstrip(";"))
        .replace("->", ".")
        .replace("in.", "input.")
    )
    nodes = list(ast.walk(ast.parse(text, mode="eval")))
    calls = [node for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "r"]
    wrapped = {id(node.args[0]) for node in calls}
    return all(id(node) in wrapped for node in nodes if isinstance(node, ast.BinOp))


def test_an_operation_is_rounded_where_the_language_lacks_the_precision() -> None:
    made, language = emitted.step("pendulum"), replace(C, rounded={"float": "r({})"})
    program = [statement for section in made.code.sections for statement in section.program]
    bodies = {real: Writer(language, made, real).function(program).lines for real in ("float", "double")}
    writer = Writer(language, made, "float")
    bodies["float"] += routines(writer, writer.subprograms).lines
    bodies["float"] += kernels(language, "p", "float", {("correct", 3)}).lines
    computed = [
        line for line in bodies["float"] if re.search(r" = [^=]*[-+*/]", line) and not re.search("[?!&|]", line)
    ]
    computed = [line for line in computed if not re.search(r"\bunsigned\b|\du\b", line)]
    assert sum("r(" in line for line in computed) > 20
    assert all(rounded_alone(line) for line in computed)
    assert not any(re.search(r"\br\(", line) for line in bodies["double"])


@pytest.mark.full
def test_what_is_rounded_has_the_same_bits_where_the_precision_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    for module in ("hgogen.targets.c99", "hgogen.emit.syntaxes"):
        monkeypatch.setattr(sys.modules[module], "C", replace(C, rounded={"float": "((float)({}))"}))
    files = hg.targets.c99(forgetting())
    assert "(float)(" in "".join(files.values())
    assert "samples as recorded" in native.run_check(files, ("-O2", "-DCHAIN_EXACT"))
