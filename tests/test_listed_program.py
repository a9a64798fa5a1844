"""The program that a certificate lists: that of the step bit for bit, tied to its equation, and forged."""

import copy
import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cache
from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sp
from exact import evaluate, machine
from forger import sealed
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.certificates.rounding_share import Listing, program_listing
from hgogen.program import Place
from hgogen.recheck.algebra import Algebra, Quotient
from hgogen.recheck.arithmetic import Undefined, Unproved
from hgogen.recheck.interval import between, intervals, point
from hgogen.recheck.program import Computed, Deviations, ListedProgram, Rounded, Walk, precision
from hgogen.recheck.rules.discrete_time import _root
from hgogen.recheck.text import expression
from hgogen.recheck.verification import recheck

Step = Any
x, v, z = (hg.Signal(name, low=-most, high=most) for name, most in (("x", 2), ("v", 3), ("z", 1)))
u, y, y2 = hg.Signal("u", low=-1, high=1), hg.Signal("y"), hg.Signal("y2")
k, c = hg.Signal("k", nominal=2, low=1, high=3), hg.Signal("c", nominal=0.1)


def plant(*flow: Any, output: Any = (x,), states: Any = (x, v), parameters: Any = ()) -> hg.System:
    outputs = (y, y2)[: len(output)]
    return hg.System(
        "plant", states=states, inputs=(u,), outputs=outputs, parameters=parameters, flow=flow, output=output
    )


SWING = plant(v, -sp.sin(x) + u)
SCALED = plant(3 * v, -sp.sin(x / 10) + u, output=(x / 7,))
MIRRORED = plant(-3 * v, -sp.sin(x / 10) + u, output=(-x / 7,))
MOVING = plant((2 + u / 3) * v, -sp.sin(x))
KNOWN = plant(v, -k * sp.sin(x) - c * v + u, parameters=(k, c))
MANY = plant(v, -sp.tanh(x) * sp.exp(v / 4) + sp.sqrt(5 + x) - sp.cos(v) / (3 + x))
ROOTS = plant(v, -((x + 4) ** sp.Rational(1, 3)) - (x + 4) ** sp.Rational(27, 10) / 100 + u)
TURNING = plant(v, -sp.sin(2 * sp.pi * x / 7) * sp.sqrt(2) + v / sp.pi + u)
CUBIC = plant(v, -((x + 4) ** 3) / 50 + u)
SENSORS = plant(v, -sp.sin(x) + u, output=(x, 3 * x))
CHAINS = plant(v, -sp.sin(x) + z, -z + x / 3, output=(x, 2 * z), states=(x, v, z))
POLES: dict[str, Any] = {"theta": 7.3, "poles": (-1.37, -0.61)}
FILTERS: dict[str, Any] = {"theta": 6, "poles": (-1, -1), "alpha": 3, "beta": 1}
INJECTED: dict[str, Any] = {"theta": 6, "F": ((-3, 0), (1, -3)), "G": (1, 0), "H": ((2, 0), (0, 1))}
BOTH: dict[str, Any] = {"theta": 10, "poles": (-1, -1), "weights": {"y": 1, "y2": 0.3}}
CASES: dict[str, tuple[hg.System, str, dict[str, Any]]] = {
    "a swing": (SWING, "high_gain", POLES),
    "filters": (SWING, "filtered", FILTERS),
    "an injected filter": (SWING, "filtered_injection", INJECTED),
    "an argument": (SWING, "circle_criterion", {**POLES, "argument": (1.02, 0.3)}),
    "scales": (SCALED, "high_gain", POLES),
    "scales of a chain": (SCALED, "filtered", FILTERS),
    "saturations in its scales": (SCALED, "peaking_free", {"theta": 6}),
    "mirrored saturations": (MIRRORED, "peaking_free", {"theta": 6}),
    "pairs": (MIRRORED, "low_power", {"theta": 6}),
    "a gain that moves": (MOVING, "high_gain", {"theta": 6, "gains": (2, 0.5)}),
    "parameters": (KNOWN, "high_gain", {"theta": 20, "poles": (-1, -1)}),
    "functions": (MANY, "high_gain", {"theta": 30, "poles": (-1, -1)}),
    "powers": (ROOTS, "high_gain", {"theta": 20, "poles": (-1, -1)}),
    "numbers that are no quotients": (TURNING, "high_gain", {"theta": 20, "poles": (-1, -1)}),
    "a cube": (CUBIC, "high_gain", {"theta": 20, "poles": (-1, -1)}),
    "two sensors": (SENSORS, "high_gain", BOTH),
    "two chains": (CHAINS, "high_gain", {"theta": 10, "poles": ((-1, -1), (-1,))}),
    "chains that end together": (CHAINS, "high_gain", {"theta": 10, "poles": ((-1, -1), (-1,))}),
}
ALIGNED = {"chains that end together": "end"}


