"""What every target is: a pure function from a step to texts; and what a language of the commands has besides."""

from functools import cache

import emitted
import pytest

import hgogen as hg
from hgogen.calling import native
from hgogen.commands.building import _languages
from hgogen.emit.syntax import BadReal
from hgogen.target import Sources

LANGUAGES = _languages()
COMMAND = "hgogen generate something --of this"
each = pytest.mark.parametrize("target", LANGUAGES)


@cache
def files(target: str, name: str, real: str = "float", check: bool = True) -> Sources:
    return getattr(hg.targets, target)(emitted.step(name), real=real, command=COMMAND, check=check)


def test_there_are_languages() -> None:
    assert {"c99", "rust"} <= set(LANGUAGES)


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
@pytest.mark.parametrize("real", ["float", "double"])
def test_the_self_check_is_a_file_of_its_own(target: str, real: str) -> None:
    whole, bare = files(target, "pendulum", real), files(target, "pendulum", real, check=False)
    assert set(whole) - set(bare) == {next(file for file in whole if "_check." in file)}
    assert {file: whole[file] for file in bare} == dict(bare)
    assert not bare.recipe


@each
def test_it_is_run_where_its_tools_are(target: str) -> None:
    written = files(target, "pendulum")
    try:
        printed = native.run_recipe(written) if written.recipe else native.run_check(written)
    except (native.NoTool, native.NoCompiler) as error:
        pytest.skip(str(error))
    assert printed == "pendulum: 64 samples as recorded\n"


@each
def test_a_precision_that_there_is_not_is_refused(target: str) -> None:
    with pytest.raises(BadReal, match='real = \'half\' must be "float" or "double"'):
        getattr(hg.targets, target)(emitted.step("pendulum"), real="half")
