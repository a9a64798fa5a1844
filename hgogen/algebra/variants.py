"""Other forms of one expression, equal to it wherever it is defined: interval arithmetic likes some better."""

import sympy as sp

_LARGE = 400  # operations beyond which rewriting would cost more than bisection
_REWRITTEN = 12  # exponents beyond which it would grow out of hand
STEEP = 2000  # exponents beyond which exact numbers would


def largest_exponent(expression: sp.Expr) -> int:
    """The size of the largest numerical exponent."""
    return max((abs(int(node.exp.p)) for node in expression.atoms(sp.Pow) if node.exp.is_Rational), default=0)


def steep(e: sp.exp) -> bool:
    """Whether SymPy would take it as a high power: exp(-8750/T) as exp(1/T)^-8750."""
    return any(abs(int(term.as_coeff_Mul(rational=True)[0].p)) > _REWRITTEN for term in sp.Add.make_args(e.args[0]))


def variants(expression: sp.Expr) -> tuple[sp.Expr, ...]:
    """The expression as it is, then its factors and its Horner forms where it is rational in its symbols.

    They come from exact algebra over the rationals: each is equal to the first where the first is defined, and may have
    lost a removable pole.
    """
    symbols = sorted(expression.free_symbols, key=str)
    if not symbols or expression.count_ops() > _LARGE or largest_exponent(expression) > _REWRITTEN:
        return (expression,)
    if expression.has(sp.Piecewise, sp.floor, sp.ceiling):
        return (expression,)
    forms = [expression]
    try:
        stands = {e: sp.Dummy() for e in sorted(expression.atoms(sp.exp), key=str) if steep(e)}
        forms.append(sp.factor(expression.xreplace(stands)).xreplace({d: e for e, d in stands.items()}))
        if expression.is_polynomial(*symbols):
            whole = sp.expand(expression)
            forms += [whole, *(sp.horner(whole, wrt=wrt) for wrt in (symbols, symbols[::-1]))]
    except (sp.PolynomialError, NotImplementedError):
        pass
    strange = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I)
    return tuple(dict.fromkeys(form for form in forms if not form.has(*strange)))
