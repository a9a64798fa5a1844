"""The commands `build`, `generate` and `simulate`: a model's observer in C and in Python, and what its trials show."""

from dataclasses import replace
from inspect import signature
from itertools import combinations
from pathlib import Path
from typing import Annotated

import typer

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.calling import native
from hgogen.calling.samples import Engine
from hgogen.certificates.error_bound import ErrorBound
from hgogen.commands import drawings, stated_bounds, tables, trial_runs
from hgogen.commands.campaigning import campaigns
from hgogen.commands.checked import checked
from hgogen.commands.command import (
    NO_RUNS,
    Bar,
    Folder,
    Json,
    ModelArgument,
    OneTrial,
    Out,
    ReaderOption,
    Runs,
    Seeds,
    Tuned,
    command,
    engine_here,
    folder_of,
    json_text,
    named,
    one_or_all,
    rendered,
    show,
)
from hgogen.commands.headed import file_list
from hgogen.commands.packing import For, Prefix, beside, demand_packing, packed
from hgogen.commands.process import console, note
from hgogen.emit.naming import prefixed
from hgogen.emit.syntax import Real
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting, UnknownCase, demand_known
from hgogen.reading.filename import same
from hgogen.reading.named import by_name, written
from hgogen.sentence import encoded
from hgogen.target import Files, Sources
from hgogen.trial import Trial
from hgogen.trials.agreement import Disagree
from hgogen.trials.comparison import seen
from hgogen.trials.falling import falling

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


def _tried(step: CallableStep, trials: tuple[Trial, ...], engine: Engine, count: int | None) -> list[trial_runs.Tried]:
    seeds = {trial.name: trial.seeds if count is None else tuple(range(count)) for trial in trials}
    language = {"c": "C", "python": "Python"}[engine]
    with Bar(f"trials in {language}", sum(map(len, seeds.values()))) as bar:
        return [trial_runs.tried(step, trial, engine, seeds[trial.name], bar.tick) for trial in trials]


def _emitted(step: CallableStep, model: Model, observer: str | None, target: str, name: str | None) -> Sources:
    """The files of a target, in float unless the precision is set, and the document that their head names; the banner
    says which command makes them again, and what they call otherwise is noted."""
    words = ["hgogen generate", model.name, *(["--observer", observer] if observer else []), *model.setting.words]
    words += [f"--target {target}"] if target != C99 else []
    words += [f"--name {name}"] if name else []
    files: Sources = getattr(targets, target)(step, real=_real(model), command=" ".join(words))
    note(*files.notes)
    return replace(files, texts=(*files.texts, *targets.markdown(step, real=_real(model)).texts))


def _real(model: Model) -> Real:
    return model.setting.real or "float"


