"""The command `check`: the claims about one model, or the answers for a library of models.

The report begins with one line: what is observable, which forms the plant is in, and whether the observer converges.
The forms are the rows of the survey, whose table follows. The observer's own form is named if it is not a proved one.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import sympy as sp
import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand

import hgogen as hg
from hgogen.analysis.observability import Answer, Observability
from hgogen.analysis.singularity import Singularity
from hgogen.analysis.undefined import MAKER, undefined_slopes, undefined_values
from hgogen.check import Check, ClaimId, Refuted, Verdict
from hgogen.commands import library
from hgogen.commands.advice import KNOWN, Admitted, Advice, advice
from hgogen.commands.claims import Checked, _text, checked, checks_table, coloured, few, theorem_table
from hgogen.commands.command import PRINTED, ModelReport, Report, Tuned, command, json_file, print_report
from hgogen.commands.output import Bar, filled, headed, note, results
from hgogen.errors import HgogenError, nearest
from hgogen.form import Form
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.rigor.bounds import Range
from hgogen.run.gramian import ObservabilityMeasure, as_share, observability_measure
from hgogen.sentence import NONE, Sentence, because, by_reason, down, point, up
from hgogen.target import demand as demand_place
from hgogen.theorem import Convergence, convergence
from hgogen.trial import Trial
from hgogen.which_forms import NOT_TRIED, Survey, of
from hgogen.which_forms import Row as FormRow

CertificateFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Write what is proved as a certificate, JSON.")
]
JsonFile = Annotated[
    str | None, typer.Option("--json", metavar="[FILE]", help="Print JSON alone; --json=FILE writes it into FILE.")
]
Bounds = Annotated[
    list[str] | None,
    typer.Option("--bound", metavar="EXPR", help="The range of an expression on the declared ranges. May be repeated."),
]
Limit = Annotated[
    float | None,
    typer.Option(min=0.1, help=f"Processor seconds for each model of a library, by default {library.LIMIT:g}."),
]


class OptionalFile(TyperCommand):
    """A command whose option --json takes a file name if --library is set; otherwise --json is a flag."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments as typer parses them, after giving a --json without a file name its default value."""
        several = any(arg.split("=")[0] == "--library" for arg in args)
        words: list[str] = []
        for arg, following in zip(args, [*args[1:], None], strict=False):
            bare = arg == "--json" and (not several or following is None or following.startswith("-"))
            words.append(f"--json={PRINTED}" if bare else arg)
        return super().parse_args(ctx, words)


@dataclass(frozen=True)
class ObservedPlant:
    """The observability of a plant as printed in JSON."""

    json_keys = "*observability least_seen=weakest"

    observability: Observability
    weakest: Annotated[
        ObservabilityMeasure | None, "the direction that the outputs show least; null where it is not measured"
    ]


@dataclass(frozen=True)
class NamedRange:
    """The range of an expression as printed in JSON."""

    json_keys = "expression *range"

    expression: Annotated[str, "the expression"]
    range: Range


_SINGULAR = "where the plant is not observable; its checks do not count for the exit status"


