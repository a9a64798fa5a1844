"""Invariants: constraints that the flow keeps, on which every estimate stays."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from time import process_time
from typing import Any

import flint
import numpy as np
import pytest
import sympy as sp
from emitted import step as emitted
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.analysis.manifold import projected_points
from hgogen.analysis.singularity import of_plant
from hgogen.prove.dissipation import BadErrorSystem
from hgogen.reading.given import BadGain
from hgogen.reading.text_model import BadModelFile, from_table, to_text
from hgogen.rigor.invariant import Division, divided, rate, restricted
from hgogen.rigor.series import Undecided
from hgogen.rigor.zero_point import zero_near
from hgogen.run.gramian import observability_measure
from hgogen.stepping.invariants import sphere
from hgogen.system import BadSystem, valued
from hgogen.trial import BadTrial, Trial, proposed_trial, simulate

DT, SIGMA = 0.01, 0.01


def signals(names: str, low: float = -1, high: float = 1) -> list[hg.Signal]:
    return [hg.Signal(name, low=low, high=high) for name in names.split()]


def attitude(vectors: Sequence[str] = "xz", bias: bool = True) -> hg.System:
    """A unit quaternion q with a gyro w = omega + b and axes of the world seen in the body, "x" and "z"."""
    q, b, w = signals("q0 q1 q2 q3"), signals("b0 b1 b2", -2, 2), signals("w0 w1 w2", -2, 2)
    rate = [one - (off if bias else 0) for one, off in zip(w, b, strict=True)]
    q0, q1, q2, q3 = q
    flow = [
        -q1 * rate[0] - q2 * rate[1] - q3 * rate[2],
        q0 * rate[0] - q3 * rate[1] + q2 * rate[2],
        q3 * rate[0] + q0 * rate[1] - q1 * rate[2],
        -q2 * rate[0] + q1 * rate[1] + q0 * rate[2],
    ]
    axes = {
        "x": [q0**2 + q1**2 - q2**2 - q3**2, 2 * (q1 * q2 - q0 * q3), 2 * (q1 * q3 + q0 * q2)],
        "z": [2 * (q1 * q3 - q0 * q2), 2 * (q2 * q3 + q0 * q1), q0**2 - q1**2 - q2**2 + q3**2],
    }
    return hg.System(
        "attitude",
        states=(*q, *(b if bias else ())),
        inputs=w,
        outputs=[hg.Signal(f"{v}{i}") for v in vectors for i in range(3)],
        flow=[*(f / 2 for f in flow), *([0, 0, 0] if bias else [])],
        output=[row for v in vectors for row in axes[v]],
        invariants=(q0**2 + q1**2 + q2**2 + q3**2 - 1,),
    )


# --- the declaration ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("invariant", "said"),
    [
        ("q0**2 - q1", "invariant 1, q0\\*\\*2 - q1 = 0, is not kept by the flow, which changes it by"),
        ("w0", "uses the input w0"),
        ("2", "has no zero that depends on states"),
        ("q0*nowhere", "unknown symbol nowhere"),
        ("I*q0", "is not finite and real"),
    ],
)
def test_an_invariant_that_is_none_is_refused(invariant: str, said: str) -> None:
    plant = attitude(bias=False)
    names = {s.name: s for s in plant.signals}
    with pytest.raises(BadSystem, match=said):
        hg.System(
            "bad",
            states=plant.states,
            inputs=plant.inputs,
            outputs=plant.outputs,
            flow=plant.flow,
            output=plant.output,
            invariants=[sp.sympify(invariant, locals=names)],
        )


x, y, k = sp.symbols("x y k", real=True)


@pytest.mark.parametrize(
    ("constraint", "flow", "invariant"),
    [
        (x**2 + y**2 - 1, {x: -y, y: x}, True),
        (x**2 + y**2 - 1, {x: -y + x * (1 - x**2 - y**2), y: x + y * (1 - x**2 - y**2)}, True),  # only on the circle
        (x**2 + y**2 - 1, {x: -y + x / 100, y: x}, False),
        (x**2 / 2 - k * sp.cos(y) - 1, {y: x, x: -k * sp.sin(y)}, True),
        (sp.exp(x) * y - 1, {x: y, y: -(y**2)}, True),
        (x**2 - y, {x: sp.Abs(x), y: 2 * x * sp.Abs(x)}, True),
        (x - y, {x: y, y: x}, True),  # x - y decays, so that 0 stays 0
    ],
)
def test_what_a_flow_keeps_is_proved(constraint: sp.Expr, flow: dict[sp.Symbol, sp.Expr], invariant: bool) -> None:
    assert (divided(rate(constraint, flow), [constraint]).remainder == 0) is invariant


CIRCLE = x**2 + y**2 - 1


def test_an_expression_is_divided_by_constraints() -> None:
    assert divided(x * CIRCLE + y, [CIRCLE]) == Division((x,), y)
    assert divided(x**2 * y + y**3 - y, [x**2 - y, CIRCLE]).remainder == 0
    assert divided(x**2 * y + y**3 - y + k, [x**2 - y, CIRCLE]).remainder != 0
    assert divided(sp.sin(x) - sp.sin(y), [x - y]) == Division((sp.cos(x),), 0)
    assert divided(sp.Abs(x), []).remainder == sp.Abs(x)


@pytest.mark.parametrize(
    ("row", "there"),
    [
        (y * sp.Abs(CIRCLE) + x, x),
        (y * sp.sin(CIRCLE) + x, x),
        (y * (sp.exp(CIRCLE) - 1) + x, x),
        (y * sp.sqrt(sp.Abs(CIRCLE)) + x, x),
        (sp.Max(x, x + y * CIRCLE), x),
        (sp.Piecewise((y, CIRCLE > 0), (x, True)), x),
        (sp.Piecewise((y, CIRCLE >= 0), (x, True)), y),
        (sp.Piecewise((y, sp.exp(CIRCLE) > 1), (x, True)), x),
        (y * CIRCLE + x, y * CIRCLE + x),  # smooth: ranks are taken along the constraint
        (y / sp.Abs(CIRCLE), y / sp.Abs(CIRCLE)),  # has no value there
        (y * sp.Abs(CIRCLE) / CIRCLE, y * sp.Abs(CIRCLE) / CIRCLE),
        (y * sp.sin(CIRCLE) / CIRCLE, y),
        (x + y * (sp.exp(CIRCLE) - 1) / CIRCLE, x + y),
        (y * sp.Abs(sp.sqrt(x**2 + y**2) - 1) + x, x),
        (x + sp.Max(sp.log(x**2 + y**2), 0), x),
        (x + y * sp.Heaviside(CIRCLE), x + y / 2),
    ],
)
def test_functions_of_what_is_a_number_on_constraints_have_their_value_there(row: sp.Expr, there: sp.Expr) -> None:
    assert divided(restricted(row, [CIRCLE]) - there, [CIRCLE]).remainder == 0


def test_a_removable_singularity_on_an_invariant_is_filled_in() -> None:
    def observed(output: sp.Expr) -> Any:
        return hg.observability(on([z], {a: b, b: -a, z: 0}, output=[output]))

    assert dict(observed(a + b * sp.sin(z) / z).known.orders)[a] == 1
    assert observed(b * sp.sin(z) / z).rank == 3
    check = observed(b * sp.Abs(z) / z).checks[0]
    assert check.verdict is hg.Verdict.UNKNOWN
    assert "at none of 282 points on the invariants is the plant known to have a value" in str(check.reason)


def on(invariants: Sequence[Any], flow: dict[hg.Signal, Any], parameters: Sequence[hg.Signal] = (), **more: Any) -> Any:
    rows: dict[str, Any] = {"outputs": (hg.Signal("out"),), "output": [list(flow)[-1]], "invariants": invariants}
    return hg.System("on", states=tuple(flow), flow=list(flow.values()), parameters=tuple(parameters), **rows | more)


a, b, z = signals("a b z", -2, 2)
RING = a**2 + b**2 - 1
SLOW = hg.Signal("slow", nominal=2.0)
POSITIVE = hg.Signal("positive", low=0.5, high=2)


@pytest.mark.parametrize(
    ("invariant", "flow"),
    [
        (RING, {a: -b * sp.Max(z, 0), b: a * sp.Max(z, 0), z: 0}),
        (RING, {a: -b * sp.Piecewise((z, z > 0), (0, True)), b: a * sp.Piecewise((z, z > 0), (0, True)), z: 0}),
        (RING, {a: -b * sp.sign(z), b: a * sp.sign(z), z: 0}),
        (sp.sqrt(a**2 + b**2) - 1, {a: -b, b: a, z: 0}),
        (sp.exp(a) - 1, {a: a * b, b: -b}),
        (sp.sin(a), {a: sp.sin(2 * a), b: -b}),
        (b / a, {a: -a, b: -a * b, z: 0}),
        (SLOW * a, {a: a * b, b: -b}),
        (a - b, {a: sp.sin(a), b: sp.sin(b), z: 0}),
        (a, {a: -sp.Max(a, 0), b: -b}),
        (b - sp.exp(a), {a: -a, b: -a * sp.exp(a) - sp.Max(b - sp.exp(a), 0)}),
        (POSITIVE**2 - 1, {POSITIVE: 1 - POSITIVE**2, b: -b}),
        (a, {a: -a * sp.Abs(a), b: -b}),
    ],
)
def test_what_is_kept_is_admitted(invariant: sp.Expr, flow: dict[hg.Signal, Any]) -> None:
    plant = on([invariant], flow, parameters=[SLOW] if invariant.has(SLOW) else [])
    assert hg.observability(plant).rank <= len(flow)


@pytest.mark.parametrize(
    ("invariant", "flow", "said"),
    [
        (RING, {a: -b + a * RING / sp.Abs(RING), b: a + b * RING / sp.Abs(RING), z: 0}, "not known to be kept"),
        (a, {a: a * sp.log(a) ** 2, b: -b}, "not known to be kept"),
        (a, {a: sp.sqrt(sp.Abs(a)), b: -b}, "not known to be kept"),
        (a, {a: a / sp.sqrt(sp.Max(sp.Abs(a), b)), b: 0}, "not known to be kept"),
        (a, {a: a / (sp.sqrt(sp.Abs(a)) + sp.Max(b, 0)), b: 0}, "not known to be kept"),
        (a, {a: sp.Piecewise((1, a > 0), (0, True)), b: -b}, "not kept by the flow"),
        (RING**2, {a: -b, b: a, z: 0}, r"no slope where it is 0; write a\*\*2 \+ b\*\*2 - 1"),
        (a * z, {a: a * b, b: 0, z: z * b}, "is 0 where a = 0 or z = 0; write the one where the plant is"),
        (a**2 - 9, {a: a**2 - 9, b: 0}, "has no zero that depends on states in their ranges"),
        (SLOW - 2, {a: a, b: 0}, "has no zero that depends on states in their ranges"),
    ],
)
def test_what_may_be_left_is_refused(invariant: sp.Expr, flow: dict[hg.Signal, Any], said: str) -> None:
    with pytest.raises(BadSystem, match=said):
        on([invariant], flow, parameters=[SLOW])


def test_a_text_model_declares_them_and_is_written_with_them() -> None:
    table = {
        "name": "circle",
        "states": {"c": {"flow": "-s"}, "s": {"flow": "c"}},
        "outputs": {"y": {"equation": "c"}},
        "invariants": ["c**2 + s**2 - 1"],
    }
    plant = from_table(table).plant
    assert [str(e) for e in plant.invariants] == ["c**2 + s**2 - 1"]
    assert 'invariants = ["c**2 + s**2 - 1"]' in to_text(plant)
    with pytest.raises(BadModelFile, match="a list of expressions"):
        from_table({**table, "invariants": "c**2 + s**2 - 1"})
    with pytest.raises(BadModelFile, match="is not kept by the flow"):
        from_table({**table, "invariants": ["c - s"]})


def test_a_recast_plant_and_one_with_other_values_keep_them() -> None:
    c, s, w = *signals("c s"), hg.Signal("w", nominal=1.0, low=0.5, high=2)
    y = hg.Signal("y")
    plant = hg.System(
        "circle",
        states=(c, s),
        outputs=(y,),
        parameters=(w,),
        flow=[-w * s, w * c],
        output=[c],
        invariants=(c**2 + s**2 - 1,),
    )
    assert valued(plant, {"w": 2.0}).invariants == plant.invariants
    r, phi = hg.Signal("r", low=0.5, high=2), hg.Signal("phi", low=-1, high=1)
    polar = hg.recast(plant, {r: sp.sqrt(c**2 + s**2), phi: sp.atan(s / c)}, {c: r * sp.cos(phi), s: r * sp.sin(phi)})
    assert [sp.simplify(e) for e in polar.invariants] == [r**2 - 1]
    assert plant.opposites == ()  # the output tells c from -c


# --- points -------------------------------------------------------------------------------------------------


def test_points_come_onto_the_invariants_and_0_becomes_a_unit() -> None:
    plant = attitude(bias=False)
    drawn = np.random.default_rng(0).normal(size=(50, 4))
    points = projected_points(plant.invariants, plant.states, plant.nominal, np.vstack([np.zeros(4), drawn]))
    assert np.linalg.norm(points, axis=1) == pytest.approx(np.ones(51), abs=1e-12)
    assert points[0] == pytest.approx([1, 0, 0, 0])
    lengths = np.linalg.norm(drawn, axis=1, keepdims=True)
    assert points[1:] == pytest.approx(drawn / lengths, abs=1e-9)
    assert projected_points((), plant.states, {}, drawn) is drawn


@pytest.mark.parametrize(
    ("constraint", "parts"),
    [
        (x**2 + y**2 - 4, ((0, 1), 4)),
        (3 * y**2 - 3 * k**2, ((1,), k**2)),
        (x**2 - y**2 - 1, ((), 0)),
        (x**2 + 2 * y**2 - 1, ((), 0)),
        (x**2 + y - 1, ((), 0)),
        (x**2 + y**2 + 1, ((), 0)),
        (x * y - 1, ((), 0)),
        (sp.cos(x) - y, ((), 0)),
    ],
)
def test_a_sphere_is_known_by_its_equation(constraint: sp.Expr, parts: Any) -> None:
    assert sphere(constraint, (x, y)) == parts


def test_opposites_are_found_and_no_others() -> None:
    assert attitude().opposites == ((0, 1, 2, 3),)
    c, s = signals("c s")
    circle = {
        "states": (c, s),
        "outputs": (hg.Signal("y"),),
        "flow": [-s, c],
        "invariants": [c**2 + s**2 - 1],
    }
    assert hg.System("odd", output=[c], **circle).opposites == ()
    assert hg.System("even", output=[c * s], **circle).opposites == ((0, 1),)


def test_a_trial_starts_on_them() -> None:
    plant = attitude()
    start = proposed_trial(plant).start
    assert sum(start[f"q{i}"] ** 2 for i in range(4)) == pytest.approx(1, abs=1e-12)
    off = Trial("off", 1.0, {**start, "q0": 1.0}, {f"w{i}": 0 for i in range(3)})
    with pytest.raises(BadTrial, match=r"start is not on the plant's invariants; take q0 = 0\.75592[89], q1 = 0\.37"):
        simulate(plant, off, DT)


def test_a_truth_stays_on_them_where_the_flow_alone_would_leave() -> None:
    """Off the circle the flow leads away like exp(10 t): of the integrator's errors nothing would be left to see."""
    plant = on([RING, 2 * RING], {a: -b + 5 * a * RING, b: a + 5 * b * RING, z: 0})
    truth = simulate(plant, Trial("turn", 8.0, {"a": 1, "b": 0, "z": 0.5}), DT)
    exact = np.c_[np.cos(truth.t), np.sin(truth.t), 0.5 * np.ones_like(truth.t)]
    assert truth.x == pytest.approx(exact, abs=1e-6)


