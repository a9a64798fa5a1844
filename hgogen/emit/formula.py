"""Lines of equations as LaTeX, from text as observers and methods have it: z' = A z + b(sat z, u).

A primed name before = is a derivative, and so is a primed lower-case name with the subscript i, n or a number; any
other prime is a transpose. A word of several letters that is no mathematical name is set as text.
"""

# Takes apart: lines of equations, which are written for people, and words in which Markdown would read marks.

import re
from collections.abc import Iterable, Sequence

import sympy as sp

_GREEK = "alpha beta gamma delta eps eta kappa lambda mu nu phi psi rho sigma tau theta xi Delta Gamma Phi Pi Psi"
_NAMES = frozenset(f"{_GREEK} dPhi dh dx dz dc dw d2h xhat".split())
_CALLED = "acos asin atan cos cosh det diag exp log max mean min sat sin sinh sqrt sum tan tanh"
_OPERATORS = frozenset(_CALLED.split())
_SIGNS = {
    "<=": r"\leq ",
    ">=": r"\geq ",
    "<-": r"\leftarrow ",
    "->": r"\to ",
    "+-": r"\pm ",
    "..": r"\dots ",
    **{mark: rf"\{mark}" for mark in "{}%&#$_"},
    "<": r"\lt ",
    ">": r"\gt ",
    "'": r"^{\top}",
    "~": r"\sim ",
    "\\": r"\backslash ",
}
_NAME = r"[A-Za-z](?:\w*[A-Za-z0-9])?"
_KNOWN = "|".join(sorted(_OPERATORS | _NAMES))
_PARTS = re.compile(
    r"(?P<power>\^-?(?=\())|\^(?P<short>-?[A-Za-z0-9]+)|(?P<below>_\()|(?P<ratio>\b\d+/\d+(?![\w.]))"
    r"|(?P<number>\d+(?:\.\d+)?(?:e[-+]?\d+)?)"
    rf"|(?P<article>a)(?= (?!(?:{_KNOWN})\b)[a-z]{{4,}})"
    r"|(?P<joined>[A-Za-z][a-z]+-[A-Za-z][a-z]+)"
    rf"|(?P<rate>{_NAME})'(?=\s*=)|(?P<name>{_NAME})(?P<mark>'|[+*](?=[\s)|,^']|$))?"
    r"|(?P<sign><=|>=|<-|->|\+-|\.\.|[<>'{}%&#$_~\\])"
)
_BETWEEN_WORDS = re.compile(r" \} ?\\text\{ ")  # between two words
_DEPTH = {"(": 1, "[": 1, ")": -1, "]": -1}
_SPECIAL = {"dPhi": r"d\Phi", "sum_j": r"\sum_j"}
_SMALL = re.compile(r"[a-z]\w*_(?:[in]|\d+)\Z")


def formulas(line: str) -> list[str]:
    """Return each equation of a line of text as LaTeX; semicolons separate the equations."""
    return [_latex(part) for part in line.split("; ")]


def symbol_name(name: str) -> str:
    r"""Return a name in LaTeX as SymPy prints a symbol with this name, such as \theta_{1} for theta_1."""
    return str(sp.latex(sp.Symbol(name)))


def _latex(text: str) -> str:
    latex, at, depth = "", 0, 0
    while at < len(text):
        match = _PARTS.match(text, at)
        if match is None:
            depth += _DEPTH.get(text[at], 0)
            latex, at = latex + (r",\quad" if text[at] == "," and depth == 0 else text[at]), at + 1
            continue
        kind, end = match.lastgroup, match.end()
        if kind in ("power", "below"):  # parentheses hold a superscript or a subscript
            close = _close(text, end - (kind == "below"))
            inner = _latex(text[end:close] if kind == "below" else text[end : close + 1])
            latex += f"_{{{inner}}}" if kind == "below" else f"^{{{match['power'][1:]}{inner}}}"
            end = close + 1
        else:
            depth += {"{": 1, "}": -1}.get(match["sign"] or "", 0)
            latex += _part(match)
        at = end
    return _BETWEEN_WORDS.sub(" ", latex).strip()


def _close(text: str, start: int) -> int:
    depth = 0
    for at in range(start, len(text)):
        depth += _DEPTH.get(text[at], 0)
        if depth == 0:
            return at
    return len(text) - 1


def _part(match: re.Match[str]) -> str:
    if match["short"]:
        power = match["short"].removeprefix("-")
        return f"^{{{'-' * match['short'].startswith('-')}{symbol_name(power)}}}"
    if match["ratio"]:
        above, below = match["ratio"].split("/")
        return rf"\frac{{{above}}}{{{below}}}"
    if match["number"]:
        digits, _, power = match["number"].partition("e")
        return rf"{digits} \cdot 10^{{{int(power)}}}" if power else digits
    if match["rate"]:
        return rf"\dot{{{symbol_name(match['rate'])}}}"
    if word := match["name"] or match["article"] or match["joined"]:
        return _name(word, match["mark"] or "", word != match["name"])
    return _SIGNS[match["sign"]]


def _name(name: str, mark: str, spoken: bool) -> str:
    if name in _OPERATORS:
        return rf"\operatorname{{{name}}}{mark}"
    if spoken or (len(name) > 1 and "_" not in name and name not in _NAMES and not name[1:].isdigit()):
        return rf"\text{{ {name} }}{mark}"
    text = _SPECIAL.get(name, symbol_name(name))
    if mark == "'":
        return rf"\dot{{{text}}}" if _SMALL.match(name) else rf"{text}^{{\top}}"
    return f"{text}^{{{mark}}}" if mark else f"{text} " if text.startswith("\\") else text


# --- words and tables of Markdown


_MARKS = str.maketrans({mark: f"\\{mark}" for mark in r"\`*_{}[]<>|#$~"})


def plain(text: str) -> str:
    """Return text with Markdown's special characters escaped."""
    return " ".join(text.splitlines()).translate(_MARKS)


def prose(text: str) -> str:
    """Return text for Markdown: code between backquotes is unchanged, special characters elsewhere are escaped."""
    return "`".join(plain(part) if k % 2 == 0 else part for k, part in enumerate(text.split("`")))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table with the titles `head` and the cells `rows`."""
    lines = [head, ["---"] * len(head), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]
