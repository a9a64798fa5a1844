"""Rigorous answers about an expression that a user asks, on the declared box of a plant or on one of his own."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from numbers import Rational, Real
from typing import Any

import sympy as sp

from hgogen.check import Verdict
from hgogen.errors import BadArgument, HgogenError
from hgogen.reading.expression import Fold, read
from hgogen.reading.given import limits, scalar
from hgogen.rigor import bounds
from hgogen.rigor.bounds import LIMIT, Range, Sign
from hgogen.rigor.box import Box, End, box
from hgogen.sentence import Reason, joined
from hgogen.system import System


@dataclass(eq=False)
class NotInBox(HgogenError):
    """An expression with a symbol that has no place in the box."""

    symbol: str
    known: tuple[str, ...]
    alike: bool

    def __str__(self) -> str:
        if self.alike:
            return f"{self.symbol} is not the symbol declared with that name; use the Signal itself, or write text"
        return f"{self.symbol} is not in the box, which has {', '.join(self.known) or 'no symbols'}; declare it there"


class BadRange(BadArgument):
    """A value in the place of a box, or of one of its ranges, that is none."""

    text = "the box: {what} {reason}; give a plant, or a mapping such as {{'u': (-1, 1)}}"


def bound(expression: Any, where: System | Box, *, boxes: int = LIMIT, relative: float = 0.02) -> Range:
    """The range of an expression, rigorous on the whole closed box, wider than the true one by at most `relative` of
    its width, or its `note` says why; so it does of a text from which SymPy folded away places without a value.

    Args: `expression`: SymPy, or text in the names of the box, read by the grammar of plain-text models; `where`: a
    plant, for the box of its declared ranges, parameters without a range at their values, outputs standing for their
    equations, or a mapping from symbols or names to closed ranges (low, high), exact or float, infinite if unbounded.

    Raises: `BadExpression` for text outside the grammar; `Misfit` for what is no expression, and for limits out of
    range; `NotInBox`; `BadRange`; `EmptyBox`; `NoTape` for a function without a rule.
    """
    limits("bound", boxes, relative)
    resolved, box, folded = _resolved("bound", expression, where)
    extent = bounds.bound(resolved, box, boxes=boxes, relative=relative)
    return replace(extent, defined=False, note=joined(folded, extent.note)) if folded else extent


def nonzero(expression: Any, where: System | Box, *, boxes: int = LIMIT) -> Sign:
    """Whether an expression is finite and has one sign on the whole closed box; arguments and errors as of `bound`.

    Of a text from which SymPy folded away places of the box without a value it is not proved.
    """
    limits("nonzero", boxes)
    resolved, box, folded = _resolved("nonzero", expression, where)
    answer = bounds.nonzero(resolved, box, boxes=boxes)
    if folded and answer.verdict is Verdict.PROVED:
        return replace(answer, verdict=Verdict.UNKNOWN, sign=0, margin=0.0, reason=folded, exact=None)
    return answer


def _resolved(what: str, source: Any, where: System | Box) -> tuple[sp.Expr, Box, Reason]:
    """The expression, the box, and where the text has no value though its expression has one, or `NONE`."""
    plant = where if isinstance(where, System) else None
    around = box((*plant.states, *plant.inputs, *plant.parameters), plant.nominal) if plant else _ranges(where)
    equations = dict(zip(plant.outputs, plant.output, strict=True)) if plant else {}
    names: dict[str, sp.Symbol] = {s.name: s for s in (*around, *equations)}
    tables = {cells.name: cells for cells in plant.tables} if plant else {}
    fold = read(source, names, tables) if isinstance(source, str) else Fold("", scalar(source, what), ())
    expression = fold.reading
    for symbol in sorted(expression.free_symbols - {*around, *equations}, key=str):
        raise NotInBox(str(symbol), tuple(names), symbol.name in names)
    written = replace(fold, lost=tuple(one._replace(of=one.of.xreplace(equations)) for one in fold.lost))
    return expression.xreplace(equations), around, written.on(around)


def _ranges(where: Any) -> Box:
    """The box that a user's mapping declares. Raises: `BadRange`."""
    if not isinstance(where, Mapping):
        raise BadRange(str(where), "is neither a plant nor a mapping")
    ranges: dict[sp.Symbol, tuple[End, End]] = {}
    for key, value in where.items():
        if not isinstance(key, sp.Symbol | str):
            raise BadRange(str(key), "is no name")
        if not isinstance(value, Sequence) or len(value) != 2:
            raise BadRange(str(key), f"has {value!r} for its range")
        low, high = (_end(key, end) for end in value)
        ranges[key if isinstance(key, sp.Symbol) else sp.Symbol(key)] = low, high
    return ranges


def _end(key: Any, end: Any) -> End:
    """A float is the number that its shortest decimal says, as in a Signal."""
    if isinstance(end, sp.Rational):
        return Fraction(end)
    if isinstance(end, bool) or not isinstance(end, Real):
        raise BadRange(str(key), f"has the end {end!r}, which is no number")
    if isinstance(end, float) and math.isfinite(end):
        return Fraction(repr(float(end)))
    return Fraction(end) if isinstance(end, Rational) else float(end)
