"""The elementary functions, their instructions read in float32 and float64, against mpmath and float64."""

import math
import subprocess
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import emitted
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.emit.elementary import (
    ARITHMETIC,
    BINARY,
    BOUNDED,
    LN2,
    NEAREST,
    PI,
    POWER_OF_TWO,
    ROUNDS,
    SMALL,
    UNARY,
    elementary,
)
from hgogen.emit.portable import functions
from hgogen.emit.pygraph import evaluated
from hgogen.emit.syntaxes import C
from hgogen.rigor.lookup import called, instructions

Real = Literal["float", "double"]
REALS: tuple[Real, ...] = ("float", "double")
TYPE: dict[Real, type] = {"float": np.float32, "double": np.float64}
FLOOR_LIMIT = {"float": 2.0**31, "double": 2.0**53}  # C converts to int32_t or int64_t
SIMPLE_RANGE = {"float": 200.0, "double": 1e4}  # of sin, cos, tan
RANGE = {"float": 8192.0, "double": 1e6}

# Largest errors in ulp: as measured on every 13th float and on 2 million doubles (in parentheses), rounded up.
ULPS = {
    "sqrt": 0.8,  # (0.755)
    "exp": 1.1,  # (1.015)
    "log": 0.9,  # (0.835)
    "expm1": 2.25,  # (2.162)
    "log1p": 2.5,  # (2.380)
    "sin": 2.0,  # (1.966) for sin and cos on every third float of SIMPLE_RANGE
    "cos": 2.0,
    "bounded_sin": 2.0,
    "bounded_cos": 2.0,
    "small_sin": 2.0,
    "small_cos": 2.0,
    "tan": 4.0,  # (3.868)
    "asin": 1.9,  # (1.772)
    "acos": 1.5,  # (1.410)
    "atan": 2.0,  # (1.849)
    "sinh": 2.4,  # (2.271)
    "cosh": 1.5,  # (1.456)
    "tanh": 2.7,  # (2.554)
    "asinh": 2.8,  # (2.701)
    "acosh": 3.1,  # (2.986)
    "atanh": 3.2,  # (3.071)
    "atan2": 2.0,  # (1.933)
    "hypot": 2.5,  # (2.407)
}
# Up to RANGE, where the last piece of pi costs a second rounding (2.336, 2.321, 4.276 on every third float).
ULPS_FAR = {"sin": 2.5, "cos": 2.5, "tan": 4.5}

COMPARE = {ca.OP_LT: np.less, ca.OP_LE: np.less_equal, ca.OP_EQ: np.equal, ca.OP_NE: np.not_equal}
COMPUTE: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: a.dtype.type(1) / a,
    ca.OP_NOT: lambda a: (a == 0).astype(a.dtype),
    ca.OP_IF_ELSE_ZERO: lambda c, a: np.where(c != 0, a, a.dtype.type(0)),
}


def nearest(argument: np.ndarray, real: Real) -> np.ndarray:
    rounds = TYPE[real](ROUNDS[real])
    assert not np.any(np.abs(argument) >= rounds / 3), "an argument beyond those that are rounded"
    return np.asarray((argument + rounds) - rounds)


def two_to(k: np.ndarray, real: Real) -> np.ndarray:
    assert np.all((k == np.floor(k)) & (np.abs(k) <= np.finfo(TYPE[real]).maxexp - 2)), "a power that is not normal"
    return np.ldexp(TYPE[real](1), k.astype(int))


PRIMITIVES = {NEAREST: nearest, POWER_OF_TWO: two_to}


