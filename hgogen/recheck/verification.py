"""Verification of a certificate by code and arithmetic that share nothing with those that wrote it.

Exact identities are proved by rational functions over fractions, ranges by mpmath's intervals on the certificate's
bisections. A claim holds for the model in the same file, whose digest is `Rechecked.model`; the file's own digest
detects accidents and is no signature. The reason of an open claim is the file's and is not verified.

A part of the model without a verified claim is reported as unexamined. For a form on which no claim depends the
identities

    dZ/dx f + dZ/du u' = A(Z) Z + b(Z),   output(Z) = h,   X(Z) = x,   Z = to_form(x, u), X = from_form

are proved exactly in x, wherever both sides have a value, or disproved at points of the plant's box.
"""

import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

from .arithmetic import Arithmetic, Undefined, Unproved, along, evaluate, total
from .box import points
from .context import REFUSALS, Context, algebra_of, inside, printed, reason_of
from .file import LARGEST, Certificate, Claim, NoCertificate, part, quoted
from .file import read as read_file
from .interval import intervals
from .rules import FORMS, OBSERVERS, assumed_claims, required, rule_of
from .rules.forms import box_of_rates
from .text import RecheckError, Unreadable

STATED = "stated"  # proved or refuted, without evidence for this checker
OPEN = ("where", "generic", "unknown", STATED)  # verdicts that assert nothing to verify


@dataclass(eq=False)
class CannotRead(RecheckError):
    """The error that a certificate file cannot be read."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


@dataclass(eq=False)
class NotVerified(RecheckError):
    """The error that a claim of a certificate was not verified."""

    status: ClassVar[int] = 1
    failed: tuple["Row", ...]

    def __str__(self) -> str:
        failures = "; ".join(f"{row.id}: {row.sentence}" for row in self.failed)
        return f"not verified: {failures}. Do not rely on this file; write it again with hgogen check --certificate"


@dataclass(eq=False)
class NothingVerified(RecheckError):
    """The error that a certificate has no verified claim, since none is stated as proved or refuted."""

    status: ClassVar[int] = 1
    plant: str

    def __str__(self) -> str:
        return f"nothing of {self.plant} is verified: of no claim does this file say that it is proved or refuted"


@dataclass(frozen=True)
class Row:
    """The outcome of one claim, or a fault of the file or of its form, which has no verdict.

    `found`: "verified" or "fails" or, for a claim that asserts nothing, "open" or "stated"; `sentence`: the reason;
    `boxes`: the number of boxes of the proof.
    """

    id: Annotated[str, "name of the claim"]
    verdict: Annotated[str, "the verdict in the file"]
    found: Annotated[str, "verified, fails, or, where nothing is asserted, open or stated"]
    sentence: Annotated[str, "how it was found"]
    boxes: Annotated[int, "number of intervals it took"] = 0


_COUNTED = {"verified": "verified", "open": "open", STATED: STATED, "fails": "failed"}


@dataclass(frozen=True)
class Rechecked:
    """The outcome of the verification of a certificate, claim by claim."""

    plant: Annotated[str, "name of the plant"]
    form: Annotated[str, "name of the form"]
    observer: str
    model: Annotated[str, "SHA-256 of plant, form and observer"]
    rows: Annotated[tuple[Row, ...], "the outcome of each claim"]
    unexamined: Annotated[tuple[str, ...], "what no verified claim is about"] = ()
    points: Annotated[Mapping[str, str], "the names that have one value, which all of it assumes"] = field(
        default_factory=dict, hash=False
    )

    @property
    def failed(self) -> tuple[Row, ...]:
        """The claims that were not verified."""
        return self._rows_with("fails")

    @property
    def verified(self) -> tuple[Row, ...]:
        """The claims that were verified."""
        return self._rows_with("verified")

    def _rows_with(self, what: str) -> tuple[Row, ...]:
        return tuple(row for row in self.rows if row.found == what)

    @property
    def counts(self) -> dict[str, int]:
        """The numbers of claims by outcome: verified, open, stated, failed."""
        return {name: len(self._rows_with(what)) for what, name in _COUNTED.items()}

    @property
    def count(self) -> str:
        """The numbers of claims by outcome, as text."""
        return ", ".join(f"{count} {name}" for name, count in self.counts.items())

    @property
    def remarks(self) -> list[str]:
        """Sentences on the fixed values that all claims assume, and on the unexamined parts."""
        points = ", ".join(f"{name} = {value}" for name, value in self.points.items())
        fixed = [f"with one value: {points}"] if points else []
        return [*fixed, *(f"not examined: {subject}" for subject in self.unexamined)]

    def demand(self) -> None:
        """Raise `NotVerified` if a claim fails, `NothingVerified` if none is verified."""
        if self.failed:
            raise NotVerified(self.failed)
        if not self.verified:
            raise NothingVerified(self.plant)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON content."""
        rows = [asdict(row) for row in self.rows]
        about = {"plant": self.plant, "form": self.form, "observer": self.observer or None, "model": self.model}
        outcome = {"verified": bool(self.verified and not self.failed), "counts": self.counts, "claims": rows}
        return {**about, **outcome, "unexamined": list(self.unexamined), "points": dict(self.points)}


