"""Logs as tables of columns: text with any encoding, delimiter, quotes and header, Parquet, MAT, DataFrames.

A signal of a log is one of its columns by name, or an expression of columns by the grammar of text models,

    T1 + 273.15      2*pi/60*rpm      -[Current(A)]

in which brackets hold the name of a column that is no identifier. A text that is the name of a column means that
column. If its name holds a unit, as "T1 [degC]" or "Current(A)", other than the signal's, it is converted by y ->
factor y + offset. The units are pint's, an optional library; the result of an expression is not converted. Texts of the
command line give a signal its column, SIGNAL=COLUMN, or a shift, SIGNAL=SAMPLES.
"""

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.errors import BadArgument
from hgogen.graph import NoGraph, to_casadi
from hgogen.reading.binary_log import Damaged, Unsupported, columns_of, frame_columns
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.files import Unread, content_of
from hgogen.registry import NotInstalled, library
from hgogen.signal import Signal

BYTES = 1 << 28  # of a log; its cells need about ten times as much memory
DELIMITERS = ",;\t|"
PIECE = 1024  # cells that are converted at once, or one by one if any is no number
EMPTY = frozenset(("", "na", "n/a", "null", "none", "nil", "-", "--"))
PARQUET, MAT, HDF = b"PAR1", b"MATLAB 5.0", (b"MATLAB 7.3", b"\x89HDF")
_BINARY = {
    "parquet": ("a Parquet file", "Parquet", ("pandas", "pyarrow.parquet")),
    "mat": ("a MAT file", "a MAT file", ("scipy.io",)),
}
_OLD = "is a MAT file of version 7.3, which is HDF5; save it again by save('log.mat', '-v7')"
_EXCEL = re.compile(r'"?sep=.?"?', re.IGNORECASE)  # the delimiter, which the header determines anyway
_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_NO_THOUSANDS = re.compile(r"[+-]?(0,\d+|\d+,(\d{1,2}|\d{4,}))([eE][+-]?\d+)?")  # unlike "1,234"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")


class BadRecord(BadArgument):
    """A log that cannot be read; the sentence names the file, what is wrong and the fix."""

    text = "{what}: {reason}"


@dataclass(frozen=True)
class Column:
    """A column as numbers (N,), NaN where a cell is empty, `blank` (N,), or no finite number, such as `example`."""

    name: str
    values: np.ndarray
    blank: np.ndarray
    example: str

    @property
    def empty(self) -> int:
        """The number of empty cells."""
        return int(np.count_nonzero(self.blank))

    @property
    def not_numbers(self) -> int:
        """The number of cells that are neither empty nor a finite number; NaN is not a finite number."""
        return int(np.count_nonzero(np.isnan(self.values))) - self.empty

    def select_rows(self, rows: np.ndarray) -> "Column":
        """Return the column in the given rows (N,), a mask or indices, only."""
        return replace(self, values=self.values[rows], blank=self.blank[rows])


