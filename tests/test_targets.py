"""What every target is: a pure function from a step to texts; and what a language of the commands has besides."""

import shutil
from functools import cache
from inspect import Parameter, signature
from itertools import product

import emitted
import pytest

import hgogen as hg
from hgogen.commands.building import _languages
from hgogen.errors import HgogenError
from hgogen.run import native
from hgogen.target import Files, Sources

TARGETS = hg.targets.__all__
LANGUAGES = _languages()
COMMAND = "hgogen generate something --of this"
EVERY_KIND = ("pendulum", "bank", "delayed", "many_states", "for_flash", "tables")  # of statement and of function
REALS = ("float", "double")
BROKEN = "print('sample 3'); raise SystemExit(1)"
each = pytest.mark.parametrize("target", LANGUAGES)


@cache
def files(target: str, name: str, real: str = "float", check: bool = True) -> Sources:
    return getattr(hg.targets, target)(emitted.step(name), real=real, command=COMMAND, check=check)


# --- every target


@pytest.mark.ordinary(
    "pendulum-c99",
    "pendulum-casadi",
    "pendulum-lanes",
    "pendulum-markdown",
    "pendulum-record",
    "pendulum-rust",
    "bank-markdown",
    "no_input-markdown",
)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["pendulum", "bank", "no_input"])
def test_a_target_is_a_pure_function_of_a_step_to_texts(target: str, name: str) -> None:
    made, emit = emitted.step(name), getattr(hg.targets, target)
    first, again = emit(made), emit(made)
    assert isinstance(first, Files)
    assert dict(first) == dict(again)
    assert list(first)
    assert all(file.startswith((f"{made.name}_", f"{made.name}.")) for file in first)
    assert all(isinstance(text, str) and text for text in first.values())


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_takes_a_step_and_then_a_precision_by_name(target: str) -> None:
    first, *others = signature(getattr(hg.targets, target)).parameters.values()
    assert first.name == "step"
    assert "real" in [each.name for each in others]
    assert all(each.kind is Parameter.KEYWORD_ONLY and each.default is not Parameter.empty for each in others)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("real", ["half", None])
def test_a_precision_that_there_is_not_is_refused(target: str, real: str | None) -> None:
    with pytest.raises(HgogenError, match=f'real = {real!r} .*"double"'):
        getattr(hg.targets, target)(emitted.step("pendulum"), real=real)


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_no_step_is_refused(target: str) -> None:
    with pytest.raises(HgogenError, match=f"str given to {target} is no step; make one by hg.sample"):
        getattr(hg.targets, target)("pendulum")


# --- a language of the commands


def test_c_and_rust_are_languages() -> None:
    assert {"c99", "rust"} <= set(LANGUAGES)


def test_a_target_that_takes_a_command_is_a_language() -> None:
    """It takes a precision and `check` too, and is then offered by `--target`."""
    takes = {target for target in TARGETS if "command" in signature(getattr(hg.targets, target)).parameters}
    assert takes == set(LANGUAGES)


@pytest.mark.ordinary("pendulum-c99", "pendulum-rust", "bank-rust")
@each
@pytest.mark.parametrize("name", ["pendulum", "bank"])
def test_a_language_is_pure_and_says_what_made_it(target: str, name: str) -> None:
    made, again = emitted.step(name), getattr(hg.targets, target)
    written = files(target, name)
    assert written == again(made, real="float", command=COMMAND)
    assert all(text.endswith("\n") and "\t" not in text for text in written.values())
    assert all(file.startswith(made.name) for file in written)
    spoken = " ".join(" ".join(written.values()).translate(str.maketrans("*/!", "   ")).split())
    assert COMMAND in spoken


@each
@pytest.mark.parametrize("real", REALS)
def test_the_self_check_is_a_file_of_its_own(target: str, real: str) -> None:
    whole, bare = files(target, "pendulum", real), files(target, "pendulum", real, check=False)
    assert set(whole) - set(bare) == {next(file for file in whole if "_check." in file)}
    code = {file for file in bare if not file.endswith(".md")}  # the manual says how it is run
    assert {file: whole[file] for file in code} == {file: bare[file] for file in code}
    assert not bare.recipe


@pytest.mark.ordinary("pendulum-c99")
@each
@pytest.mark.parametrize("name", EVERY_KIND)
def test_it_is_run_where_its_tools_are(target: str, name: str) -> None:
    assert checked(target, name, "float") == f"{emitted.step(name).name}: 64 samples as recorded\n"


@pytest.mark.slow
@each
@pytest.mark.parametrize(
    ("name", "real"), [pair for pair in product(emitted.STEPS, REALS) if pair not in product(EVERY_KIND, ["float"])]
)
def test_every_other_step_is_run_where_its_tools_are(target: str, name: str, real: str) -> None:
    """In both precisions: those of C and Rust have more tests, those of a new language only these."""
    assert checked(target, name, real) == f"{emitted.step(name).name}: 64 samples as recorded\n"


def checked(target: str, name: str, real: str) -> str:
    """What the self-check prints."""
    written = files(target, name, real)
    try:
        return native.run_recipe(written) if written.recipe else native.run_check(written)
    except (native.NoTool, native.NoCompiler) as error:
        pytest.skip(str(error))


@pytest.mark.ordinary("a tool")
@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        ((("python3", "-c", "pass"), ("python3", "-c", BROKEN)), r"the self-check failed: \S*python3 .*\nsample 3$"),
        ((("python3", "-c", BROKEN), ("python3", "-c", "pass")), r"sample 3\nmend it, or name another by \$PYTHON3$"),
    ],
    ids=["the check", "a tool"],
)
def test_a_recipe_that_fails_says_which_part_of_it(recipe: tuple[tuple[str, ...], ...], message: str) -> None:
    with pytest.raises(HgogenError, match=f"(?s){message}") as raised:
        native.run_recipe(Sources((), recipe))
    assert "$CC" not in str(raised.value)
    assert "engine=" not in str(raised.value)
    assert raised.value.status == 1


@pytest.mark.parametrize(("tool", "variable"), [("rustc", "RUSTC"), ("c++", "CXX"), ("clang++", "CLANGXX")])
def test_a_shell_can_set_the_variable_of_a_tool(tool: str, variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert str(native.NoTool(tool)).endswith(f"or name another by ${variable}")
    monkeypatch.setenv(variable, "python3")
    assert native.tool(tool) == shutil.which("python3")


def test_a_self_check_in_c_that_fails_is_no_failure_of_the_compiler() -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    with pytest.raises(native.CheckFailed, match=r"the self-check failed: .*check\n"):
        native.run_check({"a.c": "int main(void) { return 1; }\n"})
