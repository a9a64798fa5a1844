"""One log in the spellings of many loggers: each is read as the plain one, or refused with the cause."""

import bz2
import gzip
import lzma
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import hgogen as hg
from hgogen.reading.cells import BadRecord, Rows
from hgogen.reading.log import table
from hgogen.reading.measured import read

N = 60
T = np.arange(N) * 0.25
Y = np.round(1500 * np.sin(0.3 * T) + 700, 3)
U = np.round(np.cos(0.1 * T), 4)
TABLE = np.column_stack([T, Y, U]).tolist()
START = datetime(2026, 3, 31, 23, 59, 50)
EARLY = datetime(2026, 3, 4, 23, 59, 50)
SIGNALS = {"y": hg.Signal("y", "mV"), "u": hg.Signal("u", "V")}


def point(value: float) -> str:
    return f"{value:.3f}"


def comma(value: float) -> str:
    return point(value).replace(".", ",")


def thousands(value: float) -> str:
    return f"{value:,.3f}"


def german(value: float) -> str:
    return thousands(value).translate(str.maketrans(",.", ".,"))


def lines(
    delimiter: str = ",",
    number: Callable[[float], str] = point,
    time: Callable[[float], str] = point,
    head: Iterable[str] = ("time", "y", "u"),
) -> list[str]:
    rows = ((time(t), number(y), number(u)) for t, y, u in TABLE)
    return [delimiter.join(row) for row in (tuple(head), *rows)]


def stamp(pattern: str, start: datetime = START) -> Callable[[float], str]:
    def text(t: float) -> str:
        at = start + timedelta(seconds=t)
        return at.strftime(pattern).replace("FFF", f"{at.microsecond // 1000:03}")

    return text


class Variant(NamedTuple):
    """A log; `options` of `read`, `missing`: the rows without y."""

    lines: list[str]
    options: Mapping[str, Any] = {}
    missing: tuple[int, ...] = ()
    encode: Callable[[str], bytes] = str.encode
    end: str = "\n"
    columns: Mapping[str, str] = {"y": "y", "u": "u"}


def spoiled(cells: Mapping[int, str], delimiter: str = ",") -> list[str]:
    """The log with other cells of y in some rows."""
    rows = [line.split(delimiter) for line in lines(delimiter)]
    for k, cell in cells.items():
        rows[k + 1][1] = cell
    return [delimiter.join(row) for row in rows]


def with_units(y: str = "mV", u: str = "V", blank: str = " ") -> list[str]:
    rows = [line.split(",") for line in lines()]
    return [",".join(rows[0]), *(f"{t},{a}{blank}{y},{b}{blank}{u}" for t, a, b in rows[1:])]


