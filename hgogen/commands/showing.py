"""The command `window`: what windows of the innovation show of the state."""

from typing import Annotated

import typer

import hgogen as hg
from hgogen.commands import tables, trial_runs
from hgogen.commands.command import Json, ModelArgument, Tuned, command, one_or_all, show
from hgogen.model import MissingPart, Model, load


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
    windows = _lengths(lengths) if lengths else _about(innovation_window(loaded, "--d", observer), chosen.duration)
    gramians = hg.gramian(loaded.plant, chosen, windows)
    value = {"model": loaded.path, "trial": chosen.name, "windows": gramians}
    show(as_json, value, tables.windows(chosen.name, gramians, loaded.plant.time))


def _about(d: float, duration: float) -> tuple[float, ...]:
    return tuple(d * k for k in (0.5, 1.0, 2.0, 4.0) if d * k <= duration)


def _lengths(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be times, such as 0.5,1,2", param_hint="--d") from None


def innovation_window(model: Model, option: str, observer: str | None = None) -> float:
    """The innovation's window d (s) in a tuning of a model, by default the first that has one; `option` is the
    command's that gives another.

    Raises: `MissingPart` if no adaptive theta is there, or no tuning of that name.
    """
    tuning = model.tuning if observer is None else model.tuned(observer)
    for name in tuning.tables if observer is None else (observer,):
        innovation = getattr(tuning.gains(name).get("theta"), "innovation", None)
        if innovation is not None:
            return float(innovation.d)
    reason = f"its tuning has no adaptive theta, whose window would be the default; give one by {option}"
    raise MissingPart(model.path, "tuning", reason)
