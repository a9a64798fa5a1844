"""The two step lengths that are named of a part of an observer by a method."""

from dataclasses import dataclass

from hgogen.program import INF


@dataclass(frozen=True)
class Lengths:
    """Two step lengths, in the unit of the model's time.

    Above `refused` a step is refused: `why` says what happens there, and `other` which method has no such limit. Up to
    `take` a step is advised, and `basis` says how that is known. `rule`: by what the part goes, "" for the method.
    """

    refused: float = INF
    take: float = INF
    why: str = ""
    other: str = ""
    basis: str = ""
    rule: str = ""
