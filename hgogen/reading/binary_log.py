"""The columns of Parquet and MAT files, read by a process of its own: a damaged file can end the one that reads it.

As a program, with a kind as its argument, it reads a file from the standard input and writes a line of JSON, the names
of the columns, and then the array of each. It imports nothing of the package, so that it starts fast.
"""

import io
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

MEMORY = 4 << 30  # bytes of address space beyond those of the file
SECONDS = 600.0
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")  # each of them asks for memory
FAILED, UNSUPPORTED = 3, 4  # exit statuses
Arrays = dict[str, np.ndarray]


class Damaged(ValueError):
    """A file that could not be read; the text says why."""


class Unsupported(ValueError):
    """A file of a version that is not read."""


def columns_of(kind: str, content: bytes, seconds: float = SECONDS) -> Arrays:
    """The columns (N,) by name of a file of that kind, "mat" or "parquet": texts, times or numbers.

    Raises: `Damaged`; `Unsupported`.
    """
    command = [sys.executable, "-P", __file__, kind]
    own = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **dict.fromkeys(_THREADS, "1")}
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, env={**os.environ, **own}, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        raise Damaged(f"that took more than {seconds:g} s") from None
    if done.returncode == UNSUPPORTED:
        raise Unsupported
    said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    if done.returncode == FAILED:
        raise Damaged(said)
    if done.returncode:
        status = f"status {done.returncode}" if done.returncode > 0 else signal.Signals(-done.returncode).name
        ended = f"{status}{said and f': {said}'}"
        raise Damaged(f"the process that read it ended ({ended}), so that the file may be damaged")
    stream = io.BytesIO(done.stdout)
    return {name: np.load(stream, allow_pickle=False) for name in json.loads(stream.readline())}


def plain(values: Any) -> np.ndarray:
    """An array of numpy's own kinds: of numbers with missing ones, NaN there."""
    array: np.ndarray = np.asarray(values)
    if array.dtype.kind == "O":
        known = [math.nan if is_missing(value) else value for value in array.tolist()]
        if all(isinstance(value, int | float) for value in known):
            return np.array(known, dtype=float)
    return array


def is_missing(value: Any) -> bool:
    """Whether a value stands for none."""
    return value is None or (isinstance(value, float) and math.isnan(value)) or str(value) in ("NaT", "<NA>")


def texts(array: np.ndarray) -> list[str]:
    """Each value as text, "" where there is none."""
    return ["" if is_missing(value) else str(value) for value in array.tolist()]


def _parquet(content: bytes) -> Arrays:
    from pyarrow import parquet

    whole = parquet.read_table(io.BytesIO(content), use_threads=False)
    arrays = {name: plain(whole.column(k).to_numpy()) for k, name in enumerate(whole.column_names)}
    for name, array in arrays.items():
        if array.dtype.kind == "O":
            arrays[name] = np.array(texts(array), dtype=str)
    return arrays


def _mat(content: bytes) -> Arrays:
    """The vectors, of structs too, as S.x, and the columns of matrices, as X(:,1)."""
    from scipy.io import loadmat

    variables = loadmat(io.BytesIO(content), squeeze_me=False, struct_as_record=True)
    named = {name: value for name, value in variables.items() if not name.startswith("__")}
    return dict(pair for name, value in named.items() for pair in _vectors(name, value))


def _vectors(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    if not isinstance(value, np.ndarray):  # as a sparse matrix
        return
    if value.dtype.names and value.size == 1:
        for part in value.dtype.names:
            yield from _vectors(f"{name}.{part}", np.atleast_2d(value.ravel()[0][part]))
    elif value.dtype.kind in "iufb" and value.ndim == 2 and value.size > 1:
        if 1 in value.shape:
            yield name, value.ravel()
        else:
            yield from ((f"{name}(:,{k})", column) for k, column in enumerate(value.T, 1))


_READERS: Mapping[str, Callable[[bytes], Arrays]] = {"mat": _mat, "parquet": _parquet}


def main() -> None:
    """The program."""
    content = sys.stdin.buffer.read()
    _bound(len(content))
    try:
        arrays = _READERS[sys.argv[1]](content)
    except NotImplementedError:
        sys.exit(UNSUPPORTED)
    except MemoryError:
        _fail(f"it asks for more than {MEMORY >> 30} GiB of memory")
    except Exception as error:  # the libraries' own, of several kinds
        _fail(next(iter(str(error).splitlines()), "") or type(error).__name__)
    sys.stdout.buffer.write(json.dumps([*arrays]).encode() + b"\n")
    for array in arrays.values():
        file = io.BytesIO()  # numpy asks a buffered file where it stands, which a pipe cannot tell
        np.save(file, array, allow_pickle=False)
        sys.stdout.buffer.write(file.getbuffer())


def _fail(reason: str) -> None:
    print(reason, file=sys.stderr)
    sys.exit(FAILED)


def _bound(size: int) -> None:
    """Bound the memory of this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = MEMORY + size
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


if __name__ == "__main__":
    main()
