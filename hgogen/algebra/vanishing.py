"""Products of powers and logarithms, as programs compute them: x log x is 0 at x = 0.

x^p log(c x), p > 0, at x = 0 is its limit 0, down to the smallest number of a float, below which the logarithm stays
where it is; so is x^p log(x^2), which is that of 2 log |x|.
"""

from collections.abc import Callable
from dataclasses import dataclass

import sympy as sp

LEAST = sp.Rational(1, 2**126)  # the smallest number of a float with all its digits


def with_limits(expression: sp.Expr) -> sp.Expr:
    """The expression with b^p log(c b), p > 0, by its limit at b = 0; it has no value where c b < 0."""
    return _logs(expression, _limited)


def bounded_logs(expression: sp.Expr) -> sp.Expr:
    """The expression with what has a finite value where the limit has one in place of b^p log(c b), p > 0."""
    return _logs(expression, lambda product, log, of: product.xreplace({log: of.bounded}))


@dataclass(frozen=True)
class _LogOf:
    """A logarithm of c b or c/b, or of a power of b >= 0 that is even, or of |b|: `even`, where c is 1."""

    base: sp.Expr
    c: sp.Expr
    even: bool

    @property
    def bounded(self) -> sp.Expr:
        """What is finite for c b >= 0 where c is not 0; for any b where it is even."""
        if self.even:
            return sp.sqrt(sp.Abs(self.base))
        return sp.sqrt(self.c * self.base) + (0 if self.c.is_number else sp.log(self.c**2))


def _logs(expression: sp.Expr, put: Callable[[sp.Mul, sp.Expr, _LogOf], sp.Expr]) -> sp.Expr:
    products = expression.atoms(sp.Mul) if expression.has(sp.log) else ()
    vanishing = {product: log for product in products if (log := _vanishing(product)) is not None}
    return expression.xreplace({product: put(product, *log) for product, log in vanishing.items()})


def _vanishing(product: sp.Mul) -> tuple[sp.Expr, _LogOf] | None:
    """The logarithm of b, and what it is of, where it stands in a product with b^p, p > 0."""
    powers = product.as_powers_dict()
    growing = [b for b, p in powers.items() if b.free_symbols and p.is_positive]
    growing += [b.args[0] for b in growing if isinstance(b, sp.Abs)]
    for factor in powers:
        if not isinstance(factor, sp.log) or powers[factor] != 1:
            continue
        e = factor.args[0]
        even = e.args[0] if isinstance(e, sp.Abs) or (e.is_Pow and e.exp.is_Integer and e.exp.is_even) else None
        if even is not None and e not in growing:
            if even in growing and (isinstance(e, sp.Abs) or e.exp > 0):
                return factor, _LogOf(even, sp.S.One, True)
            continue
        for b in growing:
            c = next((c for c in (e / b, e * b) if not c.has(b) and not (c.free_symbols & b.free_symbols)), None)
            if c is not None:
                return factor, _LogOf(b, c, False)
    return None


def _limited(product: sp.Mul, log: sp.Expr, of: _LogOf) -> sp.Expr:
    b, e = of.base, log.args[0]
    if of.even:
        power = e.exp if e.is_Pow else 1
        lowest, own = (power * sp.log(x) for x in (LEAST, sp.Abs(b)))
        return sp.Piecewise((product.xreplace({log: own}), sp.Abs(b) > LEAST), (product.xreplace({log: lowest}), True))
    if e == b:
        low = product.xreplace({log: sp.log(LEAST)})
        return sp.Piecewise((product, b > LEAST), (low, b >= 0), evaluate=False)
    low = product.xreplace({log: sp.log(sp.Abs(e.xreplace({b: LEAST})))})
    return sp.Piecewise((low, sp.And(sp.Abs(b) <= LEAST, of.c * b >= 0)), (product, True), evaluate=False)
