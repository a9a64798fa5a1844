"""Reading logs, good and bad; predictions and noise from them."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.commands import running
from hgogen.reading import cells as cells_module
from hgogen.reading.cells import BadRecord, numbers_of
from hgogen.reading.log import _ragged, _regular, mapping, table
from hgogen.reading.measured import Record, read
from hgogen.run import consistency, prediction
from hgogen.run.prediction import predictions
from hgogen.run.samples import Run
from hgogen.trial import OrnsteinUhlenbeck, Trial, noisy, simulate

U, Y, Z = hg.Signal("pump"), hg.Signal("level"), hg.Signal("flow")


def log(folder: Path, text: str | bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def column(folder: Path, text: str | bytes, name: str = "y") -> list[float]:
    return table(log(folder, text)).column(name).values.tolist()


# --- the file -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "t,y\n0,1.5\n1,-2\n",
        "t;y\n0;1.5\n1;-2\n",
        "t;y\n0;1,5\n1;-2,0\n",
        "t\ty\n0\t1.5\n1\t-2\n",
        "t|y\n0|1.5\n1|-2",
        '"t","y",\r\n"0","1.5",\r\n"1","-2",\r\n',
        "\ufefft,y\n0,1.5\n1,-2\n",
        "# made by a logger\nt, y \n 0 , 1.5 \n\n1,-2\n\n",
        "# t,y\n0,1.5\n1,-2\n",
        "t,y\r0,15e-1\r1,-.2E+1\r",
        "t,y\n0,1.5,\n1,-2,,\n",
    ],
)
def test_a_log_is_read_whatever_wrote_it(tmp_path: Path, text: str):
    assert column(tmp_path, text) == [1.5, -2.0]
    assert column(tmp_path, text, "t") == [0.0, 1.0]


def test_other_encodings(tmp_path: Path):
    assert column(tmp_path, "t,y\n0,1\n".encode("utf-16")) == [1.0]
    latin = table(log(tmp_path, "t,Höhe\n0,1\n".encode("latin-1")))
    assert latin.column("Höhe").values.tolist() == [1.0]
    assert "Latin-1" in latin.notes[0]


def test_what_is_no_number_is_missing_and_counted(tmp_path: Path):
    cells = ["1", "", "nan", "NA", "inf", "1e999", "-Infinity", "err", "1_000", "0x10", "--", "1 2", "2"]
    parsed = table(log(tmp_path, "t,y\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells)))).column("y")
    assert np.flatnonzero(np.isfinite(parsed.values)).tolist() == [0, 12]
    assert parsed.empty == 3
    assert parsed.not_numbers == 8
    assert parsed.example == "nan"
    part = parsed.select_rows(np.array([0, 1, 2, 12]))
    assert (part.empty, part.not_numbers) == (1, 1)


def test_rows_of_another_length(tmp_path: Path):
    contents = table(log(tmp_path, "t,y\n0,1\n1\n2,2,99\n3,3,\n"))
    assert contents.malformed == 1
    assert contents.column("t").values.tolist() == [0.0, 1.0, 3.0]
    assert contents.column("y").empty == 1
    assert "fewer cells" in contents.notes[0]


def test_a_stray_quote_spoils_only_its_line(tmp_path: Path):
    values = column(tmp_path, 't,y\n0,1\n1,"2\n2,3\n')
    assert values[0::2] == [1.0, 3.0]
    assert len(values) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("# nothing\n", "is empty"),
        ("t,y\n", "header but no rows"),
        ("1,2\n3,4\n", "numbers in its first row"),
        ("t,y\n0,1,2\n1,2,3\n", "no row that fits"),
        (b"t,y\n0,\x00\n", "is no text"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "is no text"),
    ],
)
def test_a_bad_file_is_a_sentence(tmp_path: Path, text: str | bytes, said: str):
    with pytest.raises(BadRecord, match=r"log\.csv") as caught:
        table(log(tmp_path, text))
    assert said in str(caught.value)


def test_no_file_and_a_folder(tmp_path: Path):
    with pytest.raises(BadRecord, match="no such file"):
        table(tmp_path / "none.csv")
    with pytest.raises(BadRecord, match="is a folder"):
        table(tmp_path)


def test_columns_that_are_not_there(tmp_path: Path):
    contents = table(log(tmp_path, "time,level,y,y\n0,1,2,3\n"))
    with pytest.raises(BadRecord, match=r"its columns are time, level, y, y; did you mean 'level'\?"):
        contents.column("levle")
    with pytest.raises(BadRecord, match="2 columns named 'y'"):
        contents.column("y")


def cpu(function: Callable[[], Any]) -> float:
    """Processor time of a call in seconds, the least of two."""
    spent = []
    for _ in range(2):
        before = time.process_time()
        function()
        spent.append(time.process_time() - before)
    return min(spent)


@pytest.mark.ordinary("10-50000")
@pytest.mark.parametrize("rows", [50_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("missing", [0, 10])
def test_many_rows_are_read_in_the_time_of_a_split(tmp_path: Path, rows: int, missing: int):
    """Within eight times that of splitting the text and making numbers of its cells, whatever is missing; cell by cell
    it takes ten times as long."""
    level = np.round(np.sin(np.arange(rows)), 6)
    cells = ["" if missing and k % missing == 0 else f"{value:g}" for k, value in enumerate(level.tolist())]
    path = log(tmp_path, "t,y\n" + "".join(f"{k / 100:.2f},{cell}\n" for k, cell in enumerate(cells)))
    record = read(path, {"y": "y"}, dt=0.01, time="t")
    assert (record.report.rows, record.report.samples) == (rows, rows)
    expected = [float(cell or "nan") for cell in cells]
    assert np.array_equal(record.values[:, 0], expected, equal_nan=True)
    text = path.read_text()
    least = cpu(lambda: [float(cell or "nan") for line in text.splitlines()[1:] for cell in line.split(",")])
    assert cpu(lambda: read(path, {"y": "y"}, dt=0.01, time="t")) < 12 * least


CELL = st.sampled_from(["1", "-2.5", " 3e-4 ", "", "nan", "inf", "1e400", "1_000", "2d3", "-", "x", ".5", "5.", "1,5"])


@settings(deadline=None)
@given(st.lists(st.lists(CELL, min_size=2, max_size=2), min_size=1, max_size=6), st.sampled_from("\t;|"))
def test_rows_of_one_length_are_split_at_once_as_one_by_one(rows: list[list[str]], delimiter: str):
    lines = [delimiter.join(row) for row in rows]
    at_once, one_by_one = _regular(lines, delimiter, 2), _ragged(lines, delimiter, 2)
    assert at_once is not None
    assert [list(map(list, at_once[0])), *at_once[1:]] == [list(map(list, one_by_one[0])), *one_by_one[1:]]
    assert _regular([*lines, "1"], delimiter, 2) is None
    assert _regular([*lines, f'"1"{delimiter}2'], delimiter, 2) is None


@settings(deadline=None)
@given(st.lists(CELL.map(str.strip), max_size=30), st.integers(1, 8))
def test_cells_are_the_same_numbers_in_pieces_of_any_length(cells: list[str], length: int):
    """Pieces of one cell that is a number are read at once, those of another are not."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(cells_module, "PIECE", length)
        whole = numbers_of("y", cells)
    assert whole.values == pytest.approx(
        [float(c.replace("d", "e")) if c in ("1", "-2.5", "3e-4", "2d3", ".5", "5.") else math.nan for c in cells],
        nan_ok=True,
    )
    assert whole.blank.tolist() == [c in ("", "-") for c in cells]
    assert whole.example == next((c for c in cells if c in ("nan", "inf", "1_000", "x", "1,5")), "")


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(), st.floats(), st.integers(0, 2**32 - 1)), max_size=8), st.integers(1, 3))
def test_rows_are_written_in_ten_digits_and_empty_where_missing(rows: list[tuple[float, float, int]], length: int):
    numbers, status = np.array([row[:2] for row in rows]).reshape(-1, 2), np.array([row[2] for row in rows], int)
    cells = [["" if math.isnan(value) else f"{value:.10g}" for value in row] for row in numbers.tolist()]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(running, "PIECE", length)
        assert running._csv(["t", "a"], numbers) == "".join(f"{','.join(row)}\n" for row in [["t", "a"], *cells])
        behind = [f"{','.join(row)},{last}\n" for row, last in zip(cells, status.tolist(), strict=True)]
        assert running._csv(["t", "a", "status"], numbers, status) == "".join(["t,a,status\n", *behind])


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=100) | st.text('ty,;\t|"# \r\n01.e-', max_size=100).map(str.encode))
def test_no_file_makes_the_reader_fall(tmp_path_factory: pytest.TempPathFactory, content: bytes):
    path = log(tmp_path_factory.getbasetemp(), content)
    with suppress(BadRecord):
        contents = table(path)
        assert len(contents.columns) == len(contents.header)
        assert {len(column) for column in contents.columns} == {contents.rows}
        assert all(
            len(contents.column(name).values) == contents.rows
            for name in contents.header
            if contents.header.count(name) == 1
        )


