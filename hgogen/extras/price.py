"""What a README says of costs, as `hgogen cost` measured them of the same source."""

import hashlib
from collections.abc import Mapping
from typing import Any

_UNKNOWN = (
    "`hgogen cost` measures instructions, flash, RAM and stack on a Cortex-M4F, and writes them to `cost.json` here;\n"
    "generated again, this page tells them."
)
_ROWS = (
    ("instructions of a step, calm", "quiet"),
    ("instructions of a step, the worst of a hostile record", "worst"),
    ("bytes of flash", "flash"),
    ("bytes of RAM, of `s` and `p`", "ram"),
    ("bytes of stack, the deepest of a hostile record and of spoiled memory", "stack"),
)


def digest(source: str) -> str:
    """By which costs and the source that they are of are known to belong together."""
    return hashlib.sha256(source.encode()).hexdigest()[:16]


def priced(costs: Mapping[str, Any] | None, source: str) -> str:
    """The costs as a table, or how they are measured, where they are unknown or of another source."""
    if costs is None or costs.get("source") != digest(source):
        return _UNKNOWN
    head = f"On a {costs['machine']}, compiled by {costs['compiler']} with `{costs['flags']}`:"
    rows = (f"| {what} | {costs[key]} |" for what, key in _ROWS)
    return "\n".join((head, "", "| what | how much |", "|---|---|", *rows))
