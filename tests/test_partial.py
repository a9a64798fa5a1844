"""Where a part of an expression is not a real number: SymPy goes on with complex numbers, a proof must not."""

from fractions import Fraction

import pytest
import sympy as sp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.rigor.bounds import bound, nonzero
from hgogen.rigor.box import sign_at, substituted, substituted_where_real
from hgogen.rigor.slope import lipschitz_bound

x, y, z = sp.symbols("x y z", real=True)
MINUS, ZERO = (Fraction(-1), Fraction(-1)), (Fraction(0), Fraction(0))
UNIT = (Fraction(1), Fraction(2))


@pytest.mark.ordinary("expression0-at0", "expression4-at4")
@pytest.mark.parametrize(
    ("expression", "at"),
    [
        (y * sp.Abs(sp.log(x)), MINUS),
        (y * sp.sqrt(x) * sp.sqrt(x - 1), MINUS),
        (y * sp.cosh(sp.sqrt(x)), MINUS),
        (y * sp.Abs(sp.acosh(x)) * z, ZERO),
        (y + 1 / (1 + 1 / x), ZERO),
        (sp.Max(sp.sqrt(x), y), MINUS),
        (sp.Heaviside(sp.sqrt(x)) + y, MINUS),
        (sp.Piecewise((y, sp.sqrt(x) < 1), (1, True)), MINUS),
    ],
)
def test_a_point_at_which_a_part_is_not_real_proves_nothing(expression: sp.Expr, at: tuple[Fraction, Fraction]) -> None:
    box = {x: at, y: UNIT, z: UNIT}
    assert not bound(expression, box, boxes=300).defined
    assert nonzero(expression, box, boxes=300).verdict is not Verdict.PROVED
    assert lipschitz_bound([expression], [y], box, boxes=300).verdict is not Verdict.PROVED


def test_points_at_which_all_parts_are_real_are_put_in() -> None:
    values = {x: sp.Integer(4), z: sp.Integer(-1)}
    assert substituted_where_real(sp.sqrt(x) + y / z + z**3, values) == 1 - y
    assert substituted_where_real(sp.sqrt(z) + x * y, values) == sp.sqrt(z) + 4 * y
    assert substituted(sp.Max(sp.sqrt(z), y), values) is None


@pytest.mark.parametrize(
    "expression",
    [
        sp.Piecewise((y, sp.sqrt(x) < 1), (1, True)),
        sp.Min(x ** sp.Rational(5, 2), sp.Max(sp.pi, x)),
        y + sp.Heaviside(sp.sqrt(x)),
        y * sp.cosh(sp.acos(10 * x + 2)),
    ],
)
def test_what_is_real_on_a_part_of_the_box_only_is_met(expression: sp.Expr) -> None:
    box = {x: (Fraction(-1), Fraction(1, 10)), y: UNIT}
    assert not bound(expression, box, boxes=300).defined
    assert nonzero(expression, box, boxes=300).verdict is not Verdict.PROVED
    assert lipschitz_bound([expression], [x, y], box, boxes=300).verdict is not Verdict.PROVED


def test_what_sympy_gives_up_is_not_known() -> None:
    slope = sp.cosh(sp.acos(x)).diff(x)
    assert sign_at(slope, {x: 1 + sp.Rational(1, 2**60)}) == "?"
    lipschitz = lipschitz_bound([sp.cosh(sp.acos(x))], [x], {x: (Fraction(-1), Fraction(3))})
    assert (lipschitz.verdict, lipschitz.witness[x]) == (Verdict.REFUTED, -1)


def test_the_slope_of_the_size_of_what_is_not_real_everywhere_takes_no_limit() -> None:
    lipschitz = lipschitz_bound([sp.Abs(sp.acosh(x)) / x**2], [x], {x: (Fraction(-1, 3), Fraction(10))}, boxes=600)
    assert lipschitz.verdict is Verdict.UNKNOWN


def _plant(q: hg.Signal, w: hg.Signal, rate: sp.Expr, *parameters: hg.Signal) -> hg.System:
    y = hg.Signal("y")
    return hg.System("p", states=(q, w), outputs=(y,), parameters=parameters, flow=[rate, -w], output=[q])


@pytest.mark.parametrize("gain", [lambda k: sp.Abs(sp.log(k)), lambda k: sp.Heaviside(sp.sqrt(k)) + 1])
def test_a_parameter_with_such_a_value_proves_no_gain(gain: object) -> None:
    assert callable(gain)
    q, w = hg.Signal("q", low=-1, high=1), hg.Signal("w", low=-1, high=1)
    k = hg.Signal("k", nominal=-1)
    plant = _plant(q, w, gain(k) * w, k)
    verdicts = {check.id: check.verdict for check in hg.forms.triangular(plant).checks}
    assert verdicts["triangular.a_2"] is not Verdict.PROVED


def test_a_row_that_cannot_be_written_at_zero_is_no_error() -> None:
    q, w = hg.Signal("q", low=-1, high=1), hg.Signal("w", low=3, high=4)
    plant = _plant(q, w, sp.Max(sp.sqrt(w - 2), w - sp.Rational(11, 5)) + w)
    verdicts = {check.id: check.verdict for check in hg.forms.triangular(plant).checks}
    assert verdicts["triangular.structure"] is not Verdict.PROVED


def test_a_constant_that_is_not_real_is_not_lipschitz_for_being_constant() -> None:
    for row in (sp.acosh(-2 * sp.pi), sp.log(-2) + x):
        assert lipschitz_bound([row], [x], {x: UNIT}).verdict is not Verdict.PROVED
    assert lipschitz_bound([sp.acosh(2 * sp.pi)], [x], {x: UNIT}).verdict is Verdict.PROVED
