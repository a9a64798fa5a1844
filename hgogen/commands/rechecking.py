"""The command `recheck`: a certificate verified again."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Group
from rich.text import Text

from hgogen.commands.command import Json, command, show
from hgogen.commands.headed import headed
from hgogen.reading.content import content_of
from hgogen.recheck import verification
from hgogen.recheck.file import LARGEST, SHOWN


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
    of = f", {outcome.observer} observer" if outcome.observer else ""
    table = headed(f"{outcome.plant}, {outcome.form} form{of}", "found", "claim", "what was shown", "boxes", numbers=1)
    colours = {"verified": "green", "fails": "red"}
    for row in outcome.rows:
        word = Text(f"{row.verdict}, verified" if row.found == "verified" else row.found)
        word.stylize(colours.get(row.found, "yellow"))
        sentence = f"{row.verdict}: {row.sentence}" if row.found in ("open", "stated") else row.sentence
        table.add_row(word, Text(row.id), Text(sentence), str(row.boxes or ""))
    lines = (*outcome.remarks, f"model {outcome.model[:SHOWN]}", outcome.count)
    show(as_json, outcome, Group(table, "", *map(Text, lines)))
    outcome.demand()
