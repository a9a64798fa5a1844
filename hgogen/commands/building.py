"""The commands that write code: `build` and `generate`, `simulate`, which tries a model's observer alone, and `cost`,
which measures what the C costs on a Cortex-M4F.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from inspect import signature
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands.claims import Checked, checked, checks_table, proved_bound, stating
from hgogen.commands.command import (
    NO_RUNS,
    ModelArgument,
    ModelReport,
    OneTrial,
    Out,
    ReaderOption,
    Report,
    Runs,
    Seeds,
    Tuned,
    command,
    early,
    engine_here,
    one_or_all,
)
from hgogen.commands.output import Bar, Folder, Written, file_list, folder_of, headed, json_text, named, note, rendered
from hgogen.commands.trial_runs import (
    LANGUAGES,
    CampaignRow,
    TrialRow,
    Tried,
    agreement_table,
    agreements,
    bounds_table,
    campaigns,
    departures,
    summaries,
    trial_figures,
    trials_of,
    trials_or_proposed,
    trials_table,
    tried,
)
from hgogen.emit.naming import demand_prefix, prefixed
from hgogen.emit.syntax import Real
from hgogen.errors import HgogenError
from hgogen.extras.costs import Costs, demand_board, measured
from hgogen.extras.folder import ALL, SOURCES, chosen, folder, known
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting, UnknownCase, demand_known
from hgogen.reading.files import BYTES, Unread, content_of, name_key
from hgogen.reading.given import field_text, values_by_name
from hgogen.run import native
from hgogen.run.comparison import Agreement, BoundedError, Disagree, Falling, bounded_errors, falling
from hgogen.run.samples import Engine
from hgogen.sentence import encoded
from hgogen.step import Step
from hgogen.target import CannotWrite, Files, Sources
from hgogen.trial import Trial, rows_given

COSTS = "cost.json"
EXTRAS = "extras"  # where a library has what is no part of it, as Arduino calls it
_MARK = "hgogen"  # in what hgogen writes

For = Annotated[
    str | None,
    typer.Option(
        "--for",
        metavar="NAME",
        help=f"A folder that a project takes as it is, for {', '.join(known())}, several with commas, or {ALL}.",
    ),
]
Prefix = Annotated[
    str | None,
    typer.Option("--name", metavar="PREFIX", help="What files, functions, types and macros begin with."),
]


def demand_packing(ecosystems: str | None, name: str | None, target: str, c: str) -> None:
    """Raises: `BadParameter` where a folder is asked for of another language than C; `UnknownEcosystem`,
    `ReservedName`, and as `demand_prefix` does."""
    demand_prefix(name)
    if ecosystems is None:
        return
    if target != c:
        raise typer.BadParameter(f"is for {c}, not for {target}; leave one of the two", param_hint="--for")
    chosen(ecosystems, name or "")


def packed(step: Step, files: Files, ecosystems: str | None, real: Real, where: Folder) -> Files:
    """The files as they go into the folder: as they are, or laid out for ecosystems with what these ask for, and with
    the costs that are known there.

    Raises: `UnknownEcosystem`, `ReservedName`; `CannotWrite` for a folder that holds what is not hgogen's.
    """
    if ecosystems is None:
        return files
    made = folder(step, files, chosen(ecosystems, step.name), real=real, costs=_costs(where))
    _demand_own(where, made)
    return made


def beside(files: Mapping[str, bytes], ecosystems: str | None) -> dict[str, bytes]:
    """Figures, as they go into the folder."""
    return {f"{EXTRAS}/{name}" if ecosystems else name: content for name, content in files.items()}


def _costs(where: Folder) -> Mapping[str, Any] | None:
    """Return what `hgogen cost` wrote there, if it did."""
    (path,) = where.demand(COSTS)
    try:
        costs = json.loads(content_of(path, BYTES))
    except (Unread, ValueError, RecursionError):
        return None
    return costs if isinstance(costs, dict) else None


def _demand_own(where: Folder, made: Files) -> None:
    """Nothing is replaced that hgogen did not write, and no other source lies where every build compiles all."""
    for path, text in zip(where.demand(*made), made.values(), strict=True):
        if path.exists() and _MARK in text and _MARK.encode() not in content_of(path, BYTES):
            raise CannotWrite(str(path), "hgogen did not write what is there", "take another folder by --out")
    source = where.demand(f"{SOURCES}/{COSTS}")[0].parent
    names = {Path(name).name for name in made}
    if others := sorted(path.name for path in source.glob("*") if path.name not in names):
        reason = f"it holds {others[0]} too, which a build would compile along"
        raise CannotWrite(str(source), reason, "remove that, or take another folder by --out")


_MEANINGS = {
    "quiet": "instructions of a step, calm",
    "worst": "instructions of a step, the worst of a hostile record",
    "flash": "flash, bytes",
    "ram": "RAM, bytes of state and parameters",
    "stack": "stack, bytes",
}


@dataclass(eq=False)
class TooDear(HgogenError):
    """Costs above the limits that were asked for: each with what it is and its limit."""

    status: ClassVar[int] = 1
    over: tuple[tuple[str, int, int], ...]

    def __str__(self) -> str:
        return "; ".join(f"{_MEANINGS[name]}: {value}, more than {limit}" for name, value, limit in self.over)


def _most(what: str) -> typer.models.OptionInfo:
    option: typer.models.OptionInfo = typer.Option(metavar="N", min=0, help=f"Fail where {what} is more.")
    return option


@dataclass(frozen=True)
class CostReport(ModelReport):
    """The costs of a model's C."""

    json_keys = "model *costs files"

    costs: Costs
    files: Written
    title: str
    limits: Mapping[str, int | None]

    def tables(self) -> Iterator[Any]:
        """A row for each cost."""
        rows = ((meaning, str(getattr(self.costs, key))) for key, meaning in _MEANINGS.items())
        yield headed(self.title, "what", "how much", numbers=1, rows=rows)
        yield f"{self.costs.compiler} {self.costs.flags}\n"

    def demand(self) -> None:
        """Raise `TooDear` where a cost is above its limit."""
        asked = [(key, getattr(self.costs, key), limit) for key, limit in self.limits.items() if limit is not None]
        if over := tuple((key, value, limit) for key, value, limit in asked if value > limit):
            raise TooDear(over)


