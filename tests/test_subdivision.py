"""A box in cells: that they cover it, where it is cut, and when it is left alone."""

from fractions import Fraction

import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from hgogen.recheck.box import leaves
from hgogen.rigor.search import MOST, Ranges, subdivided

x, y = sp.symbols("x y")
BOX: Ranges = {x: (Fraction(-1), Fraction(3)), y: (Fraction(0), Fraction(1))}


def inverse(scale: float, cell: Ranges) -> Ranges | None:
    """The cell, where 1/(scale + x - y) has no pole as it is read: none where x - y may be -scale."""
    (low, _), (_, high) = cell[x], cell[y]
    return cell if low - high > -Fraction(scale) else None


@given(st.floats(2.01, 9))
def test_cells_are_those_of_their_tree_and_nothing_is_missing(scale: float) -> None:
    def weight(cell: Ranges) -> float:
        return float(1 / (Fraction(scale) + cell[x][0] - cell[y][1]))

    known = subdivided(BOX, lambda cell: inverse(scale, cell), weight)
    assert known is not None
    assert 1 <= len(known.cells) <= MOST
    written = leaves(known.tree, {str(name): side for name, side in BOX.items()})
    assert sorted(map(str, written)) == sorted(str({str(k): side for k, side in one.items()}) for one in known.cells)


def test_a_box_that_weighs_little_is_one_cell() -> None:
    known = subdivided(BOX, lambda cell: cell, lambda cell: 0.5)
    assert known is not None
    assert (known.cells, known.tree) == ((BOX,), ".")


def test_a_box_that_weighs_no_more_than_its_centre_is_one_cell() -> None:
    known = subdivided(BOX, lambda cell: cell, lambda cell: 100.0)
    assert known is not None
    assert known.tree == "."


def test_the_side_that_matters_is_cut_where_it_weighs_most() -> None:
    """Beyond x = 2 by its width there; that of y counts for nothing."""

    def weight(cell: Ranges) -> float:
        low, high = cell[x]
        return 1.0 + 20 * float(high - low) * (high > 2)

    known = subdivided(BOX, lambda cell: cell, weight)
    assert known is not None
    assert known.tree.split()[:5] == ["x", ".", "x", ".", "x"]
    assert "y" not in known.tree.split()


@pytest.mark.parametrize("pole", [Fraction(1), Fraction(1, 3)])
def test_where_nothing_is_known_of_a_point_there_are_no_cells(pole: Fraction) -> None:
    """At the centre of the box at once, elsewhere after so many cells."""
    asked = list[Ranges]()

    def known_on(cell: Ranges) -> Ranges | None:
        asked.append(cell)
        low, high = cell[x]
        return None if low <= pole <= high else cell

    assert subdivided(BOX, known_on, lambda cell: 0.0) is None
    assert (len(asked) == 2) is (pole == 1)
    assert len(asked) < 6 * MOST
