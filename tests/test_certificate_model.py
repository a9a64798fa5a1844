"""The link of a certificate with the C: one digest of the model; and what of a file is refused, or fails alone."""

import json
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import emitted
import pytest
from plants import pendulum
from typer.testing import CliRunner

import hgogen as hg
from hgogen import cli
from hgogen.certificates.certificate import NotCertifiable, certificate, fingerprint
from hgogen.recheck.file import DIGEST_DIGITS, NoCertificate, digest, model_digest
from hgogen.recheck.verification import Row, recheck

ROOT = Path(__file__).resolve().parents[1]
LINKED = ("pendulum", "fitzhugh_nagumo", "cascaded_tanks", "two", "tunable", "no_input")


def of(observer: hg.Observer) -> dict[str, Any]:
    return certificate(observer.form, observer.checks, observer.name)


@cache
def _written() -> str:
    return json.dumps(of(pendulum(theta=1e4)))


def written() -> dict[str, Any]:
    """A certificate all of whose claims are verified."""
    content: dict[str, Any] = json.loads(_written())
    return content


def sealed(content: dict[str, Any]) -> str:
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def rows(content: dict[str, Any]) -> dict[str, Row]:
    return {row.id: row for row in recheck(sealed(content)).rows}


def claim_of(content: dict[str, Any], id: str) -> dict[str, Any]:
    return next(claim for claim in content["claims"] if claim["id"] == id)


def command(*arguments: str) -> Any:
    return CliRunner().invoke(cli.app, list(arguments))


# --- one digest -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LINKED)
def test_the_header_the_certificate_and_the_verifier_name_one_model(name: str) -> None:
    step = emitted.step(name)
    content = of(step.observer)
    report = recheck(json.dumps(content))
    assert content["observer"]["name"] == report.observer == step.observer.name
    assert report.model == content["model"] == fingerprint(step.observer.form, step.observer.checks, report.observer)
    line = f" * Model: {report.model[:DIGEST_DIGITS]}, as `hgogen recheck` prints it for the model's certificate\n"
    assert line in emitted.files(name)[f"{step.name}.h"]


@pytest.mark.full
def test_the_committed_header_is_of_the_model(tmp_path: Path) -> None:
    """A changed parameter is another model: the header of the old one does not name it."""
    header = (ROOT / "generated" / "pendulum" / "pendulum.h").read_text()
    text = (ROOT / "models" / "pendulum.py").read_text()
    assert text.count("19.6") == 1
    for value, same in (("19.6", True), ("25", False)):
        model, file = tmp_path / "pendulum.py", tmp_path / "pendulum.json"
        model.write_text(text.replace("19.6", value))
        assert command("check", str(model), "--certificate", str(file)).exit_code == 0
        (line,) = [row for row in command("recheck", str(file)).stdout.splitlines() if row.startswith("model ")]
        assert (f"Model: {line.removeprefix('model ')}," in header) is same


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "a range": lambda c: c["plant"]["states"][0].update(high="5"),
    "a parameter": lambda c: c["plant"]["parameters"][0].update(low="25", high="25"),
    "an equation of the plant": lambda c: c["plant"]["flow"].__setitem__(0, "w + q"),
    "an output": lambda c: c["plant"]["output"].__setitem__(0, "2*q"),
    "the form": lambda c: c["form"]["b"].__setitem__(0, "z1"),
    "theta": lambda c: c["observer"].update(theta="20"),
    "a gain": lambda c: c["observer"]["gains"].__setitem__(0, "1"),
    "the observer's name": lambda c: c["observer"].update(name="other"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_part_that_is_proved_about_counts(change: str) -> None:
    content = written()
    CHANGES[change](content)
    assert model_digest(content) != content["model"]


def test_what_is_found_of_a_model_does_not_count() -> None:
    """Claims, their evidence, the version: another proof is of the same model."""
    content = written()
    other = {**content, "claims": [], "hgogen": "99", "digest": ""}
    assert model_digest(other) == content["model"]


def test_a_file_that_names_another_model_fails() -> None:
    content = written()
    content["model"] = "0" * 64
    report = recheck(json.dumps({**content, "digest": digest(content)}))
    assert [(row.id, row.found) for row in report.failed] == [("model", "fails")]
    assert report.model == model_digest(content)


def test_the_banner_computes_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError

    file = sys.modules["hgogen.certificates.certificate"]  # hgogen.certificate is the function
    monkeypatch.setattr(file, "texts", never)
    monkeypatch.setattr(file, "recheck", never)
    text = hg.targets.c99(emitted.step("pendulum"), check=False)["pendulum.h"]
    assert "Model: " in text
    with pytest.raises(AssertionError):
        of(emitted.step("pendulum").observer)


def test_a_header_of_a_model_without_a_certificate_says_so() -> None:
    assert " * Model: no certificate can carry all of its functions\n" in emitted.files("functions")["functions.h"]
    with pytest.raises(NotCertifiable):
        of(emitted.step("functions").observer)


@pytest.mark.parametrize("gone", ["states", "outputs", "form"])
def test_a_plant_without_states_or_outputs_is_none(gone: str) -> None:
    """Nobody declares one, so the rules need not ask."""
    content = of(emitted.step("pendulum").observer)
    plant, form = {**content["plant"]}, {**content["form"]}
    if gone == "outputs":
        plant |= {"outputs": [], "output": []}
        form |= {"output": []}
    else:
        form |= {"from_form": []} if gone == "states" else {"states": [], "to_form": [], "A": [], "b": [], "blocks": []}
        plant |= {"states": [], "flow": [], "output": ["0"]} if gone == "states" else {}
    forged = {**content, "plant": plant, "form": form, "observer": None, "claims": []}
    with pytest.raises(NoCertificate, match="has no states, or there are no outputs"):
        recheck(json.dumps({**forged, "digest": digest(forged)}))


# --- the observer ---------------------------------------------------------------------------------------------------


def test_a_bound_is_that_of_the_named_observer() -> None:
    """An observer of another name has other equations."""
    content = written()
    assert rows(content)["high_gain.theta"].found == "verified"
    content["observer"]["name"], numbered = "low_power", content["observer"]
    for content["observer"] in (numbered, {"name": "high_gain"}):
        for known in (rows(content)[id] for id in ("high_gain.convergence", "high_gain.theta")):
            assert known.found == "fails"
            assert "the file has no high_gain observer with its numbers" in known.sentence


def test_the_row_of_convergence_says_under_what() -> None:
    content = written()
    sentence = rows(content)["high_gain.convergence"].sentence
    under = "in continuous time, without noise, the error converges exponentially for every theta"
    assert sentence.startswith(f"the high_gain observer: {under}")
    for state in content["form"]["states"]:
        assert f"{state['name']} in [{state['low']}, {state['high']}]" in sentence


# --- what is refused, and what fails alone --------------------------------------------------------------------------

HOLDERS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "the file": lambda c: c,
    "plant": lambda c: c["plant"],
    "form": lambda c: c["form"],
    "observer": lambda c: c["observer"],
    "a range": lambda c: c["plant"]["states"][0],
    "a claim": lambda c: c["claims"][0],
}