@cache
def step_of(case: str, method: str, between: str = "line") -> Step:
    system, name, gains = CASES[case]
    several = len(system.outputs) > 1
    form = hg.forms.block_triangular(system, align=ALIGNED.get(case)) if several else hg.forms.triangular(system)
    observer = getattr(hg.observers, name)(form, **gains)
    return hg.sample(observer, getattr(hg.methods, method), dt=1e-3, between=between)


@cache
def certified(case: str, method: str = "euler", real: str = "float", between: str = "line") -> dict[str, Any]:
    step = step_of(case, method, between)
    rates = {} if between == "hold" else {"u": 1}
    known = hg.error_bound(step, noise={"y": 1e-3}, rates=rates, real=real)  # type: ignore[arg-type]
    assert known.bounds, known.check.reason
    return hg.certificate(step.observer.form, (*step.observer.checks, known.check), step.observer.name)


def row(content: dict[str, Any]) -> Any:
    (one,) = (row for row in recheck(sealed(content)).rows if row.id.endswith(".error"))
    return one


def share(content: dict[str, Any]) -> dict[str, Any]:
    (one,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    (rounding,) = (each for each in one["shares"] if each["inputs"] == "rounding")
    return rounding  # type: ignore[no-any-return]


# --- the program is that of the step


def sine(value: Any) -> Any:
    """That of the program in floats."""
    return np.float32(evaluate(_SINE, [np.array([value])], "float")[0][0])


_A = ca.SX.sym("a")
_SINE = ca.Function("f", [_A], [ca.sin(_A)])
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": sine,
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "square": lambda a: a * a,
    "Abs": abs,
    "Min": min,
    "Max": max,
}


def run(program: Listing, values: Mapping[str, Any], number: Callable[[Fraction], Any]) -> list[Any]:
    """The fields after a call, in the arithmetic of the values."""
    known = dict(values)

    def of(operand: str) -> Any:
        return known[operand] if operand in known else number(Fraction(operand))

    for i, text in enumerate(program.statements, 1):
        word, *operands = text.split()
        known[f"v{i}"] = FUNCTIONS[word](*map(of, operands))
    return [of(operand) for operand in program.after]


@pytest.mark.ordinary(
    "filters-euler",
    "mirrored saturations-heun",
    "two sensors-heun",
    "two chains-heun",
    "an argument-euler",
    "an argument-rk4",
)
@pytest.mark.parametrize("method", ["euler", "heun", "rk4"])
@pytest.mark.parametrize("case", ["filters", "mirrored saturations", "two sensors", "two chains", "an argument"])
def test_it_is_the_program_bit_for_bit(case: str, method: str) -> None:
    """Of one call in floats."""
    step = step_of(case, method)
    program = program_listing(step, step.observer.error)
    assert program
    fields = [(field.name, field.size) for field in step.observer.parts[0].fields]
    each, rng, p = machine(step, "float"), np.random.default_rng(3), len(step.observer.form.output)
    for _ in range(20):
        start = np.float32(rng.uniform(-0.5, 0.5, len(program.after)))
        samples, inputs = np.float32(rng.uniform(-0.9, 0.9, (2, p))), np.float32(rng.uniform(-1, 1, (2, 1)))
        each.reset()
        each.record(inputs[:1].astype(float), samples[:1].astype(float))
        at = 0
        for name, size in fields:
            each.memory[Place("state", name)][:] = start[at : at + size]
            at += size
        each.record(inputs[1:].astype(float), samples[1:].astype(float))
        after = np.concatenate([each.memory[Place("state", name)] for name, _ in fields])
        known = {f"x{i}": value for i, value in enumerate(start, 1)}
        known |= {f"y{j + 1}{end}": samples[t, j] for j, (t, end) in product(range(p), enumerate(("_last", "")))}
        known |= {f"u1{end}": inputs[t, 0] for t, end in enumerate(("_last", ""))}
        np.testing.assert_array_equal(run(program, known, lambda value: np.float32(float(value))), np.float32(after))