def test_a_row_of_a_rotation_that_nothing_measures_is_known_by_the_others() -> None:
    R = [signals(f"r{i}0 r{i}1 r{i}2") for i in range(3)]
    w = signals("wx wy wz")
    turn = sp.Matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    every = sp.Matrix(R)
    rows: dict[str, Any] = {
        "states": tuple(one for row in R for one in row),
        "inputs": w,
        "outputs": tuple(hg.Signal(f"y{i}{j}") for i in range(2) for j in range(3)),
        "flow": list(every * turn),
        "output": [*R[0], *R[1]],
    }
    loose = hg.forms.original(hg.System("loose", **rows))
    assert loose.checks[0].verdict is hg.Verdict.REFUTED
    orthonormal = [(every * every.T - sp.eye(3))[i, j] for i in range(3) for j in range(i + 1)]
    plant = hg.System("rotation", **rows, invariants=orthonormal)
    joined = hg.forms.original(plant).checks[0]
    assert joined.verdict is hg.Verdict.PROVED
    assert joined.claim.endswith("or in an invariant with such states")
    assert hg.observability(plant).unobservable == ()


def test_errors_take_the_nearer_of_two_opposites() -> None:
    plant = attitude(bias=False)
    trial = Trial("turn", 1.0, {"q0": 1, "q1": 0, "q2": 0, "q3": 0}, {"w0": 2, "w1": 0, "w2": 0})
    truth = simulate(plant, trial, DT)
    assert truth.error(-truth.x) == pytest.approx(0 * truth.x, abs=1e-12)
    assert truth.error(truth.x + 0.1) == pytest.approx(0 * truth.x + 0.1, abs=1e-12)