# --- the mapping ----------------------------------------------------------------------------------------------


def test_mapping():
    assert mapping("log", (), (U,), (Y,)) == {"pump": "pump", "level": "level"}
    assert mapping("log", ("u=a b", "level = c=d"), (U,), (Y,)) == {"pump": "a b", "level": "c=d"}
    assert mapping("log", ("y=c",), (U,), (hg.Signal("y"),)) == {"pump": "pump", "y": "c"}


@pytest.mark.parametrize("text", ["pump", "pump=", "valve=3", "y=a"])
def test_a_bad_mapping_is_a_sentence(text: str):
    with pytest.raises(BadRecord, match="the signals are pump, level, flow"):
        mapping("log", (text,), (U,), (Y, Z))


@pytest.mark.parametrize("texts", [("pump=a", "pump=b"), ("pump=a", "u=a")])
def test_a_signal_mapped_twice_is_a_sentence(texts: tuple[str, str]):
    with pytest.raises(BadRecord, match="map pump twice"):
        mapping("log", texts, (U,), (Y,))


# --- the grid -------------------------------------------------------------------------------------------------


def test_missing_duplicated_and_unordered_rows(tmp_path: Path):
    text = "t,u,y\n10.0,1,1\n10.1,,2\n10.1,5,9\n10.3,3,bad\n10.2,2,3\n,7,7\n10.9,4,4\n"
    got = read(log(tmp_path, text), {"u": "u", "y": "y"}, dt=0.1, time="t")
    nan = math.nan
    expected = [[1, 1], [5, 2], [2, 3], [3, nan], *[[nan, nan]] * 5, [4, 4]]
    np.testing.assert_array_equal(got.values, expected)
    assert got.t == pytest.approx(10 + 0.1 * np.arange(10))
    report = got.report
    assert (report.rows, report.samples, report.period) == (7, 10, pytest.approx(0.1))
    assert (report.missing, report.not_numbers) == ({"u": 1, "y": 0}, {"u": 0, "y": 1})
    assert (report.covered, report.absent) == ({"u": 1, "y": 0}, {"u": 5, "y": 6})
    assert (report.untimed, report.out_of_order, report.duplicates, report.surplus) == (1, 1, 1, 0)
    assert (report.gaps, report.longest_gap, report.filled) == (1, pytest.approx(0.6), 5)
    said = "; ".join(report.sentences())
    for part in ("u (u): cells that are empty: 1", "no finite number: 1", "earlier than one before them: 1", "gaps"):
        assert part in said