def test_it_reads_as_the_step_does() -> None:
    """A constant as it was before a double held it; what nothing reads is not there."""
    program = program_listing(step_of("parameters", "euler"), step_of("parameters", "euler").observer.error)
    assert program
    assert program.statements == (
        *("mul 2 20", "square 20", "sub y1_last x1", "mul v1 v3", "add x2 v4", "mul v2 v3"),
        *("Max x1 -2", "Min v7 2", "sin v8", "mul 2 v9", "sub u1_last v10", "Max x2 -3", "Min v12 3", "mul 1/10 v13"),
        *("sub v11 v14", "add v6 v15", "mul 1/1000 v5", "add x1 v17", "mul 1/1000 v16", "add x2 v19"),
    )
    assert (program.stages, program.rates, program.after) == ((("x1", "x2"),), (("v5", "v16"),), ("v18", "v20"))


def test_an_end_of_a_range_stands_in_the_unit_of_its_field() -> None:
    """Of a saturation; no simple quotient would do for this one."""
    w = hg.Signal("w", low=-3, high=Fraction(30000001, 10**7))
    system = plant(3 * w, -sp.sin(x / 10) + u, output=(x / 7,), states=(x, w))
    observer = hg.observers.peaking_free(hg.forms.triangular(system), theta=6)
    program = program_listing(hg.sample(observer, hg.methods.euler, dt=1e-3), observer.error)
    assert program
    assert "Min v5 90000003/70000000" in program.statements


# --- it is tied to the equation of its observer, and what it rounds is computed again


@pytest.mark.ordinary("a swing", "two sensors", "chains that end together")
@pytest.mark.parametrize("case", CASES)
def test_what_every_step_rounds_is_derived(case: str) -> None:
    one = row(certified(case, "euler", "double"))
    assert one.found == "verified", one.sentence
    assert "operations in double round" in one.sentence


@pytest.mark.ordinary("mirrored saturations", "two chains")
@pytest.mark.parametrize("case", ["filters", "mirrored saturations", "two chains"])
def test_what_two_stages_round_is_derived(case: str) -> None:
    """Fields and rates of stages that are the same statement among them."""
    one = row(certified(case, "heun"))
    assert one.found == "verified", one.sentence
    assert "operations in float round" in one.sentence


@pytest.mark.full
@pytest.mark.parametrize("between", ["line", "hold"])
def test_all_stages_of_runge_and_kutta_are_tied(between: str) -> None:
    one = row(certified("a swing", "rk4", "float", between))
    assert one.found == "verified"
    assert (
        f"what {73 if between == 'line' else 69} operations in float round while the estimate errs by" in one.sentence
    )
    assert ", where sin errs by at most 4 ulps" in one.sentence


def changed(content: dict[str, Any], **parts: Any) -> dict[str, Any]:
    other = copy.deepcopy(content)
    share(other)["follows"] |= parts
    return other


@pytest.mark.full
def test_every_statement_is_needed_as_it_is() -> None:
    """Each with another operation, and with its operands in another order where that is another number."""
    content = certified("a swing")
    program = share(content)["follows"]["program"]
    for i, text in enumerate(program):
        word, *operands = text.split()
        others = [" ".join((WRONG[word], *operands))]
        others += [" ".join((word, *operands[::-1]))] if word in ("sub", "div") else []
        others += [" ".join((word, *operands[:-1], f"v{i}"))] if i and operands[-1] != f"v{i}" else []
        for other in others:
            forged = changed(content, program=[*program[:i], other, *program[i + 1 :]])
            assert row(forged).found == "fails", other


WRONG = {"mul": "add", "add": "sub", "sub": "add", "square": "neg", "Max": "Min", "Min": "Max", "sin": "cos"}


@pytest.mark.parametrize("by", ["1001/1000", "1000001/1000000", "1000000001/1000000000"])
def test_a_constant_is_beside_its_own_by_what_a_double_rounds_alone(by: str) -> None:
    content = certified("a swing", real="double")
    program = share(content)["follows"]["program"]
    other = [text.replace("1/1000", str(Fraction(1, 1000) * Fraction(by))) for text in program]
    assert other != program
    assert row(changed(content, program=other)).found == "fails"