@command()
def build_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Out = None,
    target: Target = C99,
    ecosystems: For = None,
    name: Prefix = None,
    seeds: Seeds = None,
    as_json: Json = False,
) -> None:
    """Check a model, generate and compile its code, try it in C and in Python, compare them, draw the figures.

    Everything lies in the folder --out, with report.json, which is what --json prints. Without a C compiler
    the trials run in Python, one seed each, and the C is written but not tried. With --target another language is
    written in the place of C, and its self-check is run where its compiler is there. With --for the C lies in
    src/, with what the ecosystem asks for beside it, and figures in extras/.

    JSON keys: model, plant, form, coordinates, flow, outputs, gains, dt, checks, refuted, theorem, notes (as in
    `check`), c_names (by signal, where the language, C or another, has another name), compiler, self_check (what it
    printed), trials (trial, criterion, seeds, engine, times, settled, worst, peak, calm, triggered, loud,
    latched, alarm_ratio, rms, clamped, left, acted), comparison (trial, seed, until, before, after, settled, dt,
    agreed), files.
    """
    _demand_language(target)
    demand_packing(ecosystems, name, target, C99)
    loaded = load(model).set(setting)
    folder = Folder(Path("build"), name) if name and out is None else folder_of(out, loaded, observer)
    folder.demand("report.json")
    step = loaded.step(observer)
    trials = trial_runs.trials_of(loaded, step)
    claims = checked(loaded, name=observer)
    stated = stated_bounds.stating(step, loaded, claims.known)
    coded = prefixed(stated, name) if name else stated
    if not as_json:
        console().print(tables.checks(claims.head, claims.checks, claims.accepted))
    note(*claims.notes)
    files = _emitted(coded, loaded, observer, target, name)
    library = packed(coded, files, ecosystems, _real(loaded), folder)
    engine = engine_here()
    self_check = _checked(files, engine)
    done = _tried(step, trials, engine, seeds if engine == "c" else 1)
    again = _tried(step, trials, "python", 1) if engine == "c" else []
    comparison = trial_runs.agreements(done, again, step.dt) if again else ()
    figures = rendered(drawings.figures(step, done, claims.known))
    written: dict[str, str | bytes] = {**library, **beside(figures, ecosystems)}
    paths = folder.demand(*written, "report.json")
    summaries = trial_runs.summaries(step, done, engine, note)
    report = {
        "model": loaded.path,
        **claims.as_dict(),
        "c_names": dict(files.names),
        "compiler": native.compiler(),
        "self_check": self_check,
        "trials": trial_runs.trial_rows(summaries, done),
        "comparison": comparison,
        "files": list(map(str, paths)),
    }
    folder.write({**written, "report.json": json_text(report) + "\n"})
    shown = [tables.trials(summaries, step.time)]
    if again:
        shown.append(tables.agreements(comparison, step.time))
    if self_check:
        language = "C" if target == C99 else target
        shown.append(f"self-check of the {_real(loaded)} {language}: {self_check}\n")
    show(as_json, report, *shown, file_list(paths))
    if not all(one.agreed for one in comparison):
        raise Disagree(tuple(one for one in comparison if not one.agreed))


def _checked(files: Sources, engine: Engine) -> str | None:
    """What the self-check printed; None where there is no compiler for it."""
    if not files.recipe:
        return native.run_check(files).strip() if engine == "c" else None
    try:
        return native.run_recipe(files).strip()
    except native.NoTool as error:
        note(f"{error}: the code is written but not tried")
        return None


@command()
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
    as_json: Json = False,
) -> None:
    """Write the code of models, by default C, and the figures of their trials as the C draws them, or Python's reading
    of it where there is no compiler. With --for the C lies in src/, with what the ecosystem asks for beside it: build
    files, an example, a README with the costs that `hgogen cost` measured; figures lie in extras/.

    JSON keys: models (a list of: model, c_names, by signal where the language, C or another, has another name, files).
    """
    _demand_language(target)
    demand_packing(ecosystems, name, target, C99)
    if name and len(models) > 1:
        raise typer.BadParameter("is one name, of one model; write the models one by one", param_hint="--name")
    loaded = [load(model).set(setting) for model in models]
    folders = [Folder(out, name or named(one, observer)) for one in loaded]
    for first, second in combinations(loaded, 2):
        if same(first.name) == same(second.name):
            reason = f"{first.path} and {second.path} have one name, and the files of one would replace the other's"
            raise typer.BadParameter(f"{reason}; give each a folder of its own by --out", param_hint="MODEL")
    steps, codes, libraries, written = list[CallableStep](), list[Sources](), list[Files](), []
    known = list[ErrorBound | None]()
    for one, folder in zip(loaded, folders, strict=True):  # of all of them, before anything is tried or written
        note(*one.notes)
        steps.append(one.step(observer))
        known.append(stated_bounds.proved(steps[-1], one, note))
        stated = stated_bounds.stating(steps[-1], one, known[-1])
        coded = prefixed(stated, name) if name else stated
        codes.append(_emitted(coded, one, observer, target, name))
        libraries.append(packed(coded, codes[-1], ecosystems, _real(one), folder))
        folder.demand(*libraries[-1])
    engine: Engine = engine_here() if any(one.has("trial") for one in loaded) else "python"
    made = zip(loaded, folders, steps, known, codes, libraries, strict=True)
    for one, folder, step, error, code, library in made:
        files: dict[str, str | bytes] = {**library}
        if one.has("trial"):
            done = _tried(step, one.trials(), engine, 1)
            note(*trial_runs.departures(done, step.time))
            files |= beside(rendered(drawings.figures(step, done, error)), ecosystems)
        else:
            note(f"{one.path} has no trial, so there are no figures of it")
        paths = folder.write(files)
        written.append({"model": one.path, "c_names": dict(code.names), "files": list(map(str, paths))})
    show(as_json, {"models": written}, *(file_list(one["files"]) for one in written))


