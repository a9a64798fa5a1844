"""Logs that are no text: DataFrames, Parquet files and MAT files, as tables of columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hgogen.reading.binary_log import Damaged, Unsupported, columns_of, is_missing, plain
from hgogen.reading.log import BadRecord, Column, Table, bytes_of, parsed, table
from hgogen.reading.optional import library

PARQUET, MAT, HDF = b"PAR1", b"MATLAB 5.0", (b"MATLAB 7.3", b"\x89HDF")
_OLD = "is a MAT file of version 7.3, which is HDF5; save it again by save('log.mat', '-v7')"


@dataclass(frozen=True)
class Columns(Table):
    """A table whose columns (N,) are arrays; its rows hold no cells."""

    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    def column(self, name: str) -> Column:
        """The column of that name; a missing value is an empty cell. Raises: `BadRecord`."""
        if name not in self.arrays:
            raise BadRecord(self.path, self.no_column(name))
        array = self.arrays[name]
        if array.dtype.kind in "iufb":
            values = array.astype(float)
            blank = np.isnan(values)
            return Column(name, np.where(np.isfinite(values), values, np.nan), blank, "")
        if array.dtype.kind == "m":  # spans of time, in seconds
            values = np.where(np.isnat(array), np.nan, array / np.timedelta64(1, "s"))
            return Column(name, values, np.isnan(values), "")
        return parsed(name, self.cells(name), self.decimal_comma)

    def cells(self, name: str) -> Sequence[str]:
        """Each value as text, "" where there is none."""
        array = self.arrays[name]
        if array.dtype.kind == "M":
            return ["" if text == "NaT" else text for text in np.datetime_as_string(array.astype("datetime64[us]"))]
        return ["" if is_missing(value) else str(value) for value in array.tolist()]


def log_of(source: Any) -> Table:
    """The table of a path, whatever kind of file it is, or of a DataFrame.

    Raises: `BadRecord`; `NotInstalled` for a file whose library is not there.
    """
    if isinstance(source, Table):
        return source
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        return of_frame(source)
    if not isinstance(source, str | Path):
        raise BadRecord(f"a {type(source).__name__}", "is no log; give the path of a file, or a DataFrame")
    content = bytes_of(Path(source))
    if content.startswith(PARQUET):
        return _parquet(str(source), content)
    if content.startswith(HDF):
        raise BadRecord(str(source), _OLD)
    if content.startswith(MAT) or (Path(source).suffix.lower() == ".mat" and b"\0" in content[:128]):
        return _mat(str(source), content)
    return table(source, content)


def of_frame(frame: Any) -> Table:
    """A DataFrame's columns by their names as text, with its index where that has a name or holds times."""
    arrays = {str(name): plain(frame[name].to_numpy()) for name in frame.columns if frame.columns.is_unique}
    if not frame.columns.is_unique:
        raise BadRecord("the DataFrame", "has several columns of one name; rename all but one")
    index = frame.index
    if getattr(index, "nlevels", 1) == 1 and (index.name is not None or index.dtype.kind in "Mm"):
        arrays.setdefault(str(index.name) if index.name is not None else "index", plain(index.to_numpy()))
    return _columns("the DataFrame", arrays, ())


def _columns(path: str, arrays: Mapping[str, np.ndarray], notes: tuple[str, ...]) -> Table:
    rows = len(next(iter(arrays.values()), ()))
    if not rows:
        raise BadRecord(path, "has no rows")
    return Columns(path, tuple(arrays), (), rows, 0, False, notes, dict(arrays))


def _parquet(path: str, content: bytes) -> Table:
    library("pyarrow.parquet", f"{path}, a Parquet file,")
    try:
        return _columns(path, columns_of("parquet", content), ())
    except Damaged as error:
        raise BadRecord(path, f"cannot be read as Parquet: {error}") from None


def _mat(path: str, content: bytes) -> Table:
    """The vectors of the most frequent length."""
    library("scipy.io", f"{path}, a MAT file,")
    try:
        arrays = columns_of("mat", content)
    except Unsupported:
        raise BadRecord(path, _OLD) from None
    except Damaged as error:
        raise BadRecord(path, f"cannot be read as a MAT file: {error}") from None
    lengths = [len(array) for array in arrays.values()]
    if not lengths:
        fix = "save vectors, a table by table2struct(T, 'ToScalar', true)"
        raise BadRecord(path, f"holds no vector or matrix of real numbers; {fix}")
    rows = max(set(lengths), key=lambda length: (lengths.count(length), length))
    others = [name for name, array in arrays.items() if len(array) != rows]
    notes = (f"of another length than {rows}, left out: {', '.join(others)}",) if others else ()
    return _columns(path, {name: array for name, array in arrays.items() if len(array) == rows}, notes)
