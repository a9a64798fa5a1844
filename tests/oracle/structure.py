"""Forms by brute force: every order of the states, dependence and linearity by evaluation in 60 digits.

It knows nothing of hgogen: sampling at random points refutes a structure with certainty and confirms it in all but
the unluckiest cases, which is what a label needs.
"""

import itertools
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mpmath
import sympy as sp

from tests.oracle.text import read as text_of

DIGITS, SAME = 60, mpmath.mpf(10) ** -42
Value = Any


def read(text: Any, names: Sequence[str]) -> sp.Expr:
    """A text as an expression in which every listed name is a symbol and every number is exact."""
    return text_of(text, {name: sp.Symbol(name) for name in names}, rational=True)


@dataclass(frozen=True)
class Sampled:
    """A model's rows (the flow, then the outputs) as functions of states, inputs and parameters."""

    model: Mapping[str, Any]
    points: int = 4

    @cached_property
    def names(self) -> list[str]:
        """States, inputs, parameters, in this order."""
        m = self.model
        return [*m["states"], *m["inputs"], *m["known_params"], *m["unknown_params"]]

    @cached_property
    def rows(self) -> list[Callable[..., Value]]:
        """The flow and the outputs."""
        symbols = [sp.Symbol(name) for name in self.names]
        texts = [*self.model["f"], *self.model["h"]]
        return [sp.lambdify(symbols, read(text, self.names), "mpmath") for text in texts]

    @cached_property
    def boxes(self) -> list[tuple[Value, Value]]:
        """Where the points lie, strictly inside the boxes; [1/3, 8/5] where there is none."""
        ranges = {k: v for key in ("x_box", "u_box", "param_ranges") for k, v in (self.model.get(key) or {}).items()}
        ends = [[read(end, ()) for end in ranges.get(name, ("1/3", "8/5"))] for name in self.names]
        with mpmath.workdps(DIGITS):
            return [tuple(mpmath.mpf(sp.N(end, DIGITS)) for end in pair) for pair in ends]

    @cached_property
    def samples(self) -> list[list[Value]]:
        """Random points."""
        rng = random.Random(5)
        with mpmath.workdps(DIGITS):
            return [[a + (b - a) * mpmath.mpf(rng.random()) for a, b in self.boxes] for _ in range(self.points)]

    def change(self, row: int, state: int, point: list[Value], to: Value) -> Value:
        """What the row's value changes by when one state moves a fraction `to` of the way to its upper end."""
        moved = list(point)
        moved[state] += to * (self.boxes[state][1] - point[state])
        return (self.rows[row](*moved) - self.rows[row](*point)) / (moved[state] - point[state])

    @cached_property
    def depends(self) -> list[set[int]]:
        """The states that each row depends on."""
        n = len(self.model["states"])
        with mpmath.workdps(DIGITS):
            return [
                {j for j in range(n) if any(abs(self.change(i, j, p, mpmath.mpf("0.37"))) > SAME for p in self.samples)}
                for i in range(len(self.rows))
            ]

    def slope_varies_with(self, row: int, state: int) -> set[int]:
        """The states with which the chord in one state changes: itself, where the row bends."""
        varying = set()
        with mpmath.workdps(DIGITS):
            for point in self.samples:
                chord = self.change(row, state, point, mpmath.mpf("0.37"))
                if abs(self.change(row, state, point, mpmath.mpf("0.81")) - chord) > SAME * (1 + abs(chord)):
                    varying.add(state)
                for other in self.depends[row] - varying - {state}:
                    moved = list(point)
                    moved[other] += mpmath.mpf("0.53") * (self.boxes[other][1] - point[other])
                    if abs(self.change(row, state, moved, mpmath.mpf("0.37")) - chord) > SAME * (1 + abs(chord)):
                        varying.add(other)
        return varying


def chains(model: Mapping[str, Any]) -> Iterator[list[list[int]]]:
    """Every way to split the states into ordered chains, one for each output, none empty."""
    n, p = len(model["states"]), len(model["outputs"])
    for order in itertools.permutations(range(n)):
        for cuts in itertools.combinations(range(1, n), p - 1):
            yield [list(order[a:b]) for a, b in itertools.pairwise((0, *cuts, n))]


def structure(s: Sampled) -> dict[str, Any]:
    """Which structures hold, by trying every split: triangular, triangular_uy, uof_structure, order; levelwise,
    cascade, bent level-wise where there are several outputs."""
    model = s.model
    n, p = len(model["states"]), len(model["outputs"])
    varies = {(i, j): s.slope_varies_with(i, j) for i in range(n + p) for j in s.depends[i]}
    labels: dict[str, Any] = dict.fromkeys(("levelwise", "cascade", "bent"), False)
    labels |= dict.fromkeys(("triangular", "triangular_uy", "uof_structure"), False)
    for split in chains(model):
        if not all(s.depends[n + k] == {chain[0]} for k, chain in enumerate(split)):
            continue
        linear_heads = all(not varies[n + k, chain[0]] for k, chain in enumerate(split))
        steps = [(row, nxt) for chain in split for row, nxt in itertools.pairwise(chain)]
        if not all(nxt in s.depends[row] for row, nxt in steps):
            continue
        linear = linear_heads and all(not varies[step] for step in steps)
        level = {state: k for chain in split for k, state in enumerate(chain)}
        follower = dict(steps)
        flat = all(level[j] <= level[i] or j == follower.get(i) for i in level for j in s.depends[i])
        labels["levelwise"] |= flat and linear
        labels["bent"] |= flat
        labels["cascade"] |= linear and any(_cascade(order, s.depends) for order in itertools.permutations(split))
        if p == 1 and flat:
            head = split[0][0]
            labels |= {"uof_structure": True, "order": [model["states"][k] for k in split[0]], "triangular": linear}
            labels["triangular_uy"] = linear_heads and all(varies[step] <= {head} - {step[1]} for step in steps)
    return labels


def _cascade(split: Sequence[Sequence[int]], depends: list[set[int]]) -> bool:
    before: set[int] = set()
    for chain in split:
        for k, row in enumerate(chain):
            if not depends[row] <= before | set(chain[: k + 2]):
                return False
        before |= set(chain)
    return True
