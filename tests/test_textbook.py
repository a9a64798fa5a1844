"""Every plain-text model in models/ has known answers, derived by hand beside them, and gets exactly those."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import hgogen as hg
from hgogen.answers import FIELDS, answers
from hgogen.box import box
from hgogen.check import Verdict
from hgogen.entry import Entry
from hgogen.modelfile import PlainModel, read

FILES = sorted((Path(__file__).resolve().parents[1] / "models").glob("*.toml"))
BOOKS = {
    *("van_der_pol", "duffing", "lorenz", "roessler", "chua", "lotka_volterra", "contois", "haldane", "cstr"),
    *("induction_motor", "pmsm", "quadruple_tank", "flexible_joint", "battery", "sir", "hindmarsh_rose"),
    *("magnetic_levitation", "series_dc_motor", "glucose_insulin"),
}
each = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)


def asked(model: PlainModel) -> dict[str, Any]:
    """The library's answers to a plant; a parameter without a range is its value."""
    plant = model.plant
    values = {p: value for p, value in plant.nominal.items() if not p.bounded}
    flow, output = (tuple(e.xreplace(values) for e in rows) for rows in (plant.flow, plant.output))
    ranges = box([s for s in plant.signals if s.bounded and s not in plant.outputs])
    known = tuple(p for p in plant.parameters if p.bounded)
    names = tuple(y.name for y in plant.outputs)
    return dict(
        answers(Entry(plant.name, plant.states, plant.inputs, known, (), names, flow, output, ranges, ranges, ()))
    )


def test_the_textbooks_are_there() -> None:
    assert {path.stem for path in FILES} >= BOOKS


@each
def test_it_says_what_it_is(path: Path) -> None:
    model = read(path)
    assert model.plant.name == path.stem
    assert len(model.known) >= 3
    assert model.known.keys() <= set(FIELDS)
    assert all(signal.meaning for signal in model.plant.signals)
    assert all(signal.bounded for signal in (*model.plant.states, *model.plant.inputs))
    assert "reference = " in path.read_text()


@each
def test_its_known_answers(path: Path) -> None:
    model = read(path)
    found = asked(model)
    assert not found.keys() & {"note", "error"}
    known = dict(model.known)
    for pair, (low, high) in zip(found.get("a_ranges") or (), known.pop("a_ranges", ()), strict=False):
        assert Fraction(pair[0]) <= Fraction(repr(low))
        assert Fraction(repr(high)) <= Fraction(pair[1])
        assert pair[1] - pair[0] <= (high - low) + 0.02 * high
    assert {field: found.get(field) for field in known} == known
    if "a_ranges" in model.known:
        assert len(found["a_ranges"]) == len(model.known["a_ranges"])


def test_every_verdict_occurs() -> None:
    """Proved, refuted and generic by the forms and the ranks; true, false, "na", "all", "none" by the answers."""
    plants = [read(path).plant for path in FILES]
    forms = [hg.forms.triangular(plant) for plant in plants if len(plant.outputs) == 1]
    verdicts = {check.verdict for form in forms for check in form.checks}
    verdicts |= {check.verdict for plant in plants for check in hg.observability(plant).checks}
    verdicts |= {check.verdict for plant in plants for check in hg.singularity(plant).checks}
    assert verdicts >= {Verdict.PROVED, Verdict.REFUTED, Verdict.GENERIC}
    known = [read(path).known for path in FILES]
    assert {one.get("gb_uniform") for one in known} >= {True, "na"}
    assert {str(one.get("singular")) for one in known} >= {"all", "none"}
    for field in ("triangular", "triangular_uy", "uof", "uof_structure", "mimo_uof"):
        assert {one.get(field) for one in known} >= {True, False}, field


@each
def test_the_triangular_form_says_the_same(path: Path) -> None:
    """The checks of the form of a plant with one output against the known answer."""
    model = read(path)
    if len(model.plant.outputs) > 1:
        pytest.skip("has several outputs")
    checks = {check.id: check.verdict for check in hg.forms.triangular(model.plant).checks}
    gains = [verdict for name, verdict in checks.items() if name.startswith("triangular.a_")]
    proved = checks["triangular.structure"] is Verdict.PROVED and set(gains) == {Verdict.PROVED}
    assert proved == model.known["triangular"]