@command(CostReport)
def cost_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that holds one folder a model.")] = Path("generated"),
    name: Prefix = None,
    max_flash: Annotated[int | None, _most("the step's code, in bytes,")] = None,
    max_ram: Annotated[int | None, _most("its state with the parameters, in bytes,")] = None,
    max_stack: Annotated[int | None, _most("its stack, in bytes,")] = None,
    max_instructions: Annotated[int | None, _most("the worst number of instructions of a step")] = None,
) -> CostReport:
    """Measure what the C of a model costs on a Cortex-M4F: compiled by arm-none-eabi-gcc and run in QEMU over the
    model's trial, or one made of its ranges, without jumps, and over the same record with gaps, jumps and numbers that
    are none. Writes MODEL/cost.json below --out, of which `hgogen generate --for` tells in the folder's README.
    """
    demand_prefix(name)
    demand_board()
    loaded = load(model).set(setting)
    folder = Folder(out, name or named(loaded, observer))
    folder.demand(COSTS)
    note(*loaded.notes)
    made, trial, real = loaded.step(observer), trials_or_proposed(loaded)[0], loaded.setting.real or "float"
    step = prefixed(made, name) if name else made
    costs = measured(step, targets.c99(step, real=real, check=False), rows_given(made, trial), real)
    paths = folder.write({COSTS: json_text({"model": loaded.name, **encoded(costs)}) + "\n"})
    limits = {"flash": max_flash, "ram": max_ram, "stack": max_stack, "worst": max_instructions}
    return CostReport(loaded.path, costs, tuple(paths), f"{step.name} in {real} on a {costs.machine}", limits)


C99 = "c99"
_TAKES = ("command", "real", "check")  # what a language takes beside the step


def _languages() -> list[str]:
    """The targets that are a whole step in a language, and say in a banner which command made them."""
    return [name for name in targets.__all__ if set(_TAKES) <= signature(getattr(targets, name)).parameters.keys()]


