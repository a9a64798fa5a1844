"""Expressions as rational functions of generators: what exp, sin, roots and powers are, so that algebra can cancel.

    exp(p m) = E^(p/g)                          E = exp(g m)
    cos(k t) + i sin(k t) = ((1 + i T)^2/(1 + T^2))^k     T = tan(t/2)
    e^(p/q) = R^p                               R^q = e, a relation
    a^b = exp(b log a),   log(c g) = log c + log g for a rational c > 0,   sinh, cosh, tanh by exp
    |e|^2 = e^2, a relation,   max(a, b) = (a + b + |a - b|)/2,   min(a, b) = (a + b - |a - b|)/2

m is a monomial of the expanded argument, g the greatest common divisor of its rational factors. Any other function of
an argument is a generator of its own. Each rule is an identity over the reals wherever both sides are defined; that
generators may depend on each other in a way not listed only loses proofs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce

import sympy as sp

from hgogen.errors import HgogenError
from hgogen.rigor.kinks import Norm
from hgogen.sentence import Reason, because

# A multiple of an angle, the terms and the operations of one argument beyond these would only cost time.
_MULTIPLE, _TERMS, _OPERATIONS = 16, 6, 200
_TRIGONOMETRIC = (sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc)
_TRIED = 2**16  # the primes that a large whole number under a logarithm is divided by
_HYPERBOLIC = (sp.sinh, sp.cosh, sp.tanh, sp.coth, sp.sech, sp.csch)


@dataclass(eq=False)
class TooLarge(HgogenError):
    """An expression that exact algebra would need too long for."""

    what: str

    @property
    def reason(self) -> Reason:
        """Why it is not tried."""
        return because("{what} is too large for exact algebra; write it in fewer or simpler terms", what=self.what)

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class Relation:
    """generator^degree = value, a rational function of generators that come before it."""

    generator: sp.Dummy
    degree: int
    value: sp.Expr


@dataclass(frozen=True, eq=False)
class Writer:
    """Kernels and relations as they are met; `units`: each exponential's or angle's monomial with its g."""

    kernels: dict[sp.Expr, sp.Dummy] = field(default_factory=dict)
    relations: list[Relation] = field(default_factory=list)
    units: dict[tuple[str, sp.Expr], sp.Rational] = field(default_factory=dict)
    known: dict[sp.Expr, sp.Expr] = field(default_factory=dict)

    def measure(self, expression: sp.Expr) -> None:
        """The greatest common divisors g of the factors of all arguments."""
        for node in sp.preorder_traversal(expression):
            kind = _kind(node)
            if kind:
                for factor, monomial in _terms(_argument(node)):
                    key = (kind, monomial)
                    self.units[key] = sp.gcd(self.units.get(key, sp.S.Zero), factor)
                    self.measure(monomial)

    def write(self, node: sp.Expr) -> sp.Expr:
        """The node in generators."""
        if node.is_Rational or node.is_Symbol:
            return node
        if node not in self.known:
            self.known[node] = self._write(node)
        return self.known[node]

    def _write(self, node: sp.Expr) -> sp.Expr:
        if node.is_Add or node.is_Mul:
            return node.func(*(self.write(part) for part in node.args))
        if node.is_Pow and node.exp.is_Integer:
            return self.write(node.base) ** node.exp
        if node.is_Pow and node.exp.is_Rational:
            base, degree = _canonical(node.base), int(node.exp.q)
            root = sp.Pow(base, sp.Rational(1, degree), evaluate=False)
            return self._relation(root, degree, base) ** int(node.exp.p)
        if isinstance(node, _TRIGONOMETRIC):
            return self._trigonometric(node)
        if _kind(node) == "exp":
            return self._exponential(node)
        if isinstance(node, sp.log):
            return self._log(_canonical(node.args[0]))
        if isinstance(node, sp.Abs) or (isinstance(node, Norm) and len(node.args) == 1):
            return self._abs(node.args[0])
        if isinstance(node, (sp.Min, sp.Max)):
            sign = 1 if isinstance(node, sp.Max) else -1
            return self.write(reduce(lambda a, b: (a + b + sign * sp.Abs(a - b)) / 2, node.args))
        return self._kernel(node)

    def _kernel(self, node: sp.Expr) -> sp.Expr:
        """A generator for the node; the same for arguments that are the same rational function."""
        if isinstance(node, sp.Function) and not isinstance(node, sp.Piecewise):
            node = node.func(*(_canonical(part) for part in node.args), evaluate=False)
        return self.kernels.setdefault(node, sp.Dummy(f"kernel{len(self.kernels)}"))

    def _relation(self, key: sp.Expr, degree: int, value: sp.Expr) -> sp.Expr:
        if key not in self.kernels:
            inner = self.write(value)
            self.kernels[key] = sp.Dummy(f"kernel{len(self.kernels)}")
            self.relations.append(Relation(self.kernels[key], degree, inner))
        return self.kernels[key]

    def _abs(self, argument: sp.Expr) -> sp.Expr:
        argument = _canonical(argument)
        if argument.could_extract_minus_sign():
            argument = _canonical(-argument)
        return self._relation(sp.Abs(argument, evaluate=False), 2, argument**2)

    def _log(self, argument: sp.Expr) -> sp.Expr:
        if argument.is_Integer and argument > 1:
            known = {} if argument < 2**40 else {"limit": _TRIED, "use_rho": False, "use_pm1": False, "use_ecm": False}
            factors = sp.factorint(argument, **known)
            return sp.Add(*(k * self._kernel(sp.log(p, evaluate=False)) for p, k in factors.items()))
        factor, rest = argument.as_content_primitive()
        if factor < 0:
            factor, rest = -factor, -rest
        powers = [part for part in sp.Mul.make_args(rest) if isinstance(part, sp.exp)]
        rest = sp.Mul(*(part for part in sp.Mul.make_args(rest) if part not in powers))
        inner = sp.S.Zero if rest == 1 else self._kernel(sp.log(rest, evaluate=False))
        ends = [self._log(sp.Integer(n)) if n != 1 else sp.S.Zero for n in (factor.p, factor.q)]
        return sp.Add(inner, ends[0], -ends[1], *(self.write(power.args[0]) for power in powers))

    def _exponential(self, node: sp.Expr) -> sp.Expr:
        power = sp.Mul(*(self._factor(*term) for term in _terms(_argument(node))))
        rules = {
            sp.sinh: (power - 1 / power) / 2,
            sp.cosh: (power + 1 / power) / 2,
            sp.tanh: (power**2 - 1) / (power**2 + 1),
            sp.coth: (power**2 + 1) / (power**2 - 1),
            sp.sech: 2 * power / (power**2 + 1),
            sp.csch: 2 * power / (power**2 - 1),
        }
        return rules.get(type(node), power)

    def _factor(self, factor: sp.Rational, monomial: sp.Expr) -> sp.Expr:
        """exp(factor monomial)."""
        if isinstance(monomial, sp.log):
            return self.write(sp.Pow(monomial.args[0], factor))
        unit, times = self._unit("exp", factor, monomial)
        return self._kernel(Exp(monomial, unit)) ** times

    def _unit(self, kind: str, factor: sp.Rational, monomial: sp.Expr) -> tuple[sp.Rational, int]:
        """g and the whole number factor/g; an argument that was not measured has a g of its own."""
        unit = self.units.get((kind, monomial), sp.S.One)
        if not (factor / unit).is_Integer:
            unit = sp.Rational(1, factor.q)
        return unit, int(factor / unit)

    def _trigonometric(self, node: sp.Expr) -> sp.Expr:
        terms = list(_terms(_argument(node)))
        if len(terms) > _TERMS:
            raise TooLarge(str(node))
        c, s = sp.S.One, sp.S.Zero
        for factor, monomial in terms:
            a, b = self._turn(factor, monomial)
            c, s = c * a - s * b, s * a + c * b
        if isinstance(node, (sp.sin, sp.cos)):
            return s if isinstance(node, sp.sin) else c
        return {sp.tan: s / c, sp.cot: c / s, sp.sec: 1 / c, sp.csc: 1 / s}[type(node)]

    def _turn(self, factor: sp.Rational, monomial: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """The cosine and the sine of factor * monomial."""
        if monomial == sp.pi:
            exact = sp.cos(factor * sp.pi), sp.sin(factor * sp.pi)
            if not any(value.has(*_TRIGONOMETRIC) for value in exact):
                return self.write(exact[0]), self.write(exact[1])
        unit, times = self._unit("turn", factor, monomial)
        T = self._kernel(Half(monomial, unit))
        if abs(times) > _MULTIPLE:
            raise TooLarge(f"{times} times the angle {unit * monomial}")
        a, b = (1 - T**2) / (1 + T**2), 2 * T / (1 + T**2)
        c, s = sp.S.One, sp.S.Zero
        for _ in range(abs(times)):
            c, s = c * a - s * b, s * a + c * b
        return c, s if times >= 0 else -s


class Exp(sp.Function):  # type: ignore[misc]
    """exp(g m), unevaluated."""


class Half(sp.Function):  # type: ignore[misc]
    """tan(g m/2), unevaluated."""


def _kind(node: sp.Basic) -> str:
    """Whether the node is written with exp or with an angle."""
    if isinstance(node, (sp.exp, *_HYPERBOLIC)) or node == sp.E or (node.is_Pow and not node.exp.is_Rational):
        return "exp"
    return "turn" if isinstance(node, _TRIGONOMETRIC) else ""


def _argument(node: sp.Expr) -> sp.Expr:
    if node == sp.E:
        return sp.S.One
    if isinstance(node, sp.exp):
        return _canonical(node.args[0])
    if node.is_Pow:
        return _canonical(node.exp * sp.log(node.base))
    return _canonical(node.args[0])


def _terms(argument: sp.Expr) -> Iterator[tuple[sp.Rational, sp.Expr]]:
    for term in sp.Add.make_args(argument):
        factor, monomial = term.as_coeff_Mul(rational=True)
        if factor:
            yield factor, monomial


def _canonical(argument: sp.Expr) -> sp.Expr:
    """An argument in one form for equal rational functions of its symbols and functions."""
    if argument.is_Atom:
        return argument
    inverse = any(not (node.exp.is_Integer and node.exp > 0) for node in argument.atoms(sp.Pow))
    if inverse and argument.count_ops() <= _OPERATIONS:
        try:
            top, bottom = sp.fraction(sp.cancel(sp.together(argument)))
            return sp.expand(sp.expand(top) / bottom)
        except sp.PolynomialError:  # Piecewise
            return argument
    return sp.expand(argument)
