"""Lipschitz bounds: between sampled norms and a few per cent more, or a point towards which a slope has no bound."""

import math
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp

from hgogen.check import Verdict
from hgogen.rigor.slope import Field, lipschitz_bound, steepest
from hgogen.rigor.tape import tape

x1, x2, x3, u = sp.symbols("x1 x2 x3 u", real=True)
STATES = (x1, x2, x3)
R = sp.Rational
UNIT = {s: (Fraction(-1), Fraction(1)) for s in (*STATES, u)}
NEURON = {x1: (Fraction(-3), Fraction(3)), x2: (Fraction(-5), Fraction(5)), x3: (Fraction(-10), Fraction(10))}


def sampled(b: list[sp.Expr], box: dict[sp.Symbol, tuple[Fraction, Fraction]]) -> float:
    """The largest spectral norm at random points and corners, a lower bound."""
    symbols = list(box)
    matrix = sp.lambdify(symbols, sp.Matrix([[row.diff(x) for x in STATES] for row in b]))
    rng = np.random.default_rng(1)
    points = (
        [float(rng.choice([low, high, low + (high - low) * Fraction(rng.random())])) for low, high in box.values()]
        for _ in range(5000)
    )
    return max(float(np.linalg.norm(np.array(matrix(*point), dtype=float), 2)) for point in points)


@pytest.mark.ordinary("neuron", "linear")
@pytest.mark.parametrize(
    ("b", "box"),
    [
        ([x1 - x1**3 / 3, R(4, 5) * (3 * sp.sin(x1) - x2)], NEURON),
        ([x1 * x2, sp.sin(x1 * x3) * u, x2 * x3 - x1**2 * u], UNIT),
        ([sp.exp(x1) * x2, x1 * sp.atan(x2 * u), x2 * x3 / (2 + sp.sin(x1))], UNIT),
        ([x1**3, x2**3, x3**3], UNIT),
        ([3 * x1 - x2, x1 + x2, sp.Integer(0)], UNIT),
        ([1e200 * x1, 1e200 * x2], UNIT),
        ([1e-200 * x1 * x2], UNIT),
    ],
    ids=["neuron", "products", "composed", "cubes", "linear", "large", "small"],
)
def test_the_bound_is_tight(b: list[sp.Expr], box: dict[sp.Symbol, tuple[Fraction, Fraction]]) -> None:
    lipschitz = lipschitz_bound(b, STATES, box)
    known = sampled(b, box)
    assert lipschitz.verdict is Verdict.PROVED
    assert known * (1 - 1e-12) <= lipschitz.high <= 1.03 * known
    assert lipschitz.low <= lipschitz.high
    assert lipschitz.low >= 0.97 * known


@pytest.mark.parametrize(
    ("row", "box", "high"),
    [
        (sp.Abs(x1) * x2, {x1: (-1, 1), x2: (-2, 1)}, math.sqrt(5)),
        (sp.Max(x1, 0) ** 2, {x1: (-1, 3)}, 6),
        (sp.sqrt(x1), {x1: (R(1, 100), 1)}, 5),
        (x1 ** R(3, 2), {x1: (0, 4)}, 3),
        (sp.sqrt(u) * x1, {x1: (0, 1), u: (0, 1)}, 1),
        (sp.sign(u) * x1, {x1: (0, 1), u: (-1, 1)}, 1),
        (sp.Piecewise((2 * x1, u > 0), (x1, True)), UNIT, 2),
        (sp.sin(x1), {x1: (-math.inf, math.inf)}, 1),
        (sp.sign(u), UNIT, 0),
    ],
    ids=str,
)
def test_kinks_and_jumps_of_inputs_do_no_harm(
    row: sp.Expr, box: dict[sp.Symbol, tuple[object, object]], high: float
) -> None:
    lipschitz = lipschitz_bound([row], STATES, _exact(box))
    assert lipschitz.verdict is Verdict.PROVED
    assert high * (1 - 1e-12) <= lipschitz.high <= 1.03 * high