def test_rows_go_to_the_nearest_grid_point(tmp_path: Path):
    got = read(log(tmp_path, "t,y\n0,1\n0.7,3\n1.1,2\n1.4,\n2.6,5\n"), {"y": "y"}, dt=1.0, time="t")
    np.testing.assert_array_equal(got.values[:, 0], [1, 2, np.nan, 5])
    assert (got.report.surplus, got.report.filled) == (2, 1)
    assert got.report.shift == pytest.approx(0.4)


def test_a_clean_record_says_nothing_but_its_size(tmp_path: Path):
    got = read(log(tmp_path, "y\n" + "1\n" * 50), {"y": "y"}, dt=0.02, period=0.02)
    assert got.report.sentences() == ("50 rows, one every 0.02 s, became 50 samples of 0.02 s",)
    assert got.t[-1] == pytest.approx(0.98)


def test_a_coarse_record_leaves_the_step_to_predict(tmp_path: Path):
    got = read(log(tmp_path, "y\n1\n2\n3\n"), {"y": "y"}, dt=0.5, period=1.0)
    np.testing.assert_array_equal(got.values[:, 0], [1, np.nan, 2, np.nan, 3])
    assert (got.report.gaps, got.report.filled) == (0, 2)


def test_cells_of_rows_without_a_time_are_not_counted(tmp_path: Path):
    report = read(
        log(tmp_path, "t,y\n0,1\n,\n,bad\n0.1,\n0.2,NaN\n0.3,4\n0.4,5\n"), {"y": "y"}, dt=0.1, time="t"
    ).report
    assert (report.untimed, report.missing, report.not_numbers) == (2, {"y": 1}, {"y": 1})
    assert (report.covered, report.absent) == ({"y": 0}, {"y": 2})
    assert "y (y): samples without a number, in all: 2" in report.sentences()


def test_a_cause_of_missing_samples_has_one_line(tmp_path: Path) -> None:
    """Cells without a number, and rows that are missing, which are not repeated for each signal."""
    cells = read(log(tmp_path, "t,y,z\n0,1,1\n0.1,x,1\n0.2,3,1\n"), {"y": "y", "z": "z"}, dt=0.1, time="t").report
    assert cells.sentences()[1:] == ("y (y): cells that are no finite number: 1, taken as missing samples",)
    rows = read(log(tmp_path, "t,y\n0,1\n0.1,1\n0.2,1\n0.3,1\n0.5,3\n"), {"y": "y"}, dt=0.1, time="t").report
    assert [line for line in rows.sentences() if "missing" in line or "without a number" in line] == [
        "grid points without a row: 1, given as missing samples"
    ]


