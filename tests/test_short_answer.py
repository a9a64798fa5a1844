"""The short answer of `check`: at most ten lines, which name what works."""

import re
import warnings
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hgogen.cli import app

MODELS = Path(__file__).resolve().parents[1] / "models"
SPRING = """
name = "spring"
states.h = {low = -1, high = 1, flow = "v"}
states.v = {low = -2, high = 2, flow = "-h - h**3"}
outputs.y = {equation = "h"}
"""
MIXER = """
name = "mixer"
states.a = {low = 0.1, high = 1, flow = "-a*b"}
states.b = {low = 0.1, high = 1, flow = "a*b - b"}
states.c = {low = 0.1, high = 1, flow = "b - c"}
outputs.y = {equation = "a + c"}
"""
OTHER = 'outputs.w = {equation = "v"}\n'
BLIND = SPRING + 'states.d = {low = -1, high = 1, flow = "-d"}\n'


def check(*arguments: str, status: int = 0) -> list[str]:
    """Return the printed lines of the command."""
    done = CliRunner().invoke(app, ["check", *arguments], env={"COLUMNS": "110"})
    assert done.exit_code == status, done.output
    return done.output.splitlines()


def labels(lines: list[str]) -> list[str]:
    return [label[1] for text in lines[1:] if (label := re.match(r"(\w+(?: \w+)?)  ", text))]


def written(folder: Path, text: str) -> str:
    path = folder / "model.toml"
    path.write_text(text)
    return str(path)


def test_a_plant_in_a_high_gain_form_takes_its_own_proved_observer() -> None:
    lines = check(str(MODELS / "pendulum.py"))
    assert lines[0] == "pendulum: locally observable; triangular, uniform, state_affine, proved"
    assert labels(lines) == ["weakest", "take", "proved", "not proved", "fix first", "details"]
    text = " ".join(" ".join(lines).split())
    assert "take high_gain in triangular form, with the gains of the model:" in text
    assert 'load("models/pendulum.py").step()' in text or f'load("{MODELS}/pendulum.py").step()' in text
    assert "proved high_gain.convergence: " in text
    assert "not proved nothing" in text
    assert "fix first nothing" in text
    assert len(lines) <= 11


