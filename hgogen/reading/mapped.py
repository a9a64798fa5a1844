"""A signal of a log: one of its columns by name, or an expression of columns.

    T1 + 273.15      2*pi/60*rpm      -[Current(A)]

by the grammar of text models. In brackets stands the name of a column that is no identifier. A column whose name is the
whole text comes first, in the unit of its signal where it names another (reading/converted.py).
"""

import re

import casadi as ca
import numpy as np
import sympy as sp

from hgogen.graph import NoGraph, to_casadi
from hgogen.reading.expression import BadExpression, parse
from hgogen.reading.log import BadRecord, Column, Table

_BRACKETS = re.compile(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")  # with a pair of brackets in it, as of a unit
_SIGNS = re.compile(r"[-+*/()\[\]]")


def column(log: Table, text: str) -> Column:
    """The numbers of a column, or of an expression: no number where one that it reads has none.

    Raises: `BadRecord`.
    """
    if text in log.header or not _SIGNS.search(text):
        return log.column(text)
    bracketed = _BRACKETS.findall(text)
    numbers = iter(range(len(bracketed)))
    plain = _BRACKETS.sub(lambda _: f" {_placeholder(log, next(numbers))} ", text)
    names = {_placeholder(log, k): name for k, name in enumerate(bracketed)}
    names |= {name: name for name in log.header if name.isidentifier()}
    symbols = {written: sp.Symbol(written, real=True) for written in names}
    try:
        expression = parse(plain, symbols)
        words = set(re.findall(r"[^\W\d]\w*", plain))
        read = {written: log.column(names[written]) for written in names if written in words}
        graph = ca.Function("column", *_graph(expression, {symbols[written]: written for written in read}))
    except (BadExpression, NoGraph) as error:
        listed = ", ".join(name if name.isidentifier() else f"[{name}]" for name in log.header if name)
        raise BadRecord(log.path, f"the expression {text!r}: {error}; its columns are {listed}") from None
    if not read:
        reason = f"the expression {text!r} reads no column; name one, in brackets if it is no identifier"
        raise BadRecord(log.path, reason)
    with np.errstate(all="ignore"):
        values = np.array(graph(*(one.values[None, :] for one in read.values()))).ravel()
    known = np.all([np.isfinite(one.values) for one in read.values()], axis=0) & np.isfinite(values)
    blank = np.any([one.blank for one in read.values()], axis=0)
    examples = (one.example for one in read.values() if one.example)
    return Column(text, np.where(known, values, np.nan), blank & ~known, next(examples, ""))


def operand(log: Table, text: str) -> str:
    """What stands for a column, or an expression of columns, within an expression."""
    if text in log.header:
        return text if text.isidentifier() else f"[{text}]"
    return f"({text})"


def _placeholder(log: Table, k: int) -> str:
    """An identifier that no column has."""
    name = f"column_{k}"
    while name in log.header:
        name += "_"
    return name


def _graph(expression: sp.Expr, written: dict[sp.Symbol, str]) -> tuple[list[ca.SX], list[ca.SX]]:
    inputs = {symbol: ca.SX.sym(name) for symbol, name in written.items()}
    return list(inputs.values()), to_casadi([expression], inputs)