# --- observability ------------------------------------------------------------------------------------------


def test_the_length_that_no_output_sees_is_known_by_the_invariant() -> None:
    c, s = signals("c s")
    rows: dict[str, Any] = {"states": (c, s), "outputs": (hg.Signal("y"),), "flow": [-s, c], "output": [s / c]}
    assert hg.observability(hg.System("loose", **rows)).rank == 1
    assert hg.observability(hg.System("kept", **rows, invariants=[c**2 + s**2 - 1])).rank == 2


def test_an_output_that_is_0_on_them_sees_nothing() -> None:
    c, s, b = signals("c s b")
    plant = hg.System(
        "blind",
        states=(c, s, b),
        outputs=(hg.Signal("y"), hg.Signal("z")),
        flow=[-s, c, 0],
        output=[c, b * (c**2 + s**2 - 1)],
        invariants=[c**2 + s**2 - 1],
    )
    assert [str(one) for one in hg.observability(plant).unobservable] == ["b"]


@pytest.mark.parametrize(
    "shown",
    [
        a + z * sp.sin(RING),
        a + z * (sp.exp(RING) - 1),
        (a + z * RING) / (2 + z * RING),
        sp.Piecewise((a + z, RING > 0), (a, True)),
        sp.Piecewise((a + z, sp.exp(RING) > 1), (a, True)),
        a + z * RING,
        a + z * sp.Abs(RING),
        a + z * sp.sqrt(sp.Abs(RING)),
    ],
)
def test_what_an_output_reads_off_them_only_is_not_observable(shown: sp.Expr) -> None:
    answer = hg.observability(on([RING], {a: -b, b: a, z: 0}, output=[shown]))
    assert answer.known.hidden == (z,)
    assert answer.checks[0].verdict is hg.Verdict.REFUTED
    assert "at a random point on the invariants" in str(answer.checks[0].reason)


