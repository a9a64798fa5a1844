"""Angles: the change of an expression over one turn of a name, exactly.

A turn is r + s pi, r and s fractions. If the flow is the same a turn later, and each output changes by whole periods of
its own, the equations hold on the whole line, and the slopes of a row there are those on one turn: a range that spans a
turn stands for the line. The samples of a periodic output are known but for turns, so that an injected error is right
while it is below half a turn.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

from .arithmetic import Unproved
from .box import Box
from .interval import intervals, point
from .text import Expression, Instruction, expression


class Turn(NamedTuple):
    """A number `whole` + `pis` pi with rational `whole` and `pis`, such as a period of an angle."""

    whole: Fraction = Fraction(0)
    pis: Fraction = Fraction(0)

    def __add__(self, other: object) -> "Turn":
        """Return the sum of two such numbers."""
        assert isinstance(other, Turn)
        return Turn(self.whole + other.whole, self.pis + other.pis)

    def times(self, factor: "Turn") -> "Turn":
        """Return the product of two such numbers. Raises: `Unproved` for a multiple of pi squared."""
        if self.pis and factor.pis:
            raise Unproved("a multiple of pi squared is no turn")
        return Turn(self.whole * factor.whole, self.whole * factor.pis + self.pis * factor.whole)

    @property
    def ends(self) -> tuple[Fraction, Fraction]:
        """A lower and an upper bound of the number."""
        low, high = (point(self.whole) + intervals.function("pi", ()) * point(self.pis)).exactly
        return Fraction(low), Fraction(high)

    def whole_periods(self, period: "Turn | None") -> bool:
        """Return whether the number is a whole multiple of a period; without a period, whether it is 0."""
        if period is None:
            return not any(self)
        count = self.pis / period.pis if period.pis else self.whole / period.whole
        return count.denominator == 1 and self == Turn(count * period.whole, count * period.pis)


_NOTHING, _MINUS = Turn(), Turn(Fraction(-1))
Turns = Mapping[str, Turn]
NO_BOX: Box = {}


def turn(text: object) -> Turn:
    """Return the positive number r + s pi of a text such as "2*pi" or "360". Raises: `Unproved`, `Unreadable`."""
    read = expression(text, ())
    value = _values(read)[read.result]
    if value is None or not value.ends[0] > 0:
        raise Unproved(f"the period {read.text} is no positive number")
    return value


def advance(text: Expression, name: str, period: Turn, box: Box = NO_BOX) -> Turn:
    """Return the change of an expression when `name` advances by one `period`, for all values in `box`; a name whose
    range is one point is a number. Raises: `Unproved` if the change is not proved to be constant."""
    known, changes = _values(text, box), list[Turn]()
    for step in text.instructions:
        if step.op == "symbol":
            changes.append(period if step.value == name else _NOTHING)
        else:
            changes.append(_advance(step, [changes[k] for k in step.args], [known[k] for k in step.args], text))
    return changes[text.result]


def _values(text: Expression, box: Box = NO_BOX) -> list[Turn | None]:
    """Return the value of each instruction that is a number r + s pi, None for the other instructions."""
    values = list[Turn | None]()
    for step in text.instructions:
        args = [value for k in step.args if (value := values[k]) is not None]
        if step.op == "number":
            values.append(Turn(Fraction(step.value or 0)))
        elif step.op == "symbol":
            low, high = box.get(str(step.value), (0, 1))
            values.append(Turn(Fraction(low)) if low == high else None)
        else:
            values.append(_value(step.op, args) if len(args) == len(step.args) else None)
    return values


def _value(op: str, args: Sequence[Turn]) -> Turn | None:
    match op, len(args):
        case "pi", 0:
            return Turn(pis=Fraction(1))
        case "neg", 1:
            return args[0].times(_MINUS)
        case (("add" | "sub"), 2):
            return args[0] + (args[1].times(_MINUS) if op == "sub" else args[1])
        case "mul", 2 if not (args[0].pis and args[1].pis):
            return args[0].times(args[1])
        case "div", 2 if args[1].whole and not args[1].pis:
            return args[0].times(Turn(1 / args[1].whole))
    return None


def _advance(step: Instruction, changes: Sequence[Turn], known: Sequence[Turn | None], text: Expression) -> Turn:
    if not any(map(any, changes)):
        return _NOTHING
    change, least = None, {"sin": 2, "cos": 2, "tan": 1}.get(step.op)
    if step.op in ("add", "sub", "neg"):
        change = _value(step.op, changes)
    elif step.op in ("mul", "div") and (factor := known[1]) is not None:
        change = _value(step.op, (changes[0], factor))
    elif step.op == "mul" and (factor := known[0]) is not None:
        change = _value(step.op, (factor, changes[1]))
    elif least and not changes[0].whole and (changes[0].pis / least).denominator == 1:
        change = _NOTHING
    if change is None:
        raise Unproved(f"{text.text[:60]} is not shown to be periodic")
    return change


def demand_periodic(rows: Iterable[tuple[Expression, Turn | None]], turns: Turns, box: Box) -> None:
    """Demand that each row changes by a whole multiple of its own period (None: not at all) when any name of `turns`
    advances by a turn, and that the range of each name spans a turn. Raises: `Unproved`."""
    each = list(rows)
    for name, period in turns.items():
        low, high = box[name]
        if not high - low >= period.ends[1]:
            raise Unproved(f"the range of {name} does not span a turn")
        for row, own in each:
            if name in row.names and not advance(row, name, period, box).whole_periods(own):
                raise Unproved(f"{row.text[:60]} is not the same a turn of {name} later")
