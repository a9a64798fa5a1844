"""The report on a plant: what is seen and when, what hides the rest, what would repair it; the library."""

import random
import time

import pytest
import sympy as sp
from neuron import MODEL
from oracle import observability as oracle
from test_rank import here, library

import hgogen as hg
from hgogen.analysis.observability import observability, symmetries
from hgogen.analysis.singularity import of_plant
from hgogen.check import Verdict
from hgogen.rigor.rank import Model, NowhereDefined
from hgogen.rigor.rank import observability as ranks

a, b, c = (hg.Signal(name, "m", "") for name in "abc")
u, y = hg.Signal("u", "", ""), hg.Signal("y", "", "")
k = hg.Signal("k", "", "", 1, low=0.5, high=2)


def plant(flow, output, states=(a, b), parameters=(k,)) -> hg.System:
    return hg.System("s", states=states, inputs=(u,), outputs=(y,), parameters=parameters, flow=flow, output=[output])


def test_the_neuron_is_observable_through_its_input() -> None:
    analysis = hg.observability(MODEL.plant)
    assert (analysis.n, analysis.rank, analysis.order) == (3, 3, 2)
    assert [(s.name, order) for s, order in analysis.known.orders] == [("x1", 0), ("x2", 1), ("eta", 2)]
    assert [check.verdict for check in analysis.checks] == [Verdict.GENERIC]
    assert "x2 (1), eta (2)" in str(analysis)


def test_a_scaling_hides_a_gain() -> None:
    """y' = k b: b and k are seen as a product."""
    analysis = observability(plant([k * b + u, -b], a))
    assert analysis.joint is not None
    states, joint = analysis.checks
    assert states.verdict is Verdict.GENERIC
    assert joint.verdict is Verdict.REFUTED
    assert [str(s) for s in analysis.joint.symmetries] == ["b -> c b, k -> k/c"]
    assert analysis.joint.repairs == (b, k)
    assert joint.fix == "Measure b or k as well."
    assert "rank 2 of 3" in str(analysis)


def test_the_kinds_of_symmetry() -> None:
    """Translation, rotation, scaling with a shift, the last two found with balls; a reflection is no direction."""
    x1, x2, x3, v = sp.symbols("x1 x2 x3 v")
    cases = [
        ([x2 - x3, v, v], x1, ["x2 -> c + x2, x3 -> c + x3"]),
        ([0, x3, -x2], x2**2 + x3**2, ["x1 -> c + x1", "along d/ds (x2: x3, x3: -x2)"]),
        ([sp.exp(x2) * x3, 0, 0], x1, ["x2 -> x2 + log(c), x3 -> x3/c"]),
        ([x2, x3 * sp.sin(x1), 0], x1**2, []),
        ([v * sp.sin(x1 - x2), 0, v], sp.cos(x1 - x2), ["x1 -> c + x1, x2 -> c + x2", "x3 -> c + x3"]),
    ]
    for flow, output, expected in cases:
        model = Model(flow, [output], [x1, x2, x3], [v])
        rank = ranks(model).known
        moves = symmetries(model, rank.unobservable, rank.order)
        shown = {str(move) for move in moves}
        assert all(move.proved for move in moves)
        assert len(moves) == 3 - rank.rank
        assert shown == set(expected)


def test_a_direction_where_no_symmetry_is_found() -> None:
    """k enters by a quotient of degree 3: the direction is that of the level set."""
    seen = (1 + b**2) / (2 + k * b**2)
    joint = observability(plant([-a * seen, 0], a)).joint
    assert joint is not None
    assert joint.symmetries == ()
    point, direction = dict(joint.point), dict(joint.direction)
    slope = sum(float(seen.diff(s).subs(point)) * direction.get(s, 0.0) for s in (b, k))
    assert abs(slope) < 1e-12
    assert max(map(abs, direction.values())) == 1
    (_, check) = observability(plant([-a * seen, 0], a)).checks
    assert check.verdict is Verdict.UNKNOWN


