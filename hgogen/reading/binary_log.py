"""Columns of DataFrames, Parquet and MAT files, by pandas and SciPy.

A damaged file can crash the process that reads it. So this module also runs as a program: its argument is the kind of
the file, it reads the file from standard input and writes an .npz, the names of the columns and then the array of each.
It imports nothing of the package, so that it starts fast.
"""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

MEMORY = 4 << 30  # bytes of address space beyond those of the file
SECONDS = 600.0
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")  # each thread allocates memory
FAILED, UNSUPPORTED = 3, 4  # exit statuses
Arrays = dict[str, np.ndarray]


class Damaged(ValueError):
    """A file that could not be read; the text says why."""


class Unsupported(ValueError):
    """A version of a file format that cannot be read."""


def columns_of(kind: str, content: bytes, seconds: float = SECONDS) -> Arrays:
    """Return the columns (N,) by name of a "mat" or "parquet" file. Raises: `Damaged`; `Unsupported`."""
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
        names, *arrays = parts.values()
    return dict(zip(map(str, names), arrays, strict=True))


def frame_columns(frame: Any) -> Arrays:
    """Return the columns of a DataFrame by name, with its index if that has a name or holds times. Numbers and times
    keep their numpy type, with NaN for a missing number; all other values become texts, "" where one is missing.
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


def _read(kind: str, content: bytes) -> Arrays:
    if kind == "parquet":
        import pandas

        arrays = frame_columns(pandas.read_parquet(io.BytesIO(content), engine="pyarrow", use_threads=False))
        return {name: array.astype(str) if array.dtype.kind == "O" else array for name, array in arrays.items()}
    from scipy.io import loadmat

    variables = loadmat(io.BytesIO(content), simplify_cells=True)
    return dict(pair for name, value in variables.items() if name[:2] != "__" for pair in _vectors(name, value))


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
    """Read a file from standard input and write its columns to standard output."""
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
        arrays = _read(sys.argv[1], content)
    except NotImplementedError:
        sys.exit(UNSUPPORTED)
    except Exception as error:  # the libraries' errors, of several kinds
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        memory_error = f"it asks for more than {MEMORY >> 30} GiB of memory"
        print(memory_error if isinstance(error, MemoryError) else reason, file=sys.stderr)
        sys.exit(FAILED)
    np.savez(sys.stdout.buffer, np.array([*arrays], dtype=str), *arrays.values())


if __name__ == "__main__":
    main()
