"""Tunings from a file, beside those that a model says: {"tuning": {"riccati": {..}}, "take": "riccati"}."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hgogen.modelfiles.json_file import BadFile, demand_plant, table_of
from hgogen.system import System


def read(path: Path, plant: System) -> tuple[Mapping[str, Any], str]:
    """The tunings of a plant by name of a JSON file, such as `hgogen tune` writes, and the one to take, "" where it
    says none.

    Raises: `BadFile`.
    """
    content = table_of(path, "hgogen tune")
    tables, take = content.get("tuning"), content.get("take", "")
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise BadFile(str(path), 'has no table "tuning" of tables; write {"tuning": {"riccati": {"Q": .., "R": ..}}}')
    if take not in ("", *tables):
        raise BadFile(str(path), f"takes {take!r:.60}, which is none of its tunings: {', '.join(tables)}")
    demand_plant(path, content, plant)
    return tables, take