def _demand_language(target: str) -> None:
    """Raise `UnknownCase` for a target that is none, or that writes no whole step in a language."""
    if target in set(targets.__all__) - set(_languages()):
        asked = signature(getattr(targets, target))
        if "command" in asked.parameters:
            lacks = ", ".join(name for name in _TAKES if name not in asked.parameters)
            why = f"takes command, and not {lacks}, as a language does"
        elif asked.return_annotation is Files:
            why = f"is no language of its own; call hg.targets.{target}"
        else:
            why = f"is for Python, as hg.targets.{target}"
        raise UnknownCase(f"--target {target}:", f"{why}; there are {', '.join(_languages())}")
    demand_known("target", target, _languages())


def _either(names: list[str]) -> str:
    """Names as one says them: a, b or c."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


_SPOKEN = f"The language of the code: {_either(_languages())}."
Target = Annotated[str, typer.Option("--target", metavar="NAME", help=_SPOKEN)]


def _tried(step: CallableStep, trials: tuple[Trial, ...], engine: Engine, count: int | None) -> list[Tried]:
    seeds = {trial.name: trial.seeds if count is None else tuple(range(count)) for trial in trials}
    with Bar(f"trials in {LANGUAGES[engine]}", sum(map(len, seeds.values()))) as bar:
        return [tried(step, trial, engine, seeds[trial.name], bar.tick) for trial in trials]


def _emitted(step: CallableStep, model: Model, observer: str | None, target: str, name: str | None) -> Sources:
    """The files of a target, in float unless the precision is set, and the document that their head names; the banner
    says which command makes them again, and what they call otherwise is noted."""
    words = ["hgogen generate", model.name, *(["--observer", observer] if observer else []), *model.setting.words]
    words += [f"--target {target}"] if target != C99 else []
    words += [f"--name {name}"] if name else []
    files: Sources = getattr(targets, target)(step, real=_real(model), command=" ".join(words))
    note(*files.notes)
    document = targets.markdown(step, real=_real(model))
    return replace(files, texts=tuple({**document, **files}.items()))


def _real(model: Model) -> Real:
    return model.setting.real or "float"


@dataclass(frozen=True, eq=False)
class Built(ModelReport):
    """A model checked, its code generated, and its trials in C and in Python."""

    json_keys = "model *claims c_names compiler self_check trials comparison files"

    claims: Checked
    c_names: Annotated[dict[str, str], "by signal, its name in the language, where that is another"]
    self_check: Annotated[str | None, "what the self-check of the code printed; null where it was not run"]
    trials: Annotated[tuple[TrialRow, ...], "what followed each event of each trial"]
    comparison: Annotated[tuple[Agreement, ...], "C against Python"]
    code: str
    unit: str
    files: Written = ()

    @property
    def compiler(self) -> str | None:
        """The C compiler; null where there is none."""
        return native.compiler()

    def tables(self) -> Iterator[Any]:
        """Yield what the trials say, and whether C and Python agree."""
        yield trials_table([one.summary for one in self.trials], self.unit)
        if self.comparison:
            yield agreement_table(self.comparison, self.unit)
        if self.self_check:
            yield f"self-check of the {self.code}: {self.self_check}\n"

    def demand(self) -> None:
        """Raise `Disagree` where C and Python do."""
        if failed := tuple(one for one in self.comparison if not one.agreed):
            raise Disagree(failed)


@command(Built)
def build_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Out = None,
    target: Target = C99,
    ecosystems: For = None,
    name: Prefix = None,
    seeds: Seeds = None,
) -> Built:
    """Check a model, generate and compile its code, try it in C and in Python, compare them, draw the figures.

    Everything lies in the folder --out, with report.json, which is what --json prints. Without a C compiler
    the trials run in Python, one seed each, and the C is written but not tried. With --target another language is
    written in the place of C, and its self-check is run where its compiler is there. With --for the C lies in
    src/, with what the ecosystem asks for beside it, and figures in extras/.
    """
    _demand_language(target)
    demand_packing(ecosystems, name, target, C99)
    loaded = load(model).set(setting)
    folder = Folder(Path("build"), name) if name and out is None else folder_of(out, loaded, observer)
    folder.demand("report.json")
    step = loaded.step(observer)
    trials = trials_of(loaded, step)
    claims = checked(loaded, name=observer)
    early(checks_table(claims.head, claims.checks, claims.accepted))
    note(*claims.notes)
    files, library = _coded(loaded, step, claims.known, observer, target, ecosystems, name, folder)
    engine = engine_here()
    self_check = _checked(files, engine)
    done = _tried(step, trials, engine, seeds if engine == "c" else 1)
    again = _tried(step, trials, "python", 1) if engine == "c" else []
    comparison = agreements(done, again, step.dt) if again else ()
    drawn = beside(rendered(trial_figures(step, done, claims.known)), ecosystems)
    rows = tuple(map(TrialRow, summaries(step, done, engine, note), done))
    code = f"{_real(loaded)} {'C' if target == C99 else target}"
    report = Built(loaded.path, claims, dict(files.names), self_check, rows, comparison, code, step.time)
    return folder.save(report, "report.json", {**library, **drawn})


def _coded(
    model: Model,
    step: CallableStep,
    known: ErrorBound | None,
    observer: str | None,
    target: str,
    ecosystems: str | None,
    name: str | None,
    folder: Folder,
) -> tuple[Sources, Files]:
    """The code of a step of which that is `known`, and all files as they go into the folder."""
    stated = stating(step, model, known)
    coded = prefixed(stated, name) if name else stated
    files = _emitted(coded, model, observer, target, name)
    return files, packed(coded, files, ecosystems, _real(model), folder)


def _checked(files: Sources, engine: Engine) -> str | None:
    """Return what the self-check printed; None where there is no compiler for it."""
    if not files.recipe:
        return native.run_check(files).strip() if engine == "c" else None
    try:
        return native.run_recipe(files).strip()
    except native.NoTool as error:
        note(f"{error}: the code is written but not tried")
        return None


@dataclass(frozen=True)
class Generated:
    """The code of a model."""

    model: Annotated[str, "path of the model"]
    c_names: Annotated[dict[str, str], "by signal, its name in the language, where that is another"]
    files: Written


@dataclass(frozen=True)
class AllGenerated(Report):
    """The code of models."""

    models: Annotated[tuple[Generated, ...], "the code of each model"]

    def tables(self) -> Iterator[Any]:
        """The files of each."""
        return (file_list(one.files) for one in self.models)


@command(AllGenerated)
def generate_(
    models: Annotated[
        list[str], typer.Argument(metavar="MODEL...", help="Model files, or names that `hgogen list` shows.")
    ],
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that holds one folder a model.")] = Path("generated"),
    target: Target = C99,
    ecosystems: For = None,
    name: Prefix = None,
) -> AllGenerated:
    """Write the code of models, by default C, and the figures of their trials as the C draws them, or Python's reading
    of it where there is no compiler. With --for the C lies in src/, with what the ecosystem asks for beside it: build
    files, an example, a README with the costs that `hgogen cost` measured; figures lie in extras/.
    """
    _demand_language(target)
    demand_packing(ecosystems, name, target, C99)
    if name and len(models) > 1:
        raise typer.BadParameter("is one name, of one model; write the models one by one", param_hint="--name")
    loaded = [load(model).set(setting) for model in models]
    for first, second in combinations(loaded, 2):
        if name_key(first.name) == name_key(second.name):
            reason = f"{first.path} and {second.path} have one name, and the files of one would replace the other's"
            raise typer.BadParameter(f"{reason}; give each a folder of its own by --out", param_hint="MODEL")
    made = []
    for one in loaded:  # of all of them, before anything is tried or written
        folder = Folder(out, name or named(one, observer))
        note(*one.notes)
        step = one.step(observer)
        known = proved_bound(step, one, note)
        code, library = _coded(one, step, known, observer, target, ecosystems, name, folder)
        folder.demand(*library)
        made.append((one, folder, step, known, code, library))
    engine: Engine = engine_here() if any(one.has("trial") for one in loaded) else "python"
    generated = []
    for one, folder, step, known, code, library in made:
        paths = folder.write({**library, **beside(_figures(one, step, known, engine), ecosystems)})
        generated.append(Generated(one.path, dict(code.names), tuple(paths)))
    return AllGenerated(tuple(generated))


def _figures(model: Model, step: CallableStep, known: ErrorBound | None, engine: Engine) -> dict[str, bytes]:
    """The figures of a model's trials; says where there are none."""
    if not model.has("trial"):
        note(f"{model.path} has no trial, so there are no figures of it")
        return {}
    done = _tried(step, model.trials(), engine, 1)
    note(*departures(done, step.time))
    return rendered(trial_figures(step, done, known))


