"""What an expression is at a point: only what is certain of it refutes."""

from fractions import Fraction

import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.rigor.bounds import nonzero
from hgogen.rigor.box import sign_at

U = hg.Signal("u", low=0.25, high=1)
HALF = sp.Rational(1, 2)
NOTHING = sp.sin(U) ** 2 + sp.cos(U) ** 2 - 1  # 0, which SymPy's digits do not show
SLOW = sp.sin(U) - sp.tan(U) / sp.sqrt(1 + sp.tan(U) ** 2)


@pytest.mark.ordinary("<lambda>1-nothing0", "<lambda>1-nothing1", "<lambda>2-nothing0")
@pytest.mark.parametrize("nothing", [NOTHING, SLOW])
@pytest.mark.parametrize(
    "function",
    [
        sp.sign,
        lambda e: sp.sqrt(sp.Abs(e)),
        lambda e: e ** sp.Rational(1, 20),
        lambda e: 1 / e,
        lambda e: sp.log(sp.Abs(e)),
        lambda e: sp.acosh(1 + e),
        lambda e: sp.asin(1 + e),
        lambda e: sp.asin(e - 1),
        lambda e: sp.tan(sp.pi / 2 + e),
        lambda e: sp.floor(e) + sp.sign(e),
    ],
)
def test_a_function_of_what_may_be_nothing_has_no_certain_sign(nothing: sp.Expr, function: sp.Function) -> None:
    """The noise of SymPy's digits, 1e-125, has a sign, a root of 1e-7 and an inverse of 1e125."""
    assert sign_at(function(nothing), {U: sp.Rational(1, 2)}) == "?"


@pytest.mark.parametrize(
    ("expression", "what"),
    [
        (sp.sqrt(sp.sin(U)), "> 0"),
        (1 / sp.sin(U) - 3, "< 0"),
        (sp.log(U), "< 0"),
        (sp.log(sp.sin(U) - 1), "undefined"),
        (sp.sqrt(sp.sin(U) - 1), "undefined"),
        (sp.sqrt(U - HALF - sp.Rational(1, 10**40)), "undefined"),  # 1e-20 i
        (sp.sqrt(U - HALF - sp.Rational(1, 10**40)) + 1, "undefined"),
        (sp.sign(sp.sin(U)), "> 0"),
        (sp.asin(2 * U), "> 0"),
        (1 / (2 * U - 1), "undefined"),
        (NOTHING + 1, "> 0"),
    ],
)
def test_what_is_certain_stays(expression: sp.Expr, what: str) -> None:
    """Away from the edges of a function its digits tell."""
    assert sign_at(expression, {U: sp.Rational(1, 2)}) == what


@pytest.mark.parametrize(
    "function",
    [
        lambda e: sp.acosh(1 + e),
        lambda e: sp.acos(1 - e),
        lambda e: sp.atanh(1 - e),
        lambda e: sp.atanh(sp.cos(e)),
        lambda e: sp.acos(sp.tanh(1 / e)),
        lambda e: 1 / sp.acosh(1 + e) - 1,
        lambda e: 1 / sp.acos(1 - e),
        lambda e: 1 / sp.atanh(sp.cos(e)),
    ],
)
def test_an_argument_that_sympy_rounds_to_an_end_is_not_at_the_end(function: sp.Function) -> None:
    """Nothing of these is 0 or infinite where e is 10^-20; SymPy, by two digits, has some for 0 and folds 1 over it."""
    for e in (sp.Rational(1, 10**20), sp.Rational(1, 10**9), sp.Rational(1, 100)):
        assert sign_at(function(U), {U: e}) in ("?", "> 0", "< 0")


@pytest.mark.parametrize(("function", "way"), [(sp.acosh, -1), (sp.acos, 1), (sp.asin, 1), (sp.atanh, 1)])
def test_an_argument_beyond_an_end_is(function: sp.Function, way: int) -> None:
    assert sign_at(function(1 + way * U), {U: sp.Rational(1, 10**9)}) == "undefined"
    assert sign_at(function(1 + way * U) + U, {U: sp.S.Zero}) == {sp.asin: "> 0", sp.atanh: "undefined"}.get(
        function, "= 0"
    )


@pytest.mark.full
def test_a_function_is_not_refuted_for_a_zero_that_it_has_not() -> None:
    around = {U: (Fraction(1, 10**9), Fraction(3, 10**8))}
    assert nonzero(sp.atanh(sp.cos(U)), around).verdict is not Verdict.REFUTED


@pytest.mark.full
def test_a_number_is_not_refuted_for_the_digits_of_nothing() -> None:
    """a_2 = 1 + 0**(1/20) is 1."""
    x1, x2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))
    root = NOTHING ** sp.Rational(1, 20)
    flow = [x2 * (1 + root), x1]
    plant = hg.System("p", states=[x1, x2], inputs=[U], outputs=[hg.Signal("y")], flow=flow, output=[x1 + root])
    refuted = [check for check in hg.forms.triangular(plant).checks if check.verdict == "refuted"]
    assert not refuted


@pytest.mark.full
def test_what_is_made_of_what_is_not_real_is_undefined(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without digits of the whole, which took minutes of such a one: atan2 of complex numbers, twice."""
    inner = sp.atan2(U ** sp.Rational(4, 3), U - sp.Rational(7, 3))
    monkeypatch.setattr("hgogen.rigor.box._digits", lambda value: pytest.fail("digits of what has none"))
    assert sign_at(sp.atan2(inner, inner), {U: sp.Rational(-3, 2)}) == "undefined"