@command()
def simulate_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    seeds: Seeds = None,
    reader: ReaderOption = None,
    trial: OneTrial = None,
    asked: Runs = NO_RUNS,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the figures; by default none.")] = None,
    as_json: Json = False,
) -> None:
    """Try a model's observer on its trials and print the metrics; with --vary or --runs, a campaign of many runs.

    With --out the figures of the trials are drawn as by `build`, with the errors beside what is proved of them where
    the model has bounds.

    JSON keys: model, gains (as in `check`), trials (trial, criterion: what settled means, seeds, engine, times of the
    events, settled and worst time to settle after each, peak of theta as [smallest, largest], calm: time until theta <
    1.05, triggered: share of seeds, loud: share of the last fifth before the next event with theta > 1.5, latched:
    seeds in which theta does not come back, alarm_ratio: innovation at the largest theta over its threshold, rms by
    state, clamped: samples outside the box after the first 5%, left: the plant's own states and inputs that leave their
    declared ranges, a list of signal, low, high, time: the first, value there, farthest, acted: times of the restarts
    from the sample and of the projections onto the ranges, of so many runs, bounds: of a model that has them a list of
    state, unit, bound: what is proved of its error, after: how long after an event, worst: the largest error of the
    first seed there, null where the trial ends before; none where no time is proved from which on they hold, falling:
    of an observer with a covariance, else null, shown on the trial without noise: trial, ratio: the largest e' S e of a
    call over that of the call before, time, calls of which it is, eigenvalues of scaled S as [least, largest]; each:
    the same by seed, without left, acted, bounds and falling), files; of a campaign model, gains, campaigns (trial,
    observer, engine, criterion, runs, failed: those without a truth, varied: name, what, low, high, quantiles: name,
    low 5 %, middle 50 %, high 95 %, worst, run: the one that had it; with --repeat its run: varied, metrics, failed).
    """
    loaded = load(model).set(setting)
    step = loaded.step(observer)
    trials = trial_runs.trials_of(loaded, step)
    chosen, engine = one_or_all(trials, trial), engine_here(reader)
    gains = {gain.name: by_name(gain) for gain in step.layout.gains}
    if asked:
        if out is not None:
            note("of a campaign no figures are drawn, and --out names a folder for nothing")
        rows, shown = campaigns(lambda _: {observer or step.observer.name: step}, chosen, engine, asked, seeds)
        show(as_json, {"model": loaded.path, "gains": gains, "campaigns": rows}, *shown)
        return
    if out is not None:
        Folder(out).demand(*(f"{one.name}_states.svg" for one in chosen))
    done = _tried(step, chosen, engine, seeds)
    summaries = trial_runs.summaries(step, done, engine, note)
    pairs = zip(encoded(trial_runs.trial_rows(summaries, done)), done, strict=True)
    known = stated_bounds.proved(step, loaded, note)
    worst = [seen(step.states, one.first, known) if known else () for one in done]
    falls = [falling(step, one, engine) for one in chosen]
    listed_ = [
        {**summary, "bounds": bounds, "falling": falls_, "each": one.each}
        for (summary, one), bounds, falls_ in zip(pairs, worst, falls, strict=True)
    ]
    paths = [] if out is None else Folder(out).write(rendered(drawings.figures(step, done, known)))
    report = {"model": loaded.path, "gains": gains, "trials": listed_, "files": list(map(str, paths))}
    head = f"{step.observer.name} observer: {', '.join(map(written, step.layout.gains))}\n"
    lines = (f"{one.trial}: {one.sentence(step.time)}" for one in falls if one)
    drawn = [file_list(paths)] if paths else []
    within = map(tables.within, filter(None, worst))
    show(as_json, report, head, tables.trials(summaries, step.time), *within, *lines, *drawn)
