"""The claims about a model, as commands print them: about its step's observer, or about a form alone, with the error
bounds under the noise and disturbances that the model declares.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Annotated, Any

import sympy as sp
from rich.console import Group, RenderableType
from rich.text import Text
from sympy.printing.str import StrPrinter

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.certificates.contraction import Admitted, admitted
from hgogen.certificates.error_bound import ErrorBound
from hgogen.check import Check, Refuted, Verdict, refuted
from hgogen.commands.output import headed
from hgogen.estimators.noise import deviation_lines
from hgogen.form import Form
from hgogen.model import MissingPart, Model
from hgogen.program import Field
from hgogen.prove.inclusion import Nothing
from hgogen.prove.questions import Signed
from hgogen.prove.semidefinite import NoSolver
from hgogen.reading.given import BadGain, BadNames, field_text, gains_by_name
from hgogen.sentence import Encoded, Sentence, equations, plain, point
from hgogen.signal import Signal
from hgogen.theorem import Row, Theorem, rows
from hgogen.which_forms import Survey


@dataclass(frozen=True)
class ListedCheck:
    """A check in a list, as printed in JSON."""

    json_keys = "*check accepted"

    check: Check
    accepted: Annotated[bool, "whether the model accepts it where it is refuted"]


@dataclass(frozen=True)
class AppliedTheorem:
    """A theorem about a step, as printed in JSON."""

    json_keys = "conclusion=theorem.conclusion reference=theorem.reference hypotheses"

    theorem: Theorem
    hypotheses: Annotated[tuple[Row, ...], "what the theorem assumes, and what is known of it"]


@dataclass(frozen=True)
class Checked(Encoded):
    """The claims about a model: about its step's observer, or about a form if there is no step or the observer does not
    accept the form.

    `observer`: its name, or ""; `demanded`: whether the model has an observer, so that a refuted check is an error;
    `step`: the step of the tuning `tuning`, "" for the model's own; `known`: the error bounds under the declared noise
    and disturbances, None if the model declares none.
    """

    json_keys = (
        "plant form=form.kind coordinates flow outputs gains=gain_values dt checks=listed refuted theorem=applied notes"
    )

    plant: Annotated[str, "name of the plant"]
    form: Form
    checks: tuple[Check, ...]
    accepted: tuple[str, ...]
    observer: str = ""
    theorem: Theorem | None = None
    notes: Annotated[tuple[str, ...], "what is not claimed, and why"] = ()
    demanded: bool = True
    step: CallableStep | None = None
    tuning: str = ""
    known: ErrorBound | None = None
    dt: Annotated[Admitted | None, "limits of dt; null for an observer whose step cannot be certified"] = None

    @property
    def gains(self) -> tuple[Field, ...]:
        """The observer's gains."""
        return self.step.layout.gains if self.step else ()

    @property
    def informative(self) -> bool:
        """Whether the checks say more than why the plant is not in the form."""
        return self.demanded or self.form.structured

    @property
    def head(self) -> tuple[Sentence, ...]:
        """The lines of the form's coordinates and equations, the observer's gains with the noise of a sample, and the
        limits of dt."""
        title, *lines = self.form.head
        origin = self.form.system.origin
        if origin is not None:  # the plant was recast: its states replace the declared ones
            pairs = zip(self.form.system.states, origin.forward, strict=True)
            change = equations({new: old for new, old in pairs if new.name != str(old)})
            lines = [Sentence.of("  with {change}", change=change), *lines]
        gains = (Sentence.of("  {gain}", gain=field_text(gain)) for gain in self.gains)
        noise = (Sentence.of("  {line}", line=line) for line in (deviation_lines(self.step) if self.step else ()))
        limits = (Sentence.of("  {limits}", limits=dt.sentence) for dt in (self.dt,) if dt)
        return (title, *lines, *gains, *noise, *limits)

    @property
    def hypotheses(self) -> tuple[Row, ...]:
        """The hypotheses of the observer's theorem, with their verdicts."""
        return rows(self.theorem, self.checks) if self.theorem else ()

    @property
    def open(self) -> tuple[Check, ...]:
        """The refuted checks that the user has not accepted."""
        return refuted(self.checks, self.accepted)

    @property
    def coordinates(self) -> dict[str, str]:
        """The form's coordinates z by the plant's states."""
        return _texts(self.form.states, self.form.to_form)

    @property
    def flow(self) -> dict[str, str]:
        """The rates z' in the form's coordinates."""
        return _texts(self.form.states, self.form.flow)

    @property
    def outputs(self) -> dict[str, str]:
        """The outputs y in the form's coordinates."""
        return _texts(self.form.system.outputs, self.form.output)

    @property
    def gain_values(self) -> dict[str, Any]:
        """The observer's gains; gains of several coordinates or outputs by their names."""
        return gains_by_name(self.gains)

    @property
    def listed(self) -> tuple[ListedCheck, ...]:
        """The claims, each with its verdict."""
        return tuple(ListedCheck(check, check.id in self.accepted) for check in self.checks)

    @property
    def refuted(self) -> tuple[str, ...]:
        """The ids of refuted checks that the user has not accepted; with an observer, the exit status is 1 if there are
        any."""
        return tuple(check.id for check in self.open)

    @property
    def applied(self) -> AppliedTheorem | None:
        """The theorem behind the observer; null without an observer."""
        return AppliedTheorem(self.theorem, self.hypotheses) if self.theorem else None