HEAD, *BODY = lines()
PREAMBLE = ["Logger;RX-20", "Serial;12345", "Operator;Smith, J.", "Started;2026-03-31 23:59:50", "Rate;4 Hz"]
READ = {
    "plain": Variant(lines()),
    "names with blanks between blanks": Variant(
        [
            "time of run    y [mV]    u",
            *(f" {t:8.3f}    {y:9.3f}    {u:6.4f}" for t, y, u in TABLE),
        ],
        {"time": "time of run"},
        columns={"y": "y [mV]", "u": "u"},
    ),
    "semicolon": Variant(lines(";")),
    "tab": Variant(lines("\t")),
    "bar": Variant(lines("|")),
    "one blank": Variant(lines(" ")),
    "several blanks": Variant([f"   {line}" for line in lines("     ")]),
    "aligned": Variant([f"{a:>12}{b:>14}{c:>9}" for a, b, c in (line.split(",") for line in lines())]),
    "blank after the delimiter": Variant(lines(", ")),
    "decimal comma": Variant(lines(";", comma, comma)),
    "decimal comma, tab": Variant(lines("\t", comma, comma)),
    "decimal comma, blanks": Variant(lines("  ", comma, comma)),
    "decimal comma in quotes": Variant(lines(",", lambda value: f'"{comma(value)}"', point)),
    "thousands": Variant(lines(";", thousands)),
    "thousands in quotes": Variant(lines(",", lambda value: f'"{thousands(value)}"')),
    "german thousands": Variant(lines(";", german, comma)),
    "swiss thousands": Variant(lines(";", lambda value: thousands(value).replace(",", "'"))),
    "french thousands": Variant(lines(";", lambda value: german(value).replace(".", "\u202f"), comma)),
    "BOM": Variant(lines(), encode=lambda text: text.encode("utf-8-sig")),
    "UTF-16": Variant(lines("\t"), encode=lambda text: text.encode("utf-16")),
    "UTF-16 without a mark": Variant(lines("\t"), encode=lambda text: text.encode("utf-16-le")),
    "UTF-16, big end first": Variant(lines(), encode=lambda text: text.encode("utf-16-be")),
    "latin-1": Variant([HEAD + ",Höhe", *(f"{line},1" for line in BODY)], encode=lambda text: text.encode("latin-1")),
    "CRLF": Variant(lines(), end="\r\n"),
    "CR": Variant(lines(), end="\r"),
    "blank lines between": Variant(lines(), end="\n\n"),
    "preamble": Variant([*PREAMBLE, "", *lines(";")]),
    "preamble as wide as the rows": Variant(["Rig,A,B", "Person,C,D", *lines()]),
    "comments": Variant(["# log of the rig", "# by hand", HEAD, *BODY[:9], "# a pause", *BODY[9:]]),
    "percent comments": Variant(["% log of y", f"% {HEAD}", *BODY]),
    "header behind #": Variant(["# log of x", "# time y u", "#", *lines("\t")[1:]]),
    "header behind #, by commas over blanks": Variant(["# " + HEAD.replace(",", ", "), *lines(" ")[1:]]),
    "header behind #, with a label": Variant(["# Columns: " + HEAD, *BODY]),
    "header behind #, numbered": Variant(["# 1: time, 2: y, 3: u", *lines(" ")[1:]]),
    "header behind #, without a blank": Variant([f"#{HEAD}", *BODY]),
    "units row": Variant([HEAD, "s,mV,V", *BODY]),
    "row of descriptions": Variant([HEAD, "Zeit,Lage,Strom", *BODY]),
    "units row in brackets": Variant([HEAD, "[s],[mV],[V]", *BODY]),
    "units row, other units": Variant(
        [
            "time,y,u",
            "ms,V,mV",
            *(f"{1000 * t:.0f},{y / 1000:.6f},{1000 * u:.1f}" for t, y, u in TABLE),
        ]
    ),
    "units in the header": Variant(
        ["time [s],y [V],u (mV)", *(f"{t},{y / 1000:.6f},{1000 * u:.1f}" for t, y, u in TABLE)],
        {"time": "time [s]"},
        columns={"y": "[y [V]]", "u": "u (mV)"},
    ),
    "units in cells": Variant(with_units()),
    "units in cells, no blank": Variant(with_units(blank="")),
    "units in cells, auto-ranged": Variant(
        [
            HEAD,
            *(f"{t} s,{f'{y} mV' if abs(y) < 1000 else f'{y / 1000:.6f} V'},{u}" for t, y, u in TABLE),
        ]
    ),
    "quoted": Variant([",".join(f'"{cell}"' for cell in line.split(",")) for line in lines()]),
    "trailing delimiter": Variant([f"{line}," for line in lines()]),
    "trailing delimiter in the rows": Variant([HEAD, *(f"{line}," for line in BODY)]),
    "empty last lines": Variant([*lines(), "", "", ""]),
    "text at the end": Variant([*lines(), "End of log", "60 rows"]),
    "zeros at the end": Variant(lines(), encode=lambda text: text.encode() + bytes(512)),
    "repeated header": Variant([HEAD, *BODY[:30], HEAD, *BODY[30:]]),
    "repeated header and preamble": Variant([*PREAMBLE, HEAD, *BODY[:30], *PREAMBLE, HEAD, *BODY[30:]]),
    "sep=": Variant(["sep=;", *lines(";")]),
    "NaN": Variant(spoiled({3: "NaN", 7: "n/a", 8: "-", 12: "#N/A", 30: "", 31: "null"}), {}, (3, 7, 8, 12, 30, 31)),
    "-999": Variant(spoiled({3: "-99999", 17: "-99999.0"}), {}, (3, 17)),
    "text columns": Variant([f"{HEAD},state,note", *(f"{line},RUN,a b" for line in BODY)]),
    "ISO": Variant(lines(",", point, stamp("%Y-%m-%dT%H:%M:%S.FFF"))),
    "ISO between tabs": Variant(
        lines("\t", point, stamp("%Y-%m-%d %H:%M:%S.FFF"), ("time", "y (mV)", "u")), columns={"y": "y (mV)", "u": "u"}
    ),
    "ISO with a zone": Variant(lines(",", point, stamp("%Y-%m-%d %H:%M:%S.FFF+02:00"))),
    "epoch ms": Variant(lines(",", point, lambda t: f"{1_774_990_790_000 + 1000 * t:.0f}")),
    "epoch s": Variant(lines(",", point, lambda t: f"{1_774_990_790 + t:.2f}")),
    "epoch ns": Variant(lines(",", point, lambda t: f"{1_774_990_790_000_000_000 + round(1e9 * t)}")),
    "ms by an expression": Variant(lines(",", point, lambda t: f"{1000 * t:.0f}"), {"time": "time/1000"}),
    "hh:mm:ss across midnight": Variant(lines(",", point, stamp("%H:%M:%S.FFF"))),
    "hh:mm:ss am/pm": Variant(lines(",", point, stamp("%I:%M:%S.FFF %p"))),
    "date and time in columns": Variant(
        lines(",", point, stamp("%d.%m.%Y,%H:%M:%S.FFF"), ("Date", "Time", "y", "u")), {"time": "Date + Time"}
    ),
    "mm:ss.f": Variant(lines(",", point, lambda t: f"{int(t // 60):02}:{t % 60:05.2f}")),
    "dd.mm.yyyy": Variant(lines(";", comma, stamp("%d.%m.%Y %H:%M:%S,FFF"))),
    "dd/mm/yyyy": Variant(lines(",", point, stamp("%d/%m/%Y %H:%M:%S.FFF"))),
    "mm/dd/yyyy am/pm": Variant(lines(",", point, stamp("%m/%d/%Y %I:%M:%S.FFF %p"))),
    "day first, of no month": Variant(lines(",", point, stamp("%d/%m/%Y %H:%M:%S.FFF", EARLY))),
    "month first, of no day": Variant(lines(",", point, stamp("%m/%d/%Y %H:%M:%S.FFF", EARLY))),
    "yyyy/mm/dd": Variant(lines(",", point, stamp("%Y/%m/%d %H:%M:%S.FFF"))),
    "dd-Mon-yyyy": Variant(lines(",", point, stamp("%d-%b-%Y %H:%M:%S.FFF"))),
    "gzip": Variant(lines(), encode=lambda text: gzip.compress(text.encode())),
    "bzip2": Variant(lines(), encode=lambda text: bz2.compress(text.encode())),
    "xz": Variant(lines(), encode=lambda text: lzma.compress(text.encode())),
}
NO_DECISION = "give the decimal sign by --decimal"
WHOLE = [f"{k};{1 + k % 7},{100 + k}" for k in range(20)]
REFUSED = {
    "thousand or decimal": (["time;y", *WHOLE], {}, NO_DECISION),
    "day or month": (["time,y", *(f"{k:02}/04/2026,{k}" for k in range(1, 13))], {}, "say --dates dmy or --dates mdy"),
    "no header": (BODY, {}, "has numbers in its first row; it needs a header"),
    "no delimiter": (["time:y", *(f"{k}:{k}" for k in range(9))], {}, "has no column 'y'"),
    "empty": ([""], {}, "is empty"),
    "hex": (["time,y", *(f"{k},0x{k:02x}" for k in range(9))], {}, "holds no number for y, but cells such as '0x00'"),
    "kinds of units": (["time,y", *(f"{k},{k} {'Vs'[k % 2]}" for k in range(9))], {}, "does not convert to V"),
    "another run": (
        ["time,y", *(f"{k % 30},{k}" for k in range(60))],
        {},
        "begin anew in row 31, as where a logger is",
    ),
    "other days": (
        ["Date,time,y", *(f"2026-03-0{1 + k // 6},10:00:{k % 6:02},{k}" for k in range(12))],
        {},
        "'Date' has other days than those that pass in 'time'; say --time 'Date + time'",
    ),
    "no date": (["time,y", *(f"99/99/2026,{k}" for k in range(9))], {}, "not all in one order of day, month and year"),
}


