"""Exact identities of quotients of polynomials with rational coefficients; the letters are names and function values.

A quotient is zero if its numerator is zero after the relations t^q = g for t = g^(1/q), cos^2 = 1 - sin^2, cosh^2 = 1 +
sinh^2. exp of a sum becomes a product. A quotient proved zero is zero wherever it is defined, and its denominator does
not vanish by these relations. A quotient that is not proved zero may still be zero.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, reduce
from typing import Any

from .arithmetic import Arithmetic, Undefined, along, evaluate
from .text import Expression

MOST_TERMS = 20_000
_LONGEST = 20_000  # bits of a coefficient

Monomial = tuple[tuple[int, int], ...]  # (letter, exponent > 0), letters rising
Polynomial = Mapping[Monomial, Fraction]


class TooLarge(Exception):  # the claim it belongs to is then not verified
    """The error that an identity is beyond the size limits of the algebra."""


def _plus(a: Polynomial, b: Polynomial) -> Polynomial:
    sums = {monomial: a.get(monomial, 0) + coefficient for monomial, coefficient in b.items()}
    return _sized({monomial: value for monomial, value in {**a, **sums}.items() if value})


def _times(a: Polynomial, b: Polynomial) -> Polynomial:
    if len(a) * len(b) > 20 * MOST_TERMS:
        raise TooLarge
    result: dict[Monomial, Fraction] = {}
    for left, p in a.items():
        for right, q in b.items():
            monomial = _product(left, right)
            result[monomial] = result.get(monomial, Fraction(0)) + p * q
    return _sized({monomial: value for monomial, value in result.items() if value})


def _sized(a: dict[Monomial, Fraction]) -> Polynomial:
    if len(a) > MOST_TERMS or any(
        max(value.numerator.bit_length(), value.denominator.bit_length()) > _LONGEST for value in a.values()
    ):
        raise TooLarge
    return a


def _product(a: Monomial, b: Monomial) -> Monomial:
    powers = dict(a)
    for letter, exponent in b:
        powers[letter] = powers.get(letter, 0) + exponent
    return tuple(sorted(powers.items()))


def _constant(value: Fraction | int) -> Polynomial:
    return {(): Fraction(value)} if value else {}


_ONE = _constant(1)


@dataclass(frozen=True)
class Quotient:
    """A quotient of polynomials with rational coefficients: the numerator `top`, and `bottom`, the factors of the
    denominator with their powers."""

    top: Polynomial
    bottom: tuple[tuple[Polynomial, int], ...] = ()

    def __add__(self, other: "Quotient") -> "Quotient":
        if self.bottom == other.bottom:
            return Quotient(_plus(self.top, other.top), self.bottom)
        factors = _merged(self.bottom, other.bottom, max)
        left, right = (_times(one.top, _expanded(_missing(factors, one.bottom))) for one in (self, other))
        return Quotient(_plus(left, right), factors)

    def __neg__(self) -> "Quotient":
        return Quotient({monomial: -value for monomial, value in self.top.items()}, self.bottom)

    def __sub__(self, other: "Quotient") -> "Quotient":
        return self + -other

    def __mul__(self, other: "Quotient") -> "Quotient":
        return Quotient(_times(self.top, other.top), _merged(self.bottom, other.bottom, lambda a, b: a + b))

    def __truediv__(self, other: "Quotient") -> "Quotient":
        if not other.top:
            raise Undefined("division by zero")
        inverse = Quotient(_expanded(other.bottom), ((other.top, 1),))
        if len(other.top) == 1 and () in other.top:  # a number
            inverse = Quotient({m: c / other.top[()] for m, c in _expanded(other.bottom).items()})
        return self * inverse

    def __bool__(self) -> bool:
        """Return False if the numerator has no term, so that the quotient is 0 as written."""
        return bool(self.top)

    @property
    def number(self) -> Fraction | None:
        """The value of the quotient if it is written as a rational number, else None."""
        if self.bottom or any(self.top.keys() - {()}):
            return None
        return self.top.get((), Fraction(0))


Factors = tuple[tuple[Polynomial, int], ...]


def _merged(a: Factors, b: Factors, join: Any) -> Factors:
    result = list(a)
    for factor, power in b:
        at = next((k for k, (known, _) in enumerate(result) if known == factor), None)
        if at is None:
            result.append((factor, power))
        else:
            result[at] = (factor, join(result[at][1], power))
    return tuple(result)


def _missing(whole: Factors, part: Factors) -> Factors:
    present = [next((power for known, power in part if known == factor), 0) for factor, _ in whole]
    pairs = zip(whole, present, strict=True)
    return tuple((factor, power - present_power) for (factor, power), present_power in pairs if power > present_power)


def _expanded(factors: Factors) -> Polynomial:
    return reduce(_times, (factor for factor, power in factors for _ in range(power)), _ONE)


def _as_product(x: Quotient) -> tuple[Fraction, dict[int, int]] | None:
    value, powers = Fraction(1), dict[int, int]()
    for factor, times in ((x.top, 1), *((factor, -power) for factor, power in x.bottom)):
        if len(factor) != 1:
            return None
        ((monomial, coefficient),) = factor.items()
        value *= coefficient**times
        for letter, exponent in monomial:
            powers[letter] = powers.get(letter, 0) + times * exponent
    return value, {letter: exponent for letter, exponent in powers.items() if exponent}


@dataclass(frozen=True)
class _Kernel:
    name: str
    args: tuple[Quotient, ...]
    degree: int = 0  # q of a root


class Algebra:
    """Quotients of polynomials in letters: first the given names, then function values in the order of their use, whose
    arguments are quotients in earlier letters.

    `nonnegative`: names whose range is not negative, so that sqrt(x^2) = x is known; `names`: the value of each name,
    its letter or, for a `fixed` name, its number.
    """

    def __init__(
        self, names: Iterable[str], nonnegative: Iterable[str] = (), fixed: Mapping[str, Fraction] | None = None
    ) -> None:
        self.letters: list[str | _Kernel] = list(names)
        self.nonnegative = frozenset(nonnegative)
        self.arithmetic = Arithmetic(self.number, self.power, self.root, self.function, self._no_hull)
        self.names = {str(name): self._at(k) for k, name in enumerate(self.letters)}
        self.names |= {name: self.number(value) for name, value in (fixed or {}).items()}
        self.zero, self.one = self.number(Fraction(0)), self.number(Fraction(1))

    def read(self, text: Expression, values: Mapping[str, Quotient] | None = None) -> Quotient:
        """Return the quotient of an expression with these `values` of its names, by default their letters. Raises:
        `Undefined`, `TooLarge`."""
        value: Quotient = evaluate(text, self.names if values is None else values, self.arithmetic)
        return value

    def speed(
        self, text: Expression, speeds: Mapping[str, Quotient], values: Mapping[str, Quotient] | None = None
    ) -> Quotient:
        """Return the time derivative of an expression from the derivatives `speeds` of its names; a missing one is 0.
        `values`: of its names, by default their letters. Raises: `Undefined`, `TooLarge`."""
        speed: Quotient = along(text, self.names if values is None else values, speeds, self.arithmetic)[1]
        return speed

    def number(self, value: Fraction) -> Quotient:
        """Return a rational number as a quotient."""
        return Quotient(_constant(value))

    def _at(self, index: int) -> Quotient:
        return Quotient({((index, 1),): Fraction(1)})

    def _no_hull(self, way: Quotient, a: Quotient, b: Quotient) -> Quotient:
        raise Undefined("Min and Max have no slope in closed form")

    def power(self, x: Quotient, exponent: int) -> Quotient:
        """Return x^exponent for an integer exponent. Raises: `TooLarge`."""
        if exponent < 0:
            return self.one / self.power(x, -exponent)
        if len(x.top) > 1 and exponent > 64:
            raise TooLarge
        result, square = self.one, x
        while exponent:
            if exponent % 2:
                result = result * square
            exponent //= 2
            square = square * square if exponent else square
        return result

    def root(self, x: Quotient, exponent: Fraction) -> Quotient:
        """Return x^(p/q), `exponent` = p/q, as the power t^p of the letter t = x^(1/q)."""
        p, q = exponent.numerator, exponent.denominator
        if self.is_zero(x):  # as a letter t, 1/t would have a value
            return self.power(self.zero, p)
        known = self._known_root(x, q)
        return self.power(known or self._kernel(_Kernel("root", (x,), q)), p)

    def _known_root(self, x: Quotient, q: int) -> Quotient | None:
        product = _as_product(x)
        if product is None:
            return None
        value, powers = product
        if any(exponent % q or not self._not_negative(letter) for letter, exponent in powers.items()) or value <= 0:
            return None
        parts = ((letter, exponent // q) for letter, exponent in powers.items())
        letters = (self.power(self._at(letter), exponent) for letter, exponent in parts)
        return reduce(lambda a, b: a * b, letters, self._number_root(value, q))

    def _number_root(self, value: Fraction, q: int) -> Quotient:
        if value < 2**40:
            root = [round(part ** (1 / q)) for part in (value.numerator, value.denominator)]
            if root[1] and Fraction(*root) ** q == value:
                return self.number(Fraction(*root))
        return self._kernel(_Kernel("root", (self.number(value),), q))

    def _magnitude(self, x: Quotient) -> Quotient | None:
        product = _as_product(x)
        if product is None:
            return None
        value, powers = product
        if any(exponent % 2 and not self._not_negative(letter) for letter, exponent in powers.items()):
            return None
        return -x if value < 0 else x

    def _not_negative(self, letter: int) -> bool:
        kind = self.letters[letter]
        if isinstance(kind, str):
            return kind in self.nonnegative
        return kind.name in ("root", "exp", "Abs", "cosh")

    def function(self, name: str, args: tuple[Quotient, ...]) -> Quotient:
        """Return the value of a function as a letter; tan x as sin x/cos x, exp of a sum as a product. Raises:
        `Undefined`."""
        if name == "jump":
            raise Undefined("a side has no slope in closed form")
        name = "sign" if name == "side" else name
        if name == "tan":
            return self.function("sin", args) / self.function("cos", args)
        if name == "exp":
            return self._exp(args[0])
        if not args:
            return self._kernel(_Kernel(name, ()))
        known = [each.number for each in args if each.number is not None]
        if name in _EXTREME and len(known) == len(args):
            return self.number(_EXTREME[name](known))
        if (name, args[0].number) in _KNOWN:
            return self.number(Fraction(_KNOWN[name, args[0].number]))
        if name == "Abs" and (magnitude := self._magnitude(args[0])) is not None:
            return magnitude
        mirrored = self._find(_Kernel(name, (-args[0],))) if name in (*_ODD, *_EVEN) else None
        if mirrored is not None:
            return self._at(mirrored) if name in _EVEN else -self._at(mirrored)
        return self._kernel(_Kernel(name, args))

    def _exp(self, x: Quotient) -> Quotient:
        """Return exp(sum of c m) over monomials m as the product of powers exp(m/k)^(c k), c k an integer."""
        if x.bottom:
            mirrored = self._find(_Kernel("exp", (-x,)))
            return self._kernel(_Kernel("exp", (x,))) if mirrored is None else self.one / self._at(mirrored)
        result = self.one
        for monomial, value in sorted(x.top.items()):
            unit = Quotient({monomial: Fraction(1, value.denominator)})
            if abs(value.numerator) > 64:
                unit, value = Quotient({monomial: abs(value)}), Fraction(1 if value > 0 else -1)
            result = result * self.power(self._kernel(_Kernel("exp", (unit,))), value.numerator)
        return result

    def _kernel(self, kernel: _Kernel) -> Quotient:
        if not all(map(self._has_value, kernel.args)):
            raise Undefined("division by zero")
        letter = self._find(kernel)
        if letter is None:
            self.letters.append(kernel)
            letter = len(self.letters) - 1
        return self._at(letter)

    def _find(self, kernel: _Kernel) -> int | None:
        for index, known in enumerate(self.letters):
            if (
                isinstance(known, _Kernel)
                and (known.name, known.degree, len(known.args)) == (kernel.name, kernel.degree, len(kernel.args))
                and all(self.is_zero(a - b) for a, b in zip(known.args, kernel.args, strict=True))
            ):
                return index
        return None

    def value(self, x: Quotient, letters: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
        """Return the value of a quotient in another arithmetic; `letters`: the value of each name there. Raises:
        `Undefined`."""

        @cache
        def letter_value(letter: int) -> Any:
            kind = self.letters[letter]
            if isinstance(kind, str):
                return letters[kind]
            args = tuple(map(quotient, kind.args))
            if kind.degree:
                return arithmetic.root(args[0], Fraction(1, kind.degree))
            return arithmetic.function(kind.name, args)

        def polynomial(terms: Polynomial) -> Any:
            total = arithmetic.number(Fraction(0))
            for monomial, coefficient in terms.items():
                powers = (arithmetic.power(letter_value(letter), exponent) for letter, exponent in monomial)
                total = total + reduce(lambda a, b: a * b, powers, arithmetic.number(coefficient))
            return total

        def quotient(x: Quotient) -> Any:
            factors = (arithmetic.power(polynomial(factor), power) for factor, power in x.bottom)
            return reduce(lambda a, b: a / b, factors, polynomial(x.top))

        return quotient(x)

    def is_zero(self, x: Quotient) -> bool:
        """Return whether x is proved to be zero wherever it is defined, with a denominator that is not the zero
        polynomial."""
        return self._vanishes(x.top) and self._has_value(x)

    def _has_value(self, x: Quotient) -> bool:
        return not any(self._vanishes(factor) for factor, _ in x.bottom)

    def _vanishes(self, top: Polynomial) -> bool:
        """Return whether a numerator is 0 after substituting t^q = g for each root t, cos^2 = 1 - sin^2 and cosh^2 = 1
        + sinh^2."""
        while top:
            relation = self._reducible(top)
            if relation is None:
                return False
            top = self._reduced(top, *relation)
        return True

    def _reducible(self, top: Polynomial) -> tuple[int, int, Quotient] | None:
        best: tuple[int, int, Quotient] | None = None
        for monomial in top:
            for letter, exponent in monomial:
                if best is not None and letter <= best[0]:
                    continue
                rule = self._relation(letter)
                if rule is not None and exponent >= rule[0]:
                    best = (letter, *rule)
        return best

    def _relation(self, letter: int) -> tuple[int, Quotient] | None:
        kernel = self.letters[letter]
        if isinstance(kernel, str):
            return None
        if kernel.name == "root":
            return kernel.degree, kernel.args[0]
        if kernel.name in ("cos", "cosh"):
            other = self.function("sin" if kernel.name == "cos" else "sinh", kernel.args)
            square = other * other
            return 2, self.one + (-square if kernel.name == "cos" else square)
        return None

    def _reduced(self, top: Polynomial, letter: int, degree: int, value: Quotient) -> Polynomial:
        """Return a numerator with t^q replaced by g, t the `letter`, q the `degree`, g the `value`, and multiplied by
        the denominators of g, which has no effect on whether it is zero."""
        parts: dict[int, dict[Monomial, Fraction]] = {}
        for monomial, coefficient in top.items():
            powers = dict(monomial)
            times, remainder = divmod(powers.pop(letter, 0), degree)
            if remainder:
                powers[letter] = remainder
            parts.setdefault(times, {})[tuple(sorted(powers.items()))] = coefficient
        terms = (Quotient(part) * self.power(value, times) for times, part in sorted(parts.items()))
        return reduce(lambda a, b: a + b, terms).top


_EXTREME: Mapping[str, Callable[[Iterable[Fraction]], Fraction]] = {"Min": min, "Max": max}
_ODD = frozenset(("sin", "sinh", "tanh", "asin", "asinh", "atan", "atanh"))
_EVEN = frozenset(("cos", "cosh", "Abs"))
_KNOWN: Mapping[tuple[str, Fraction | None], int] = {
    **{(name, Fraction(0)): 0 for name in _ODD},
    **{(name, Fraction(0)): 1 for name in ("cos", "cosh")},
    ("log", Fraction(1)): 0,
}
