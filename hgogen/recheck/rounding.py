"""That the sizes of what a program rounds follow from its statements, which are those of the step (`program`).

How far it is from the step in its precision is computed where the plant is in its ranges and the error of each field
within a bound, in pieces of the ranges of the states that outputs show. All shares together are at most that bound: an
error that inputs alone made never leaves it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise, product
from typing import Any

from .arithmetic import Undefined, evaluate
from .box import End, NotShown
from .computed import POWER, PRECISIONS, UNITS, Computed, constant, precision
from .context import Context, short
from .file import column, part
from .inequality import Tableau
from .interval import Interval, between, intervals, point
from .plant_motion import demand_keys, demand_speeds
from .program import Equation, StepProgram, Walk, listed
from .uncertain import ErrorInclusion

_KEYS = ("between", "parameters", "precision", "speeds", "within", "program", "stages", "rates", "after")
_BETWEEN = ("line", "hold")
_PIECES = 32  # of the ranges of the states that outputs show
_NONE = Fraction(0)
Side = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class Rounded:
    """The program of a `step` in a `precision`; errors of samples at most `samples` (p), of fields in units of their
    states at most `within` (N), the plant moves by at most `moves` (n) in a call."""

    step: StepProgram
    precision: str
    samples: Sequence[Fraction]
    within: Sequence[Fraction]
    moves: Sequence[Fraction]

    def demand_sizes(self, sizes: Sequence[Fraction]) -> int:
        """That a call rounds the error of each field by at most h times its size (N); with how many pieces. Raises:
        `NotShown`."""
        pieces, beside = self._pieces, self.step.besides().statements
        for ranges in pieces:
            try:
                held, known = self._values(ranges), partial(constant, self.precision)
                walk = Walk(self.step.program, held, precision(self.precision), beside, known)
                errors = [walk.value(operand).error for operand in self.step.program.after]
            except Undefined as error:
                raise NotShown(f"how far its program rounds is not known: {error}") from None
            for beside_step, size, unit in zip(errors, sizes, self.step.equation.units, strict=True):
                if not (point(abs(unit)) * beside_step).at_most(size * self.step.h):
                    raise NotShown("a size of its rounding is less than how far its program is from the step")
        return len(pieces)

    @property
    def _pieces(self) -> list[tuple[Side, ...]]:
        """The ranges (n) of the states, those that outputs show in pieces."""
        context = self.step.equation.context
        heads, sides = {z for z in context.seen if z}, list[list[Side]]()
        count = round(_PIECES ** (1 / max(1, len(heads))))
        for z in context.z:
            low, high = _finite(context.form.box[z])
            parts = count if z in heads else 1
            sides.append(list(pairwise(low + (high - low) * Fraction(part, parts) for part in range(parts + 1))))
        return list(product(*sides))

    def _values(self, ranges: Sequence[Side]) -> dict[str, Computed]:
        """What the program reads while the plant is in these ranges at the beginning of a call."""
        equation, context, values = self.step.equation, self.step.equation.context, dict[str, Interval]()
        known = zip(equation.units, equation.scales, equation.error.index, equation.error.fed, self.within, strict=True)
        for k, (unit, scale, i, fed, error) in enumerate(known, 1):
            low, high = ranges[i] if fed else (_NONE, _NONE)
            values[f"x{k}"] = point(scale / unit) * between(low - error, high + error)
        for j, most in enumerate(self.samples):
            seen = self._sample(j, ranges) + between(-most, most)
            values |= dict.fromkeys((f"y{j + 1}_last", f"y{j + 1}"), seen)
        for j, name in enumerate(context.file.inputs, 1):
            values |= dict.fromkeys((f"u{j}_last", f"u{j}"), between(*_finite(context.form.box[name])))
        return {name: Computed(self.precision, value) for name, value in values.items()}

    def _sample(self, output: int, ranges: Sequence[Side]) -> Interval:
        """The range of an output, from the beginning of a call to its end."""
        context = self.step.equation.context
        moved = zip(context.z, ranges, self.moves, strict=True)
        box = {**context.form.box, **{z: (low - move, high + move) for z, (low, high), move in moved}}
        text = context.form.output[output]
        value: Interval = evaluate(text, {name: between(*box[name]) for name in text.names}, intervals)
        return value


def demand_rounding(
    equation: Equation,
    tableau: Tableau,
    h: Fraction,
    share: Mapping[str, Any],
    shares: Mapping[str, Mapping[str, Any]],
    totals: Sequence[Fraction],
) -> tuple[str, int]:
    """That the sizes of a share are those of its program, beside all `shares` which come to `totals` (N) in the units
    of the fields' states; what it assumes, in words, and with how many boxes. Raises: `NotShown`."""
    follows, context = share["follows"], equation.context
    n, count, p = len(context.z), len(totals), len(context.form.output)
    errors, speeds = column(follows, "within", count), column(follows, "speeds", n)
    if any(error < total for error, total in zip(errors, totals, strict=True)):
        raise NotShown("the errors within which its program rounds are less than what all shares come to")
    boxes = demand_speeds(context, speeds)
    beside = [column(each, "beside", n) for each in shares.values() if each["beside"] != []]
    moves = [h * (speed + sum(each, _NONE)) for speed, *each in zip(speeds, *beside, strict=True)]
    noisy = [column(each, "samples", p) for each in shares.values() if each["samples"] != []]
    samples = [sum(each, _NONE) for each in zip(*noisy, strict=True)] or [_NONE] * p
    program = listed(follows, count, len(tableau.weights))
    step = StepProgram(equation, tableau, h, program, _between(context, follows, shares))
    rounded = Rounded(step, _one_of(follows, "precision", PRECISIONS), samples, errors, moves)
    boxes += rounded.demand_sizes(column(share, "fields", count))
    return _said(rounded), boxes


