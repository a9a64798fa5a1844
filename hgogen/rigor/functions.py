"""Functions that may stand in a model, by the names that a text and SymPy have for them: one table for both.

A function is known to every arithmetic and every language, or is rewritten by such functions where a model is declared,
    Mod(x, p) = x - p floor(x/p),   frac(x) = x - floor(x),   cot(x) = cos(x)/sin(x),   acoth(x) = atanh(1/x), ..
or is refused there, with what to write instead. Heaviside(0) is 1/2, as SymPy has it; cbrt is the real root.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import reduce

import sympy as sp

from hgogen.errors import nearest

ARGUMENTS = 20  # most arguments of a function of several
# functions of SymPy that are rewritten where a model is declared
MEANING: dict[type, Callable[..., sp.Basic]] = {
    sp.cot: lambda x: sp.cos(x) / sp.sin(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: sp.cosh(x) / sp.sinh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
    sp.asec: lambda x: sp.acos(1 / x),
    sp.acsc: lambda x: sp.asin(1 / x),
    sp.asech: lambda x: sp.acosh(1 / x),
    sp.acsch: lambda x: sp.asinh(1 / x),
    sp.acoth: lambda x: sp.atanh(1 / x),
    sp.sinc: lambda x: sp.sin(x) / x,
    sp.Mod: lambda x, y: x - y * sp.floor(x / y),
    sp.frac: lambda x: x - sp.floor(x),
    sp.ITE: lambda c, a, b: (c & a) | (~c & b),
    sp.Xor: lambda *args: reduce(lambda a, b: (a & ~b) | (~a & b), args),
    sp.Implies: lambda a, b: ~a | b,
    sp.Equivalent: lambda *args: sp.And(*args) | sp.And(*map(sp.Not, args)),
}

_ONE = "exp log sqrt sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh Abs sign floor ceiling"
_REWRITTEN = "sec csc cot sech csch coth asec acsc asech acsch acoth frac"

# by the name in a text: the function, its least and its most arguments
WRITTEN: Mapping[str, tuple[Callable[..., sp.Expr], int, int]] = {
    **{name: (getattr(sp, name), 1, 1) for name in _ONE.split()},
    **{name: (MEANING[getattr(sp, name)], 1, 1) for name in _REWRITTEN.split()},
    "sinc": (lambda e: sp.S.One if e == 0 else MEANING[sp.sinc](e), 1, 1),
    "abs": (sp.Abs, 1, 1),
    "cbrt": (lambda e: sp.sign(e) * sp.Abs(e) ** sp.Rational(1, 3), 1, 1),
    "Heaviside": (sp.Heaviside, 1, 2),
    "Mod": (lambda e, p: MEANING[sp.Mod](e, p) if p != 0 else sp.zoo, 2, 2),
    "atan2": (sp.atan2, 2, 2),
    "hypot": (lambda *args: sp.sqrt(sp.Add(*(e**2 for e in args))), 1, ARGUMENTS),
    "clip": (lambda e, low, high: sp.Max(low, sp.Min(e, high)), 3, 3),
    **{name: (getattr(sp, name.capitalize()), 1, ARGUMENTS) for name in ("Min", "min", "Max", "max")},
}
NAMES = (*sorted(WRITTEN), "Piecewise")

_TABLE = "it has no portable implementation: give its values on the declared range as a table"
_CLOSED = "write it in closed form, or make an integral a state"
_REAL = "a model is of real numbers: leave it out"
_DECIMAL = "write its value as a decimal number"
_SPECIAL = (
    "erf erfc erfi erfinv gamma loggamma digamma polygamma beta factorial binomial zeta polylog LambertW Ei Si Ci li "
    "besselj bessely besseli besselk airyai airybi elliptic_k elliptic_e expint fresnels fresnelc hyper"
)
# by the name in a text or in SymPy of a function that is refused: what to write instead
INSTEAD: Mapping[str, str] = {
    **dict.fromkeys(_SPECIAL.split(), _TABLE),
    **dict.fromkeys(("Derivative", "Integral", "Sum", "Product", "Limit", "Subs", "Order"), _CLOSED),
    **dict.fromkeys(("re", "conjugate"), _REAL),
    "im": "a model is of real numbers: write 0",
    "arg": "write atan2(y, x)",
    **dict.fromkeys(("Catalan", "EulerGamma", "GoldenRatio", "TribonacciConstant"), _DECIMAL),
    "DiracDelta": "a rate has no impulses: write a short pulse with Piecewise, or let an input carry it",
    "SingularityFunction": "write Max(x - a, 0)**n, or Heaviside(x - a) for n = 0",
    "KroneckerDelta": "write Piecewise((1, (x >= a) & (x <= a)), (0, True))",
    "Contains": "compare with < <= > >=",
    "acot": "write atan(1/x), which jumps at 0, or pi/2 - atan(x), which does not",
    "real_root": "write sign(x)*abs(x)**(1/n) for an odd n",
    **dict.fromkeys(("deadzone", "dead_zone"), "write x - clip(x, -a, a)"),
    **dict.fromkeys(("sat", "saturate", "saturation"), "write clip(x, low, high)"),
    **dict.fromkeys(("round", "rint"), "write floor(x + 1/2)"),
    "trunc": "write sign(x)*floor(abs(x))",
    **dict.fromkeys(("mod", "fmod", "remainder"), "write Mod(x, p), which is x - p*floor(x/p)"),
    **dict.fromkeys(("where", "if_else", "ifelse"), "write Piecewise((value, condition), (other, True))"),
    **dict.fromkeys(("step", "theta", "unit_step"), "write Heaviside(x), which is 1/2 at 0, or Heaviside(x, 1)"),
    **dict.fromkeys(("norm", "length"), "write hypot(x, y)"),
    "ln": "write log(x)",
    "log10": "write log(x)/log(10)",
    "log2": "write log(x)/log(2)",
    "log1p": "write log(1 + x)",
    "expm1": "write exp(x) - 1",
    "pow": "write x**y",
    "ceil": "write ceiling(x)",
    "fabs": "write abs(x)",
    "sgn": "write sign(x)",
    **dict.fromkeys(
        ("arcsin", "arccos", "arctan", "arcsinh", "arccosh", "arctanh"), "write asin, acos, atan, asinh, acosh or atanh"
    ),
    "arctan2": "write atan2(y, x)",
}


def refusal(name: str, others: Iterable[str] = ()) -> str:
    """Return the sentence that no model can have the function `name`, and what to write instead. `others`: further
    names that the model text may call."""
    known = (*NAMES, *others)
    listed = f"the functions are {', '.join(known)}; give another one by its values, as a table"
    return f"there is no function {name[:60]!r}; {INSTEAD.get(name) or nearest(name, known, listed)}"