@pytest.mark.parametrize(
    "shown", [a + z, a * z, sp.Piecewise((a + z, b > 0), (a + 2 * z, True)), a + sp.sin(z) + RING * z]
)
def test_what_an_output_reads_on_them_is_observable(shown: sp.Expr) -> None:
    assert hg.observability(on([RING], {a: -b, b: a, z: -z}, output=[shown])).unobservable == ()


def test_parts_of_an_invariant_have_their_own_answers() -> None:
    """sin(x) is 0 at 0 and at pi: with y = z (1 + cos x) + .. z is observable at 0 only."""
    wide = hg.Signal("wide", low=-4, high=4)
    flow = {wide: sp.sin(wide), b: -b, z: 0}
    answer = hg.observability(on([sp.sin(wide)], flow, output=[z * sp.cos(wide) + z + b]))
    assert answer.checks[0].verdict is hg.Verdict.WHERE
    assert "whether z can be observed where wide is near" in str(answer)
    narrow = hg.Signal("narrow", low=-1, high=1)
    flow = {narrow: sp.sin(narrow), b: -b, z: 0}
    answer = hg.observability(on([sp.sin(narrow)], flow, output=[z * sp.cos(narrow) + z + b]))
    assert answer.checks[0].verdict is hg.Verdict.GENERIC


