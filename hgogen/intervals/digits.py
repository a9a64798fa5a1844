"""Numbers in few digits: a bound that is printed as proved is rounded to the safe side, a gain reads back as it is."""

import math
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from typing import ClassVar

MOST = 17  # digits in which any two floats differ


def up(value: float | Fraction, digits: int = 4, below: float | Fraction = math.inf) -> str:
    """The least number of so many significant digits that is not below the value; of a value that is `below` another,
    of as many more as keep it there, up to `MOST`."""
    while True:
        text = _rounded(value, digits, ROUND_CEILING)
        if digits >= MOST or not value < below or Decimal(text) < Decimal(same(float(below))):
            return text
        digits += 1


def down(value: float | Fraction, digits: int = 4) -> str:
    """The largest number of so many significant digits that is not above the value."""
    return _rounded(value, digits, ROUND_FLOOR)


def same(value: float) -> str:
    """A float as text that reads back as the same: in six digits where they do, else in as many as it takes."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


@dataclass(frozen=True)
class Up:
    """A number that `up` writes."""

    value: float | Fraction
    digits: int = 4
    below: float | Fraction = math.inf
    direction: ClassVar[str] = "up"

    def __str__(self) -> str:
        return up(self.value, self.digits, self.below)


@dataclass(frozen=True)
class Down:
    """A number that `down` writes."""

    value: float | Fraction
    digits: int = 4
    direction: ClassVar[str] = "down"

    def __str__(self) -> str:
        return down(self.value, self.digits)


def _rounded(value: float | Fraction, digits: int, rounding: str) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value:g}"
    exact = Fraction(value)
    rounded = Context(prec=digits, rounding=rounding).divide(Decimal(exact.numerator), Decimal(exact.denominator))
    plain = -4 <= rounded.adjusted() < digits  # as float's g: 0.0001, 1e-05
    return f"{rounded.normalize():f}" if plain or not rounded else f"{rounded.normalize():e}"
