"""The JSON Schema of text models, by which an editor completes their keys and marks what a model cannot have.

It is made of the tables of keys by which the reader itself refuses them, and of the arguments of the observers.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from hgogen import observers
from hgogen.estimators.synonyms import SYNONYMS
from hgogen.modelfiles.tuning import PLACED, TYPES, arguments
from hgogen.reading import text_model as keys
from hgogen.registry import cases

_NUMBERS = {"type": "array", "items": {"type": "number"}}
_VALUES: Mapping[str, Any] = {
    keys.TEXT: {"type": "string"},
    keys.NUMBER: {"type": "number"},
    keys.EXPRESSION: {"type": ["string", "number"]},
    keys.TABLE: {"type": "object"},
    keys.RANGES: {"type": "array", "items": {**_NUMBERS, "minItems": 2, "maxItems": 2}},
    keys.NUMBERS: _NUMBERS,
    keys.ROWS: {"type": "array", "items": _NUMBERS},
    keys.EXPRESSIONS: {"type": "array", "items": {"type": ["string", "number"]}},
    keys.SWITCH: {"type": "boolean"},
}


def text_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a plain-text model, in TOML or JSON."""
    tuning = _tuning()
    top = {key: _VALUES[kind] for key, kind in keys.TOP.items()}
    kinds = {kind: _each(_closed(of, (needed,) if needed else ())) for kind, (of, needed) in keys.KINDS.items()}
    others = {
        "disturbances": _each(_closed(keys.DISTURBANCE, ("on",))),
        "tables": _each(_closed(keys.POINTS, ("x", "y"))),
        "observer": {**tuning, "required": ["kind"]},
        "tuning": _each(tuning),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A model of hgogen as text",
        "type": "object",
        "required": ["name"],
        "additionalProperties": False,
        "properties": {**top, **kinds, **others},
    }


def _closed(keys_of: Mapping[str, str], needed: Iterable[str] = ()) -> dict[str, Any]:
    properties = {key: _VALUES[kind] for key, kind in keys_of.items()}
    return {"type": "object", "properties": properties, "required": [*needed], "additionalProperties": False}


def _each(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": entry}


def _tuning() -> dict[str, Any]:
    """The schema of a tuning. An argument of an observer may have any type, since it is a number, a list or a table by
    names."""
    kinds = sorted({*cases("observers"), *SYNONYMS})
    every = (name for kind in observers.__all__ for name in arguments(getattr(observers, kind))[0])
    times = {"anyOf": [{"type": "number"}, {**_NUMBERS, "minItems": 2, "maxItems": 2}]}
    choices = {
        "kind": {"enum": kinds},
        "form": {"anyOf": [{"enum": cases("forms")}, {"type": "object", "required": ["kind"]}]},
        "method": {"anyOf": [{"enum": cases("methods")}, {"type": "object"}]},
        "dt": times,
    }
    typed = {key: _VALUES[kind] for key, kind in TYPES.items()}
    properties = {**{key: {} for key in (*PLACED, *every)}, **typed, **choices}
    return {"type": "object", "properties": properties, "additionalProperties": False}