def test_an_invariant_with_a_parameter_holds_at_its_value() -> None:
    for radius in (SLOW, hg.Signal("slow", nominal=2.0, low=1, high=3)):
        plant = on([a**2 + b**2 - radius], {a: -b, b: a, z: -z}, [radius], output=[a / b + z * (a**2 + b**2 - radius)])
        assert hg.observability(plant).unobservable == (z,)


def test_repeated_invariants_are_as_one() -> None:
    flow = {a: -b, b: a, z: 0}
    assert (
        hg.observability(on([RING, 3 * RING], flow, output=[a])).known
        == hg.observability(on([RING], flow, output=[a])).known
    )


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 2)] * 3, st.integers(-2, 2)), min_size=1, max_size=4), st.integers(-1, 1))
def test_ranks_are_those_of_coordinates_on_the_circle(terms: list[tuple[int, ...]], growth: int) -> None:
    """The plant in an angle instead of a point on the circle has the same observable and unobservable states."""
    angle = hg.Signal("angle", low=-3, high=3)
    shown = sum(c * a**i * b**j * z**k for i, j, k, c in terms)
    rows: dict[str, Any] = {"outputs": (hg.Signal("out"),)}
    turned = shown.subs({a: sp.cos(angle), b: sp.sin(angle)}) if sp.sympify(shown).free_symbols else sp.sympify(shown)
    plain = hg.System("angle", states=(angle, z), flow=[1 + z, growth * z], output=[turned], **rows)
    circle = on([RING], {a: -b * (1 + z), b: a * (1 + z), z: growth * z}, output=[shown], **rows)
    assert hg.observability(circle).rank == hg.observability(plain).rank + 1


def test_what_is_not_decided_on_them_is_no_branch() -> None:
    """On the circle sqrt(a^2 + b^2 + z^2) is sqrt(1 + z^2), which is not proved: no sign is taken from its rounding."""
    shown = sp.Piecewise((a + z, sp.sqrt(a**2 + b**2 + z**2) > sp.sqrt(1 + z**2)), (a, True))
    assert hg.observability(on([RING], {a: -b, b: a, z: 0}, output=[shown])).known.verdict is hg.Verdict.UNKNOWN


def test_the_sheets_of_a_hyperbola_have_their_own_answers() -> None:
    """a^2 - b^2 = 1 is irreducible, and a root is the same on no two sheets: a + sqrt(1 + b^2) is 0 where a < 0."""
    plant = on(
        [a**2 - b**2 - 1], {a: b, b: a, z: 0}, output=[z * (a + sp.sqrt(1 + b**2)), a], outputs=signals("first second")
    )
    assert "whether z can be observed where a is near -" in str(hg.observability(plant))


@pytest.mark.full
def test_forty_states_with_an_invariant_are_quick() -> None:
    """SymPy alone would take 9 s for the factors of the invariant."""
    x, begun = signals(" ".join(f"x{i}" for i in range(40)), -2, 2), process_time()
    flow = [x[1], *(x[i + 1] - x[i - 1] for i in range(1, 39)), -x[38]]
    rows: dict[str, Any] = {"states": x, "outputs": (hg.Signal("y"),), "flow": flow, "output": [x[0]]}
    plant = hg.System("ring", **rows, invariants=[sum(one**2 for one in x) - 1])
    assert hg.observability(plant).known.rank.rank == 40
    assert process_time() - begun < 8


def test_uniform_observability_is_not_claimed_on_them() -> None:
    force = hg.Signal("force", low=-1, high=1)
    plant = on([RING], {a: -b, b: a, z: force}, inputs=(force,), output=[a + z])
    assert of_plant(plant).verdict is hg.Verdict.UNKNOWN
    assert "plants without invariants" in str(of_plant(plant).reason)


# --- a zero -------------------------------------------------------------------------------------------------


def zero(rows: Sequence[sp.Expr], start: Sequence[float]) -> list[Any]:
    names = (x, y)

    def at(point: Sequence[Any]) -> tuple[list[Any], list[list[Any]]]:
        value = sp.lambdify(names, list(rows))(*point)
        slope = sp.lambdify(names, sp.Matrix(list(rows)).jacobian(names).tolist())(*point)
        return [flint.arb(v) for v in value], [[flint.arb(v) for v in row] for row in slope]

    return zero_near(at, [flint.arb(v) for v in start])


def test_a_zero_is_enclosed_in_a_ball() -> None:
    with flint.ctx.workprec(400):
        first, second = zero([x**2 + y**2 - 2, x - y], [1.1, 0.8])
        assert first.contains(1)
        assert second.contains(1)
        assert 0 < first.rad() < flint.arb(2) ** -350
        first, second = zero([x**2 - 2], [1.5, 7])
        assert (first**2).contains(2)
        assert second == 7
        first, _ = zero([x**2 - 2, 3 * x**2 - 6], [1.5, 7])
        assert (first**2).contains(2)


