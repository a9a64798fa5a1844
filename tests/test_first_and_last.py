"""What `check` says first, what its table says and what it says last agree, and what it advises is built."""

from pathlib import Path

import pytest
from plants import MODELS
from test_advice import made
from test_cli import hgogen
from test_headline import NONE, agrees

import hgogen as hg
from hgogen.check import Verdict
from hgogen.commands.advice import advice
from hgogen.commands.checking import headline
from hgogen.commands.claims import checked
from hgogen.model import load

FILES = sorted(path for path in MODELS.glob("*.*") if path.is_file())
PLANTS = {  # the flow of each state, then the outputs; the forms that are proved
    "buck": ("v: i - l; i: 0.5*u - v; l: 0", "v", {"state_affine"}),
    "hidden": ("p: s; s: c - d - s + u; c: 0; d: 0", "p", {"state_affine"}),
    "chain": ("a: b; b: c; c: u - sin(b)", "a", {"triangular", "uniform"}),
    "linear": ("a: b; b: u - a - b", "a", {"triangular", "uniform", "state_affine"}),
    "bends": ("a: b + b**3/3; b: -a*b", "a", {"uniform"}),
    "by_the_measured": ("a: (2 + a)*b; b: -b**2", "a", {"triangular", "uniform"}),
    "by_the_input": ("a: (2 + u)*b; b: -sin(b)", "a", {"triangular", "uniform"}),
    "by_a_sign": ("a: u*b; b: -a", "a", {"state_affine"}),
    "square": ("a: b; b: u - a", "a**2", set()),
    "mixed": ("a: b - a; b: a - 2*b", "a + b**3 + b", set()),
    "product": ("a: a*b; b: -b", "a*b", set()),
    "two": ("a: b; b: c - sin(b); c: u - c", "a; c", {"block_triangular"}),
    "two_linear": ("a: b; b: c - a; c: u - c", "a; c", {"block_triangular", "state_affine"}),
    "two_mixed": ("a: b*c; b: -a; c: a*b", "a + b**3; b*c", set()),
    "unseen": ("a: -a; b: a - b", "a", set()),
}
SLOW = {"chain", "linear", "by_the_measured", "by_the_input", "two", "two_linear", "two_mixed", "product", "bends"}


def written(folder: Path, name: str) -> Path:
    """The plant as plain text, everything in [-1, 1], in a folder with a space in its name."""
    flow, outputs, _ = PLANTS[name]
    rows = [f'name = "{name}"']
    for state, _, rate in (part.strip().partition(": ") for part in flow.split(";")):
        rows.append(f'states.{state} = {{low = -1, high = 1, flow = "{rate}"}}')
    rows += ["inputs.u = {low = -1, high = 1}"] if "u" in flow else []
    rows += [f'outputs.y{k} = {{equation = "{e.strip()}"}}' for k, e in enumerate(outputs.split(";"))]
    path = folder / "my plants" / f"{name}.toml"
    path.parent.mkdir()
    path.write_text("\n".join([*rows, ""]))
    return path


def agree(path: Path, folder: Path) -> set[str]:
    """The forms that are proved, after first, table and last were compared."""
    model = load(path)
    survey = hg.survey(model.plant)
    seen, claims = hg.observability(model.plant), checked(model, survey)
    first, advised = headline(seen, survey, claims), advice(model, seen, survey, claims)
    agrees(first, survey)
    proved = {row.kind for row in survey.proved}
    last = claims.notes[-1] if not claims.demanded else ""
    assert ("none of the requested forms" in last) == (not claims.demanded and not survey.candidates and not proved)
    assert not ("none of the requested forms" in last and NONE not in first)
    if "and in no other" in last:
        assert set(last.partition("is in ")[2].partition(", proved")[0].split(", ")) == proved
    if "form alone" in last:
        assert survey.candidates
        assert f"the {survey.best.kind} form" in last
    if proved:
        assert not [note for note in advised.notes if "in a form" in note]
    refuted = {row.name for row in survey.answered if row.verdict is Verdict.REFUTED}
    assert not refuted & {one.form for one in advised.admitted if one.proposed}  # a tuning may be of a recast plant
    for one in advised.admitted[:2]:
        assert made(model, one, folder).observer.name == one.observer
        assert not (model.plain and ("load(" in one.line or "hg." in one.line))
    spoken = " ".join([last, *advised.notes, *(check.advice for check in claims.checks)])
    assert not (model.plain and any(word in spoken for word in ("hg.", "accept=", "forms.")))
    return proved


@pytest.mark.ordinary("buck", "unseen")
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in PLANTS])
def test_a_plant(name: str, tmp_path: Path) -> None:
    assert agree(written(tmp_path, name), tmp_path) == PLANTS[name][2]


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_shipped_model(file: Path, tmp_path: Path) -> None:
    agree(file, tmp_path)


def test_a_refusal_is_in_the_language_of_the_model(tmp_path: Path) -> None:
    """Of plain text by each command, and in the table of checks in none."""
    path = written(tmp_path, "by_a_sign")
    path.write_text(path.read_text() + 'observer = {kind = "high_gain", theta = 5, poles = [-1, -1], dt = 1e-3}\n')
    for command in ("check", "generate"):
        out, err = hgogen(command, str(path), *(["--out", str(tmp_path)] if command == "generate" else []), status=1)
        assert (
            'To build all the same, say accept = ["triangular.a_2"], knowing that the observer predicts without '
            "correction" in err
        )
        assert "accept=" not in out + err
    assert "Or accept triangular.a_2, knowing that" in " ".join(
        hgogen("check", str(path), "--all", status=1)[0].split()
    )
