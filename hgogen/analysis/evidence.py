"""The evidence of claims as texts in a certificate: numbers and expressions exact, bisections in prefix order.

Evidence is a mapping of exact values by name: numbers, expressions, texts, or lists and mappings of them. The proof of
a claim is a dataclass, and its fields are the evidence, or what its `evidence(form)` returns. A proof in the evidence
of another is replaced by the names of its own. Evidence is None where a certificate cannot show the claim.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from hgogen.form import Form
from hgogen.rigor.bounds import Proof, Range
from hgogen.rigor.box import exact
from hgogen.rigor.lookup import Table
from hgogen.rigor.tape import plain
from hgogen.sentence import up

_DIGITS = 12


def certificate_text(form: Form, expression: sp.Expr) -> str:
    """Return an expression of a form's symbols, or of its plant's, as the text that a certificate writes."""
    names = {s.name for s in (*form.system.signals, *form.states)}
    if form.system.origin is not None:
        names |= {s.name for s in form.system.origin.plant.signals}
    return text_with_names(expression, names)


def text_with_names(expression: sp.Expr, names: set[str]) -> str:
    """Return an expression as the text that a certificate writes; `names`: the names of its symbols."""
    return str(_Printer(names).doprint(exact(plain(sp.sympify(expression)))))


def exact_texts(form: Form, value: Any) -> Any:
    """Return a value as a certificate writes it: numbers and expressions as exact texts, also inside lists, mappings
    and proofs; texts and None unchanged."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Mapping) or is_dataclass(value):
        return texts(form, value)
    if isinstance(value, Iterable):
        return [exact_texts(form, each) for each in value]
    return certificate_text(form, value) if isinstance(value, sp.Basic) else str(Fraction(value))


def end_text(value: Fraction | float) -> str | None:
    """Return the end of a range as the text that a certificate writes, None for an infinite end."""
    return None if abs(value) == math.inf else str(Fraction(value))


def outward(value: float | Fraction, way: int) -> Fraction:
    """Return the value rounded to 12 significant digits: up for `way` = 1, down for `way` = -1."""
    if not value:
        return Fraction(0)
    step: Fraction = Fraction(10) ** (Decimal(up(abs(Fraction(value)))).adjusted() + 1 - _DIGITS)
    steps = Fraction(value) / step
    return step * (math.ceil(steps) if way > 0 else math.floor(steps))


def bisection_text(bisection: Range | Proof, form: Form | None = None) -> str:
    """Return a proof by bisection of a box as the text that a certificate writes, in prefix order: the name of the
    state that is bisected, then both halves; "." for a part that is not divided. The names are those of the form's
    states with a `form`, else those of the plant's."""
    pairs = zip(form.system.states, form.from_form, strict=True) if form else ()
    of_form = {*form.states} if form else set()  # x is such a z, or -z: mirrored
    images = {x: (str(z), z != image) for x, image in pairs for z in (image, -image) if z in of_form}
    names = [images.get(s, (s.name, False)) for s in bisection.variables]
    tokens: list[str] = []
    stack: list[Any] = [bisection.tree]
    while stack:
        node = stack.pop()
        if isinstance(node, str):
            tokens.append(".")
            continue
        _, index, first, second = node
        name, mirrored = names[int(index)]
        tokens.append(name)
        stack += [first, second] if mirrored else [second, first]
    return " ".join(tokens)


def _number_text(number: Fraction) -> str:
    decimal = repr(float(number))
    return str(number) if number.denominator == 1 or Fraction(decimal) != number else decimal


class _Printer(StrPrinter):  # type: ignore[misc]
    """A printer of SymPy's texts with rationals for floats, exp(1) for e."""

    def __init__(self, names: set[str]) -> None:
        super().__init__()
        self.names = names

    def _print_Exp1(self, expression: sp.Expr) -> str:
        return "exp(1)"

    def table(self, node: Table) -> str:
        cells = node.cells
        if len(node.args) == 1:
            points = zip(cells.axes[0].x, cells.values, strict=True)
            name, numbers = cells.kind.capitalize(), [number for point in points for number in point]
        else:  # the number of breakpoints of the first argument, the breakpoints of both, the values by rows
            x, y = (axis.x for axis in cells.axes)
            name, numbers = f"Bi{cells.kind}", [Fraction(len(x)), *x, *y, *(z for row in cells.values for z in row)]
        parts = (*map(self.doprint, node.args), *node.order, *map(_number_text, numbers))
        return f"{name}({', '.join(map(str, parts))})"

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "4*atan(1)" if "pi" in self.names else "pi"


Evidence = Mapping[str, Any]


@dataclass(frozen=True)
class ByForm:
    """The evidence of a claim that a checker verifies from the equations of the form and its plant alone."""

    def evidence(self, form: Form) -> Evidence:
        """Return no evidence besides the form."""
        return {}