def equation_of(context: Context, error: ErrorInclusion, theta: Fraction, follows: Mapping[str, Any]) -> Equation:
    """The equation of the observer whose program is listed. Raises: `NotShown`."""
    demand_keys(follows, _KEYS, "its rounding")
    return Equation(context, error, theta, parameters_of(context, follows))


def parameters_of(context: Context, follows: Mapping[str, Any]) -> dict[str, Fraction]:
    """The plant's parameters as the program has them, each in its range. Raises: `NotShown`."""
    names = context.file.parameters
    values = dict(zip(names, column(follows, "parameters", len(names)), strict=True))
    for name, value in values.items():
        low, high = context.form.box[name]
        if not low <= value <= high:
            raise NotShown(f"its program has {name} = {value}, outside the model's range")
    return values


def _between(context: Context, follows: Mapping[str, Any], shares: Mapping[str, Mapping[str, Any]]) -> str:
    """How its program has inputs between two samples: held where none moves. Raises: `NotShown`."""
    between, motion = _one_of(follows, "between", _BETWEEN), shares.get("method", {}).get("follows", {})
    rates = column(motion, "rates", len(context.file.inputs)) if "rates" in motion else []
    if between == "hold" and any(rates):
        raise NotShown("its program holds inputs that move")
    return between


def _said(rounded: Rounded) -> str:
    words = {word for word, _ in rounded.step.program.statements}
    functions = [f"{name} errs by at most {units / 2} ulps" for name, units in UNITS.items() if name in words]
    functions += [f"x^k by {POWER[0] / 2} and {POWER[1] / 2} more for each |k log x|"] if "pow" in words else []
    taken = f", where {', '.join(functions)}" if functions else ""
    equation, count = rounded.step.equation, len(rounded.step.program.statements)
    each = zip(equation.context.z, equation.error.picks, strict=True)
    errs = ", ".join(f"{short(rounded.within[k], -1)} in {z}" for z, k in each)
    return f"what {count} operations in {rounded.precision} round while the estimate errs by at most {errs}{taken}"


def _one_of(follows: Mapping[str, Any], key: str, known: Sequence[str]) -> str:
    value: str = part(follows, key, str)
    if value not in known:
        raise NotShown(f"its {key} is none of {', '.join(known)}")
    return value


def _finite(side: tuple[End, End]) -> Side:
    low, high = side
    if not (isinstance(low, Fraction) and isinstance(high, Fraction)):
        raise NotShown("a state or an input has no range")
    return low, high
