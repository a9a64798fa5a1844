"""A certificate verified again, by code and arithmetic that share nothing with those that wrote it.

Exact identities are shown by rational functions over fractions, ranges by mpmath's intervals on the certificate's
bisections. A claim holds for the model that stands in the same file, of which `Rechecked.model` is the digest; the
file's own digest finds accidents, it is no signature.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hgogen.errors import HgogenError
from hgogen.recheck.algebra import TooLarge
from hgogen.recheck.arithmetic import Undefined
from hgogen.recheck.box import NotShown
from hgogen.recheck.context import Context, Shown
from hgogen.recheck.file import LARGEST, Certificate, Claim, NoCertificate, read
from hgogen.recheck.rules import required, rests, rule
from hgogen.recheck.text import Unreadable

OPEN = ("where", "generic", "unknown", "stated")  # verdicts that assert nothing to verify


@dataclass(eq=False)
class CannotRead(HgogenError):
    """A certificate file that cannot be read."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


@dataclass(eq=False)
class NotVerified(HgogenError):
    """A certificate of which a claim was not verified."""

    failed: tuple["Row", ...]

    def __str__(self) -> str:
        told = "; ".join(f"{row.id}: {row.sentence}" for row in self.failed)
        return f"not verified: {told}. Do not rely on this file; write it again with hgogen check --certificate"


@dataclass(eq=False)
class NothingVerified(HgogenError):
    """A certificate of which nothing is verified, because no claim of it asserts anything."""

    plant: str

    def __str__(self) -> str:
        return f"nothing of {self.plant} is verified: of no claim does this file say that it is proved or refuted"


@dataclass(frozen=True)
class Row:
    """One claim, what was found ("verified", "open" where nothing is asserted, "fails"), how, with how many boxes."""

    id: str
    verdict: str
    found: str
    sentence: str
    boxes: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "id": self.id,
            "verdict": self.verdict,
            "found": self.found,
            "sentence": self.sentence,
            "boxes": self.boxes,
        }


@dataclass(frozen=True)
class Rechecked:
    """What was verified of a certificate, claim by claim."""

    plant: str
    form: str
    observer: str
    model: str
    rows: tuple[Row, ...]

    @property
    def failed(self) -> tuple[Row, ...]:
        """The claims that were not verified."""
        return self._found("fails")

    @property
    def verified(self) -> tuple[Row, ...]:
        """The claims that were verified."""
        return self._found("verified")

    def _found(self, what: str) -> tuple[Row, ...]:
        return tuple(row for row in self.rows if row.found == what)

    @property
    def count(self) -> str:
        """How many claims were verified, are open, failed."""
        return f"{len(self.verified)} verified, {len(self._found('open'))} open, {len(self.failed)} failed"

    def demand(self) -> None:
        """Raises: `NotVerified` where a claim fails, `NothingVerified` where none is verified."""
        if self.failed:
            raise NotVerified(self.failed)
        if not self.verified:
            raise NothingVerified(self.plant)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        rows = [row.as_dict() for row in self.rows]
        about = {"plant": self.plant, "form": self.form, "observer": self.observer or None, "model": self.model}
        return {**about, "verified": bool(self.verified and not self.failed), "claims": rows}


def recheck(text: str) -> Rechecked:
    """Verify the certificate in a text; what is not shown is a row that fails.

    A file that was changed fails by the row "digest"; the other rows tell what holds of the model that it now names.

    Raises: `NoCertificate` and `Unreadable` for a text that is no certificate.
    """
    certificate = read(text)
    observer = certificate.observer.name if certificate.observer else ""
    about = (certificate.name, certificate.form.kind, observer, certificate.model)
    return Rechecked(*about, (*_changed(certificate), *rows(certificate)))


def _changed(certificate: Certificate) -> Iterator[Row]:
    """A row for each digest in the file that is another than that of what the file holds."""
    if not certificate.untouched:
        yield Row("digest", "", "fails", "the file is not as it was written")
    if not certificate.named:
        yield Row("model", "", "fails", "the file names another model than it holds")


def load(path: str | Path) -> str:
    """The text of a certificate file. Raises: `CannotRead`."""
    try:
        with open(path, encoding="utf-8") as stream:
            return stream.read(LARGEST + 1)
    except OSError as error:
        raise CannotRead(str(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise CannotRead(str(path), "is no text in UTF-8") from None


def rows(certificate: Certificate) -> Iterator[Row]:
    """One row a claim, and one for each that is missing."""
    context = Context(certificate)
    found: dict[str, Row] = {}
    for claim in certificate.claims:
        if claim.id in found:
            yield Row(claim.id, claim.verdict, "fails", "it stands twice")
        found.setdefault(claim.id, _row(context, claim))
    known = dict(found)
    while loose := [row for row in known.values() if row.found == "verified" and _missing(certificate, row, known)]:
        known |= {row.id: _resting(row, _missing(certificate, row, known)) for row in loose}
    yield from known.values()
    for id in required(certificate):
        if id not in found:
            yield Row(id, "", "fails", "the claim is missing")


def _missing(certificate: Certificate, row: Row, known: Mapping[str, Row]) -> list[str]:
    """What a claim rests on and is not verified."""
    return [id for id in rests(certificate, row.id) if id not in known or known[id].found != "verified"]


def _resting(row: Row, missing: list[str]) -> Row:
    return replace(row, found="fails", sentence=f"it rests on {missing[0]}, which is not verified", boxes=0)


def _row(context: Context, claim: Claim) -> Row:
    try:
        if claim.verdict in OPEN:
            _read_only(claim, ("reason",))
            return Row(claim.id, claim.verdict, "open", str(claim.evidence.get("reason", "")))
        shown = _shown(context, claim)
    except NotShown as error:
        return Row(claim.id, claim.verdict, "fails", str(error))
    except Undefined as error:
        return Row(claim.id, claim.verdict, "fails", f"an expression has no value: {error}")
    except TooLarge:
        return Row(claim.id, claim.verdict, "fails", "its identity is too large to verify")
    except NoCertificate as error:
        return Row(claim.id, claim.verdict, "fails", error.reason)
    except Unreadable as error:
        return Row(claim.id, claim.verdict, "fails", error.fault)
    return Row(claim.id, claim.verdict, "verified", shown.sentence, shown.boxes)


def _shown(context: Context, claim: Claim) -> Shown:
    found = rule(context.form.kind, claim)
    if found is None:
        raise NotShown(f"no rule verifies that it is {claim.verdict}")
    verify, place, keys = found
    _read_only(claim, keys)
    return verify(context, claim, place)


def _read_only(claim: Claim, keys: Iterable[str]) -> None:
    """Evidence that nothing reads could say anything. Raises: `NotShown`."""
    strange = sorted(claim.evidence.keys() - set(keys))
    if strange:
        raise NotShown(f"its evidence has a part {strange[0]!r}, which is unknown here")


__all__ = [
    *("CannotRead", "NoCertificate", "NotVerified", "NothingVerified", "Rechecked", "Row", "Unreadable"),
    *("load", "recheck"),
]
