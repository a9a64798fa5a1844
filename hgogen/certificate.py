"""Certificates: what was proved of a model, as a JSON value that `hgogen.recheck` verifies again.

    {"format": "hgogen certificate", "version": "1", "hgogen": its version,
     "plant": {"name", "states", "inputs", "parameters": [{"name", "low", "high"}], "outputs": [name], "flow",
               "output"},
     "form": {"kind", "states", "to_form", "from_form", "A", "b", "output"},
     "claims": [{"id", "verdict", "evidence"}],
     "digest": SHA-256 of all the rest}

Numbers are exact and texts, "7/2" or "0.05"; an infinite end of a range is null; a parameter without a range has its
value as both ends. x' = flow(x, u), y = output(x, u) is the plant as first declared, z = to_form(x), x = from_form(z),
z' = A z + b, y = output the form.

Evidence of an enclosure: "expression", "box", "low", "high", "tree"; of a Lipschitz bound: "box", "bound" of |db/dz| in
the spectral norm, "tree"; of a refutation: "expression", "witness". A tree is a bisection in prefix order: a name cuts
its side of the box at the midpoint (an unbounded side at 0, beyond 0 at twice its end and one), a dot is a leaf.

A claim is "proved" or "refuted" here only if its evidence is verified by `hgogen.recheck`; what has no such evidence is
"stated", with a reason, and so are open verdicts as they are: they assert nothing.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from importlib.metadata import version
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from hgogen.bounds import Range, bound, box, nonzero
from hgogen.check import Check, Verdict
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.points import exact
from hgogen.recheck import recheck
from hgogen.recheck_file import FORMAT, VERSION, digest
from hgogen.recheck_text import Unreadable
from hgogen.signal import Signal

Evidence = dict[str, Any]
_DIGITS = 12


@dataclass(eq=False)
class NotCertifiable(HgogenError):
    """A model that a certificate cannot carry."""

    plant: str
    reason: str

    def __str__(self) -> str:
        return f"no certificate of {self.plant!r}: {self.reason}"


def certificate(form: Form, checks: Iterable[Check]) -> dict[str, Any]:
    """The certificate of a form's checks.

    What `hgogen.recheck` does not verify is "stated" in it, not "proved".

    Raises: `NotCertifiable` for a model with functions that the certificate's grammar has not (Piecewise, floor).
    """
    claims = [_claim(form, check) for check in checks]
    found = _sealed({**_model(form), "claims": claims})
    try:
        rows = recheck(json.dumps(found)).rows
    except Unreadable as error:
        raise NotCertifiable(form.system.name, error.reason) from None
    failed = {row.id: row.sentence for row in rows if row.found == "fails"}
    return _sealed({**found, "claims": [_demoted(claim, failed) for claim in claims]})


def _sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    return {**content, "digest": digest(content)}


def _demoted(claim: Mapping[str, Any], failed: Mapping[str, str]) -> dict[str, Any]:
    if claim["id"] not in failed:
        return dict(claim)
    reason = f"{claim['verdict']}, without evidence that can be verified again: {failed[claim['id']]}"
    return {"id": claim["id"], "verdict": "stated", "evidence": {"reason": reason}}


# --- the model


def _model(form: Form) -> dict[str, Any]:
    system = form.system
    plant = system if system.origin is None else system.origin.plant
    text = _Printer({s.name for s in (*plant.signals, *form.states)}).text
    inverse = [expression for _, expression in form.estimates]
    return {
        "format": FORMAT,
        "version": VERSION,
        "hgogen": version("hgogen"),
        "plant": {
            "name": plant.name,
            "states": _ranges(plant.states),
            "inputs": _ranges(system.inputs),
            "parameters": _ranges(system.parameters, system.nominal),
            "outputs": [y.name for y in plant.outputs],
            "flow": [text(row) for row in plant.flow],
            "output": [text(row) for row in plant.output],
        },
        "form": {
            "kind": form.kind,
            "states": _ranges(form.states),
            "to_form": [text(row) for row in form.entry],
            "from_form": [text(row) for row in inverse],
            "A": [[text(form.A[i, j]) for j in range(form.n)] for i in range(form.n)],
            "b": [text(row) for row in form.b],
            "output": [text(row) for row in form.output],
        },
    }


def _ranges(signals: Iterable[Signal], nominal: Mapping[Signal, sp.Rational] | None = None) -> list[dict[str, Any]]:
    return [{"name": s.name, "low": _end(low), "high": _end(high)} for s, (low, high) in box(signals, nominal).items()]


def _end(value: Fraction | float) -> str | None:
    return None if abs(value) == math.inf else str(Fraction(value))


class _Printer(StrPrinter):  # type: ignore[misc]
    """SymPy's text in the certificate's grammar: rationals for floats, exp(1) for e."""

    def __init__(self, names: set[str]) -> None:
        super().__init__()
        self.names = names

    def text(self, expression: sp.Expr) -> str:
        """The text of an expression."""
        return str(self.doprint(exact(sp.sympify(expression))))

    def _print_Exp1(self, expression: sp.Expr) -> str:
        return "exp(1)"

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "4*atan(1)" if "pi" in self.names else "pi"


# --- the claims


def _claim(form: Form, check: Check) -> dict[str, Any]:
    evidence = _evidence(form, check)
    if evidence is None:
        open_ = check.verdict not in (Verdict.PROVED, Verdict.REFUTED)
        verdict, prefix = (str(check.verdict), "") if open_ else ("stated", f"{check.verdict}: ")
        return {"id": check.id, "verdict": verdict, "evidence": {"reason": f"{prefix}{check.reason}"}}
    return {"id": check.id, "verdict": str(check.verdict), "evidence": evidence}


def _evidence(form: Form, check: Check) -> Evidence | None:
    for verdict, pattern, make in _MAKERS:
        match = re.fullmatch(pattern, check.id)
        if match and check.verdict is verdict:
            return make(form, int(match.group(1)) if match.groups() else 0)
    return None


def _text(form: Form, expression: sp.Expr) -> str:
    return _Printer({s.name for s in (*form.system.signals, *form.states)}).text(expression)


def _box(form: Form, names: Iterable[sp.Symbol]) -> dict[sp.Symbol, tuple[Fraction | float, Fraction | float]]:
    system = form.system
    every = box((*form.states, *system.inputs, *system.parameters), system.nominal)
    return {s: every[s] for s in sorted(names, key=str)}


def _sides(where: Mapping[sp.Symbol, tuple[Fraction | float, Fraction | float]]) -> dict[str, list[str | None]]:
    return {s.name: [_end(low), _end(high)] for s, (low, high) in where.items()}


def _tree(found: Range) -> str:
    """The bisection in prefix order."""
    tokens, left = [], [found.tree]
    while left:
        node = left.pop()
        if isinstance(node, str):
            tokens.append(".")
        else:
            _, index, first, second = node
            tokens.append(found.variables[int(index)].name)  # type: ignore[call-overload]
            left += [second, first]  # type: ignore[list-item]
    return " ".join(tokens)


def _enclosure(form: Form, expression: sp.Expr, found: Range) -> Evidence | None:
    if not (found.defined and found.finite):
        return None
    return {
        "expression": _text(form, expression),
        "box": _sides(_box(form, expression.free_symbols)),
        "low": str(outward(found.low, -1)),
        "high": str(outward(found.high, 1)),
        "tree": _tree(found),
    }


def outward(value: float, way: int) -> Fraction:
    """A number of 12 significant digits at or above the value (`way` 1), or at or below it (-1)."""
    if not value:
        return Fraction(0)
    step = Fraction(10) ** (math.floor(math.log10(abs(value))) + 1 - _DIGITS)
    steps = Fraction(value) / step
    return step * (math.ceil(steps) if way > 0 else math.floor(steps))


def _gain(form: Form, index: int) -> Evidence | None:
    """0 < a_m <= a_i <= a_M: the range where it keeps clear of zero, else what shows the sign."""
    a = _coefficient(form, index)
    where = _box(form, a.free_symbols)
    found = bound(a, where)
    return _enclosure(form, a, found if found.low > 0 else nonzero(a, where).range)


def _coefficient(form: Form, index: int) -> sp.Expr:
    a = sp.diff(form.output[0], form.states[0]) if index == 1 else form.A[index - 2, index - 1]
    return exact(sp.sympify(a))


def _no_gain(form: Form, index: int) -> Evidence | None:
    """A point where a_i is zero, negative or undefined, exactly."""
    a = _coefficient(form, index)
    where = _box(form, a.free_symbols)
    found = nonzero(a, where)
    least = found.range.least
    if found.verdict is Verdict.REFUTED and found.reason != "changes sign":  # else it is next to the zero only
        point = found.witness
    elif least is not None and least.value < 0:
        point = least.point
    else:
        return None
    at = {s.name: str(point[s]) for s in where if s in point}
    return {"expression": _text(form, a), "witness": at}


def _offset(form: Form, index: int) -> Evidence | None:
    z = form.states[0]
    c = exact(sp.sympify(form.output[0])).subs(z, 0)
    return _enclosure(form, c, bound(c, _box(form, c.free_symbols)))


def _slope(form: Form, index: int) -> Evidence | None:
    """dh/dz_1 or dF_(i-1)/dz_i away from zero, on the box of states, inputs and parameters."""
    row = form.output[0] if index == 1 else form.flow[index - 2]
    slope = exact(sp.sympify(row).diff(form.states[index - 1]))
    where = _box(form, slope.free_symbols)
    found = bound(slope, where)
    return _enclosure(form, slope, found if found.low > 0 or found.high < 0 else nonzero(slope, where).range)


def _lipschitz(form: Form, index: int) -> Evidence | None:
    return _steep(form, form.b)


def _whole_lipschitz(form: Form, index: int) -> Evidence | None:
    return _steep(form, (*form.flow, *form.output))


def _steep(form: Form, rows: Iterable[sp.Expr]) -> Evidence | None:
    """A bound of the rows' Jacobian, from the range of its squared Frobenius norm."""
    b = sp.Matrix([exact(sp.sympify(row)) for row in rows])
    slopes = b.jacobian(sp.Matrix(form.states))
    square = sp.Add(*(x**2 for x in slopes))
    found = bound(square, _box(form, square.free_symbols), relative=0.1)
    if not (found.defined and found.finite):
        return None
    steep = outward(math.sqrt(max(found.high, 0.0)) * (1 + 1e-9), 1)
    return {"box": _sides(_box(form, b.free_symbols)), "bound": str(steep), "tree": _tree(found)}


def _nothing(form: Form, index: int) -> Evidence:
    """For claims that are verified from the form itself."""
    return {}


Maker = Callable[[Form, int], Evidence | None]
_MAKERS: tuple[tuple[Verdict, str, Maker], ...] = (
    (Verdict.PROVED, r"triangular\.structure", _nothing),
    (Verdict.PROVED, r"triangular\.a_(\d+)", _gain),
    (Verdict.REFUTED, r"triangular\.a_(\d+)", _no_gain),
    (Verdict.PROVED, r"triangular\.offset", _offset),
    (Verdict.PROVED, r"triangular\.lipschitz", _lipschitz),
    (Verdict.PROVED, r"uniform\.structure", _nothing),
    (Verdict.PROVED, r"uniform\.slope_(\d+)", _slope),
    (Verdict.PROVED, r"uniform\.lipschitz", _whole_lipschitz),
    (Verdict.PROVED, r"recast\.(?:inverse|range)", _nothing),
)