def read(text: str) -> Certificate:
    """Return the certificate in a text. Raises: `NoCertificate` for a text that is no JSON or lacks a part;
    `Unreadable` for an expression or number."""
    return read_file(text, OBSERVERS)


@lru_cache(maxsize=4)  # the maker of a certificate verifies it, and often reads it first
def recheck(text: str) -> Rechecked:
    """Return the outcome of the verification of each claim of the certificate in a text.

    A claim that is not confirmed is a row "fails". A file changed after it was written fails by the row "digest"; the
    other rows then describe the model that it now contains. Raises: `NoCertificate` and `Unreadable` for a text that is
    no certificate.
    """
    certificate = read(text)
    context = Context(certificate)
    observer = certificate.observer.name if certificate.observer else ""
    changed = (
        (certificate.untouched, "digest", "the file is not as it was written"),
        (certificate.named, "model", "the file names another model than it holds"),
    )
    outcomes = (
        *(Row(name, "", "fails", fault) for same, name, fault in changed if not same),
        *rows(context),
        *(Row("form", "", "fails", fault) for fault in faults(context)),
    )
    verified = [row.id for row in outcomes if row.found == "verified"]
    points = {name: printed(Fraction(low)) for name, (low, high) in certificate.plant.box.items() if low == high}
    return Rechecked(
        _plain(certificate.name),
        _plain(certificate.form.kind),
        observer,
        certificate.model,
        outcomes,
        tuple(unexamined(context, verified)),
        points,
    )


def _plain(text: str) -> str:
    return text if re.fullmatch(r"[\w ,.()-]{1,80}", text, re.ASCII) else quoted(text)


def load(path: str | Path) -> str:
    """Return the text of a certificate file. Raises: `CannotRead`."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise CannotRead(str(path), "is no regular file")
        with open(path, encoding="utf-8") as stream:
            return stream.read(LARGEST + 1)
    except OSError as error:
        raise CannotRead(str(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise CannotRead(str(path), "is no text in UTF-8") from None
    except ValueError:  # a null byte
        raise CannotRead(str(path), "is no path") from None


def rows(context: Context) -> Iterator[Row]:
    """Yield the outcome of each claim, and of each required claim that is missing."""
    certificate = context.file
    by_id: dict[str, Row] = {}
    for claim in certificate.claims:
        if claim.id in by_id:
            by_id[claim.id] = Row(claim.id, _plain(claim.verdict), "fails", "it stands twice")
        else:
            by_id[claim.id] = _row(context, claim)
    known = dict(by_id)
    while loose := [row for row in known.values() if row.found == "verified" and _missing(certificate, row, known)]:
        for row, (first, *_) in [(row, _missing(certificate, row, known)) for row in loose]:
            sentence = f"it rests on {first}, which is not verified"
            known[row.id] = replace(row, found="fails", sentence=sentence, boxes=0)
    yield from known.values()
    for id in required(certificate):
        if id not in by_id:
            yield Row(id, "", "fails", "the claim is missing")


def _missing(certificate: Certificate, row: Row, known: Mapping[str, Row]) -> list[str]:
    claim = certificate.claim(row.id)
    needed = assumed_claims(certificate, claim) if claim else ()
    return [id for id in needed if id not in known or known[id].found != "verified"]


def _row(context: Context, claim: Claim) -> Row:
    kind, verdict = context.form.kind, _plain(claim.verdict)
    try:
        if claim.verdict in OPEN:
            _read_only(claim, ("reason",))
            outcome = STATED if claim.verdict == STATED else "open"
            reason = quoted(part(claim.evidence, "reason", str))
            return Row(claim.id, verdict, outcome, f"not verified; in the file's words: {reason}")
        rule = rule_of(kind, claim)
        if rule is None:
            raise Unproved(f"no rule verifies that it is {verdict}")
        _read_only(claim, rule.keys)
        finding = rule.find(context, claim)
    except REFUSALS as error:
        return Row(claim.id, verdict, "fails", reason_of(error))
    about = rule.named(rule.about, kind, claim)
    return Row(claim.id, verdict, "verified", f"{about}: {finding.sentence}{_narrow(context)}", finding.boxes)


def _narrow(context: Context) -> str:
    plant = context.plant
    every = {**plant.box, **{name: context.form.box[name] for name in context.z}}
    signals = (*plant.states, *context.file.inputs, *context.z)
    named = [f"{name} = {printed(Fraction(every[name][0]))}" for name in signals if every[name][0] == every[name][1]]
    return f"; at {', '.join(named)} alone, a range of one point" if named else ""


def _read_only(claim: Claim, keys: Iterable[str]) -> None:
    strange = sorted(claim.evidence.keys() - set(keys))
    if strange:
        raise Unproved(f"its evidence has a part {quoted(strange[0])}, which is unknown here")


# --- parts that no claim examines

_PLANT_COORDINATES = (
    "phase, original coordinates",
    "uniform_chain, original coordinates",
    "original",
)  # the plant's coordinates
UNMODELLED = "lambda_tracking"  # this observer may have no model of the last row; its b is then 0
_POINTS = 5


def faults(context: Context) -> Iterator[str]:
    """Yield sentences on the equations in which the form differs from the plant."""
    form = context.form
    if form.kind in _PLANT_COORDINATES and sorted(row.text for row in form.to_form) != sorted(context.plant.states):
        yield "its states are not those of the plant, as its kind says"
    if context.fault:
        yield from _differences(context)


def unexamined(context: Context, verified: Iterable[str]) -> Iterator[str]:
    """Yield sentences on the parts of the certificate that no verified claim is about, and on identities that are not
    proved."""
    form, observer = context.form, context.file.observer
    if form.kind not in FORMS:
        yield f"no rule knows the form {quoted(form.kind)}: that the plant is in it"
    if context.fault and (reason := _unshown(context)):
        yield f"the form's equations: {reason}"
    if _unmodelled(context):
        yield f"what the last row of the form adds to A z: the {UNMODELLED} observer has no model of it"
    if observer is not None and not any(id.startswith(f"{observer.name}.") for id in verified):
        yield f"the {observer.name} observer: no verified claim is about it"


def _unmodelled(context: Context) -> bool:
    """Return whether b = 0 and the observer is lambda_tracking, which may have no model of the form's last row."""
    observer = context.file.observer
    return observer is not None and observer.name == UNMODELLED and all(row.text == "0" for row in context.form.b)