def got(folder: Path, variant: Variant) -> Any:
    path = folder / "log.csv"
    path.write_bytes(variant.encode(variant.end.join(variant.lines) + variant.end))
    options = {"time": "time", **variant.options}
    return read(path, variant.columns, dt=None, signals=SIGNALS, **options)


def test_a_log_is_the_same_whatever_wrote_it(tmp_path: Path) -> None:
    assert len(READ) >= 43
    wrong = []
    for name, variant in READ.items():
        expected = np.column_stack([Y, U])
        expected[list(variant.missing), 0] = np.nan
        try:
            one = got(tmp_path, variant)
            assert one.report.dt == pytest.approx(0.25, rel=1e-6)
            np.testing.assert_allclose(one.values, expected, atol=2e-3)
            np.testing.assert_allclose(one.t - one.t[0], T, atol=1e-5)
        except (BadRecord, AssertionError) as error:
            wrong.append(f"{name}: {' '.join(str(error).split())[:300]}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_with_the_cause(name: str, tmp_path: Path) -> None:
    text, options, said = REFUSED[name]
    with pytest.raises(BadRecord) as caught:
        got(tmp_path, Variant(text, options, columns={"y": "y"}))
    assert said in str(caught.value)


def test_an_option_decides_what_cells_do_not(tmp_path: Path) -> None:
    for decimal, first in ((".", 1100), (",", 1.1)):
        values = got(tmp_path, Variant(["time;y", *WHOLE], {"decimal": decimal}, columns={"y": "y"})).values
        assert values[0, 0] == pytest.approx(first)
    days = REFUSED["day or month"][0]
    for dates, period in (("dmy", 86_400), ("mdy", 365 * 86_400 / 12)):
        period_read = got(tmp_path, Variant(days, {"dates": dates}, columns={"y": "y"})).report.period
        assert period_read == pytest.approx(period, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "first", "count"),
    [
        (Rows("5", "10"), 20, 21),
        (Rows("row:3", "row:12"), 2, 10),
        (Rows(end="row 5"), 0, 5),
        (Rows("00:00:00", "00:00:05"), 40, 21),
        (Rows("23:59:55", "row:40"), 20, 20),
    ],
)
def test_rows_are_taken_by_times_and_numbers(rows: Rows, first: int, count: int, tmp_path: Path) -> None:
    for every in (1, 2):
        taken = Rows(rows.begin, rows.end, every)
        one = got(tmp_path, READ["hh:mm:ss across midnight"]._replace(options={"rows": taken}))
        np.testing.assert_allclose(one.values[:, 0], Y[first : first + count : every], atol=2e-3)
        assert one.report.dt == pytest.approx(0.25 * every)
        assert one.t[0] == pytest.approx(T[first])
        assert any(note.startswith(f"rows {first + 1} to ") for note in one.report.notes)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (Rows("50"), "leave 0 of its rows; its times run from 0 to 14.75 s and its rows from 1 to 60"),
        (Rows("5", "3"), "leave 0 of its rows"),
        (Rows("nan"), "leave 0 of its rows"),
        (
            Rows("noon"),
            "--from 'noon' must be a time in seconds, a time as its column has it, or a row",
        ),
        (Rows(end="row:1"), "leave 1 of its rows"),
    ],
)
def test_rows_that_are_none_are_refused(rows: Rows, said: str, tmp_path: Path) -> None:
    with pytest.raises(BadRecord) as caught:
        got(tmp_path, Variant(lines(), {"rows": rows}))
    assert said in str(caught.value)