def _texts(signals: Iterable[Signal], expressions: Iterable[Any]) -> dict[str, str]:
    return {s.name: str(expression) for s, expression in zip(signals, expressions, strict=True)}


def checked(model: Model, survey: Survey | None = None, name: str | None = None) -> Checked:
    """Return the claims about the observer of the tuning `name`, by default of the model's own step. For a model
    without an observer, return those about the best form in `survey`, by default among the forms that are fast to
    check. If the model declares a dissipation inequality (38), that claim is added.

    Raises: `MissingPart`, `ModelFails`.
    """
    claims, declared = _checked(model, survey, name), model.dissipation
    if declared is None:
        return claims
    note = f"of the errors e of {declared.system.name}: {declared.conclusion}"
    return replace(claims, checks=(*claims.checks, *declared.checks), notes=(*claims.notes, note))


def _checked(model: Model, survey: Survey | None, name: str | None) -> Checked:
    if name is None and not model.has("step"):
        survey = survey or hg.survey(model.plant)
        form = getattr(hg.forms, model.setting.form)(model.plant) if model.setting.form else survey.best
        notes = (*model.notes, _note_without_observer(model, survey, form))
        return Checked(model.plant.name, form, form.checks, (), notes=notes, demanded=False)
    try:
        step = model.step(name)
    except Refuted as error:
        if error.form is None:
            raise
        note = f"the observer of {model.path} is refused on this form, so its own claims are not in the list"
        known = tuple(check.id for check in error.form.checks if check.id in error.accepted)
        return Checked(model.plant.name, error.form, error.form.checks, known, notes=(*model.notes, note))
    observer = step.observer
    plain = Checked(model.plant.name, observer.form, observer.checks, observer.accepted, observer.name)
    claims = replace(plain, theorem=observer.theorem, notes=model.notes, step=step, tuning=name or "")
    try:
        return _add_step_proofs(claims, step, model)
    except NoSolver as missing:
        return replace(claims, notes=(*claims.notes, str(missing)))


def _add_step_proofs(claims: Checked, step: CallableStep, model: Model) -> Checked:
    error, gains = bound_of(step, model), _gains(step.observer, model)
    if step.observer.error is None:
        step_checks = (error.check, *gains) if error else ()
        return replace(claims, checks=(*claims.checks, *step_checks), known=error)
    known, noise, start = hg.contraction(step), hg.noise_gain(step), hg.start_set(step)
    bounds = (bound.check for bound in (noise, start, error) if bound and not isinstance(bound, Nothing))
    step_checks = (*known.checks, *bounds, *gains)
    return replace(claims, checks=(*claims.checks, *step_checks), known=error, dt=admitted(step, known))


def _gains(observer: hg.Observer, model: Model) -> tuple[Check, ...]:
    if model.bounds is None or not model.bounds.gains:
        return ()
    sizes = {
        input_kind: each for input_kind, each in model.bounds.sizes.items() if input_kind in ("noise", "disturbance")
    }
    return hg.l2_gain(observer, **sizes).check, hg.iss_gain(observer, **sizes).check


def _note_without_observer(model: Model, survey: Survey, form: Form) -> str:
    proved = ", ".join(row.kind for row in survey.proved)
    if form.structured or model.setting.form:
        return f"{model.path} has no observer: the checks are those of the {form.kind} form alone"
    if proved:
        return f"{model.path} has no observer; of the requested forms its plant is in {proved}, proved, and in no other"
    return f"{model.path} has no observer, and its plant has the structure of none of the requested forms"


_COLOURS = {Verdict.PROVED: "green", Verdict.REFUTED: "red", Verdict.UNKNOWN: "yellow"}


def coloured(text: object, verdict: Verdict | None, without: str = "") -> Text:
    """Return a text in the colour of a verdict; `without`: the colour where there is no verdict."""
    return Text(str(text), style=_COLOURS.get(verdict, "cyan") if verdict else without)


_ALIKE = 4  # equal rows from which on they become one

_FEW = 6  # digits of a number in a printed equation
_ZEROS, _DIGITS = 20, 15  # trailing zeros from which on, and digits up to which, an integer has a power of ten


