"""The step and the trial of a plain-text model, from its tables `observer` and `trial`.

[observer]
kind = "high_gain"               # one of hg.observers; form = "triangular", one of hg.forms
method = "rk4"                   # one of hg.methods; between = "line" or "hold"
dt = 1e-3                        # s
theta = 20                       # every other key is an argument of the observer; a complex pole is [re, im]
poles = [[-1, 0.5], [-1, -0.5]]

[trial]
duration = 10                    # s
start = {x1 = 1, x2 = 0}
inputs = {u = "sin(t)"}          # expressions of the time t
noise = {y = 0.01}               # standard deviation
seeds = 4                        # how many records of the noise
"""

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any

from hgogen import forms, methods, observers
from hgogen.call import CallableStep, sample
from hgogen.check import Refuted
from hgogen.errors import HgogenError
from hgogen.expression import parse
from hgogen.modelfile import EXPRESSION, NUMBER, TABLE, TEXT, BadModelFile, PlainModel, demand_keys, named
from hgogen.trial import OrnsteinUhlenbeck, Trial, t

_STEP = {"kind": TEXT, "form": TEXT, "method": TEXT, "dt": NUMBER, "between": TEXT}
_TRIAL = {"name": TEXT, "duration": NUMBER, "steady": NUMBER, "seeds": NUMBER}
_TRIAL |= dict.fromkeys(("start", "inputs", "noise"), TABLE)
_SEEDS = 1000  # at most


def step_of(model: PlainModel) -> CallableStep:
    """The step of the table `observer`.

    Raises: `BadModelFile` for a table that makes none; `Refuted`.
    """
    file, table = model.file, model.observer
    for key in ("kind", "dt"):
        demand_keys(file, "observer", {k: table[k] for k in _STEP if k in table}, _STEP, key)
    make = _case(file, "observer.kind", observers, table["kind"])
    form = _case(file, "observer.form", forms, table.get("form", "triangular"))
    method = _case(file, "observer.method", methods, table.get("method", "continuous_discrete"))
    gains = {k: _poles(v) if k == "poles" else v for k, v in table.items() if k not in _STEP}
    _arguments(file, table["kind"], make, gains)
    try:
        observer = make(form(model.plant), **gains)
        return sample(observer, method, table["dt"], between=table.get("between", "line"))
    except Refuted:
        raise
    except (HgogenError, TypeError, ValueError) as error:
        raise BadModelFile(file, "observer", str(error)) from None


def trial_of(model: PlainModel) -> Trial:
    """The trial of the table `trial`.

    Raises: `BadModelFile`.
    """
    file, table = model.file, model.trial
    demand_keys(file, "trial", table, _TRIAL, "duration")
    known = {
        "start": dict.fromkeys((s.name for s in model.plant.states), NUMBER),
        "inputs": dict.fromkeys((s.name for s in model.plant.inputs), EXPRESSION),
        "noise": dict.fromkeys((s.name for s in model.plant.outputs), NUMBER),
    }
    for key, names in known.items():
        demand_keys(file, f"trial.{key}", table.get(key, {}), names)
    count = table.get("seeds", 12)
    if not isinstance(count, int) or not 1 <= count <= _SEEDS:
        raise BadModelFile(file, "trial.seeds", f"is {count!r}; write a whole number from 1 to {_SEEDS}")
    inputs = {
        name: named(file, f"trial.inputs.{name}", parse, value if isinstance(value, str) else repr(value), {"t": t})
        for name, value in table.get("inputs", {}).items()
    }
    return Trial(
        table.get("name", "trial"),
        table["duration"],
        table.get("start", {}),
        inputs,
        {name: OrnsteinUhlenbeck(sigma) for name, sigma in table.get("noise", {}).items()},
        steady=table.get("steady"),
        seeds=tuple(range(count)),
    )


def _case(file: str, where: str, folder: Any, name: str) -> Any:
    """A case of a plural folder, by name."""
    if name not in folder.__all__:
        near = get_close_matches(name[:60], folder.__all__, n=1)
        known = f"did you mean {near[0]}?" if near else f"there are {', '.join(folder.__all__)}"
        raise BadModelFile(file, where, f"there is no {name[:60]!r}; {known}")
    return getattr(folder, name)


def _poles(value: Any) -> Any:
    """Pairs [re, im] as complex numbers; the observer refuses what else is no pole."""
    if not isinstance(value, list):
        return value
    pairs = [isinstance(v, list) and len(v) == 2 and all(type(part) in (int, float) for part in v) for v in value]
    return [complex(*v) if pair else v for v, pair in zip(value, pairs, strict=True)]


def _arguments(file: str, kind: str, make: Callable[..., Any], gains: Mapping[str, Any]) -> None:
    """Every argument known, and none missing."""
    wanted = [p for p in signature(make).parameters.values() if p.kind is Parameter.KEYWORD_ONLY]
    names = [p.name for p in wanted]
    for key in gains:
        if key not in names:
            near = get_close_matches(key[:60], [*names, *_STEP], n=1)
            fix = f"did you mean {near[0]}?" if near else f"its arguments are {', '.join(names)}"
            raise BadModelFile(file, f"observer.{key}", f"{kind} has no argument {key[:60]!r}; {fix}")
    for p in wanted:
        if p.default is Parameter.empty and p.name not in gains:
            raise BadModelFile(file, "observer", f"the key {p.name!r} is missing; {kind} needs it")
