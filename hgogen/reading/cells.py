"""The cells of a log, as text from any program, read as numbers and as times.

Cells that can be read in one way only decide for the others: "0,5", "1.234,5" and "1,234.5" for "1,234", and 13/04/2026
for 03/04/2026. Where no such date is, an order of day, month and year counts in which the log runs on without a jump.
What no cell decides is refused, with the option that does.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from itertools import islice
from typing import Literal, get_args

import numpy as np

from hgogen.errors import BadArgument

DecimalSign = Literal[".", ","]
DateOrder = Literal["dmy", "mdy", "ymd"]
PIECE = 1024  # cells that are converted at once, or one by one if any is no number
EMPTY = frozenset(
    ("", "na", "n/a", "n.a.", "#n/a", "#na", "<na>", "null", "none", "nil", "missing", "?", "-", "--", "---")
)
CODES = (-999.0, -9999.0, -99999.0, -999.9, -999.99, -9999.9, -9999.99, -999.25)  # for a missing number
_FAR = 5.0  # ranges of the other numbers: a code is so far from them
_SAMPLE = 200  # cells that show whether a column holds units
_JUMP = 100.0  # times as long a pause as in another order of day and month: it is not that order
_DAY, _SECOND = 86_400 * 10**9, 10**9  # ns
_BLANK = re.compile("[ '’\u00a0\u202f]")
_GROUPS = re.compile(rf"[+-]?\d{{1,3}}(?:{_BLANK.pattern}\d{{3}})+(?:[.,]\d*)?")
_SEPARATED = re.compile(rf",|\d{_BLANK.pattern}\d{{3}}|\.\d{{3}}\.")
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_QUANTITY = re.compile(rf"([+-]?[\d.,](?:[\d.,]|{_BLANK.pattern})*(?:[eE][+-]?\d+)?)\s*((?:[^\W\d_]|[%°])[^\s,;]*)")


class BadRecord(BadArgument):
    """The error that a log cannot be read; the message names the file, what is wrong and the fix."""

    text = "{what}: {reason}"


class Undecided(ValueError):
    """The error that cells can be read in two ways; the text names one cell, and the option that decides."""


@dataclass(frozen=True)
class Column:
    """A column of a log as numbers. `values` (N,): the numbers, NaN for an empty cell and for one that is no finite
    number; `blank` (N,): which cells are empty; `example`: a cell that is no number, "" without any; `unit`: that of
    the numbers, "" for none; `notes`: the decisions made on reading, for the report."""

    name: str
    values: np.ndarray
    blank: np.ndarray
    example: str
    unit: str = ""
    notes: tuple[str, ...] = ()

    @property
    def empty(self) -> int:
        """The number of empty cells."""
        return int(np.count_nonzero(self.blank))

    @property
    def not_numbers(self) -> int:
        """The number of cells that are neither empty nor a finite number; a cell NaN counts."""
        return int(np.count_nonzero(np.isnan(self.values))) - self.empty

    def select_rows(self, rows: np.ndarray) -> "Column":
        """Return the column in some rows only; `rows`: a mask (N,) or indices."""
        return replace(self, values=self.values[rows], blank=self.blank[rows])

    def without_codes(self) -> "Column":
        """Return the column with empty cells in place of a code for a missing number, such as -999, that is far below
        all other numbers."""
        for code in CODES:
            coded = self.values == code
            others = self.values[np.isfinite(self.values) & ~coded]
            if not coded.any() or not len(others):
                continue
            low, high = float(others.min()), float(others.max())
            if code < low - _FAR * (high - low):
                note = f"{self.name}: {code:g} in {coded.sum()} cells, a code for a missing number: taken as empty"
                values = np.where(coded, np.nan, self.values)
                return replace(self, values=values, blank=self.blank | coded, notes=(*self.notes, note)).without_codes()
        return self


@dataclass(frozen=True)
class Rows:
    """The selection of rows of a log: from `begin` to `end`, each a time or "row:100", and one in `every` of these."""

    begin: str | None = None
    end: str | None = None
    every: int = 1


EVERY_ROW = Rows()


# --- numbers ------------------------------------------------------------------------------------------------


def _pattern(sign: str, thousands: str) -> re.Pattern[str]:
    plain = rf"(?:\d+(?:{sign}\d*)?|{sign}\d+)(?:[eEdD][+-]?\d+)?"
    return re.compile(rf"[+-]?(?:{plain}|[1-9]\d{{0,2}}(?:{thousands}\d{{3}})+(?:{sign}\d*)?)")


NUMBERS: Mapping[DecimalSign, re.Pattern[str]] = {".": _pattern(r"\.", ","), ",": _pattern(",", r"\.")}


def signs_of(cell: str) -> list[DecimalSign]:
    """Return the decimal signs, "." or ",", with which a cell can be read as a number; empty for a cell that is no
    number."""
    return [sign for sign, pattern in NUMBERS.items() if pattern.fullmatch(cell)]


def decimal_signs(cells: Iterable[str]) -> set[DecimalSign]:
    """Return the decimal signs, "." or ",", of those cells that can be read as a number in one way only."""
    every = (signs_of(cell) for cell in cells if "," in cell or "." in cell)
    return {signs[0] for signs in every if len(signs) == 1}


def with_points(
    cells: Sequence[str], decimal: DecimalSign | None, others: Callable[[], set[DecimalSign]]
) -> tuple[Sequence[str], tuple[str, ...]]:
    """Return the cells with decimal points and without thousands separators, and notes for the report. `decimal`: the
    decimal sign; None: decided by the cells, or else by `others()`, the signs that occur in other columns. Raises:
    `Undecided`."""
    if decimal != "," and not _SEPARATED.search("\n".join(cells)) and "," not in others():
        return cells, ()
    cells = [_BLANK.sub("", cell) if _GROUPS.fullmatch(cell) else cell for cell in cells]
    every = [signs_of(cell) if "," in cell or "." in cell else [] for cell in cells]
    shown = {decimal} if decimal else {signs[0] for signs in every if len(signs) == 1} or others() or None
    plain, notes = [], dict[str, str]()
    for cell, signs in zip(cells, every, strict=True):
        if _EITHER.fullmatch(cell) and (shown or "." in cell):
            signs = [sign for sign in signs if sign in (shown or ".")]
        if len(signs) > 1:
            readings = f"{cell.replace(',', '.')} or {re.sub('[.,]', '', cell)}"
            reason = f"cells such as {cell!r}, which may be {readings}, and no other cell decides"
            raise Undecided(f"{reason}; give the decimal sign by --decimal '.' or --decimal ',' (decimal=)")
        thousands = "," if signs == ["."] else "."
        if signs and thousands in cell:
            notes.setdefault("thousands", f"separators of thousands: taken out, such as that in {cell}")
        if signs == [","] and "," in cell:
            notes.setdefault("decimal", "decimal commas: read as decimal points")
        plain.append(cell.replace(thousands, "").replace(",", ".") if signs else cell)
    return plain, tuple(notes.values())


def is_value(cell: str) -> bool:
    """Return whether a cell is a number, with a unit or without, or a time."""
    return bool(signs_of(_BLANK.sub("", cell)) or _with_unit(cell)[1] or is_stamp(cell))


def quantities(cells: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """Return the numbers and the units of cells such as "3.2 V"; unless most of the first cells have a unit, the cells
    as they are and "" for each unit."""
    sample = list(islice((cell for cell in cells if cell.lower() not in EMPTY), _SAMPLE))
    if 2 * sum(bool(_with_unit(cell)[1]) for cell in sample) <= len(sample):
        return cells, [""] * len(cells)
    numbers, units = zip(*map(_with_unit, cells), strict=True)
    return numbers, units


def _with_unit(cell: str) -> tuple[str, str]:
    match = _QUANTITY.fullmatch(cell)
    there = match and not signs_of(cell) and signs_of(_BLANK.sub("", match[1]))
    return (match[1].strip(), match[2]) if match and there else (cell, "")


def numbers_of(name: str, cells: Sequence[str]) -> Column:
    """Return cells with decimal points as a column of numbers; `name`: that of the column."""
    values, blank, example = np.full(len(cells), np.nan), np.zeros(len(cells), bool), ""
    for first in range(0, len(cells), PIECE):
        piece = cells[first : first + PIECE]
        numbers = _plain_numbers(list(filter(None, piece)))
        if numbers is not None:
            there = first + np.flatnonzero(list(map(len, piece)))
            values[there] = numbers
            blank[first : first + PIECE] = True
            blank[there] = False
            continue
        for k, cell in enumerate(piece, first):
            if _PLAIN.fullmatch(cell):
                values[k] = float(cell.replace("d", "e").replace("D", "e"))
            elif cell.lower() in EMPTY:
                blank[k] = True
            else:
                example = example or cell
    values[np.isinf(values)] = np.nan
    return Column(name, values, blank, example)


def _plain_numbers(cells: list[str]) -> list[float] | None:
    try:
        numbers = list(map(float, cells))
    except ValueError:
        return None
    return numbers if np.isfinite(sum(numbers)) and "_" not in "".join(cells) else None  # float accepts 1_000 as well


# --- times --------------------------------------------------------------------------------------------------


_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE = r"(?P<date>(\d{1,4})([-/. ])(\d{1,2}|[A-Za-z]{3,9})\.?\3(\d{1,4}))"
_CLOCK = r"(?:(?P<d>\d+) days?,? )?(?P<h>\d{1,3}):(?P<m>\d\d?)(?::(?P<s>\d\d?))?(?:[.,](?P<f>\d{1,9})|:(?P<ms>\d{3}))?"
_ZONE = r"(?:\s*(?P<half>[ap])\.?m\.?)?(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d\d:?(?:\d\d)?))?"
_STAMP = re.compile(rf"(?:{_DATE}(?:[T ,_]+(?=\d)|$))?(?:{_CLOCK}{_ZONE})?", re.IGNORECASE)
_ENGLISH = re.compile(r"(?:[A-Za-z]{3,9},?\s+)?([A-Za-z]{3,9})\.?\s+(\d{1,2}),?\s+(?:([\d:.]+)\s+)?(\d{4})")
Part = tuple[tuple[str, ...], int]  # year, month and day with their mark, in the order of the cell; ns since midnight


@dataclass(frozen=True)
class Stamps:
    """The times of cells: `seconds` (N,) since the first of them, NaN for a cell that is no time; `dated`: whether they
    have a date; `notes`: the decisions made on reading."""

    seconds: np.ndarray
    dated: bool = False
    notes: tuple[str, ...] = ()


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date, a time of day or both."""
    return _part(cell) is not None


