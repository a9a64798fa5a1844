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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache, cached_property
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.graph import NoGraph, to_casadi
from hgogen.reading.binary_log import Columns, Damaged, Unsupported, columns_of, frame_columns
from hgogen.reading.cells import (
    EMPTY,
    BadRecord,
    Column,
    DateOrder,
    DecimalSign,
    Undecided,
    decimal_signs,
    is_stamp,
    is_value,
    numbers_of,
    quantities,
    signs_of,
    with_points,
)
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.files import Unread, content_of
from hgogen.registry import NotInstalled, library
from hgogen.signal import Signal

BYTES = 1 << 28  # of a log; its cells need about ten times as much memory
DELIMITERS = (*";\t|, ", "  ")  # of those that serve equally the first; blanks: one or several, or two and more
_LABEL, _NUMBERED = re.compile(r"^[A-Za-z]\w*:\s+"), re.compile(r"^\d+[:.)]\s*")  # of names in a comment
HEAD, TAIL = 100, 20  # lines at the begin and the end of a file that tell its delimiter and its header
MARKS = ("#", "%", "//")  # of a comment
NEUTRAL = EMPTY | {"nan", "-nan", "inf", "-inf"}  # cells that are neither a value nor text
PARQUET, MAT, HDF = b"PAR1", b"MATLAB 5.0", (b"MATLAB 7.3", b"\x89HDF")
PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\xfd7zXZ": "lzma"}
_BINARY = {
    "parquet": ("a Parquet file", ("pandas", "pyarrow.parquet"), "logs"),
    "mat": ("a MAT file", ("scipy.io",), "logs"),
    "xlsx": ("an Excel file", ("pandas", "openpyxl"), "logs"),
    "ulog": ("a ULog file", ("pyulog",), "loggers"),
    "mdf": ("an MDF file", ("asammdf",), "loggers"),
}
BEGINS = {PARQUET: "parquet", MAT: "mat", b"PK\x03\x04": "xlsx", b"ULog\x01\x12\x35": "ulog", b"MDF     ": "mdf"}
_OLD = "is a MAT file of version 7.3, which is HDF5; save it again by save('log.mat', '-v7')"
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")  # characters of no text
_EXCEL = re.compile(r'"?sep=.?"?', re.IGNORECASE)  # the delimiter, which the header determines anyway