@dataclass(frozen=True)
class Table:
    """Header and columns (N,), of cells or, from a library, arrays; `malformed` counts the rows longer than the header,
    which are left out."""

    path: str
    header: tuple[str, ...]
    columns: Sequence[Any]
    malformed: int = 0
    decimal_comma: bool = False
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.columns[0])

    def column(self, name: str) -> Column:
        """Return the column `name` as numbers; a missing value is an empty cell. Raises: `BadRecord`."""
        if self.header.count(name) != 1:
            raise BadRecord(self.path, self.no_column(name))
        array, kind = self._column_and_kind(name)
        if kind not in "iufbm":
            return parsed(name, self.cells(name), self.decimal_comma)
        values = array / np.timedelta64(1, "s") if kind == "m" else array.astype(float)  # spans of time in seconds
        return Column(name, np.where(np.isfinite(values), values, np.nan), np.isnan(values), "")

    def cells(self, name: str) -> Sequence[str]:
        """Return the cells of the column `name` as text, "" for a missing value."""
        array, kind = self._column_and_kind(name)
        if kind == "M":
            return ["" if text == "NaT" else text for text in np.datetime_as_string(array.astype("datetime64[us]"))]
        if kind in "OU":
            return cast(Sequence[str], array.tolist() if kind == "U" else array)
        return ["" if one is None or one != one else str(one) for one in array.tolist()]

    def _column_and_kind(self, name: str) -> tuple[Any, str]:
        column = self.columns[self.header.index(name)]
        return column, column.dtype.kind if isinstance(column, np.ndarray) else "O"

    def no_column(self, name: str) -> str:
        """Return a sentence why no single column is called `name`, with the names of the columns."""
        named = [column for column in self.header if column]
        if name in named:
            return f"has {named.count(name)} columns named {name!r}; rename all but one"
        close = get_close_matches(name, named, 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"has no column {name!r}; its columns are {', '.join(named)}{hint}"


def log_of(source: Any) -> Table:
    """Return the table of a path to a file of any kind, or of a DataFrame. Raises: `BadRecord`; `NotInstalled` if the
    library for the file is missing."""
    if isinstance(source, Table):
        return source
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        try:
            return _of_arrays("the DataFrame", frame_columns(source))
        except ValueError as error:
            raise BadRecord("the DataFrame", str(error)) from None
    if not isinstance(source, str | Path):
        raise BadRecord(f"a {type(source).__name__}", "is no log; give the path of a file, or a DataFrame")
    content = bytes_of(Path(source))
    if content.startswith(PARQUET):
        return _binary(str(source), "parquet", content)
    if content.startswith(HDF):
        raise BadRecord(str(source), _OLD)
    if content.startswith(MAT) or (Path(source).suffix.lower() == ".mat" and b"\0" in content[:128]):
        return _binary(str(source), "mat", content)
    return table(source, content)


# --- text ---------------------------------------------------------------------------------------------------


def parsed(name: str, cells: Sequence[str], decimal_comma: bool) -> Column:
    """Return cells as numbers."""
    if decimal_comma:
        cells = [cell.replace(",", ".") for cell in cells]
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
            if _NUMBER.fullmatch(cell):
                values[k] = float(cell.replace("d", "e").replace("D", "e"))
            elif cell.lower() in EMPTY:
                blank[k] = True
            else:
                example = example or cell
    values[np.isinf(values)] = np.nan
    return Column(name, values, blank, example)


def _plain_numbers(cells: Sequence[str]) -> list[float] | None:
    try:
        numbers = list(map(float, cells))
    except ValueError:
        return None
    return numbers if math.isfinite(sum(numbers)) and "_" not in "".join(cells) else None  # float accepts 1_000 as well


def table(path: str | Path, content: bytes | None = None) -> Table:
    """Return the table of the CSV file at `path`, or of its `content`.

    The delimiter (comma, semicolon, tab or bar) is the header's most frequent. Decimal commas are accepted if a cell
    has one that cannot separate thousands, with a comma as delimiter only in quotes. Lines that start with # are
    comments; the last one before the data is the header if the data has none. Each line is parsed alone, so a stray
    quote spoils only its own line.

    Raises: `BadRecord`.
    """
    text, notes = _text(Path(path), bytes_of(Path(path)) if content is None else content)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    full = [line for line in lines if line.strip()]
    if len(full) < len(lines):
        notes.append(f"{len(lines) - len(full)} empty lines: skipped")
    comments = [line for line in full if line.lstrip().startswith("#")] if "#" in text else []
    data = [line for line in full if not line.lstrip().startswith("#")] if comments else full
    if data and _EXCEL.fullmatch(data[0].strip()):
        notes.append(f"the line {data.pop(0).strip()!r}, which is for a spreadsheet: skipped")
    if not data:
        raise BadRecord(str(path), "is empty; it needs a header with column names, then rows of numbers")
    delimiter = max(DELIMITERS, key=re.sub(r'"[^"]*"', "", data[0]).count)
    named = [cell for cell in _cells(data[0], delimiter) if cell.lower() not in EMPTY | {"nan"}]
    if named and all(_NUMBER.fullmatch(cell.replace(",", ".")) for cell in named):
        if not comments:
            raise BadRecord(str(path), "has numbers in its first row; it needs a header with column names there")
        data.insert(0, comments.pop().lstrip().lstrip("#"))
    if comments:
        notes.append(f"{len(comments)} comment lines: skipped")
    return _aligned(str(path), _cells(data[0], delimiter), data[1:], delimiter, notes)


def _aligned(path: str, header: list[str], lines: list[str], delimiter: str, notes: list[str]) -> Table:
    if not lines:
        raise BadRecord(path, "has a header but no rows")
    width = len(header)
    columns, malformed, short_rows = _regular(lines, delimiter, width) or _ragged(lines, delimiter, header)
    if not columns:
        raise BadRecord(
            path, f"has no row that fits its header of {width} columns; is the delimiter {delimiter!r} right?"
        )
    if short_rows:
        notes.append(f"{short_rows} rows have fewer cells than the header: the rest of them is empty")
    certain = _COMMA if delimiter != "," else _NO_THOUSANDS
    with_comma = (cell for column in columns if "," in "".join(column) for cell in column if "," in cell)
    comma = any(map(certain.fullmatch, with_comma))
    if comma:
        notes.append("decimal commas: read as decimal points")
    return Table(path, tuple(header), columns, malformed, comma, tuple(notes))


_Columns = tuple[Sequence[Sequence[str]], int, int]  # columns of cells, numbers of malformed and of short rows


def _regular(lines: list[str], delimiter: str, width: int) -> _Columns | None:
    if '"' in "".join(lines) or {line.count(delimiter) for line in lines} != {width - 1}:
        return None
    cells = list(map(str.strip, delimiter.join(lines).split(delimiter)))
    return [cells[k::width] for k in range(width)], 0, 0


def _ragged(lines: list[str], delimiter: str, header: list[str]) -> _Columns:
    width = len(header)
    aligned, malformed, short_rows = [], 0, 0
    for row in (_cells(line, delimiter) for line in lines):
        if any(row[width:]):
            malformed += 1
            continue
        short_rows += len(row) < width - (header[-1] == "")
        aligned.append(row[:width] + [""] * (width - len(row)))
    return list(zip(*aligned, strict=True)), malformed, short_rows


def bytes_of(path: Path) -> bytes:
    """Return the content of a log. Raises: `BadRecord`."""
    try:
        return content_of(path, BYTES)
    except Unread as error:
        raise BadRecord(str(path), error.reason) from None


def _text(path: Path, content: bytes) -> tuple[str, list[str]]:
    try:
        wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")
        text, notes = content.decode("utf-16" if wide else "utf-8-sig"), []
    except UnicodeDecodeError:
        text, notes = content.decode("latin-1"), ["not UTF-8: read as Latin-1"]
    if "\0" in text:
        raise BadRecord(str(path), "is no text; give a CSV, Parquet or MAT file")
    return text, notes


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        row = line.split(delimiter)
    return [cell.strip() for cell in row]


# --- columns ------------------------------------------------------------------------------------------------


def _of_arrays(path: str, arrays: Mapping[str, np.ndarray], notes: tuple[str, ...] = ()) -> Table:
    if not any(map(len, arrays.values())):
        raise BadRecord(path, "has no rows")
    return Table(path, tuple(arrays), list(arrays.values()), notes=notes)


def _binary(path: str, kind: str, content: bytes) -> Table:
    what, form, packages = _BINARY[kind]
    for package in packages:
        library(package, f"{path}, {what},")
    try:
        arrays = columns_of(kind, content)
    except Unsupported:
        raise BadRecord(path, _OLD) from None
    except Damaged as error:
        raise BadRecord(path, f"cannot be read as {form}: {error}") from None
    lengths = [len(array) for array in arrays.values()]
    if kind == "mat" and not lengths:
        fix = "save vectors, a table by table2struct(T, 'ToScalar', true)"
        raise BadRecord(path, f"holds no vector or matrix of real numbers; {fix}")
    rows = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    others = [name for name, array in arrays.items() if len(array) != rows]
    notes = (f"of another length than {rows}, left out: {', '.join(others)}",) if others else ()
    return _of_arrays(path, {name: array for name, array in arrays.items() if len(array) == rows}, notes)


# ---------------------------------------------------------------- mapped


FAR = 1e9  # a conversion is evaluated here and at 0; the offset then costs the factor no digits
_BRACKETS = re.compile(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")  # may contain a pair of brackets, as of a unit
_SIGNS = re.compile(r"[-+*/()\[\]]")
_UNIT = re.compile(r"[\[(]([^\[\]()]+)[\])]\s*$")
_POWER = re.compile(r"(?<=[A-Za-z°µ])\^?(-?\d)")
_WORDS = {"²": "**2", "³": "**3", "·": "*", "°C": "degC", "°F": "degF", "°": "degree", "%": "percent", "Ω": "ohm"}
_GRAVITY = {"g": "standard_gravity", "G": "standard_gravity", "mg": "millistandard_gravity"}  # of an acceleration
_ANGLES = {"radian", "degree", "revolution", "turn"}


def column_of(log: Table, text: str) -> Column:
    """Return a column, or an expression of columns, as numbers, NaN where one is missing. Raises: `BadRecord`."""
    if text in log.header or not _SIGNS.search(text):
        return log.column(text)
    bracketed = _BRACKETS.findall(text)
    numbers = iter(range(len(bracketed)))
    plain = _BRACKETS.sub(lambda _: f" {_placeholder(log, next(numbers))} ", text)
    names = {_placeholder(log, k): name for k, name in enumerate(bracketed)}
    names |= {name: name for name in log.header if name.isidentifier()}
    symbols = {written: sp.Symbol(written, real=True) for written in names}
    try:
        expression = parse(plain, symbols)
        words = set(re.findall(r"[^\W\d]\w*", plain))
        read = {written: log.column(names[written]) for written in names if written in words}
        inputs = {symbols[written]: ca.SX.sym(written) for written in read}
        graph = ca.Function("column", list(inputs.values()), to_casadi([expression], inputs))
    except (BadExpression, NoGraph) as error:
        listed = ", ".join(name if name.isidentifier() else f"[{name}]" for name in log.header if name)
        raise BadRecord(log.path, f"the expression {text!r}: {error}; its columns are {listed}") from None
    if not read:
        reason = f"the expression {text!r} reads no column; name one, in brackets if it is no identifier"
        raise BadRecord(log.path, reason)
    with np.errstate(all="ignore"):
        values = np.array(graph(*(one.values[None, :] for one in read.values()))).ravel()
    known = np.all([np.isfinite(one.values) for one in read.values()], axis=0) & np.isfinite(values)
    blank = np.any([one.blank for one in read.values()], axis=0)
    examples = (one.example for one in read.values() if one.example)
    return Column(text, np.where(known, values, np.nan), blank & ~known, next(examples, ""))


def operand(log: Table, text: str) -> str:
    """Return a column name, or an expression of columns, as text that can be an operand in a longer expression."""
    if text in log.header:
        return text if text.isidentifier() else f"[{text}]"
    return f"({text})"


def _placeholder(log: Table, k: int) -> str:
    name = f"column_{k}"
    while name in log.header:
        name += "_"
    return name


# --- units --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conversion:
    """A conversion from a column's unit to a signal's, value -> factor value + offset, with a note for the report."""

    factor: float
    offset: float
    note: str

    def operand(self, column: str) -> str:
        """Return the converted column as an operand in an expression of columns."""
        shift = f" {'+' if self.offset > 0 else '-'} {abs(self.offset):.12g}" if self.offset else ""
        return f"({self.factor:.12g}*{column}{shift})"


class Inconvertible(ValueError):
    """Two units of different kinds, such as m and s, that do not convert."""


def named_unit(column: str) -> str:
    """Return the unit in brackets at the end of a column's name, "" for none."""
    match = _UNIT.search(column)
    return match[1].strip() if match and re.search(r"[^\W\d]|[%°]", match[1]) else ""


def converted(log: Table, column: Column, name: str, text: str, unit: str) -> tuple[Table, Column, str]:
    """Return the log with a note on the conversion, the column converted to `unit`, that of the signal `name`, and the
    operand for it in an expression. `text`: the column's name or expression. Raises: `BadRecord` if the units do not
    convert."""
    plain = operand(log, text)
    try:
        change = conversion(name, text, unit)
    except Inconvertible as error:
        fix = f"rename it, or take its numbers as they are, by an expression such as 1*{plain}"
        raise BadRecord(log.path, f"the column {text!r} {error}; {fix}") from None
    if isinstance(change, str):
        return (replace(log, notes=(*log.notes, change)) if change else log), column, plain
    log = replace(log, notes=(*log.notes, change.note))
    return log, replace(column, values=change.factor * column.values + change.offset), change.operand(plain)


def conversion(name: str, column: str, unit: str) -> Conversion | str:
    """Return the conversion of a column to the unit of the signal `name`. If the units are equal, or cannot be
    compared, return a note instead, which may be empty. Raises: `Inconvertible` for units of different kinds."""
    source = named_unit(column)
    if not source or not unit or _normal(source) == _normal(unit):
        return ""
    try:
        registry = _registry()
    except NotInstalled as error:
        return f"{name}: the unit in {column!r} is not compared with the model's, {unit}, since {error}"
    pair = [_parsed(registry, text) for text in (source, unit)]
    if None in pair:
        return ""
    first, second = pair
    if source in _GRAVITY and second.dimensionality == registry.Unit(_GRAVITY[source]).dimensionality:
        first = registry.Unit(_GRAVITY[source])
    if first.dimensionality != second.dimensionality or _turns(first, second):
        raise Inconvertible(f"is in {source}, which does not convert to {unit}, the unit of {name}")
    try:
        zero, far = (float(registry.Quantity(value, first).to(second).magnitude) for value in (0.0, FAR))
    except Exception:  # pint's errors, of offsets in products
        return f"{name}: {source} is not converted to {unit}, which is no matter of a factor and an offset"
    factor, offset = (far - zero) / FAR, zero
    if math.isclose(factor, 1.0, rel_tol=1e-12) and not offset:
        return ""
    return Conversion(factor, offset, f"{name}: converted from {source} to {unit}")


@cache
def _registry() -> Any:
    return library("pint", "a unit in a column's name", "units").UnitRegistry()


def _normal(text: str) -> str:
    for sign, written in _WORDS.items():
        text = text.replace(sign, written)
    return _POWER.sub(r"**\1", text).replace(" ", "*")


def _parsed(registry: Any, text: str) -> Any:
    try:
        return registry.Unit(_normal(text))
    except Exception:  # pint's errors, of several kinds
        return None


def _turns(first: Any, second: Any) -> bool:
    """Return whether one unit counts cycles and the other angles: pint omits their factor 2 pi."""
    cycles, angles = (
        [bool(names & set(map(str, unit._units))) for unit in (first, second)] for names in ({"hertz"}, _ANGLES)
    )
    return (cycles[0] and angles[1]) or (cycles[1] and angles[0])


def signal_named(key: str, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> str | None:
    """Return the name of the signal that a text means; plain "u" and "y" mean the only input and the only output."""
    names = [s.name for s in (*inputs, *outputs)]
    single = {"u": inputs, "y": outputs}
    if key not in names and len(single.get(key, ())) == 1:
        return str(single[key][0].name)
    return key if key in names else None


def shifts_of(path: str, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> dict[str, int]:
    """Return shifts in samples by signal, from texts "SIGNAL=SAMPLES", or several with commas. Raises: `BadRecord`."""
    shifts: dict[str, int] = {}
    for text in (part for each in texts for part in each.split(",")):
        key, _, number = (part.strip() for part in text.partition("="))
        name = signal_named(key, inputs, outputs)
        if name is None:
            listed = ", ".join(s.name for s in (*inputs, *outputs))
            raise BadRecord(path, f"--shift {text!r} names no signal; the signals are {listed}")
        if name in shifts:
            raise BadRecord(path, f"--shift gives {name} twice; leave one of them out")
        try:
            shifts[name] = int(number)
        except ValueError:
            reason = f"--shift {text!r} must read SIGNAL=SAMPLES, a whole number, such as u=1 for one sample later"
            raise BadRecord(path, reason) from None
    return shifts


def mapping(
    path: str, assignments: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, str]:
    """Return the column name of each signal, from texts "SIGNAL=COLUMN", by default the name of the signal.

    Plain "u" and "y" name the only input and the only output.

    Raises: `BadRecord`.
    """
    names = [s.name for s in (*inputs, *outputs)]
    columns = {name: name for name in names}
    assigned: dict[str, str] = {}
    for text in assignments:
        key, equals, column = text.partition("=")
        key = signal_named(key.strip(), inputs, outputs) or key.strip()
        if not equals or not column.strip():
            raise BadRecord(path, f"--map {text!r} must read SIGNAL=COLUMN; the signals are {', '.join(names)}")
        if key not in names:
            raise BadRecord(path, f"--map {text!r} names no signal; the signals are {', '.join(names)}")
        if key in assigned:
            raise BadRecord(path, f"--map {assigned[key]!r} and --map {text!r} map {key} twice; leave one of them out")
        assigned[key] = text
        columns[key] = column.strip()
    return columns
