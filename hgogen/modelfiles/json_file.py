"""A JSON file that a user gives, read once and no further than is reasonable.

A file that a command wrote holds the equations of its plant. A plant with others takes its numbers all the same, since
a model changes while it is worked on; but that is said.
"""

import json
import warnings
from pathlib import Path
from typing import Any

from hgogen.errors import BadArgument
from hgogen.reading.content import Unread, content_of
from hgogen.system import System

LARGEST = 10_000_000  # bytes


class BadFile(BadArgument):
    """A file of parameters or tunings that cannot be taken."""


class OtherPlant(UserWarning):
    """A file that was written for a plant with other equations."""


def equations(plant: System) -> list[str]:
    """Of the plant as first declared, as a file holds them: values of parameters are no part of them."""
    first = plant.declared
    flow = (f"{x}' = {row}" for x, row in zip(first.states, first.flow, strict=True))
    return [*flow, *(f"{y} = {row}" for y, row in zip(first.outputs, first.output, strict=True))]


def demand_plant(path: Path, table: dict[str, Any], plant: System) -> None:
    """Warn with `OtherPlant` where the file says of which equations it is, and the plant has others."""
    own, others = equations(plant), table.get("equations")
    if not isinstance(others, list) or others == own:
        return
    lost = next((f"{row}" for row in others if row not in own), "fewer equations")
    warnings.warn(
        f"{path} was made for another plant, with {lost:.200}; make it again for this one", OtherPlant, stacklevel=2
    )


def table_of(path: Path, writer: str) -> dict[str, Any]:
    """The object that the file holds; `writer`: the command that writes such files. Raises: `BadFile`."""
    try:
        table = json.loads(content_of(path, LARGEST))
    except Unread as error:
        raise BadFile(str(path), error.reason) from None
    except (ValueError, RecursionError) as error:
        raise BadFile(str(path), f"is no JSON ({error}); give a file that `{writer}` wrote") from None
    return table if isinstance(table, dict) else {}
