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
from hgogen.commands.advice import unobservable_note
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
    trials_table,
    tried,
)
from hgogen.emit.naming import demand_prefix, prefixed
from hgogen.emit.syntax import Real
from hgogen.errors import HgogenError
from hgogen.estimators.noise import deviation_lines
from hgogen.extras.costs import MEANINGS, Costs, demand_board, measured
from hgogen.extras.folder import ALL, SOURCES, chosen, folder, known
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting, UnknownCase, demand_known
from hgogen.reading.files import BYTES, Unread, content_of, name_key
from hgogen.reading.given import field_text, gains_by_name
from hgogen.run import native
from hgogen.run.comparison import Agreement, BoundedError, Disagree, LyapunovDecay, bounded_errors, lyapunov_decay
from hgogen.run.samples import Engine
from hgogen.sentence import encoded
from hgogen.step import Step
from hgogen.target import CannotWrite, Files, Sources
from hgogen.trial import Trial, rows_given

COSTS = "cost.json"
EXTRAS = "extras"  # Arduino's name for the files of a library that are not its code
_MARK = "hgogen"  # a word in every file that hgogen writes

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


def lay_out(step: Step, files: Files, ecosystems: str | None, real: Real, where: Folder) -> Files:
    """Return the files of a step as they are written into the folder `where`: unchanged, or arranged for ecosystems of
    firmware projects, with the measured costs (cost.json) that the folder already holds.

    Raises: `UnknownEcosystem`, `ReservedName`; `CannotWrite` for a folder with files that hgogen did not write.
    """
    if ecosystems is None:
        return files
    library = folder(step, files, chosen(ecosystems, step.name), real=real, costs=costs_known(where))
    _demand_replaceable(where, library)
    return library


def figures_by_path(files: Mapping[str, bytes], ecosystems: str | None) -> dict[str, bytes]:
    """Return image files by path in the folder of results: in extras/ if `ecosystems` are named, else at the top."""
    return {f"{EXTRAS}/{name}" if ecosystems else name: content for name, content in files.items()}


def costs_known(where: Folder) -> Mapping[str, Any] | None:
    """Return the measured costs in a folder, as `hgogen cost` writes them; None without them."""
    (path,) = where.demand(COSTS)
    try:
        costs = json.loads(content_of(path, BYTES))
    except (Unread, ValueError, RecursionError):
        return None
    return costs if isinstance(costs, dict) else None


def _demand_replaceable(where: Folder, library: Files) -> None:
    """Raise `CannotWrite` if one of the files `library` would replace a file that hgogen did not write, or if src/
    holds a foreign source, which every build would compile."""
    for path, text in zip(where.demand(*library), library.values(), strict=True):
        if path.exists() and _MARK in text and _MARK.encode() not in content_of(path, BYTES):
            raise CannotWrite(str(path), "hgogen did not write what is there", "take another folder by --out")
    source = where.demand(f"{SOURCES}/{COSTS}")[0].parent
    names = {Path(name).name for name in library}
    if others := sorted(path.name for path in source.glob("*") if path.name not in names):
        reason = f"it also contains {others[0]}, which a build would compile too"
        raise CannotWrite(str(source), reason, "remove that, or take another folder by --out")


@dataclass(eq=False)
class CostTooHigh(HgogenError):
    """The error for costs above their limits: (name, value, limit) of each."""

    status: ClassVar[int] = 1
    over: tuple[tuple[str, int, int], ...]

    def __str__(self) -> str:
        return "; ".join(f"{MEANINGS[name]}: {value}, more than {limit}" for name, value, limit in self.over)


def _limit_option(what: str) -> typer.models.OptionInfo:
    option: typer.models.OptionInfo = typer.Option(metavar="N", min=0, help=f"Fail where {what} is more.")
    return option


@dataclass(frozen=True)
class CostReport(ModelReport):
    """The measured costs of a model's C."""

    json_keys = "model *costs files"

    costs: Costs
    files: Written
    title: str
    limits: Mapping[str, int | None]

    def tables(self) -> Iterator[Any]:
        """Yield a row for each cost."""
        rows = ((meaning, str(getattr(self.costs, key))) for key, meaning in MEANINGS.items())
        yield headed(self.title, "what", "how much", numbers=1, rows=rows)
        yield f"{self.costs.compiler} {self.costs.flags}\n"

    def demand(self) -> None:
        """Raise `CostTooHigh` if a cost is above its limit."""
        limited = [(key, getattr(self.costs, key), limit) for key, limit in self.limits.items() if limit is not None]
        if over := tuple((key, value, limit) for key, value, limit in limited if value > limit):
            raise CostTooHigh(over)


