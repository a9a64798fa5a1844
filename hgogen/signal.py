"""A signal: a SymPy symbol with a unit, a meaning, a nominal value and a range.

One declaration of the range serves proof assumptions, clamping, the C comment and test sampling.

A model's unit of time is a plain word, "s" unless its System declares another. Rates, periods, trials and gains are all
in this unit, and nothing is converted. Reports and firmware name it, and give a known unit in seconds as well.
"""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import sympy as sp

from hgogen.errors import BadArgument, HgogenError
from hgogen.sentence import same

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_DOTS = ("", "_dot", "_ddot", "_dddot")
_WORD = re.compile(r"[A-Za-z]{1,12}\Z")
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_PLURAL = {"us": "microseconds", "ms": "milliseconds", "s": "seconds", "min": "minutes", "h": "hours", "d": "days"}
HIGHEST = 60  # order of a derivative: a form reads derivatives of an order below its number of states
LONGEST = 63  # characters of a signal's name, which C99 guarantees to be significant
TURNS = 2**10  # up to so many turns off, an angle is brought back to its own
LOST = 1e30  # a value of the state beyond it, or none at all, is lost; no range and no gain goes beyond it


@dataclass(eq=False)
class BadName(HgogenError):
    """The error for the name of a signal or a system that no C compiler would accept as a member name."""

    name: str
    reason: str
    text = "the name {name!r} {reason}; choose another, letters and digits, such as {self.hint!r}"

    @property
    def hint(self) -> str:
        """A valid name similar to the invalid one."""
        cleaned = re.sub(r"[\W_]+", "_", str(self.name), flags=re.ASCII).strip("_")
        named = cleaned if cleaned[:1].isalpha() else f"x_{cleaned or 1}"
        named = named[: LONGEST // 2].rstrip("_") if len(named) > LONGEST else named
        return f"{named}_1" if named == self.name else named


class BadRange(BadArgument):
    """The error for a range with exchanged ends, or a value that is not a finite number or lies outside its range."""

    text = "signal {what!r}: {reason}"


def check_name(name: str) -> None:
    """Raise `BadName` unless `name` is an ASCII identifier. A keyword of C is renamed in the emitted code."""
    if not isinstance(name, str) or not _IDENTIFIER.match(name):
        raise BadName(str(name), "is not an identifier (a letter, then letters, digits and underscores)")
    if "__" in name:
        raise BadName(name, "has a double underscore, which C++ reserves")


def _number(name: str, what: str, value: Any) -> float | None:
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise BadRange(name, f"{what} = {value!r} is not a number; give a number or leave it out") from None
    if not math.isfinite(number):
        raise BadRange(name, f"{what} = {number} is not finite; give a finite number or leave it out")
    return number


Ends = tuple[float | None, float | None]


def _range(name: str, low: Any, high: Any, names: tuple[str, str] = ("low", "high")) -> Ends:
    low, high = (_number(name, what, value) for what, value in zip(names, (low, high), strict=True))
    if (low is None) != (high is None):
        raise BadRange(name, "has only one end of a range; give both low and high, or neither")
    if low is not None and high is not None and not low < high:
        raise BadRange(name, f"{names[0]} = {low:g} is not below {names[1]} = {high:g}; swap or widen them")
    for what, end in zip(names, (low, high), strict=True):
        if end is not None and abs(end) > LOST:
            raise BadRange(name, f"{what} = {end} is beyond {LOST:g}; give it in another unit, or leave it out")
    return low, high


def _rates(name: str, rates: Any) -> tuple[tuple[float, float], ...]:
    fix = "rates is a pair for each derivative, such as rates=((-1, 1), (-2, 2))"
    if isinstance(rates, str) or not isinstance(rates, Iterable):
        raise BadRange(name, f"rates = {rates!r} is no list of ranges; {fix}")
    result = []
    for k, pair in enumerate(rates, 1):
        if isinstance(pair, str) or not isinstance(pair, Iterable) or len(pair := tuple(pair)) != 2:
            raise BadRange(name, f"rate {k} is {pair!r}, no pair of numbers; {fix}")
        low, high = _range(name, pair[0], pair[1], (f"low end of rate {k}", f"high end of rate {k}"))
        if low is None or high is None:
            raise BadRange(name, f"rate {k} is {pair!r}, no pair of numbers; {fix}")
        result.append((low, high))
    return tuple(result)


def _turn(name: str, period: float | None, ends: Ends) -> Ends:
    if period is None:
        return ends
    if not 0 < period <= LOST:
        raise BadRange(name, f"period = {period:g} is no turn; give a positive number, such as 2*pi for radians")
    low, high = ends
    if low is None or high is None:
        return -period / 2, period / 2
    if abs(high - low - period) > 1e-9 * period:
        way = "leave them out, or leave out period for an angle that stays in its range"
        raise BadRange(name, f"low and high span {high - low:g}, and period = {period:g} is one turn; {way}")
    return low, low + period


def _short_way(difference: Any, period: float | None) -> Any:
    if period is None:
        return difference
    within = np.fmod(difference, period)  # exact, in (-period, period)
    return within - period * np.floor(within / period + 0.5)


class Signal(sp.Symbol):  # type: ignore[misc]
    """A real symbol with its engineering data.

    Args: `name`, a C identifier; `unit` and `meaning`, free text for reports and C comments; `nominal`, a
    parameter's value or an input's value before the first sample; `low`, `high`, the closed range, both or
    neither, with ends within 1e30. A signal without a range is never clamped. A parameter with a range can be tuned at
    run time, one without is folded into the code. `rates`: closed ranges of an input's derivatives, the first
    derivative's first, for the forms into which they enter; of a state, the range of a valid
    rate where the plant may have no finite one (`analysis.dynamics`). `period`: one turn of an angle, such as 2*pi or
    360: values that differ by whole turns are equal, differences are taken the shorter way, and values are reported
    from `low` to `high`, one turn, by default from -period/2 to period/2. A latitude or an elevation ends at its poles
    and has no period.

    Raises: `BadName`, `BadRange`.

    Signals of equal name but different data are different symbols (SymPy's cache, which would return the
    first, is bypassed), and signals pickle.
    """

    __slots__ = ("_content", "high", "low", "meaning", "nominal", "period", "rates", "unit")

    unit: str
    meaning: str
    nominal: float | None
    low: float | None
    high: float | None
    rates: tuple[tuple[float, float], ...]
    period: float | None
    _content: tuple[Any, ...]

    def __new__(
        cls,
        name: str,
        unit: str = "",
        meaning: str = "",
        nominal: Any = None,
        low: Any = None,
        high: Any = None,
        rates: Any = (),
        period: Any = None,
    ) -> "Signal":
        check_name(name)
        if len(name) > LONGEST:
            raise BadName(name, f"has {len(name)} characters, and C distinguishes names by {LONGEST}")
        for what, text in (("unit", unit), ("meaning", meaning)):
            if not isinstance(text, str):
                raise BadRange(name, f"{what} = {text!r} is not text; numbers go to nominal=, low=, high=")
        nominal = _number(name, "nominal", nominal)
        period = _number(name, "period", period)
        low, high = _turn(name, period, _range(name, low, high))
        if nominal is not None and low is not None and high is not None and not low <= nominal <= high:
            raise BadRange(name, f"nominal = {nominal:g} lies outside [{low:g}, {high:g}]; widen it")
        signal: Signal = sp.Symbol.__xnew__(cls, name, real=True)
        signal.unit, signal.meaning = str(unit), str(meaning)
        signal.nominal, signal.low, signal.high = nominal, low, high
        signal.rates, signal.period = _rates(name, rates), period
        data = (signal.unit, signal.meaning, signal.nominal, signal.low, signal.high, signal.rates, signal.period)
        signal._content = (*super()._hashable_content(signal), *map(str, data))
        return signal

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing: `__new__` has set the data, and SymPy's base class accepts no arguments here."""

    def _hashable_content(self) -> tuple[Any, ...]:
        return self._content  # needed by SymPy for each comparison

    def __getnewargs_ex__(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        data = (self.unit, self.meaning, self.nominal, self.low, self.high, self.rates, self.period)
        return (self.name, *data), {}

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return Signal, self.__getnewargs_ex__()[0]

    @property
    def bounded(self) -> bool:
        """Whether a range was declared."""
        return self.low is not None

    @property
    def interval(self) -> tuple[float, float]:
        """The closed range; (-inf, inf) where none was declared."""
        if self.low is None or self.high is None:
            return -math.inf, math.inf
        return self.low, self.high

    @property
    def limits(self) -> tuple[float, float]:
        """The range to which a value is clamped: the closed range; (-inf, inf) for a periodic signal, which is
        wrapped."""
        return self.interval if self.period is None else (-math.inf, math.inf)

    def difference(self, values: Any, reference: Any) -> Any:
        """The difference values - reference (arrays of any shape), of a periodic signal the short way round."""
        return _short_way(np.subtract(values, reference), self.period)

    def turned(self, values: Any) -> Any:
        """The values (an array of any shape); those of a periodic signal are wrapped to its range, from low to high."""
        if self.period is None:
            return values
        middle = math.fsum(self.interval) / 2
        return middle + _short_way(np.subtract(values, middle), self.period)

    def reduced(self, values: Any) -> Any:
        """Return samples (array of any shape), those of a periodic signal wrapped to its range; NaN beyond `TURNS`
        turns, where a step rejects a sample."""
        if self.period is None:
            return values
        far = np.abs(np.subtract(values, math.fsum(self.interval) / 2)) > (TURNS + 0.5) * self.period
        return self.turned(np.where(far, np.nan, values))

    def nearest(self, values: Any, reference: Any) -> Any:
        """Return the values (arrays of any shape); those of a periodic signal are shifted by the whole turns that bring
        them nearest to the reference."""
        return values if self.period is None else reference + self.difference(values, reference)

    def unwrapped(self, values: np.ndarray) -> np.ndarray:
        """Return the values (N,) over time; those of a periodic signal are unwrapped: no step exceeds half a turn. NaN
        where a value is missing."""
        if self.period is None:
            return values
        course = np.array(self.reduced(values))
        there = np.isfinite(course)
        inside = course[there]
        turns = np.floor(np.diff(inside, prepend=inside[:1]) / self.period + 0.5)
        course[there] = inside - self.period * np.cumsum(turns)
        return course

    def mean(self, values: np.ndarray) -> float:
        """Return the mean of the finite values (N,), NaN without any. For a periodic signal: a centre plus the mean of
        the differences from it, the centre being the direction of the mean of the unit vectors."""
        finite = values[np.isfinite(values)]
        if not len(finite) or self.period is None:
            return float(finite.mean()) if len(finite) else math.nan
        centre = np.angle(np.exp(2j * np.pi * finite / self.period).mean()) * self.period / (2 * np.pi)
        return float(self.turned(centre + self.difference(finite, centre).mean()))

    def derivative(self, order: int, time: str = "s") -> "Signal":
        """Return the signal's time derivative of this order, as a signal in the range of `rates`; order 0 is the
        signal.

        Its name is NAME_dot, NAME_ddot, NAME_dddot, NAME_d4, ...; its unit is per `time`. The input of a form is the
        derivative with `time` "s" for any model, and is printed in the model's unit.
        """
        if order == 0:
            return self
        suffix = _DOTS[order] if order < len(_DOTS) else f"_d{order}"
        unit = f"({self.unit})/{time}{order if order > 1 else ''}" if self.unit else ""
        what = "derivative" if order == 1 else f"derivative of order {order}"
        source = "you supply it, from what sets the signal or from a filter of it"
        low, high = self.rates[order - 1] if order <= len(self.rates) else (None, None)
        return Signal(
            f"{self.name.rstrip('_')}{suffix}",
            unit,
            f"{what} of {self.name}; {source}",
            low=low,
            high=high,
            rates=self.rates[order:],
        )


class Time(Signal):
    """The time since a start modulo one `turn` (exact), an input that a step counts by itself, for a plant whose
    equations are periodic functions of time. Its rate is 1."""

    __slots__ = ("turn",)

    turn: sp.Expr

    def __new__(cls, name: str, turn: sp.Expr, unit: str = "s") -> "Time":
        high = math.nextafter(float(turn), math.inf)  # not below one turn
        time = super().__new__(cls, name, unit, f"time modulo {turn} {unit}, which the step counts", 0, 0, high)
        time.turn = turn
        time._content = (*time._content, turn)
        return time

    def __getnewargs_ex__(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.name, self.turn, self.unit), {}

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return Time, self.__getnewargs_ex__()[0]


t = Signal("t", "", "time")  # in a plant's equations, and in the inputs of a trial


def times(inputs: Iterable[Signal]) -> tuple[Time, ...]:
    """Return the inputs that are a `Time`, which a step counts by itself."""
    return tuple(u for u in inputs if isinstance(u, Time))


def supplied(inputs: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return the inputs that a caller supplies: all but those that are a `Time`."""
    return tuple(u for u in inputs if not isinstance(u, Time))


def with_times(inputs: Sequence[Signal], u: np.ndarray, first: Sequence[float], passed: np.ndarray) -> np.ndarray:
    """Return all inputs (N, m) at N samples: the columns of `u`, which a caller supplies, then a column for each input
    that is a `Time`: its value in `first` at the first sample, plus the time `passed` (N) since the first sample."""
    return np.column_stack([u, *(start + passed for start, _ in zip(first, times(inputs), strict=True))])


def differences(signals: Sequence[Signal], values: np.ndarray, references: np.ndarray) -> np.ndarray:
    """The differences values - references (N, k) of k signals, those of periodic signals the short way round."""
    error: np.ndarray = np.subtract(values, references)
    for j, signal in enumerate(signals):
        if signal.period is not None:
            error[:, j] = signal.difference(values[:, j], references[:, j])
    return error


def in_turn(
    signals: Sequence[Signal], values: np.ndarray, change: Callable[[Signal, np.ndarray], Any] = Signal.turned
) -> np.ndarray:
    """Return the columns (N, k) of k signals, with the columns of periodic signals changed by `change`, by default
    wrapped to their range."""
    if not any(signal.period for signal in signals):
        return values
    return np.column_stack([change(signal, column) for signal, column in zip(signals, values.T, strict=True)])


def resting(signal: Signal) -> float:
    """Return a signal's default value: its nominal value, else 0 or the end of its range nearest to 0."""
    low, high = signal.interval
    return signal.nominal if signal.nominal is not None else min(max(0.0, low), high)


def spread(signal: Signal) -> tuple[float, float]:
    """Return the interval (low, high) from which sample points of a signal are drawn: its range, or without one its
    default value as both ends."""
    return signal.interval if signal.bounded else (resting(signal),) * 2


def part_of_turn(signal: Signal, shift: sp.Rational) -> str:
    """Return the text of a shift of a signal, such as "a quarter turn"; `shift`: in turns, or in the signal's unit
    where it has no period."""
    if signal.period is None:
        return f"{float(shift):g} {signal.unit}".strip()
    words = {2: "half a turn", 3: "a third of a turn", 4: "a quarter turn"}
    return words[shift.q] if shift.p == 1 and shift.q in words else f"{shift} of a turn"


def derived(inputs: Sequence[Signal]) -> dict[str, tuple[str, int]]:
    """Return the source and the order of each input that is a derivative of another input, by its name.

    The derivatives of two inputs, such as u and u_, may have the same name: the source is the one whose derivative is
    equal to the signal. The source of a derivative of u_dot, where u_dot is a derivative too, is u.
    """
    names, rates = {u.name: u for u in inputs}, dict[str, tuple[str, int]]()
    for u, k in product(inputs if len(inputs) > 1 else (), range(1, HIGHEST + 1)):
        rate = u.derivative(k)
        if rate.name in names and (rate.name not in rates or rate == names[rate.name]):
            rates[rate.name] = (u.name, k)

    def root(name: str, order: int) -> tuple[str, int]:
        source, more = rates.get(name, ("", 0))
        return root(source, order + more) if source else (name, order)

    return {name: root(*source) for name, source in rates.items()}


# --- the unit of time ---------------------------------------------------------------------------------------


def is_unit(value: object) -> bool:
    """Return whether a value can be a unit of time."""
    return isinstance(value, str) and bool(_WORD.match(value))


def seconds(time: str) -> float | None:
    """Return the number of seconds in the unit; None for an unknown unit."""
    return _SECONDS.get(time)


def plural(time: str) -> str:
    """Return a unit of time in the plural for a sentence, "seconds" for "s"; an unknown unit unchanged."""
    return _PLURAL.get(time, time)


def finer_units(time: str) -> dict[str, int]:
    """Return the shorter units of time, in the plural and the longest first, each with its number in one unit
    `time`."""
    if time not in _SECONDS:
        return {f"milli{time}": 1000, f"micro{time}": 1_000_000}
    whole = _SECONDS[time]
    shorter = sorted((size, unit) for unit, size in _SECONDS.items() if size < whole)[::-1]
    return {_PLURAL[unit]: round(whole / size) for size, unit in shorter}


def of_time(unit: str, time: str, declared: Iterable[str] = ()) -> str:
    """Return `unit`, which is written with s, as y^2 s, with the model's unit `time` in place of s. A unit in
    `declared`, the units of signals, is not changed."""
    return unit if time == "s" or unit in declared else re.sub(r"\bs(\d*)\b", rf"{time}\1", unit)


def pace(dt: float, time: str) -> str:
    """Return a period as text: "0.01 h (36 s)", without the seconds where they are not known."""
    text = f"{same(dt)} {time}"
    return text if time == "s" or time not in _SECONDS else f"{text} ({dt * _SECONDS[time]:.6g} s)"
