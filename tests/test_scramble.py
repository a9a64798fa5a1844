"""The score of a library run on the scrambled systems: nothing claimed that is false, nearly all that is true found.

Every range must enclose the true one exactly; how much wider it may be is what the project promises: 5% for one and
two variables, 20% up to five. Each answer is there within the library's time limit. The ordinary run takes a fifth of
the systems, of every family and kind some; the slow one the rest.
"""

from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import pytest
import sympy as sp

from hgogen.commands import library
from hgogen.reading.expression import parse
from tests.scramble import Labelled, queries
from tests.scramble_families import singles
from tests.scramble_several import several
from tests.test_scramble_labels import numbers

FORMS = ("triangular", "triangular_uy", "uof_structure", "uof", "gb_uniform", "lipschitz")
SEVERAL = ("mimo_levelwise", "mimo_cascade", "mimo_uof")
Answers = dict[str, dict[str, Any]]


def every() -> tuple[Labelled, ...]:
    """Made when they are first asked for: to make them takes seconds, and every worker imports this file."""
    return (*singles(), *several(), *queries())


def in_fifth(one: Labelled) -> bool:
    return int(one.name.rsplit("_", 1)[1]) % 5 == 0


@pytest.fixture(scope="module", params=["a fifth", pytest.param("the rest", marks=pytest.mark.slow)])
def answers(request: pytest.FixtureRequest) -> Answers:
    wanted = request.param == "a fifth"
    return library.check([(one.name, one.model) for one in every() if in_fifth(one) == wanted])


def labelled(answers: Answers, field: str) -> Iterator[tuple[Labelled, Any]]:
    return ((one, one.truth[field]) for one in every() if one.name in answers and field in one.truth)


def test_a_fifth_is_of_every_family_and_kind() -> None:
    assert {one.kind for one in every() if in_fifth(one)} == {one.kind for one in every()}


@pytest.mark.full
def test_nothing_failed_and_nothing_was_late(answers: Answers) -> None:
    complaints = {name: [a.get(key) for key in ("error", "partial", "notes")] for name, a in answers.items()}
    wrong = {name: said for name, said in complaints.items() if any(said)}
    assert not wrong


@pytest.mark.ordinary("a fifth-triangular_uy", "a fifth-uof_structure")
@pytest.mark.parametrize("field", [*FORMS, *SEVERAL])
def test_verdicts(answers: Answers, field: str, capsys: pytest.CaptureFixture[str]) -> None:
    score: Counter[str] = Counter()
    for one, truth in labelled(answers, field):
        answer = answers[one.name][field]
        score[f"{truth} {'right' if answer == truth else 'none' if answer is None else 'WRONG: ' + one.name}"] += 1
    with capsys.disabled():
        print(f"\n  {field:16}", ", ".join(f"{what}: {count}" for what, count in sorted(score.items())), end="")
    assert not [what for what in score if "WRONG" in what]
    assert score["True right"] >= 0.95 * (score["True right"] + score["True none"]) > 0


@pytest.mark.parametrize("field", ["order", "rank_params_known", "observable_params_known"])
def test_orders_and_ranks(answers: Answers, field: str) -> None:
    missed = 0
    for one, truth in labelled(answers, field):
        answer = answers[one.name][field]
        if answer is None:
            missed += 1
            continue
        assert (sorted(answer) if field.startswith("observable") else answer) == truth, one.name
    assert missed <= 0.02 * sum(1 for _ in labelled(answers, field))


def encloses(answer: list[float], low: sp.Expr, high: sp.Expr) -> bool:
    """Exactly: a float is a rational."""
    ends = [sp.Rational(*Fraction(end).as_integer_ratio()) for end in answer]
    return bool(ends[0] <= low) and bool(high <= ends[1])


def excess(answer: list[float], low: sp.Expr, high: sp.Expr) -> float:
    """How much wider than the true range, of its width; of a point, of its size."""
    width = float(high - low) or abs(float(high)) or 1.0
    return (answer[1] - answer[0] - float(high - low)) / width


def test_ranges_of_gains(answers: Answers) -> None:
    none, wide = [], []
    for one, truth in labelled(answers, "a_ranges"):
        answer = answers[one.name]["a_ranges"]
        if answer is None:
            none.append(one.name)
            continue
        for pair, (low, high) in zip(answer, truth, strict=True):
            assert encloses(pair, low, high), (one.name, pair, low, high)
            wide += [one.name] if excess(pair, low, high) > 0.05 else []
        if answers[one.name]["triangular"]:
            assert all(pair[0] > 0 for pair in answer), one.name
    assert len(none) + len(wide) <= 0.02 * sum(1 for _ in labelled(answers, "a_ranges")), (none, wide)


def test_ranges_of_queries(answers: Answers) -> None:
    missed = []
    for one, truth in labelled(answers, "bounds"):
        for answer, (low, high) in zip(answers[one.name]["bounds"], truth, strict=True):
            assert answer is None or encloses(answer, low, high), (one.name, answer, low, high)
            allowed = 0.05 if len(one.model["states"]) <= 2 else 0.20
            if answer is None or excess(answer, low, high) > allowed:
                missed.append((one.name, answer, (low, high)))
    assert not missed


def test_singular_sets(answers: Answers) -> None:
    """At random points of the box neither vanishes; where a state makes the truth vanish, the answer does too."""
    count = 0
    for one, truth in labelled(answers, "singular"):
        answer = answers[one.name]["singular"]
        if answer is None:
            continue
        count += 1
        if isinstance(truth, str):
            assert answer == truth, one.name
            continue
        at = numbers(one, 4)
        names = {s.name: s for s in at} | {s.name: s for s in truth.free_symbols}
        product = sp.S.One if answer == "none" else sp.Mul(*(parse(text, names) for text in answer))
        assert sp.N(product.subs(at)) != 0, one.name
        for s in sorted(truth.free_symbols & at.keys(), key=str):
            point = at | {s: sp.S.Zero}
            if s.name in one.model["states"] and truth.subs(point).is_finite:
                assert (truth.subs(point) == 0) == (product.subs(point) == 0), one.name
    assert count >= 0.9 * sum(1 for _ in labelled(answers, "singular"))
