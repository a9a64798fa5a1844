"""The equation of an observer in its own fields, built from the plant of the certificate and its numbers.

    of a gain    z' = A z + b(clamped z + N v, u) + S^-1 theta B v,                v_j = theta^-late (y_j - h_j(z, u))
    of a core    e' = theta (N e + B v + sum over saturations of onto (sat e_j - e_j)) + s_i b_i(clamped z, u)

S is the diagonal of scale and powers of theta, e_k = r_k x_k of a field x_k of a chain of integrators, v = y - o(u). b
stands in the rows of the fields that estimate, of s_i theirs. What b reads is clamped to the ranges; a saturation
clamps a field to the range of the state that it estimates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

from .algebra import Algebra, Quotient
from .box import End
from .context import Context, applied, inner, value_of
from .uncertain import ErrorInclusion

Row = Sequence[Quotient]
_NONE = Fraction(0)


@dataclass(frozen=True)
class Equation:
    """That of an observer at a theta, with the plant's `parameters` as the program has them."""

    context: Context
    error: ErrorInclusion
    theta: Fraction
    parameters: Mapping[str, Fraction]

    @cached_property
    def scales(self) -> list[Fraction]:
        """By field (N), its error e_k where that of its state of the form is 1. Raises: `NotShown`."""
        return self.error.scales(self.context, self.theta)

    @cached_property
    def units(self) -> list[Fraction]:
        """r (N), the error e_k where that of the field is 1. Raises: `NotShown`."""
        if not self.error.units:
            return self.scales
        own = self.error.units
        return [own[i] / self.theta**p for i, p in zip(self.error.index, self.error.power, strict=True)]

    def rates(self, algebra: Algebra, x: Row, y: Row, u: Row) -> list[Quotient]:
        """x' (N) of fields x (N), samples y (p) and inputs u (m). Raises: `NotShown`, `Undefined`, `TooLarge`."""
        context, error, number = self.context, self.error, algebra.number
        names = {name: number(value) for name, value in self.parameters.items()}
        names |= zip(context.file.inputs, u, strict=True)
        rates, reads = (self._of_core if error.units else self._of_gain)(algebra, names, x, y)
        clamped = {z: _clamp(algebra, each, *context.form.box[z]) for z, each in zip(context.z, reads, strict=True)}
        b = [value_of(row, {**names, **clamped}, algebra) for row in context.form.b]
        each = zip(rates, self.scales, self.units, error.fed, error.index, strict=True)
        return [rate + number(fed * s / r) * b[i] for rate, s, r, fed, i in each]

    def _of_gain(self, algebra: Algebra, names: Mapping[str, Quotient], z: Row, y: Row) -> tuple[Row, Row]:
        """z' but for b, and what b reads."""
        form, there = self.context.form, {**names, **dict(zip(self.context.z, z, strict=True))}
        v = self._missed(algebra, there, y)
        A = [[value_of(entry, names, algebra) for entry in row] for row in form.A]
        injected, taken = (applied(algebra, M, v) for M in (self.error.measured, self.error.takes))
        each = zip(A, injected, self.scales, strict=True)
        rates = [inner(algebra, row, z) + algebra.number(self.theta / s) * more for row, more, s in each]
        return rates, [a + algebra.number(1 / s) * b for a, b, s in zip(z, taken, self.scales, strict=True)]

    def _of_core(self, algebra: Algebra, names: Mapping[str, Quotient], x: Row, y: Row) -> tuple[Row, Row]:
        """x' but for b, and what b reads."""
        error, number, nothing = self.error, algebra.number, dict.fromkeys(self.context.z, algebra.number(_NONE))
        e = [number(r) * each for r, each in zip(self.units, x, strict=True)]
        v = self._missed(algebra, {**names, **nothing}, y)
        rates = [a + b for a, b in zip(applied(algebra, error.N, e), applied(algebra, error.measured, v), strict=True)]
        for of, onto in self._saturations:
            taken = number(self.units[of]) * (x[of] - self._saturated(algebra, x[of], of))
            rates = [rate + number(share) * taken for rate, share in zip(rates, onto, strict=True)]
        reads = [number(1 / self.scales[k]) * e[k] for k in error.picks]
        return [number(self.theta / r) * rate for rate, r in zip(rates, self.units, strict=True)], reads

    def _missed(self, algebra: Algebra, there: Mapping[str, Quotient], y: Row) -> list[Quotient]:
        """theta^-late (y - h) (p), 0 of an output that shows no state."""
        nothing, context = algebra.number(_NONE), self.context
        each = zip(y, context.form.output, context.seen, self.error.late, strict=True)
        return [
            algebra.number(self.theta**-late) * (sample - value_of(row, there, algebra)) if z else nothing
            for sample, row, z, late in each
        ]

    @property
    def _saturations(self) -> list[tuple[int, list[Fraction]]]:
        """Of each the field that it passes on, and the column by which what it takes away enters."""
        return [(slope.reads.index(Fraction(1)), slope.onto) for slope in self.error.slopes if slope.degree == -1]

    def _saturated(self, algebra: Algebra, x: Quotient, k: int) -> Quotient:
        """Field k clamped to the range of its state."""
        share, box = self.scales[k] / self.units[k], self.context.form.box[self.context.z[self.error.index[k]]]
        low, high = (end * share if isinstance(end, Fraction) else end for end in box)
        return _clamp(algebra, x, *((low, high) if share > 0 else (high, low)))


def _clamp(algebra: Algebra, x: Quotient, low: End, high: End) -> Quotient:
    """min(max(x, low), high), of ends that are numbers."""
    for name, end in (("Max", low), ("Min", high)):
        x = algebra.function(name, (x, algebra.number(end))) if isinstance(end, Fraction) else x
    return x