def test_rows_without_a_period_have_none_in_the_report(tmp_path: Path) -> None:
    """And no advice to sample at it; times in another unit than dt stay in doubt."""
    times = np.cumsum(np.random.default_rng(0).uniform(0.2, 1.8, 60))
    text = "t,y\n" + "".join(f"{t:.6f},1\n" for t in times)
    (note,) = read(log(tmp_path, text), {"y": "y"}, dt=0.9, time="t").report.notes
    assert "without a period" in note
    first, second = read(log(tmp_path, text), {"y": "y"}, dt=1e-3, time="t").report.notes
    assert first.startswith("its rows are ")
    assert "times the step's dt, 0.001 s: are its times milliseconds?" in first
    assert second == note


@pytest.mark.parametrize(("period", "first"), [(0.01, 0.0), (0.004, 1.7e9), (1 / 3, 0.0), (1e-7, 5.0)])
def test_a_period_is_what_was_written(tmp_path: Path, period: float, first: float) -> None:
    """To the rounding of the times, which is no part of it; a third is cut where that begins."""
    times = [repr(first + k * period) for k in range(400)]
    got = read(
        log(tmp_path, "t,y\n" + "".join(f"{t},{k}\n" for k, t in enumerate(times))), {"y": "y"}, dt=None, time="t"
    )
    assert got.report.dt == (pytest.approx(period, rel=1e-12) if period == 1 / 3 else period)
    assert len(repr(got.report.dt)) <= len(repr(period))


@pytest.mark.parametrize("kind", ["uniform", "late", "dropped", "pauses", "first"])
def test_the_grid_of_a_clock_that_jitters_ends_where_its_rows_do(tmp_path: Path, kind: str) -> None:
    """The median of its steps is off by so much that the rows would lie some samples beside the grid at the end. A line
    through 3,000 times that are off by a tenth of a period is off by 0.1 sqrt(12/3000), some 0.006 periods, there."""
    draw, period = np.random.default_rng(3), 0.0103
    number = np.arange(3000)
    off = draw.exponential(0.1, 3000) if kind == "late" else draw.uniform(-0.12, 0.12, 3000)
    if kind == "pauses":
        number = number + 4567 * (number > 900) + 12 * (number > 2000)
    times = (number + off) * period + (1.7e9 if kind == "first" else 0.0)
    if kind == "dropped":
        times = times[draw.random(3000) > 0.2]
    rows = "".join(f"{float(t)!r},1\n" for t in times)
    report = read(log(tmp_path, "t,y\n" + rows), {"y": "y"}, dt=None, time="t").report
    assert abs(report.dt / period - 1) * 3000 < (0.5 if kind == "late" else 0.1)
    assert report.dt == float(f"{report.dt:.7g}")  # of which the last digit moves no row by 0.01 periods
    assert abs(float(np.median(np.diff(times))) / period - 1) * 3000 > 1


@pytest.mark.parametrize(
    ("period", "said"),
    [
        (0.1, None),
        (0.2, None),
        (0.05, None),
        (0.1005, None),
        (0.139, "is 1.39 times the step's dt, 0.1 s: rows and samples do not match; with --dt 0.139 (dt=)"),
        (0.08, "is 0.8 times the step's dt, 0.1 s: rows and samples do not match; with --dt 0.08 (dt=)"),
        (0.21, "is 2.1 times the step's dt, 0.1 s: between rows"),
        (0.02, "is 0.2 times the step's dt, 0.1 s: only the row nearest"),
        (100, "is 1000 times the step's dt, 0.1 s: are its times milliseconds?"),
    ],
)
def test_another_pace_than_the_steps_is_noted(tmp_path: Path, period: float, said: str | None):
    notes = read(log(tmp_path, "y\n" + "1\n" * 20), {"y": "y"}, dt=0.1, period=period).report.notes
    assert len(notes) == (said is not None)
    assert said is None or said in notes[0]


def test_a_file_that_is_not_there_is_said_before_what_is_asked_of_its_rows(tmp_path: Path) -> None:
    with pytest.raises(BadRecord, match="there is no such file"):
        read(tmp_path / "none.csv", {"y": "y"}, dt=0.1)


def test_a_record_of_one_sample_is_a_sentence(tmp_path: Path):
    for text in ("t,y\n5,1\n", "t,y\n5,1\n5,2\n5.04,3\n"):
        with pytest.raises(BadRecord, match=r"make 1 sample of 0\.1 s; give a log of at least 2"):
            read(log(tmp_path, text), {"y": "y"}, dt=0.1, time="t")


