"""Logs that a library reads: Excel, ULog and MDF files, and times of MAT and Parquet files as expressions."""

import struct
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from hgogen.reading.cells import BadRecord
from hgogen.reading.log import log_of
from hgogen.reading.measured import Record, read
from hgogen.signal import Signal

T = np.arange(40) * 0.05
Y, U = np.sin(T), np.cos(T)
SIGNALS = {"y": Signal("y", "rad"), "u": Signal("u", "V")}


def xlsx(path: Path) -> dict[str, str]:
    pandas, _ = pytest.importorskip("pandas"), pytest.importorskip("openpyxl")
    start = datetime(2026, 3, 31, 23, 59, 59)
    rows = [["Rig 7", None, None], ["Time", "y (deg)", "u"]]
    rows += [[start + timedelta(seconds=t), np.degrees(y), u] for t, y, u in zip(T.tolist(), Y, U, strict=True)]
    pandas.DataFrame(rows).to_excel(path, header=False, index=False)
    return {"time": "Time", "y": "y (deg)", "u": "u"}


def ulog(path: Path) -> dict[str, str]:
    """The messages B, F, A and D of https://docs.px4.io/main/en/dev_log/ulog_file_format.html."""
    pytest.importorskip("pyulog")

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<Hc", len(content), kind) + content

    text = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for name in ("angle", "drive"):
        text += message(b"F", f"{name}:uint64_t timestamp;float value;float[2] more;".encode())
    text += message(b"A", struct.pack("<BH", 0, 0) + b"angle") + message(b"A", struct.pack("<BH", 0, 1) + b"drive")
    for t, y, u in zip(T, Y, U, strict=True):
        stamp = 5_000_000 + round(1e6 * t)
        text += message(b"D", struct.pack("<HQfff", 0, stamp, y, 0, y))
        text += message(b"D", struct.pack("<HQfff", 1, stamp, u, 0, u))
    path.write_bytes(text)
    return {"time": "time", "y": "angle.value", "u": "[drive.more[1]]"}


def mdf(path: Path) -> dict[str, str]:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(np.degrees(Y), T, name="angle", unit="deg")])
        file.append([asammdf.Signal(1000 * U, T, name="drive", unit="mV")])
        file.save(path.with_suffix(".mf4"), overwrite=True).replace(path)
    return {"time": "time", "y": "angle", "u": "drive"}


def mat(path: Path) -> dict[str, str]:
    io = pytest.importorskip("scipy.io")
    io.savemat(path, {"X": np.column_stack([1000 * T, Y, U])})
    return {"time": "[X(:,1)]/1000", "y": "X(:,2)", "u": "[X(:,3)]"}


def parquet(path: Path) -> dict[str, str]:
    pandas, _ = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    pandas.DataFrame({"t ms": 1000 * T, "y": Y, "u": U}).to_parquet(path)
    return {"time": "[t ms]/1000", "y": "y", "u": "u"}


def got(path: Path, columns: dict[str, str]) -> Record:
    time, *_ = columns.values()
    return read(path, {name: columns[name] for name in ("y", "u")}, dt=None, time=time, signals=SIGNALS)


@pytest.mark.full
@pytest.mark.parametrize("write", [xlsx, ulog, mdf, mat, parquet])
def test_a_file_of_a_library_is_a_log(write: Callable[[Path], dict[str, str]], tmp_path: Path) -> None:
    path = tmp_path / f"log.{write.__name__}"
    columns = write(path)
    one = got(path, columns)
    assert one.report.dt == pytest.approx(0.05)
    np.testing.assert_allclose(one.values, np.column_stack([Y, U]), atol=1e-6)


@pytest.mark.full
def test_columns_of_two_clocks_are_joined_by_time(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    path, slow = tmp_path / "log.mf4", T[::4] + 0.01
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(Y, T, name="y")])
        file.append([asammdf.Signal(np.arange(10.0), slow, name="u")])
        file.save(path, overwrite=True)
    one = read(path, {"y": "y", "u": "u"}, dt=0.05, time="time")
    np.testing.assert_allclose(one.values[:, 0], Y)
    np.testing.assert_array_equal(one.values[::4, 1], np.arange(10.0))
    assert np.isnan(np.delete(one.values[:, 1], np.s_[::4])).all()
    assert "the columns have 2 clocks: each has its samples in the rows of its own" in one.report.notes
    with pytest.raises(BadRecord, match="has none of the columns given; its columns are time, y, u"):
        log_of(path, ("z",))


def test_a_damaged_file_is_a_sentence(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    path = tmp_path / "log.xlsx"
    path.write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(BadRecord, match="cannot be read as an Excel file"):
        log_of(path)
