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
from hgogen.reading.text_model import EXPRESSION, NUMBER, TABLE, TEXT, BadModelFile, PlainModel, demand_keys, named
from hgogen.trial import Settled, Trial, t

_TRIAL = {"name": TEXT, "duration": NUMBER, "steady": NUMBER, "seeds": NUMBER}
_TRIAL |= dict.fromkeys(("start", "estimate", "inputs", "noise", "settled"), TABLE)
_SETTLED = {"state": TEXT, "band": NUMBER, "hold": NUMBER}


def trial_of(model: PlainModel) -> Trial:
    """The trial of the table `trial`. Raises: `BadModelFile`."""
    file, table = model.file, model.trial
    demand_keys(file, "trial", table, _TRIAL, "duration")
    states, outputs = ((signals, NUMBER) for signals in (model.plant.states, model.plant.outputs))
    known = {"start": states, "estimate": states, "inputs": (model.plant.inputs, EXPRESSION), "noise": outputs}
    for key, (signals, kind) in known.items():
        demand_keys(file, f"trial.{key}", table.get(key, {}), {s.name: kind for s in signals})
    if "settled" in table:
        for key in _SETTLED:
            demand_keys(file, "trial.settled", table["settled"], _SETTLED, key)
    count = table.get("seeds", 12)
    if not isinstance(count, int) or not 1 <= count <= SEEDS:
        raise BadModelFile(file, "trial.seeds", f"is {count!r}; write a whole number from 1 to {SEEDS}")
    texts = {name: str(value) for name, value in table.get("inputs", {}).items()}
    inputs = {name: named(file, f"trial.inputs.{name}", parse, text, {"t": t}) for name, text in texts.items()}
    fields = {"name": "trial", "start": {}, "seeds": 12, **table, "inputs": inputs}
    if "settled" in table:
        fields["settled"] = Settled(**table["settled"])
    return named(file, "trial", Trial, **fields)
