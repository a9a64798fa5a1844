"""The trial of a plain-text model, from its table `trial`.

[trial]
duration = 10                    # s
start = {x1 = 1, x2 = 0}
estimate = {x1 = 0.5}            # from where a comparison starts every observer, by default the nominal values
inputs = {u = "sin(t)"}          # expressions of the time t
noise = {y = 0.01}               # standard deviation
settled = {state = "x2", band = 0.1, hold = 0.5}   # the error's band, kept to for so long (s)
seeds = 4                        # how many records of the noise
"""

from hgogen.modelfiles.setting import SEEDS
from hgogen.reading.expression import parse
from hgogen.reading.text_model import (
    EXPRESSION,
    NUMBER,
    TABLE,
    TEXT,
    BadModelFile,
    PlainModel,
    as_text,
    demand_keys,
    named,
)
from hgogen.trial import OrnsteinUhlenbeck, Settled, Trial, t

_TRIAL = {"name": TEXT, "duration": NUMBER, "steady": NUMBER, "seeds": NUMBER}
_TRIAL |= dict.fromkeys(("start", "estimate", "inputs", "noise", "settled"), TABLE)
_SETTLED = {"state": TEXT, "band": NUMBER, "hold": NUMBER}


def trial_of(model: PlainModel) -> Trial:
    """The trial of the table `trial`. Raises: `BadModelFile`."""
    file, table = model.file, model.trial
    demand_keys(file, "trial", table, _TRIAL, "duration")
    known = {
        "start": dict.fromkeys((s.name for s in model.plant.states), NUMBER),
        "estimate": dict.fromkeys((s.name for s in model.plant.states), NUMBER),
        "inputs": dict.fromkeys((s.name for s in model.plant.inputs), EXPRESSION),
        "noise": dict.fromkeys((s.name for s in model.plant.outputs), NUMBER),
    }
    for key, names in known.items():
        demand_keys(file, f"trial.{key}", table.get(key, {}), names)
    if "settled" in table:
        for key in _SETTLED:
            demand_keys(file, "trial.settled", table["settled"], _SETTLED, key)
    count = table.get("seeds", 12)
    if not isinstance(count, int) or not 1 <= count <= SEEDS:
        raise BadModelFile(file, "trial.seeds", f"is {count!r}; write a whole number from 1 to {SEEDS}")
    inputs = {
        name: named(file, f"trial.inputs.{name}", parse, as_text(value), {"t": t})
        for name, value in table.get("inputs", {}).items()
    }
    return named(
        file,
        "trial",
        Trial,
        table.get("name", "trial"),
        table["duration"],
        table.get("start", {}),
        inputs,
        {name: OrnsteinUhlenbeck(sigma) for name, sigma in table.get("noise", {}).items()},
        settled=Settled(**table["settled"]) if "settled" in table else None,
        steady=table.get("steady"),
        seeds=tuple(range(count)),
        estimate=table.get("estimate", {}),
    )
