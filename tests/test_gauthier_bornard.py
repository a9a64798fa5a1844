"""Observability for every input: against Lie derivatives written out, known answers, where it does not apply."""

import random
from itertools import pairwise
from time import process_time

import pytest
import sympy as sp
from neuron import MODEL

import hgogen as hg
from hgogen.analysis.singularity import UniformObservability, of_plant
from hgogen.analysis.singularity import gauthier_bornard as of_model
from hgogen.check import Verdict
from hgogen.rigor.rank import Model

x1, x2, x3, u, v = sp.symbols("x1 x2 x3 u v")
X = (x1, x2, x3)


def gauthier_bornard(*equations) -> UniformObservability:
    return of_model(Model(*equations))


def written_out(flow, output, states, inputs) -> bool:
    """The definition, with SymPy's derivatives at one rational point."""
    field = sp.Matrix(flow)
    drift = field.subs(dict.fromkeys(inputs, 0))
    point = {s: sp.Rational(17 * i + 5, 13 + i) for i, s in enumerate(states)}

    def along(h, g):
        return sum((h.diff(s) * rate for s, rate in zip(states, g, strict=True)), sp.S.Zero)

    def rank(functions) -> int:
        return sp.Matrix([[h.diff(s).subs(point) for s in states] for h in functions]).rank()

    lie = [output]
    for _ in states[1:]:
        lie.append(along(lie[-1], drift))
    if rank(lie) < len(states):
        return False
    return all(rank([*lie[: i + 1], along(lie[i], field.diff(w))]) == i + 1 for w in inputs for i in range(len(states)))


@pytest.mark.ordinary("20", "21", "28")
@pytest.mark.parametrize("seed", range(40))
def test_random_plants_answer_as_the_definition(seed: int) -> None:
    """Triangular ones, and the same with a term that may break the triangle; in coordinates that hide it."""
    draw = random.Random(seed)

    def pick(upto: int) -> sp.Symbol:
        return X[draw.randrange(upto)]

    flow = [x2 * (1 + x1**2), x3 + x1 * x2, x1 * x3]
    for i in range(3):
        flow[i] += draw.choice((0, 1)) * u * pick(i + 1) * pick(i + 1) + draw.choice((0, 1)) * v * pick(i + 1)
    if draw.random() < 0.5:
        flow[draw.randrange(2)] += u * x3 * pick(3)
    mixed = {x1: x1, x2: x2 + x1**2, x3: x3 - x1 * x2}  # new coordinates w: x = mixed(w)
    jacobian = sp.Matrix([[e.diff(s) for s in X] for e in mixed.values()])
    flow = list(jacobian.inv() * sp.Matrix([sp.sympify(e).subs(mixed, simultaneous=True) for e in flow]))
    assert gauthier_bornard(flow, [x1], X, [u, v]).answer is written_out(flow, x1, X, [u, v])


def test_transcendental_plants() -> None:
    assert gauthier_bornard([x2, u - sp.sin(x1)], [x1], X[:2], [u]).answer is True
    assert gauthier_bornard([x2 + u * sp.exp(x2), u - sp.sin(x1)], [x1], X[:2], [u]).answer is False
    mixing = [x2 * sp.exp(x1) + u * sp.sin(x1), sp.sqrt(x1) * x3 + u * sp.cos(x1 * x2), u * x3]
    assert gauthier_bornard(mixing, [x1], X, [u]).answer is True
    mixing[0] += u * sp.Integer(10) ** -60 * x3  # a small term is a term
    assert gauthier_bornard(mixing, [x1], X, [u]).answer is False


def test_ten_states() -> None:
    z = sp.symbols("z1:11")
    flow = [a * sp.cos(b) + b * 3 + u * a * z[0] for a, b in pairwise(z)] + [z[0] * z[9] + u]
    assert gauthier_bornard(flow, [z[0]], z, [u]).answer is True
    flow[3] += u * z[6]
    broken = gauthier_bornard(flow, [z[0]], z, [u])
    assert broken.answer is False
    assert "L_f^3 h" in str(broken.reason)


def test_without_input_the_neuron_is_lost() -> None:
    """Boizot's example: a_2 = -u, so that at u = 0 only x1 is seen."""
    check = of_plant(MODEL.plant)
    assert check.verdict is Verdict.REFUTED
    assert "rank 1 of 3" in str(check.reason)


