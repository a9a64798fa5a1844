"""What `hgogen check --latex` prints: a form's equations and its checks as a LaTeX fragment (amsmath is enough).

z = T(x),   z' = A(u) z + b(z, u),   y = h(z, u)
"""

import re
from collections.abc import Iterable, Mapping, Sequence

import sympy as sp

from hgogen.check import Check
from hgogen.form import Form

_ESCAPED = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}


def fragment(form: Form, checks: Iterable[Check], accepted: Sequence[str] = ()) -> str:
    """The form's coordinates and equations, and a table of the checks with their verdicts."""
    plant = form.system
    parts = (
        _aligned("{} &= {}", dict(zip(form.states, form.to_form, strict=True))),
        _aligned(r"\dot{{{}}} &= {}", dict(zip(form.states, form.flow, strict=True))),
        _aligned("{} &= {}", dict(zip(plant.outputs, form.output, strict=True))),
        _table(checks, accepted),
    )
    return f"% {_escaped(plant.name)}, {_escaped(form.kind)} form\n" + "\n".join(parts) + "\n"


def _aligned(row: str, equations: Mapping[sp.Symbol, sp.Expr]) -> str:
    rows = (row.format(sp.latex(left), sp.latex(right)) for left, right in equations.items())
    return "\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"


def _table(checks: Iterable[Check], accepted: Sequence[str]) -> str:
    rows = [r"verdict & check & claim and reason \\ \hline"]
    for check in checks:
        at = ", ".join(f"{name} = {float(value):g}" for name, value in check.witness.items())
        verdict = f"{check.verdict}{', accepted' if check.id in accepted else ''}"
        said = f"{check.claim}: {check.reason}{'; at ' + at if at else ''}"
        rows.append(rf"{_escaped(verdict)} & {_escaped(check.id)} & {_escaped(said)} \\")
    columns = r"p{0.14\textwidth}p{0.24\textwidth}p{0.52\textwidth}"
    return f"\\begin{{tabular}}{{{columns}}}\n" + "\n".join(rows) + "\n\\end{tabular}"


def _escaped(text: str) -> str:
    """Text in which LaTeX reads no command; what is not ASCII is left to its input encoding."""
    return re.sub(r"[\\^~<>&%$#_{}]", lambda mark: _ESCAPED[mark[0]], text)