@dataclass(frozen=True, eq=False)
class CheckReport(ModelReport):
    """The results of a check of a model. Each part is computed when it is first read, so that the first tables are
    printed even if a later one takes long or fails.

    `name`: the tuning, None for the model's own observer; `certificate`: the file to which the certificate is written.
    """

    json_keys = "model headline observability=observed forms=survey.rows bounds *claims undefined singular *advice"

    loaded: Model
    name: str | None
    bounds: Annotated[tuple[NamedRange, ...], "the range of each --bound"]
    deep: bool
    certificate: Path | None

    @cached_property
    def observability(self) -> Observability:
        """The observability of the plant."""
        return hg.observability(self.loaded.plant)

    @cached_property
    def weakest(self) -> ObservabilityMeasure | None:
        """The observability measure with the least observable direction; None where it is not measured."""
        model, known = self.loaded, self.observability
        if known.rank < known.n or model.plant.discrete:
            return None
        trials: list[Trial | None] = [None]
        try:
            trials = [*(model.trials()[:1] if model.has("trial") else ()), None]
        except HgogenError as error:
            note(str(error))
        for trial in trials:
            try:
                return observability_measure(model.plant, trial)
            except HgogenError as error:
                note(str(error))
        return None

    @property
    def observed(self) -> Annotated[ObservedPlant, "what is generically observable"]:
        """The observability of the plant, with its least observable direction."""
        return ObservedPlant(self.observability, self.weakest)

    @cached_property
    def survey(self) -> Survey:
        """The forms that the plant is in, or is not in."""
        return hg.survey(self.loaded.plant, deep=self.deep)

    @cached_property
    def claims(self) -> Checked:
        """The claims about the observer; for a model without an observer, about the best form."""
        return checked(self.loaded, self.survey, self.name)

    @cached_property
    def undefined(self) -> tuple[Check, ...]:
        """The equations and derivatives that have no finite value somewhere in the ranges."""
        return (*undefined_values(self.loaded.plant), *undefined_slopes(self.loaded.plant))

    @cached_property
    def singular(self) -> Annotated[Singularity, _SINGULAR]:
        """The singular set of the plant."""
        return hg.singularity(self.observability.system)

    @cached_property
    def advice(self) -> Advice:
        """The advice on the model file as it is written, without the options of the command line."""
        written, claims = self.loaded.set(AS_WRITTEN), self.claims
        if self.loaded.setting:
            claims = checked(written, self.survey, self.name)
        return advice(written, self.observability, self.survey, claims, deep=self.deep)

    @property
    def headline(self) -> str:
        """The result of the check in one line."""
        return headline(self.observability, self.survey, self.claims, self.weakest)

    @property
    def notes(self) -> tuple[str, ...]:
        """The limits of the claims, and reasons for missing parts."""
        return self.claims.notes

    def latex(self) -> str:
        """Return the form's equations and the table of checks as LaTeX."""
        claims = self.claims
        return fragment(claims.form, claims.checks, claims.accepted) + self.singular.latex()

    def tables(self) -> Iterator[Any]:
        """Yield all tables."""
        yield undefined_list(self.undefined)
        known = ranges_table(self.bounds), observability_table(self.observability, self.weakest)
        try:
            first = self.headline
        except BaseException:  # an observer that is refused, or Ctrl-C
            yield from known
            raise
        yield from (first, "", *known)
        claims, singular = self.claims, self.singular
        yield survey_table(self.survey, claims.checks)
        if claims.informative:
            yield checks_table(claims.head, claims.checks, claims.accepted)
        if self.observability.rank == self.observability.n:
            yield checks_table(singular.head, singular.checks, ())
        yield theorem_table(claims.theorem, claims.hypotheses)
        yield advice_tables(self.advice)

    def demand(self) -> None:
        """Print the notes and write the certificate; raise `Refuted` if a claim about the observer is refuted and the
        user has not accepted it."""
        claims, model = self.claims, self.loaded
        note(*(sentence for sentence in self.notes if sentence not in model.notes))
        if self.certificate is not None:
            _certify(claims, self.certificate)
        if claims.demanded and claims.open:
            raise Refuted(claims.open, claims.form, claims.accepted, plain=model.plain)


def _certify(claims: Checked, path: Path) -> None:
    """Write the proofs as a certificate, and print which claims `recheck` can verify."""
    from hgogen.certificates.certificate import asserted, certificate, stated

    content = certificate(claims.form, claims.checks, claims.observer)
    hg.write({path.name: json.dumps(content, indent=1, ensure_ascii=True) + "\n"}, path.parent)
    again = f"hgogen recheck {path} verifies it" if asserted(content) else "nothing in it can be verified"
    note(f"wrote {path}; {again} again")
    for id, reason in stated(content):
        note(f"{path} only states {id}, it cannot be verified again: {reason}")


KINDS = ("high_gain", "uniform_injection", "riccati")


