"""A record replayed in float, as the firmware computes, and how far it is from double."""

import json
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen
from test_mapped import RUN, record

import hgogen as hg
from hgogen.run.comparison import differences, precision_warnings
from hgogen.run.samples import Run

STATES = (hg.Signal("p", low=0, high=4), hg.Signal("v", "m/s"))


def run(x: np.ndarray, status: np.ndarray | None = None) -> Run:
    status = np.zeros(len(x), np.uint32) if status is None else status
    return Run(np.arange(len(x)) * 0.1, x, ("p", "v"), {}, status, "c")


def test_a_difference_is_a_share_of_the_range_or_of_the_peak() -> None:
    double = np.array([[1.0, 2.0], [1.0, -8.0], [1.0, 1.0]])
    single = double + np.array([[0, 0], [0, 0.004], [-0.01, 0]])
    p, v = differences(STATES, run(single, np.array([0, 0, 1], np.uint32)), run(double))
    assert (p.largest, p.t, p.share, p.of) == (pytest.approx(0.01), pytest.approx(0.2), pytest.approx(0.0025), "range")
    assert (v.largest, v.t, v.share, v.of) == (pytest.approx(0.004), pytest.approx(0.1), pytest.approx(0.0005), "peak")
    said = list(precision_warnings((p, v), "s"))
    assert said[0].startswith("in float, p is 0.0025 of its range from double at 0.2 s")
    assert said[1] == "in float, samples whose status is another than in double: 1"
    assert len(said) == 2


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_run_says_how_far_float_is_from_double(tmp_path: Path) -> None:
    """A float has 24 bits: over a contracting observer of some 100 operations a sample an estimate of 1 rad is within
    1e-4 of 8 rad, and not the same. The estimates in float are those of the step in float."""
    words = ("run", "pendulum", "--data", record(tmp_path), *RUN[:-1], "-o", str(tmp_path), "--observer", "riccati")
    answer = json.loads(hgogen(*words, "--real", "float", "--json")[0])
    assert answer["real"] == "float"
    assert [(one["state"], one["of"]) for one in answer["from_double"]] == [("q", "range"), ("w", "range")]
    assert all(0 < one["share"] < 1e-4 for one in answer["from_double"])
    single = np.genfromtxt(tmp_path / "log_estimates.csv", delimiter=",", names=True)
    shown = hgogen(*words, "--real", "float")[0]
    assert "as the firmware computes" in shown
    answer = json.loads(hgogen(*words, "--json")[0])
    assert (answer["real"], answer["from_double"]) == ("double", [])
    double = np.genfromtxt(tmp_path / "log_estimates.csv", delimiter=",", names=True)
    assert 0 < np.abs(single["q"] - double["q"]).max() < 1e-4 * 8