@pytest.mark.parametrize("rows", [[x**2], [(x**2 - 2) ** 2], [x**2 + 1], [x - 1, 2 * x - 3]])
def test_where_none_is_proved_there_is_no_zero(rows: Sequence[sp.Expr]) -> None:
    with flint.ctx.workprec(200), pytest.raises(Undecided):
        zero(rows, [1.4, 0])


def test_a_zero_of_a_function_that_is_known_less_well_is_not_proved() -> None:
    with flint.ctx.workprec(200), pytest.raises(Undecided):
        zero_near(lambda point: ([point[0] + flint.arb(0, flint.arb(2) ** -90)], [[flint.arb(1)]]), [flint.arb(1)])


def test_the_measure_is_taken_along_them() -> None:
    measure = observability_measure(attitude())
    point = [measure.where[f"q{i}"] for i in range(4)]
    assert np.linalg.norm(point) == pytest.approx(1, abs=1e-9)
    assert measure.least > 0.05
    along = [measure.direction[f"q{i}"] for i in range(4)]
    assert np.dot(point, along) == pytest.approx(0, abs=1e-9)


# --- the step -----------------------------------------------------------------------------------------------


def numbers(plant: hg.System) -> tuple[Callable[..., Any], ...]:
    """f, df/dx, h, dh/dx as numpy functions of x and u."""
    at = [list(plant.states), list(plant.inputs)]
    f, h = sp.Matrix(plant.flow), sp.Matrix(plant.output)
    rows = (list(f), f.jacobian(plant.states), list(h), h.jacobian(plant.states))
    return tuple(sp.lambdify(at, row) for row in rows)


def motion(plant: hg.System, off: float, bias: Sequence[float] = ()) -> tuple[np.ndarray, ...]:
    """Truth (N, n), gyro (N, 3) and noisy vectors (N, p) of a body that begins `off` (rad) from the identity."""
    f, _, h, _ = numbers(plant)
    t = np.arange(1500) * DT
    u = np.c_[0.8 * np.sin(0.7 * t), 0.6 * np.cos(0.5 * t), 0.5 * np.sin(0.3 * t + 1)]
    axis = np.array([1, 2, -1]) / np.sqrt(6)
    truth = [np.r_[np.cos(off / 2), np.sin(off / 2) * axis, bias]]
    for before, after in pairwise(u):
        now = truth[-1]
        for part in range(4):
            first, last = (before + (after - before) * share / 4 for share in (part, part + 1))
            now = runge_kutta(f, now, first, last, DT / 4)[0]
        truth.append(now)
    x = np.array(truth)
    clean = np.array([h(*pair) for pair in zip(x, u, strict=True)])
    return x, u, clean + SIGMA * np.random.default_rng(0).standard_normal(clean.shape)


def runge_kutta(f: Callable[..., Any], z: np.ndarray, u: np.ndarray, v: np.ndarray, h: float) -> tuple[Any, Any]:
    """The classical step from z, and the state of its third stage."""
    middle = (u + v) / 2
    k1 = np.array(f(z, u))
    k2 = np.array(f(z + h / 2 * k1, middle))
    k3 = np.array(f(z + h / 2 * k2, middle))
    k4 = np.array(f(z + h * k3, v))
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), z + h / 2 * k2