def test_no_single_measurement_repairs_two_hidden_states() -> None:
    known = observability(plant([-a, b, c], a, (a, b, c), ())).known
    assert known.repairs == ()
    assert known.rank.unobservable == (b, c)
    assert "no single state or parameter would do" in str(known)
    assert [str(move) for move in known.symmetries] == ["b -> b + c", "c -> c + s"]  # a name that is free


def test_a_parameter_without_a_range_stands_at_its_value() -> None:
    """At 0 the coupling is not there; with a range it is, almost everywhere."""
    zero = hg.Signal("gain", "", "", 0)
    assert observability(plant([zero * b, -b], a, parameters=(zero,))).rank == 1
    ranged = hg.Signal("gain", "", "", 0, low=-1, high=1)
    assert observability(plant([ranged * b, -b], a, parameters=(ranged,))).rank == 2


def test_branches_and_undefined_plants() -> None:
    analysis = observability(plant([b, -sp.Abs(b)], a, parameters=()))
    assert "examined on 2 branches" in str(analysis.checks[0].reason)
    assert "a, b, u without a range: sampled from 0.01 to 100 in size" in str(analysis)
    with pytest.raises(NowhereDefined, match="logarithm"):
        observability(plant([b, sp.log(u - a**2 - 9) + sp.log(-u)], a, parameters=()))


@pytest.mark.parametrize(
    ("flow", "output", "where", "hidden"),
    [
        ([b, -a], sp.Max(a, 0), (a < 0,), (a, b)),
        ([sp.Max(b, 0), 0 * b], a, (b < 0,), (b,)),
        ([sp.Max(b, 2 * a), 0 * b], a, (b < 2 * a,), (b,)),
        ([sp.Piecewise((b, (b > 0) & (a > b)), (a, True)), 0 * b], a, (a <= b, b > 0), (b,)),
    ],
    ids=["a sensor", "a valve", "a switch", "two conditions"],
)
def test_what_a_branch_hides_is_said_of_this_branch(flow, output, where, hidden) -> None:
    """On the other branch all is observable, and the whole is so on a condition."""
    analysis = observability(plant(flow, output, parameters=()))
    assert (analysis.rank, analysis.known.lost) == (2, ())
    (check,) = analysis.checks
    assert (check.verdict, check.fix) == (Verdict.WHERE, "")
    sides = {frozenset(branch.where): branch.hidden for branch in analysis.known.elsewhere}
    assert sides[frozenset(where)] == hidden
    assert f"{hidden[-1]} {'is' if len(hidden) == 1 else 'are'} not observable where" in str(check.reason)


def test_what_every_branch_hides_is_lost_on_all_of_them() -> None:
    known = observability(plant([1 + 0 * b, 0 * b], sp.Max(a, b), parameters=())).known
    assert known.rank.rank == 1
    assert known.lost == ()  # either is observable where it is the larger one
    both = observability(plant([-a, sp.Max(a, 0) - b], a, parameters=())).known
    assert both.lost == (b,)


def test_a_threshold_is_not_lost_though_each_branch_hides_it() -> None:
    """x' = -1 above b and 1 below: x arrives at b and stays there."""
    relay = observability(plant([-sp.Piecewise((1, a > b), (-1, True)), 0 * b], a, parameters=())).known
    assert (relay.rank.rank, relay.hidden) == (1, (b,))
    assert (relay.lost, relay.advice) == ((), "")


def test_a_branch_that_is_left_refutes_nothing() -> None:
    """What a branch hides is seen later on another one, unless one symmetry is that of all branches."""
    h = hg.Signal("h", low=-2, high=2)
    verdicts = {  # of an oscillator a, b and a constant h
        sp.Max(a, h): Verdict.UNKNOWN,  # h where a < h
        sp.Piecewise((a, u > 0), (h, True)): Verdict.UNKNOWN,
        a + sp.Max(b, 0): Verdict.REFUTED,  # h -> h + c everywhere
        sp.Max(a, 0) * h: Verdict.REFUTED,  # the scaling a -> c a, h -> h/c changes no sign
        sp.sign(a): Verdict.UNKNOWN,  # the times at which it changes tell more
        sp.Piecewise((a + h, h > 0), (0, True)): Verdict.WHERE,
        sp.Piecewise((a, h > 0), (0, True)): Verdict.REFUTED,  # h' = 0: it is not left
    }
    for output, verdict in verdicts.items():
        analysis = observability(plant([b, -a, 0], output, states=(a, b, h), parameters=()))
        assert analysis.checks[0].verdict is verdict, output
    invariant = observability(
        plant([a, 0], sp.Piecewise((a, a > 0), (b, True)), parameters=())
    )  # a > 0 stays so, by a' = a
    assert (invariant.checks[0].verdict, invariant.known.lost) == (Verdict.REFUTED, ())
    left = observability(plant([b, -a, 0], sp.Max(a, h), states=(a, b, h), parameters=()))
    assert "h is not observable where a > h, which the plant may leave" in str(left.checks[0].reason)
    assert (left.known.lost, left.known.advice) == ((), "")