def evaluate(function: Any, real: Real, *arguments: Any, flush: bool = False) -> np.ndarray:
    """The function at arrays, each instruction rounded to `real`; `flush`: subnormal results become 0."""
    number, slots, calls = TYPE[real], {}, instructions(function)
    inputs = np.broadcast_arrays(*(np.asarray(a, number) for a in arguments))
    with np.errstate(all="ignore"):
        for i in range(function.n_instructions()):
            op = function.instruction_id(i)
            sources, taken = function.instruction_input(i), function.instruction_output(i)
            if op == ca.OP_OUTPUT:
                return np.asarray(slots[sources[0]])
            if op == ca.OP_CONST:
                constant = function.instruction_constant(i)
                value = np.full(inputs[0].shape, constant, number)
                assert math.isnan(constant) or float(value.flat[0]) == constant, "a constant that real does not hold"
            elif op == ca.OP_INPUT:
                value = inputs[sources[0]]
            elif op in COMPARE:
                value = COMPARE[op](*(slots[k] for k in sources)).astype(number)
            elif op == ca.OP_FLOOR:
                argument = slots[sources[0]]
                assert np.all(np.abs(argument) < FLOOR_LIMIT[real]), "an argument that C cannot convert"
                value = np.floor(argument)
            elif op == ca.OP_CALL:
                value = PRIMITIVES[called(calls[i]).name()](slots[sources[0]], real)
            elif op == ca.OP_FABS:
                value = np.abs(slots[sources[0]])
            else:  # KeyError: an operation that is no primitive
                value = COMPUTE[op](*(slots[k] for k in sources))
            assert value.dtype == number
            if flush:
                value = np.where(np.abs(value) < np.finfo(number).tiny, number(0), value)
            slots[taken[0]] = value
    raise AssertionError("no output")


def call(name: str, real: Real, *arguments: Any, flush: bool = False) -> np.ndarray:
    return evaluate(elementary(real)[name], real, *arguments, flush=flush)


# --- points


