"""Signals of a log as expressions of its columns; the estimate's start, its burn-in and its truth in `run`."""

import json
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.logs.records import range_warnings
from hgogen.reading.log import BadRecord, column_of, table

LOG = "t,T1,Current(A),a b,rpm\n0,1,2,3,60\n1,2,,4,120\n2,3,4,x,180\n3,4,5,6,240\n"
NAN = np.nan


@pytest.fixture
def log(tmp_path: Path) -> Path:
    (tmp_path / "log.csv").write_text(LOG)
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("T1", [1, 2, 3, 4]),
        ("Current(A)", [2, NAN, 4, 5]),
        ("T1 + 273.15", [274.15, 275.15, 276.15, 277.15]),
        ("-[Current(A)]", [-2, NAN, -4, -5]),
        ("[a b]*T1", [3, 8, NAN, 24]),
        ("2*pi/60*rpm", [2 * np.pi, 4 * np.pi, 6 * np.pi, 8 * np.pi]),
        ("log(T1 - 1)", [NAN, 0, np.log(2), np.log(3)]),
        ("T1 + 0*[Current(A)]", [1, NAN, 3, 4]),  # what is read is missing, though SymPy folds it away
        ("Max(T1, 2)", [2, 2, 3, 4]),
    ],
)
def test_a_signal_is_an_expression_of_columns(log: Path, text: str, values: list[float]) -> None:
    assert column_of(table(log), text).values == pytest.approx(values, nan_ok=True)


def test_an_empty_cell_is_told_from_one_that_is_no_number(log: Path) -> None:
    empty, word = column_of(table(log), "2*[Current(A)]"), column_of(table(log), "2*[a b]")
    assert (empty.empty, empty.not_numbers) == (1, 0)
    assert (word.empty, word.not_numbers, word.example) == (0, 1, "x")
    both = column_of(table(log), "[Current(A)] + [a b]")  # one row has an empty cell, another the word
    assert (both.empty, both.not_numbers, both.example) == (1, 1, "x")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("T9", "has no column 'T9'"),
        ("T9 + 1", r"the name 'T9' is not declared; did you mean T1\?; its columns are t, T1, \[Current\(A\)\]"),
        ("[x] + 1", "has no column 'x'"),
        ("3*2", "reads no column"),
        ("T1/0", "divides by zero"),
        ("T1 + [", "is not in the grammar"),
        ("__import__('os') + T1", "not in the grammar|not declared"),
    ],
)
def test_a_bad_expression_is_refused(log: Path, text: str, reason: str) -> None:
    with pytest.raises(BadRecord, match=reason):
        column_of(table(log), text)


def record(folder: Path, offset: float = 0.0) -> str:
    """A pendulum at rest at 1 rad, its angle in degrees, the rate beside it; nothing moves it but the model."""
    t = np.arange(400) * 0.01
    q = np.exp(-0.05 * t) * np.cos(4.3 * t)
    w = np.gradient(q, 0.01)
    rows = "\n".join(f"{a:.4f},{np.degrees(b) + offset:.9f},{c:.9f},0" for a, b, c in zip(t, q, w, strict=True))
    (folder / "log.csv").write_text(f"t,angle (deg),rate,tau\n{rows}\n")
    return str(folder / "log.csv")


RUN = ("--time", "t", "--dt", "0.01", "--map", "y=pi/180*[angle (deg)]", "--json")


@pytest.mark.usefixtures("undrawn")
def test_the_estimate_starts_from_the_first_sample(tmp_path: Path) -> None:
    out = ("-o", str(tmp_path))
    own = json.loads(hgogen("run", "pendulum", "--data", record(tmp_path), *RUN, *out)[0])
    assert own["initial"]["q"] == pytest.approx(1.0)
    whys = {name: one["why"] for name, one in own["begins"].items()}
    assert whys == {"q": "its first sample", "w": "what the first samples imply"}  # it moves
    assert own["record"]["columns"]["y"] == "pi/180*[angle (deg)]"
    rows = (tmp_path / "log_estimates.csv").read_text().splitlines()
    assert float(rows[1].split(",")[2]) == pytest.approx(1.0, abs=0.02)  # q after the first sample
    moved = json.loads(hgogen("run", "pendulum", "--data", record(tmp_path), *RUN, *out, "--initial", "q=-1,w=2")[0])
    assert moved["initial"] == {"q": -1.0, "w": 2.0}
    rows = (tmp_path / "log_estimates.csv").read_text().splitlines()
    assert float(rows[1].split(",")[2]) < 0


