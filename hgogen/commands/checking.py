"""The command `check`: the claims about one model, or the answers for a library of models.

The report begins with one line: what is observable, which forms the plant is in, and whether the observer converges.
The forms are the rows of the survey, whose table follows. The observer's own form is named if it is not a proved one.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
from hgogen.commands import short_answer as short
from hgogen.commands.advice import Advice, advice
from hgogen.commands.claims import COLOURS, Checked, _text, checked, checks_table, few, theorem_table
from hgogen.commands.command import ModelReport, Tuned, command
from hgogen.commands.output import Bar, filled, headed, json_text, note, print_result, results
from hgogen.errors import HgogenError, nearest
from hgogen.form import Form
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.rigor.bounds import Range
from hgogen.run.gramian import Sight, as_share, sight
from hgogen.sentence import NONE, Reason, Sentence, because, down, point, up
from hgogen.system import System
from hgogen.target import demand as demand_place
from hgogen.theorem import convergence
from hgogen.trial import Trial
from hgogen.which_forms import Survey, of

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
_PRINTED = "-"  # the standard output instead of a file


class OptionalFile(TyperCommand):
    """A command whose --json takes a file if --library is given; otherwise --json is a flag."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare --json its default value."""
        several = any(arg.split("=")[0] == "--library" for arg in args)
        words: list[str] = []
        for arg, following in zip(args, [*args[1:], None], strict=False):
            bare = arg == "--json" and (not several or following is None or following.startswith("-"))
            words.append(f"--json={_PRINTED}" if bare else arg)
        return super().parse_args(ctx, words)


@dataclass(frozen=True)
class ObservedPlant:
    """The observability of a plant, as JSON has it."""

    json_keys = "*observability least_seen=weakest"

    observability: Observability
    weakest: Annotated[Sight | None, "the direction that the outputs show least; null where it is not measured"]


@dataclass(frozen=True)
class NamedRange:
    """The range of an expression as JSON has it."""

    json_keys = "expression *range"

    expression: Annotated[str, "the expression"]
    range: Range