def test_between_blanks_a_short_row_is_left_out(tmp_path: Path) -> None:
    text = lines(" ")
    text[5] = f"{T[4]:.3f}   {U[4]:.3f}"  # y is missing, and u would be read in its place
    one = got(tmp_path, Variant(text))
    assert np.isnan(one.values[4]).all()
    assert one.report.malformed == 1


def test_other_columns_decide_the_sign(tmp_path: Path) -> None:
    text = [f"{row};{u}" for row, u in zip(["time;y", *WHOLE], ["u", *(f"{k}.{k:02}" for k in range(20))], strict=True)]
    text[3:5] = ["2;1,234;0.5", "3;12,345;0.5"]
    assert got(tmp_path, Variant(text)).values[2:4, 0].tolist() == [1234, 12345]


def test_a_code_among_like_numbers_is_a_number(tmp_path: Path) -> None:
    falling = ["time,y", *(f"{k},{-900 - 11 * k}" for k in range(20))]  # one is -999
    assert np.isfinite(got(tmp_path, Variant(falling, columns={"y": "y"})).values).all()


def test_a_counter_of_nanoseconds_is_no_date(tmp_path: Path) -> None:
    counted = ["time,y", *(f"{1_300_000_000_000 + 1_000_000 * k},{k}" for k in range(20))]
    assert got(tmp_path, Variant(counted, columns={"y": "y"})).report.period == 1_000_000