@dataclass(frozen=True, eq=False)
class ShortAnswer(CheckReport):
    """The short answer of a check: at most ten lines in the order of a user's questions, or the single claim `proof`.

        what is observable, and in which forms the plant is; which state is least observable
        which observer to take, and the line that makes it
        what is proved of it, what is not, and what to fix first

    Gains of the model are preferred to first gains, which nobody tried. Among either, an observer with proved
    convergence is preferred, of those the model's own; where none is proved, the model's own, else the extended Kalman
    filter. Only `KINDS` are tried beside the model's own observer, so that the answer takes seconds; all its tunings
    are where it has gains for none of these.
    """

    proof: str | None

    @property
    def notes(self) -> tuple[str, ...]:
        """The limits of the claims about an observer; none without an observer, where the lines say which to take."""
        return self.claims.notes if self.claims.demanded else ()

    @cached_property
    def advice(self) -> Advice:
        """The advice on the model with the options of the command line, about few observers."""
        short = self._about(self.claims.observer, *KINDS)
        if all(one.proposed for one in short.admitted) and self.loaded.tuning.tables:
            return self._about(*KINDS, *self.loaded.tuning.kinds.values())
        return short

    def _about(self, *kinds: str) -> Advice:
        return advice(self.loaded, self.observability, self.survey, self.claims, deep=self.deep, kinds=kinds)

    @property
    def as_set(self) -> bool:
        """Whether command-line options set the observer, so that none is advised."""
        return self.claims.step is not None and bool(self.loaded.setting)

    @property
    def preferred(self) -> Admitted | None:
        """The recommended observer; None if none is admitted."""
        own = self.claims.observer

        def place(one: Admitted) -> tuple[bool, int, bool, bool, tuple[int, int, int]]:
            known = KNOWN[one.convergence][1]
            return one.proposed, known, one.observer != own, one.observer != "riccati", one.rank

        return min(self.advice.admitted, key=place, default=None)

    @property
    def judged(self) -> tuple[str, Form, tuple[Check, ...]]:
        """The observer whose claims the answer prints: its name, its form and its checks."""
        claims, one = self.claims, None if self.as_set else self.preferred
        if one is None or (one.observer == claims.observer and not one.proposed):
            return claims.observer, claims.form, claims.checks
        observer = one.step.observer
        return observer.name, observer.form, observer.checks

    def tables(self) -> Iterator[Any]:
        """Yield the lines."""
        if self.proof:
            name, form, checks = self.judged
            yield _proof(form, checks, name, self.proof)
            return
        if self.bounds:
            yield ranges_table(self.bounds)
        least = self.weakest
        observed = _observed(self.observability, least)
        yield Text(f"{self.survey.plant.name}: {observed}; {in_forms(self.observability, self.survey)}", style="bold")
        if least is not None:
            yield line("weakest", weakest(least))
        yield from self._observer()
        name, _, checks = self.judged
        yield from standing(name, checks)
        yield line("fix first", self._fix(convergence(name, checks)))
        yield line("details", "--all, --form NAME, --proof NAME, --json")

    def _observer(self) -> Iterator[RenderableType]:
        claims = self.claims
        if self.as_set:
            words = f"{claims.observer} {_in(claims.form.kind)}", *self.loaded.setting.words
            yield line("observer", " ".join(words))
            return
        one, notes = self.preferred, self.advice.notes
        if one is None:
            yield line("take", notes[0] if notes else f"no observer admits {self.survey.plant.name}")
            return
        gains = "with starting gains, not yet simulated" if one.proposed else "with the gains of the model"
        name = "riccati, the extended Kalman filter," if one.observer == "riccati" else one.observer
        yield line("take", f"{name} {_in(one.form)}, {gains}:")
        yield Group(Text(f"{'':12}{one.line}", no_wrap=True, overflow="ignore"))

    def _fix(self, known: Convergence) -> str:
        """Return the one thing to fix first; `known`: the verdict on the observer's convergence."""
        for gap in self.undefined:
            return f"{gap.id}: {gap.reason}"
        if self.observability.known.rank.unobservable:
            advised = self.observability.known.advice
            return advised or "declare a trial: along a motion the outputs may show more than at a point"
        for check in self.claims.open if self.claims.demanded else ():
            return f"{check.id} is refuted: {check.advice or check.reason}"
        if self.weakest is not None and self.weakest.below_resolution:
            take = "add a sensor, or expect an estimate by the model alone"
            return f"{next(iter(self.weakest.direction))} hardly changes the outputs: {take}"
        test = "test the observer by simulation (hgogen simulate) or on a log (hgogen run, hgogen inspect)"
        return f"nothing, but convergence is not proved: {test}" if known is Convergence.UNKNOWN else "nothing"


