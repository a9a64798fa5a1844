"""The command `window`: what windows of the innovation show of the state."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import typer

import hgogen as hg
from hgogen.commands import tables, trial_runs
from hgogen.commands.command import Report, command
from hgogen.commands.options import ModelArgument, Tuned, numbers_in, one_or_all
from hgogen.commands.running import innovation_window
from hgogen.model import load
from hgogen.trials.gramian import Gramian


@dataclass(frozen=True, eq=False)
class Windows(Report):
    """What windows show along a trial."""

    json_keys = ("model", "trial", "windows")

    model: Annotated[str, "path of the model"]
    trial: Annotated[str, "name of the trial"]
    windows: Annotated[tuple[Gramian, ...], "the observability Gramian of each window"]
    unit: str

    def tables(self) -> Iterator[Any]:
        """A row for each window."""
        yield tables.windows(self.trial, self.windows, self.unit)


@command(Windows)
def window_(
    model: ModelArgument,
    lengths: Annotated[str, typer.Option("--d", help="Windows d, in the model's time, such as 0.5,1,2.")] = "",
    observer: Tuned = None,
    trial: Annotated[str | None, typer.Option(help="The trial of this name; by default the first.")] = None,
) -> Windows:
    """Tell how well windows d of the innovation show the state along a trial: the observability Gramian of each.

    By default half of the window d of the model, or of one of its tunings, itself, twice and four times it, as far as
    the trial is long.
    """
    loaded = load(model)
    chosen, *_ = one_or_all(trial_runs.trials(loaded), trial)
    if lengths:
        windows = numbers_in(lengths, "times, such as 0.5,1,2", "--d")
    else:
        d = innovation_window(loaded, "--d", observer)
        windows = tuple(d * k for k in (0.5, 1.0, 2.0, 4.0) if d * k <= chosen.duration)
    gramians = hg.gramian(loaded.plant, chosen, windows)
    return Windows(loaded.path, chosen.name, gramians, loaded.plant.time)
