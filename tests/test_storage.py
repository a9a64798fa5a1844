"""What a model declares of inequality (38): proved with its other claims, in Python and in plain text."""

import json
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.check import Verdict
from hgogen.commands.claims import checked
from hgogen.errors import HgogenError
from hgogen.model import MissingPart, load
from hgogen.modelfiles.declarations import stored
from hgogen.prove.dissipation import BadErrorSystem
from hgogen.reading.given import Misfit

ROOT = Path(__file__).resolve().parents[1]
x, u, y = hg.Signal("x", low=-1, high=1), hg.Signal("u", low=-1, high=1), hg.Signal("y")
PLANT = hg.System("decay", states=(x,), inputs=(u,), outputs=(y,), flow=[-x + u], output=[x])
# e' = -4 e + w1 - 3 w2: V = e^2 has -8 e^2 + 20 e^2/mu^2 + e^2/2 < 0 for mu^2 > 8/3
DECLARED = {"gain": (3,), "V": "e_x**2", "mu": 2, "within": {"x": 1}}
PLAIN = """
name = "decay"
[states.x]
low = -1
high = 1
flow = "-x + u"
[inputs.u]
low = -1
high = 1
[outputs.y]
equation = "x"
[dissipation]
gain = [3]
V = {V}
mu = {mu}
within = {{x = 1}}
"""


@pytest.mark.parametrize("V", ["e_x**2", ((1,),), sp.Symbol("e_x", real=True) ** 2])
def test_a_declaration_is_what_dissipation_says(V: Any) -> None:
    dissipation = stored(PLANT, {**DECLARED, "V": V})
    assert dissipation.checks == hg.dissipation(hg.error_system(PLANT, (3,)), [[1]], mu=2, within=[1]).checks
    assert dissipation.proved
    assert dissipation.level == 1


@pytest.mark.parametrize(("mu", "verdict"), [(1.64, Verdict.PROVED), (1.62, Verdict.REFUTED)])
def test_its_edge_is_known(mu: float, verdict: Verdict) -> None:
    checks = {check.id: check for check in stored(PLANT, {**DECLARED, "mu": mu}).checks}
    assert checks["dissipation.inequality"].verdict is verdict


def test_a_disturbance_of_its_own_and_a_system_of_its_own() -> None:
    alone = stored(PLANT, {**DECLARED, "G1": ((1,),), "mu": "3/5"})  # 2 e^2/mu^2 < 7.5 e^2 for mu > 0.52
    assert alone.proved
    e = sp.Symbol("e", real=True)
    system = hg.ErrorSystem("own", (e,), (-4 * e,), [[1]])
    assert stored(PLANT, {"system": system, "V": e**2, "mu": 1, "within": (1,)}).proved


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        ({"gain": (3,), "V": "e_x**2", "mu": 2}, "has no key 'within'"),
        ({**DECLARED, "W": 1}, "has a key 'W'"),
        ({**DECLARED, "gain": (3, 4)}, "gain"),
        ({**DECLARED, "system": 7}, "has a key 'gain'"),
        ({**DECLARED, "mu": -1}, "must be a positive number"),
        ({**DECLARED, "V": "x**2"}, "x"),
        ({**DECLARED, "V": "__import__('os')"}, "__import__"),
    ],
)
def test_bad_declarations(declared: dict[str, Any], said: str) -> None:
    with pytest.raises(HgogenError) as caught:
        stored(PLANT, declared)
    assert said in str(caught.value)


def test_what_is_no_declaration_and_no_system() -> None:
    with pytest.raises(Misfit):
        stored(PLANT, 7)
    with pytest.raises((Misfit, BadErrorSystem)):
        stored(PLANT, {"system": 7, "V": 1, "mu": 1, "within": (1,)})


def plain(folder: Path, V: str = '"e_x**2"', mu: str = "2") -> Path:
    path = folder / "decay.toml"
    path.write_text(PLAIN.format(V=V, mu=mu))
    return path


@pytest.mark.parametrize("V", ['"e_x**2"', "[[1]]"])
def test_plain_text(tmp_path: Path, V: str) -> None:
    claims = checked(load(plain(tmp_path, V)))
    known = {check.id: check.verdict for check in claims.checks}
    assert known["dissipation.inequality"] is known["dissipation.level"] is Verdict.PROVED
    assert "with the L2 gain 2 from w" in claims.notes[-1]


def test_a_bad_declaration_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(MissingPart, match=r"decay\.toml: in dissipation, mu = 0"):
        checked(load(plain(tmp_path, mu="0")))


@pytest.mark.full
def test_check_prints_it_and_recheck_verifies_it(tmp_path: Path) -> None:
    file = tmp_path / "decay.json"
    run = CliRunner().invoke(cli.app, ["check", str(plain(tmp_path)), "--all", "--certificate", str(file)])
    assert run.exit_code == 0, run.output
    assert "dissipation.inequality" in run.stdout
    assert "the error stays in the box" in run.stderr
    answer = json.loads(CliRunner().invoke(cli.app, ["recheck", str(file), "--json"]).stdout)
    assert {row["found"] for row in answer["claims"] if row["id"].startswith("dissipation")} == {"verified"}


@pytest.mark.ordinary("not_iss")
@pytest.mark.parametrize("name", ["not_iss", "disturbed_pendulum"])
def test_the_shipped_declarations_are_proved(name: str) -> None:
    dissipation = load(ROOT / "models" / f"{name}.py").dissipation
    assert dissipation is not None
    assert dissipation.proved


def test_a_model_without_one() -> None:
    assert load(ROOT / "models" / "pendulum.py").dissipation is None