def _in(form: str) -> str:
    return "in the plant's own states" if form == "original" else f"in {form} form"


@dataclass(frozen=True, eq=False)
class FormClaims(Report):
    """The claims about one form, each with its verdict, or the reason why the plant has no such form."""

    plant: str
    row: FormRow

    def tables(self) -> Iterator[Any]:
        """Yield a row for each claim."""
        form = self.row.form
        if form is None:
            yield Text(f"{self.plant} in {self.row.name} form: {self.row.why}")
        else:
            yield checks_table(form.head, form.checks, ())


@dataclass(frozen=True, eq=False)
class LibraryReport(Report):
    """The answers about the models of a library."""

    json_keys = "*answers"

    answers: Mapping[str, Mapping[str, Any]]

    def tables(self) -> Iterator[Any]:
        """Yield how often each field has which answer, and the errors of models."""
        each = self.answers.values()
        table = Table("field", "true", "false", "other", "no answer", box=None, title=f"{len(each)} models")
        for field in library.FIELDS:
            values = [answer[field] for answer in each]
            true, false, none = (sum(value is kind for value in values) for kind in (True, False, None))
            table.add_row(field, *map(str, (true, false, len(values) - true - false - none, none)))
        for name, answer in self.answers.items():
            if "error" in answer:
                table.add_row(f"{name}: {answer['error']}")
        yield table

    def demand(self) -> None:
        """Print a note on how many models have errors."""
        bad = sum("error" in answer for answer in self.answers.values())
        if bad:
            note(f"{bad} of {len(self.answers)} models {'has an error' if bad == 1 else 'have errors'}")


@command(CheckReport, library.LibraryAnswer, cls=OptionalFile)
def check_(
    model: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="A model file, or a name from `hgogen list`.")
    ] = None,
    certificate: CertificateFile = None,
    latex: Annotated[bool, typer.Option("--latex", help="Print the equations and the checks as LaTeX.")] = False,
    bounds: Bounds = None,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    deep: Annotated[bool, typer.Option("--deep", help="Also try forms that may take seconds.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Print all tables instead of the short answer.")] = False,
    proof: Annotated[str | None, typer.Option(metavar="NAME", help="Print a claim with its evidence.")] = None,
    many: Annotated[
        Path | None, typer.Option("--library", metavar="FILE", help="Answer every model of a JSON file.")
    ] = None,
    limit: Limit = None,
    as_json: JsonFile = None,
) -> None:
    """Print in ten lines what is observable, which observer to take, and what is proved of it and what is not.

    --all prints in which forms the plant is, why not in the others, and each claim about the form and the observer.
    --form NAME prints only the claims of that form, --proof NAME one claim with its evidence. With an observer the
    exit status is 1 if a claim is refuted that the model does not accept. With --library FILE, which holds
    {"models": [MODEL, ..]}, each MODEL a plain-text model, with "bound_queries": [expression, ..] beside its tables, or
    lists of names and expressions, {"name": "osc", "states": ["x1", "x2"], "f": ["x2", "-a*x1 + u"], "outputs": ["y"],
    "h": ["x1"], "inputs": ["u"], "known_params": ["a"], "unknown_params": [], "x_box": {"x1": [-1, 1]}, "u_box": {"u":
    [-1, 1]}, "param_ranges": {"a": [1, 2]}, "bound_queries": ["x1**2"]}; all but name, states, f, h may be missing. The
    answer: an object from each model's name to its answers, null where there is none.
    """
    if (model is None) == (many is None):
        raise typer.BadParameter("give a MODEL, or --library FILE", param_hint="MODEL")
    _demand_results(certificate, as_json, latex)
    options: dict[str, Any] = {"--certificate": certificate, "--latex": latex, "--bound": bounds, "--deep": deep}
    options |= {"--all": everything, "--proof": proof, "--observer": observer}
    options |= dict(word.split(maxsplit=1) for word in setting.words)
    _demand_unset({"--limit": limit} if many is None else options, many)
    if many is not None:
        print_report(_answered_library(many, limit or library.LIMIT), as_json)
        return
    loaded, whole = load(str(model)).set(setting), latex or bool(as_json) or everything
    if loaded.setting.form and not (whole or certificate or bounds or observer or proof):
        print_report(FormClaims(loaded.plant.name, of(loaded.setting.form, loaded.plant)), None)
        return
    if observer is not None:
        loaded.tuned(observer)
    note(*loaded.notes, *(loaded.tuning.synonyms if observer is None else ()))  # before any verdict is printed
    ranges = tuple(NamedRange(text, hg.bound(text, loaded.plant)) for text in bounds or ())
    parts = loaded.path, loaded, observer, ranges, deep, certificate
    report = CheckReport(*parts) if whole else ShortAnswer(*parts, proof)
    if latex:
        print(report.latex(), file=results())
        report.demand()
    else:
        print_report(report, as_json)


