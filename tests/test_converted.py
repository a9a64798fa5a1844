"""Columns whose names hold a unit, in the unit of the model's signal."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from test_cli import hgogen
from test_mapped import record

import hgogen as hg
from hgogen.reading import log as log_module
from hgogen.reading.log import BadRecord, Conversion, Inconvertible, conversion, named_unit
from hgogen.reading.measured import read

pytest.importorskip("pint")


@pytest.mark.parametrize(
    ("column", "unit", "factor", "offset"),
    [
        ("T [degC]", "K", 1, 273.15),
        ("T (°C)", "K", 1, 273.15),
        ("T [degF]", "degC", 5 / 9, -160 / 9),
        ("angle (deg)", "rad", np.pi / 180, 0),
        ("speed (rpm)", "rad/s", np.pi / 30, 0),
        ("Current (mA)", "A", 1e-3, 0),
        ("q [l/min]", "m3/s", 1e-3 / 60, 0),
        ("p [bar]", "Pa", 1e5, 0),
        ("Q (Ah)", "A s", 3600, 0),
        ("valve (%)", "1", 0.01, 0),
        ("acc_x [g]", "m/s^2", 9.80665, 0),
        ("acc_x (mg)", "m/s2", 9.80665e-3, 0),
        ("m [g]", "kg", 1e-3, 0),
    ],
)
def test_units_convert_by_a_factor_and_an_offset(column: str, unit: str, factor: float, offset: float) -> None:
    change = conversion("y", named_unit(column), unit)
    assert isinstance(change, Conversion)
    assert change.factor == pytest.approx(factor, rel=1e-9)
    assert change.offset == pytest.approx(offset, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("I (A)", "A"),
        ("a [m/s2]", "m/s^2"),
        ("y (measured)", "V"),
        ("y (2)", "V"),
        ("y", "V"),
        ("y (mV)", ""),
        ("[", "V"),
    ],
)
def test_what_is_no_other_unit_is_left_alone(column: str, unit: str) -> None:
    assert conversion("y", named_unit(column), unit) == ""


@pytest.mark.parametrize(("column", "unit"), [("y [V]", "K"), ("f (Hz)", "rad/s"), ("speed (rad/s)", "Hz")])
def test_units_of_different_kinds_are_refused(column: str, unit: str) -> None:
    with pytest.raises(Inconvertible, match=rf"does not convert to {unit}, the unit of y"):
        conversion("y", named_unit(column), unit)


def test_the_unit_is_the_last_thing_in_brackets() -> None:
    names = {"T [degC]": "degC", "T(1) (K)": "K", "T (K) raw": "", "T [ degC ] ": "degC", "plain": ""}
    assert {name: named_unit(name) for name in names} == names


def log(folder: Path) -> Path:
    (folder / "log.csv").write_text("t (ms),T [degC],u [V]\n0,20,1\n100,21,\n200,x,3\n")
    return folder / "log.csv"


def test_a_log_is_read_in_the_units_of_the_model(tmp_path: Path) -> None:
    columns, units = {"T": "T [degC]", "twice": "2*[T [degC]]", "u": "u [V]"}, {"T": "K", "twice": "K", "u": "V"}
    signals = {name: hg.Signal(name, unit) for name, unit in units.items()}
    got = read(log(tmp_path), columns, dt=0.1, time="t (ms)", signals=signals)
    np.testing.assert_allclose(got.t, [0, 0.1, 0.2])
    np.testing.assert_allclose(got.values[:, 0], [293.15, 294.15, np.nan])
    np.testing.assert_allclose(got.values[:, 1], [40, 42, np.nan])  # an expression says itself what it does
    notes = "; ".join(got.report.notes)
    assert "T: converted from degC to K" in notes
    assert "time: converted from ms to s" in notes
    assert got.operands == {"T": "(1*[T [degC]] + 273.15)", "twice": "(2*[T [degC]])", "u": "[u [V]]"}
    with pytest.raises(BadRecord, match=r"the column 'u \[V\]' is in V, which does not convert to K.*1\*\[u \[V\]\]"):
        read(log(tmp_path), {"T": "u [V]"}, dt=0.1, time="t (ms)", signals={"T": signals["T"]})


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_run_converts_what_a_column_says(tmp_path: Path) -> None:
    words = (
        "run",
        "pendulum",
        "--data",
        record(tmp_path),
        "--time",
        "t",
        "--dt",
        "0.01",
        "-o",
        str(tmp_path),
        "--json",
    )
    by_name, by_hand = (
        json.loads(hgogen(*words, "--map", each)[0]) for each in ("y=angle (deg)", "y=pi/180*[angle (deg)]")
    )
    assert by_name["record"]["notes"] == ["y: converted from deg to rad"]
    errors = [[one["model"] for one in answer["predictions"]] for answer in (by_name, by_hand)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-6)


def test_without_the_library_the_unit_is_not_compared_and_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    log_module._registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    said = conversion("y", "degC", "K")
    assert isinstance(said, str)
    assert "not compared with the model's, K, since" in said
    assert 'pip install "hgogen[units]"' in said
    assert conversion("y", "K", "K") == ""
    log_module._registry.cache_clear()


def test_a_small_offset_has_its_sign() -> None:
    written = [log_module.Conversion(2.0, offset, "").operand("T") for offset in (0.5, -0.5, 0.0)]
    assert written == ["(2*T + 0.5)", "(2*T - 0.5)", "(2*T)"]
