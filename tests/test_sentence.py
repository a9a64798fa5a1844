"""Reasons as data: a constant pattern with the values that it names; the text is made where it is printed."""

import ast
import json
import math
import pickle
import re
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from hypothesis import example, given
from hypothesis import strategies as st
from plants import MODELS, model

import hgogen as hg
from hgogen.check import Check, Verdict
from hgogen.commands.claims import _value_text
from hgogen.form import Form
from hgogen.model import load
from hgogen.rigor.singular import singular
from hgogen.sentence import NONE, Down, Reason, Sentence, Up, because, down, equations, joined, point, up
from hgogen.theorem import rows

PACKAGE = Path(hg.__file__).parent
NAMES = sorted(path.stem for path in MODELS.glob("*.[pt]*"))
x, u = sp.symbols("x u")
NESTED = because(
    "|det| >= {margin} on {boxes}, where {conditions: and }, below {most}; {share:.0%}, {exact}",
    margin=Down(Fraction(2, 3)),
    boxes=because("{count} boxes", count=7),
    conditions=[because("{of} != 0", of=x), because("{of} > 0", of=u + 1)],
    most=Up(2 / 3),
    share=0.25,
    exact=Fraction(1, 3),
)
TEXT = "|det| >= 0.6666 on 7 boxes, where x != 0 and u + 1 > 0, below 0.6667; 25%, 1/3"


def test_the_text_of_a_reason() -> None:
    assert (str(NESTED), f"{NESTED}") == (TEXT, TEXT)
    assert NESTED.part("margin").value == Fraction(2, 3)
    assert NESTED.part("boxes").part("count") == 7


def test_a_reason_is_its_values() -> None:
    """Two bounds that round to one text are two reasons."""
    one, other = (because("it is {a}", a=Down(a)) for a in (0.12341, 0.12342))
    assert str(one) == str(other)
    assert one != other
    assert len({one, other, because("it is {a}", a=Down(0.12341))}) == 2
    assert because("it is {a}", a=x) != Sentence.of("it is {a}", a=x)
    again = pickle.loads(pickle.dumps(NESTED))
    assert (again, hash(again)) == (NESTED, hash(NESTED))


def test_a_reason_as_data() -> None:
    data = json.loads(json.dumps(NESTED.as_dict()))
    assert data["pattern"] == NESTED.pattern
    assert data["values"] == {
        "margin": {"value": "2/3", "rounded": "down"},
        "boxes": {"pattern": "{count} boxes", "values": {"count": 7}},
        "conditions": [
            {"pattern": "{of} != 0", "values": {"of": "x"}},
            {"pattern": "{of} > 0", "values": {"of": "u + 1"}},
        ],
        "most": {"value": 2 / 3, "rounded": "up"},
        "share": 0.25,
        "exact": "1/3",
    }
    assert because("{a}", a=math.inf).as_dict()["values"] == {"a": "inf"}  # JSON has none


def test_a_plain_text_is_a_reason_without_a_pattern_of_its_own() -> None:
    """Braces in it are its own."""
    check = Check("mine", "a claim", Verdict.PROVED, "by hand, {of} 7")
    assert isinstance(check.reason, Reason)
    assert str(check.reason) == check.as_dict()["reason"] == "by hand, {of} 7"
    assert check.reason.part("text") == "by hand, {of} 7"


def test_reasons_one_after_the_other() -> None:
    one, other = because("one"), because("other")
    assert [str(joined(*each)) for each in ((), (one,), (NONE, one), (one, NONE, other))] == [
        "",
        "one",
        "one",
        "one; other",
    ]
    assert not NONE
    assert one


def test_names_with_values() -> None:
    at = {x: Fraction(1, 3), u: Fraction(2)}
    assert str(because("at {at}", at=equations(at))) == "at x = 1/3, u = 2"
    assert str(because("at {at}", at=point(at))) == "at x = 0.333333, u = 2"


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(1, 9))
def test_a_bound_is_written_as_it_is_rounded(value: float, digits: int) -> None:
    assert (
        str(because("{a} {b}", a=Down(value, digits), b=Up(value, digits)))
        == f"{down(value, digits)} {up(value, digits)}"
    )


