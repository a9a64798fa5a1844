"""The first line of `check` says what its table says: of every shipped model, and of random plants."""

import random
from pathlib import Path

import pytest
import sympy as sp
from plants import MODELS, chain

import hgogen as hg
from hgogen.commands.checking import headline
from hgogen.commands.claims import Checked, checked
from hgogen.model import load
from hgogen.which_forms import Survey

FILES = sorted(path for path in MODELS.glob("*.*") if path.is_file())
QUICK = ("sir", "fitzhugh_nagumo", "cascaded_tanks", "pmsm")  # none, another form, a recast plant, two outputs
NONE = "in none of the requested forms"


def agrees(line: str, survey: Survey) -> None:
    """The line names the forms whose rows are proved, and no other as proved; it says "none" of none alone."""
    said = line.partition(": ")[2].split("; ")[1]
    proved = {row.kind for row in survey.rows if row.form and row.verdict is hg.Verdict.PROVED}
    if proved:
        assert set(said.removesuffix(", proved").split(", ")) == proved
    else:
        assert not said.endswith(", proved")
        assert (said == NONE) == (not survey.candidates)


@pytest.mark.parametrize(
    "file",
    [pytest.param(f, marks=() if f.stem in QUICK else (pytest.mark.slow,), id=f.stem) for f in FILES],
)
def test_of_every_shipped_model(file: Path) -> None:
    model = load(file)
    survey = hg.survey(model.plant)
    claims = checked(model, survey)
    line = headline(hg.observability(model.plant), survey, claims)
    agrees(line, survey)
    if claims.demanded:
        kinds = {row.kind for row in (survey.proved or survey.candidates)}
        recast = claims.form.system is not model.plant and claims.form.system.origin is not None
        assert ("its observer's form" in line) == (recast or claims.form.kind not in kinds)


def plants(count: int) -> list[hg.System]:
    """Of two or three states and one or two outputs, of monomials that are often chains, and often not."""
    draw, systems = random.Random(5), []
    x = [hg.Signal(f"x{i}", low=-1, high=2) for i in range(1, 4)]
    u = hg.Signal("u", low=-1, high=1)
    for k in range(count):
        n, p = draw.randint(2, 3), draw.randint(1, 2)
        terms = [0, *x[:n], x[0] * x[n - 1], sp.sin(x[0]), u * x[1], x[1] ** 3, sp.Integer(1)]
        flow = [sp.Add(*draw.sample(terms, 2), x[i + 1] if i + 1 < n and draw.random() < 0.7 else 0) for i in range(n)]
        output = [draw.choice((x[j], x[j], 2 * x[j] + u, x[j] ** 3)) for j in range(p)]
        ys = [hg.Signal(f"y{j}") for j in range(p)]
        systems.append(hg.System(f"random{k}", states=x[:n], inputs=(u,), outputs=ys, flow=flow, output=output))
    return systems


@pytest.mark.full
def test_of_random_plants() -> None:
    lines = []
    for plant in [*plants(12), chain(3)]:
        survey = hg.survey(plant)
        form = survey.best
        claims = Checked(plant.name, form, form.checks, (), demanded=False)
        lines.append(headline(hg.observability(plant), survey, claims))
        agrees(lines[-1], survey)
    assert any("proved" in line for line in lines)
    assert any(NONE in line for line in lines)