@dataclass(frozen=True)
class CheckReport(ModelReport):
    """The report of a check of a model."""

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
        """Return the equations and the checks as LaTeX."""
        claims = self.claims
        return fragment(claims.form, claims.checks, claims.accepted) + self.singular.latex()


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
    everything: Annotated[bool, typer.Option("--all", help="Print all tables, and not the short answer.")] = False,
    proof: Annotated[str | None, typer.Option(metavar="NAME", help="Print a claim with its evidence.")] = None,
    many: Annotated[
        Path | None, typer.Option("--library", metavar="FILE", help="Answer every model of a JSON file.")
    ] = None,
    limit: Limit = None,
    as_json: JsonFile = None,
) -> None:
    """Print in ten lines what is observable, which observer to take, and what is proved of it and what is not; with
    --all which forms the plant is in and why not in the others, and each claim on the form and observer.

    --form NAME prints the claims of that form alone, --proof NAME one claim with its evidence. With an observer the
    exit status is 1 if a claim is refuted that nobody accepted. With --library FILE, which holds
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
    options |= {"--all": everything, "--proof": proof, "--observer": observer}
    options |= dict(word.split(maxsplit=1) for word in setting.words)
    inapplicable = {"--limit": limit} if many is None else options
    if unused := next((name for name, value in inapplicable.items() if value), None):
        reason = "is for --library" if many is None else "does nothing beside --library, and is for a MODEL"
        raise typer.BadParameter(reason, param_hint=unused)
    if many is not None:
        _library(many, limit or library.LIMIT, as_json)
        return
    loaded = load(str(model)).set(setting)
    if loaded.setting.form and not (latex or as_json or everything):
        print_result(False, {}, _form_table(loaded.plant, loaded.setting.form))
        return
    if latex or as_json or everything:
        report = _checked(loaded, observer, bounds or (), deep, silent=latex or bool(as_json), advised=not latex)
        claims = report.claims
    else:
        claims = _short(loaded, observer, bounds or (), deep, proof)
    if latex:
        print(report.latex(), file=results())
    elif as_json:
        _print_json(report, as_json)
    note(*(sentence for sentence in claims.notes if sentence not in loaded.notes))
    if certificate is not None:
        _certify(claims, certificate)
    if claims.demanded and claims.open:
        raise Refuted(claims.open, claims.form, claims.accepted, plain=loaded.plain)


def _certify(claims: Checked, path: Path) -> None:
    """Write the proofs as a certificate, and note which claims can be verified again."""
    from hgogen.certificates.certificate import asserted, certificate, stated

    content = certificate(claims.form, claims.checks, claims.observer)
    hg.write({path.name: json.dumps(content, indent=1, ensure_ascii=True) + "\n"}, path.parent)
    again = f"hgogen recheck {path} verifies it" if asserted(content) else "nothing in it can be verified"
    note(f"wrote {path}; {again} again")
    for id, reason in stated(content):
        note(f"{path} only states {id}, it cannot be verified again: {reason}")


def _demand_places(certificate: Path | None, json_file: Path | None) -> None:
    for option, file in (("--certificate", certificate), ("--json", json_file)):
        if file is not None and file.is_dir():
            raise typer.BadParameter(f"{file} is a folder; give a file in it", param_hint=option)
        if file is not None:
            demand_place([file.name], file.parent)
    if certificate is not None and certificate == json_file:
        raise typer.BadParameter("one file cannot be the certificate and the JSON", param_hint="--certificate")


def _file(as_json: str | None) -> Path | None:
    return None if as_json in (None, _PRINTED) else Path(str(as_json))


def _print_json(value: Any, as_json: str) -> None:
    file = _file(as_json)
    if file is None:
        print_result(True, value)
        return
    new = "" if file.parent.is_dir() else ", in a new folder"
    hg.write({file.name: json_text(value, indent=1) + "\n"}, file.parent)
    note(f"wrote {file}{new}")


def _checked(
    loaded: Model, observer: str | None, bounds: Iterable[str], deep: bool, silent: bool, advised: bool
) -> CheckReport:
    """Return the report on a model. Unless `silent`, each part is printed as soon as it is
    computed, so that the user has the first parts if a later part takes long or fails."""

    def say(*parts: Any) -> None:
        print_result(False, {}, *(() if silent else parts))

    plant = loaded.plant
    if observer is not None:
        loaded.tuned(observer)
    note(*loaded.notes)  # before any verdict is printed
    ranges = {text: hg.bound(text, plant) for text in bounds}
    gaps = (*undefined_values(plant), *undefined_slopes(plant))
    say(undefined_list(gaps))
    observability = hg.observability(plant)
    least = _least(loaded) if observability.rank == observability.n else None
    try:
        forms = hg.survey(plant, deep=deep)
        claims = checked(loaded, forms, observer)
        first = headline(observability, forms, claims, least)
        say(first, "")
    finally:
        say(ranges_table(ranges), observability_table(observability, least))
    say(survey_table(forms, claims.checks))
    singular = _print_claims(say, claims, observability)
    take = None
    if advised:  # about the file, without the options that are set
        written = loaded.set(AS_WRITTEN)
        take = advice(
            written, observability, forms, checked(written, forms, observer) if loaded.setting else claims, deep=deep
        )
        say(advice_tables(take))
    named = tuple(NamedRange(text, one) for text, one in ranges.items())
    return CheckReport(
        loaded.path, first, ObservedPlant(observability, least), forms, named, claims, gaps, singular, take
    )


def _short(loaded: Model, observer: str | None, bounds: Iterable[str], deep: bool, proof: str | None) -> Checked:
    """Print the short answer, each line as soon as it is known, or the claim `proof` alone; return the claims."""

    def say(*parts: Any) -> None:
        print_result(False, {}, *(() if proof else parts))

    plant = loaded.plant
    if observer is not None:
        loaded.tuned(observer)
    note(*loaded.notes)
    if bounds:
        say(ranges_table({text: hg.bound(text, plant) for text in bounds}))
    observability = hg.observability(plant)
    least = _least(loaded) if observability.rank == observability.n else None
    forms = hg.survey(plant, deep=deep)
    first = f"{plant.name}: {_observed(observability, least)}; {short.in_forms(observability, forms)}"
    say(Text(first, style="bold"))
    if least is not None:
        say(short.line("weakest", short.weakest(least)))
    claims = checked(loaded, forms, observer)
    form, checks, name = claims.form, claims.checks, claims.observer
    if claims.step is not None and loaded.setting:
        say(short.line("observer", " ".join([f"{name} in {form.kind} form", *loaded.setting.words])))
    else:
        advised = advice(loaded, observability, forms, claims, deep=deep, kinds=(name, *short.KINDS))
        one = short.preferred(advised, name)
        say(*short.observer_lines(one, advised, forms))
        if one is not None and (one.proposed or one.observer != name):
            built = one.step.observer
            form, checks, name = built.form, built.checks, built.name
    say(*short.standing(name, checks))
    gaps = (*undefined_values(plant), *undefined_slopes(plant))
    say(short.line("fix first", short.to_fix(gaps, observability, least, claims, convergence(name, checks))))
    say(short.details())
    if proof:
        print_result(False, {}, _proof(form, checks, name, proof))
    return replace(claims, notes=claims.notes if claims.demanded else ())  # what is taken without an observer was said


def _form_table(plant: System, name: str) -> RenderableType:
    """Return the claims of a form, each with its verdict; why the plant has no such form."""
    row = of(name, plant)
    if row.form is None:
        return Text(f"{plant.name} in {name} form: {row.why}")
    return checks_table(row.form.head, row.form.checks, ())


def _proof(form: Form, checks: Iterable[Check], observer: str, name: str) -> RenderableType:
    """Return a claim with its reason, its advice and the evidence that a certificate has of it. Raises: `BadParameter`
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