def spread(real: Real, low: float, high: float, count: int, seed: int) -> np.ndarray:
    """Both signs, evenly in the logarithm."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.uniform(math.log(low), math.log(high), count)) * rng.choice([-1, 1], count)


def points(name: str, real: Real, count: int) -> np.ndarray:
    """Points of the function's domain with normal arguments and results; half of them where it bends."""
    tiny, huge = float(np.finfo(TYPE[real]).tiny) * 1.01, float(np.finfo(TYPE[real]).max) * 0.99
    rng, logarithmic = np.random.default_rng(1), spread(real, tiny, huge, count, 2)
    small, top = spread(real, tiny, 1.0, count // 4, 3), math.log(huge)
    bend = rng.uniform(-2, 2, count // 2)
    around_1 = np.linspace(0.25, 4, count // 4)
    match name:
        case "sqrt":
            arguments = np.abs(logarithmic)
        case "log":
            arguments = np.concatenate([np.abs(logarithmic), around_1])
        case "exp":
            arguments = np.concatenate([rng.uniform(math.log(tiny), top, count), small])
        case "expm1" | "sinh" | "cosh":
            arguments = np.concatenate([rng.uniform(-top, top, count), small, bend])
        case "log1p":
            arguments = np.concatenate([np.abs(logarithmic), small[small > -0.9999], bend[bend > -1]])
        case "sin" | "cos" | "tan":
            k = np.arange(1, 64) / 2
            arguments = np.concatenate([rng.uniform(-1, 1, count) * SIMPLE_RANGE[real], bend, small, k * np.pi])
        case "small_sin" | "small_cos" | "bounded_sin" | "bounded_cos":
            most = SMALL if name.startswith("small") else BOUNDED
            zeros = (np.arange(1, 2 * most / np.pi) * np.pi / 2).astype(TYPE[real])
            beside = np.concatenate([np.nextafter(zeros, TYPE[real](0)), zeros, np.nextafter(zeros, TYPE[real](999))])
            inside = np.concatenate([rng.uniform(-most, most, count), bend, small, [-most, most]])
            arguments = np.concatenate([inside, beside, -beside])
        case "asin" | "acos" | "atanh":
            arguments = np.concatenate([bend / 2, small, 1 - np.abs(small[np.abs(small) > 1e-7])])
        case "acosh":
            arguments = np.concatenate([1 + np.abs(small), np.abs(logarithmic) + 1, around_1[around_1 > 1]])
        case _:
            arguments = np.concatenate([logarithmic, 4 * bend])
    return arguments.astype(TYPE[real])


def reference(name: str, real: Real, *arguments: np.ndarray) -> np.ndarray:
    """Float: float64, itself good to 2^-29 ulp of float. Double: mpmath, as a pair (nearest, remainder)."""
    if real == "float":
        with np.errstate(all="ignore"):
            function = NUMPY.get(name) or getattr(np, name)
            return np.asarray(function(*(a.astype(np.float64) for a in arguments)))[..., None]
    pairs = []
    with mp.workdps(40):
        for values in zip(*(a.tolist() for a in arguments), strict=True):
            exact = MPMATH.get(name, getattr(mp, name, None))(*map(mp.mpf, values))
            pairs.append((float(exact), float(exact - mp.mpf(float(exact))) if abs(exact) < 1e308 else 0.0))
    return np.array(pairs)


NUMPY = {
    "small_sin": np.sin,
    "small_cos": np.cos,
    "bounded_sin": np.sin,
    "bounded_cos": np.cos,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "atan2": np.arctan2,
    "pow": np.power,
}
MPMATH: dict[str, Callable[..., Any]] = {"pow": mp.power, "small_sin": mp.sin, "small_cos": mp.cos} | {
    "bounded_sin": mp.sin,
    "bounded_cos": mp.cos,
}


def ulps(name: str, real: Real, *arguments: np.ndarray) -> np.ndarray:
    """The error in ulp of the exact value, where that is a normal number."""
    exact, computed = reference(name, real, *arguments), call(name, real, *arguments).astype(np.float64)
    limits = np.finfo(TYPE[real])
    usable = (np.abs(exact[:, 0]) > limits.tiny) & (np.abs(exact[:, 0]) < 0.999 * float(limits.max))
    exact, computed = exact[usable], computed[usable]
    assert len(computed) > 0.3 * len(usable)
    unit = np.spacing(np.abs(exact[:, 0]).astype(TYPE[real])).astype(np.float64)
    return np.abs((computed - exact[:, 0]) - exact[:, 1:].sum(axis=1)) / unit


COUNT: dict[Real, int] = {"float": 100_000, "double": 3000}


# --- accuracy


@pytest.mark.ordinary("exp-float", "sin-float", "cos-float", "small_cos-float", "atanh-double")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", UNARY)
def test_error_of_one_argument(name: str, real: Real) -> None:
    assert ulps(name, real, points(name, real, COUNT[real])).max() <= ULPS[name]


@pytest.mark.ordinary("sin-float", "cos-float", "cos-double", "tan-float")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ULPS_FAR)
def test_error_of_large_angles(name: str, real: Real) -> None:
    """Over the whole claimed range, and at the numbers next to the zeros, where the reduction cancels."""
    turns = np.arange(1, RANGE[real] / np.pi, RANGE[real] / COUNT[real] / 2) // 1 / 2
    zeros = (turns * np.pi).astype(TYPE[real])
    inside = np.random.default_rng(4).uniform(-RANGE[real], RANGE[real], COUNT[real]).astype(TYPE[real])
    assert ulps(name, real, np.concatenate([inside, zeros, np.nextafter(zeros, TYPE[real](0))])).max() <= ULPS_FAR[name]


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["atan2", "hypot"])
def test_error_of_two_arguments(name: str, real: Real) -> None:
    ratio, n = spread(real, 1e-3, 1e3, COUNT[real], 6), COUNT[real]
    x = spread(real, 1e-30, 1e30, n, 5).astype(TYPE[real])
    assert ulps(name, real, x, (x * ratio).astype(TYPE[real])).max() <= ULPS[name]


@pytest.mark.parametrize("real", REALS)
def test_atan2_next_to_the_negative_axis_has_every_bit_of_pi(real: Real) -> None:
    """pi less an angle of at most 1e-3, whose own error is 1e-3 of a unit of pi: one rounding remains."""
    y = np.geomspace(1e-6, 1e-3, COUNT[real]).astype(TYPE[real])
    assert ulps("atan2", real, y, np.full_like(y, -1)).max() <= 0.51


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ["sinh", "cosh"])
def test_hyperbolic_functions_reach_the_largest_numbers(name: str, real: Real) -> None:
    """e^x/2 up to log(2 MAX), beyond the x where e^x itself overflows; a rounding of x - log 2 is some 700 eps."""
    x = (np.log(2) + np.log(float(np.finfo(TYPE[real]).max)) - np.array([0.6, 0.3, 0.01])).astype(TYPE[real])
    wanted = np.exp(x.astype(float) - np.log(2))
    assert call(name, real, x) == pytest.approx(wanted, rel=1e3 * float(np.finfo(TYPE[real]).eps))


