"""Faults of the times of a log's rows, samples that are declared missing, and what mends them, as it is printed."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import hgogen as hg
from hgogen.commands.data import log_summary
from hgogen.logs.clocks import is_of_unit, time_findings
from hgogen.reading.cells import BadRecord
from hgogen.reading.measured import Record, read

DT, N = 0.02, 400
EVEN, DRAW = DT * np.arange(N), np.random.default_rng(3)
LEVEL = np.sin(EVEN) + 0.01 * DRAW.normal(size=N)
STALE = np.where(DRAW.uniform(size=N) < 0.1, np.append(0, EVEN[:-1]), EVEN)
UNEVEN = EVEN + DT * DRAW.uniform(-0.4, 0.4, N)
LATE = EVEN + DT * np.minimum(DRAW.exponential(0.3, N), 0.9)
ROWS = {
    "wraps": {"t": (EVEN + 255.5 * DT) % (256 * DT)},
    "coarse": {"t": np.floor(np.arange(N) / 10) * 10 * DT},
    "stale": {"t": STALE},
    "milli": {"t": 1000 * EVEN},
    "gap": {"t": EVEN + (np.arange(N) >= 200) * 1.0},
    "jitter": {"t": UNEVEN},
    "clock": {"t": EVEN, "stamp [us]": 1e6 * UNEVEN + 1e9},
    "period": {"stamp": EVEN + 3},
}


def logged(folder: Path, columns: dict[str, np.ndarray], **options: object) -> Record:
    table = np.column_stack([*columns.values(), LEVEL])
    rows = "\n".join(",".join(f"{value:.10g}" for value in row) for row in table)
    (folder / "log.csv").write_text(f"{','.join(columns)},y\n{rows}\n")
    time = {"time": "t"} if "t" in columns else {"period": 1.25 * DT}
    return read(folder / "log.csv", {"y": "y"}, **{"dt": DT, **time, **options})


def test_each_fault_of_the_times_has_its_name_and_its_fix_mends_it(tmp_path: Path) -> None:
    for fault, columns in ROWS.items():
        faults = time_findings(logged(tmp_path, columns))
        assert [one.fault for one in faults] == [fault]
        (one,) = faults
        assert (one.strength > 1, one.count > 0, len(one.rows) > 0) == (True, True, True)
        if period := re.search(r"--period ([\d.]+)", one.fix):
            mended = logged(tmp_path, columns, time=None, period=float(period[1]))
            assert len(mended.t) == N
            assert not time_findings(mended)
        if fault == "clock":
            assert one.fix == "--time '[stamp [us]]/1e+06'"
        if fault == "milli":
            assert one.fix == 'times in milliseconds? --time "t/1000"'
            assert not time_findings(logged(tmp_path, columns, time="t/1000"))


@pytest.mark.parametrize(
    ("name", "prefix", "power"), [("Zeit_ms", "milli", 1000), ("us_t", "micro", 1e6), ("t (us)", "", 0), ("tms", "", 0)]
)
def test_a_unit_in_the_name_of_a_column_is_evidence(name: str, prefix: str, power: float, tmp_path: Path) -> None:
    """Of a model that has no dt; a unit in brackets is converted."""
    columns = {name: (power or 1) * EVEN}
    faults = time_findings(logged(tmp_path, columns, period=None, time=name, dt=None))
    assert [one.fault for one in faults] == [prefix] * bool(prefix)
    for one in faults:
        assert one.finding.startswith(f"times look like {prefix}seconds by the name of the column {name!r}")
        assert one.fix.startswith(f'--time "{name}/{power:g}"')
        for time in (f"{name}/{power:g}", f"1*{name}"):
            assert not time_findings(logged(tmp_path, columns, period=None, time=time, dt=None))
    dated = {"t_ms": 1.7e12 + 1000 * EVEN}  # since 1970, converted
    assert not any(map(is_of_unit, time_findings(logged(tmp_path, dated, period=None, time="t_ms", dt=None))))


@pytest.mark.parametrize(("longest", "prefix"), [(0.1, "milli"), (1e-4, "micro"), (2.0, ""), (1e-6, "")])
def test_a_step_far_too_long_is_evidence_of_a_unit(longest: float, prefix: str, tmp_path: Path) -> None:
    """A row every 20: ms and us are tried, in this order."""
    record = logged(tmp_path, {"t": 1000 * EVEN}, dt=None)
    assert [one.fault for one in time_findings(record, longest=longest)] == [prefix] * bool(prefix)


def test_rows_without_a_period_are_said_once(tmp_path: Path) -> None:
    record, printed = logged(tmp_path, ROWS["jitter"]), Console(width=1000)
    for findings, count in (((), 1), (time_findings(record), 0)):
        with printed.capture() as text:
            printed.print(log_summary(record.report, findings=findings))
        assert text.get().count("without a period") == count


def test_a_counter_that_wraps_late_is_refused_with_its_period(tmp_path: Path) -> None:
    with pytest.raises(BadRecord, match=r"a counter that wraps, the rows in their order, --period 0\.02"):
        logged(tmp_path, {"t": (EVEN + 0.6) % (256 * DT)})


def test_the_earlier_of_two_stamps_is_that_of_the_measurement(tmp_path: Path) -> None:
    (one,) = [each for each in time_findings(logged(tmp_path, {"t": LATE, "sent": EVEN})) if each.fault == "clock"]
    assert (one.signal, one.fix) == ("sent", "--time sent")
    assert "it holds the times of measurement, t those of arrival" in one.finding
    assert not [
        each for each in time_findings(logged(tmp_path, {"t": UNEVEN, "got": LATE + 1})) if each.fault == "clock"
    ]


def test_healthy_times_have_no_fault(tmp_path: Path) -> None:
    for columns in ({"t": EVEN}, {"t": EVEN + 0.02 * DT * DRAW.normal(size=N)}, {"t": np.round(EVEN + 1.7e5, 3)}):
        assert not time_findings(logged(tmp_path, columns))
    assert not time_findings(logged(tmp_path, {"row": np.arange(N), "ramp": 7 * EVEN}))  # no clocks, by their names


def test_samples_are_missing_by_value_by_repeats_and_by_number(tmp_path: Path) -> None:
    y = hg.Signal("y")
    record = logged(tmp_path, {"t": EVEN})
    record = replace(record, values=np.where(np.arange(N)[:, None] % 100 == 7, -999.0, record.values))
    record.values[50] = record.values[49]
    masked = record.without(["y=-999", "y=repeats, y=10..12"], (), (y,))
    lost = np.flatnonzero(np.isnan(masked.values[:, 0]))
    np.testing.assert_array_equal(lost, [7, 10, 11, 12, 50, 107, 207, 307])
    assert masked.report.notes[-3:] == (
        "y: samples taken as missing by -999: 4",
        "y: samples taken as missing by repeats: 1",
        "y: samples taken as missing by 10..12: 3",
    )
    for text, said in (
        ("z=1", "names no signal; the signals are y"),
        ("y", "must read SIGNAL=VALUE"),
        ("y=some", "must read SIGNAL=VALUE"),
        ("y=0..999", "leaves no sample of y"),
    ):
        with pytest.raises(BadRecord, match=said):
            record.without([text], (), (y,))
