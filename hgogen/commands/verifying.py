"""The command `recheck`, which verifies a certificate again."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.text import Text

from hgogen.commands.command import Report, command
from hgogen.commands.output import headed
from hgogen.reading.files import content_of
from hgogen.recheck.file import DIGEST_DIGITS, LARGEST
from hgogen.recheck.verification import CannotRead, Rechecked, recheck

_COLOURS = {"verified": "green", "fails": "red"}


@dataclass(frozen=True)
class Verification(Report):
    """The claims of a certificate, verified again."""

    json_keys = (
        "plant=outcome.plant form=outcome.form observer model=outcome.model verified counts=outcome.counts "
        "claims=outcome.rows unexamined=outcome.unexamined points=outcome.points"
    )

    outcome: Rechecked

    @property
    def observer(self) -> str | None:
        """Name of the observer; null without one."""
        return self.outcome.observer or None

    @property
    def verified(self) -> bool:
        """Whether at least one claim is verified, and none fails."""
        return bool(self.outcome.verified and not self.outcome.failed)

    def tables(self) -> Iterator[Any]:
        """Yield a row for each claim."""
        outcome = self.outcome
        of = f", {outcome.observer} observer" if outcome.observer else ""
        head = f"{outcome.plant}, {outcome.form} form{of}"
        table = headed(head, "found", "claim", "what was shown", "boxes", numbers=1)
        for row in outcome.rows:
            word = Text(f"{row.verdict}, verified" if row.found == "verified" else row.found)
            word.stylize(_COLOURS.get(row.found, "yellow"))
            sentence = f"{row.verdict}: {row.sentence}" if row.found in ("open", "stated") else row.sentence
            table.add_row(word, Text(row.id), Text(sentence), str(row.boxes or ""))
        lines = (*outcome.remarks, f"model {outcome.model[:DIGEST_DIGITS]}", outcome.count)
        yield Group(table, "", *map(Text, lines))

    def demand(self) -> None:
        """Raise an error if a claim fails or none is verified."""
        self.outcome.demand()


@command(Verification)
def recheck_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A certificate that hgogen check wrote.")],
) -> Verification:
    """Verify a certificate again, by code and an arithmetic that are independent of those that wrote it.

    Exit status: 0 if every claim that is declared proved or refuted is verified, 1 if one of them is not or there is
    none, 2 if the file is no certificate. The model's digest is that in the banner of its C; the file's digest is no
    signature.
    """
    try:
        text = content_of(file, LARGEST).decode()
    except UnicodeDecodeError:
        raise CannotRead(str(file), "is no text in UTF-8") from None
    return Verification(recheck(text))