@pytest.mark.parametrize(
    ("times", "arguments", "said"),
    [
        ("0\n1\n", {}, "give either --time COLUMN or --period TIME, so that the rows have times; the columns are t, y"),
        ("0\n1\n", {"time": "t", "period": 1.0}, "give either"),
        ("0\n1\n", {"period": 0.0}, "positive number"),
        ("0\n1\n", {"period": math.nan}, "positive number"),
        ("0\n1\n", {"time": "clock"}, "no column 'clock'; its columns are t, y"),
        ("noon\nmidnight\n", {"time": "t"}, "such as 'noon'"),
        ("\n\n", {"time": "t"}, "2 empty ones"),
        ("0\n1e12\n", {"time": "t"}, "are they seconds, and is dt right? Where they are in another unit, name it"),
    ],
)
def test_bad_times_are_a_sentence(tmp_path: Path, times: str, arguments: dict, said: str):
    rows = "".join(f"{time},1\n" for time in times.split("\n")[:-1])
    with pytest.raises(BadRecord) as caught:
        read(log(tmp_path, "t,y\n" + rows), {"y": "y"}, dt=0.1, **arguments)
    assert said in str(caught.value)


def test_a_clock_in_milliseconds_is_asked_for_before_a_vast_grid_is_filled(tmp_path: Path):
    """3000 rows that are 1000 samples apart; 300 apart they may be, and so may a few with long pauses."""

    def samples(rows: int, pause: int) -> int:
        text = "t,y\n" + "".join(f"{pause * k},1\n" for k in range(rows))
        return read(log(tmp_path, text), {"y": "y"}, dt=1, time="t").report.samples

    with pytest.raises(BadRecord, match=r"span 2\.999e\+06 s, 3e\+06 samples of 1 s for 3000 rows; are they s"):
        samples(3000, 1000)
    assert samples(4000, 300) == 3999 * 300 + 1
    assert samples(100, 9000) == 99 * 9000 + 1


def test_a_signal_without_a_column_asks_for_the_mapping(tmp_path: Path):
    with pytest.raises(BadRecord, match="say --map level=COLUMN, one of t, y"):
        read(log(tmp_path, "t,y\n0,1\n"), {"level": "level"}, dt=0.1, time="t")


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        ("t,v\n0,1\n1,2\n", {"time": "t"}, "has no column 'y'; say columns={'y': COLUMN}, one of t, v"),
        ("t,y\n0,-\n1,-\n", {"time": "t"}, "holds no number for y; say columns={'y': COLUMN}"),
        ("t,y\n0,1\n1,2\n", {}, "give either time=COLUMN or period=TIME, so"),
        ("t,y\nnow,1\nthen,2\n", {"time": "t"}, "or say period=TIME"),
        ("t,y\n0,1\n1,2\n", {"time": "t", "columns": {"y": "2*z"}}, "the expression '2*z': "),
        ("t,y\n0,1\n1,2\n", {"time": "t", "columns": {"y": "2*3"}}, "the expression '2*3' reads no column"),
        ("t,y\n0,1\n1,2\n", {"time": "t", "shift": {"y": 2}}, "a shift of y by 2 leaves nothing of its 2 samples"),
    ],
)
def test_what_python_reads_is_refused_in_the_words_of_python(tmp_path: Path, text: str, words: dict, said: str):
    x, y = hg.Signal("x"), hg.Signal("y")
    plant = hg.System("tank", states=(x,), outputs=(y,), flow=[-x], output=[x])
    with pytest.raises(BadRecord) as caught:
        hg.record(log(tmp_path, text), plant, **words)
    assert said in str(caught.value)
    assert "--" not in str(caught.value)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 20), st.floats(-5, 5)), min_size=2, max_size=40))
def test_every_number_on_the_grid_was_measured_nearby(tmp_path_factory: pytest.TempPathFactory, rows):
    rows = [*rows, (25.0, 0.0)]  # a record of one sample is refused
    text = "t,y\n" + "".join(f"{t!r},{y!r}\n" for t, y in rows)
    got = read(log(tmp_path_factory.getbasetemp(), text), {"y": "y"}, dt=0.7, time="t")
    assert got.report.surplus + got.report.duplicates + got.report.samples - got.report.filled == len(rows)
    for t, y in zip(got.t, got.values[:, 0], strict=True):
        neighbours = [value for time, value in rows if abs(time - t) <= 0.35 + 1e-9]
        assert y in neighbours if np.isfinite(y) else not [v for time, v in rows if abs(time - t) < 0.35 - 1e-9]


# --- predictions ----------------------------------------------------------------------------------------------