@dataclass(frozen=True)
class Table:
    """A log as a table: the `header` and the `columns` (N,), whose cells are texts or, from a binary file, numbers.
    `malformed`: the number of rows longer than the header, which are left out; `notes`: the decisions made on reading;
    `units`: those of a row below the header, by name; `decimal`, `dates`: the decimal sign and the order of day, month
    and year, None where the cells decide; `read`: a cache of the columns read so far."""

    path: str
    header: tuple[str, ...]
    columns: Sequence[Any]
    malformed: int = 0
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    decimal: DecimalSign | None = None
    dates: DateOrder | None = None
    read: dict[str, Column] = field(default_factory=dict, repr=False)

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.columns[0])

    def column(self, name: str) -> Column:
        """Return the column `name` as numbers; a missing value counts as an empty cell. Raises: `BadRecord`."""
        if name not in self.read:
            self.read[name] = self._read(name)
        return self.read[name]

    def _read(self, name: str) -> Column:
        if self.header.count(name) != 1:
            raise BadRecord(self.path, self.no_column(name))
        array, kind = self._column_and_kind(name)
        if kind in "iufbm":
            values = array / np.timedelta64(1, "s") if kind == "m" else array.astype(float)  # spans of time in seconds
            read = Column(name, np.where(np.isfinite(values), values, np.nan), np.isnan(values), "")
        else:
            read = self._numbers(name, self.cells(name))
        return replace(read, unit=read.unit or self.units.get(name, "") or named_unit(name)).without_codes()

    def _numbers(self, name: str, cells: Sequence[str]) -> Column:
        numbers, units = quantities(cells)
        kinds = list(dict.fromkeys(filter(None, units)))
        if not all(map(is_unit, kinds)):
            numbers, kinds = cells, []
        try:
            plain, notes = with_points(numbers, self.decimal, lambda: self._decimal_signs)
        except Undecided as error:
            raise BadRecord(self.path, f"the column {name!r} holds {error}") from None
        read = numbers_of(name, plain)
        for unit in kinds[1:]:
            try:
                change = conversion(name, unit, kinds[0])
            except Inconvertible as error:
                raise BadRecord(
                    self.path, f"the column {name!r} holds cells in {kinds[0]} and one that {error}"
                ) from None
            if isinstance(change, Conversion):
                there = np.array(units) == unit
                read.values[there] = change.factor * read.values[there] + change.offset
        return replace(read, unit="".join(kinds[:1]), notes=notes)

    @cached_property
    def _decimal_signs(self) -> set[DecimalSign]:
        """The decimal signs that the columns show, none in a log without commas in its cells."""
        every = [self.cells(name) for name in self.header if self._column_and_kind(name)[1] in "OU"]
        commas = any("," in "".join(cells) for cells in every)
        return {sign for cells in every for sign in decimal_signs(cells)} if commas else set()

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

    def called(self, name: str) -> str:
        """Return the full header of the only column with this name and a unit in brackets, such as "t [s]" for "t"; any
        other name unchanged."""
        named = [column for column in self.header if _UNIT.sub("", column).strip() == name]
        return named[0] if len(named) == 1 and name not in self.header else name

    def no_column(self, name: str) -> str:
        """Return the sentence that no column, or more than one, is called `name`, with the names of the columns."""
        named = [column for column in self.header if column]
        if name in named:
            return f"has {named.count(name)} columns named {name!r}; rename all but one"
        close = get_close_matches(name, named, 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"has no column {name!r}; its columns are {', '.join(named)}{hint}"


def log_of(
    source: Any,
    wanted: Iterable[str] = (),
    decimal: DecimalSign | None = None,
    dates: DateOrder | None = None,
) -> Table:
    """Return the log at a path as a table, of any supported kind of file, uncompressed or compressed by gzip, bzip2 or
    xz; or that in a DataFrame; a `Table` is returned unchanged. `wanted`: names of columns, or expressions with such
    names, by which the header of a text is recognised; `decimal`, `dates`: as of the `Table`. Raises: `BadRecord`;
    `NotInstalled` if the library for the file is missing."""
    if isinstance(source, Table):
        return source
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        try:
            return _of_arrays("the DataFrame", frame_columns(source))
        except ValueError as error:
            raise BadRecord("the DataFrame", str(error)) from None
    if not isinstance(source, str | Path):
        raise BadRecord(f"a {type(source).__name__}", "is no log; give the path of a file, or a DataFrame")
    content = unpacked(str(source), bytes_of(Path(source)))
    kind = next((kind for begin, kind in BEGINS.items() if content.startswith(begin)), "")
    if content.startswith(HDF):
        raise BadRecord(str(source), _OLD)
    if not kind and Path(source).suffix.lower() == ".mat" and b"\0" in content[:128]:
        kind = "mat"
    read = _binary(str(source), kind, content, wanted) if kind else table(source, content, wanted)
    return replace(read, decimal=decimal, dates=dates, read={})


# --- text ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Head:
    """A line of a text log that may be its header: its number, the `delimiter` and the `names`; `values`: the number of
    cells with a value minus the number with other text, in the rows that fit the header; `known`: the number of its
    names that are wanted."""

    line: int
    delimiter: str
    names: tuple[str, ...]
    values: int
    known: int

    @property
    def rank(self) -> tuple[bool, float, int]:
        """The sort key of candidates for the header: the largest wins."""
        return len(self.names) > 1, round(self.values / len(self.names), 6), self.known


def table(path: str | Path, content: bytes | None = None, wanted: Iterable[str] = ()) -> Table:
    """Return the table in the text file at `path`, or in its `content`; `wanted`: the names of columns by which its
    header is recognised.

    Header and delimiter (comma, semicolon, tab, bar, blanks, or at least two blanks) are those for which most cells of
    the rows are values. The header is a line above the rows with as many names, perhaps in a comment; of several such
    lines the one with the most wanted names, else the last that does not hold units. Lines above it, comments,
    repetitions of it and other lines of text are left out. Each line is parsed alone, so a stray quote spoils only its
    own line.

    Raises: `BadRecord`.
    """
    text, notes = _text(Path(path), bytes_of(Path(path)) if content is None else content)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    full = [line for line in lines if line.strip()]
    if len(full) < len(lines):
        notes.append(f"{len(lines) - len(full)} empty lines: skipped")
    if full and _EXCEL.fullmatch(full[0].strip()):
        notes.append(f"the line {full.pop(0).strip()!r}, which is for a spreadsheet: skipped")
    if not any(map(_uncommented, full)):
        raise BadRecord(str(path), "is empty; it needs a header with column names, then rows of numbers")
    head = _head(str(path), full, {word for text in wanted for word in words_of(text)})
    following = full[head.line + 1 :]
    begins = (_uncommented(line) and _value_balance(_cells(line, head.delimiter)) is not None for line in following)
    first = next((k for k, begin in enumerate(begins) if begin), 0)
    above, below = full[: head.line], list(filter(_uncommented, following[:first]))
    units = [cell.strip("[]()") for cell in _cells(below[0], head.delimiter)] if below else []
    of_units = bool(units) and all(map(is_unit, units))
    repeated = {*full[: head.line + 1], *below}.intersection(following[first:])
    body = [line for line in following[first:] if line not in repeated] if repeated else following[first:]
    rows = list(filter(_uncommented, body)) if any(mark in text for mark in MARKS) else body
    counted = (
        (len(list(filter(_uncommented, above))), "lines above the header: skipped"),
        (len(below) - of_units, "lines below the header: skipped"),
        (int(of_units), "line of units below the header"),
        (
            len(following) - first - len(body),
            "lines that repeat the header, as a logger that starts anew writes it: skipped",
        ),
        (len(above) - len(list(filter(_uncommented, above))) + len(body) - len(rows), "comment lines: skipped"),
    )
    notes += [f"{count} {what}" for count, what in counted if count]
    read = _aligned(str(path), head.names, rows, head.delimiter, notes)
    return replace(read, units=dict(zip(head.names, units, strict=False)) if of_units else {})


def _uncommented(line: str) -> bool:
    return not line.lstrip().startswith(MARKS)


def _value_balance(cells: Sequence[str]) -> int | None:
    """Return the number of cells that are values minus the number of those that are other text; None if all are other
    text."""
    texts = [cell for cell in cells if cell.lower() not in NEUTRAL]
    values = sum(map(is_value, texts))
    return 2 * values - len(texts) if values or not texts else None


def _trimmed(cells: list[str]) -> tuple[str, ...]:
    return tuple(cells[: max((k for k, cell in enumerate(cells, 1) if cell), default=0)])


def _head(path: str, lines: list[str], wanted: set[str]) -> _Head:
    sample = [*lines[:HEAD], *lines[HEAD:][-TAIL:]]
    heads = [head for delimiter in DELIMITERS for head in _heads(sample, delimiter, wanted)]
    if heads:
        most = max(head.rank for head in heads)
        best = [head for head in heads if head.rank == most]
        if len(best) == 1:  # to parse units takes a second
            return best[0]
        return next((head for head in best if not all(map(is_unit, head.names))), best[0])
    first = next(k for k, line in enumerate(lines) if _uncommented(line))
    plain = re.sub(r'"[^"]*"', "", lines[first])
    delimiter = max(",;\t|", key=plain.count)
    names = _trimmed(_cells(lines[first], delimiter))
    if all(is_value(name) or name.lower() in EMPTY for name in names):
        raise BadRecord(path, "has numbers in its first row; it needs a header with column names there")
    return _Head(first, delimiter, names, 0, 0)


def _heads(lines: list[str], delimiter: str, wanted: set[str]) -> Iterator[_Head]:
    """Yield the candidates for the header with this delimiter, the last line first."""
    split = [_cells(line.lstrip(" \t#%/"), delimiter) for line in lines]
    rows = [
        (k, len(_trimmed(cells)), len(cells), balance)
        for k, (line, cells) in enumerate(zip(lines, split, strict=True))
        if _uncommented(line) and (balance := _value_balance(cells)) is not None
    ]
    for k, names in _names_of(lines[:HEAD], delimiter):
        if not any(names) or any(signs_of(name) or is_stamp(name) for name in names):
            continue
        fitting = [
            balance for line, least, most, balance in rows if line > k and least <= len(names) <= max(least, most)
        ]
        if fitting:
            yield _Head(k, delimiter, names, sum(fitting), len(wanted.intersection(names)))


def _names_of(lines: list[str], delimiter: str) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the number of each line and its cells as column names, the last line first. A comment may have another
    delimiter than the rows, a number before each name, and a label before all."""
    for k, line in reversed(list(enumerate(lines))):
        if _uncommented(line):
            yield k, _trimmed(_cells(line.lstrip(), delimiter))
            continue
        text = _LABEL.sub("", line.lstrip(" \t#%/"))
        for each in (delimiter, *DELIMITERS):
            yield k, _trimmed([_NUMBERED.sub("", cell).rstrip(",;") for cell in _cells(text, each)])


def _aligned(path: str, header: tuple[str, ...], lines: list[str], delimiter: str, notes: list[str]) -> Table:
    if not lines:
        raise BadRecord(path, "has a header but no rows")
    width = len(header)
    if not delimiter.strip(" ") and '"' not in "".join(lines):
        lines = [delimiter.join(_cells(line, delimiter)) for line in lines]
    columns, malformed, short_rows, texts = _regular(lines, delimiter, width) or _ragged(lines, delimiter, width)
    if not columns:
        raise BadRecord(
            path, f"has no row that fits its header of {width} columns; is the delimiter {delimiter!r} right?"
        )
    if short_rows:
        notes.append(f"{short_rows} rows have fewer cells than the header: the rest of them is empty")
    if texts:
        notes.append(f"{texts} lines of text between the rows: skipped")
    return Table(path, header, columns, malformed, tuple(notes))


_Columns = tuple[Sequence[Sequence[str]], int, int, int]  # columns of cells, numbers of malformed, short and text rows


def _regular(lines: list[str], delimiter: str, width: int) -> _Columns | None:
    if '"' in "".join(lines) or {line.count(delimiter) for line in lines} != {width - 1}:
        return None
    cells = list(map(str.strip, delimiter.join(lines).split(delimiter)))
    return [cells[k::width] for k in range(width)], 0, 0, 0


def _ragged(lines: list[str], delimiter: str, width: int) -> _Columns:
    """Return the columns of rows with different numbers of cells. With blanks as the delimiter no cell can be empty, so
    that a short row is malformed: it is unknown which cell is missing."""
    aligned, malformed, short_rows, texts = [], 0, 0, 0
    for row in (_cells(line, delimiter) for line in lines):
        short = len(row) < width
        if short and _value_balance(row) is None:
            texts += 1
        elif any(row[width:]) or (short and not delimiter.strip(" ")):
            malformed += 1
        else:
            short_rows += short
            aligned.append(row[:width] + [""] * (width - len(row)))
    return list(zip(*aligned, strict=True)), malformed, short_rows, texts


def bytes_of(path: Path) -> bytes:
    """Return the content of a log file. Raises: `BadRecord`."""
    try:
        return content_of(path, BYTES)
    except Unread as error:
        raise BadRecord(str(path), error.reason) from None


def unpacked(path: str, content: bytes) -> bytes:
    """Return the content of a file, decompressed if it is compressed by gzip, bzip2 or xz. Raises: `BadRecord`."""
    name = next((name for mark, name in PACKED.items() if content.startswith(mark)), None)
    if name is None:
        return content
    try:
        with import_module(name).open(BytesIO(content)) as stream:
            plain = bytes(stream.read(BYTES + 1))
    except Exception as error:  # of each library its own
        raise BadRecord(path, f"cannot be unpacked by {name}: {error}") from None
    if len(plain) > BYTES:
        raise BadRecord(path, f"is larger than {BYTES} bytes when unpacked; give a smaller file")
    return plain


def _text(path: Path, content: bytes) -> tuple[str, list[str]]:
    notes, ended = [], content.rstrip(b"\0")
    zeros = [content[k:HEAD:2].count(0) > len(content[k:HEAD:2]) // 2 for k in (0, 1)]
    wide = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        if zeros[0] != zeros[1] or wide == "utf-16":
            text = content[: len(content) // 2 * 2].decode(wide)
        else:
            notes += ["zeros at its end, as after a loss of power: skipped"] * (len(ended) < len(content))
            text = ended.decode("utf-8-sig")
    except UnicodeDecodeError:
        text, notes = ended.decode("latin-1"), [*notes, "not UTF-8: read as Latin-1"]
    if _CONTROL.search(text.rstrip("\x1a")):
        raise BadRecord(str(path), "is no text, and no Parquet, MAT, Excel, ULog or MDF file")
    return text, notes


def _cells(line: str, delimiter: str) -> list[str]:
    if not delimiter.strip(" "):
        line = line.replace("\t", delimiter).strip()
        if '"' not in line:
            return line.split() if delimiter == " " else re.split(" {2,}", line)
    try:
        row = next(csv.reader([line], delimiter=delimiter[0], skipinitialspace=True), [])
    except csv.Error:
        row = line.split(delimiter)
    return [cell.strip() for cell in row]


# --- columns ------------------------------------------------------------------------------------------------


def _of_arrays(path: str, arrays: Mapping[str, np.ndarray], notes: tuple[str, ...] = ()) -> Table:
    if not any(map(len, arrays.values())):
        raise BadRecord(path, "has no rows")
    return Table(path, tuple(arrays), list(arrays.values()), notes=notes)


def _binary(path: str, kind: str, content: bytes, wanted: Iterable[str]) -> Table:
    what, packages, extra = _BINARY[kind]
    for package in packages:
        library(package, f"{path}, {what},", extra)
    try:
        columns = columns_of(kind, content)
    except Unsupported:
        raise BadRecord(path, _OLD) from None
    except Damaged as error:
        raise BadRecord(path, f"cannot be read as {what}: {error}") from None
    arrays = columns.arrays
    if kind == "xlsx":
        return table(path, b"".join(array.tobytes() for array in arrays.values()), wanted)
    if columns.clocks:
        return _joined(path, columns, {word for text in wanted for word in words_of(text)})
    lengths = [len(array) for array in arrays.values()]
    if kind == "mat" and not lengths:
        fix = "save vectors, a table by table2struct(T, 'ToScalar', true)"
        raise BadRecord(path, f"holds no vector or matrix of real numbers; {fix}")
    rows = max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)
    others = [name for name, array in arrays.items() if len(array) != rows]
    notes = (f"of another length than {rows}, left out: {', '.join(others)}",) if others else ()
    return _of_arrays(path, {name: array for name, array in arrays.items() if len(array) == rows}, notes)


def _joined(path: str, columns: Columns, wanted: set[str]) -> Table:
    """Return the wanted columns of a file whose columns have different clocks, in the rows of all these times, in s as
    the column "time", NaN where a column has no sample. Columns that are not wanted are NaN."""
    chosen = {name: columns.clocks[name] for name in columns.arrays if name in columns.clocks and name in wanted}
    if not chosen:
        raise BadRecord(path, f"has none of the columns given; its columns are time, {', '.join(columns.clocks)}")
    clocks = {clock: columns.arrays[clock] for clock in dict.fromkeys(chosen.values())}
    times = np.unique(np.concatenate(list(clocks.values())))
    arrays = {"time": times} | dict.fromkeys(columns.clocks, np.full(len(times), np.nan))
    for name, clock in chosen.items():
        arrays[name] = arrays[name].copy()
        arrays[name][np.searchsorted(times, clocks[clock])] = columns.arrays[name]
    several = any(len(clock) < len(times) for clock in clocks.values())
    notes = (f"the columns have {len(clocks)} clocks: each has its samples in the rows of its own",) * several
    return replace(_of_arrays(path, arrays, notes), units={"time": "s", **columns.units})


# ---------------------------------------------------------------- mapped


FAR = 1e9  # a conversion is evaluated here and at 0; the offset then costs the factor no digits
_BRACKETS = re.compile(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")  # may contain a pair of brackets, as of a unit
_SIGNS = re.compile(r"[-+*/()\[\]]")
_UNIT = re.compile(r"[\[(]([^\[\]()]+)[\])]\s*$")
_POWER = re.compile(r"(?<=[A-Za-z°µ])\^?(-?\d)")
_WORDS = {"²": "**2", "³": "**3", "·": "*", "°C": "degC", "°F": "degF", "°": "degree", "%": "percent", "Ω": "ohm"}
_GRAVITY = {"g": "standard_gravity", "G": "standard_gravity", "mg": "millistandard_gravity"}  # of an acceleration
_ANGLES = {"radian", "degree", "revolution", "turn"}


def column_named(text: str) -> str:
    """Return the name inside the brackets of a text "[name]"; any other text unchanged."""
    match = _BRACKETS.fullmatch(text.strip())
    return match[1] if match else text


def words_of(text: str) -> list[str]:
    """Return the parts of a name or an expression that may be names of columns."""
    return [text, *_BRACKETS.findall(text), *re.findall(r"[^\W\d]\w*", text)]


def column_of(log: Table, text: str, column: Callable[[str], Column] | None = None) -> Column:
    """Return a column of a log, or an expression of columns, as numbers, NaN where one is missing. `column`: the
    function from a name to its column, by default `log.column`. Raises: `BadRecord`."""
    column = column or log.column
    if text in log.header or not _SIGNS.search(text):
        return column(text)
    plain, names = _identifiers(log, text)
    symbols = {written: sp.Symbol(written, real=True) for written in names}
    try:
        expression = parse(plain, symbols)
        words = set(re.findall(r"[^\W\d]\w*", plain))
        read = {written: column(names[written]) for written in names if written in words}
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
    notes = tuple(note for one in read.values() for note in one.notes)
    return Column(text, np.where(known, values, np.nan), blank & ~known, next(examples, ""), notes=notes)


def _identifiers(log: Table, text: str) -> tuple[str, dict[str, str]]:
    """Return an expression of columns with an identifier in place of each name in brackets, and the names of columns by
    identifier."""
    placeholders = dict[str, str]()
    for bracketed in _BRACKETS.findall(text):
        name = f"column_{len(placeholders)}"
        while name in log.header:
            name += "_"
        placeholders[name] = bracketed
    unused = iter(placeholders)
    plain = _BRACKETS.sub(lambda _: f" {next(unused)} ", text)
    return plain, placeholders | {name: name for name in log.header if name.isidentifier()}


def operand(log: Table, text: str) -> str:
    """Return a column name, or an expression of columns, as text that can be an operand in a larger expression."""
    if text in log.header:
        return text if text.isidentifier() else f"[{text}]"
    return f"({text})"


def quotient(text: str, divisor: int) -> str:
    """Return the text of an expression of columns that divides `text`, a column or an expression, by a number."""
    expression = f"({text})" if re.search(r"[-+*/]", text) else f"[{text}]"
    return f"{text if text.isidentifier() else expression}/{divisor}"


# --- units --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conversion:
    """A conversion from a column's unit to a signal's: value -> `factor` value + `offset`, with a `note` for the
    report."""

    factor: float
    offset: float
    note: str

    def operand(self, column: str) -> str:
        """Return the converted column as text that can be an operand in an expression of columns."""
        shift = f" {'+' if self.offset > 0 else '-'} {abs(self.offset):.12g}" if self.offset else ""
        return f"({self.factor:.12g}*{column}{shift})"


class Inconvertible(ValueError):
    """The error that two units of different kinds, such as m and s, have no conversion."""


def named_unit(column: str) -> str:
    """Return the unit in brackets at the end of a column's name, such as s of "t [s]"; "" for none."""
    match = _UNIT.search(column)
    return match[1].strip() if match and re.search(r"[^\W\d]|[%°]", match[1]) else ""


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, or the mark of a pure number ("", "-", "1"). Without Pint, any text without
    digits and blanks counts."""
    try:
        return text in ("", "-", "1") or _parsed(_registry(), text) is not None
    except NotInstalled:
        return re.search(r"[\d\s]", text) is None


def converted(log: Table, column: Column, name: str, text: str, unit: str) -> tuple[Table, Column, str]:
    """Return the log with a note on the conversion; the `column` converted to `unit`, that of the signal `name`; and
    its operand in an expression of columns. `text`: the column's name, or an expression, which is not converted.
    Raises: `BadRecord` if the units have no conversion."""
    plain = operand(log, text)
    if text not in log.header:
        read = [log.column(each) for each in dict.fromkeys(words_of(text)) if log.header.count(each) == 1]
        others = [f"{one.name!r} in {one.unit}" for one in read if one.unit and _normal(one.unit) != _normal(unit)]
        notes = [f"{name}: the expression {text!r} reads {', '.join(others)}, as it is"] * bool(others)
        return replace(log, notes=(*log.notes, *notes)), column, plain
    try:
        change = conversion(name, column.unit, unit)
    except Inconvertible as error:
        fix = f"rename it, or take its numbers as they are, by an expression such as 1*{plain}"
        raise BadRecord(log.path, f"the column {text!r} {error}; {fix}") from None
    if isinstance(change, str):
        return (replace(log, notes=(*log.notes, change)) if change else log), column, plain
    log = replace(log, notes=(*log.notes, change.note))
    return log, replace(column, values=change.factor * column.values + change.offset), change.operand(plain)


def conversion(name: str, source: str, unit: str) -> Conversion | str:
    """Return the conversion of a column in the unit `source` to the `unit` of the signal `name`; if the units are equal
    or cannot be compared, a note instead, which may be "". Raises: `Inconvertible` for units of different kinds."""
    if not source or not unit or _normal(source) == _normal(unit):
        return ""
    try:
        registry = _registry()
    except NotInstalled as error:
        return f"{name}: the unit of its column, {source}, is not compared with the model's, {unit}, since {error}"
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
    """Return the name of the signal with this name; "u" and "y" also name the only input and the only output; None for
    no signal."""
    names = [s.name for s in (*inputs, *outputs)]
    single = {"u": inputs, "y": outputs}
    if key not in names and len(single.get(key, ())) == 1:
        return str(single[key][0].name)
    return key if key in names else None


def of_signals(
    path: str, option: str, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> Iterator[tuple[str, str, str]]:
    """Yield the parts of texts "SIGNAL=WHAT" of a command-line option, several of which may be separated by commas: the
    option with its text, the signal's name and WHAT. `path`: the log's, for errors. Raises: `BadRecord` for the name of
    no signal."""
    for text in (part for each in texts for part in each.split(",")):
        key, _, what = (part.strip() for part in text.partition("="))
        name = signal_named(key, inputs, outputs)
        if name is None:
            listed = ", ".join(s.name for s in (*inputs, *outputs))
            raise BadRecord(path, f"{option} {text!r} names no signal; the signals are {listed}")
        yield f"{option} {text!r}", name, what


def shifts_of(path: str, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> dict[str, int]:
    """Return shifts in samples by name of the signal, from texts "SIGNAL=SAMPLES", several of which may be separated by
    commas. `path`: the log's, for errors. Raises: `BadRecord`."""
    shifts: dict[str, int] = {}
    for option, name, number in of_signals(path, "--shift", texts, inputs, outputs):
        if name in shifts:
            raise BadRecord(path, f"--shift gives {name} twice; leave one of them out")
        try:
            shifts[name] = int(number)
        except ValueError:
            reason = f"{option} must read SIGNAL=SAMPLES, a whole number, such as u=1 for one sample later"
            raise BadRecord(path, reason) from None
    return shifts


def mapping(
    path: str, assignments: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, str]:
    """Return the column name of each signal, from texts "SIGNAL=COLUMN", by default the name of the signal.

    "u" and "y" also name the only input and the only output. `path`: the log's, for errors. Raises: `BadRecord`.
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