@pytest.mark.ordinary(
    "sqrt(x1)-{x1: (0, 1)}",
    "x1/u-{x1: (0, 1), u: (0, 1)}",
    "x1*log(x1)-{x1: (0, 1)}",
    "log(x1 + x2)-{x1: (0, 1), x2: (0, 1)}",
)
@pytest.mark.parametrize(
    ("row", "box"),
    [
        (sp.sqrt(x1), {x1: (0, 1)}),
        (sp.sqrt(x1 - x2 / 2), {x1: (0, 1), x2: (0, 1)}),
        (sp.sqrt(sp.Abs(x1)), UNIT),
        (x2 * sp.Abs(x1) ** R(1, 3), UNIT),
        (x1 / u, {x1: (0, 1), u: (0, 1)}),
        (x1 * sp.log(x1), {x1: (0, 1)}),
        (sp.asin(x1), UNIT),
        (1 / (x1 - R(1, 3)), {x1: (0, 1)}),
        (sp.log(x1 + x2), {x1: (0, 1), x2: (0, 1)}),
        (sp.asin(x1 * x2) * sp.Min(x1 + x2, sp.tanh(sp.sqrt(2))), {x1: (-2, 10), x2: (-2, R(1, 2))}),
        (sp.sqrt(sp.Max(x1, 0) - sp.Abs(x1 - 2) + 2), UNIT),
        (sp.atanh(sp.Min(sp.pi**-3, x1)), UNIT),
    ],
    ids=str,
)
def test_a_slope_without_bound_refutes_with_the_point(
    row: sp.Expr, box: dict[sp.Symbol, tuple[object, object]]
) -> None:
    ends = _exact(box)
    lipschitz = lipschitz_bound([row], STATES, ends)
    assert lipschitz.verdict is Verdict.REFUTED
    assert all(ends[s][0] <= value <= ends[s][1] for s, value in lipschitz.witness.items())
    assert "no bound towards" in str(lipschitz.reason)
    assert lipschitz.low > 5  # where a sharper search would find more


@pytest.mark.ordinary("sign(x1)", "floor(3*x1)", "atan2(x2, x1)", "Piecewise((x1, x1 > 0), (x2, True))", "sin(x1)/x1")
@pytest.mark.parametrize(
    "row",
    [
        sp.sign(x1),
        sp.floor(3 * x1),
        sp.atan2(x2, x1),
        sp.Piecewise((x1, x1 > 0), (x2, True)),
        sp.sin(x1) / x1,
        (1 - sp.cos(x1)) / x1,  # its slope grows towards 0, to 1/2
        (x1**2 - 1) / (x1 - 1),
    ],
    ids=str,
)
def test_jumps_and_removable_poles_stay_unknown(row: sp.Expr) -> None:
    lipschitz = lipschitz_bound([row], STATES, UNIT, boxes=600)
    assert lipschitz.verdict is Verdict.UNKNOWN
    assert "boxes" in str(lipschitz.reason)


def test_an_unbounded_slope_on_an_unbounded_box_stays_unknown() -> None:
    lipschitz = lipschitz_bound([x1**2], STATES, {x1: (-math.inf, math.inf)})
    assert (lipschitz.verdict, lipschitz.high) == (Verdict.UNKNOWN, math.inf)


def _exact(box: dict[sp.Symbol, tuple[object, object]]) -> dict[sp.Symbol, tuple[Fraction | float, Fraction | float]]:
    return {s: (_end(low), _end(high)) for s, (low, high) in box.items()}


def _end(value: object) -> Fraction | float:
    return value if isinstance(value, float) and math.isinf(value) else Fraction(str(value))


def test_the_value_of_a_step_at_zero_counts() -> None:
    box = {x1: (Fraction(0), Fraction(1)), u: (Fraction(0), Fraction(1))}
    assert lipschitz_bound([sp.Heaviside(u, x1)], [x1], box).high >= 1
    for row in (sp.Heaviside(u, sp.sqrt(x1)), sp.Heaviside(u, 1 / x1)):
        assert lipschitz_bound([row], [x1], box).verdict is not Verdict.PROVED


def test_a_root_under_a_saturation_and_a_power_with_a_range() -> None:
    bent = lipschitz_bound([sp.Min(1, sp.sqrt(x1))], [x1], {x1: (Fraction(0), Fraction(4))})
    assert (bent.verdict, bent.witness[x1]) == (Verdict.REFUTED, 0)
    # d/dx x^u = u x^(u - 1) <= 2, but as u exp((u - 1) log x) it has no bound at 0
    power = lipschitz_bound([x1**u], [x1], {x1: (Fraction(0), Fraction(1)), u: (Fraction(1), Fraction(2))})
    assert power.verdict is Verdict.UNKNOWN
    assert 1.99 < power.low <= 2


def test_a_bisection_that_goes_on_is_that_with_more_boxes() -> None:
    program = tape([sp.sin(5 * x1 * x2), x2], (x1, x2))
    vector, root = Field(program, (0, 1), tape([], (x1, x2)), ()), (-np.ones(2), np.ones(2))
    first, whole = (steepest(vector, root, 1e-9, boxes) for boxes in (70, 212))
    on = steepest(vector, root, 1e-9, 212, first.before)
    assert (first.boxes, on.boxes) == (69, 211)
    assert (on.inner.most, on.high, on.tree) == (whole.inner.most, whole.high, whole.tree)