@command(CostReport)
def cost_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that holds one folder a model.")] = Path("generated"),
    name: Prefix = None,
    max_flash: Annotated[int | None, _limit_option("the step's code, in bytes,")] = None,
    max_ram: Annotated[int | None, _limit_option("its state with the parameters, in bytes,")] = None,
    max_stack: Annotated[int | None, _limit_option("its stack, in bytes,")] = None,
    max_instructions: Annotated[int | None, _limit_option("the worst number of instructions of a step")] = None,
) -> CostReport:
    """Measure the cost of a model's C on a Cortex-M4F, compiled by arm-none-eabi-gcc and run in QEMU: over the model's
    trial without jumps (or a proposed trial), and over the same samples with gaps, jumps and NaN. Writes
    MODEL/cost.json below --out, which `hgogen generate --for` copies into the README of its folder.
    """
    demand_prefix(name)
    demand_board()
    loaded = load(model).set(setting)
    folder = Folder(out, name or named(loaded, observer))
    folder.demand(COSTS)
    note(*loaded.notes)
    unnamed_step, real = loaded.step(observer), loaded.setting.real or "float"
    trial = trials_of(loaded, unnamed_step)[0]
    step = prefixed(unnamed_step, name) if name else unnamed_step
    costs = measured(step, targets.c99(step, real=real, check=False), rows_given(unnamed_step, trial), real)
    paths = folder.write({COSTS: json_text({"model": loaded.name, **encoded(costs)}) + "\n"})
    limits = {
        "flash_bytes": max_flash,
        "ram_bytes": max_ram,
        "stack_bytes": max_stack,
        "worst_instructions": max_instructions,
    }
    return CostReport(loaded.path, costs, tuple(paths), f"{step.name} in {real} on a {costs.machine}", limits)


C99 = "c99"
_TAKES = ("command", "real", "check")  # arguments of a language's target besides the step


def _languages() -> list[str]:
    return [name for name in targets.__all__ if set(_TAKES) <= signature(getattr(targets, name)).parameters.keys()]


def _demand_code(target: str, ecosystems: str | None, name: str | None) -> None:
    """Raise `UnknownCase` for a target that is no language, `BadParameter` if --for is given with another than C,
    `UnknownEcosystem`, `ReservedName`, or what `demand_prefix` raises."""
    _demand_language(target)
    demand_prefix(name)
    if ecosystems is not None and target != C99:
        raise typer.BadParameter(f"is for {C99}, not for {target}; leave one of the two", param_hint="--for")
    if ecosystems is not None:
        chosen(ecosystems, name or "")


def _demand_language(target: str) -> None:
    if target in set(targets.__all__) - set(_languages()):
        declaration = signature(getattr(targets, target))
        if "command" in declaration.parameters:
            lacks = ", ".join(name for name in _TAKES if name not in declaration.parameters)
            why = f"takes command, and not {lacks}, as a language does"
        elif declaration.return_annotation is Files:
            why = f"is no language of its own; call hg.targets.{target}"
        else:
            why = f"is for Python, as hg.targets.{target}"
        raise UnknownCase(f"--target {target}:", f"{why}; there are {', '.join(_languages())}")
    demand_known("target", target, _languages())