def _unshown(context: Context) -> str:
    try:
        box, speeds = _moving(context)
        algebra = algebra_of(box)
        for name, residual in _residuals(context, algebra.names, speeds, algebra.arithmetic):
            if not algebra.is_zero(residual):
                return f"{name} is not shown to be the plant's"
    except Undefined:
        return "an expression of it has no value"
    except REFUSALS as error:
        return reason_of(error)
    return ""


def _differences(context: Context) -> Iterator[str]:
    try:
        box, speeds = _moving(context)
    except Unproved:
        return
    for k in range(_POINTS):
        at = {
            name: inside(*ends, Fraction((3 * (k + i) + 5) % 11 + 1, 13)) for i, (name, ends) in enumerate(box.items())
        }
        try:
            differing = [name for name, x in _residuals(context, points(at), speeds, intervals) if x.sign]
        except Undefined:
            continue
        if differing:
            place = ", ".join(f"{name} = {printed(value)}" for name, value in at.items())
            yield f"its equations are not the plant's: {differing[0]} differs at {place}"
            return


def _moving(context: Context) -> tuple[Mapping[str, tuple[Any, Any]], Mapping[str, str]]:
    box, rates = box_of_rates(context)
    read = {name for row in context.form.to_form for name in row.names}
    return box, {u: rate for u, rate in rates.items() if u in read}


def _residuals(
    context: Context, at: Mapping[str, Any], rates: Mapping[str, str], arithmetic: Arithmetic
) -> Iterator[tuple[str, Any]]:
    """Yield the name and the residual of each equation of the form, z' = A z + b, y = output, X(Z(x)) = x, at the
    values `at` of the plant's names; `rates`: the name of u' for each input u."""
    form, plant = context.form, context.plant
    speeds = {name: evaluate(row, at, arithmetic) for name, row in zip(plant.states, plant.flow, strict=True)}
    speeds |= {u: at[rate] for u, rate in rates.items()}
    Z = [along(row, at, speeds, arithmetic) for row in form.to_form]
    z = {**at, **{name: image for name, (image, _) in zip(form.states, Z, strict=True)}}
    known = len(Z) - 1 if _unmodelled(context) else len(Z)
    for name, (_, speed), row, nonlinear in zip(form.states[:known], Z, form.A, form.b, strict=False):
        driven = (evaluate(entry, z, arithmetic) * z[other] for entry, other in zip(row, form.states, strict=True))
        yield f"{name}'", total((evaluate(nonlinear, z, arithmetic), *driven)) - speed
    for k, (measured, output) in enumerate(zip(plant.output, form.output, strict=True), 1):
        yield f"output {k}", evaluate(output, z, arithmetic) - evaluate(measured, at, arithmetic)
    for name, inverse in zip(plant.states, form.from_form, strict=True):
        yield name, evaluate(inverse, z, arithmetic) - at[name]


__all__ = ["CannotRead", "NoCertificate", "NotVerified", "NothingVerified", "Rechecked", "Row", "Unreadable"]
__all__ += ["load", "read", "recheck"]