@dataclass(frozen=True)
class Grounds:
    """The evidence of a claim about an observer. `numbers`: the observer's arguments by name (numbers, expressions of
    parameters, sequences of these); `fact`: the proved fact, or None where the claim follows from the fact of another
    claim."""

    numbers: Mapping[str, Any] = field(hash=False)
    fact: Any = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """Return the evidence of `fact`, under the keys of a certificate."""
        return {} if self.fact is None else {"fact": self.fact}


def texts(form: Form, value: Any) -> dict[str, Any] | None:
    """Return the entries of a proof, or of a mapping by name, as texts for a certificate; None where a part has no
    evidence."""
    parts: Evidence | None
    if isinstance(value, Mapping):
        parts = value
    elif hasattr(value, "evidence"):
        parts = value.evidence(form)
    else:
        parts = {each.name: getattr(value, each.name) for each in fields(value)}
    if parts is None:
        return None
    entries: dict[str, Any] = {}
    for name, part in parts.items():
        inner = texts(form, part) if is_dataclass(part) else {name: exact_texts(form, part)}
        if inner is None:
            return None
        entries |= inner
    return entries


Sides = Mapping[sp.Symbol, tuple[Fraction | float, Fraction | float]]
LOOSE = 2.0**-10  # relative excess of a Lipschitz bound over the proof's, so that a weaker arithmetic reaches it


def enclosure(form: Form, expression: sp.Expr, bounds: Range | Proof, where: Sides | None = None) -> Evidence | None:
    """Return the evidence that low <= expression <= high, finite, on the form's box, or on the box `where`; None where
    the `bounds` are not finite or not proved."""
    low, high = bounds.low, bounds.high
    if isinstance(bounds, Range) and not bounds.defined:
        return None
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return None
    number = Fraction(str(expression)) if expression.is_Rational else None
    return {
        "expression": certificate_text(form, expression),
        "box": _sides(sides(form, expression.free_symbols) if where is None else where),
        "low": outward(low, -1) if number is None else number,
        "high": outward(high, 1) if number is None else number,
        "tree": bisection_text(bounds, form if where is None else None),
    }


def lipschitz_evidence(form: Form, rows: Iterable[sp.Expr], proof: Proof, wider: float = 1e-9) -> Evidence | None:
    """Return the evidence of a bound of the spectral norm of dr/dx, r = `rows` as expressions of the form's states;
    None where the `proof` has no bound. `wider`: the relative excess of the certificate's bound over the proved one."""
    if proof.high is None:
        return None
    names = set().union(*(exact(sp.sympify(row)).free_symbols for row in rows))
    bound = outward(float(proof.high) * (1 + wider), 1)
    return {"box": _sides(sides(form, names)), "bound": bound, "tree": bisection_text(proof, form)}


def sides(form: Form, names: Iterable[sp.Symbol]) -> Sides:
    """Return the ranges of the states, inputs and parameters of a form that occur in `names`."""
    every = form.box
    return {s: every[s] for s in sorted(names, key=str)}


def point(place: Mapping[sp.Symbol, Fraction], names: Iterable[sp.Symbol]) -> Mapping[str, str]:
    """Return the coordinates of a point as texts by name, those of `place` whose symbols are in `names`."""
    return {s.name: str(place[s]) for s in names if s in place}


def _sides(where: Sides) -> dict[str, list[str | None]]:
    return {s.name: [end_text(low), end_text(high)] for s, (low, high) in where.items()}


@dataclass(frozen=True)
class Slopes:
    """The evidence of a bound of the Jacobian |db/dx| by the plant's states x, with its `proof`."""

    proof: Proof = field(hash=False)

    def evidence(self, form: Form) -> Evidence | None:
        """Return the evidence of the bound of |db/dz|, b as expressions of the form's states z, under the keys of a
        certificate."""
        back = dict(zip(form.system.states, form.from_form, strict=True))
        return lipschitz_evidence(form, [row.xreplace(back) for row in self.proof.expressions], self.proof, LOOSE)


@dataclass(frozen=True)
class Steep:
    """The evidence of a bound of |S dc/dw S^-1| on the box, S = diag(`units`), c the nonlinear part in the coordinates
    w of integrators. `scale` (n): the diagonal of S dw/dz, expressions of parameters; `wider`: the relative excess of
    the certificate's bound over the proved one, so that less accurate arithmetic reaches it."""

    units: tuple[Fraction, ...]
    scale: tuple[sp.Expr, ...]
    proof: Proof
    wider: float = 1e-9

    def evidence(self, form: Form) -> Evidence | None:
        """Return the evidence of the bound of |S dc/dw S^-1|, under the keys of a certificate."""
        slope = lipschitz_evidence(form, (*form.b, *self.scale), self.proof, self.wider)
        return slope and {"units": self.units, "scale": self.scale, **slope}