def test_hidden_directions_that_differ_between_branches_are_not_lost() -> None:
    """Each branch hides b and h, by b + h and by b - h."""
    h, v = hg.Signal("h", low=-2, high=2), hg.Signal("v", low=-2, high=2)
    output = v + sp.Piecewise((b + h, v > 0), (b - h, True))
    known = observability(plant([a, 0, 0, 1], output, states=(a, b, h, v), parameters=())).known
    assert (known.verdict, known.lost) == (Verdict.REFUTED, (a,))


def test_a_direction_that_is_not_proved_is_no_fact() -> None:
    answer = observability(plant([b, -a], a * (sp.sin(b) ** 2 + sp.cos(b) ** 2 - 1), parameters=())).known
    assert answer.hidden == ()
    assert "a direction in which no derivative up to order 0 is known to change: " in str(answer)
    assert "an unobservable direction" not in str(answer)


def test_a_rounding_is_asked_next_to_its_steps() -> None:
    """Halfway between two points again and again, to where a ball's end is a whole number."""
    p, q = hg.Signal("p", low=-1, high=1), hg.Signal("q", low=-1, high=1)
    steps = hg.System("s", states=(p, q), outputs=(y,), flow=[-p, -q], output=[sp.floor(10 * p) + q])
    assert hg.observability(steps).known.rank.unobservable == (p,)


@pytest.mark.parametrize("thin", [sp.Rational(1, 10**3), sp.Rational(1, 10**9)])
@pytest.mark.parametrize("at", [sp.Rational(7, 20), sp.Integer(0)])
def test_a_thin_branch_between_others_is_asked(thin: sp.Rational, at: sp.Rational) -> None:
    """A dead zone around a place, which hides b, is found whatever its width; so is one that no point need reach."""
    x, z = hg.Signal("x", low=-1, high=1), hg.Signal("z", low=-1, high=1)
    gap = z - at - sp.Max(-thin, sp.Min(thin, z - at))
    dead = hg.System("dead", states=(x, z), outputs=(y,), flow=[gap, -z], output=[x])
    (inside,) = hg.observability(dead).known.elsewhere
    assert inside.hidden == (z,)
    assert {sp.solve(one.lhs - one.rhs, z)[0] for one in inside.where} == {at - thin, at + thin}


def test_branches_beyond_the_ranges_are_not_asked() -> None:
    """max(0, a - b) is a - b where a > 0 > b, and a saturation far outside is none; a root has its value inside."""
    p, q = hg.Signal("p", low=1, high=5), hg.Signal("q", low=-5, high=-1)
    for rate in (-sp.Max(0, p - q), sp.Min(p - q, 11), sp.sqrt(p - q - 1), sp.log(p - q - sp.Rational(3, 2))):
        analysis = hg.observability(hg.System("s", states=(p, q), outputs=(y,), flow=[rate, -q], output=[p]))
        assert (analysis.rank, analysis.checks[0].verdict, str(analysis.scope)) == (2, Verdict.GENERIC, "")


def test_a_corner_of_two_conditions_is_asked() -> None:
    """Where both hold in a millionth of a side each, and only there, the state is observable."""
    p, q = hg.Signal("p", low=0, high=1), hg.Signal("q", low=0, high=1)
    edge = 1 - sp.Rational(1, 10**6)
    flow = [sp.Max(p - edge, 0) * sp.Max(q - edge, 0), -q]
    analysis = hg.observability(hg.System("s", states=(p, q), outputs=(y,), flow=flow, output=[p]))
    assert analysis.rank == 2
    assert {branch.hidden for branch in analysis.known.elsewhere} == {(q,)}