def _print_claims(say: Callable[..., None], claims: Checked, observability: Observability) -> Singularity:
    if claims.informative:
        say(checks_table(claims.head, claims.checks, claims.accepted))
    singular = hg.singularity(observability.system)
    if observability.rank == observability.n:
        say(checks_table(singular.head, singular.checks, ()))
    say(theorem_table(claims.theorem, claims.hypotheses))
    return singular


def _least(model: Model) -> Sight | None:
    if model.plant.discrete:
        return None
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
        print_result(False, answers, table)
    else:
        _print_json(answers, out)
    bad = sum("error" in answer for answer in answers.values())
    if bad:
        note(f"{bad} of {len(answers)} models {'has an error' if bad == 1 else 'have errors'}")


_CUT = 200  # characters of a part of the evidence that are printed
_REPEATABLE = 20  # characters of a reason that may be repeated


def survey_table(forms: Survey, below: Iterable[Check] = ()) -> RenderableType:
    """Return the table of forms: in which forms the plant is, in which order of states, or why not. A fix that the
    checks `below` already advise is left out."""
    table = headed(f"{forms.plant.name}: which form, on the declared ranges", *("", "form", "order", "why"))
    before = NONE
    for row in forms.answered:
        verdict = Text(str(row.verdict), style=COLOURS.get(row.verdict, "cyan") if row.verdict else "")
        why = because("as above") if row.why == before and len(str(row.why)) > _REPEATABLE else row.why
        table.add_row(verdict, Text(row.name), Text(few(row.order)), _text(why))
        before = row.why
    reasons: dict[Reason, list[str]] = {}
    for row in forms.rows:
        if row.verdict is None:
            reasons.setdefault(row.why, []).append(row.name)
    silent = [Text(f"{', '.join(names)}: {why}", style="dim") for why, names in reasons.items()]
    advised = {check.advice for check in below}
    settled = any(row.verdict is Verdict.PROVED for row in forms.answered)
    fixes = {row.fix: f"{row.name}: {row.fix}" for row in forms.answered if row.fix and row.fix not in advised}
    return Group(table, *silent, *map(Text, () if settled else fixes.values()), "")


def ranges_table(bounds: Mapping[str, Range]) -> RenderableType:
    """Return the table of the ranges of expressions; empty without one."""
    rows = (
        (Text(text), down(one.low, 9), up(one.high, 9), str(one.boxes), Text(str(one.note)))
        for text, one in bounds.items()
    )
    title, columns = "ranges on the declared box, outward-rounded", ("expression", "from", "to", "boxes", "")
    return Group(*filled(headed(title, *columns, rows=rows)))


_PLAIN: Any = {"box": None, "pad_edge": False, "padding": (0, 2, 0, 0)}
_LINES = {False: "with the gains of the model's tuning", True: "with first gains, read off the ranges, untried"}
_WHERE = {  # keys: whether the gains are proposed, and whether the model is plain text
    (False, False): ", after `from hgogen.model import load`:",
    (False, True): ", by the command:",
    (True, False): ", beside the model's plant, after `import hgogen as hg`:",
    (True, True): ", an entry that goes above the first [table] of the model, or into its object:",
}


def headline(observability: Observability, survey: Survey, claims: Checked, least: Sight | None = None) -> str:
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


def _observed(observability: Observability, least: Sight | None) -> str:
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
        return f"{locally}, {next(iter(least.direction))} by its motion alone"
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
        yield _form(survey.best, ()) if survey.candidates else "in none of the forms asked"
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
    """Return a line for each equation of the plant that has no finite value, or may have none, in the declared
    ranges."""
    lines = []
    for check in checks:
        pattern = "{id}: {reason}; at {point}" if check.witness else "{id}: {reason}"
        sentence = Sentence.of(pattern, id=check.id, reason=check.reason, point=point(check.witness))
        lines.append(
            Text(f"{check.verdict:10}", style=COLOURS.get(check.verdict, "cyan")).append(str(sentence), "default")
        )
    return Group(*lines)


def observability_table(observability: Observability, least: Sight | None = None) -> RenderableType:
    """Return the table of the observable states and ranged parameters, with the observability measure `least`."""
    title = f"{observability.system.name}: observability, at almost every state, parameter value and input"
    loose = few(s for s in observability.system.parameters if s.bounded)
    whose = ("the states", f"the states and {loose}") if loose else ("the states",)
    table = Table(show_header=False, **_PLAIN)
    for check, answer, what in zip(
        observability.checks, (observability.known, observability.joint), whose, strict=False
    ):
        verdict = Text(str(check.verdict), style=COLOURS.get(check.verdict, "cyan"))
        table.add_row(verdict, Text(_answered(answer, what)) if answer else "")
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
    subtitle = "each built without accepting anything, with what is known of its convergence in continuous time"
    head = Text(f"{advice.plant}: what to take, {subtitle}", style="bold")
    parts: list[RenderableType] = [head]
    if advice.admitted:
        table = Table(*("observer", "form", "convergence", "cost", "take it where"), **_PLAIN)
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
