"""The command `advise`: gains without a record, for every observer that a plant admits."""

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from hgogen import observers as kinds
from hgogen.calibration.advise import Advised, advise
from hgogen.commands import log_tables
from hgogen.commands.advice import KNOWN
from hgogen.commands.calibrating import forms_asked, renamed
from hgogen.commands.command import (
    Bar,
    Jobs,
    Json,
    ModelArgument,
    OneTrial,
    Out,
    command,
    folder_of,
    json_text,
    one_or_all,
    rendered,
    show,
)
from hgogen.commands.headed import file_list
from hgogen.commands.logs import Deep, names_in, numbers_by_name
from hgogen.commands.process import note
from hgogen.commands.trial_runs import trials
from hgogen.emit.cost import cost
from hgogen.model import load
from hgogen.modelfiles.json_file import equations
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.system import System
from hgogen.trials.proposed import NoTrial


@command()
def advise_(
    model: ModelArgument,
    observers: Annotated[
        str | None, typer.Option("--observers", "--observer", metavar="A,B,..", help="By default all.")
    ] = None,
    setting: Setting = AS_WRITTEN,
    noise: Annotated[
        list[str] | None,
        typer.Option("--noise", metavar="OUTPUT=SIGMA", help="Standard deviation of a sample; repeat it."),
    ] = None,
    settling: Annotated[
        float | None, typer.Option("--settling", help="The wanted time to settle, in the model's time.")
    ] = None,
    trial: OneTrial = None,
    deep: Deep = False,
    jobs: Jobs = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Propose gains of every observer that a plant admits, from its ranges, the noise of its sensors, the sampling
    period and a wanted time to settle; and try other values of theta on the model's trial. The file `advised.json` that
    it writes is what `--tuning` of every command that makes a step takes.

    JSON keys: model, equations (of its plant), tuning (tables by name), take, trial (its name, or null), rows (name,
    form, theta, certified: from which theta on, settles: the first theta that does, settled: the time of its own, noise
    by state, sigma: of the sensors, by output, known: of its convergence, operations, tried: theta, settled, noise),
    refused (why, by observer), notes, files.
    """
    loaded = load(model).set(setting)
    plant, folder = loaded.plant, folder_of(out, loaded)
    folder.demand("advised.json")
    sigmas = numbers_by_name(noise or (), "--noise")
    try:
        chosen = one_or_all(trials(loaded), trial)[0]
    except NoTrial as error:
        chosen = None
        note(f"values of theta are not tried: {error}")
    names = names_in(observers, "--observers")
    with Bar("observers", len(names) or len(kinds.__all__)) as bar:
        advised, refused = advise(
            plant,
            dt=setting.dt,
            noise=sigmas,
            settling=settling,
            observers=names or None,
            trial=chosen,
            rows=forms_asked(loaded, deep),
            jobs=jobs,
            each=lambda _: bar.tick(),
        )
    advised = renamed(loaded, advised, "advised")
    rows = [
        {
            "name": one.name,
            "form": one.first.row.name,
            "theta": one.theta,
            "certified": one.certified,
            "settles": one.settles.theta if one.settles and one.theta is not None else None,
            "settled": one.own.settled if one.own else None,
            "noise": dict(one.own.noise) if one.own else {},
            "sigma": dict(one.sigma),
            "known": KNOWN[one.first.known][0],
            "operations": cost(one.first.step).operations,
            "tried": [{"theta": each.theta, "settled": each.settled, "noise": dict(each.noise)} for each in one.tried],
        }
        for one in advised
    ]
    best = min(advised, key=_rank).name
    notes = [one.sentence for one in advised if one.sentence]
    drawn = {"advised": _figure(advised, plant)} if any(len(one.tried) > 1 for one in advised) else {}
    files: dict[str, str | bytes] = {**rendered(drawn)}
    paths = folder.demand(*files, "advised.json")
    report = {
        "model": loaded.path,
        "equations": equations(plant),
        "take": best,
        "tuning": {one.name: one.table for one in advised},
        "trial": chosen.name if chosen else None,
        "rows": rows,
        "refused": refused,
        "notes": notes,
        "files": list(map(str, paths)),
    }
    folder.write({**files, "advised.json": json_text(report) + "\n"})
    show(as_json, report, log_tables.advised(rows, best, plant.time, notes, refused), file_list(paths))


def _rank(one: Advised) -> tuple[bool, int, int]:
    """What settles before what does not, then what is known of it, then its cost."""
    settles = one.own is not None and one.own.settled is not None
    return not settles, KNOWN[one.first.known][1], cost(one.first.step).operations


def _figure(advised: Sequence[Advised], plant: System) -> Any:
    """Time to settle and noise over theta."""
    from hgogen.trials import figures

    shown = [one for one in advised if len(one.tried) > 1]
    widths = {x.name: x.interval[1] - x.interval[0] if x.bounded else 1.0 for x in plant.states}
    settled = {one.name: [(each.theta, each.settled) for each in one.tried if each.settled] for one in shown}
    noise = {
        one.name: [
            (each.theta, max(value / widths.get(name, 1.0) for name, value in each.noise.items())) for each in one.tried
        ]
        for one in shown
    }
    return figures.over_theta(settled, noise, plant.time)
