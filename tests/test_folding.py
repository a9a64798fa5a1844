"""What SymPy folds away from a text: each place without a value is told, none is made up."""

from pathlib import Path

import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.commands.claims import checked
from hgogen.model import load
from hgogen.reading.expression import read
from hgogen.sentence import NONE

x, y, u = (hg.Signal(name) for name in "xyu")
NAMES = {"x": x, "y": y, "u": u}
BOX = dict.fromkeys(NAMES.values(), (-3, 3))

FOLDED = [
    ("exp(log(x))", "x <= 0"),
    ("sqrt(x)**2", "x < 0"),
    ("x/x", "x = 0"),
    ("0/x", "x = 0"),
    ("1/(1/x)", "x = 0"),
    ("x**2/x", "x = 0"),
    ("(x*y)/(2*x)", "x = 0"),
    ("log(x) - log(x)", "x <= 0"),
    ("0*log(x)", "x <= 0"),
    ("exp(log(x)/2)", "x = 0"),
    ("exp(-log(x))", "x < 0"),
    ("(1/x)**0", "x = 0"),
    ("x**u/x**u", "x <= 0"),
    ("cos(acos(x))", "1 - x**2 < 0"),
    ("0*tan(x)", "cos(x) = 0"),
    ("-exp(log(x)) - sqrt(x)**2", "x <= 0"),
    ("0*atan2(x, y)", "x**2 + y**2 = 0"),
    ("x/x + Piecewise((1/x, x > 9), (0, True))", "x = 0"),
]
# Nothing is lost on the box, or anywhere.
WHOLE = (
    *(
        "1/(3*x + 3)",
        "sqrt(2*x)",
        "sqrt(-2*x)",
        "sqrt(x**2*y)",
        "x/x**2",
        "1/(x*y)",
        "log(exp(x))",
        "sqrt(x**2)",
        "x**u",
    ),
    *("2**x/2**x", "1/sqrt(x)", "x**0.5*x", "(x + 1)/(3*x + 3)", "1/exp(-x)", "1/(1 - x)", "x*(1/x + 1)", "log(2*x)"),
    *("(x**2 + 1)/(x**2 + 1)", "(x + 4)/(x + 4)", "sqrt(x + 3)**2", "(x**2)**(-0.5)", "1/sqrt(x + y/2 - 2)", "x**0"),
    *("1/sqrt(x**3)", "sqrt(1/sqrt(x))", "Piecewise((x/x, x > 0), (0, True))", "0*atan2(x, 4)"),
)


@pytest.mark.parametrize(("text", "where"), FOLDED)
def test_what_is_folded_away_is_told(text: str, where: str) -> None:
    note = str(read(text, NAMES).on(BOX))
    assert note.startswith(f"SymPy reads {text} as ")
    assert f", also where {where}; " in note


@pytest.mark.parametrize("text", WHOLE)
def test_what_keeps_its_domain_on_the_box_is_silent(text: str) -> None:
    assert read(text, NAMES).on(BOX) == NONE


def test_a_box_without_these_places_is_silent() -> None:
    for text, _ in FOLDED:
        assert read(text, NAMES).on({x: (sp.Rational(1, 2), 1), y: (1, 2), u: (1, 2)}) == NONE


def test_a_bound_of_a_folded_text_says_so() -> None:
    enclosure = hg.bound("exp(log(x))", {"x": (-3, 3)})
    assert (enclosure.low, enclosure.high, enclosure.defined) == (-3, 3, False)
    assert str(enclosure.note).startswith("SymPy reads exp(log(x)) as x, also where x <= 0")
    assert hg.nonzero("exp(log(x)) + 5", {"x": (-3, 3)}).verdict is Verdict.UNKNOWN
    assert hg.nonzero("exp(log(x)) + 5", {"x": (1, 3)}).verdict is Verdict.PROVED
    assert hg.bound("exp(log(x))", {"x": (1, 3)}).note == NONE


def test_a_plain_text_model_that_is_folded_says_so(tmp_path: Path) -> None:
    (tmp_path / "el.toml").write_text(
        'name = "el"\nstates.x1 = {low = -3, high = 3, flow = "x2"}\n'
        'states.x2 = {low = 1, high = 2, flow = "-exp(log(x1)) - exp(log(x2))"}\noutputs.y = {equation = "x1"}\n'
    )
    (said, _) = checked(load(tmp_path / "el.toml")).notes
    assert said.startswith("SymPy reads -exp(log(x1)) - exp(log(x2)) as -x1 - x2, also where x1 <= 0; ")
