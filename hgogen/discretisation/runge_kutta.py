"""Explicit Runge-Kutta methods as data: k_i = f(z + h sum_j a_ij k_j, c_i), z+ = z + h sum_i b_i k_i."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from operator import add

from hgogen.graph import Graph

Values = Mapping[str, Graph]


@dataclass(frozen=True)
class Tableau:
    """A Butcher tableau; `a` holds the rows below the diagonal."""

    name: str
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int

    @property
    def equations(self) -> tuple[str, ...]:
        """A line for each stage, and one for the result; a stage reads the input and the samples at its own time."""
        stages = (f"k_{i} = f(z{' + ' * any(row)}{_slopes(row)})" for i, row in enumerate(self.a, 1))
        return (*stages, f"z+ = z + {_slopes(self.b)}")

    @property
    def chained(self) -> bool:
        """Whether there are many stages, and each starts with the slope of the one before it alone: a sum of slopes is
        then all that need be remembered of the others."""
        return len(self.a) > 2 and not any(any(row[:-1]) for row in self.a)

    @property
    def polynomial(self) -> tuple[float, ...]:
        """Coefficients of the stability polynomial R(z) = 1 + sum_k z^(k+1) b' A^k 1, constant first."""
        weights, coefficients = [1.0] * len(self.b), [1.0]
        for _ in self.b:
            coefficients.append(sum(b * w for b, w in zip(self.b, weights, strict=True)))
            weights = [sum(a * w for a, w in zip(row, weights, strict=False)) for row in self.a]
        return tuple(coefficients)


def _slopes(weights: Iterable[float]) -> str:
    """h times a sum of slopes with their weights; "" where every weight is 0."""
    exact = {f"k_{j}": Fraction(weight).limit_denominator(10_000) for j, weight in enumerate(weights, 1) if weight}
    if not exact:
        return ""
    if len(exact) == 1:
        ((name, weight),) = exact.items()
        return f"h {name}" if weight == 1 else f"{weight} h {name}"
    return f"h ({' + '.join(name if weight == 1 else f'{weight} {name}' for name, weight in exact.items())})"


EULER = Tableau("Euler", ((),), (1.0,), (0.0,), 1)
HEUN = Tableau("Heun", ((), (1.0,)), (0.5, 0.5), (0.0, 1.0), 2)
RK4 = Tableau(
    "classical Runge-Kutta",
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
    (0.0, 0.5, 0.5, 1.0),
    4,
)


def repeated(tableau: Tableau, times: int) -> Tableau:
    """`times` equal steps of a method, together one step of it."""
    share = [b / times for b in tableau.b]
    rows = [
        (*share * k, *(a / times for a in row), *[0.0] * (len(share) - len(row)))
        for k in range(times)
        for row in tableau.a
    ]
    return Tableau(
        f"{tableau.name}, {times} steps",
        tuple(row[:i] for i, row in enumerate(rows)),
        tuple(share * times),
        tuple((k + c) / times for k in range(times) for c in tableau.c),
        tableau.order,
    )


@dataclass(frozen=True)
class Stages:
    """One Runge-Kutta step: the new values, and each stage's argument and slope."""

    result: dict[str, Graph]
    arguments: tuple[dict[str, Graph], ...]
    slopes: tuple[dict[str, Graph], ...]

    @property
    def names(self) -> dict[str, Graph]:
        """The slopes by name (`k1_z`, ...), for the C printer."""
        return {f"k{i}_{key}": k[key] for i, k in enumerate(self.slopes, 1) for key in k}


def advance(tableau: Tableau, rate: Callable[[Values, float], Values], start: Values, h: float) -> Stages:
    """One step of length h from `start`; `rate(values, c)` is the slope at the fraction c of the step."""
    arguments: list[dict[str, Graph]] = []
    slopes: list[dict[str, Graph]] = []
    for row, c in zip(tableau.a, tableau.c, strict=True):
        stage = dict(start)
        for a, slope in zip(row, slopes, strict=False):
            if a:
                stage = {key: value + h * a * slope[key] for key, value in stage.items()}
        arguments.append(stage)
        slopes.append(dict(rate(stage, c)))
    result, ratios = {}, _ratios(tableau.b)
    for key, value in start.items():  # z + h b_1 (k_1 + b_2/b_1 k_2 + ..): whole ratios cost no multiplication
        each = zip(ratios, slopes, strict=True)
        total = reduce(add, (slope[key] if ratio == 1 else ratio * slope[key] for ratio, slope in each))
        result[key] = value + h * tableau.b[0] * total
    return Stages(result, tuple(arguments), tuple(slopes))


@dataclass(frozen=True)
class Rounds:
    """The stages of a `chained` tableau as one that is done again and again: its fraction c of the step, what its slope
    weighs in the sum of slopes, which ends by `last`, and how far ahead the next stage lies along its slope."""

    fractions: tuple[float, ...]
    shares: tuple[float, ...]
    ahead: tuple[float, ...]
    last: float


def rounds(tableau: Tableau, h: float) -> Rounds:
    """The rounds of one step of length h: k = f(at, c), sum <- sum + share k, at <- z + ahead k; z+ = z + last sum."""
    ahead = (*(h * row[-1] for row in tableau.a[1:]), 0.0)
    return Rounds(tuple(tableau.c), tuple(_ratios(tableau.b)), ahead, h * tableau.b[0])


def _ratios(b: tuple[float, ...]) -> list[float]:
    return [round(weight / b[0], 12) for weight in b]