def test_an_expression_reads_units_as_they_are_and_says_so(tmp_path: Path) -> None:
    text = ["time,y [V],u", *(f"{t},{y / 1000:.6f},{u}" for t, y, u in TABLE)]
    for column, factor, note in (
        ("[y [V]]", 1, "y: converted from V to mV"),
        ("2*[y [V]]", 2e-3, "y: the expression '2*[y [V]]' reads 'y [V]' in V, as it is"),
    ):
        one = got(tmp_path, Variant(text, columns={"y": column}))
        np.testing.assert_allclose(one.values[:, 0], factor * Y, atol=2e-3)
        assert note in one.report.notes


def test_one_run_of_a_logger_that_was_started_again_is_read(tmp_path: Path) -> None:
    text = REFUSED["another run"][0]
    for rows, first in ((Rows(end="row:30"), 0), (Rows("row:31"), 30)):
        one = got(tmp_path, Variant(text, {"rows": rows}, columns={"y": "y"}))
        assert one.values[:, 0].tolist() == list(range(first, first + 30))


def test_a_column_is_called_by_its_name_without_the_unit() -> None:
    """Unless another one has the very name, or several have it with units."""
    read = table("log.csv", b"t [s],T[degC],T,F (N),F (kN)\n" + b"0.5,1.5,2.5,1,2\n" * 20)
    assert [read.called(name) for name in ("t", "T", "F", "v")] == ["t [s]", "T", "F", "v"]


def test_a_row_of_units_is_no_header() -> None:
    """Nor where no names are wanted by which the header could be told."""
    assert table("log.csv", b"t,speed,force\ns,m/s,N\n" + b"0.5,1.5,2.5\n" * 20).header == ("t", "speed", "force")
