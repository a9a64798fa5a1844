"""The command `check`: the claims of one model, or the answers to many."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperCommand

import hgogen as hg
from hgogen.analysis.observability import Observability
from hgogen.analysis.singularity import Singularity
from hgogen.analysis.undefined import undefined_slopes, undefined_values
from hgogen.check import Check, Refuted
from hgogen.commands import findings, library, tables
from hgogen.commands.advice import Advice, advice
from hgogen.commands.checked import Checked, checked
from hgogen.commands.command import ModelReport, command
from hgogen.commands.latex import fragment
from hgogen.commands.options import Tuned
from hgogen.commands.output import Bar, json_text, show
from hgogen.commands.process import note, results
from hgogen.errors import HgogenError
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.rigor.bounds import Range
from hgogen.run.gramian import Sight, sight
from hgogen.target import demand as demand_place
from hgogen.trial import Trial
from hgogen.which_forms import Survey

CertificateFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Write what is proved as a certificate, JSON.")
]
JsonFile = Annotated[
    str | None, typer.Option("--json", metavar="[FILE]", help="Print JSON alone; --json=FILE writes it into FILE.")
]
Bounds = Annotated[
    list[str] | None,
    typer.Option("--bound", metavar="EXPR", help="The range of an expression on the declared box; repeat it."),
]
Limit = Annotated[
    float | None,
    typer.Option(min=0.1, help=f"Processor seconds for each model of a library, by default {library.LIMIT:g}."),
]
_PRINTED = "-"  # the standard output, in the place of a file


class OptionalFile(TyperCommand):
    """A command whose --json takes a file where --library is given; else it is a flag, as everywhere."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare --json its value."""
        several = any(arg.split("=")[0] == "--library" for arg in args)
        words: list[str] = []
        for arg, following in zip(args, [*args[1:], None], strict=False):
            bare = arg == "--json" and (not several or following is None or following.startswith("-"))
            words.append(f"--json={_PRINTED}" if bare else arg)
        return super().parse_args(ctx, words)


@dataclass(frozen=True)
class ObservedPlant:
    """What is observable of a plant as JSON has it."""

    json_keys = "*seen least_seen"

    seen: Observability
    least_seen: Annotated[Sight | None, "the direction that the outputs show least; null where it is not measured"]


@dataclass(frozen=True)
class NamedRange:
    """The range of an expression as JSON has it."""

    json_keys = "expression *range"

    expression: Annotated[str, "the expression"]
    range: Range


@dataclass(frozen=True)
class CheckReport(ModelReport):
    """What is known of a model."""

    json_keys = "model headline observability forms=survey.rows bounds *claims undefined singular *advice"

    headline: Annotated[str, "the whole in one line"]
    observability: Annotated[ObservedPlant, "what is generically observable"]
    survey: Survey
    bounds: Annotated[tuple[NamedRange, ...], "the range of each --bound"]
    claims: Checked
    undefined: Annotated[tuple[Check, ...], "rows and derivatives without a finite value somewhere in the ranges"]
    singular: Annotated[Singularity, "where the plant is not observable; its checks do not count for the exit status"]
    advice: Advice | None

    def latex(self) -> str:
        """The equations and the checks as LaTeX."""
        claims = self.claims
        return fragment(claims.form, claims.checks, claims.accepted) + self.singular.latex()

    def certify(self, path: Path) -> None:
        """Write what is proved as a certificate; says what in it can be verified again."""
        from hgogen.certificates.certificate import asserted, certificate, stated

        content = certificate(self.claims.form, self.claims.checks, self.claims.observer)
        hg.write({path.name: json.dumps(content, indent=1, ensure_ascii=True) + "\n"}, path.parent)
        again = f"hgogen recheck {path} verifies it" if asserted(content) else "nothing in it can be verified"
        note(f"wrote {path}; {again} again")
        for id, reason in stated(content):
            note(f"{path} only states {id}, it cannot be verified again: {reason}")


@command(CheckReport, library.LibraryAnswer, cls=OptionalFile)
def check_(
    model: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="A model file, or the name of one that `hgogen list` shows.")
    ] = None,
    certificate: CertificateFile = None,
    latex: Annotated[bool, typer.Option("--latex", help="Print the equations and the checks as LaTeX.")] = False,
    bounds: Bounds = None,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    deep: Annotated[bool, typer.Option("--deep", help="Ask the forms too that may take seconds.")] = False,
    many: Annotated[
        Path | None, typer.Option("--library", metavar="FILE", help="Answer every model of a JSON file.")
    ] = None,
    limit: Limit = None,
    as_json: JsonFile = None,
) -> None:
    """Print what is observable, which forms the plant is in and why not in the others, and what is claimed of the
    model's form and observer, each claim with its verdict.

    With an observer the exit status is 1 if a claim is refuted that nobody accepted. With --library FILE, which holds
    {"models": [MODEL, ..]}, each MODEL a plain-text model, with "bound_queries": [expression, ..] beside its tables, or
    lists of names and expressions, {"name": "osc", "states": ["x1", "x2"], "f": ["x2", "-a*x1 + u"], "outputs": ["y"],
    "h": ["x1"], "inputs": ["u"], "known_params": ["a"], "unknown_params": [], "x_box": {"x1": [-1, 1]}, "u_box": {"u":
    [-1, 1]}, "param_ranges": {"a": [1, 2]}, "bound_queries": ["x1**2"]}; all but name, states, f, h may be missing. The
    answer: an object from each model's name to its answers, null where there is none.
    """
    if (model is None) == (many is None):
        raise typer.BadParameter("give a MODEL, or --library FILE", param_hint="MODEL")
    _demand_places(certificate, _file(as_json))
    options: dict[str, Any] = {"--certificate": certificate, "--latex": latex, "--bound": bounds, "--deep": deep}
    options |= {"--observer": observer, **dict(word.split(maxsplit=1) for word in setting.words)}
    asked = {"--limit": limit} if many is None else options
    if unused := next((name for name, value in asked.items() if value), None):
        reason = "is for --library" if many is None else "does nothing beside --library, and is for a MODEL"
        raise typer.BadParameter(reason, param_hint=unused)
    if many is not None:
        _library(many, limit or library.LIMIT, as_json)
        return
    loaded = load(str(model)).set(setting)
    report = _checked(loaded, observer, bounds or (), deep, quiet=latex or bool(as_json), advised=not latex)
    claims = report.claims
    if latex:
        print(report.latex(), file=results())
    elif as_json:
        _print_json(report, as_json)
    note(*(sentence for sentence in claims.notes if sentence not in loaded.notes))
    if certificate is not None:
        report.certify(certificate)
    if claims.demanded and claims.open:
        raise Refuted(claims.open, claims.form, claims.accepted, plain=loaded.plain)


