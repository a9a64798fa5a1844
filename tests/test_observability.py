"""The report on a plant: what is seen and when, what hides the rest, what would repair it; the library."""

import random
import time

import pytest
import sympy as sp
from neuron import MODEL
from oracle import observability as oracle
from test_rank import here, library

import hgogen as hg
from hgogen.algebra.rank import NowhereDefined
from hgogen.algebra.rank import observability as ranks
from hgogen.analysis.gauthier_bornard import of_plant
from hgogen.analysis.observability import observability
from hgogen.analysis.symmetry import symmetries
from hgogen.check import Verdict

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
        rank = ranks(flow, [output], [x1, x2, x3], [v]).known
        moves = symmetries(flow, [output], [x1, x2, x3], [v], [], hidden=rank.unobservable, order=rank.order)
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
    assert "measuring no single unknown" in str(known)
    assert [str(move) for move in known.symmetries] == ["b -> b + c", "c -> c + s"]  # a name that is free


def test_a_parameter_without_a_range_stands_at_its_value() -> None:
    """At 0 the coupling is not there; with a range it is, almost everywhere."""
    zero = hg.Signal("gain", "", "", 0)
    assert observability(plant([zero * b, -b], a, parameters=(zero,))).rank == 1
    ranged = hg.Signal("gain", "", "", 0, low=-1, high=1)
    assert observability(plant([ranged * b, -b], a, parameters=(ranged,))).rank == 2


def test_branches_and_undefined_plants() -> None:
    analysis = observability(plant([b, -sp.Abs(b)], a, parameters=()))
    assert "open set only, because of abs" in str(analysis.checks[0].reason)
    with pytest.raises(NowhereDefined, match="logarithm"):
        observability(plant([b, sp.log(u - a**2 - 9) + sp.log(-u)], a, parameters=()))


@pytest.mark.parametrize(
    ("flow", "output", "hidden"),
    [
        ([b, -a], sp.Max(a, 0), lambda at: at[a] < 0),
        ([sp.Max(b, 0), 0 * b], a, lambda at: at[b] < 0),
        ([sp.Max(b, 2 * a), 0 * b], a, lambda at: at[b] < 2 * at[a]),
        ([1 + 0 * b, 0 * b], sp.Max(a, b), lambda at: True),
    ],
    ids=["a sensor", "a valve", "a switch", "everywhere"],
)
def test_an_unobservable_direction_is_of_a_point_on_the_branch_that_hides_it(flow, output, hidden) -> None:
    """On the other branches all is seen, some of it by later derivatives than those that show what is seen here."""
    answer = observability(plant(flow, output, parameters=())).known
    assert answer.rank.rank < 2
    assert answer.direction or answer.symmetries
    assert not answer.direction or hidden(dict(answer.point))


@pytest.mark.parametrize("bend", [lambda e: e**2, sp.sin], ids=["modulo a prime", "balls"])
def test_sixty_states(bend) -> None:
    """A sparse nonlinear chain with one output: a partial answer by a limit; with three outputs, the whole."""
    draw = random.Random(5)
    x = sp.symbols("x0:60")
    flow = [x[i + 1] * (1 + x[draw.randrange(60)]) + bend(x[draw.randrange(60)]) for i in range(59)] + [x[0] * x[7]]
    start = time.process_time()
    part = ranks(flow, [x[0]], x, limit=4).known
    assert not part.final
    assert part.rank == 5
    whole = ranks(flow, [x[0], x[20], x[40]], x).known
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
        flow, output, states, inputs, parameters = model
        rank = ranks(flow, output, states, inputs, parameters).joint
        if not rank.unobservable or any(not e.is_rational_function() for e in (*flow, *output)):
            continue
        deficient += 1
        moves = symmetries(*model, hidden=rank.unobservable, order=rank.order)
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
