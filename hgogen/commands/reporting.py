"""The command `report`: a model, its proofs, its C and its live observer in one HTML file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hgogen import targets
from hgogen.commands.building import costs_known, run_trials
from hgogen.commands.claims import proved_bound, stating
from hgogen.commands.command import ModelArgument, ModelReport, Tuned, command, engine_here, one_or_all
from hgogen.commands.output import Folder, Written, named, note, rendered
from hgogen.commands.trial_runs import trial_figures, trials_of
from hgogen.extras.costs import cost_table
from hgogen.extras.page import page
from hgogen.model import load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting


@dataclass(frozen=True, eq=False)
class PageReport(ModelReport):
    """The HTML page of a model."""

    live: Annotated[bool, "whether the observer runs in the page"]
    bytes: Annotated[int, "size of the page"]
    files: Written


@command(PageReport)
def report_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    trial: Annotated[str | None, typer.Option(help="The trial that the page follows; by default the first.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file, by default MODEL.html.")] = None,
) -> PageReport:
    """Write a model, its proofs, figures and C into one HTML file that needs no network. The observer runs live in the
    page: its C is compiled to WebAssembly, if clang with wasm-ld or Python's package ziglang is installed."""
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    path = out or Path(f"{named(loaded, observer)}.html")
    folder = Folder(path.parent)
    folder.demand(path.name)
    chosen = one_or_all(trials_of(loaded, step), trial)[:1]
    known = proved_bound(step, loaded, note)
    sources = targets.c99(stating(step, loaded, known), real=loaded.setting.real or "float")
    done = run_trials(step, chosen, engine_here(), 1)
    costs = cost_table(costs_known(folder), sources[f"{step.name}.c"])
    figures = rendered(trial_figures(step, done, known))
    text, why = page(step, done[0].first, sources, figures, known.bounds if known else {}, costs)
    if why:
        note(why)
    paths = folder.write({path.name: text})
    return PageReport(loaded.path, not why, len(text.encode()), tuple(paths))