@pytest.mark.parametrize("holder", HOLDERS)
def test_an_unknown_part_is_refused(holder: str) -> None:
    content = written()
    HOLDERS[holder](content)["approved_by"] = "nobody"
    with pytest.raises(NoCertificate, match=rf'{holder} has a part "approved_by", which is unknown here'):
        recheck(sealed(content))


ROWS: dict[str, Callable[[dict[str, Any]], object]] = {
    "an unknown part": lambda e: e.update(approved_by="nobody"),
    "a number that is none": lambda e: e.update(bound="about 2"),
    "a part that is missing": lambda e: e.pop("tree"),
    "a part of another type": lambda e: e.update(box=[]),
    "a range that is none": lambda e: e.update(box={**e["box"], "z1": ["1"]}),
    "an empty range": lambda e: e.update(box={**e["box"], "z1": ["1", "0"]}),
}


@pytest.mark.parametrize("fault", ROWS)
def test_a_malformed_row_fails_alone(fault: str) -> None:
    content = written()
    ROWS[fault](claim_of(content, "triangular.lipschitz")["evidence"])
    by_claim = rows(content)
    assert [id for id, row in by_claim.items() if row.found == "fails"] == ["triangular.lipschitz"]
    assert by_claim["triangular.lipschitz"].sentence
    assert "hgogen check" not in by_claim["triangular.lipschitz"].sentence  # the advice stands once, below the table


def test_an_unknown_verdict_and_an_unknown_reason_fail_alone() -> None:
    content = written()
    claim_of(content, "triangular.lipschitz")["verdict"] = "certain"
    by_claim = rows(content)
    assert (by_claim["triangular.lipschitz"].found, by_claim["triangular.a_2"].found) == ("fails", "verified")
    claim_of(content, "triangular.lipschitz").update(verdict="unknown", evidence={"reason": "", "bound": "1"})
    assert rows(content)["triangular.lipschitz"].found == "fails"


# --- the command line -----------------------------------------------------------------------------------------------


@pytest.mark.full
def test_the_last_line_counts(tmp_path: Path) -> None:
    file = tmp_path / "p.json"
    command("check", str(ROOT / "models" / "pendulum.py"), "--certificate", str(file))
    assert command("recheck", str(file)).stdout.splitlines()[-1] == "11 verified, 0 open, 0 stated, 0 failed"
    content = json.loads(file.read_text())
    answer = json.loads(command("recheck", str(file), "--json").stdout)
    assert (answer["model"], answer["observer"], answer["verified"]) == (content["model"], "high_gain", True)
    claim_of(content, "triangular.lipschitz")["evidence"]["bound"] = "1"
    file.write_text(sealed(content))
    assert command("recheck", str(file)).stdout.splitlines()[-1] == "10 verified, 0 open, 0 stated, 1 failed"


def test_a_file_of_which_nothing_is_verified_does_not_pass(tmp_path: Path) -> None:
    file = tmp_path / "sir.json"
    shown = command("check", str(ROOT / "models" / "sir.toml"), "--certificate", str(file))
    assert "nothing in it can be verified again" in shown.stderr
    assert "verifies it again" not in shown.stderr
    shown = command("recheck", str(file))
    assert shown.exit_code == 1
    assert shown.stdout.splitlines()[-1] == "0 verified, 0 open, 1 stated, 0 failed"
    assert "nothing of sir is verified" in shown.stderr
    answer = json.loads(command("recheck", str(file), "--json").stdout)
    assert (answer["verified"], answer["observer"]) == (False, None)
