"""A certificate verified again, by code and arithmetic that share nothing with those that wrote it.

Exact identities are shown by rational functions over fractions, ranges by mpmath's intervals on the certificate's
bisections. A claim holds for the model that stands in the same file, of which `Rechecked.model` is the digest; the
file's own digest finds accidents, it is no signature. What no verified claim is about is said to be unexamined, and an
open claim's reason is the file's: nobody has verified it.
"""

import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from .algebra import TooLarge
from .arithmetic import Undefined
from .box import NotShown
from .context import Context, Shown, short
from .examined import faults, unexamined
from .file import LARGEST, Certificate, Claim, NoCertificate, part, words
from .file import read as read_file
from .rules import OBSERVERS, required, rests, rule_of
from .text import RecheckError, Unreadable

STATED = "stated"  # proved or refuted, but of no evidence that is verified here
OPEN = ("where", "generic", "unknown", STATED)  # verdicts that assert nothing to verify


@dataclass(eq=False)
class CannotRead(RecheckError):
    """A certificate file that cannot be read."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


@dataclass(eq=False)
class NotVerified(RecheckError):
    """A certificate of which a claim was not verified."""

    status: ClassVar[int] = 1
    failed: tuple["Row", ...]

    def __str__(self) -> str:
        failures = "; ".join(f"{row.id}: {row.sentence}" for row in self.failed)
        return f"not verified: {failures}. Do not rely on this file; write it again with hgogen check --certificate"


@dataclass(eq=False)
class NothingVerified(RecheckError):
    """A certificate of which nothing is verified, because no claim of it asserts anything."""

    status: ClassVar[int] = 1
    plant: str

    def __str__(self) -> str:
        return f"nothing of {self.plant} is verified: of no claim does this file say that it is proved or refuted"


@dataclass(frozen=True)
class Row:
    """The outcome of one claim, or a fault of the file or of its form, which has no verdict.

    `found` is "verified", "fails", or, where nothing is asserted, "open" or "stated"; `sentence` says how it was found,
    with how many `boxes`.
    """

    id: str
    verdict: str
    found: str
    sentence: str
    boxes: int = 0


_COUNTED = {"verified": "verified", "open": "open", STATED: STATED, "fails": "failed"}


@dataclass(frozen=True)
class Rechecked:
    """What was verified of a certificate, claim by claim.

    `unexamined` is what no verified claim is about; `points` are the names that have one value, which all of it rests
    on.
    """

    plant: str
    form: str
    observer: str
    model: str
    rows: tuple[Row, ...]
    unexamined: tuple[str, ...] = ()
    points: Mapping[str, str] = field(default_factory=dict, hash=False)

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
        """How many claims were verified, are open, are only stated; and what failed."""
        return {name: len(self._rows_with(what)) for what, name in _COUNTED.items()}

    @property
    def count(self) -> str:
        """The counts as text."""
        return ", ".join(f"{count} {name}" for name, count in self.counts.items())

    @property
    def remarks(self) -> list[str]:
        """What all of it rests on, and what it says nothing of."""
        points = ", ".join(f"{name} = {value}" for name, value in self.points.items())
        fixed = [f"with one value: {points}"] if points else []
        return [*fixed, *(f"not examined: {subject}" for subject in self.unexamined)]

    def demand(self) -> None:
        """Raises: `NotVerified` where a claim fails, `NothingVerified` where none is verified."""
        if self.failed:
            raise NotVerified(self.failed)
        if not self.verified:
            raise NothingVerified(self.plant)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        rows = [asdict(row) for row in self.rows]
        about = {"plant": self.plant, "form": self.form, "observer": self.observer or None, "model": self.model}
        outcome = {"verified": bool(self.verified and not self.failed), "counts": self.counts, "claims": rows}
        return {**about, **outcome, "unexamined": list(self.unexamined), "points": dict(self.points)}


def read(text: str) -> Certificate:
    """The certificate in a text.

    Raises: `NoCertificate` for what is no JSON, or misses a part; `Unreadable` for an expression or number.
    """
    return read_file(text, OBSERVERS)


@lru_cache(maxsize=4)  # who makes a certificate has it verified, and is often the first who is given it
def recheck(text: str) -> Rechecked:
    """Verify the certificate in a text; what is not shown is a row that fails.

    A file that was changed fails by the row "digest"; the other rows tell what holds of the model that it now names.

    Raises: `NoCertificate` and `Unreadable` for a text that is no certificate.
    """
    certificate = read(text)
    context = Context(certificate)
    observer = certificate.observer.name if certificate.observer else ""
    outcomes = (*_changed(certificate), *rows(context), *(Row("form", "", "fails", fault) for fault in faults(context)))
    verified = [row.id for row in outcomes if row.found == "verified"]
    points = {name: short(Fraction(low)) for name, (low, high) in certificate.plant.box.items() if low == high}
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
    """A name of the file, quoted where it may be more than a name."""
    return text if re.fullmatch(r"[\w ,.()-]{1,80}", text, re.ASCII) else words(text)


def _changed(certificate: Certificate) -> Iterator[Row]:
    """A row for each digest in the file that is another than that of what the file holds."""
    if not certificate.untouched:
        yield Row("digest", "", "fails", "the file is not as it was written")
    if not certificate.named:
        yield Row("model", "", "fails", "the file names another model than it holds")


def load(path: str | Path) -> str:
    """The text of a certificate file. Raises: `CannotRead`."""
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
    """A row for each claim, and one for each required claim that is missing."""
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
    """What a claim rests on and is not verified."""
    claim = certificate.claim(row.id)
    needed = rests(certificate, claim) if claim else ()
    return [id for id in needed if id not in known or known[id].found != "verified"]


def _row(context: Context, claim: Claim) -> Row:
    """What the verification of a claim gives: it is verified, it asserts nothing to verify, or it fails, and why."""
    verdict = _plain(claim.verdict)
    try:
        if claim.verdict in OPEN:
            _read_only(claim, ("reason",))
            reason = words(part(claim.evidence, "reason", str))
            outcome = STATED if claim.verdict == STATED else "open"
            return Row(claim.id, verdict, outcome, f"not verified; in the file's words: {reason}")
        shown = _shown(context, claim)
    except NotShown as error:
        return Row(claim.id, verdict, "fails", str(error))
    except Undefined as error:
        return Row(claim.id, verdict, "fails", f"an expression has no value: {error}")
    except (TooLarge, RecursionError):
        return Row(claim.id, verdict, "fails", "its identity is too large to verify")
    except NoCertificate as error:
        return Row(claim.id, verdict, "fails", error.reason)
    except Unreadable as error:
        return Row(claim.id, verdict, "fails", error.fault)
    return Row(claim.id, verdict, "verified", f"{shown.sentence}{_narrow(context)}", shown.boxes)


def _narrow(context: Context) -> str:
    """The states and inputs whose ranges are one point, which a claim holds at alone."""
    plant = context.plant
    every = {**plant.box, **{name: context.form.box[name] for name in context.z}}
    signals = (*plant.states, *context.file.inputs, *context.z)
    named = [f"{name} = {short(Fraction(every[name][0]))}" for name in signals if every[name][0] == every[name][1]]
    return f"; at {', '.join(named)} alone, a range of one point" if named else ""


def _shown(context: Context, claim: Claim) -> Shown:
    kind = context.form.kind
    rule = rule_of(kind, claim)
    if rule is None:
        raise NotShown(f"no rule verifies that it is {_plain(claim.verdict)}")
    _read_only(claim, rule.keys)
    shown = rule.show(context, claim)
    return replace(shown, sentence=f"{rule.named(rule.about, kind, claim)}: {shown.sentence}")


def _read_only(claim: Claim, keys: Iterable[str]) -> None:
    """Evidence that nothing reads could say anything. Raises: `NotShown`."""
    strange = sorted(claim.evidence.keys() - set(keys))
    if strange:
        raise NotShown(f"its evidence has a part {words(strange[0])}, which is unknown here")


__all__ = [
    *("CannotRead", "NoCertificate", "NotVerified", "NothingVerified", "Rechecked", "Row", "Unreadable"),
    *("load", "read", "recheck"),
]