def _demand_places(certificate: Path | None, json_file: Path | None) -> None:
    """Raises: `BadParameter`; `CannotWrite` where one of the files cannot be written."""
    for option, file in (("--certificate", certificate), ("--json", json_file)):
        if file is not None and file.is_dir():
            raise typer.BadParameter(f"{file} is a folder; give a file in it", param_hint=option)
        if file is not None:
            demand_place([file.name], file.parent)
    if certificate is not None and certificate == json_file:
        raise typer.BadParameter("one file cannot be the certificate and the JSON", param_hint="--certificate")


def _file(as_json: str | None) -> Path | None:
    """The file that --json names."""
    return None if as_json in (None, _PRINTED) else Path(str(as_json))


def _print_json(value: Any, as_json: str) -> None:
    """Write JSON into the file that --json names, else print it."""
    file = _file(as_json)
    if file is None:
        show(True, value)
        return
    new = "" if file.parent.is_dir() else ", in a new folder"
    hg.write({file.name: json_text(value, indent=1) + "\n"}, file.parent)
    note(f"wrote {file}{new}")


def _checked(
    loaded: Model, observer: str | None, bounds: Iterable[str], deep: bool, quiet: bool, advised: bool
) -> CheckReport:
    """What is known of a model. Unless `quiet`, each part is printed as soon as it is known, so that a model whose next
    part takes long, or fails, shows the others."""

    def say(*parts: Any) -> None:
        show(False, {}, *(() if quiet else parts))

    plant = loaded.plant
    if observer is not None:
        loaded.tuned(observer)
    note(*loaded.notes)  # before anything is called proved
    ranges = {text: hg.bound(text, plant) for text in bounds}
    gaps = (*undefined_values(plant), *undefined_slopes(plant))
    say(findings.undefined(gaps))
    seen = hg.observability(plant)
    least = _least(loaded) if seen.rank == seen.n else None
    try:
        forms = hg.survey(plant, deep=deep)
        claims = checked(loaded, forms, observer)
        first = findings.headline(seen, forms, claims, least)
        say(first, "")
    finally:
        say(tables.ranges(ranges), findings.observed(seen, least))
    say(tables.survey(forms, claims.checks))
    if claims.shown:
        say(tables.checks(claims.head, claims.checks, claims.accepted))
    singular = hg.singularity(plant)
    if seen.rank == seen.n:
        say(tables.checks(singular.head, singular.checks, ()))
    say(tables.theorem(claims.theorem, claims.hypotheses))
    take = _advice(loaded, observer, seen, forms, claims, deep) if advised else None
    if take:
        say(findings.taking(take))
    named = tuple(NamedRange(text, one) for text, one in ranges.items())
    return CheckReport(loaded.path, first, ObservedPlant(seen, least), forms, named, claims, gaps, singular, take)


def _advice(
    loaded: Model, observer: str | None, seen: Observability, forms: Survey, claims: Checked, deep: bool
) -> Advice:
    """What to take, which is asked of the file, without what is set."""
    written = loaded.set(AS_WRITTEN)
    own = checked(written, forms, observer) if loaded.setting else claims
    return advice(written, seen, forms, own, deep=deep)


def _least(model: Model) -> Sight | None:
    """What the outputs show at least, along the model's first trial, else on its box; a note says why not."""
    trials: list[Trial | None] = [None]
    try:
        trials = [*(model.trials()[:1] if model.has("trial") else ()), None]
    except HgogenError as error:
        note(str(error))
    for trial in trials:
        try:
            return sight(model.plant, trial)
        except HgogenError as error:
            note(str(error))
    return None


def _library(path: Path, limit: float, out: str | None) -> None:
    """Answer all models of a file; the table says how many have which answer, and what is wrong with the others."""
    models = library.read(path)
    with Bar("models", len(models)) as bar:
        answers = library.check(models, limit=limit, tick=bar.tick)
    table = Table("field", "true", "false", "other", "no answer", box=None, title=f"{len(answers)} models")
    for field in library.FIELDS:
        values = [answer[field] for answer in answers.values()]
        true, false, none = (sum(value is kind for value in values) for kind in (True, False, None))
        table.add_row(field, *map(str, (true, false, len(values) - true - false - none, none)))
    for name, answer in answers.items():
        if "error" in answer:
            table.add_row(f"{name}: {answer['error']}")
    if out is None:
        show(False, answers, table)
    else:
        _print_json(answers, out)
    bad = sum("error" in answer for answer in answers.values())
    if bad:
        note(f"{bad} of {len(answers)} models {'has an error' if bad == 1 else 'have errors'}")