@pytest.mark.parametrize(("case", "real"), [("a swing", "float"), ("filters", "double"), ("two chains", "float")])
def test_no_size_of_it_may_be_smaller(case: str, real: str) -> None:
    content = certified(case, real=real)
    for i, size in enumerate(share(content)["fields"]):
        forged = copy.deepcopy(content)
        share(forged)["fields"][i] = str(Fraction(size) * Fraction(9, 10))
        one = row(forged)
        assert one.found == "fails"
        assert "a size of its rounding is less than how far its program is" in one.sentence


LIES: dict[str, tuple[dict[str, Any], str]] = {
    "errors that shares exceed": ({"within": ["1/1000000", "1/1000000"]}, "less than what all shares come to"),
    "one error that shares exceed": ({"within": ["1", "1/1000000"]}, "less than what all shares come to"),
    "a plant that stands still": ({"speeds": ["0", "0"]}, "it does not hold at"),
    "another precision": ({"precision": "half"}, "its precision is none of float, double"),
    "inputs that are held": ({"between": "hold"}, "its program holds inputs that move"),
    "other inputs": ({"between": "curve"}, "its between is none of line, hold"),
    "another parameter": ({"parameters": ["2", "1/10"]}, "its parameters has not 0 entries"),
    "rates that are fields": ({"rates": [["x2", "x1"]]}, "x2 of its program is not what the step has"),
    "a number for a field": ({"after": ["0", "0"]}, "0 of its program is not what the step has"),
    "a statement that is not there": ({"after": ["v99", "v99"]}, "reads a statement that it has not"),
    "a name that is not there": ({"after": ["w", "w"]}, "reads 'w', which it has not"),
    "no stages": ({"stages": []}, "its stages has not 1 entries"),
    "numbers for names": ({"after": [1, 2]}, "its after are no operands"),
    "no program": ({"program": []}, "reads a statement that it has not"),
    "no texts": ({"program": [None]}, "its program is no list"),
    "an empty statement": ({"program": [""]}, "its program is no list"),
    "a statement of itself": ({"program": ["add v1 v1"]}, "statement 1 reads one that is not before it"),
    "an operation of none": ({"program": ["add"]}, "takes 'add' of 0 values"),
    "an unknown operation": ({"program": ["fma x1 x1 x1"]}, "has the operation 'fma', whose rounding is not known"),
    "a broken power": ({"program": ["pow x1 1/2"]}, "has the power '1/2', which is a square root"),
    "a division by nothing": ({"program": ["div x1 0"]}, "its program has no value"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_forged_program_fails(lie: str) -> None:
    parts, said = LIES[lie]
    one = row(changed(certified("a swing"), **parts))
    assert one.found == "fails"
    assert said in one.sentence


def test_a_parameter_of_the_program_is_in_its_range() -> None:
    """And the one that its statements have."""
    content = certified("parameters")
    outside, beside = "outside the model's range", "from the step"
    for value, said in (("4", outside), ("0", outside), ("3", beside)):
        one = row(changed(content, parameters=[value, "1/10"]))
        assert one.found == "fails"
        assert said in one.sentence


@pytest.mark.parametrize("field", range(4))
def test_of_each_field_the_errors_are_those_of_all_shares(field: int) -> None:
    """A filter's as well, which no share bounds by itself."""
    content = certified("filters", real="double")
    within = [str(Fraction(x) / (10 if k == field else 1)) for k, x in enumerate(share(content)["follows"]["within"])]
    assert "less than what all shares come to" in row(changed(content, within=within)).sentence


def test_floats_do_not_pass_for_doubles() -> None:
    assert row(changed(certified("a swing", real="double"), precision="float")).found == "fails"


def test_without_a_program_nothing_is_verified() -> None:
    forged = copy.deepcopy(certified("a swing"))
    share(forged)["follows"] = {}
    assert row(forged).found == "fails"


# --- the analysis itself


UNARY = {"neg": lambda a: -a, "square": lambda a: a * a, "Abs": abs, "sqrt": mpmath.sqrt}
WORDS = (*UNARY, "add", "sub", "mul", "div", "Min", "Max")


@pytest.mark.full
@given(
    st.lists(st.tuples(st.sampled_from(WORDS), st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=8),
    st.sampled_from(["float", "double"]),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=150)
def test_no_program_is_further_from_exact_arithmetic(rows: list[tuple[str, int, int]], real: str, seed: int) -> None:
    """In numpy's numbers of a precision, from anywhere in ranges, against 60 digits."""
    rng, dtype = np.random.default_rng(seed), {"float": np.float32, "double": np.float64}[real]
    names, low = ["x1", "x2", "1/3", "2", "0.1"], rng.uniform(-2, 2, 2)
    high = low + rng.choice([0.0, 1.0], 2)
    statements = list[tuple[str, list[str]]]()
    for i, (word, a, b) in enumerate(rows, 1):
        operands = [names[a % len(names)], names[b % len(names)]][: 1 if word in UNARY else 2]
        statements.append((word, operands))
        names.append(f"v{i}")
    ends = [(Fraction(float(dtype(a))), Fraction(float(dtype(b)))) for a, b in zip(low, high, strict=True)]
    held = {f"x{i}": Computed(real, between(*pair)) for i, pair in enumerate(ends, 1)}
    walk = Walk(ListedProgram(statements, [], [], []), held, precision(real))
    try:
        known = walk.value(names[-1])
    except Undefined:
        return
    top = known.error.exactly[1]
    least, most = known.value.exactly
    for _ in range(10):
        at = [dtype(float(a + (b - a) * Fraction(float(rng.choice([0, 1, rng.random()]))))) for a, b in ends]
        with mpmath.workdps(60):
            exact: dict[str, Any] = {f"x{i}": mpmath.mpf(float(value)) for i, value in enumerate(at, 1)}
            computed: dict[str, Any] = {f"x{i}": value for i, value in enumerate(at, 1)}
            for name in ("1/3", "2", "0.1"):
                exact[name] = mpmath.mpf(Fraction(name).numerator) / Fraction(name).denominator
                computed[name] = dtype(float(Fraction(name)))
            for i, (word, operands) in enumerate(statements, 1):
                function = UNARY.get(word) or FUNCTIONS[word]
                exact[f"v{i}"] = function(*(exact[each] for each in operands))
                function = np.sqrt if word == "sqrt" else function
                computed[f"v{i}"] = dtype(function(*(computed[each] for each in operands)))
            value, off = exact[names[-1]], abs(mpmath.mpf(float(computed[names[-1]])) - exact[names[-1]])
            assert off <= mpmath.mpf(top.numerator) / top.denominator
            slack = abs(value) * mpmath.mpf(10) ** -20
            assert mpmath.mpf(least.numerator) / least.denominator - slack <= value
            assert value <= mpmath.mpf(most.numerator) / most.denominator + slack


def of(value: float, error: float = 0.0, real: str = "float") -> Computed:
    ends = between(Fraction(value), Fraction(value))
    return Computed(real, ends, between(Fraction(error), Fraction(error)))


@pytest.mark.parametrize(
    ("word", "errors", "least"),
    [
        ("add", (0.5, 0.25), 0.75),
        ("sub", (0.5, 0.25), 0.75),
        ("mul", (0.5, 0.25), 1.875),
        ("div", (0.5, 0.0), 0.25),
        ("div", (0.0, 0.25), 3 / 1.75 - 1.5),
        ("Min", (0.5, 0.25), 0.5),
        ("Max", (0.25, 0.5), 0.5),
    ],
)
def test_what_both_operands_err_by_goes_on(word: str, errors: tuple[float, float], least: float) -> None:
    """Of 3 and 2, by as much as operands at the ends of their errors make it, and a rounding."""
    held = {f"x{i}": of(value, error) for i, (value, error) in enumerate(zip((3.0, 2.0), errors, strict=True), 1)}
    walk = Walk(ListedProgram([(word, ["x1", "x2"])], [], [], []), held, precision("float"))
    error = float(walk.value("v1").error.exactly[1])
    rounded = 0 if word in ("Min", "Max") else 2.0**-24 * {"add": 5, "sub": 1, "mul": 6, "div": 1.5}[word]
    assert least + rounded <= error <= (least + rounded) * (1 + 1e-6) + 2.0**-24


@pytest.mark.parametrize(
    ("name", "at", "slope"),
    [("sin", 0.5, math.cos(0.4)), ("exp", 1.0, math.exp(1.1)), ("tan", 0.2, 1 + math.tan(0.3) ** 2)],
)
def test_a_function_hands_on_its_steepest_slope_and_errs_itself(name: str, at: float, slope: float) -> None:
    walk = Walk(ListedProgram([(name, ["x1"])], [], [], []), {"x1": of(at, 0.1)}, precision("float"))
    inherited = float(walk.value("v1").error.exactly[1])
    alone = Walk(ListedProgram([(name, ["x1"])], [], [], []), {"x1": of(at)}, precision("float"))
    own = float(alone.value("v1").error.exactly[1])
    least = (16 if name == "tan" else 8) * 2.0**-24 * abs(getattr(math, name)(at))
    assert least < own < least * 1.001
    assert 0.1 * slope * 0.999 <= inherited <= 0.1 * slope * 1.01 + 1e-5


def test_angles_beyond_those_that_were_measured_have_no_bound() -> None:
    for size, known in ((199.0, True), (201.0, False)):
        content = Walk(ListedProgram([("sin", ["x1"])], [], [], []), {"x1": of(size)}, precision("float"))
        if known:
            assert content.value("v1").error.finite
        else:
            with pytest.raises(Undefined, match="an angle beyond those"):
                content.value("v1")


def applied(text: str, at: Computed) -> Computed:
    """A statement of x1, which is `at`."""
    word, *operands = text.split()
    value: Computed = Walk(ListedProgram([(word, operands)], [], [], []), {"x1": at}, precision(at.real)).value("v1")
    return value


@pytest.mark.parametrize(("real", "half"), [("float", 64), ("double", 512)])
def test_what_may_overflow_has_no_bound(real: str, half: int) -> None:
    """2^128 is no number of floats, 2^126 is one."""
    assert applied("mul x1 x1", of(2.0 ** (half - 1), real=real)).error.finite
    with pytest.raises(Undefined, match="may overflow"):
        applied("mul x1 x1", of(2.0**half, real=real))


@pytest.mark.parametrize("text", ["mul 2 x1", "mul x1 2", f"Min x1 {10**39}"])
def test_what_rounds_nothing_may_overflow(text: str) -> None:
    """Twice a number, and a constant."""
    with pytest.raises(Undefined, match="may overflow"):
        applied(text, of(2.0**127))


@pytest.mark.parametrize(("real", "least"), [("float", -126), ("double", -1022)])
def test_what_underflows_may_be_lost(real: str, least: int) -> None:
    """Wholly, where a machine has no numbers below the smallest normal one."""
    assert applied("mul x1 x1", of(2.0 ** (least // 2 - 1), real=real)).error.exactly[1] >= Fraction(2) ** least


@pytest.mark.parametrize(("at", "exponent"), [(0.25, -2), (2.0, -1), (2.0, 3)])
def test_a_power_hands_on_its_steepest_slope(at: float, exponent: int) -> None:
    """That at the end of its base that is nearer to zero where it falls, at the other one where it rises."""
    end = at + math.copysign(0.125, exponent)
    steepest = 0.125 * abs(exponent * end ** (exponent - 1))
    assert steepest <= float(applied(f"pow x1 {exponent}", of(at, 0.125)).error.exactly[1]) <= steepest * 1.001


# --- what it is computed on, and what it is tied to


@pytest.mark.parametrize(("name", "most"), [("x1", 5), ("y1_last", 7), ("y1", 7)])
@pytest.mark.parametrize("side", [-1, 1])
def test_what_is_rounded_is_that_at_the_far_end_of_all_ranges(name: str, most: int, side: int) -> None:
    """Of a square, where the state is within 4 on one side, its error 1, its sample's 2, and it moves by 1."""
    context = SimpleNamespace(
        z=["z1"],
        observed=["z1"],
        file=SimpleNamespace(inputs=()),
        form=SimpleNamespace(
            box={"z1": tuple(sorted((Fraction(0), Fraction(4 * side))))}, output=[expression("z1", ["z1"])]
        ),
    )
    equation = SimpleNamespace(context=context, units=[1], scales=[1], error=SimpleNamespace(index=[0], fed=[True]))
    program = ListedProgram([("square", [name])], [], [], ["v1"])
    step: Any = SimpleNamespace(
        equation=equation, program=program, h=1, deviations=lambda: SimpleNamespace(statements={})
    )
    one, size = Fraction(1), Fraction(most**2, 2**24)
    rounded = Rounded(step, "float", [2 * one], [one], [one])
    assert rounded.demand_sizes([size * Fraction("1.000001")]) == 32
    with pytest.raises(Unproved, match="a size of its rounding is less"):
        rounded.demand_sizes([size * Fraction("0.999999")])


def test_the_plant_moves_at_its_speed_and_by_what_is_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the method leaves something in each row."""
    content, seen = changed(certified("a swing"), speeds=["5", "7"]), []
    monkeypatch.setattr("hgogen.recheck.program.Rounded", lambda *parts: seen.append(parts[-1]) or Rounded(*parts))
    assert row(content).found == "fails"
    (claim,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    (left,) = (map(Fraction, one["beside"]) for one in claim["shares"] if one["inputs"] == "method")
    assert seen == [[Fraction(claim["dt"]) * (speed + more) for speed, more in zip((5, 7), left, strict=True)]]


def summed() -> tuple[Deviations, Quotient, Quotient]:
    """Statements of a program that adds two names; and these."""
    algebra = Algebra(["x1", "x2", "field 0", "rate 0"])
    x1, x2 = (algebra.names[name] for name in ("x1", "x2"))
    walk = Walk(ListedProgram([("add", ["x1", "x2"])], [], [], []), {"x1": x1, "x2": x2}, algebra.arithmetic)
    return Deviations(algebra, walk, {"field 0": "v1", "rate 0": "v1"}), x1, x2


def test_a_statement_is_beside_one_value_alone() -> None:
    """How far it is from another would not be known."""
    stage, x1, x2 = summed()
    stage.match(["v1"], [x1 + x2], "field")
    after, *both = summed()
    for statements, wanted in ((stage, [x1]), (after, both)):
        with pytest.raises(Unproved, match="v1 of its program is not what the step has"):
            statements.match(["v1"] * len(wanted), wanted)


def test_a_statement_that_stands_for_several_keeps_its_first_letter() -> None:
    statements, x1, x2 = summed()
    for letters in ("field", "rate", ""):
        assert statements.match(["v1"], [x1 + x2], letters) == [statements.algebra.names["field 0"]]


@pytest.mark.parametrize("by", [Fraction(-1, 8), Fraction(1, 8)])
def test_a_statement_errs_by_as_much_as_it_is_beside(by: Fraction) -> None:
    """Below what the step has as above it."""
    statements, x1, x2 = summed()
    statements.match(["v1"], [x1 + x2 + statements.algebra.number(by)])
    error = statements.statements["v1"](statements.walk, of(5.0)).error
    assert error.exactly == (Fraction(1, 8), Fraction(1, 8))


def test_a_quotient_has_its_denominator_as_often_as_it_is_there() -> None:
    algebra = Algebra(["x1"])
    below = algebra.names["x1"] + algebra.number(Fraction(1))
    quotient = algebra.number(Fraction(1)) / below / below
    value = algebra.value(quotient, {"x1": point(Fraction(1))}, intervals)
    assert value.exactly == (Fraction(1, 4), Fraction(1, 4))


def test_a_program_has_an_end() -> None:
    one = row(changed(certified("a swing"), program=["neg x1"] * 5_001))
    assert "is no list of at most 5000 statements" in one.sentence


def test_errors_that_rounding_itself_makes_are_among_all() -> None:
    """Those within which a program rounds are not those of the other shares alone."""
    content = certified("a swing")
    (claim,) = (each["evidence"] for each in content["claims"] if each["id"].endswith(".error"))
    bounds = [sum(Fraction(one["bounds"][k]["bound"]) for one in claim["shares"]) for k in range(2)]
    for left, outcome in ((0, "verified"), (Fraction(1, 2), "fails")):
        rounding = [left * Fraction(one["bound"]) for one in share(content)["bounds"]]
        within = [str(bound - own) for bound, own in zip(bounds, rounding, strict=True)]
        assert row(changed(content, within=within)).found == outcome


@pytest.mark.parametrize("value", ["2", "4", "1/3"])
def test_a_root_is_rounded_up(value: str) -> None:
    root = _root(Fraction(value))
    assert Fraction(value) < root**2 < Fraction(value) + Fraction(1, 2**190)
