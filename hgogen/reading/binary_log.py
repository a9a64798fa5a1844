"""Columns of DataFrames, Parquet, MAT, ULog and MDF files, by pandas, SciPy, pyulog and asammdf; sheets as text.

A damaged file can crash the process that reads it. So this module also runs as a program: its argument is the kind of
the file, it reads the file from standard input and writes an .npz: the names of the columns, their clocks and units,
and then the array of each.
It imports nothing of the package, so that it starts fast.
"""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

MEMORY = 4 << 30  # bytes of address space beyond those of the file
SECONDS = 600.0
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")  # each thread allocates memory
FAILED, UNSUPPORTED = 3, 4  # exit statuses
Arrays = dict[str, np.ndarray]


class Damaged(ValueError):
    """The error that a log file could not be read; its text gives the reason."""


class Unsupported(ValueError):
    """The error that a file has a version of its format that cannot be read."""


@dataclass(frozen=True)
class Columns:
    """The columns of a log file. `arrays`: the values (N,) of each column by name; `clocks`: for a column with its own
    times, the name of the column of these times, in s; `units`: the unit of a column, where the file has one."""

    arrays: Arrays
    clocks: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)


def columns_of(kind: str, content: bytes, seconds: float = SECONDS) -> Columns:
    """Return the columns of a binary log file with this `content`, of the `kind` "parquet", "mat", "xlsx", "ulog" or
    "mdf". It is read in a process of its own, with limited memory, for at most `seconds`. Raises: `Damaged`;
    `Unsupported`."""
    command = [sys.executable, "-P", __file__, kind]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **dict.fromkeys(_THREADS, "1")}
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, env={**os.environ, **environment}, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        raise Damaged(f"that took more than {seconds:g} s") from None
    if done.returncode == UNSUPPORTED:
        raise Unsupported
    message = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    if done.returncode == FAILED:
        raise Damaged(message)
    if done.returncode:
        status = f"status {done.returncode}" if done.returncode > 0 else signal.Signals(-done.returncode).name
        ended = f"{status}{message and f': {message}'}"
        raise Damaged(f"the process that read it ended ({ended}), so that the file may be damaged")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as parts:
        names, clocks, units, *arrays = parts.values()
    listed = list(map(str, names))
    by_name = [{name: str(text) for name, text in zip(listed, texts, strict=True) if text} for texts in (clocks, units)]
    return Columns(dict(zip(listed, arrays, strict=True)), *by_name)


def frame_columns(frame: Any) -> Arrays:
    """Return the columns of a DataFrame by name, together with its index if this has a name or holds times. Numbers and
    times keep their numpy type, with NaN for a missing number; all other values become texts, "" where one is missing.
    Raises: `ValueError` for several columns of one name."""
    if not frame.columns.is_unique:
        raise ValueError("has several columns of one name; rename all but one")
    columns, index = {str(name): frame[name] for name in frame.columns}, frame.index
    if index.nlevels == 1 and (index.name is not None or index.dtype.kind in "Mm"):
        columns.setdefault("index" if index.name is None else str(index.name), index)
    return {name: _plain(values.to_numpy(), values.isna()) for name, values in columns.items()}


def _plain(array: np.ndarray, missing: Any) -> np.ndarray:
    if array.dtype.kind != "O":
        return array
    pairs = list(zip(array.tolist(), missing, strict=True))
    if all(absent or isinstance(value, int | float) for value, absent in pairs):
        return np.array([np.nan if absent else value for value, absent in pairs], dtype=float)
    return np.array(["" if absent else str(value) for value, absent in pairs], dtype=object)


def _parquet(stream: io.BytesIO) -> Columns:
    import pandas

    arrays = frame_columns(pandas.read_parquet(stream, engine="pyarrow", use_threads=False))
    return Columns({name: array.astype(str) if array.dtype.kind == "O" else array for name, array in arrays.items()})


def _mat(stream: io.BytesIO) -> Columns:
    from scipy.io import loadmat

    variables = loadmat(stream, simplify_cells=True)
    return Columns(
        dict(pair for name, value in variables.items() if name[:2] != "__" for pair in _vectors(name, value))
    )


def _xlsx(stream: io.BytesIO) -> Columns:
    """Return the first sheet with cells as a text of tabs, by its name."""
    import pandas

    sheets = pandas.read_excel(stream, sheet_name=None, header=None, dtype=object, engine="openpyxl")
    name = next((name for name, sheet in sheets.items() if len(sheet)), next(iter(sheets)))
    text = sheets[name].to_csv(sep="\t", header=False, index=False)
    return Columns({str(name): np.frombuffer(text.encode(), np.uint8)})


def _ulog(stream: io.BytesIO) -> Columns:
    from pyulog import ULog

    columns = Columns({})
    for topic in ULog(stream).data_list:
        name = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
        columns.arrays[f"{name} time"] = topic.data["timestamp"] * 1e-6
        for part, array in topic.data.items():
            columns.arrays[f"{name}.{part}"], columns.clocks[f"{name}.{part}"] = array, f"{name} time"
    return columns


def _mdf(stream: io.BytesIO) -> Columns:
    from asammdf import MDF

    columns = Columns({})
    with MDF(stream) as file:
        for number, group in enumerate(file.groups):
            masters = file.masters_db.get(number)
            wanted = [(None, number, k) for k, _ in enumerate(group.channels) if k != masters]
            for signal in file.select(wanted) if wanted else ():
                if signal.samples.ndim == 1 and signal.samples.dtype.kind in "iufb" and len(signal.samples):
                    name = signal.name if signal.name not in columns.arrays else f"{signal.name} of group {number}"
                    columns.arrays[f"group {number} time"] = signal.timestamps
                    columns.arrays[name], columns.clocks[name] = signal.samples, f"group {number} time"
                    columns.units[name] = signal.unit
    return columns


_READERS = {"parquet": _parquet, "mat": _mat, "xlsx": _xlsx, "ulog": _ulog, "mdf": _mdf}


def _vectors(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, dict):
        for part, inner in value.items():
            yield from _vectors(f"{name}.{part}", inner)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "iufb" and value.size > 1:
        if value.ndim == 1:
            yield name, value
        elif value.ndim == 2:
            yield from ((f"{name}(:,{k})", column) for k, column in enumerate(value.T, 1))


def main() -> None:
    """Read a binary log from standard input and write its columns to standard output: the process that `columns_of`
    starts."""
    content = sys.stdin.buffer.read()
    try:
        import resource
    except ImportError:  # a system that cannot limit the memory of a process
        pass
    else:
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = MEMORY + len(content)
        resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    try:
        columns = _READERS[sys.argv[1]](io.BytesIO(content))
    except NotImplementedError:
        sys.exit(UNSUPPORTED)
    except Exception as error:  # the libraries' errors, of several kinds
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        memory_error = f"it asks for more than {MEMORY >> 30} GiB of memory"
        print(memory_error if isinstance(error, MemoryError) else reason, file=sys.stderr)
        sys.exit(FAILED)
    names = list(columns.arrays)
    texts = (np.array([each.get(name, "") for name in names], dtype=str) for each in (columns.clocks, columns.units))
    np.savez(sys.stdout.buffer, np.array(names, dtype=str), *texts, *columns.arrays.values())


if __name__ == "__main__":
    main()
