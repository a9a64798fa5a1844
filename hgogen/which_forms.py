"""The survey of observability forms: which ones a plant is in, on its declared box, in which order of states, and why
not.

Every form of the folder `forms` is tried, each in its variants, and the test of Gauthier and Bornard, which is about
every real input regardless of the box. The verdict on the whole plant is the worst verdict of the checks.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import sympy as sp

from hgogen import forms
from hgogen.analysis.singularity import of_plant
from hgogen.analysis.undefined import MAKER
from hgogen.check import Verdict, worst
from hgogen.errors import HgogenError
from hgogen.form import Form, SurveySettings
from hgogen.reading.given import requires_any_plant, requires_switches
from hgogen.sentence import Encoded, Reason, because, encoded, point
from hgogen.system import System

NOT_TRIED = because("not tried, since it may take seconds; --deep tries it, in Python survey(plant, deep=True)")
_CONTINUOUS = because("for differential equations, and the plant is discrete")


def survey_settings(name: str) -> SurveySettings:
    """Return the settings by which a survey tries the form `name`, by default `Asking()`."""
    return getattr(getattr(forms, name, None), "survey_settings", SurveySettings())


@dataclass(frozen=True)
class Row(Encoded):
    """The verdict on a plant in one form: its name `kind`, the arguments `options`, and the resulting `form`.

    `verdict`: the worst verdict of the checks; None where the form does not apply to the plant, or was not tried; `why`
    says which.
    """

    json_keys = "name verdict why why_data=why.as_dict fix order witness"

    kind: str
    verdict: Annotated[Verdict | None, "the worst of the checks'; null: not asked, or refuses the plant"]
    order: Annotated[tuple[str, ...], "the plant's states in the form's order, with signs; none in other coordinates"]
    why: Annotated[Reason, "the reason of the first of the worst checks"]
    witness: Annotated[Mapping[str, float], "the point that refutes it"] = field(default_factory=dict, hash=False)
    fix: Annotated[str, "what may help"] = ""
    form: Form | None = field(default=None, repr=False)
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def name(self) -> str:
        """The name of the form with its options, such as "triangular, measured=True"."""
        return ", ".join([self.kind, *(f"{key}={value!r}" for key, value in self.options.items())])


@dataclass(frozen=True)
class Survey:
    """The verdicts on a plant in each form."""

    plant: System
    rows: Annotated[tuple[Row, ...], "each form in each variant, and the test of Gauthier and Bornard"]

    def __getitem__(self, name: str) -> Row:
        """Return the verdict on the form `name`, such as "triangular" or "triangular, measured=True"."""
        return {row.name: row for row in self.rows}[name]

    @property
    def answered(self) -> tuple[Row, ...]:
        """The forms with a verdict: those that were tried and that apply to the plant."""
        return tuple(row for row in self.rows if row.verdict is not None)

    @property
    def proved(self) -> tuple[Row, ...]:
        """The forms in which the plant is proved to be, each in its first such variant, except `original`, in which any
        plant is."""
        rows = [row for row in self.rows if row.form and row.verdict is Verdict.PROVED and row.kind != "original"]
        return tuple({row.kind: row for row in reversed(rows)}.values())[::-1]

    @property
    def candidates(self) -> tuple[Row, ...]:
        """The forms with a claim of observability and a structure that the plant has, proved ones first."""
        rows = [row for row in self.answered if survey_settings(row.kind).candidate]
        shaped = [row for row in rows if row.form and row.form.structured]
        return tuple(sorted(shaped, key=lambda row: row.verdict is not Verdict.PROVED))

    @property
    def silent(self) -> tuple[Row, ...]:
        """The forms that make no claim of observability, and whose structure the plant has."""
        rows = [row for row in self.answered if not survey_settings(row.kind).candidate]
        return tuple(row for row in rows if row.form and row.form.structured)

    @property
    def best(self) -> Form:
        """The plant in the first proved form, else the first whose structure it has, else any, else `original`."""
        answering = [row for row in self.answered if survey_settings(row.kind).candidate]
        rows = (*self.candidates, *answering)
        return next((row.form for row in rows if row.form), None) or forms.original(self.plant)

    def as_dict(self) -> list[dict[str, Any]]:
        """Return the verdict on each form as plain data for JSON."""
        rows: list[dict[str, Any]] = encoded(self.rows)
        return rows

    def __str__(self) -> str:
        lines = [f"{row.verdict or '-':8} {row.name}: {row.why}" for row in self.rows]
        return "\n".join([f"{self.plant.name}: which form, on the declared box", *(f"  {line}" for line in lines)])


@requires_any_plant
@requires_switches
def survey(plant: System, *, deep: bool = False) -> Survey:
    """Return the verdict on every form for the plant on its declared box; forms that take seconds only if `deep`."""
    names = sorted(forms.__all__, key=lambda name: survey_settings(name).place)
    rows = []
    for name in names:
        case = survey_settings(name)
        refusal = case.refusal(len(plant.outputs))
        if plant.discrete and not case.discrete:
            rows.append(Row(name, None, (), _CONTINUOUS))
        elif refusal:
            rows.append(Row(name, None, (), because("{refusal}", refusal=refusal)))
        elif case.costly and not deep and not plant.discrete:
            rows.append(Row(name, None, (), NOT_TRIED))
        else:
            rows += [_row(name, options, plant) for options in case.options]
    return Survey(plant, (*rows, _gauthier_bornard(plant)))


def of(name: str, plant: System) -> Row:
    """Return the verdict on the plant in the form `name`, a function of `hg.forms`, with its default options."""
    return _row(name, {}, plant)


def _row(name: str, options: Mapping[str, Any], plant: System) -> Row:
    try:
        form: Form = getattr(forms, name)(plant, **options)
    except HgogenError as refusal:  # the form does not apply to the plant
        return Row(name, None, (), because("{refusal}", refusal=str(refusal)), options=options)
    weakest = worst(form.checks)
    permuted = all(any(z in (x, -x) for x in form.system.states) for z in form.to_form)
    order = tuple(map(sp.sstr, form.to_form)) if form.structured and permuted else ()
    if weakest.verdict is Verdict.PROVED:
        proved = because("all {count} checks proved", count=len(form.checks))
        return Row(name, weakest.verdict, order, proved, {}, "", form, options)
    reason = weakest.reason
    if weakest.witness:
        reason = because("{reason}, at {point}", reason=reason, point=point(weakest.witness))
    of_subject = weakest.verdict is Verdict.REFUTED and weakest.subject is not None
    if not (of_subject or weakest.id.fact == "structure" or weakest.id.maker == MAKER):  # else it names it
        reason = because("{check}: {reason}", check=weakest.id.unqualified, reason=reason)
    return Row(name, weakest.verdict, order, reason, weakest.witness, weakest.advice, form, options)


def _gauthier_bornard(plant: System) -> Row:
    if plant.discrete:
        return Row("Gauthier-Bornard", None, (), _CONTINUOUS)
    answer = of_plant(plant)
    if not answer.applies:
        return Row("Gauthier-Bornard", None, (), because("does not apply: {reason}", reason=answer.reason))
    patterns = {
        Verdict.GENERIC: "for every real input, ranges apart, uniformly observable: {reason}",
        Verdict.REFUTED: "for every real input, ranges apart, some input hides a state: {reason}",
    }
    pattern = patterns.get(answer.verdict, "for every real input, ranges apart, {reason}")
    return Row("Gauthier-Bornard", answer.verdict, (), because(pattern, reason=answer.reason))
