"""The JSON Schema of text models: every shipped one fits, and what the reader refuses does not."""

import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hgogen.modelfiles.text_schema import text_schema
from hgogen.reading.text_model import BadModelFile, from_table

MODELS = sorted((Path(__file__).resolve().parents[1] / "models").glob("*.toml"))
GOOD: dict[str, Any] = {
    "name": "a",
    "states": {"x": {"flow": "-x", "low": -1, "high": 1, "period": "2"}},
    "outputs": {"y": {"equation": "x"}},
    "observer": {"kind": "ekf", "noise": {"y": 0.1}, "Q_per_sample": [1], "dt": [0.1, 0.2]},
}
BAD = [
    ("stats", {}),
    ("states", {"x": {"flw": "-x"}}),
    ("states", {"x": {"low": -1}}),
    ("states", {"x": {"flow": "-x", "low": "a"}}),
    ("outputs", {"y": {}}),
    ("discrete", "yes"),
    ("name", 3),
    ("tables", {"f": {"x": [0, 1]}}),
    ("disturbances", {"d": {"low": -1, "high": 1}}),
]


def errors(table: Any) -> list[str]:
    return [error.message for error in jsonschema.Draft202012Validator(text_schema()).iter_errors(table)]


def test_the_schema_is_one_and_every_shipped_model_fits_it() -> None:
    jsonschema.Draft202012Validator.check_schema(text_schema())
    assert len(MODELS) > 5
    for path in MODELS:
        assert errors(tomllib.loads(path.read_text())) == [], path.name
    assert errors(GOOD) == []


@pytest.mark.parametrize(("key", "value"), BAD)
def test_what_the_reader_refuses_does_not_fit(key: str, value: Any) -> None:
    table = {**GOOD, key: value}
    assert errors(table)
    with pytest.raises(BadModelFile):
        from_table(table)


@pytest.mark.parametrize("bad", [{"kind": "ekv"}, {"dt": 0.1}, {"kind": "ekf", "Qper": 1}, {"kind": "ekf", "dt": "a"}])
def test_a_wrong_observer_does_not_fit(bad: dict[str, Any]) -> None:
    assert errors({**GOOD, "observer": bad})