def normalised(z: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    q, n = z[:4], len(z)
    N = np.eye(n)
    N[:4, :4] = (np.eye(4) - np.outer(q, q) / (q @ q)) / np.linalg.norm(q)
    return np.r_[q / np.linalg.norm(q), z[4:]], N @ P @ N.T


def projected_filter(plant: hg.System, u: np.ndarray, y: np.ndarray, P: np.ndarray, Q: float) -> np.ndarray:
    """The extended Kalman filter with its estimate and covariance projected, from the textbook; estimates (N, n)."""
    f, F, h, H = numbers(plant)
    n = len(plant.states)
    z, estimates = np.eye(n)[0], []
    z, P = normalised(z, P)
    for k, now in enumerate(u):
        if k:
            z, middle = runge_kutta(f, z, u[k - 1], now, DT)
            A = np.array(F(middle, (u[k - 1] + now) / 2), dtype=float)
            Phi = np.eye(n) + DT * A + DT * DT / 2 * A @ A
            z, P = normalised(z, Phi @ P @ Phi.T + DT * Q * np.eye(n))
        for j, sample in enumerate(y[k]):
            c = np.array(H(z, now), dtype=float)[j]
            K = P @ c / (SIGMA**2 + c @ P @ c)
            z, P = normalised(z + K * (sample - h(z, now)[j]), P - np.outer(K, c @ P))
        estimates.append(z)
    return np.array(estimates)


def filtered(plant: hg.System, u: np.ndarray, y: np.ndarray, P: np.ndarray, Q: float, **options: Any) -> Any:
    n = len(plant.states)
    observer = hg.observers.riccati(
        hg.forms.original(plant), Q=[Q] * n, R=SIGMA**2 * DT, covariance=np.diag(P).tolist()
    )
    return hg.sample(observer, options.pop("method", hg.methods.continuous_discrete), dt=DT, **options).run(u=u, y=y)


@pytest.mark.parametrize("method", ["continuous_discrete", "cholesky"])
def test_the_filter_is_the_textbooks_with_a_projected_covariance(method: str) -> None:
    plant = attitude(bias=False)
    _, u, y = motion(plant, np.pi / 3)
    P = 0.1 * np.eye(4)
    run = filtered(plant, u[:300], y[:300], P, 1e-6, method=getattr(hg.methods, method), guards="none")
    assert run.x == pytest.approx(projected_filter(plant, u[:300], y[:300], P, 1e-6), abs=1e-11)
    guarded = filtered(plant, u[:300], y[:300], P, 1e-6, method=getattr(hg.methods, method))
    assert guarded.x == pytest.approx(run.x, abs=1e-9)
    assert not guarded.status.any()


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def error_state_filter(u: np.ndarray, y: np.ndarray, P: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The multiplicative filter: an angle error (3) and a bias (3), R <- R exp[d]; R (N, 3, 3) and the last P."""
    R, b, rotations = np.eye(3), np.zeros(3), []
    world = [np.array([1.0, 0, 0]), np.array([0, 0, 1.0])][-(y.shape[1] // 3) :]
    for k, now in enumerate(u):
        if k:
            rate = (u[k - 1] + now) / 2 - b
            R = R @ turned(rate * DT)
            Phi = np.eye(6)
            Phi[:3, :3], Phi[:3, 3:] = turned(-rate * DT), -DT * np.eye(3)
            P = Phi @ P @ Phi.T + DT * Q
        for j, sample in enumerate(y[k]):
            body = R.T @ world[j // 3]
            c = np.r_[skew(body)[j % 3], np.zeros(3)]
            K = P @ c / (SIGMA**2 + c @ P @ c)
            d = K * (sample - body[j % 3])
            R, b, P = R @ turned(d[:3]), b + d[3:], P - np.outer(K, c @ P)
        rotations.append(R)
    return np.array(rotations), P


def turned(d: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(d)
    if angle < 1e-12:
        return np.eye(3) + skew(d)
    axis = skew(d / angle)
    return np.eye(3) + np.sin(angle) * axis + (1 - np.cos(angle)) * axis @ axis


def matrices(q: np.ndarray) -> np.ndarray:
    a, b, c, d = q.T
    rows = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The angles (N) between rotations."""
    return np.linalg.norm(a - b, axis=(1, 2)) / np.sqrt(2)


@pytest.mark.full
def test_it_is_as_good_as_an_error_state_filter_from_60_degrees() -> None:
    plant = attitude("xz")
    x, u, y = motion(plant, np.pi / 3, [0.05, -0.08, 0.03])
    P, Q = np.diag([0.25] * 4 + [0.01] * 3), 1e-6
    run = filtered(plant, u, y, P, Q)
    R, _ = error_state_filter(u, y, np.diag([1.0] * 3 + [0.01] * 3), np.diag([4 * Q] * 3 + [Q] * 3))
    truth = matrices(x[:, :4])
    ours, theirs = angles(matrices(run.x[:, :4]), truth), angles(R, truth)
    late = slice(500, None)
    assert np.sqrt((ours[late] ** 2).mean()) < 1.05 * np.sqrt((theirs[late] ** 2).mean())
    assert ours[100:].max() < 0.05
    assert np.linalg.norm(run.x[:, :4], axis=1) == pytest.approx(np.ones(len(x)), abs=1e-14)


@pytest.mark.full
def test_a_yaw_that_no_sensor_sees_does_not_look_known() -> None:
    """Gravity alone says nothing of the turn about it: its variance is that of the start."""
    plant = attitude("z", bias=False)
    _, u, y = motion(plant, 0.0)
    n, start, Q = 4, 0.01, 1e-9
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[Q] * n, R=SIGMA**2 * DT, covariance=[start] * n)
    run = hg.sample(observer, hg.methods.continuous_discrete, dt=DT).run(u=u, y=y)
    q0, q1, q2, q3 = run.x[-1]
    yaw = np.array([-q3, -q2, q1, q0])  # 2 dq/dpsi of the turn about the axis of gravity
    assert run.covariance is not None
    assert 0.9 * start < yaw @ run.covariance[-1] @ yaw < 1.01 * start


@pytest.mark.parametrize(("name", "factor"), [("unit_vector", "root"), ("hyperbola", "D")])
def test_a_factor_of_the_covariance_may_be_zero_on_the_invariants(name: str, factor: str) -> None:
    """The projected covariance has no variance across them: its limits, which the step keeps, admit that."""
    (field,) = (each for each in emitted(name).layout.state if each.name == factor)
    assert max(field.low) == 0


@pytest.mark.parametrize("name", ["unit_vector", "hyperbola"])
def test_every_call_ends_on_them(name: str) -> None:
    """From a start off them, with samples that contradict them, missing ones, and after a restart."""
    step = emitted(name)
    p, m = len(step.outputs), len(step.inputs)
    draw = np.random.default_rng(3)
    y = draw.normal(size=(200, p)) * 0.1 + (1.0 if name == "unit_vector" else 0.3)
    y[20:40] = np.nan
    run = step.run(u=np.full((200, m), 0.3) if m else (), y=y, engine="python")
    (constraint,) = step.observer.form.system.invariants
    at = sp.lambdify([list(step.observer.form.system.states)], constraint)
    off = np.array([at(x) for x in run.x])
    assert np.abs(off).max() < (1e-14 if name == "unit_vector" else 1e-2)  # a step of Newton squares what is left
    assert np.abs(off[3:]).max() < 1e-3
    assert np.isfinite(run.x).all()


def test_a_covariance_that_is_stored_inverted_and_a_bank_are_refused() -> None:
    plant = attitude(bias=False)
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1] * 4, R=1)
    with pytest.raises(BadGain, match="take continuous_discrete or cholesky"):
        hg.sample(observer, hg.methods.rk4, dt=DT)
    with pytest.raises(BadGain, match="does not keep the invariants of attitude; take its member"):
        hg.sample(hg.observers.bank(observer, count=2, period=0.1), hg.methods.continuous_discrete, dt=DT)