def _answered_library(path: Path, limit: float) -> LibraryReport:
    models = library.read(path)
    with Bar("models", len(models)) as bar:
        return LibraryReport(library.check(models, limit=limit, tick=bar.tick))


def _demand_unset(options: Mapping[str, Any], many: Path | None) -> None:
    """Raise `BadParameter` for an option that is set, and is for a library alone, or for a model alone."""
    if unused := next((name for name, value in options.items() if value), None):
        reason = "is for --library" if many is None else "does nothing beside --library, and is for a MODEL"
        raise typer.BadParameter(reason, param_hint=unused)


def _demand_results(certificate: Path | None, as_json: str | None, latex: bool) -> None:
    if latex and as_json:
        raise typer.BadParameter("prints LaTeX; ask for JSON by itself", param_hint="--latex")
    report = json_file(as_json)
    for option, file in (("--certificate", certificate), ("--json", report)):
        if file is not None and file.is_dir():
            raise typer.BadParameter(f"{file} is a folder; give a file in it", param_hint=option)
        if file is not None:
            demand_place([file.name], file.parent)
    if certificate is not None and certificate == report:
        raise typer.BadParameter("one file cannot be the certificate and the JSON", param_hint="--certificate")


def in_forms(observability: Observability, forms: Survey) -> str:
    """Return the forms that the plant is proved to be in, as text; without one, what to do instead for an observable
    plant."""
    if forms.proved:
        return f"{', '.join(row.kind for row in forms.proved)}, proved"
    rows = [row for row in forms.rows if row.kind != "original"]
    complete = all(row.why != NOT_TRIED for row in rows)
    settled = complete and all(row.verdict in (None, Verdict.REFUTED) for row in rows)
    why = "high-gain observers do not apply" if settled else "no high-gain form is proved for it"
    where = f"(why: --all{'' if complete else '; more forms: --deep'})"
    take = "" if observability.known.rank.unobservable else "take the extended Kalman filter; "
    return f"{take}{why} {where}"


def weakest(least: ObservabilityMeasure) -> str:
    """Return a sentence on the least observable state: how much a change of the state changes the outputs."""
    weak = next(iter(least.direction))
    if least.by_motion:
        return f"{weak}: observable only along a motion, not by the linearisation at a fixed point"
    over = f"along trial {least.trial}" if least.trial else "over the declared ranges"
    share = as_share(least.median)
    return f"{weak}: if it changes by its range, the outputs change by {share} times their range (median {over})"


def standing(observer: str, checks: Sequence[Check]) -> Iterator[RenderableType]:
    """Yield what is proved of an observer and its form, and what is not: the first claim of each in full (convergence
    if it is among them), and the names of the other claims."""

    def place(check: Check) -> tuple[bool, bool]:
        return check.id.fact != "convergence", check.id.maker != observer

    ordered = sorted(checks, key=place)
    for label, proved in (("proved", True), ("not proved", False)):
        chosen = [check for check in ordered if (check.verdict is Verdict.PROVED) is proved]
        if not chosen:
            yield line(label, "nothing" if proved else "nothing; conditions that you must ensure: --all")
            continue
        first, *others = chosen
        known = first.claim if proved else first.reason
        more = f"; also {few((check.id for check in others), 5)}" if others else ""
        yield line(label, f"{first.id}: {known}{more}")