@pytest.mark.parametrize("real", REALS)
def test_error_of_pow(real: Real) -> None:
    """x^y multiplies the error of log x, below 1 ulp, and of the product, 1/2 ulp, by |y log x|."""
    rng, n = np.random.default_rng(7), COUNT[real]
    x = np.abs(spread(real, 1e-30, 1e30, n, 8)).astype(TYPE[real])
    y = (rng.uniform(-1, 1, n) * 60 / np.log(x.astype(float))).astype(TYPE[real])
    factor = 1.5 + 2 * np.abs(y.astype(float) * np.log(x.astype(float)))
    assert (ulps("pow", real, x, y) / factor).max() <= 1


@pytest.mark.parametrize("real", REALS)
def test_square_roots_of_squares_are_exact(real: Real) -> None:
    whole = np.geomspace(1, 2.0 ** (ARITHMETIC[real].bits // 2), 20_000).round().astype(TYPE[real])
    scale = TYPE[real](4.0) ** np.arange(-40, 40).astype(TYPE[real])
    assert np.array_equal(call("sqrt", real, whole * whole), whole)
    assert np.array_equal(call("sqrt", real, 9 * scale), 3 * np.sqrt(scale))


# --- exceptional arguments

INF, NAN = math.inf, math.nan
SPECIAL: dict[str, list[tuple[float, float]]] = {
    "sqrt": [(0, 0), (1, 1), (INF, INF), (-1, NAN), (-INF, NAN)],
    "exp": [(0, 1), (INF, INF), (-INF, 0), (800, INF), (-800, 0), (1e30, INF), (-1e30, 0)],
    "log": [(1, 0), (0, -INF), (INF, INF), (-1, NAN), (-INF, NAN)],
    "expm1": [(0, 0), (INF, INF), (-INF, -1), (800, INF), (-800, -1), (-1e30, -1)],
    "log1p": [(0, 0), (-1, -INF), (INF, INF), (-2, NAN), (-INF, NAN)],
    "sin": [(0, 0), (INF, NAN), (-INF, NAN), (1e30, 0)],
    "cos": [(0, 1), (INF, NAN), (-INF, NAN), (1e30, 1)],
    "bounded_sin": [(0, 0)],
    "bounded_cos": [(0, 1)],
    "small_sin": [(0, 0)],
    "small_cos": [(0, 1)],
    "tan": [(0, 0), (INF, NAN), (-INF, NAN), (1e30, 0)],
    "asin": [(0, 0), (1, math.pi / 2), (-1, -math.pi / 2), (1.5, NAN), (-1.5, NAN), (INF, NAN), (-INF, NAN)],
    "acos": [(0, math.pi / 2), (1, 0), (-1, math.pi), (1.5, NAN), (-1.5, NAN), (INF, NAN), (-INF, NAN)],
    "atan": [(0, 0), (1, math.pi / 4), (INF, math.pi / 2), (-INF, -math.pi / 2)],
    "sinh": [(0, 0), (INF, INF), (-INF, -INF), (800, INF), (-1e30, -INF)],
    "cosh": [(0, 1), (INF, INF), (-INF, INF), (800, INF), (-1e30, INF)],
    "tanh": [(0, 0), (INF, 1), (-INF, -1), (1e30, 1), (-30, -1)],
    "asinh": [(0, 0), (INF, INF), (-INF, -INF)],
    "acosh": [(1, 0), (INF, INF), (0, NAN), (-5, NAN), (-1e30, NAN), (-INF, NAN)],
    "atanh": [(0, 0), (1, INF), (-1, -INF), (1.5, NAN), (-1.5, NAN)],
}
SPECIAL_PAIRS: dict[str, list[tuple[float, float, float]]] = {
    "pow": [
        *((0, 2, 0), (0, -2, INF), (0, 0, 1), (2, 0, 1), (1, 5, 1), (2, 3, 8), (2, -1, 0.5), (-2, 3, -8)),
        *((-2, 2, 4), (-2, -1, -0.5), (-2, 0.5, NAN), (-1, 1e30, 1), (INF, 2, INF), (INF, -1, 0)),
        *((-INF, 3, -INF), (2, INF, INF), (2, -INF, 0), (0.5, INF, 0)),
        *((NAN, 1, NAN), (1, NAN, NAN), (NAN, 0, 1)),
    ],
    "atan2": [
        *((0, 0, 0), (0, 1, 0), (0, -1, math.pi), (1, 0, math.pi / 2), (-1, 0, -math.pi / 2)),
        *((1, 1, math.pi / 4), (-1, -1, -3 * math.pi / 4), (INF, 1, math.pi / 2), (1, INF, 0)),
        *((1, -INF, math.pi), (INF, INF, NAN), (NAN, 1, NAN), (1, NAN, NAN), (0, NAN, NAN), (NAN, 0, NAN)),
    ],
    "hypot": [
        *((0, 0, 0), (3, 4, 5), (-4, -3, 5), (0, -7, 7), (INF, 1, INF), (1, -INF, INF), (INF, INF, NAN)),
        *((NAN, 1, NAN), (1, NAN, NAN), (0, NAN, NAN), (NAN, 0, NAN)),
    ],
}


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", UNARY + BINARY)
def test_exceptional_values(name: str, real: Real) -> None:
    *arguments, expected = np.array(SPECIAL.get(name) or SPECIAL_PAIRS[name], TYPE[real]).T
    # exact, but for 1.5 + 2 |y log x| <= 6 ulp of the finite powers, |y log x| <= 2.1
    tolerance = 6 * np.finfo(TYPE[real]).eps if name == "pow" else 0.0
    np.testing.assert_allclose(call(name, real, *arguments), expected, rtol=tolerance, atol=0)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", UNARY)
def test_nan_gives_nan(name: str, real: Real) -> None:
    assert np.isnan(call(name, real, NAN))


@pytest.mark.parametrize("real", REALS)
def test_angles_beyond_the_range_stay_bounded_and_near(real: Real) -> None:
    """Below the limit the angle is that of a number within 2 ulp: an inexact product costs half an ulp of x."""
    limit = ARITHMETIC[real].angle_limit
    x = np.geomspace(RANGE[real], limit, 20_000, endpoint=False).astype(TYPE[real])
    exact = np.array([float(mp.sin(mp.mpf(v))) for v in x.tolist()])
    ulp = np.spacing(x).astype(float)
    error = np.abs(call("sin", real, x) - exact)
    assert np.all(error <= 2 * ulp + np.finfo(TYPE[real]).eps)
    everything = spread(real, 1.0, float(np.finfo(TYPE[real]).max) / 2, 20_000, 9)
    for name in ("sin", "cos"):
        assert np.all(np.abs(call(name, real, everything)) <= 1)


# --- how the graphs are built


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", UNARY + BINARY)
def test_casadi_rewrites_nothing_that_matters(name: str, real: Real) -> None:
    """The same bits from graphs built without its rewriting, and from those called on symbols, so built anew."""
    arguments = [points(name if name in UNARY else "atan", real, 2000)]
    arguments += [arguments[0][::-1].copy()] if name in BINARY else []
    inputs = [ca.SX.sym("x"), ca.SX.sym("y")][: len(arguments)]
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        plain = ca.Function(name, inputs, [getattr(ARITHMETIC[real], name)(*inputs)])
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(True)
    anew = ca.Function(name, inputs, [elementary(real)[name](*inputs)])
    values = call(name, real, *arguments)
    np.testing.assert_array_equal(values, evaluate(plain, real, *arguments))
    np.testing.assert_array_equal(values, evaluate(anew, real, *arguments))


@pytest.mark.parametrize("name", UNARY)
def test_casadi_computes_the_same_doubles(name: str) -> None:
    x = points(name, "double", 500)
    by_casadi = np.array(elementary("double")[name].map(len(x))(x)).ravel()
    np.testing.assert_array_equal(call(name, "double", x), by_casadi)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", UNARY + BINARY)
def test_flushing_subnormal_numbers_changes_no_normal_result(name: str, real: Real) -> None:
    if name in UNARY:
        arguments = [points(name, real, 4000)]
    else:
        x = spread(real, 1e-20, 1e20, 4000, 10).astype(TYPE[real])
        arguments = [x, (x * spread(real, 1e-3, 1e3, 4000, 11)).astype(TYPE[real])]
    values = call(name, real, *arguments)
    normal = np.abs(values) >= np.finfo(TYPE[real]).tiny
    np.testing.assert_array_equal(values[normal], call(name, real, *arguments, flush=True)[normal])


@pytest.mark.parametrize("real", REALS)
def test_pieces_make_exact_products(real: Real) -> None:
    """k times every piece but the last fits the significand: the premise of the range reductions."""
    arithmetic = ARITHMETIC[real]
    half_turns = Fraction(RANGE[real]) / PI  # the cosine's k are odd multiples of 1/2
    reductions = [
        (PI, arithmetic.pi_widths, int(2 * half_turns) + 1),
        (LN2, arithmetic.ln2_widths, 2**arithmetic.octaves),
    ]
    for constant, widths, largest in reductions:
        pieces = arithmetic.pieces(constant, widths)
        remainder = abs(sum(map(Fraction, pieces)) - constant)
        assert remainder <= abs(Fraction(pieces[-1])) / 2**arithmetic.bits
        for piece in pieces[:-1]:
            for k in (largest, largest - 1, largest - 2):
                product = Fraction(piece) * k
                assert Fraction(arithmetic.near(product)) == product


@pytest.mark.parametrize("real", REALS)
def test_conditional_factors_are_powers_of_two(real: Real) -> None:
    arithmetic, x = ARITHMETIC[real], ca.SX.sym("x")
    for n in [2**i for i in range(arithmetic.octaves)] + [2**arithmetic.octaves - 2]:
        both = [arithmetic.lift_if(x > 0, n), arithmetic.lower_unless(x > 0, n)]
        values = [evaluate(ca.Function("f", [x], [graph]), real, [0.0, 1.0]).tolist() for graph in both]
        assert values == [[1.0, 2.0**n], [2.0**-n, 1.0]]


PRINTED = """
int main(void)
{{
    for (int k = {least}; k <= {most}; ++k) {{
        printf("%a\\n", (double)two_power_of_two(({real})k));
    }}
    return 0;
}}
"""


@pytest.mark.parametrize("other", [(), ("-D__FRAMAC__",)])
@pytest.mark.parametrize("real", REALS)
def test_powers_of_two_are_exact_in_every_reading(real: Real, other: tuple[str, ...], tmp_path: Path) -> None:
    """Of bits in C, by choices where an analyser reads it, in Python, and by the graph itself."""
    limits = np.finfo(TYPE[real])
    exponents = range(int(limits.minexp), int(limits.maxexp))
    exact = [2.0**k for k in exponents]
    assert evaluate(ARITHMETIC[real].power_of_two, real, list(exponents)).tolist() == exact
    text = "\n".join(("#include <stdbool.h>", "#include <stdint.h>", "#include <stdio.h>", *_two(real)))
    source = text + PRINTED.format(least=exponents[0], most=exponents[-1], real=real)
    program = emitted.compiled(emitted.tool("gcc"), {"two.c": source}, tmp_path, *other)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert [float.fromhex(each) for each in printed.split()] == exact
    x = ca.SX.sym("x")
    by_call = evaluated(ca.Function("f", [x], [ARITHMETIC[real].power_of_two(x)]), real)
    assert [float(by_call([[TYPE[real](k)]])[0][0]) for k in exponents] == exact


def _two(real: Real) -> Sequence[str]:
    """The text of the power of two, of the functions that call it."""
    lines = functions(C, "two", real, {"exp"}).lines
    start = next(k for k, line in enumerate(lines) if "two_power_of_two(" in line)
    return lines[start : lines.index("}", start) + 1]


# --- polynomials: the claims beside the coefficients, as log2 of the error

# by name: the function, its approximation from the argument and the tail's polynomial, the interval
FITS: dict[str, tuple[Callable[[Any], Any], Callable[[Any, Any], Any], float, float]] = {
    "sin": (mp.sin, lambda r, tail: r + r**3 * tail(r * r), 1e-6, math.pi / 2),
    "exp": (mp.expm1, lambda r, tail: r + r**2 * (0.5 + r * tail(r)), -math.log(2) / 2, math.log(2) / 2),
    "log": (lambda s: 2 * mp.atanh(s), lambda s, tail: 2 * s + s**3 * tail(s * s), 1e-6, 3 - 8**0.5),
    "atan": (mp.atan, lambda t, tail: t + t**3 * tail(t * t), 1e-6, 2**0.5 - 1),
    "asin": (mp.asin, lambda s, tail: s + s**3 * tail(s * s), 1e-6, 0.5),
}
CLAIMS = {
    "float": {"sin": -27.2, "exp": -25.8, "log": -30.1, "atan": -30.3, "asin": -27.6},
    "double": {"sin": -60.5, "exp": -54.8, "log": -59.4, "atan": -59.2, "asin": -55.8},
}


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", FITS)
def test_claimed_errors_of_the_polynomials(name: str, real: Real) -> None:
    exact, whole, low, high = FITS[name]
    arithmetic = ARITHMETIC[real]
    coefficients = [mp.mpf(arithmetic.near(c)) for c in getattr(arithmetic, f"{name}_tail")]
    with mp.workdps(40):
        errors = []
        for r in map(mp.mpf, np.linspace(low, high, 600).tolist()):
            approximation = whole(r, lambda z: mp.polyval(coefficients[::-1], z))
            errors.append(abs(approximation / exact(r) - 1))
        assert CLAIMS[real][name] - 0.3 <= float(mp.log(max(errors), 2)) <= CLAIMS[real][name]


# --- laws

floats = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False)
ODD = ("sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh")
EVEN = ("cos", "cosh")


@pytest.mark.full
@pytest.mark.parametrize("real", REALS)
@given(x=floats)
@settings(max_examples=50, deadline=None)
def test_symmetries_are_exact(real: Real, x: float) -> None:
    for name in ODD:
        np.testing.assert_array_equal(call(name, real, -x), -call(name, real, x))
    for name in EVEN:
        np.testing.assert_array_equal(call(name, real, -x), call(name, real, x))


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", ODD + EVEN)
def test_symmetries_are_exact_at_many_points(name: str, real: Real) -> None:
    """Among them the multiples of pi / 2, where the quotient rounds to a tie."""
    x = np.concatenate([points(name, real, 20_000), (np.arange(2000) * np.pi / 2).astype(TYPE[real])])
    mirrored = call(name, real, -x)
    np.testing.assert_array_equal(mirrored if name in EVEN else -mirrored, call(name, real, x))


@pytest.mark.ordinary("double")
@pytest.mark.parametrize("real", REALS)
@given(x=st.floats(-8192, 8192, width=32))
@settings(max_examples=100, deadline=None)
def test_sine_and_cosine_lie_on_the_circle(real: Real, x: float) -> None:
    """Each errs by 2.5 ulp <= 2.5 eps / 2, so s^2 + c^2 by 2 (|s| + |c|) <= 2.84 times that."""
    s, c = (float(call(name, real, x)) for name in ("sin", "cos"))
    assert abs(s * s + c * c - 1) <= 2.84 * 2.5 * np.finfo(TYPE[real]).eps / 2 + 4 * np.finfo(float).eps


@pytest.mark.ordinary("float")
@pytest.mark.parametrize("real", REALS)
@given(x=st.floats(2.0**-100, 2.0**100, width=32))
@settings(max_examples=100, deadline=None)
def test_exp_undoes_log(real: Real, x: float) -> None:
    """log errs by 0.9 ulp <= 0.9 eps |log x|, a relative error after exp, which adds 1.1 ulp <= 1.1 eps."""
    back = float(call("exp", real, call("log", real, x)))
    assert abs(back / x - 1) <= 1.02 * (0.9 * abs(math.log(x)) + 1.1) * np.finfo(TYPE[real]).eps


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize(("name", "low", "high"), [("exp", -80, 80), ("log", 1e-30, 1e30), ("tanh", -2, 2)])
def test_monotone(name: str, low: float, high: float, real: Real) -> None:
    """On a grid whose steps move the result by many ulp: there is no seam where k or a branch changes."""
    grid = np.unique(np.linspace(low, high, 8001) if low < 0 else np.geomspace(low, high, 8001))
    assert np.all(np.diff(call(name, real, grid)) > 0)


@pytest.mark.parametrize("real", REALS)
def test_square_root_is_monotone_at_its_seams(real: Real) -> None:
    """From number to number, for some thousand neighbours of the powers where its scaling changes."""
    bits = {"float": np.int32, "double": np.int64}[real]
    for seam in (2.0**-32, 2.0**-4, 1.0, 4.0, 16.0, 2.0**8, 2.0**16, 2.0**64):
        around = np.array(seam, TYPE[real]).view(bits) + np.arange(-2000, 2000, dtype=bits)
        assert np.all(np.diff(call("sqrt", real, around.view(TYPE[real]))) >= 0)