def decaying(low: float | None = None, high: float | None = None) -> CallableStep:
    """x' = -x + u, an extended Kalman filter at dt = .1; y has the range [low, high]."""
    x, u = hg.Signal("x", low=-10, high=10), hg.Signal("u", low=-1, high=1)
    plant = hg.System(
        "tank", states=(x,), inputs=(u,), outputs=(hg.Signal("y", low=low, high=high),), flow=[-x + u], output=[x]
    )
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=(1.0,), R=1.0), dt=0.1)


def went(x: np.ndarray, status: int | list[int] = 0) -> Run:
    """A run with these estimates."""
    flags = np.broadcast_to(np.asarray(status, np.uint32), len(x))
    return Run(0.1 * np.arange(len(x)), x, ("x",), {}, flags, "python")


def test_predictions_of_the_exact_model():
    t = 0.1 * np.arange(60)
    u = np.sin(t)[:, None]
    y = 1.5 * np.exp(-t) + (np.sin(t) - np.cos(t)) / 2
    ticks: list[None] = []
    forecasts = predictions(decaying(), went(y[:, None]), u, y[:, None], (1, 5), lambda: ticks.append(None))
    assert len(ticks) == 5
    one, five, free = forecasts
    # The input on a line between samples is off by dt^2/8 |u''| at most; through x' = -x + u that much reaches x.
    assert max(one.model, five.model, free.model) < 0.1**2 / 8
    assert five.copying == pytest.approx(np.sqrt(np.mean((y[5:] - y[:-5]) ** 2)))
    assert [p.ahead for p in forecasts] == [1, 5, None]
    assert [p.count for p in forecasts] == [59, 55, 59]
    wrong = predictions(decaying(), went(y[:, None] + 1), u, y[:, None], (5,))[0]
    assert wrong.model == pytest.approx(math.exp(-0.5), abs=0.1**2 / 8)