def _join_with_or(names: list[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


_SPOKEN = f"The language of the code: {_join_with_or(_languages())}."
Target = Annotated[str, typer.Option("--target", metavar="NAME", help=_SPOKEN)]


def run_trials(step: CallableStep, trials: tuple[Trial, ...], engine: Engine, count: int | None) -> list[Tried]:
    """Return the results of each trial over its seeds, or over the first `count` of them. Display a progress bar."""
    seeds = {trial.name: trial.seeds if count is None else tuple(range(count)) for trial in trials}
    with Bar(f"trials in {LANGUAGES[engine]}", sum(map(len, seeds.values()))) as bar:
        return [tried(step, trial, engine, seeds[trial.name], bar.tick) for trial in trials]


def _emit(step: CallableStep, model: Model, observer: str | None, target: str, name: str | None) -> Sources:
    words = ["hgogen generate", model.argument, *(["--observer", observer] if observer else []), *model.setting.words]
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
    """The claims about a model, its generated code, and its trials in C and in Python."""

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
        """Yield the trial results, and whether C and Python agree."""
        yield trials_table([one.summary for one in self.trials], self.unit)
        if self.comparison:
            yield agreement_table(self.comparison, self.unit)
        if self.self_check:
            yield f"self-check of the {self.code}: {self.self_check}\n"

    def demand(self) -> None:
        """Raise `Disagree` if C and Python disagree."""
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
    """Check a model, write and compile its C, simulate it in C and in Python, compare both, and draw figures.

    All files are in the folder --out, with report.json, which --json prints. Without a C compiler the trials run in
    Python with one seed each, and the C is written but not run. With --target the code is in another language, and its
    self-check runs if there is a compiler. With --for the C is in src/, figures are in extras/, and the folder contains
    the files that the ecosystem needs.
    """
    _demand_code(target, ecosystems, name)
    loaded = load(model).set(setting)
    folder = Folder(Path("build"), name) if name and out is None else folder_of(out, loaded, observer)
    folder.demand("report.json")
    step = loaded.step(observer)
    trials = trials_of(loaded, step)
    claims = checked(loaded, name=observer)
    early(checks_table(claims.head, claims.checks, claims.accepted))
    note(*claims.notes)
    files, library = _generate_code(loaded, step, claims.known, observer, target, ecosystems, name, folder)
    engine = engine_here()
    self_check = _run_self_check(files, engine)
    done = run_trials(step, trials, engine, seeds if engine == "c" else 1)
    in_python = run_trials(step, trials, "python", 1) if engine == "c" else []
    comparison = agreements(done, in_python, step.dt) if in_python else ()
    drawn = figures_by_path(rendered(trial_figures(step, done, claims.known)), ecosystems)
    rows = tuple(map(TrialRow, summaries(step, done, engine, note), done))
    code = f"{_real(loaded)} {'C' if target == C99 else target}"
    report = Built(loaded.path, claims, dict(files.names), self_check, rows, comparison, code, step.time)
    return folder.save(report, "report.json", {**library, **drawn})


def _generate_code(
    model: Model,
    step: CallableStep,
    known: ErrorBound | None,
    observer: str | None,
    target: str,
    ecosystems: str | None,
    name: str | None,
    folder: Folder,
) -> tuple[Sources, Files]:
    note(*unobservable_note(model.plant, step.observer.form))
    stated = stating(step, model, known)
    coded = prefixed(stated, name) if name else stated
    files = _emit(coded, model, observer, target, name)
    return files, lay_out(coded, files, ecosystems, _real(model), folder)


def _run_self_check(files: Sources, engine: Engine) -> str | None:
    if not files.recipe:
        return native.run_check(files).strip() if engine == "c" else None
    try:
        return native.run_recipe(files).strip()
    except native.NoTool as error:
        note(f"{error}: the code is written but not tried")
        return None


@dataclass(frozen=True)
class Generated:
    """The generated code of a model."""

    model: Annotated[str, "path of the model"]
    c_names: Annotated[dict[str, str], "by signal, its name in the language, where that is another"]
    files: Written


@dataclass(frozen=True)
class AllGenerated(Report):
    """The generated code of several models."""

    models: Annotated[tuple[Generated, ...], "the code of each model"]

    def tables(self) -> Iterator[Any]:
        """Yield the files of each model."""
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
    """Write the code of models, by default C, and figures of their trials, simulated by the C, or by Python without a
    compiler. With --for the C is in src/, figures are in extras/, and the folder contains build files, an example, and
    a README with the costs that `hgogen cost` measured.
    """
    _demand_code(target, ecosystems, name)
    if name and len(models) > 1:
        raise typer.BadParameter("is one name, of one model; write the models one by one", param_hint="--name")
    loaded = [load(model).set(setting) for model in models]
    for first, second in combinations(loaded, 2):
        if name_key(first.name) == name_key(second.name):
            reason = (
                f"{first.path} and {second.path} have the same name, and the files of one would replace those "
                "of the other"
            )
            raise typer.BadParameter(f"{reason}; give each a folder of its own by --out", param_hint="MODEL")
    prepared = []
    with Bar("models", len(loaded)) as bar:
        for one in loaded:  # all models, before any trial is run or file written
            folder = Folder(out, name or named(one, observer))
            note(*one.notes)
            step = one.step(observer)
            known = proved_bound(step, one, note)
            code, library = _generate_code(one, step, known, observer, target, ecosystems, name, folder)
            folder.demand(*library)
            prepared.append((one, folder, step, known, code, library))
            bar.tick()
    engine: Engine = engine_here() if any(one.has("trial") for one in loaded) else "python"
    generated = []
    for one, folder, step, known, code, library in prepared:
        paths = folder.write({**library, **figures_by_path(_figures(one, step, known, engine), ecosystems)})
        generated.append(Generated(one.path, dict(code.names), tuple(paths)))
    return AllGenerated(tuple(generated))


def _figures(model: Model, step: CallableStep, known: ErrorBound | None, engine: Engine) -> dict[str, bytes]:
    if not model.has("trial"):
        note(f"{model.path} has no trial, so there are no figures of it")
        return {}
    done = run_trials(step, model.trials(), engine, 1)
    note(*departures(done, step.time))
    return rendered(trial_figures(step, done, known))


@dataclass(frozen=True, eq=False)
class SimulatedTrial:
    """A trial of a step as printed in JSON."""

    json_keys = "*row bounds falling each=row.tried.each"

    row: TrialRow
    bounds: Annotated[tuple[BoundedError, ...], "each state's error beside what is proved of it"]
    falling: Annotated[
        LyapunovDecay | None, "how e' S e falls without noise; null for an observer without a covariance"
    ]


@dataclass(frozen=True, eq=False)
class Simulated(ModelReport):
    """The results of a model's observer on its trials."""

    json_keys = "model gains trials files"

    step: CallableStep
    trials: Annotated[tuple[SimulatedTrial, ...], "what followed each event of each trial"]
    files: Written

    @property
    def gains(self) -> dict[str, Any]:
        """The observer's gains; gains of several coordinates or outputs by their names."""
        return gains_by_name(self.step.layout.gains)

    def tables(self) -> Iterator[Any]:
        """Yield the events of each trial, and the errors with their bounds."""
        yield f"{self.step.observer.name} observer: {', '.join(map(field_text, self.step.layout.gains))}\n"
        yield from (f"{line}\n" for line in deviation_lines(self.step))
        yield trials_table([one.row.summary for one in self.trials], self.step.time)
        yield from (bounds_table(one.bounds) for one in self.trials if one.bounds)
        falls = (one.falling for one in self.trials if one.falling)
        yield from (f"{one.trial}: {one.sentence(self.step.time)}" for one in falls)


@dataclass(frozen=True, eq=False)
class SimulatedCampaigns(ModelReport):
    """The campaigns of a model's observer, with --vary or --runs."""

    gains: Annotated[dict[str, Any], "the observer's gains, those of several coordinates by the name of each"]
    campaigns: Annotated[tuple[CampaignRow, ...], "the campaign on each trial"]

    def tables(self) -> Iterator[Any]:
        """Yield a table for each campaign."""
        return (part for row in self.campaigns for part in row.tables())


@command(Simulated, SimulatedCampaigns)
def simulate_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    seeds: Seeds = None,
    reader: ReaderOption = None,
    trial: OneTrial = None,
    campaign_options: Runs = NO_RUNS,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the figures; by default no figures are drawn.")
    ] = None,
) -> Simulated | SimulatedCampaigns:
    """Simulate a model's observer on its trials and print the metrics; with --vary or --runs, a campaign of many runs.

    With --out it draws figures of the trials as `build` does, with proved error bounds if the model declares bounds.
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    trials = trials_of(loaded, step)
    chosen, engine = one_or_all(trials, trial), engine_here(reader)
    if campaign_options:
        if out is not None:
            note("a campaign draws no figures, so --out has no use")
        rows = campaigns(lambda _: {observer or step.observer.name: step}, chosen, engine, campaign_options, seeds)
        return SimulatedCampaigns(loaded.path, gains_by_name(step.layout.gains), rows)
    if out is not None:
        Folder(out).demand(*(f"{one.name}_states.svg" for one in chosen))
    done = run_trials(step, chosen, engine, seeds)
    summed = map(TrialRow, summaries(step, done, engine, note), done)
    known = proved_bound(step, loaded, note)
    errors = [bounded_errors(step.states, one.first, known) if known else () for one in done]
    falls = [lyapunov_decay(step, one, engine) for one in chosen]
    paths = [] if out is None else Folder(out).write(rendered(trial_figures(step, done, known)))
    return Simulated(loaded.path, step, tuple(map(SimulatedTrial, summed, errors, falls)), tuple(paths))
