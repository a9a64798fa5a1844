"""Figures of the papers: what is drawn in them, of numbers that are known."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hgogen.estimators.theta import logistic, smoothstep
from hgogen.run.figures import svg

sys.path.append(str(Path(__file__).parent.parent / "docs"))
import paper_panels as drawn

INSIDE = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3, -1 + 0.2j, -1 - 0.2j, -0.1, -0.4)
OUTSIDE = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3, -1 + 0.6j, -1 - 0.6j, -0.1, -0.4)


def lines(figure: drawn.Figure) -> dict[str, np.ndarray]:
    """The lines (2, k) by their names."""
    (axis,) = figure.axes
    return {str(line.get_label()): np.array(line.get_data(), dtype=float) for line in axis.get_lines()}


def test_poles_and_the_eigenvalues_of_the_filtered_core() -> None:
    """Two poles outside of the parabola make two eigenvalues unstable; all are symmetric about -.05."""
    good, bad = (lines(drawn.poles(poles, 0.1, 0.1)) for poles in (INSIDE, OUTSIDE))
    assert good["inside"].shape == (2, 8)
    assert sorted(bad["outside"][1]) == [-0.6, 0.6]
    good, bad = (lines(drawn.core(poles, 0.1, 0.1)) for poles in (INSIDE, OUTSIDE))
    assert good["stable"].shape == (2, 16)
    assert bad["unstable"][0] == pytest.approx([0.0421480641] * 2, abs=1e-9)
    assert np.sort(good["stable"][0]) == pytest.approx(-0.1 - np.sort(good["stable"][0])[::-1], abs=1e-9)


def test_the_course_of_mu() -> None:
    known = lines(drawn.share({"smooth": smoothstep(0.16, 0.32), "steep": logistic(0.16, 500)}, 0.48, "y^2 s"))
    at, smooth = known["smooth"]
    assert (smooth[at <= 0.16] == 0).all()
    assert (smooth[at >= 0.32] == 1).all()
    assert np.interp(0.24, at, smooth) == pytest.approx(0.5, abs=1e-4)
    assert np.interp(0.16, *known["steep"]) == pytest.approx(0.5, abs=1e-2)


def test_the_members_of_a_bank_restart_by_turns() -> None:
    """At 35 one of three is 5 old, the next 15, the last 25: theta = 1 + 7 exp(-age/10)."""
    (axis,) = drawn.thetas(8.0, 0.1, 3, 10.0, 60.0, "s").axes
    values = sorted(float(np.interp(35, *line.get_data())) for line in axis.get_lines()[:3])
    assert values == pytest.approx(sorted(1 + 7 * np.exp(-np.array([5, 15, 25]) / 10)), rel=1e-3)


def test_sizes_of_errors_and_the_same_bytes() -> None:
    t = np.linspace(0, 1, 50)
    figure = drawn.sizes(t, {"one": np.stack([3 * t, 4 * t], axis=1)}, "s")
    assert lines(figure)["one"][1] == pytest.approx(5 * t)
    again = drawn.sizes(t, {"one": np.stack([3 * t, 4 * t], axis=1)}, "s")
    assert svg(figure) == svg(again)
