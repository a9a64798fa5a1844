"""Signs of a fault and their counts, as the law of recovery moves them (stepping/recovery.py)."""

from dataclasses import dataclass

import casadi as ca

from hgogen.graph import Graph
from hgogen.program import Block, Field, Place, scalar, sym


@dataclass(frozen=True)
class Sign:
    """A sign of a fault: of `output`, or of the range of a state for None. `meaning` says of what, after "at which";
    `time` (the model's unit) for which it shows at least before a guard first acts, `wait` (W), `most` (M) and `change`
    (m) as counts."""

    name: str
    output: int | None
    meaning: str
    time: float
    wait: int
    most: int
    change: int = 0

    @property
    def count(self) -> str:
        """The field of the state that counts it, c."""
        return f"fault_count_{self.name}"

    @property
    def limit(self) -> str:
        """The field of the count at which a guard acts, w."""
        return f"fault_limit_{self.name}"

    @property
    def fields(self) -> tuple[Field, ...]:
        """What is remembered of it."""
        least = 0 if self.output is None else -self.most
        signed = "" if self.output is None else ", with the sign of the last error that does"
        return (
            scalar(self.count, 0.0, low=least, high=self.most, meaning=f"valid samples that show a fault{signed}"),
            scalar(self.limit, self.wait, low=self.wait, high=self.most, meaning="fault count at which a guard acts"),
        )

    @property
    def counted(self) -> Block:
        """The count moved by `work.moves_NAME`, with the sign of `work.side_NAME`. Count and limit are in their ranges,
        which was asked, and stay there: one at its most is at its limit as well, which an analyser need not see."""
        moves, limit = sym("work", f"moves_{self.name}"), sym("state", self.limit)
        size = ca.fmin(ca.fmax(self.size + moves, 0), self.most)
        return Block(
            f"count of {self.name}",
            {
                Place("state", self.count): self._signed(sym("work", f"side_{self.name}"), size),
                Place("state", self.limit): ca.if_else(size <= 0, self.wait, limit),
            },
        )

    @property
    def over(self) -> Graph:
        """Whether the count is at its limit, as it is only where it has just moved there; SX."""
        return self.size >= sym("state", self.limit)

    @property
    def size(self) -> Graph:
        """|c|; SX."""
        count = sym("state", self.count)
        return count if self.output is None else ca.fabs(count)

    def _signed(self, side: Graph, size: Graph) -> Graph:
        """A count of that size, of errors on a side of 0."""
        return size if self.output is None else ca.if_else(side < 0, -size, size)

    @property
    def longest(self) -> float:
        """The longest time between two restarts by it."""
        return self.time * self.most / self.wait / 2

    @property
    def later(self) -> Block:
        """A guard next acts at twice the count."""
        count, limit = sym("state", self.count), sym("state", self.limit)
        least = ca.fmin(limit, self.most / 2)  # which the size of the count has reached
        doubled = {self.count: self._signed(count, least), self.limit: ca.fmin(2 * limit, self.most)}
        return Block("the fault limit doubles", {Place("state", name): value for name, value in doubled.items()})
