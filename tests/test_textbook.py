"""Every plain-text model gets exactly its known answers; those of textbooks have some, derived by hand beside them."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import hgogen as hg
from hgogen.check import Verdict
from hgogen.commands.library import FIELDS, answers
from hgogen.reading.text_model import Entry, PlainModel, read
from hgogen.rigor.box import box

EVERY = sorted((Path(__file__).resolve().parents[1] / "models").glob("*.toml"))
BOOKS = {
    *("van_der_pol", "duffing", "lorenz", "roessler", "chua", "lotka_volterra", "contois", "haldane", "cstr"),
    *("induction_motor", "pmsm", "quadruple_tank", "flexible_joint", "battery", "sir", "hindmarsh_rose"),
    *("magnetic_levitation", "series_dc_motor", "glucose_insulin"),
}
FILES = [path for path in EVERY if path.stem in BOOKS]
PROVED, REFUTED, GENERIC, UNKNOWN = Verdict.PROVED, Verdict.REFUTED, Verdict.GENERIC, Verdict.UNKNOWN
GB = "Gauthier-Bornard"
each = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
every = pytest.mark.parametrize("path", EVERY, ids=lambda path: path.stem)


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
    assert {path.stem for path in FILES} == BOOKS
    assert all(len(read(path).known) >= 3 for path in FILES)


@every
def test_it_says_what_it_is(path: Path) -> None:
    model = read(path)
    assert model.plant.name == path.stem
    assert model.known.keys() <= set(FIELDS)
    assert all(signal.meaning for signal in model.plant.signals)
    assert all(signal.bounded for signal in (*model.plant.states, *model.plant.inputs))
    assert "reference = " in path.read_text()


@pytest.mark.ordinary("duffing", "sir", "van_der_pol")
@every
def test_its_known_answers(path: Path) -> None:
    model = read(path)
    answer = asked(model)
    assert not answer.keys() & {"note", "error"}
    known = dict(model.known)
    for pair, (low, high) in zip(answer.get("a_ranges") or (), known.pop("a_ranges", ()), strict=False):
        assert Fraction(pair[0]) <= Fraction(repr(low))
        assert Fraction(repr(high)) <= Fraction(pair[1])
        assert pair[1] - pair[0] <= (high - low) + 0.02 * high
    assert {field: answer.get(field) for field in known} == known
    if "a_ranges" in model.known:
        assert len(answer["a_ranges"]) == len(model.known["a_ranges"])


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


# Which form, and why not in the narrower ones, by hand: the row of `hg.survey`, its verdict, what its reason must say.
# triangular: u and parameters alone may stand in the slope by the next state; measured: the measured state too.
WHY: dict[str, tuple[tuple[str, Verdict | None, str], ...]] = {
    "van_der_pol": (("triangular", PROVED, "all"), (GB, None, "there is no input")),
    "duffing": (("triangular", PROVED, "all"), (GB, GENERIC, "uniformly observable")),
    # y' = s (y_ - x), y_' = -x z + ..: z is seen through x, not at all where x = 0
    "lorenz": (
        ("triangular", REFUTED, "y_' brings in z with a slope that varies with x, -x"),
        ("triangular, measured=True", REFUTED, "a_3 vanishes, at x = 0"),
        ("uniform", REFUTED, "dF_2/dz_3 vanishes, at x = 0"),
    ),
    "roessler": (("triangular", PROVED, "all"),),
    "chua": (("triangular", PROVED, "all"),),
    "lotka_volterra": (
        ("triangular", REFUTED, "N' brings in P with a slope that varies with N, -N*a"),
        ("triangular, measured=True", PROVED, "all"),
    ),
    # growth is not linear in the substrate
    "contois": (("triangular, measured=True", REFUTED, "varies with s"), ("uniform", PROVED, "all")),
    # growth has its maximum at S = sqrt(K J) = 2, inside the range: there the biomass does not show the substrate
    "haldane": (
        ("triangular", REFUTED, "X' brings in S with a slope that varies with X, S"),
        ("uniform", REFUTED, "dF_1/dz_2 changes sign"),
        (GB, GENERIC, "uniformly observable"),
    ),
    "cstr": (("triangular", REFUTED, "varies with T"), ("triangular, measured=True", PROVED, "all")),
    "induction_motor": (
        ("triangular", None, "for 1 output"),
        ("block_triangular, align='top'", REFUTED, "ia' brings in fa, fb, w together"),
        ("block_triangular, align='cascade'", REFUTED, "ia' brings in fa, fb, w together"),
        (GB, None, "for one output"),
    ),
    "pmsm": (
        ("block_triangular, align='top'", REFUTED, "i_d' and i_q' bring in the same state, w"),
        ("block_triangular, align='end'", UNKNOWN, "no chains aligned at their ends were found"),
        ("block_triangular, align='cascade'", REFUTED, "i_d' brings in i_q, w together"),
    ),
    "quadruple_tank": (("block_triangular, align='top'", REFUTED, "varies with h3, c3/(2*sqrt(h3))"),),
    "flexible_joint": (("triangular", PROVED, "all"), (GB, GENERIC, "uniformly observable")),
    # the voltage shows the charge and the relaxation at once
    "battery": (
        ("triangular, measured=True", REFUTED, "y brings in soc, v together"),
        ("uniform", REFUTED, "y brings in soc, v together"),
        (GB, None, "the output depends on i"),
    ),
    "sir": (("uniform", REFUTED, "the output never shows R"),),
    # x' = w - z + ..: both at once, though observable for every input
    "hindmarsh_rose": (("uniform", REFUTED, "x' brings in w, z together"), (GB, GENERIC, "uniformly observable")),
    # the force goes with the square of the current
    "magnetic_levitation": (("triangular, measured=True", REFUTED, "varies with i"), ("uniform", PROVED, "all")),
    "series_dc_motor": (
        ("triangular", REFUTED, "i' brings in w with a slope that varies with i, -i*k"),
        ("triangular, measured=True", PROVED, "all"),
    ),
    "glucose_insulin": (
        ("triangular", REFUTED, "G' brings in X with a slope that varies with G, -G"),
        ("triangular, measured=True", PROVED, "all"),
    ),
}
# Where the first derivatives determine the state: the verdict, and the condition or the determinant.
WHERE: dict[str, tuple[tuple[Verdict, str], ...]] = {
    **dict.fromkeys(("van_der_pol", "duffing", "roessler"), ((PROVED, "is 1,"),)),
    "chua": ((PROVED, "is alpha**2,"),),
    "lorenz": ((Verdict.WHERE, "x != 0"), (Verdict.WHERE, "y_ != 0"), (UNKNOWN, "below 3")),  # on the z axis, z' = -b z
    "lotka_volterra": ((PROVED, "is -N*a,"),),
    "contois": ((PROVED, "no zero on the box"),),
    "haldane": ((Verdict.WHERE, "J*K - S**2 != 0"),),
    "cstr": ((PROVED, "exp(-E/T)"),),
    "induction_motor": ((Verdict.WHERE, "!= 0"),),
    "pmsm": ((Verdict.WHERE, "holds where i_q != 0"), (PROVED, "is -i_d - k,")),
    "quadruple_tank": ((PROVED, "c3*c4/(4*sqrt(h3)*sqrt(h4))"),),
    "flexible_joint": ((PROVED, "is kl**2,"),),
    "battery": ((Verdict.WHERE, "!= 0"),),
    "sir": ((UNKNOWN, "rank below 3"),),
    "hindmarsh_rose": ((PROVED, "is r - 1,"),),
    "magnetic_levitation": ((PROVED, "-2*c*i/x**2"),),
    "series_dc_motor": ((PROVED, "-i**2*k**2"),),
    "glucose_insulin": ((PROVED, "G**2*p3"),),
}


@pytest.mark.ordinary("battery", "duffing", "lotka_volterra")
@each
def test_its_verdicts_and_why_not(path: Path) -> None:
    rows = {row.name: row for row in hg.survey(read(path).plant).rows}
    for name, verdict, why in WHY[path.stem]:
        assert rows[name].verdict == verdict
        assert why in str(rows[name].why)


@each
def test_where_its_outputs_determine_the_state(path: Path) -> None:
    plant = read(path).plant
    checks = hg.singularity(plant).checks
    assert [check.verdict for check in checks] == [verdict for verdict, _ in WHERE[path.stem]]
    for check, (_, says) in zip(checks, WHERE[path.stem], strict=True):
        assert says in str(check.reason)


def test_what_is_hidden_and_what_would_show_it() -> None:
    """The recovered of the epidemic alone: nothing else reads them."""
    hidden = {path.stem: hg.observability(read(path).plant) for path in FILES}
    assert {name: seen.unobservable for name, seen in hidden.items() if seen.unobservable} == {
        "sir": hidden["sir"].known.repairs
    }
    (symmetry,) = hidden["sir"].known.symmetries
    assert (str(symmetry), symmetry.proved) == ("R -> R + c", True)
    assert {check.verdict for name, seen in hidden.items() if name != "sir" for check in seen.checks} == {GENERIC}
    assert [check.verdict for check in hidden["sir"].checks] == [REFUTED]


def test_every_book_is_in_both_tables() -> None:
    assert WHY.keys() == WHERE.keys() == BOOKS
