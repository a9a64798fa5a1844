"""The command `advise`: gains without a record, for every observer that a plant admits."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.text import Text

from hgogen import observers as kinds
from hgogen.commands import log_tables
from hgogen.commands.advice import KNOWN
from hgogen.commands.calibrating import Names, forms_asked, renamed
from hgogen.commands.command import ModelReport, command
from hgogen.commands.options import Deep, Jobs, ModelArgument, OneTrial, Out, names_in, numbers_by_name, one_or_all
from hgogen.commands.output import Bar, Written, folder_of, headed, rendered
from hgogen.commands.process import note
from hgogen.commands.trial_runs import trials
from hgogen.emit.cost import cost
from hgogen.logs.advise import Advised, advise
from hgogen.model import load
from hgogen.modelfiles.json_file import equations
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.system import System
from hgogen.trial import NoTrial


@dataclass(frozen=True, eq=False)
class AdvisedRow:
    """Proposed gains of an observer as JSON has them."""

    json_keys = (
        "name=gains.name form theta=gains.theta certified=gains.certified settles settled=gains.own.settled noise "
        "sigma=gains.sigma known operations tried=gains.tried"
    )

    gains: Advised

    @property
    def form(self) -> str:
        """The form the observer is built on."""
        return self.gains.first.row.name

    @property
    def settles(self) -> float | None:
        """The first theta tried that settles."""
        gains = self.gains
        return gains.settles.theta if gains.settles and gains.theta is not None else None

    @property
    def settled(self) -> float | None:
        """The time to settle of its own theta."""
        return self.gains.own.settled if self.gains.own else None

    @property
    def noise(self) -> Mapping[str, float]:
        """RMS that noise alone makes of the estimate, by state."""
        return self.gains.own.noise if self.gains.own else {}

    @property
    def known(self) -> str:
        """What is known of the convergence."""
        return KNOWN[self.gains.first.known][0]

    @property
    def operations(self) -> int:
        """Operations of one call."""
        return cost(self.gains.first.step).operations

    @property
    def rank(self) -> tuple[bool, int, int]:
        """What settles before what does not, then what is known of it, then its cost."""
        return self.settled is None, KNOWN[self.gains.first.known][1], self.operations


@dataclass(frozen=True, eq=False)
class AdviceReport(ModelReport):
    """Gains without a record."""

    json_keys = "model equations take tuning trial rows refused notes files"

    equations: Annotated[list[str], "the plant's equations"]
    trial: Annotated[str | None, "name of the trial; null where none is tried"]
    rows: Annotated[tuple[AdvisedRow, ...], "the gains of each observer"]
    refused: Annotated[Mapping[str, str], "why observers have no gains, by name"]
    unit: str
    files: Written = ()

    @property
    def take(self) -> str:
        """Name of the tuning to take."""
        return min(self.rows, key=lambda row: row.rank).gains.name

    @property
    def tuning(self) -> dict[str, Mapping[str, Any]]:
        """Tables of the tunings by name."""
        return {row.gains.name: row.gains.table for row in self.rows}

    @property
    def notes(self) -> list[str]:
        """How each theta stands to what is certified and to what settles."""
        return [row.gains.sentence for row in self.rows if row.gains.sentence]

    def figures(self, plant: System) -> dict[str, Any]:
        """Time to settle and noise over theta; none where one theta alone was tried."""
        from hgogen.run import figures

        shown = [row.gains for row in self.rows if len(row.gains.tried) > 1]
        widths = {x.name: x.interval[1] - x.interval[0] if x.bounded else 1.0 for x in plant.states}
        settled, noise = {}, {}
        for one in shown:
            settled[one.name] = [(each.theta, each.settled) for each in one.tried if each.settled]
            worst = (max(v / widths.get(x, 1.0) for x, v in each.noise.items()) for each in one.tried)
            noise[one.name] = [(each.theta, most) for each, most in zip(one.tried, worst, strict=True)]
        return {"advised": figures.over_theta(settled, noise, plant.time)} if shown else {}

    def tables(self) -> Iterator[Any]:
        """The gains, and what they do on the trial."""
        states = list(dict.fromkeys(state for row in self.rows for state in row.noise))
        numbers = ("theta", "certified from", "settles from", f"settles in ({self.unit})")
        table = headed("gains from ranges, noise and period", "", "observer", "form", *numbers, numbers=len(numbers))
        sigmas = ", ".join(f"{output} = {sigma:.3g}" for output, sigma in self.rows[0].gains.sigma.items())
        title = f"noise: the RMS that it alone makes of an estimate on the trial, of samples with sigma {sigmas}"
        alone = headed(title, "", "observer", "convergence", *states, numbers=len(states))
        for row in self.rows:
            first = "take" if row.gains.name == self.take else "", row.gains.name
            gains = (row.gains.theta, row.gains.certified, row.settles, row.settled)
            table.add_row(*first, row.form, *map(log_tables.cell, gains))
            alone.add_row(*first, row.known, *map(log_tables.cell, map(row.noise.get, states)))
        yield Group(table, "", alone, "", *map(Text, self.notes), "", *log_tables.without(self.refused))


@command(AdviceReport)
def advise_(
    model: ModelArgument,
    observers: Names = None,
    setting: Setting = AS_WRITTEN,
    noise: Annotated[
        list[str] | None,
        typer.Option("--noise", metavar="OUTPUT=SIGMA", help="Standard deviation of a sample; repeat it."),
    ] = None,
    settling: Annotated[float | None, typer.Option(help="The wanted time to settle, in the model's time.")] = None,
    trial: OneTrial = None,
    deep: Deep = False,
    jobs: Jobs = None,
    out: Out = None,
) -> AdviceReport:
    """Propose gains of every observer that a plant admits, from its ranges, the noise of its sensors, the sampling
    period and a wanted time to settle; and try other values of theta on the model's trial. The file `advised.json` that
    it writes is what `--tuning` of every command that makes a step takes.
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
    rows = tuple(map(AdvisedRow, renamed(loaded, advised, "advised")))
    tried_on = chosen.name if chosen else None
    report = AdviceReport(loaded.path, equations(plant), tried_on, rows, refused, plant.time)
    return folder.save(report, "advised.json", rendered(report.figures(plant)))
