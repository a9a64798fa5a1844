"""The headers are Doxygen's: it reads every comment without a warning, and each function, field and macro has one."""

import re
from collections.abc import Mapping
from pathlib import Path

import emitted
import plants
import pytest

import hgogen as hg
from hgogen.model import load

SHIPPED = sorted(path.stem for path in plants.MODELS.glob("*.*") if path.suffix in (".py", ".toml", ".json"))
SETTINGS = """
QUIET = YES
WARN_AS_ERROR = FAIL_ON_WARNINGS
WARN_IF_UNDOCUMENTED = YES
WARN_NO_PARAMDOC = YES
EXTRACT_ALL = NO
OPTIMIZE_OUTPUT_FOR_C = YES
HAVE_DOT = NO
GENERATE_HTML = YES
GENERATE_LATEX = NO
GENERATE_XML = YES
"""


def read(texts: dict[str, str], folder: Path) -> str:
    """All that Doxygen makes of headers, as XML; the test fails with its warnings."""
    doxygen = emitted.tool("doxygen")
    hg.write({**texts, "Doxyfile": f"{SETTINGS}INPUT = {' '.join(texts)}\n"}, folder)
    emitted.run([doxygen], folder)
    return "".join(path.read_text() for path in sorted((folder / "xml").glob("*.xml")))


def headers(texts: Mapping[str, str]) -> dict[str, str]:
    return {name: text for name, text in texts.items() if name.endswith(".h")}


@pytest.mark.ordinary("many_states", "exponential", "bent")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_a_header_is_read_without_a_warning(name: str, tmp_path: Path) -> None:
    step = emitted.step(name)
    text = read(headers(emitted.files(name)), tmp_path)
    assert f"<name>{step.name}_init</name>" in text
    assert "<verbatim>" in text
    assert "<programlisting>" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_the_header_of_every_model_is_read_without_a_warning(name: str, tmp_path: Path) -> None:
    (path,) = (path for path in plants.MODELS.iterdir() if path.stem == name and path.is_file())
    model = load(path)
    if not model.has("step"):
        pytest.skip("it has no observer of its own")
    read(headers(hg.targets.c99(model.step(), check=False)), tmp_path)


def test_what_is_not_said_is_a_warning(tmp_path: Path) -> None:
    """So that the tests above cannot pass on nothing: a parameter, a macro and a member without a comment."""
    text = headers(emitted.files("pendulum"))["pendulum.h"]
    for gone in (r" \* @param\[in\] in .*\n", r" /\*\*< digest of the model, as .*", r" /\*\*< drive .*"):
        with pytest.raises(AssertionError, match="is not documented"):
            read({"pendulum.h": re.sub(gone, "", text)}, tmp_path)


def test_a_users_words_are_no_commands(tmp_path: Path) -> None:
    """What Doxygen, Markdown or HTML would take for a command, a link, an image or a tag."""
    words = r"\brief @param x <b> </i> #include %d ~x &lt;", r"![a](b.png) [c](d) @endverbatim */ \endcode"
    a, y = hg.Signal("a", r"\@m", words[0], low=-1, high=1), hg.Signal("y", "", words[1])
    plant = hg.System("words", states=(a,), outputs=(y,), flow=[-a], output=[a])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)
    text = read(headers(hg.targets.c99(made, check=False)), tmp_path)
    assert r"\brief @param x &lt;b&gt; &lt;/i&gt; #include %d ~x &amp;lt;" in text
    assert "![a](b.png) [c](d) @endverbatim * /" in text
