"""Figures have room for what is written on them."""

import numpy as np
import pytest
from matplotlib import rc_context

from hgogen.run import figures

T = np.linspace(0, 1, 100)


def drawn(values: np.ndarray, meaning: str = "pressure"):
    with rc_context(figures.STYLE):
        figure, axes = figures.panels(1, T, "s")
        axes[0].plot(T, values)
        figures.caption(axes[0], "pressure", "Pa", meaning)
    return figure


@pytest.mark.parametrize("values", [101325 + 300 * T, 4e-4 * (T - 0.5)], ids=["pressure", "small"])
def test_the_label_of_a_panel_is_on_the_page_where_numbers_are_long(values):
    figure = drawn(values)
    figures.files("one", figure)
    assert figure.get_tightbbox().x0 >= 0


def test_a_figure_that_has_room_is_left_as_it_is():
    figure = drawn(T)
    before = figure.subplotpars.left
    figures.files("one", figure)
    assert figure.subplotpars.left == before


def test_a_long_meaning_ends_on_the_page():
    figure = drawn(T, "a long meaning that goes on " * 9)
    figures.files("one", figure)
    assert figure.get_tightbbox().x1 <= figure.get_figwidth()
    assert figure.axes[0].get_title(loc="left").endswith(" ..")
