"""A JSON file that a user gives, read once and no further than is reasonable."""

import json
from pathlib import Path
from typing import Any

from hgogen.errors import BadArgument

LARGEST = 10_000_000  # bytes


class BadFile(BadArgument):
    """A file of parameters or tunings that cannot be taken."""


def table_of(path: Path, writer: str) -> dict[str, Any]:
    """The object that the file holds; `writer`: the command that writes such files. Raises: `BadFile`."""
    try:
        with path.open("rb") as stream:
            text = stream.read(LARGEST + 1)
        table = json.loads(text[:LARGEST])
    except OSError as error:
        raise BadFile(str(path), f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise BadFile(str(path), f"is no JSON ({error}); give a file that `{writer}` wrote") from None
    return table if isinstance(table, dict) else {}