def checks_table(head: Iterable[Sentence], listed: Iterable[Check], accepted: Sequence[str]) -> RenderableType:
    """Return a table of claims with their verdicts, with the lines `head` (equations, gains) above and the advice on
    refuted claims below; `accepted`: the ids of claims that the user accepted."""
    listed = tuple(listed)
    title, *lines = head
    table = headed("", "verdict", "check", "claim and reason")
    for called, check in _gathered(listed, accepted):
        pattern = "{claim}\n{reason}; at {point}" if check.witness else "{claim}\n{reason}"
        sentence = Sentence.of(pattern, claim=check.claim, reason=check.reason, point=point(check.witness))
        verdict = coloured(check.verdict, check.verdict)
        if check.id in accepted:
            verdict.append("\naccepted", style="yellow")
        table.add_row(verdict, Text(called), _text(sentence))
    fixes = [Text(f"{c.id}: {c.advice}") for c in listed if c.fix and c.verdict is Verdict.REFUTED]
    return Group(Text(str(title), style="bold"), *map(_text, lines), table, *fixes, "")


class _Tens(StrPrinter):  # type: ignore[misc]
    """A printer of expressions that writes an integer with many trailing zeros by a power of ten."""

    def _print_Integer(self, number: sp.Integer) -> str:
        return _whole(number.p)

    def _print_Rational(self, number: sp.Rational) -> str:
        return f"{_whole(number.p)}/{_whole(number.q)}"


def _value_text(value: Any) -> str:
    if isinstance(value, sp.Basic):
        numbers = value.atoms(sp.Rational)
        rounded = {number: sp.Float(number, _FEW) for number in numbers if any(map(_is_long, (number.p, number.q)))}
        return str(_Tens({"order": None}).doprint(value.xreplace(rounded)))
    return _whole(value) if isinstance(value, int) else plain(value)


def _is_long(number: int) -> bool:
    return len(str(abs(number)).rstrip("0")) > _FEW


def _whole(number: int) -> str:
    digits = str(number).rstrip("0")
    zeros = len(str(number)) - len(digits)
    return f"{digits}e{zeros}" if zeros >= _ZEROS and len(digits.lstrip("-")) <= _DIGITS else str(number)


def _text(sentence: Sentence) -> Text:
    return Text(sentence.written(_value_text))


def _gathered(listed: Iterable[Check], accepted: Sequence[str]) -> Iterable[tuple[str, Check]]:
    """Yield pairs (row title, check) for a table. Checks of equal verdict and reason about
    a_1, a_2, .. become one row; `accepted`: ids of checks that the user accepted."""

    def kind(check: Check) -> tuple[Any, ...]:
        alone = check.id in accepted or check.subject is None
        return (check.id,) if alone else (check.id.maker, check.id.fact, check.verdict, check.reason, check.subject)

    for _, group in groupby(listed, key=kind):
        first, *others = group
        if 1 + len(others) < _ALIKE:
            yield from ((check.id, check) for check in (first, *others))
        else:
            last = others[-1].id.unqualified
            alike = Sentence.of("{claim}, and so for each up to {last}", claim=first.claim, last=last)
            yield f"{first.id}..{last}", replace(first, claim=alike)


def few(names: Iterable[Any], most: int = 8) -> str:
    """Return names as text, separated by commas; of more than `most` names the middle ones are left out, as "a, b, c,
    .., z"."""
    names = [str(name) for name in names]
    return ", ".join(names if len(names) <= most else (*names[:3], "..", names[-1]))


def theorem_table(theorem: Theorem | None, hypotheses: Iterable[Row]) -> RenderableType:
    """Return the table of the theorem's conclusion and the verdict on each hypothesis; empty without a theorem."""
    if theorem is None:
        return Group()
    head = f"Theorem: {theorem.conclusion}\n({theorem.reference}), if"
    table = headed("", "", "hypothesis", "known by")
    for row in hypotheses:
        standing = coloured(row.standing, row.verdict, without="magenta")
        known = "; ".join(part for part in (", ".join(row.checks), str(row.reason)) if part)
        where = f" [{row.reference}]" if row.reference else ""
        table.add_row(standing, Text(row.claim + where), Text(known))
    return Group(Text(head), table, "")


def bound_of(step: CallableStep, model: Model) -> ErrorBound | None:
    """Return the proved bounds of each state's error under the declared noise and disturbances; None if the model
    declares none.

    Raises: `NoSolver`; `MissingPart` for an invalid size or signal.
    """
    if model.bounds is None:
        return None
    try:
        return hg.error_bound(step, **model.bounds.sizes)
    except (BadNames, BadGain) as error:
        raise MissingPart(model.path, f"in bounds, {error}") from None


def proved_bound(step: CallableStep, model: Model, say: Callable[[str], None]) -> ErrorBound | None:
    """Return the proved bounds of each state's error under the declared noise and disturbances, None without a solver
    or a proof. `say` is called with the reason if requested bounds are missing."""
    try:
        known = bound_of(step, model)
    except NoSolver as missing:
        say(str(missing))
        return None
    if known and known.missing:
        say(f"{model.path}: {known.missing}")
    return known


def stating(step: CallableStep, model: Model, known: ErrorBound | None) -> CallableStep:
    """Return the step whose generated code states the proved error bounds `known`, or that none is proved; unchanged if
    the model requests no bounds."""
    if model.bounds is None:
        return step
    return replace(step, signed=known.signed if known else Signed())