@dataclass(frozen=True, eq=False)
class SimulatedTrial:
    """A trial of a step as JSON has it."""

    json_keys = "*row bounds falling each=row.tried.each"

    row: TrialRow
    bounds: Annotated[tuple[BoundedError, ...], "each state's error beside what is proved of it"]
    falling: Annotated[Falling | None, "how e' S e falls without noise; null for an observer without a covariance"]


@dataclass(frozen=True, eq=False)
class Simulated(ModelReport):
    """A model's observer on its trials."""

    json_keys = "model gains trials files"

    step: CallableStep
    trials: Annotated[tuple[SimulatedTrial, ...], "what followed each event of each trial"]
    files: Written

    @property
    def gains(self) -> dict[str, Any]:
        """The observer's gains, those of several coordinates or outputs by the name of each."""
        return {gain.name: values_by_name(gain) for gain in self.step.layout.gains}

    def tables(self) -> Iterator[Any]:
        """Yield what followed each event of each trial, and errors beside their bounds."""
        yield f"{self.step.observer.name} observer: {', '.join(map(field_text, self.step.layout.gains))}\n"
        yield trials_table([one.row.summary for one in self.trials], self.step.time)
        yield from (bounds_table(one.bounds) for one in self.trials if one.bounds)
        falls = (one.falling for one in self.trials if one.falling)
        yield from (f"{one.trial}: {one.sentence(self.step.time)}" for one in falls)