def has_dates(cells: Iterable[str]) -> bool:
    """Return whether one of the cells is a date."""
    return any(part[0] for part in map(_part, cells) if part)


def stamps_of(cells: Sequence[str], order: DateOrder | None = None, overnight: bool = True) -> Stamps:
    """Return the times in cells: in ISO 8601; a time of day hh:mm:ss(.fff), with am or pm, or with hours above 24; a
    date with such a time or alone. `order`: the order of day, month and year, None: decided by the cells; `overnight`:
    whether times of day without a date continue after midnight. Raises: `Undecided`."""
    parts = [_part(cell) for cell in cells]
    dates = {part[0] for part in parts if part and part[0]}
    timed = {k: part for k, part in enumerate(parts) if part and bool(part[0]) == bool(dates)}
    seconds = np.full(len(cells), np.nan)
    if not timed:
        return Stamps(seconds)
    example = cells[next(iter(timed))]
    first, notes = _running(_readings([*timed.values()], order), example)
    nights = np.cumsum(np.diff(first, prepend=0) < -_DAY // 2) if not dates and overnight else np.zeros(1, int)
    if nights[-1]:
        notes.append(f"times of day pass midnight {nights[-1]} times")
    seconds[[*timed]] = (first + nights * _DAY) / _SECOND
    if not dates and re.fullmatch(r"\d+:\d\d", example):
        notes.append(
            f"times such as {example!r}: read as hours and minutes; if they are minutes and seconds, divide them by 60"
        )
    return Stamps(seconds, bool(dates), tuple(notes))


def _readings(parts: Sequence[Part], order: DateOrder | None) -> dict[DateOrder, np.ndarray]:
    """Return the times (N,) in ns since the first one, for each order of day, month and year in which all dates are
    valid."""
    keys, clock = zip(*parts, strict=True)
    readings = dict[DateOrder, np.ndarray]()
    for each in get_args(DateOrder):
        days = {one: _day(one, each) if one else 0 for one in set(keys)} if order in (None, each) else {(): None}
        if None not in days.values():
            at = np.array([days[key] for key in keys]) * _DAY + np.array(clock)
            readings[each] = at - at[0]
    return readings


def _running(readings: Mapping[DateOrder, np.ndarray], example: str) -> tuple[np.ndarray, list[str]]:
    """Return the times (N,) in the order of day, month and year that makes the longest pause shortest, with a note.
    Raises: `Undecided`."""
    if not readings:
        raise Undecided(f"dates such as {example!r}, which are not all in one order of day, month and year")
    pauses = {each: int(np.abs(np.diff(at)).max(initial=0)) for each, at in readings.items()}
    running = [each for each, pause in pauses.items() if pause <= _JUMP * min(pauses.values())]
    first, *others = (readings[each] for each in running)
    if any(np.any(first != other) for other in others):
        choices = " or ".join(f"--dates {each}" for each in running)
        raise Undecided(f"dates such as {example!r}, of which no cell tells day from month; say {choices} (dates=)")
    note = f"dates such as {example!r}: read as {running[0]}, day, month and year"
    return first, [note] * (len(running) < len(readings))


def _part(cell: str) -> Part | None:
    if cell[:1].isalpha():
        cell = _ENGLISH.sub(r"\2 \1 \4 \3", cell).strip()
    match = _STAMP.fullmatch(cell) if cell else None
    if match is None:
        return _iso(cell)
    clock = _nanoseconds(match.groupdict())
    return None if clock is None else (match.group(2, 3, 4, 5) if match["date"] else (), clock)


def _iso(cell: str) -> Part | None:
    """Return a time in another notation of ISO 8601, such as 20260301T100000 or with weeks; None for no time."""
    if not ("T" in cell or "W" in cell) or not cell[:4].isdigit():
        return None
    try:
        at = datetime.fromisoformat(cell)
    except ValueError:
        return None
    at = at.astimezone(UTC) if at.tzinfo else at
    midnight = at.replace(hour=0, minute=0, second=0, microsecond=0)
    return (f"{at.year:04}", "-", f"{at.month}", f"{at.day}"), (at - midnight) // timedelta(microseconds=1) * 1000


def _nanoseconds(clock: Mapping[str, str | None]) -> int | None:
    """Return the time of day in ns from the groups of a match of `_STAMP`; None if it is invalid, such as 25:00 with
    am."""
    hours, minutes, whole = (int(clock[key] or 0) for key in "hms")
    if clock["half"]:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + 12 * (clock["half"] in "pP")
    if clock["s"] is None and clock["f"]:  # minutes, seconds and their fraction
        hours, minutes, whole = 0, hours, minutes
    elif minutes > 59 or (clock["date"] and hours > 24):
        return None
    if whole > 60:
        return None
    zone = (clock["zone"] or "").replace(":", "")
    away = 0 if not zone[1:].isdigit() else int(zone[:3]) * 60 + int(zone[0] + (zone[3:] or "0"))
    total = ((int(clock["d"] or 0) * 24 + hours) * 60 + minutes - away) * 60 + whole
    return total * _SECOND + int(f"{clock['f'] or clock['ms'] or '':0<9}")


def _day(key: tuple[str, ...], order: DateOrder) -> int | None:
    """Return the day number of a date whose parts have this order; None if they are invalid in it."""
    parts = dict(zip(order, (key[0], key[2], key[3]), strict=True))
    year, short = parts["y"], all(len(part) < 3 or part.isalpha() for part in parts.values())
    if (
        len(year) != (2 if short else 4)
        or (key[1] == "." and order == "mdy")
        or (key[1] == "." and short and order == "ymd")
    ):
        return None
    month = parts["m"][:3].lower()
    try:
        number = _MONTHS.index(month) + 1 if month in _MONTHS else int(parts["m"])
        return date(int(year) + 2000 * short, number, int(parts["d"])).toordinal()
    except ValueError:
        return None
