"""The command `window`: what windows of the innovation show of the state."""

from typing import Annotated

import typer

import hgogen as hg
from hgogen.commands import tables, trial_runs
from hgogen.commands.command import Json, ModelArgument, Tuned, command, one_or_all, show
from hgogen.commands.logs import numbers_in
from hgogen.commands.running import innovation_window
from hgogen.model import load


@command()
def window_(
    model: ModelArgument,
    lengths: Annotated[str, typer.Option("--d", help="Windows d, in the model's time, such as 0.5,1,2.")] = "",
    observer: Tuned = None,
    trial: Annotated[str | None, typer.Option(help="The trial of this name; by default the first.")] = None,
    as_json: Json = False,
) -> None:
    """Tell how well windows d of the innovation show the state along a trial: the observability Gramian of each.

    By default half of the window d of the model, or of one of its tunings, itself, twice and four times it, as far as
    the trial is long.

    JSON keys: model, trial, windows (d, least, median and most of the Gramian's smallest eigenvalue, weakest: the state
    with the largest share of the direction that shows least, share).
    """
    loaded = load(model)
    chosen, *_ = one_or_all(trial_runs.trials(loaded), trial)
    if lengths:
        windows = numbers_in(lengths, "times, such as 0.5,1,2", "--d")
    else:
        d = innovation_window(loaded, "--d", observer)
        windows = tuple(d * k for k in (0.5, 1.0, 2.0, 4.0) if d * k <= chosen.duration)
    gramians = hg.gramian(loaded.plant, chosen, windows)
    value = {"model": loaded.path, "trial": chosen.name, "windows": gramians}
    show(as_json, value, tables.windows(chosen.name, gramians, loaded.plant.time))