@pytest.mark.full
@example(-(10**5) - 1, 20, 0)  # six digits and a sign
@given(st.integers(-(10**6) + 1, 10**6 - 1), st.integers(0, 30), st.integers(0, 300))
def test_the_tables_shorten_whole_numbers_of_many_zeros(number: int, zeros: int, more: int) -> None:
    """As a search in the text would find them, of up to six digits before 20 zeros and more."""
    long = re.compile(r"(?<![\d.])(\d{1,15}?)(0{20,})(?!\d)")
    whole = sp.Integer(number) * 10**zeros
    for value in (whole, whole * x + 10**more, x / 10**more + sp.sin(whole * u), x**whole - 1):
        assert _value_text(value) == long.sub(lambda part: f"{part[1]}e{len(part[2])}", str(value))
    assert _value_text(int(whole)) == _value_text(whole)


def test_conditions_in_words() -> None:
    """Each kind of what a function asks for."""
    f = sp.Function("f")
    asking = [1 / x, sp.sqrt(x), sp.log(x), sp.asin(x), sp.acosh(x), sp.tan(x), sp.atan2(u, x), f(x)]
    said = ["x != 0", "x > 0", "x > 0", "-1 < x < 1", "x > 1", "cos(x) != 0", "x > 0", "f(x) is smooth"]
    conditions = [singular([part], {x: (-9, 9), u: (-9, 9)})[part] for part in asking]
    assert [str(each) for each in conditions] == said
    assert [str(each.failure) for each in conditions[:2]] == ["at x = 0", "unless x > 0"]


def test_the_tables_shorten_what_is_nested() -> None:
    inner = because("it is {a}", a=x / sp.Integer(10) ** 30)
    assert inner.written(_value_text) == "it is x/1e30"
    assert because("{why}, {each: and }", why=inner, each=[10**25, inner]).written(_value_text) == (
        "it is x/1e30, 1e25 and it is x/1e30"
    )


# --- of the shipped models


@cache
def constants() -> frozenset[str]:
    """The texts that stand in the package, and those of an f-string not among them."""
    texts = set()
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
        nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in parts)
        texts |= {node.value for node in nodes if isinstance(node.value, str)}
    return frozenset(texts)


def sentences(value: Any) -> Iterator[Sentence]:
    """A sentence, and those in it."""
    if isinstance(value, Sentence):
        yield value
        yield from (inner for _, each in value.values for inner in sentences(each))
    elif isinstance(value, tuple):
        yield from (inner for each in value for inner in sentences(each))


def of_forms(plant: hg.System) -> tuple[tuple[Form, ...], tuple[Sentence, ...]]:
    survey = hg.survey(plant)
    return tuple(row.form for row in survey.rows if row.form), tuple(row.why for row in survey.rows)


@pytest.mark.ordinary("pmsm", "sir")
@pytest.mark.parametrize("name", NAMES)
def test_no_number_is_written_into_the_pattern_of_a_reason(name: str) -> None:
    loaded = load(name)
    forms, said = of_forms(loaded.plant)
    checks = [*(check for form in forms for check in form.checks), *hg.singularity(loaded.plant).checks]
    checks += hg.observability(loaded.plant).checks
    if loaded.has("step"):
        observer = loaded.step().observer
        checks += observer.checks
        if observer.theorem:
            said += tuple(row.reason for row in rows(observer.theorem, observer.checks))
    assert checks
    every = [*said, *(check.reason for check in checks), *(check.claim for check in checks)]
    patterns = {inner.pattern for each in every for inner in sentences(each)}
    assert len(patterns) > 5
    assert patterns <= constants()
    for check in checks:
        data = check.as_dict()
        assert json.loads(json.dumps(data)) == data
        assert data["reason"] == str(check.reason)
        assert data["reason_data"]["pattern"] == check.reason.pattern


def test_a_proved_bound_is_data() -> None:
    """At its full precision, and exact where it is."""
    form = hg.forms.triangular(model("pendulum"))
    (lipschitz,) = form.about("lipschitz")
    bound = lipschitz.reason.part("L_b")
    assert isinstance(bound, Up)
    assert str(lipschitz.reason).startswith(f"L_b <= {bound}, ")
    assert 0 <= float(str(bound)) - bound.value <= 1e-3 * bound.value
