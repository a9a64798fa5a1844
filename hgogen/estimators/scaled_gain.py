"""A gain of an observer whose entries, of parameters, stand times powers of theta: a derived value of its program."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import casadi as ca
import sympy as sp

from hgogen.analysis.scaling import power
from hgogen.estimators.columns import Column
from hgogen.form import Form
from hgogen.graph import Graph, to_casadi
from hgogen.program import Block, Field, Place, sym
from hgogen.sentence import same

_OWN = 2  # numbers in the index of an entry for its own chain


@dataclass(frozen=True)
class ScaledGain:
    """The gain `name` of the entries `values`, at their `places`; it is what a report calls its `meaning`."""

    name: str
    values: tuple[sp.Expr, ...]
    places: tuple[Column, ...]
    meaning: str

    def __str__(self) -> str:
        numbers = {x: sp.Symbol(same(float(x))) for k in self.values for x in k.atoms(sp.Float)}
        texts = dict(zip(self.places, (str(k.xreplace(numbers)) for k in self.values), strict=True))
        groups = groupby(texts, lambda place: place.row if self.whole else place.chain)
        return ", ".join(f"({', '.join(texts[place] for place in group)})" for _, group in groups)

    @property
    def whole(self) -> bool:
        """Whether rows act on outputs of other chains, too."""
        return any(len(place.index) > _OWN for place in self.places)

    @property
    def field(self) -> Field:
        """The derived value, its entries called theta K_1, theta^2 K_2, ..; chain by chain of several."""
        labels = []
        for place in self.places:
            powers = {0: "", 1: "theta "}.get(place.power, f"theta^{place.power} ")
            index = ",".join(map(str, place.index))
            labels.append(f"{powers}{self.name}_{index}" if len(place.index) == 1 else f"{powers}{self.name}_({index})")
        return Field(self.name, (0.0,) * len(self.values), labels=tuple(labels), meaning=self.meaning)

    def tuned(self, form: Form) -> Block:
        """How it comes of theta and the parameters, SX of their places."""
        constants = {s: v for s, v in form.system.nominal.items() if not s.bounded}
        parameters = {s: sym("plant", s.name) for s in form.system.parameters if s.bounded}
        values: list[Graph] = to_casadi([k.subs(constants) for k in self.values], parameters)
        theta, powered = sym("gain", "theta"), []
        for place, value in zip(self.places, values, strict=True):
            scale = power(theta, place.power) if place.power >= 0 else 1 / power(theta, -place.power)
            powered.append(scale * value)
        return Block(self.meaning, {Place("derived", self.name): ca.vertcat(*powered)})

    def onto(self, e: Graph, n: int) -> Graph:
        """The gain times the error (q) of each chain's output: (n)."""
        entries: Sequence[Graph] = ca.vertsplit(sym("derived", self.name, len(self.values)))
        rows: list[Graph] = [0] * n
        for place, row in groupby(zip(self.places, entries, strict=True), lambda pair: pair[0].row):
            rows[place] = sum(k * e[at.chain] for at, k in row)
        return ca.vertcat(*rows)