def test_a_rank_at_random_points_is_no_proof() -> None:
    """x2 + x3 alone is seen: rank 2 of 3, though every state is read."""
    observability = gauthier_bornard([x2 + x3 + u * x1, x3, x2], [x1], X, [u])
    assert (observability.answer, observability.proved, observability.verdict) == (False, False, Verdict.UNKNOWN)
    assert "rank 2 of 3 at 3 random points, which is no proof" in str(observability.reason)
    x4 = sp.Symbol("x4")
    longer = gauthier_bornard([x2 + u * x1, x3 + x4, x4, x3], [x1], [*X, x4], [u])
    assert (longer.answer, longer.proved) == (False, False)
    hidden = gauthier_bornard([x2 + u * x3, x1, u * x1], [x1], X, [u])
    assert (hidden.answer, hidden.proved, hidden.verdict) == (False, True, Verdict.REFUTED)
    assert "rank 2 of 3: u = 0 hides x3" in str(hidden.reason)


def test_two_inputs_hide_a_state_together() -> None:
    """Neither alone."""
    observability = gauthier_bornard([(u + v) * x2, x1], [x1], X[:2], [u, v])
    assert str(observability.reason).endswith("u = v = 0 hides x2")


def test_it_is_of_every_real_input_whatever_the_ranges() -> None:
    """u is declared from 1/2 on; it is u = 0, beyond, that hides x2."""
    a, b = hg.Signal("a", low=-1, high=1), hg.Signal("b", low=-1, high=1)
    drive = hg.Signal("drive", low=0.5, high=2)
    data = {"states": (a, b), "inputs": (drive,), "outputs": (hg.Signal("y"),)}
    plant = hg.System("driven", **data, flow=[drive * b, -b], output=[a])
    assert {c.verdict for c in hg.forms.triangular(plant).checks} == {Verdict.PROVED}
    check, row = of_plant(plant), hg.survey(plant)["Gauthier-Bornard"]
    assert check.verdict is row.verdict is Verdict.REFUTED
    assert str(row.why).startswith("for every real input, ranges apart, some input hides a state: ")
    assert str(check.reason).endswith("drive = 0 hides b")
    assert str(row.why).endswith("drive = 0 hides b")


def test_parameters_stand_at_their_values() -> None:
    """The coupling that breaks the triangle has the nominal value 0, or a range."""
    a, b = hg.Signal("a", "m", ""), hg.Signal("b", "m", "")
    drive, y = hg.Signal("drive", "", ""), hg.Signal("y", "", "")

    def plant(c: hg.Signal) -> hg.System:
        flow = [b + c * drive * b, a]
        return hg.System("s", states=(a, b), inputs=(drive,), outputs=(y,), parameters=(c,), flow=flow, output=[a])

    assert of_plant(plant(hg.Signal("c", "", "", 0))).verdict is Verdict.GENERIC
    assert of_plant(plant(hg.Signal("c", "", "", 0, low=-1, high=1))).verdict is Verdict.REFUTED


@pytest.mark.parametrize(
    ("flow", "output", "inputs", "reason"),
    [
        ([x2, u**2], [x1], [u], "not affine in u;"),
        ([x2, u * v], [x1], [u, v], "not affine in u, v;"),
        ([x2, u], [x1 + u], [u], "output depends on u"),
        ([x2, x1], [x1], [], "no input"),
        ([x2, u], [x1, x2], [u], "one output"),
    ],
)
def test_where_it_does_not_apply(flow, output, inputs, reason: str) -> None:
    observability = gauthier_bornard(flow, output, [x1, x2], inputs)
    assert observability.answer is None
    assert not observability.applies
    assert reason in f"{observability.reason};"


def test_what_cancels_is_affine() -> None:
    """Exactly: by fractions, and by identities."""
    hidden = [x2 + ((u + x1) ** 2 - u**2 - 2 * u * x1) / (1 + x1), u * (sp.sin(u) ** 2 + sp.cos(u) ** 2)]
    assert gauthier_bornard(hidden, [x1], [x1, x2], [u]).answer is True


def test_a_slope_in_many_functions_is_judged_by_a_point() -> None:
    """Simplifying its second derivative took 30 s."""
    steep = sp.cosh(sp.atan(u) + sp.sqrt(1 + u**2))
    began = process_time()
    assert "not affine" in str(gauthier_bornard([x2, steep], [x1], [x1, x2], [u]).reason)
    assert process_time() - began < 20


def test_a_branch_is_not_an_open_dense_set() -> None:
    """For x1 > 0 the triangle holds; for x1 < 0 the input moves x3 into it. What fails somewhere fails."""
    flow = [x2 + u * sp.Max(0, -x1) * x3, x3, u]
    observability = gauthier_bornard(flow, [x1], X, [u])
    assert observability.answer is None
    assert "branch of max" in str(observability.reason)
    assert gauthier_bornard([x2 + u * sp.Abs(x3), x3, u], [x1], X, [u]).answer is False