@pytest.mark.parametrize("text", [SPRING, MIXER], ids=["spring", "mixer"])
def test_a_line_that_makes_the_observer_can_be_pasted(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    lines = check(path)
    (entry,) = (line.strip() for line in lines if line.startswith(" " * 12 + "tuning."))
    Path(path).write_text(entry + text)
    own = check(path, "--observer", entry.split()[0].removeprefix("tuning."))
    assert "with the gains of the model" in " ".join(own)
    assert len(lines) <= 14


def test_a_plant_in_no_high_gain_form_takes_the_kalman_filter(tmp_path: Path) -> None:
    path = written(tmp_path, MIXER)
    first = " ".join(" ".join(check(path)[:2]).split())
    assert first.startswith("mixer: locally observable; take the extended Kalman filter; no high-gain form is proved")
    assert "(why: --all; more forms: --deep)" in first
    why = "the theorem requires a high-gain form, and the plant is in its own coordinates"
    assert f"riccati.convergence: {why}; also original.order" in " ".join(" ".join(check(path)).split())


def test_a_form_whose_claims_are_printed_is_not_called_untried(tmp_path: Path) -> None:
    gains = "Q = [1, 1, 1], R = 1e-4, covariance = [1, 1, 1], dt = 0.01"
    filtered = f'observer = {{kind = "riccati", form = "original", {gains}}}\n{MIXER}'
    other, own = (" ".join(" ".join(check(written(tmp_path, text), "--all")).split()) for text in (MIXER, filtered))
    assert "original: not tried, since it may take seconds" in other
    assert "not tried, since it may take seconds" in own
    assert "original: not tried" not in own


def test_a_hidden_state_is_what_to_fix_and_no_observer_is_taken(tmp_path: Path) -> None:
    text = " ".join(" ".join(check(written(tmp_path, BLIND))).split())
    assert text.startswith("spring: d not observable; no high-gain form")
    assert "Kalman" not in text
    assert "fix first measure d as well" in text


def test_a_claim_is_printed_with_its_evidence() -> None:
    pendulum = str(MODELS / "pendulum.py")
    lines = check(pendulum, "--proof", "high_gain.convergence")
    assert lines[0].startswith("proved   high_gain.convergence: ")
    assert any(line.startswith("  P: [[") for line in lines)
    assert "did you mean high_gain.step" in " ".join(check(pendulum, "--proof", "high_gain.stp", status=2))


def test_no_coefficient_has_more_than_six_digits(tmp_path: Path) -> None:
    path = written(tmp_path, SPRING.replace("-h - h**3", "-h*(10/3.7)**20 - 1e-30*v - h**3/1234567 - 2000000*sin(h)"))
    text = " ".join(check(path, "--form", "triangular"))
    assert "z2' = -8.10001e-7*z1**3 - 4.32479e+8*z1 - z2/1e30 - 2000000*sin(z1)" in text


def test_a_form_is_printed_alone(tmp_path: Path) -> None:
    assert check(written(tmp_path, MIXER), "--form", "triangular")[0].startswith("mixer ")
    assert check(written(tmp_path, SPRING + OTHER), "--form", "uniform")[0].startswith("spring in uniform form: ")


def test_the_model_s_own_observer_is_kept_where_none_is_proved(tmp_path: Path) -> None:
    gains = "Q = [1, 1, 1], R = 1e-4, covariance = [1, 1, 1], dt = 0.01"
    other = f'tuning.riccati = {{form = "original", {gains}}}\n'
    path = written(tmp_path, f'observer = {{kind = "ukf", form = "original", {gains}}}\n{other}{MIXER}')
    assert any(
        line.startswith("take        ukf in the plant's own states, with the gains of the model")
        for line in check(path)
    )


def test_a_form_beside_another_question_does_not_hide_it(tmp_path: Path) -> None:
    """--form alone prints its claims; with a certificate, a claim or a range it is the form of the answer."""
    path, file = written(tmp_path, SPRING), tmp_path / "c.json"
    alone = check(path, "--form", "triangular")
    check(path, "--form", "triangular", "--certificate", str(file))
    assert '"hgogen certificate"' in file.read_text()
    proof = check(path, "--form", "triangular", "--proof", "triangular.structure")
    assert proof[0].startswith("proved   triangular.structure: ")
    assert len(proof) < len(alone)
    assert any(line.startswith("h**2") for line in check(path, "--form", "triangular", "--bound", "h**2"))


def test_latex_beside_json_is_refused(tmp_path: Path) -> None:
    text = " ".join(check(written(tmp_path, SPRING), "--latex", "--json", status=2))
    assert "prints LaTeX; ask for JSON by itself" in text


def test_the_model_s_gains_are_preferred_to_untried_ones_that_are_proved(tmp_path: Path) -> None:
    gains = "Q = {h = 1, v = 1}, noise = {y = 0.01}, covariance = {h = 1, v = 1}, dt = [0.001, 0.02]"
    own = f'observer = {{kind = "riccati", form = "original", {gains}}}\n{SPRING}'
    taken = "take riccati, the extended Kalman filter, in the plant's own states, with the gains of the model:"
    assert taken in words(own, tmp_path)
    other = f'tuning.nonlinear_filter = {{kind = "ukf", form = "original", {gains}}}\n{SPRING}'
    assert "take ukf in the plant's own states, with the gains of the model:" in words(other, tmp_path)


def test_a_tuning_of_any_observer_is_preferred_to_untried_gains() -> None:
    text = " ".join(check(str(MODELS / "lorenz.toml")))  # its other tunings accept what is refuted
    assert "take        kalman_like in state_affine form, with the gains of the model:" in text


def test_a_proposed_dt_is_one_that_the_step_advises(tmp_path: Path) -> None:
    flow = '"k*u - d*w - f*tanh(w/0.3)"'
    motor = f"""
name = "motor"
states.th = {{low = -600, high = 600, flow = "w"}}
states.w = {{low = -250, high = 250, flow = {flow}}}
inputs.u = {{low = -12, high = 12}}
outputs.angle = {{equation = "th"}}
outputs.tacho = {{equation = "w"}}
parameters.k = {{value = 15, low = 1, high = 200}}
parameters.d = {{value = 1, low = 0, high = 20}}
parameters.f = {{value = 1, low = 0, high = 100}}
"""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lines = check(written(tmp_path, motor), "--all")
    assert [line.endswith("dt = 0.00788}") for line in lines if line.startswith("  tuning.riccati = ")] == [True]


def words(text: str, folder: Path) -> str:
    """Return the answer to a model, with single spaces."""
    return " ".join(" ".join(check(written(folder, text))).split())