@dataclass(frozen=True, eq=False)
class SimulatedCampaigns(ModelReport):
    """Campaigns of a model's observer, with --vary or --runs."""

    gains: Annotated[dict[str, Any], "the observer's gains, those of several coordinates by the name of each"]
    campaigns: Annotated[tuple[CampaignRow, ...], "the campaign on each trial"]

    def tables(self) -> Iterator[Any]:
        """A table for each campaign."""
        return (part for row in self.campaigns for part in row.tables())


@command(Simulated, SimulatedCampaigns)
def simulate_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    seeds: Seeds = None,
    reader: ReaderOption = None,
    trial: OneTrial = None,
    asked: Runs = NO_RUNS,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the figures; by default none.")] = None,
) -> Simulated | SimulatedCampaigns:
    """Try a model's observer on its trials and print the metrics; with --vary or --runs, a campaign of many runs.

    With --out the figures of the trials are drawn as by `build`, with the errors beside what is proved of them where
    the model has bounds.
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    trials = trials_of(loaded, step)
    chosen, engine = one_or_all(trials, trial), engine_here(reader)
    if asked:
        if out is not None:
            note("of a campaign no figures are drawn, and --out names a folder for nothing")
        rows = campaigns(lambda _: {observer or step.observer.name: step}, chosen, engine, asked, seeds)
        return SimulatedCampaigns(loaded.path, {gain.name: values_by_name(gain) for gain in step.layout.gains}, rows)
    if out is not None:
        Folder(out).demand(*(f"{one.name}_states.svg" for one in chosen))
    done = _tried(step, chosen, engine, seeds)
    summed = map(TrialRow, summaries(step, done, engine, note), done)
    known = proved_bound(step, loaded, note)
    seen_ = [bounded_errors(step.states, one.first, known) if known else () for one in done]
    falls = [falling(step, one, engine) for one in chosen]
    paths = [] if out is None else Folder(out).write(rendered(trial_figures(step, done, known)))
    return Simulated(loaded.path, step, tuple(map(SimulatedTrial, summed, seen_, falls)), tuple(paths))