def test_invariants_that_no_state_meets_are_refused() -> None:
    c, s = signals("c s")
    rows: dict[str, Any] = {"states": (c, s), "outputs": (hg.Signal("y"),), "flow": [-s, c], "output": [c]}
    with pytest.raises(BadSystem, match="2 invariants of 2 states, which leave nothing to estimate"):
        hg.System("fixed", **rows, invariants=[c**2 + s**2 - 1, c**2 + s**2 - 1])
    with pytest.raises(BadSystem, match="has no zero that depends on states in their ranges"):
        hg.System("nowhere", **rows, invariants=[c**2 + s**2 + 1])
    k = hg.Signal("k", nominal=1.0, low=-1, high=2)  # at its value there is none
    with pytest.raises(BadSystem, match="no state is found on its invariants"):
        hg.System("nowhere", **rows, invariants=[c**2 + s**2 + k], parameters=(k,))


@pytest.mark.parametrize("data", [{"period": 2 * np.pi}, {}])
def test_designs_and_error_systems_do_not_pass_over_turns_and_projections(data: dict[str, float]) -> None:
    x, v, y = hg.Signal("x", **(data or {"low": -2, "high": 2})), hg.Signal("v", low=-2, high=2), hg.Signal("y", **data)
    flow, more = ([v, 0], {}) if data else ([v, -x], {"invariants": [x**2 + v**2 - 1]})
    plant = hg.System("turned", states=(x, v), outputs=(y,), flow=flow, output=[x], **more)
    with pytest.raises(BadGain, match="has no gain that is designed: the e"):
        hg.design.gain(hg.forms.triangular(plant), rate=1.0)
    with pytest.raises(BadErrorSystem, match="has no error system: the e"):
        hg.error_system(plant, [[3], [9]])


def test_an_invariant_may_be_text_and_an_estimate_begins_on_it_in_the_ranges() -> None:
    """From (0, 0), where the energy has no slope, (-4.19, 0) is nearest in direction, and out of the ranges."""
    th, om = signals("th", -3, 3) + signals("om", -4, 4)
    rows: dict[str, Any] = {"states": (th, om), "outputs": (hg.Signal("y"),), "flow": [om, -sp.sin(th)], "output": [th]}
    plant = hg.System("swing", **rows, invariants=("om**2/2 - cos(th) - 1/2",))
    assert plant.invariants == (om**2 / 2 - sp.cos(th) - sp.Rational(1, 2),)
    step = hg.sample(hg.observers.high_gain(hg.forms.triangular(plant), theta=3, poles=(-1, -1)), dt=DT)
    assert step(y=float("nan")).x == pytest.approx([0, np.sqrt(3)])
    with pytest.raises(hg.HgogenError, match="the name 'a' is not declared"):
        hg.System("swing", **rows, invariants=("om**2/2 - a",))


def test_a_parameter_that_stabilises_the_constraint_is_not_seen_on_it() -> None:
    c, s, k = signals("c s k")
    g = c**2 + s**2 - 1
    plant = hg.System(
        "held",
        states=(c, s, k),
        outputs=(hg.Signal("y"),),
        flow=[-s + k * g * c, c + k * g * s, 0],
        output=[c],
        invariants=[g],
    )
    assert [str(one) for one in hg.observability(plant).unobservable] == ["k"]


def test_a_covariance_of_full_rank_is_not_claimed() -> None:
    plant = attitude(bias=False)
    observer = hg.observers.riccati(hg.forms.original(plant), Q=[1] * 4, R=1)
    (definite,) = (one for one in observer.theorem.hypotheses if one.claim.startswith("Q, S(0) are positive definite"))
    assert definite.verdict is hg.Verdict.UNKNOWN
    assert definite.reason == "the step projects P and Q onto the invariants, where they are singular"


def test_convergence_is_not_claimed() -> None:
    x, y, seen = signals("x y seen", -9, 9)
    rows: dict[str, Any] = {"states": (x, y), "outputs": (seen,), "flow": [y, x], "output": [x]}
    verdicts = {}
    for name, more in (("free", {}), ("kept", {"invariants": [x**2 - y**2 - 1]})):
        observer = hg.observers.riccati(hg.forms.original(hg.System(name, **rows, **more)), Q=[1, 1], R=1)
        verdicts[name] = next(c.verdict for c in observer.checks if str(c.id) == "riccati.convergence")
    assert verdicts == {"free": hg.Verdict.PROVED, "kept": hg.Verdict.UNKNOWN}
