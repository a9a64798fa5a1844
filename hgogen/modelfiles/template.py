"""The text of a model file to begin with."""

import os
from pathlib import Path

from hgogen.emit.naming import demand_file
from hgogen.modelfiles.place import PYTHON
from hgogen.reading import files
from hgogen.signal import check_name
from hgogen.target import CannotWrite

_TEXT = Path(__file__).with_suffix(".txt")
_NAME = "NAME"  # stands in the text for that of the model


def model(name: str, folder: Path) -> dict[str, str]:
    """A model file of this name, by the name of the file. Raises: `BadName`, `BadFileName`, `HidesHeader` for a name
    that a plant or a file cannot have; `CannotWrite` where the folder holds such a file."""
    check_name(name)
    demand_file(name)
    file = f"{files.demand(name)}{PYTHON}"
    if os.path.lexists(folder / file):
        raise CannotWrite(str(folder / file), "it is there already", "take another name, or another folder by --out")
    return {file: _TEXT.read_text(encoding="utf-8").replace(_NAME, name)}
