"""The way from a record to C: the cells of its tutorial run, on the record that they make and on a measured one. The
others run where the site is built."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import ROOT, blocks

from hgogen.run import native

DATA = Path(os.environ.get("HGOGEN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
MEASURED = DATA / "pendulum_energy_shaping.csv"
PAGE = ROOT / "docs" / "tutorials" / "log_to_c.md"


def ran(folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names after all cells but the end of the first, which makes the record, where there is one."""
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    first, *others = blocks("{code-cell}", PAGE.read_text(encoding="utf-8"))
    made = (folder / "record.csv").exists()
    for source in (first.partition("rich = ")[0] if made else first, *others):
        exec(compile(source, PAGE.name, "exec"), names)
    return names


@pytest.mark.full
def test_it_goes_from_a_record_to_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The values of the richer plant, but for what its friction does to them; the velocity, which nothing was told;
    innovations that friction and encoder colour; and C that says it is right."""
    names = ran(tmp_path, monkeypatch)
    a, b, k = (p.value for p in names["fit"].parameters)
    assert a == pytest.approx(19.6, rel=0.02)
    assert 0.11 < b < 0.2  # friction is damping to a model without it
    assert k == pytest.approx(5.3, rel=0.05)
    assert names["error"] < 0.02
    assert not names["seen"].outputs[0].whiteness.white
    assert sorted(path.name for path in (tmp_path / "firmware").iterdir()) == sorted(names["files"])
    if native.compiler():
        assert native.run_check(names["files"]).endswith("samples as recorded\n")


@pytest.mark.slow
@pytest.mark.skipif(not MEASURED.exists(), reason="the measured records are not here")
def test_it_goes_the_same_way_from_a_measured_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real pendulum: differencing its encoder errs by .33 rad/s in the second half."""
    (tmp_path / "record.csv").write_bytes(MEASURED.read_bytes())
    names = ran(tmp_path, monkeypatch)
    assert names["error"] < 0.4
    assert np.isfinite([p.deviation for p in names["fit"].parameters]).all()