def test_of_a_long_record_some_predictions_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """From one sample of each two, at random: a sensor that answers every second period only is met."""
    n = 4000
    y = np.random.default_rng().standard_normal((n, 1))
    y[1::2] = np.nan
    run, u = went(np.zeros((n, 1))), np.zeros((n, 1))
    every = predictions(decaying(), run, u, y, (1, 4))
    monkeypatch.setattr(prediction, "MOST", n // 2)
    some = predictions(decaying(), run, u, y, (1, 4))
    assert [one.count for one in every] == [n // 2 - 1, n // 2 - 2, n // 2 - 1]
    assert some[2] == every[2]  # in open loop
    for few, all_ in zip(some[:2], every[:2], strict=True):
        assert abs(few.count - n // 4) < 5 * np.sqrt(n // 8)  # of n/2 draws with a half
        assert few.model == pytest.approx(all_.model, rel=5 / np.sqrt(n // 2))


def test_predictions_with_holes_and_limits():
    y = np.array([1.0, np.nan, 1.0, 1.0])[:, None]
    u = np.array([5.0, np.nan, np.nan, np.nan])[:, None]  # clamped to 1, then reused: x stays at 1
    one = predictions(decaying(), went(np.ones((4, 1))), u, y, (1, 9))[0]
    assert (one.count, one.model, one.copying) == (2, pytest.approx(0.0, abs=1e-12), 0.0)
    limited = predictions(decaying(0.0, 0.5), went(np.ones((4, 1))), u, y, (1,))[0]
    assert limited.model == pytest.approx(0.5)


def test_predictions_are_compared_with_what_the_step_took():
    """A sample that it rejected is a missing one, and an input that it did not take is the one before."""
    step, t = decaying(-10, 10), 0.1 * np.arange(60)
    u, y = np.sin(t)[:, None], (1.5 * np.exp(-t) + (np.sin(t) - np.cos(t)) / 2)[:, None]
    u[30:32] = u[29]
    bad, holes, other = y.copy(), y.copy(), u.copy()
    bad[[10, 20, 21]], holes[[10, 20, 21]], other[30:32] = [[1e9], [31.0], [-1e300]], np.nan, [[1e16], [-np.inf]]
    run = step.run(u=other, y=bad)
    raised = [step.flags(run.status[k]) for k in (10, 20, 21, 30)]
    assert raised == [("REJECTED_Y",), ("REJECTED_Y",), ("MISSING_Y",), ("REUSED_U",)]
    step.reset()
    without = predictions(step, step.run(u=u, y=holes), u, holes, (1, 5))
    forecasts = predictions(step, run, other, bad, (1, 5))
    assert [one.rejected for one in forecasts] == [3] * 3
    assert [replace(one, rejected=0) for one in forecasts] == list(without)
    assert max(one.model for one in forecasts) < 2


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (('"0,0"', '"0,125"', '"-1,5e1"'), [0, 0.125, -15]),  # as a spreadsheet in German writes it
        (("0", '"0,125"', '"1,250"'), [0, 0.125, 1.25]),
        (("0.5", '"1,250"', "2"), [0.5, 1250, 2]),
    ],
)
def test_decimal_commas_in_quotes_beside_a_comma_as_delimiter(tmp_path: Path, cells: tuple[str, ...], values: list):
    rows = "\n".join(f"{k},{cell}" for k, cell in enumerate(cells))
    column = table(log(tmp_path, f"t,level\n{rows}\n")).column("level")
    assert column.values == pytest.approx(values, nan_ok=True)


@pytest.mark.parametrize("line", ["sep=;", '"sep=;"', "SEP=;", "sep="])
def test_the_line_that_tells_a_spreadsheet_the_delimiter_is_no_header(tmp_path: Path, line: str):
    one = table(log(tmp_path, f"{line}\r\nt;level\r\n0;1,5\r\n1;2\r\n"))
    assert (one.header, list(one.column("level").values)) == (("t", "level"), [1.5, 2])
    assert any("which is for a spreadsheet" in note for note in one.notes)
    with pytest.raises(BadRecord, match="is empty"):
        table(log(tmp_path, line))


# --- noise ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.0, 0.1, 0.5])
def test_noise_is_found_again(tau: float):
    x, y = hg.Signal("x"), hg.Signal("y")
    plant = hg.System("drift", states=(x,), outputs=(y,), flow=[0.01], output=[x])
    trial = Trial("quiet", 400.0, {"x": 3.0}, noise={"y": OrnsteinUhlenbeck(0.2, tau)})
    record = noisy(plant, simulate(plant, trial, 0.02), trial, [1])[0, :, 0]
    record[100:200] = np.nan
    suggestion = consistency.suggest("y", record, 0.02, 1.0)
    # Two estimates' deviations over T/tau independent stretches: 400/(2 tau) for sigma, some 3 sqrt(tau/T) for tau.
    assert suggestion.sigma == pytest.approx(0.2, rel=4 * math.sqrt(max(tau, 0.01) / 400))
    assert suggestion.tau == pytest.approx(tau, rel=10 * math.sqrt(max(tau, 0.01) / 400))
    assert suggestion.notes == ()
    spread = consistency.spread(50, 0.02, suggestion.tau)
    assert suggestion.gamma_0 == pytest.approx(suggestion.sigma**2 * (1 + 6.5 * spread))


def test_the_spread_of_the_quiet_innovation():
    assert consistency.spread(100, 0.01, 0.0) == pytest.approx(math.sqrt(0.02))
    rho = math.exp(-0.2)
    exact = math.sqrt(0.02 * (1 + 2 * sum((1 - k / 100) * rho**k for k in range(1, 100))))
    assert consistency.spread(100, 0.01, 0.1) == pytest.approx(exact, rel=1e-12)
    # The reference trial's gamma_0 = .16 lies 6..7 spreads above the mean .04.
    assert 0.04 * (1 + 6 * exact) < 0.16 < 0.04 * (1 + 7 * exact)


def test_a_record_that_is_not_quiet_is_doubted():
    moving = consistency.suggest("y", np.sin(np.arange(2000) * 0.01), 0.01, 1.0)
    assert any("quiet" in note for note in moving.notes)


def test_a_long_record_that_drifts_takes_a_moment():
    """The correlation of 300,000 samples falls after some tenth of them; a sum for each lag takes minutes."""
    t = np.arange(300_000) * 0.01
    drift, begun = np.sin(2 * np.pi * 1.3 * t / t[-1]), time.process_time()
    drift[::7] = np.nan
    tau = consistency.suggest("y", drift, 0.01, 1.0).tau
    assert time.process_time() - begun < 30
    direct, lag = np.where(np.isfinite(drift), drift - np.polyval(_line(t, drift), t), 0.0), round(tau / 0.01)
    pairs = np.isfinite(drift)[lag:] & np.isfinite(drift)[:-lag]
    fallen = np.mean((direct[lag:] * direct[:-lag])[pairs]) / np.mean(direct[np.isfinite(drift)] ** 2)
    assert fallen == pytest.approx(math.exp(-1), abs=1e-4)


def _line(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    there = np.isfinite(y)
    return np.polyfit(t[there], y[there], 1)


@pytest.mark.parametrize("d", [-1.0, 0.0, 0.09, 20.1, math.inf, math.nan])
def test_a_window_that_does_not_fit_is_a_sentence(d: float):
    y = np.random.default_rng(0).standard_normal(200)
    with pytest.raises(consistency.BadWindow, match=r"must lie within 0\.1\.\.20 s"):
        consistency.suggest("y", y, 0.1, d)
    assert consistency.suggest("y", y, 0.1, 0.1).d == 0.1
    assert consistency.suggest("y", y, 0.1, 20.0).d == 20.0


@pytest.mark.parametrize("values", [np.ones(500), np.arange(500.0), np.full(500, np.nan), np.zeros(5)])
def test_nothing_to_learn_from_is_a_sentence(values: np.ndarray):
    with pytest.raises(consistency.TooLittle, match="y "):
        consistency.suggest("y", values, 0.1, 1.0)


# --- a clock beside --period ------------------------------------------------------------------------------------


def clocked(folder: Path, stamps: list[object], name: str = "time", **options: Any) -> Record:
    rows = "\n".join(f"{stamp},{k % 7}" for k, stamp in enumerate(stamps))
    return read(log(folder, f"{name},y\n{rows}\n"), {"y": "y"}, dt=0.1, **options)


PAUSED = [*np.arange(50) / 10, *(5 + 3 + np.arange(50) / 10)]
DATES = [(datetime(2026, 3, 1, tzinfo=UTC) + timedelta(seconds=s)).isoformat() for s in PAUSED]


@pytest.mark.parametrize("stamps", [PAUSED, DATES, [1000 * t for t in PAUSED]], ids=["numbers", "dates", "counts"])
def test_a_gap_that_a_period_closes_is_said(tmp_path: Path, stamps: list[object]):
    record = clocked(tmp_path, stamps, "log time", period=0.1)
    (said,) = record.report.notes
    assert said.startswith("the column 'log time' runs like a clock")
    assert "but for pauses: 1, of up to 3" in said
    assert "Say --time 'log time' to have missing samples there" in said


@pytest.mark.parametrize(
    "stamps",
    [
        np.arange(100) / 10,
        np.cumsum(np.random.default_rng(0).exponential(size=100)),
        np.cumsum([0.1, 0.1, 0.1, 0.1, 0.3] * 20),
        [5] * 100,
        ["a"] * 100,
    ],
    ids=["no gap", "no clock", "a clock in four steps of five", "one time", "text"],
)
def test_no_gap_no_word(tmp_path: Path, stamps: list[object]):
    assert clocked(tmp_path, list(stamps), period=0.1).report.notes == ()


def test_a_header_that_ends_with_a_delimiter_has_no_column_more(tmp_path: Path) -> None:
    assert table(log(tmp_path, "t,y,\n0,1\n1,2\n")).notes == ()
    (short,) = table(log(tmp_path, "t,y,\n0,1\n1\n")).notes
    assert short.startswith("1 rows have fewer cells")


@pytest.mark.skipif(not hasattr(time, "tzset"), reason="the zone of a process cannot be set here")
def test_dates_without_a_zone_know_no_summer_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two hours about that which the clocks of the machine leave out."""
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    try:
        dates = [(datetime(2026, 3, 29, 1, 30) + timedelta(minutes=k)).isoformat() for k in range(120)]
        rows = "\n".join(f"{date},{k % 7}" for k, date in enumerate(dates))
        record = read(log(tmp_path, f"time,y\n{rows}\n"), {"y": "y"}, dt=60.0, time="time")
    finally:
        monkeypatch.undo()
        time.tzset()
    assert (record.report.gaps, record.report.samples, record.report.out_of_order) == (0, 120, 0)


@pytest.mark.parametrize(("lost", "read_at_all"), [(49, True), (50, False)])
def test_half_of_the_times_are_too_few(tmp_path: Path, lost: int, read_at_all: bool) -> None:
    stamps = ["" if k % 2 and k < 2 * lost else f"{k / 10}" for k in range(100)]
    rows = "\n".join(f"{stamp},{k % 7}" for k, stamp in enumerate(stamps))
    path = log(tmp_path, f"time,y\n{rows}\n")
    if read_at_all:
        assert read(path, {"y": "y"}, dt=0.1, time="time").report.untimed == lost
        return
    with pytest.raises(BadRecord, match=f"0 cells that are no numbers and {lost} empty ones; it must hold seconds"):
        read(path, {"y": "y"}, dt=0.1, time="time")


@pytest.mark.parametrize(("stamps", "unit", "dt"), [(PAUSED, "s", 0.1), (DATES, "s", 0.1), (DATES, "min", 0.1 / 60)])
def test_a_gap_in_times_is_missing_samples(tmp_path: Path, stamps: list[object], unit: str, dt: float):
    """Also of dates, which count from the first one, in the model's unit."""
    rows = "\n".join(f"{stamp},{k % 7}" for k, stamp in enumerate(stamps))
    record = read(log(tmp_path, f"time,y\n{rows}\n"), {"y": "y"}, dt=dt, time="time", unit=unit)
    assert (record.report.gaps, record.report.filled, record.report.samples) == (1, 30, 130)
    assert np.isnan(record.values[50:80]).all()
    assert np.isfinite(np.delete(record.values, np.s_[50:80], axis=0)).all()
