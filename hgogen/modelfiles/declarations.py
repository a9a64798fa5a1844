"""Declarations of a model besides its plant: V and mu of inequality (38) for its errors, which `check` proves or
refutes; bounds on noise and the like; and the trial of a plain-text model.

    dissipation = {"gain": {"x1": 6, "x2": 12, "x3": 8}, "V": P, "mu": 30, "within": {"x1": 1, "x2": 3, "x3": 3}}

`gain`, with `G1` and `G2` if there are any, makes the error system of the plant as `error_system` does; a Python model
may declare a `system` instead. `V`, `mu` and `within` are those of `dissipation`. A text, as in plain-text models, is
an expression: in V of the errors, named e_STATE, else of the plant's signals. `bounds` are the largest sizes of noise,
disturbances and the like, and the requested error bounds.

    [trial]
    duration = 10                    # s
    start = {x1 = 1, x2 = 0}
    estimate = {x1 = 0.5}            # the initial estimate of a comparison's observers, by default the nominal values
    inputs = {u = "sin(t)"}          # expressions of the time t
    noise = {y = 0.01}               # standard deviation
    settled = {state = "x2", band = 0.1, hold = 0.5}   # the error's band, kept for so long (s)
    seeds = 4                        # number of noise realisations
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sympy as sp

from hgogen.errors import BadArgument
from hgogen.modelfiles.setting import SEEDS
from hgogen.prove.dissipation import BadErrorSystem, Dissipation, dissipation, error_system
from hgogen.prove.plant_step import ERROR_INPUTS
from hgogen.reading.expression import parse
from hgogen.reading.given import Misfit
from hgogen.reading.text_model import (
    EXPRESSION,
    NUMBER,
    TABLE,
    TEXT,
    BadModelFile,
    PlainModel,
    demand_keys,
    with_file_errors,
)
from hgogen.rigor.rounding import REALS
from hgogen.system import System
from hgogen.trial import Settled, Trial, t

_SYSTEM = ("gain", "G1", "G2")
_STORED = ("V", "mu", "within")
_GAINS = "gains"


def stored(plant: System, declared: Any) -> Dissipation:
    """Return the dissipation inequality that a model declares of its plant, proved or not: V and mu of dV/de F + |dV/de
    G|^2/(2 mu^2) + |e|^2/2 < 0 (38). Raises: `BadErrorSystem` for keys that are missing or unknown, or values that do
    not fit; `Misfit` for a declaration that is no mapping; `BadExpression`."""
    if not isinstance(declared, Mapping):
        raise Misfit("dissipation", declared, "a mapping with the keys gain, V, mu and within")
    system_keys = ("system",) if "system" in declared else _SYSTEM
    for key in declared.keys() - {*system_keys, *_STORED}:
        raise BadErrorSystem(f"dissipation has a key {key!r}", f"that is none of {', '.join((*system_keys, *_STORED))}")
    for key in (system_keys[0], *_STORED):
        if key not in declared:
            raise BadErrorSystem("dissipation", f"has no key {key!r}; add it")
    signals = {s.name: s for s in plant.signals}
    system = declared.get("system") or error_system(
        plant, **{key: _read(declared[key], signals) for key in _SYSTEM if key in declared}
    )
    errors = {str(e): e for e in getattr(system, "errors", ())}
    V, mu, within = (_read(declared[key], errors) for key in _STORED)
    return dissipation(system, V, mu=mu, within=within)


def _read(value: Any, names: Mapping[str, sp.Symbol]) -> Any:
    if isinstance(value, str):
        return parse(value, names)
    if isinstance(value, Mapping):
        return {key: _read(each, names) for key, each in value.items()}
    return [_read(each, names) for each in value] if isinstance(value, list | tuple) else value


class NoBounds(BadArgument):
    """The error for an invalid entry of the bounds on noise and disturbances in a model file."""

    text = "in bounds, {what} is none; {reason}"


@dataclass(frozen=True)
class Bounds:
    """The bounds on noise and disturbances that a model declares. `sizes`: the arguments of `hg.error_bound`; `gains`:
    whether gains from noise to error in continuous time are requested too."""

    sizes: Mapping[str, Any]
    gains: bool


def bounds(declared: Any) -> Bounds:
    """Return the bounds on noise and disturbances that a model file declares. Raises: `NoBounds`."""
    for what, value in declared.items() if isinstance(declared, Mapping) else [("bounds", declared)]:
        sized = what in ERROR_INPUTS and isinstance(value, Mapping)
        if not (sized or (what == "real" and value in REALS) or (what == _GAINS and isinstance(value, bool))):
            kinds = f"a mapping from some of {', '.join(ERROR_INPUTS)} to sizes by name"
            raise NoBounds(f"{what} = {value!r}", f"make it {kinds}, real a precision, {_GAINS} true or false")
    sizes = {what: value for what, value in declared.items() if what != _GAINS}
    return Bounds(sizes, declared.get(_GAINS, False))


_TRIAL = {"name": TEXT, "duration": NUMBER, "steady": NUMBER, "seeds": NUMBER}
_TRIAL |= dict.fromkeys(("start", "estimate", "inputs", "noise", "settled"), TABLE)
_SETTLED = {"state": TEXT, "band": NUMBER, "hold": NUMBER}


def trial_of(model: PlainModel) -> Trial:
    """Return the trial that a plain-text model declares in the table `trial`. Raises: `BadModelFile`."""
    file, table = model.file, model.trial
    demand_keys(file, "trial", table, _TRIAL, "duration")
    states, outputs = ((signals, NUMBER) for signals in (model.plant.states, model.plant.outputs))
    known = {"start": states, "estimate": states, "inputs": (model.plant.supplied, EXPRESSION), "noise": outputs}
    for key, (signals, kind) in known.items():
        demand_keys(file, f"trial.{key}", table.get(key, {}), {s.name: kind for s in signals})
    if "settled" in table:
        for key in _SETTLED:
            demand_keys(file, "trial.settled", table["settled"], _SETTLED, key)
    count = table.get("seeds", 12)
    if not isinstance(count, int) or not 1 <= count <= SEEDS:
        raise BadModelFile(file, "trial.seeds", f"is {count!r}; write a whole number from 1 to {SEEDS}")
    texts = {name: str(value) for name, value in table.get("inputs", {}).items()}
    inputs = {
        name: with_file_errors(file, f"trial.inputs.{name}", parse, text, {"t": t}) for name, text in texts.items()
    }
    fields = {"name": "trial", "start": {}, "seeds": 12, **table, "inputs": inputs}
    if "settled" in table:
        fields["settled"] = Settled(**table["settled"])
    return with_file_errors(file, "trial", Trial, **fields)