def line(label: str, text: str) -> RenderableType:
    """Return a line of the answer: `label`, then `text`, which is indented where it is wrapped."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(width=10, no_wrap=True)
    grid.add_column(overflow="fold")
    grid.add_row(Text(label, style="bold"), Text(text))
    return grid


def _proof(form: Form, checks: Iterable[Check], observer: str, name: str) -> RenderableType:
    """Return the claim `name` with its reason, its advice and its evidence as in a certificate. Raises: `BadParameter`
    for a name of no claim."""
    from hgogen.certificates.certificate import NotCertifiable, certificate  # slow to import

    known = {str(check.id): check for check in checks}
    if name not in known:
        fix = nearest(name, known, f"the claims are {', '.join(known)}")
        raise typer.BadParameter(f"{name[:60]!r} is no claim about this model; {fix}", param_hint="--proof")
    check = known[name]
    try:
        (entry,) = (claim for claim in certificate(form, checks, observer)["claims"] if claim["id"] == name)
        texts = {key: json.dumps(value) for key, value in entry["evidence"].items()}
        evidence = [f"  {key}: {text[:_CUT]}{'..' * (len(text) > _CUT)}" for key, text in texts.items()]
    except NotCertifiable as error:
        evidence = [f"  none: {error}"]
    advised = (check.advice,) if check.advice else ()
    parts = (*advised, "evidence, whole by --certificate FILE, which hgogen recheck verifies again", *evidence)
    return Group(Text(str(check), style="bold"), *map(Text, parts))


_CUT = 200  # characters of a part of the evidence that are printed
_REPEATABLE = 20  # characters of a reason that may be repeated


def survey_table(forms: Survey, below: Iterable[Check] = ()) -> RenderableType:
    """Return the table of forms: whether the plant is in each form and in which order of states, or why not. What the
    checks `below` answer, a form or advice, is left out."""
    table = headed(f"{forms.plant.name}: which form, on the declared ranges", *("", "form", "order", "why"))
    before = NONE
    for row in forms.answered:
        why = because("as above") if row.why == before and len(str(row.why)) > _REPEATABLE else row.why
        table.add_row(coloured(row.verdict, row.verdict), Text(row.name), Text(few(row.order)), _text(why))
        before = row.why
    checked = {check.id.maker for check in below}
    reasons = by_reason((row.name, row.why) for row in forms.rows if row.verdict is None and row.kind not in checked)
    silent = [Text(f"{', '.join(names)}: {why}", style="dim") for why, names in reasons.items()]
    advised = {check.advice for check in below}
    settled = any(row.verdict is Verdict.PROVED for row in forms.answered)
    fixes = {row.fix: f"{row.name}: {row.fix}" for row in forms.answered if row.fix and row.fix not in advised}
    return Group(table, *silent, *map(Text, () if settled else fixes.values()), "")


def ranges_table(bounds: Iterable[NamedRange]) -> RenderableType:
    """Return the table of the ranges of expressions; empty without one."""
    rows = (
        (Text(each.expression), down(one.low, 9), up(one.high, 9), str(one.boxes), Text(str(one.note)))
        for each, one in ((each, each.range) for each in bounds)
    )
    title, columns = "ranges on the declared box, outward-rounded", ("expression", "from", "to", "boxes", "")
    return Group(*filled(headed(title, *columns, rows=rows)))


_PLAIN: Any = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
_LINES = {
    False: "with the gains of the model's tuning",
    True: "with starting gains, not yet simulated",
}
_WHERE = {  # keys: whether the gains are proposed, and whether the model is plain text
    (False, False): ", after `from hgogen.model import load`:",
    (False, True): ", by the command:",
    (True, False): ", beside the model's plant, after `import hgogen as hg`:",
    (True, True): ", an entry that goes above the first [table] of the model, or into its object:",
}


def headline(
    observability: Observability, survey: Survey, claims: Checked, least: ObservabilityMeasure | None = None
) -> str:
    """Return the result of a check in one line: observability, forms of the plant, convergence of the observer.

    As "pendulum: locally observable; triangular, uniform, state_affine, proved; convergence unknown".
    """
    parts = [_observed(observability, least), *_forms(survey, claims)]
    if claims.observer:
        parts.append(str(convergence(claims.observer, claims.checks)))
    else:
        parts.append("its observer is refused" if claims.demanded else "no observer")
    for check in claims.checks:
        if check.id == ClaimId(claims.observer, "step"):  # only of an observer with an error system
            parts.append(f"{'' if check.verdict is Verdict.PROVED else 'not '}proved as it runs")
    return f"{claims.plant}: " + "; ".join(parts)


def _observed(observability: Observability, least: ObservabilityMeasure | None) -> str:
    known = observability.known
    locally = ", ".join(filter(None, ("locally observable", observability.system.modulo)))
    if known.rank.unobservable:
        hidden, doubtful = (few((s.name for s in names), 4) for names in (known.hidden, known.doubtful))
        parts = [f"{hidden} not observable"] if hidden else []
        parts += [f"whether {doubtful} can be observed is unknown"] if doubtful else []
        where = f", where {known.condition}" if known.where and not known.everywhere else ""
        return ", ".join(parts) + where + (", which the plant may leave" if known.passing and known.hidden else "")
    if known.elsewhere:
        first, *more = known.exceptions
        return f"{locally}, but {first}" + (", ..." if more else "")
    if least is not None and least.by_motion:
        return f"{locally}, {next(iter(least.direction))} only along a motion"
    if least is not None and least.below_resolution:
        state, share = next(iter(least.direction)), as_share(least.median, 1)
        return f"{locally}, but {state} practically unobservable ({share})"
    return locally


def _forms(survey: Survey, claims: Checked) -> Iterator[str]:
    proved = [row.kind for row in survey.proved]
    recast = claims.form.system.origin is not survey.plant.origin
    known = claims.demanded and not recast and claims.form.kind in (proved or [row.kind for row in survey.candidates])
    if proved:
        yield f"{', '.join(proved)}, proved"
    elif known:
        yield _form(claims.form, claims.accepted)
    else:
        yield _form(survey.best, ()) if survey.candidates else "in none of the requested forms"
    if claims.demanded and not known:
        yield f"its observer's form{', of the recast plant' * recast}: {_form(claims.form, claims.accepted)}"


def _form(form: Form, accepted: Iterable[str]) -> str:
    failed = [check for check in form.checks if check.verdict is Verdict.REFUTED]
    if failed:
        known = "accepted" if all(check.id in accepted for check in failed) else "refuted"
        return f"{form.kind} but for {_names(failed)} ({known})"
    doubtful = [check for check in form.checks if check.verdict is not Verdict.PROVED]
    if doubtful:
        return f"{form.kind} as far as is known: {_names(doubtful)} not proved"
    return f"{form.kind}, proved"


def _names(checks: Iterable[Check]) -> str:
    return few((check.id if check.id.maker == MAKER else check.id.unqualified for check in checks), 4)


def undefined_list(checks: Iterable[Check]) -> RenderableType:
    """Return a line for each equation of the plant that has, or may have, no finite value somewhere in the declared
    ranges."""
    lines = []
    for check in checks:
        pattern = "{id}: {reason}; at {point}" if check.witness else "{id}: {reason}"
        sentence = Sentence.of(pattern, id=check.id, reason=check.reason, point=point(check.witness))
        lines.append(coloured(f"{check.verdict:10}", check.verdict).append(str(sentence), "default"))
    return Group(*lines)


def observability_table(observability: Observability, least: ObservabilityMeasure | None = None) -> RenderableType:
    """Return the table of the observable states and ranged parameters, with the observability measure `least`."""
    title = f"{observability.system.name}: observability, at almost every state, parameter value and input"
    loose = few(s for s in observability.system.parameters if s.bounded)
    whose = ("the states", f"the states and {loose}") if loose else ("the states",)
    table = Table(show_header=False, **_PLAIN)
    for check, answer, what in zip(
        observability.checks, (observability.known, observability.joint), whose, strict=False
    ):
        table.add_row(coloured(check.verdict, check.verdict), Text(_answered(answer, what)) if answer else "")
    if least is not None:
        table.add_row(
            Text("practically unobservable", style="red") if least.below_resolution else Text("measured"),
            Text(str(least)),
        )
    return Group(Text(title, style="bold"), table, *(Text(line) for line in observability.limits), "")


def _answered(answer: Answer, what: str) -> str:
    rank, count = answer.rank, answer.counted
    if not rank.unobservable:
        but = "".join(f"\nbut {exception}" for exception in answer.exceptions)
        return f"{what} are locally observable: {count}{but}"
    lines = [f"of {what}, {', and '.join(map(str, answer.unseen))}: {count}"]
    lines += [f"no output sees {symmetry}" for symmetry in answer.symmetries if symmetry.proved]
    lines += map(str, answer.exceptions)
    return "\n".join([*lines, *([answer.advice] if answer.advice else [])])


def advice_tables(advice: Advice) -> RenderableType:
    """Return the admitted observers, best first, with the line that makes each, and the notes."""
    subtitle = "each without accepted checks, and the status of its convergence in continuous time"
    head = Text(f"{advice.plant}: observers, {subtitle}", style="bold")
    parts: list[RenderableType] = [head]
    if advice.admitted:
        table = Table(*("observer", "form", "convergence", "cost", "use it if"), **_PLAIN)
        for one in advice.admitted:
            count = f"{one.cost.operations} + {one.cost.functions}"
            table.add_row(*map(Text, (one.observer, one.form, one.known, count, one.where.replace("`", ""))))
        parts.append(table)
    for proposed, title in _LINES.items():
        lines = [
            Text(f"  {one.line}", no_wrap=True, overflow="ignore")
            for one in advice.admitted
            if one.proposed is proposed
        ]
        parts += [Text(title + _WHERE[proposed, advice.plain]), *lines] if lines else []
    return Group(*parts, *map(Text, advice.notes), "")


_ESCAPED = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}


def fragment(form: Form, checks: Iterable[Check], accepted: Sequence[str] = ()) -> str:
    """Return the form's coordinates and equations, and a table of the checks, as LaTeX."""
    plant = form.system
    parts = (
        _aligned("{} &= {}", dict(zip(form.states, form.to_form, strict=True))),
        _aligned(
            "{}^+ &= {}" if plant.discrete else r"\dot{{{}}} &= {}", dict(zip(form.states, form.flow, strict=True))
        ),
        _aligned("{} &= {}", dict(zip(plant.outputs, form.output, strict=True))),
        _table(checks, accepted),
    )
    return f"% {_escaped(plant.name)}, {_escaped(form.kind)} form\n" + "\n".join(parts) + "\n"


def _aligned(row: str, equations: Mapping[sp.Symbol, sp.Expr]) -> str:
    rows = (row.format(sp.latex(symbol), sp.latex(expression)) for symbol, expression in equations.items())
    return "\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"


def _table(checks: Iterable[Check], accepted: Sequence[str]) -> str:
    rows = [r"verdict & check & claim and reason \\ \hline"]
    for check in checks:
        at = ", ".join(f"{name} = {float(value):g}" for name, value in check.witness.items())
        verdict = f"{check.verdict}{', accepted' if check.id in accepted else ''}"
        claim = f"{check.claim}: {check.reason}{'; at ' + at if at else ''}"
        rows.append(rf"{_escaped(verdict)} & {_escaped(check.id)} & {_escaped(claim)} \\")
    columns = r"p{0.14\textwidth}p{0.24\textwidth}p{0.52\textwidth}"
    return f"\\begin{{tabular}}{{{columns}}}\n" + "\n".join(rows) + "\n\\end{tabular}"


def _escaped(text: str) -> str:
    """Return the text with LaTeX's special characters escaped;
    non-ASCII characters are left to the input encoding."""
    return re.sub(r"[\\^~<>&%$#_{}]", lambda mark: _ESCAPED[mark[0]], text)