@pytest.mark.usefixtures("undrawn")
def test_the_estimate_starts_within_the_range_of_the_state(tmp_path: Path) -> None:
    far = record(tmp_path, offset=400)  # the first sample is 1 rad and 400 degrees, the range of q ends at 4 rad
    assert json.loads(hgogen("run", "pendulum", "--data", far, *RUN, "-o", str(tmp_path))[0])["initial"] == {"q": 4.0}


@pytest.mark.full
def test_the_truth_and_the_burn_in(tmp_path: Path) -> None:
    out, truth = ("-o", str(tmp_path)), ("--truth", "w=rate")
    whole, late = (
        json.loads(hgogen("run", "pendulum", "--data", record(tmp_path), *RUN, *out, *truth, "--burn-in", each)[0])
        for each in ("0", "1")
    )
    assert late["hidden"]["w"] < whole["hidden"]["w"]
    estimates = np.genfromtxt(tmp_path / "log_estimates.csv", delimiter=",", names=True)
    rate = np.genfromtxt(tmp_path / "log.csv", delimiter=",", skip_header=1)[:, 2]
    assert late["hidden"]["w"] == pytest.approx(np.sqrt(np.mean((estimates["w"] - rate)[100:] ** 2)), rel=1e-6)
    assert whole["predictions"][0]["count"] - late["predictions"][0]["count"] == 100


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--truth", "v=rate"), "must read STATE=COLUMN; the states are q, w"),
        (("--truth", "w=speed"), "has no column 'speed'"),
        (("--initial", "q"), "must read NAME=NUMBER"),
        (("--initial", "v=1"), "v"),
        (("--burn-in", "9"), "leaves nothing of a log of 3.99 s"),
        (("--burn-in", "inf"), "inf s leaves nothing of a log of 3.99 s"),
    ],
)
def test_bad_words_are_refused(words: tuple[str, str], reason: str, tmp_path: Path) -> None:
    _, said = hgogen("run", "pendulum", "--data", record(tmp_path), *RUN, "-o", str(tmp_path), *words, status=2)
    assert reason in " ".join(said.replace("│", "").split())


@pytest.mark.full
def test_a_record_beyond_the_declared_range_is_said(tmp_path: Path) -> None:
    """By a fit and by a tuning; 1 rad and its motion about it, shifted by 180 degrees, leave -4 .. 4."""
    data = ("--data", record(tmp_path, offset=180.0), *RUN[:2], *RUN[4:], "-o", str(tmp_path))
    said = f"y leaves the declared range of q, -4..4, in {{}} of 400 samples, as far as {1 + np.pi:.4g}: "
    t = np.arange(400) * 0.01
    count = int(np.sum(np.exp(-0.05 * t) * np.cos(4.3 * t) + np.pi > 4))
    for words in (("fit", "--free", "a", "--starts", "1"), ("tune", "--observers", "high_gain")):
        report = json.loads(hgogen(words[0], "pendulum", *data, *words[1:])[0])
        assert report["notes"][0].startswith(said.format(count)), words


def test_the_farthest_sample_is_that_farthest_from_the_range() -> None:
    """Not the largest: of a range from 100 to 110, 90 is farther than 112."""
    x = hg.Signal("x", low=100, high=110)
    plant = hg.System("warm", states=(x,), outputs=(hg.Signal("y"),), flow=[0 * x], output=[x])
    (said,) = range_warnings(plant, hg.Log(np.zeros((3, 0)), np.array([[105.0], [90.0], [112.0]]), 0.1))
    assert "in 2 of 3 samples, as far as 90:" in said