def test_a_deficiency_without_a_proof_is_no_fact_and_no_advice() -> None:
    """The level sets of a quotient are no symmetry that is looked for: b and k stay doubtful, in every text."""
    level = (1 + b**2) / (2 + k * b**2)
    analysis = observability(plant([-a * level, 0], a))
    joint = analysis.joint
    assert joint is not None
    assert (joint.hidden, joint.doubtful, joint.advice) == ((), (b, k), "")
    check = analysis.checks[1]
    assert (check.verdict, check.fix) == (Verdict.UNKNOWN, "")
    assert "whether b, k can be observed is not known" in str(joint)
    assert not any(word in str(analysis) for word in ("measure", "not observable", "not seen"))


@pytest.mark.ordinary("modulo a prime")
@pytest.mark.parametrize("bend", [lambda e: e**2, sp.sin], ids=["modulo a prime", "balls"])
def test_sixty_states(bend) -> None:
    """A sparse nonlinear chain with one output: a partial answer by a limit; with three outputs, the whole."""
    draw = random.Random(5)
    x = sp.symbols("x0:60")
    flow = [x[i + 1] * (1 + x[draw.randrange(60)]) + bend(x[draw.randrange(60)]) for i in range(59)] + [x[0] * x[7]]
    start = time.process_time()
    part = ranks(Model(flow, [x[0]], x), limit=4).known
    assert not part.final
    assert part.rank == 5
    whole = ranks(Model(flow, [x[0], x[20], x[40]], x)).known
    assert whole.rank == 60
    assert time.process_time() - start < 60  # some 3 s; a busy machine has room


# --- the library --------------------------------------------------------------------------------------------


def annihilated(field, model, order: int) -> bool:
    """Whether the oracle's gradients, modulo its own prime, are all zero along the field."""
    flow, output, states, inputs, parameters = model
    unknowns = [*states, *parameters]
    for seed in range(50):
        program = oracle.Program(oracle.Tower(), [*flow, *output], unknowns, len(states), seed)
        program.build(set(inputs))
        try:
            gradients = [row for _, rows in zip(range(order + 2), oracle.rows(program), strict=False) for row in rows]
        except ZeroDivisionError:
            continue
        along = {s: program.residue(e) for s, e in field}
        return all(sum(row[unknowns.index(s)] * v for s, v in along.items()) % oracle.PRIME == 0 for row in gradients)
    raise AssertionError


@here
@pytest.mark.slow
def test_every_symmetry_of_the_library_is_one_for_the_oracle() -> None:
    """Of the models of + - * / with a deficiency; most have as many symmetries as the deficiency."""
    tried = full = deficient = 0
    for name, model in library():
        flow, output, *_ = model
        rank = ranks(Model(*model)).joint
        if not rank.unobservable or any(not e.is_rational_function() for e in (*flow, *output)):
            continue
        deficient += 1
        moves = symmetries(Model(*model), rank.unobservable, rank.order)
        full += len(moves) == rank.dimension - rank.rank
        for move in moves:
            assert annihilated(move.field, model, rank.order), (name, str(move))
            tried += 1
    print(f"{tried} symmetries of {deficient} models, all of them for {full}")
    assert tried > 300
    assert full > 0.8 * deficient


@pytest.mark.parametrize("ask", [hg.observability, of_plant])
def test_a_comparison_without_a_value_at_the_parameters_is_no_traceback(ask) -> None:
    """max(3, sin(1/q)) has none at q = 0."""
    x1, x2, force = (hg.Signal(name) for name in ("x1", "x2", "force"))
    q = hg.Signal("q", nominal=0)
    flow = [x2, sp.Max(3, sp.sin(1 / q)) * force]
    sick = hg.System(
        "p", states=[x1, x2], inputs=[force], outputs=[hg.Signal("y")], parameters=[q], flow=flow, output=[x1]
    )
    with pytest.raises(NowhereDefined):
        ask(sick)
