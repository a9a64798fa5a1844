"""Records that are no CSV: DataFrames, Parquet and MAT files; a run as a DataFrame."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_cli import hgogen

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.logs.records import BadSignal
from hgogen.model import load
from hgogen.reading import binary_log
from hgogen.reading.log import BadRecord, column_of, log_of
from hgogen.reading.measured import read
from hgogen.registry import NotInstalled
from hgogen.run.samples import BadShape

pandas = pytest.importorskip("pandas")
NAN = np.nan
T = np.arange(200) * 0.01
ANGLE = np.exp(-0.05 * T) * np.cos(4.3 * T)


def frame() -> Any:
    return pandas.DataFrame({"t": T, "angle (deg)": np.degrees(ANGLE), "tau": 0.0})


def written(folder: Path, kind: str) -> Path:
    path = folder / f"log.{kind}"
    if kind == "parquet":
        pytest.importorskip("pyarrow")
        frame().to_parquet(path)
    elif kind == "mat":
        io = pytest.importorskip("scipy.io")
        io.savemat(path, {"t": T, "angle": np.degrees(ANGLE)[:, None], "tau": 0 * T, "comment": "a swing", "k": 3.0})
    else:
        frame().to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def step() -> CallableStep:
    return load("pendulum").step("riccati").rebuilt(dt=0.01)


@pytest.mark.ordinary("csv", "mat")
@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
@pytest.mark.usefixtures("undrawn")
def test_every_kind_of_file_gives_one_record(kind: str, tmp_path: Path, step: CallableStep) -> None:
    path = written(tmp_path, kind)
    name = "angle" if kind == "mat" else "[angle (deg)]"
    got = hg.record(path, load("pendulum").plant, time="t", columns={"y": f"pi/180*{name}"}, dt=0.01)
    assert got.dt == 0.01
    np.testing.assert_allclose(got.y[:, 0], ANGLE, atol=1e-12)
    np.testing.assert_array_equal(got.u, 0)
    words = ("run", "pendulum", "--data", str(path), "--time", "t", "--dt", "0.01", "--map", f"y=pi/180*{name}")
    answer = json.loads(hgogen(*words, "-o", str(tmp_path), "--json")[0])
    assert answer["record"]["samples"] == 200


def test_a_data_frame_is_a_record_and_what_a_step_takes(step: CallableStep) -> None:
    log = hg.record(frame(), load("pendulum").plant, time="t", columns={"y": "pi/180*[angle (deg)]"})
    step.reset()
    run = step.run(u=log.u, y=log.y)
    step.reset()
    same = step.run(u=frame(), y=pandas.DataFrame({"y": log.y[:, 0], "more": "text"}))
    np.testing.assert_array_equal(run.x, same.x)
    with pytest.raises(BadShape, match="has no column y; its columns are t, angle"):
        step.run(u=frame(), y=frame())


def test_a_run_is_a_data_frame(step: CallableStep) -> None:
    step.reset()
    run = step.run(u=np.zeros(200), y=ANGLE)
    table = run.frame()
    assert list(table.columns) == ["q", "w", "status", "e_y", "s_y"]
    assert table.index.name == "t"
    np.testing.assert_array_equal(table["w"], run["w"])
    np.testing.assert_array_equal(table["e_y"], run.innovations[:, 0])
    assert len(run.since(50).frame()) == 150
    plain = load("pendulum").step("high_gain").run(u=np.zeros(9), y=ANGLE[:9]).frame()
    assert list(plain.columns) == ["q", "w", "status", "e_y"]


def test_columns_of_every_kind_are_numbers_or_none() -> None:
    log = log_of(
        pandas.DataFrame(
            {
                "whole": [1, 2, 3],
                "maybe": pandas.array([1, None, 3], dtype="Int64"),
                "flag": [True, False, True],
                "gap": [1.5, np.nan, np.inf],
                "mixed": ["1,5", "x", None],
                "span": pandas.to_timedelta([0, 1500, None], unit="ms"),
            }
        )
    )
    values = {name: column_of(log, name).values.tolist() for name in log.header}
    assert values["whole"] == [1, 2, 3]
    assert values["flag"] == [1, 0, 1]
    np.testing.assert_array_equal(values["maybe"], [1, NAN, 3])
    np.testing.assert_array_equal(values["gap"], [1.5, NAN, NAN])
    np.testing.assert_array_equal(values["span"], [0, 1.5, NAN])
    assert (column_of(log, "gap").empty, column_of(log, "gap").not_numbers) == (1, 1)
    mixed = column_of(log, "mixed")
    assert (mixed.empty, mixed.not_numbers, mixed.example) == (1, 1, "x")


@pytest.mark.full
def test_dates_are_times(tmp_path: Path) -> None:
    dates = pandas.date_range("2026-01-01", periods=5, freq="250ms")
    for zone in (None, "Europe/Paris"):
        one = pandas.DataFrame({"y": range(5)}, index=dates.tz_localize(zone))
        got = read(one, {"y": "y"}, dt=0.25, time="index")
        np.testing.assert_allclose(got.t, np.arange(5) * 0.25, atol=1e-6)
        np.testing.assert_array_equal(got.values[:, 0], range(5))
    pytest.importorskip("pyarrow")
    pandas.DataFrame({"when": dates, "y": range(5)}).to_parquet(tmp_path / "a.parquet")
    got = read(tmp_path / "a.parquet", {"y": "y"}, dt=0.25, time="when")
    np.testing.assert_allclose(got.t, np.arange(5) * 0.25, atol=1e-6)


def test_a_mat_file_has_vectors_matrices_and_structs(tmp_path: Path) -> None:
    io = pytest.importorskip("scipy.io")
    values = {
        "S": {"a": np.arange(4.0), "b": {"c": np.arange(4)}},
        "X": np.arange(8.0).reshape(4, 2),
        "z": np.arange(3),
    }
    io.savemat(tmp_path / "a.mat", values)
    log = log_of(tmp_path / "a.mat")
    assert set(log.header) == {"S.a", "S.b.c", "X(:,1)", "X(:,2)"}
    assert log.notes == ("of another length than 4, left out: z",)
    assert column_of(log, "2*[X(:,2)] + [S.a]").values.tolist() == [2, 7, 12, 17]


@pytest.mark.full
def test_a_bad_file_is_a_sentence(tmp_path: Path) -> None:
    contents = {
        "new.mat": (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n", "save.*'-v7'"),
        "hdf.mat": (b"\x89HDF\r\n\x1a\n", "save.*'-v7'"),
        "bad.mat": (b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\xff" * 30, "cannot be read as a MAT file"),
        "bad.parquet": (b"PAR1 and no more", "cannot be read as a Parquet file"),
    }
    for name, (content, said) in contents.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadRecord, match=said):
            log_of(tmp_path / name)
    pytest.importorskip("scipy.io").savemat(tmp_path / "none.mat", {"text": "nothing"})
    with pytest.raises(BadRecord, match="holds no vector"):
        log_of(tmp_path / "none.mat")
    with pytest.raises(BadRecord, match="is no log"):
        log_of(3)
    with pytest.raises(BadRecord, match="has no rows"):
        log_of(pandas.DataFrame({"y": []}))
    with pytest.raises(BadRecord, match="several columns of one name"):
        log_of(pandas.DataFrame([[1, 2]], columns=["y", "y"]))
    with pytest.raises(BadRecord, match="has no column 'x'; its columns are y"):
        column_of(log_of(pandas.DataFrame({"y": [1]})), "x")
    with pytest.raises(BadSignal, match="x is no signal; the signals are tau, y"):
        hg.record(frame(), load("pendulum").plant, time="t", columns={"x": "t"})


@pytest.mark.parametrize(
    ("name", "said"), [("pandas", "run.frame"), ("pyarrow.parquet", "Parquet"), ("scipy.io", "a MAT file")]
)
def test_what_is_not_installed_is_named_with_its_extra(
    name: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: CallableStep
) -> None:
    files = {kind: written(tmp_path, kind) for kind in ("parquet", "mat")}
    step.reset()
    asked = {
        "pandas": lambda: step.run(u=[0.0], y=[0.1]).frame(),
        "pyarrow.parquet": lambda: log_of(files["parquet"]),
        "scipy.io": lambda: log_of(files["mat"]),
    }
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(NotInstalled, match=rf'{said}.* needs .*pip install "hgogen\[logs\]"'):
        asked[name]()


@pytest.mark.ordinary(
    "os.kill(os.getpid(), signal.SIGSEGV)-that read it ended \\\\(SIGSEGV\\\\), so that the file may be damaged",
    "os._exit(7)-the process that read it ended \\\\(status 7\\\\)",
)
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", r"that read it ended \(SIGSEGV\), so that the file may be damaged"),
        ("os._exit(7)", r"the process that read it ended \(status 7\)"),
        ("print('one\\nwhy', file=sys.stderr, flush=True); os._exit(1)", r"ended \(status 1: why\)"),
        ("time.sleep(600)", "that took more than 2 s"),
        ("bytearray(1 << 40)", "it asks for more than 4 GiB of memory"),
        ("print('noise', file=sys.stderr); raise KeyError", "KeyError"),
        ("raise ValueError('first\\nsecond')", "^first$"),
    ],
)
def test_a_reader_that_crashes_or_hangs_ends_its_own_process_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, said: str
) -> None:
    """In the place of SciPy's, a reader that does what SciPy's does on some damaged files."""
    (tmp_path / "scipy").mkdir()
    (tmp_path / "scipy" / "__init__.py").touch()
    text = f"import os, signal, sys, time\ndef loadmat(*_, **__):\n    {body}\n"
    (tmp_path / "scipy" / "io.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(binary_log.Damaged, match=said):
        binary_log.columns_of("mat", b"", seconds=2 if "sleep" in body else 600)
