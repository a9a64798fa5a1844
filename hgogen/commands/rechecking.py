"""The command `recheck`: a certificate verified again."""

from pathlib import Path
from typing import Annotated

import typer

from hgogen.commands import tables
from hgogen.commands.command import Json, command, show
from hgogen.reading.content import content_of
from hgogen.recheck import verification
from hgogen.recheck.file import LARGEST


@command()
def recheck_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A certificate that hgogen check wrote.")],
    as_json: Json = False,
) -> None:
    """Verify a certificate again, by other code and another arithmetic than those that wrote it.

    Exit status: 0 every claim that is said to be proved or refuted is verified, 1 one of them is not or there is none,
    2 the file is no certificate. The model's digest is that in the banner of its C; the file's digest is no signature.

    JSON keys: plant, form, observer (null without one), model (SHA-256 of these three), verified, counts (verified,
    open, stated, failed), claims (id, verdict, found: "verified", "open" or "stated" where nothing is asserted, or
    "fails", sentence, boxes: how many intervals it took), unexamined (what no verified claim is about), points (names
    whose range is one value, and it).
    """
    try:
        text = content_of(file, LARGEST).decode()
    except UnicodeDecodeError:
        raise verification.CannotRead(str(file), "is no text in UTF-8") from None
    outcome = verification.recheck(text)
    show(as_json, outcome.as_dict(), tables.rechecked(outcome))
    outcome.demand()
