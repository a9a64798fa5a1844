"""The observability of a plant's states and unknown parameters, the symmetries that hide some, and the missing outputs.

Observability is local: a state nearby gives another output, a far one may not, as -x where y = x**2. Answers are
generic: they hold at almost every state, parameter value and input. Full rank at one point proves full rank almost
everywhere. A deficiency is proved by a symmetry, a vector field that changes no output. Without a symmetry it could be
an accident of the random points, and nothing is concluded from it.

A plant with kinks, jumps or tables has an answer on each branch that its declared ranges reach (`rigor.rank`), as long
as it stays there. One branch may hide a state that another does not: a shaft in its backlash hides the load. So a
branch that the plant may leave refutes nothing, unless a symmetry is that of all branches and changes no condition.

Of a discrete plant, x+ = f(x, u), the rank is that of y at samples 0, 1, .., one less than there are unknowns, the
inputs at different samples free of each other.

A state is hidden by a vector field along which every output and all its derivatives are constant.

    v(x, p) = sum_j c_ij m_j(x, p),   O(x, p) v(x, p) = 0 at random points   ->   the coefficients c, by linear algebra
    exact proof:  L_v h = 0  and  [f, v] = 0 or along v   =>   L_v (L_f^k h) = 0 for every k
    x+ = f(x):    L_v h = 0  and  (df/dx) v = v(f), or along v(f)   =>   L_v (h o f^k) = 0 for every k

The coefficients are found modulo a prime, or with balls, and converted to small fractions; then SymPy proves the two
conditions where it can. A scaling is printed as x -> c x, a translation as x -> x + c.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import combinations_with_replacement
from math import lcm, prod
from typing import Annotated, Any, ClassVar

import flint
import sympy as sp

from hgogen.analysis.undefined import on_branches
from hgogen.check import Check, ClaimId, Verdict
from hgogen.reading.given import BadGain, cached, requires_any_plant, signals_named
from hgogen.rigor.bounds import enclose
from hgogen.rigor.box import exact
from hgogen.rigor.factors import factors
from hgogen.rigor.invariant import divided, rate
from hgogen.rigor.rank import (
    FEW_BITS,
    Branch,
    Model,
    NowhereDefined,
    Place,
    Rank,
    Ranks,
    SampledBranches,
    TooImprecise,
    at_random_point,
    exact_numbers,
    independent_rows,
    matrix_rows,
    modulus,
    nullspace_basis,
)
from hgogen.rigor.rank import observability as ranks
from hgogen.rigor.series import Arithmetic, Plant, Point, Undecided, first_gradients
from hgogen.sentence import NONE, Encoded, Reason, because, joined
from hgogen.system import System

TERMS = 400  # of the vector field in the search
OPERATIONS = 4000  # of the model, beyond which the exact proof is left out
_LARGEST = 1000  # numerator and denominator of a coefficient
_SPARE = 4  # equations more than coefficients


@dataclass(frozen=True)
class Symmetry:
    """A symmetry that hides unknowns: a vector field v on states and parameters along which no output changes. `field`:
    the nonzero components of v, by unknown; `proved`: whether this is proved exactly, by SymPy; otherwise it holds at
    every random point that was tried."""

    json_keys: ClassVar[None] = None

    field: tuple[tuple[sp.Symbol, sp.Expr], ...]
    proved: bool

    def __str__(self) -> str:
        how = "" if self.proved else " (at random points)"
        direction = ", ".join(f"{s}: {v}" for s, v in self.field)
        return (_scaling(self.field) or _translation(self.field) or f"along d/ds ({direction})") + how


@dataclass(frozen=True)
class _Sample:
    """The `values` of states and parameters at a random point, and the independent `rows`
    of the observability matrix; `prime`: the modulus of these numbers, 0 for reals."""

    values: tuple[Any, ...]
    rows: tuple[tuple[Any, ...], ...]
    prime: int


def symmetries(model: Model, hidden: Sequence[sp.Symbol], order: int) -> tuple[Symmetry, ...]:
    """Return independent symmetries of a model that change the `hidden` unknowns: vector fields v with polynomial
    components of degree 1, or else 2, along which no output changes; for a model with constraints, where these are 0.

    `order`: the order of the outputs' derivatives (of a discrete model, the sample) at which the observability matrix
    attains its rank. There may be fewer symmetries than the deficiency of the rank, where the search has no further
    result.
    """
    plant, unknowns = model.plant, model.unknowns
    first = _sample(plant, order, 0)
    missing = len(unknowns) - len(first.rows)
    samples = [first]
    best: list[list[sp.Expr]] = []
    for terms in _ladder(unknowns, hidden):
        if len(terms) > TERMS or not first.rows:
            break
        samples = _enough(plant, order, samples, len(hidden), len(terms))
        independent = _independent(_fields(samples, terms, unknowns), unknowns, first)
        best = independent if len(independent) > len(best) else best
        if len(best) >= missing:
            break
    return tuple(_symmetry(unknowns, field, proof) for field, proof in zip(best, _proved(best, model), strict=True))


def _symmetry(unknowns: Sequence[sp.Symbol], field: Sequence[sp.Expr], proved: bool) -> Symmetry:
    return Symmetry(tuple((s, v) for s, v in zip(unknowns, field, strict=True) if v != 0), proved)


def _ladder(unknowns: Sequence[sp.Symbol], hidden: Sequence[sp.Symbol]) -> Iterable[list[tuple[int, tuple[int, ...]]]]:
    at = [unknowns.index(s) for s in hidden]
    yield [(i, m) for i in at for m in ((), (i,))]
    every = range(len(unknowns))
    for degree in (1, 2):
        yield [(i, m) for i in at for d in range(degree + 1) for m in combinations_with_replacement(every, d)]


def _enough(plant: Plant, order: int, samples: list[_Sample], hidden: int, terms: int) -> list[_Sample]:
    """Return samples of the observability matrix, all modulo one prime, with more equations than
    `terms` unknown coefficients. Only the `hidden` unobservable unknowns give equations."""
    samples = list(samples)
    each = max(len(samples[0].rows) - (plant.wide - hidden), 1)
    k = len(samples)
    while each * len(samples) < terms + _SPARE:
        sample = _sample(plant, order, k)
        k += 1
        if sample.prime == samples[0].prime:
            samples.append(sample)
    return samples


def _sample(plant: Plant, order: int, k: int) -> _Sample:
    def answer(numbers: Arithmetic, point: Point) -> _Sample:
        prime = modulus(numbers)
        rows = [row for y in first_gradients(plant, numbers, point, order + 1) for row in matrix_rows(y)]
        independent = tuple(tuple(rows[i]) for i in independent_rows(rows, prime))
        return _Sample((*point.states, *point.constants[: plant.q]), independent, prime)

    return at_random_point(plant, answer, first=k)


def _fields(
    samples: Sequence[_Sample], terms: Sequence[tuple[int, tuple[int, ...]]], unknowns: Sequence[sp.Symbol]
) -> list[list[sp.Expr]]:
    """Return a basis of the vector fields v, sums of `terms`, with row . v = 0 for
    all rows of all samples: symmetries that leave the outputs unchanged."""
    prime = samples[0].prime
    with flint.ctx.workprec(FEW_BITS):
        equations = [
            [row[i] * prod((sample.values[j] for j in m), start=row[i] * 0 + 1) for i, m in terms]
            for sample in samples
            for row in sample.rows
        ]
        try:
            basis = nullspace_basis(equations, len(terms), prime)
        except TooImprecise:
            return []
        vectors = [_fractions(vector, prime) for vector in basis]
    fields = []
    for vector in vectors:
        if vector is None:
            continue
        field = [sp.S.Zero] * len(unknowns)
        scale = lcm(*(c.denominator for c in vector))
        for (i, m), c in zip(terms, vector, strict=True):
            field[i] += sp.Integer(int(c * scale)) * prod((unknowns[j] for j in m), start=sp.S.One)
        fields.append(field)
    return fields


def _fractions(vector: Sequence[Any], prime: int) -> list[Fraction] | None:
    """Return a vector modulo a prime (0: real) as small
    fractions, its first nonzero entry scaled to 1; or None."""
    lead = next((c for c in vector if c != 0), None)
    if lead is None:
        return None
    fractions = [
        _residue(int(c) * pow(int(lead), -1, prime) % prime, prime) if prime else _number(c / lead) for c in vector
    ]
    return None if None in fractions else [c for c in fractions if c is not None]


def _residue(a: int, prime: int) -> Fraction | None:
    """Return the small fraction that equals `a` modulo the prime, by the extended Euclidean algorithm."""
    (r, s), (b, t) = (prime, 0), (a, 1)
    while b > _LARGEST:
        (r, s), (b, t) = (b, t), (r - r // b * b, s - r // b * t)
    return Fraction(b, t) if 0 < abs(t) <= _LARGEST else None


def _number(a: Any) -> Fraction | None:
    fraction = Fraction(float(flint.arb(a).mid())).limit_denominator(_LARGEST)
    close = (flint.arb(a) - flint.arb(flint.fmpq(fraction.numerator, fraction.denominator))).contains(0)
    return fraction if close and abs(fraction) <= _LARGEST else None


def _independent(
    fields: Sequence[Sequence[sp.Expr]], unknowns: Sequence[sp.Symbol], sample: _Sample
) -> list[list[sp.Expr]]:
    """Return the simplest fields that are independent at a sample's point."""
    ordered = sorted(fields, key=lambda field: (sum(v != 0 for v in field), sum(v.count_ops() for v in field)))

    def value(component: sp.Expr) -> Any:
        terms = sp.Poly(component, *unknowns).terms()
        factors = ((v**k for v, k in zip(sample.values, powers, strict=True)) for powers, _ in terms)
        return sum((int(c) * prod(part) for (_, c), part in zip(terms, factors, strict=True)), 0 * sample.values[0])

    with flint.ctx.workprec(FEW_BITS):
        return [
            list(ordered[i]) for i in independent_rows([list(map(value, field)) for field in ordered], sample.prime)
        ]


def _proved(fields: Sequence[Sequence[sp.Expr]], model: Model) -> list[bool]:
    """Return for each vector field v whether L_v h = 0 and [f, v] in the span of such fields are proved where the
    constraints of the model are 0, f its rates, h its outputs: moving the unknowns along v then changes no output. Of a
    map f, (df/dx) v in the span of such fields at f(x) in place of [f, v]."""
    unknowns, discrete, constraints = model.unknowns, model.discrete, model.constraints
    rates = (*model.flow, *(model.parameters if discrete else (sp.S.Zero for _ in model.parameters)))
    output = (*model.output, *constraints)
    if sum(e.count_ops() for e in (*rates, *output)) > OPERATIONS:
        return [False] * len(fields)

    def along(h: sp.Expr, direction: Sequence[sp.Expr]) -> sp.Expr:
        return sum((h.diff(s) * v for s, v in zip(unknowns, direction, strict=True) if v != 0), sp.S.Zero)

    after = dict(zip(unknowns, rates, strict=True))

    def commutator(field: Sequence[sp.Expr]) -> list[sp.Expr]:
        if discrete:
            return [_together(along(f, field)) for f in rates]
        rows = (along(v, rates) - along(f, field) for v, f in zip(field, rates, strict=True))
        return [sp.S.Zero if vanishes(e) else _together(e) for e in rows]

    def vanishes(e: sp.Expr) -> bool:
        return _vanishes(e) or bool(constraints and divided(e, constraints).remainder == 0)

    def there(field: Sequence[sp.Expr]) -> Sequence[sp.Expr]:
        return [_together(v.xreplace(after)) for v in field] if discrete else field

    def spanned(bracket: Sequence[sp.Expr], family: Sequence[Sequence[sp.Expr]]) -> bool:
        """Return whether the Lie bracket is a combination of independent
        fields with functions as coefficients, exactly."""
        known = [there(field) for field in family]
        return _rank([*known, bracket]) == (_rank(known) if discrete else len(family))

    invisible = [all(vanishes(along(h, field)) for h in output) for field in fields]
    brackets = [commutator(field) if ok else [] for field, ok in zip(fields, invisible, strict=True)]
    return _mapped_into_itself(fields, brackets, invisible, spanned)


def _mapped_into_itself(
    fields: Sequence[Sequence[sp.Expr]],
    brackets: Sequence[Sequence[sp.Expr]],
    family: Sequence[bool],
    spanned: Callable[[Sequence[sp.Expr], Sequence[Sequence[sp.Expr]]], bool],
) -> list[bool]:
    """Return the largest part of a family of fields, each in it or not, whose brackets are `spanned` by that part."""
    closed = list(family)
    while True:
        members = [field for field, ok in zip(fields, closed, strict=True) if ok]
        remaining = [ok and spanned(bracket, members) for bracket, ok in zip(brackets, closed, strict=True)]
        if remaining == closed:
            return remaining
        closed = remaining


def _rank(rows: Sequence[Sequence[sp.Expr]]) -> int:
    return int(sp.Matrix(rows).rank(iszerofunc=_vanishes, simplify=_together))


def _together(e: sp.Expr) -> sp.Expr:
    return sp.S.Zero if _vanishes(e) else sp.cancel(e) if e.is_rational_function() else e


def _vanishes(e: sp.Expr) -> bool:
    if e == 0:
        return True
    e = exact(e)
    if sp.expand(sp.fraction(sp.together(e))[0]) == 0:
        return True
    return not e.is_rational_function() and sp.simplify(e) == 0


def _letter(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> sp.Symbol:
    used = {s.name for x, v in field for s in {x, *v.free_symbols}}
    return sp.Symbol(next(name for name in ("c", "s", "r", *(f"c{k}" for k in range(len(used)))) if name not in used))


def _scaling(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> str:
    """Return the scaling that a vector field generates, such
    as "x -> c x, k -> k/c" or "z -> z + log(c)", or ""."""
    powers = {s: v / s for s, v in field if not v.is_Rational}
    if not powers or not all(power.is_Rational for power in powers.values()):
        return ""
    c = _letter(field)
    whole = lcm(*(int(p.q) for p in powers.values()))
    terms = []
    for s, v in field:
        if s not in powers:
            terms.append(f"{s} -> {s + v * whole * sp.log(c)}")
            continue
        power = int(powers[s] * whole)
        factor = f"{c}" if abs(power) == 1 else f"{c}^{abs(power)}"
        terms.append(f"{s} -> {factor} {s}" if power > 0 else f"{s} -> {s}/{factor}")
    return ", ".join(terms)


def _translation(field: Sequence[tuple[sp.Symbol, sp.Expr]]) -> str:
    """Return the translation "x -> x + c v" along a vector
    field v that is free of the moved unknowns, or ""."""
    changed = {s for s, _ in field}
    if any(v.free_symbols & changed for _, v in field):
        return ""
    c = _letter(field)
    shifts = ((s, v if v.is_Number else sp.factor(v)) for s, v in field)
    return ", ".join(f"{s} -> {s + c * v}" for s, v in shifts)


# ---------------------------------------------------------------- observability


_PROVED_BRANCHES = 8  # with a search for symmetries, which may take a second each
_PARTS = 8  # places on constraints, where ranks may differ
_CONDITIONS, _BRANCHES = 4, 3  # conditions of a branch, and branches, in a sentence


@dataclass(frozen=True)
class Answer(Encoded):
    """The observability of the unknowns, states alone or states with unknown parameters, on one branch of the plant.

    A symmetry is a change of the unknowns that leaves all outputs unchanged. `orders`: the order of derivatives of the
    outputs from which each observable unknown is observable; `direction`: where there are fewer symmetries than the
    deficiency of the rank, an unobservable direction at a random point, `point`; `discrete`: orders count samples, not
    derivatives. `passing`: whether the plant may leave the branch, so that the rank on the branch decides nothing,
    because elsewhere more or less may be observable. `lost`: the unknowns that are proved to be unobservable, by one
    symmetry of all branches that leaves the conditions of the branches unchanged. `later`: the states of a discrete
    plant that are not observable at sample 0 but known later, since the map takes all states with the same outputs to
    the same next state.
    """

    json_keys = (
        "rank=rank.rank dimension=rank.dimension order=rank.order observable=rank.observable "
        "unobservable=rank.unobservable proved_unobservable=hidden symmetries repairs where elsewhere"
    )

    rank: Rank
    orders: tuple[tuple[sp.Symbol, int], ...] = ()
    symmetries: Annotated[tuple[Symmetry, ...], "what hides the unobservable unknowns"] = ()
    direction: tuple[tuple[sp.Symbol, float], ...] = ()
    point: tuple[tuple[sp.Symbol, float], ...] = ()
    repairs: Annotated[tuple[sp.Symbol, ...], "each unknown whose measurement alone would make all observable"] = ()
    hidden: Annotated[tuple[sp.Symbol, ...], "the unknowns that are proved to be unobservable"] = ()
    where: Annotated[tuple[sp.Basic, ...], "the conditions of the branch, none of a plant without branches"] = ()
    elsewhere: Annotated[tuple["Answer", ...], "the answers on other branches that hide something"] = ()
    discrete: bool = False
    passing: bool = False
    lost: tuple[sp.Symbol, ...] = ()
    later: tuple[sp.Symbol, ...] = ()

    @property
    def counted(self) -> str:
        """The rank as a sentence."""
        rank = self.rank
        if not rank.final:
            return "the rank is not decided"
        samples = "by the outputs up to sample {}, the first is 0"
        by = samples if self.discrete else "by derivatives of the outputs up to order {}"
        return f"rank {rank.rank} of {rank.dimension}, {by.format(rank.order)}"

    @property
    def verdict(self) -> Verdict:
        """The verdict of the claim that all unknowns of the question are observable on this branch."""
        if self.passing:
            return Verdict.UNKNOWN
        if not self.rank.unobservable:
            return Verdict.GENERIC
        return Verdict.REFUTED if self.hidden else Verdict.UNKNOWN

    @property
    def doubtful(self) -> tuple[sp.Symbol, ...]:
        """The unknowns that are neither observable nor proved to be unobservable."""
        return tuple(s for s in self.rank.unobservable if s not in self.hidden)

    @property
    def everywhere(self) -> bool:
        """Whether all unknowns that are unobservable on this branch are unobservable on every branch."""
        return bool(self.lost) and set(self.rank.unobservable) <= {*self.lost}

    @property
    def advice(self) -> str:
        """The advice which further signal to measure, where an unknown is proved unobservable on every branch; else
        ""."""
        if not self.lost:
            return ""
        missing = " or ".join(s.name for s in self.repairs)
        if not missing:
            return "measure more: no single state or parameter would do"
        return f"measure {missing} as well" + (f", which shows all where {self.condition}" if self.elsewhere else "")

    @property
    def condition(self) -> Reason:
        """The conditions of the branch as a sentence; `NONE` for a plant without branches."""
        if not self.where:
            return NONE
        first_conditions, more = self.where[:_CONDITIONS], len(self.where[_CONDITIONS:])
        shown = [because("{x} is near {value}", x=c.lhs, value=c.rhs) if c.is_Equality else c for c in first_conditions]
        first = because("{shown: and }", shown=shown)
        return because("{first} and {more} more conditions", first=first, more=more) if more else first

    @property
    def unseen(self) -> tuple[Reason, ...]:
        """Sentences on the unobservable unknowns of this branch, and on those for which this is not decided."""
        place = because(" where {condition}", condition=self.condition) if self.where and not self.everywhere else NONE
        are = "is" if len(self.hidden) == 1 else "are"
        later = because("the outputs determine {names} at later samples all the same", names=self.later)
        stays = because(", which the plant may leave") if self.passing else NONE
        pattern = "{names} {are} not observable{place}{stays}"
        hidden = because(pattern, names=self.hidden, are=are, place=place, stays=stays)
        undecided = because("whether {names} can be observed{place} is not known", names=self.doubtful, place=place)
        each = ((hidden, self.hidden), (later, self.later), (undecided, self.doubtful))
        return tuple(one for one, names in each if names)

    @property
    def exceptions(self) -> tuple[Reason, ...]:
        """Sentences on the unknowns that are unobservable on other branches only, for the first such branches."""
        lost = {*self.lost}
        sentences = [one for other in self.elsewhere if not {*other.rank.unobservable} <= lost for one in other.unseen]
        more = because("so on {more} other branches", more=len(sentences) - _BRANCHES)
        return (*sentences[:_BRANCHES], *((more,) if len(sentences) > _BRANCHES else ()))

    def __str__(self) -> str:
        rank = self.rank
        lines = [self.counted.replace("derivatives of the outputs", "derivatives")]
        if self.orders:
            what = "sample" if self.discrete else "derivative"
            lines.append(f"observable, from {what}: " + ", ".join(f"{s} ({k})" for s, k in self.orders))
        lines += map(str, self.unseen)
        lines += [f"not seen: {symmetry}" for symmetry in self.symmetries]
        if self.direction:
            what = "no output" if self.discrete else f"no derivative up to order {rank.order}"
            unchanged = f"a direction in which {what} is known to change"
            known = "an unobservable direction" if self.hidden == rank.unobservable else unchanged
            lines.append(f"{known}: {_values(self.direction)}, at {_values(self.point)}")
        lines += [self.advice] if self.advice else []
        return "\n".join([*lines, *map(str, self.exceptions)])


@dataclass(frozen=True)
class Observability(Encoded):
    """The generic observability of a plant."""

    json_keys = "known joint method asked=scope checks"

    system: System
    known: Annotated[Answer, "with known parameters, on the branch where most is observable"]
    joint: Annotated[Answer | None, "with the parameters that have a range as unknowns; null where none has"]
    method: Annotated[str, "the arithmetic"]
    scope: Annotated[Reason, "branches, by how many points of which ranges they were found, and what was left out"]

    @property
    def n(self) -> int:
        """Number of states."""
        return self.known.rank.dimension

    @property
    def rank(self) -> int:
        """Generic rank of d(y, y', ..)/dx with known parameters, on the branch where the rank is largest."""
        return self.known.rank.rank

    @property
    def order(self) -> int:
        """The least k for which d(y, y', .., y^(k))/dx has the generic rank."""
        return self.known.rank.order

    @property
    def observable(self) -> tuple[sp.Symbol, ...]:
        """The states that are individually observable, parameters known."""
        return self.known.rank.observable

    @property
    def unobservable(self) -> tuple[sp.Symbol, ...]:
        """The states that are not individually observable, parameters known."""
        return self.known.rank.unobservable

    @property
    def limits(self) -> tuple[str, ...]:
        """Sentences on the limits of the answers: the branches that were reached, and the states that are observable
        only modulo a part of a turn."""
        modulo = self.system.modulo and f"the outputs give {self.system.modulo}"
        return tuple(filter(None, (str(self.scope), modulo)))

    @property
    def checks(self) -> tuple[Check, ...]:
        """The check `observability.states`, and `observability.joint` where a parameter has a range."""
        known = _check("states", "the states are locally observable, parameters known", self.known, self)
        if self.joint is None:
            return (known,)
        together = "states and ranged parameters are locally observable together"
        return known, _check("joint", together, self.joint, self)

    def __str__(self) -> str:
        parts = [("parameters known", self.known), ("with the parameters that have a range", self.joint)]
        lines = [f"{self.system.name}: generic observability, {self.method}"]
        for title, answer in parts:
            if answer is not None:
                lines += [f"  {title}:", *(f"    {line}" for line in str(answer).splitlines())]
        return "\n".join([*lines, *(f"  {line}" for line in self.limits)])


@requires_any_plant
@cached
def observability(plant: System, *, unknown: tuple[str, ...] | None = None) -> Observability:
    """Return the generic observability of a plant's states, and of its states together with the parameters `unknown`,
    by default those with a range. Other parameters have their nominal values. A discrete plant is observed by its
    outputs at later samples.

    Raises: `BadGain` for names of no parameter; `NowhereDefined` for a plant that is nowhere defined; `NoTape` for a
    function without interval arithmetic.
    """
    unknowns: tuple[sp.Symbol, ...] = plant.tunable
    if unknown is not None:
        unknowns = signals_named(
            "unknown",
            unknown,
            plant.parameters,
            lambda name, fix: BadGain(f"unknown names {name!r}", f"which is no parameter; {fix}"),
        )
    reached = on_branches(plant, unknowns)
    questions = [part for branch in reached.branches for part in _Question(plant, branch, unknowns).parts()]
    first = {one.key: one for one in reversed(questions)}  # branches with the same rows have the same ranks
    generic = {key: one.ranks() for key, one in first.items()}
    ranked = [(one, ranks_of_branch) for one in questions if (ranks_of_branch := generic[one.key]) is not None]
    if not ranked and plant.constraints:  # a quotient or a jump there whose limits are not known to be equal
        undecided = [
            Answer(Rank(len(every), 0, 0, (), every, False)) for every in (plant.states, (*plant.states, *unknowns))
        ]
        scope = because(
            "at none of {points} points on the invariants is the plant known to have a value", points=reached.points
        )
        return Observability(plant, undecided[0], undecided[1] if unknowns else None, "not decided", scope)
    if not ranked:
        raise NowhereDefined(reached.points)
    every = len(ranked) == len(questions) and not reached.more
    known = _whole([(replace(question, parameters=()), one.known) for question, one in ranked], every)
    joint = _whole([(question, one.joint) for question, one in ranked], every) if unknowns else None
    scope = _scope(plant, unknowns, reached, len(ranked))
    return Observability(plant, known, joint, ranked[0][1].method, scope)


def _scope(plant: System, loose: Sequence[sp.Symbol], reached: SampledBranches, count: int) -> Reason:
    if not reached.branching:
        return NONE
    pattern = "examined on {count} branches, those that {points} points of the ranges reach; there may be others"
    more = because("{more} were found and left out", more=len(reached.branches) + reached.more - count)
    free = [s for s in (*plant.states, *plant.inputs, *loose) if not s.bounded]
    without = because("{free} without a range: sampled from 0.01 to 100 in size, of either sign", free=free)
    many = because(pattern, count=count, points=reached.points)
    return joined(many, more if len(reached.branches) + reached.more > count else NONE, without if free else NONE)


@dataclass(frozen=True)
class _Question:
    plant: System
    branch: Branch
    parameters: tuple[sp.Symbol, ...]

    @cached_property
    def model(self) -> Model:
        """The equations on the branch, with its places."""
        plant, n, p = self.plant, len(self.plant.states), len(self.plant.outputs)
        flow, output, constraints = self.branch.rows[:n], self.branch.rows[n : n + p], self.branch.rows[n + p :]
        signals = plant.states, plant.inputs, self.parameters
        return Model(flow, output, *signals, self.branch.places, plant.discrete, constraints)

    @property
    def key(self) -> tuple[Any, ...]:
        """The rows, and on constraints the conditions, on which the ranks depend."""
        return self.branch.rows, self.branch.where if self.model.constraints else ()

    def parts(self) -> list["_Question"]:
        """Return the question itself; of a plant with constraints one for each result that is found at places of the
        branch: what is 0 where they are may have several parts, as sin(x) at 0 and at pi."""
        if not self.model.constraints or self.irreducible:
            return [self]
        places_by_ranks: dict[Ranks | None, list[Place]] = {}
        for place in self.branch.places[:_PARTS]:
            places_by_ranks.setdefault(self.at((place,)).ranks(), []).append(place)
        places_by_ranks.pop(None, None)
        parts = [self.at(tuple(places)) for places in places_by_ranks.values()]
        return [part.near() for part in parts] if len(parts) > 1 else parts

    @property
    def irreducible(self) -> bool:
        """Whether the rows are rational functions on the zeros of one irreducible polynomial in states over the
        rationals: its parts are conjugate, so that all have the same ranks."""
        c, *more = self.model.constraints
        if more or not exact_numbers(replace(self.model, constraints=()).plant):
            return False
        product = factors(c)
        polynomial = c.free_symbols <= {*self.plant.states} and c.is_polynomial(*self.plant.states)
        return bool(polynomial and product and [one.exponent for one in product.factors] == [1])

    def at(self, places: tuple[Place, ...]) -> "_Question":
        """Return the question at these places of its branch."""
        return replace(self, branch=replace(self.branch, places=places))

    def near(self) -> "_Question":
        """Return the question with its first place as a condition, for the states that the constraints read."""
        place, read = self.branch.places[0], sp.Tuple(*self.model.constraints).free_symbols
        here = (sp.Eq(x, sp.Float(float(place[x]), 3)) for x in self.plant.states if x in read)
        return replace(self, branch=replace(self.branch, where=(*self.branch.where, *here)))

    def ranks(self) -> Ranks | None:
        """The ranks of d(y, y', ..)/dx on the branch; None if no random point decides them."""
        try:
            return ranks(self.model)
        except NowhereDefined:
            return None

    @property
    def where(self) -> tuple[sp.Basic, ...]:
        around, where = self.plant.box, self.branch.where
        return tuple(one for one in where if isinstance(one, sp.Eq) or not enclose(one.gts - one.lts, around)[0] >= 0)

    @property
    def tests(self) -> tuple[sp.Expr, ...]:
        """The expressions whose signs are the conditions of the branch."""
        return tuple(one.lhs - one.rhs for one in self.branch.where if not isinstance(one, sp.Eq))

    @property
    def may_be_left(self) -> bool:
        """Whether the plant may leave the branch: unless g' = k g is proved of each g > 0, k finite."""
        rates = dict(zip(self.plant.states, self.model.flow, strict=True))
        moving = {*self.plant.inputs, *(self.plant.states if self.plant.discrete else ())}
        return any(g.free_symbols & moving or divided(rate(g, rates), [g]).remainder != 0 for g in self.tests)

    def symmetries(self, fields: Sequence[Sequence[sp.Expr]]) -> list[Sequence[sp.Expr]]:
        """Return the vector fields that change neither an output nor the sign of a condition on the branch, each with
        the others."""
        along = [dict(zip(self.model.unknowns, field, strict=True)) for field in fields]
        inside = [all(divided(rate(g, field), [g]).remainder == 0 for g in self.tests) for field in along]
        return [field for field, *sure in zip(fields, _proved(fields, self.model), inside, strict=True) if all(sure)]

    def answer(self, rank: Rank, *, proofs: bool = True) -> Answer:
        hidden, discrete = rank.unobservable, self.plant.discrete
        left = (*(self.plant.states if discrete else ()), *self.plant.times)
        passing = any(condition.free_symbols & {*left} for condition in self.branch.where)
        if passing or not hidden or not proofs:
            orders, where = self.orders(rank) if proofs else (), self.where if hidden or passing else ()
            return Answer(rank, orders, where=where, discrete=discrete, passing=passing)
        fields = symmetries(self.model, hidden, rank.order)
        few = len(fields) < rank.dimension - rank.rank
        direction, point = self.direction(rank.order) if few else ((), ())
        changed = {s for field in fields if field.proved for s, _ in field.field}
        if not any(e.free_symbols & {*self.plant.states} for e in self.model.output):
            changed |= {*self.plant.states}
        proved = tuple(s for s in hidden if s in changed)
        repairs = self.repairs(rank) if proved else ()
        return Answer(rank, self.orders(rank), fields, direction, point, repairs, proved, self.where, discrete=discrete)

    def orders(self, rank: Rank) -> tuple[tuple[sp.Symbol, int], ...]:
        """Return for each observable unknown the order of y', y'', .. from
        which its unit vector is in the row space of d(y, y', ..)/dx."""
        plant, unknowns = self.model.plant, self.model.unknowns

        def answer(numbers: Arithmetic, point: Point) -> dict[sp.Symbol, int]:
            orders: dict[sp.Symbol, int] = {}
            rows: list[Any] = []
            for k, y in enumerate(first_gradients(plant, numbers, point, rank.order + 1)):
                rows += matrix_rows(y)
                basis = nullspace_basis(rows, plant.wide, modulus(numbers))
                observable = (s for i, s in enumerate(unknowns) if all(vector[i] == 0 for vector in basis))
                orders |= {s: k for s in observable if s not in orders}
            return orders

        orders = at_random_point(plant, answer)
        return tuple((s, orders[s]) for s in rank.observable if s in orders)

    def repairs(self, rank: Rank) -> tuple[sp.Symbol, ...]:
        """Return the unobservable unknowns whose measurement alone gives full
        rank. Each order of derivatives up to the stationary one adds to the
        rank, so `rank.order` and as many more as the deficiency suffice."""
        output, hidden, discrete = self.model.output, rank.unobservable, self.plant.discrete
        p, plant = len(output), replace(self.model, output=(*output, *hidden)).plant

        def answer(numbers: Arithmetic, point: Point) -> tuple[sp.Symbol, ...]:
            count = rank.dimension if discrete else rank.order + rank.dimension - rank.rank + 1
            orders = [matrix_rows(y) for y in first_gradients(plant, numbers, point, count)]

            def full(i: int) -> bool:
                rows = [row for y in orders for row in (*y[:p], *y[p + len(hidden) :], y[p + i])]
                return len(independent_rows(rows, modulus(numbers))) == rank.dimension

            return tuple(s for i, s in enumerate(hidden) if full(i))

        return at_random_point(plant, answer)

    def determined_later(self, rank: Rank) -> tuple[sp.Symbol, ...]:
        """Return the unobservable states of a discrete plant whose value at sample n is a function of the outputs: the
        rows of d(x at sample n)/d(x, p) that are in the row space of d(y_0, y_1, ..)/d(x, p)."""
        output, states = self.model.output, self.model.states
        plant = replace(self.model, output=(*output, *states)).plant

        def answer(numbers: Arithmetic, point: Point) -> tuple[sp.Symbol, ...]:
            orders = [matrix_rows(y) for y in first_gradients(plant, numbers, point, plant.wide + 1)]
            rows = [row for y in orders[:-1] for row in y[: len(output)]]
            last = zip(states, orders[-1][len(output) :], strict=True)
            known = [x for x, row in last if len(independent_rows([*rows, row], modulus(numbers))) == rank.rank]
            return tuple(x for x in known if x in rank.unobservable)

        return at_random_point(plant, answer)

    def direction(self, order: int) -> tuple[Any, Any]:
        """Return a vector v (largest entry 1) with d(y, .., y^(order))/dx
        v = 0 at a random real point, and the point; or ()."""
        plant, unknowns = self.model.plant, self.model.unknowns

        def answer(numbers: Arithmetic, point: Point) -> tuple[Any, Any]:
            rows = [row for y in first_gradients(plant, numbers, point, order + 1) for row in matrix_rows(y)]
            basis = nullspace_basis(rows, plant.wide, 0)
            if not basis:
                raise Undecided
            vector = [float(flint.arb(e).mid()) for e in basis[0]]
            largest = max(vector, key=abs)
            values = (*point.states, *point.constants[: plant.q])
            components = tuple((s, v / largest) for s, v in zip(unknowns, vector, strict=True) if v)
            return components, tuple((s, float(v.mid())) for s, v in zip(unknowns, values, strict=True))

        try:
            return at_random_point(plant, answer, balls=True)
        except NowhereDefined:
            return (), ()


def _whole(ranked: Sequence[tuple[_Question, Rank]], every: bool) -> Answer:
    best, rank = max(ranked, key=lambda pair: pair[1].rank)
    blind = [(question, other) for question, other in ranked if other.unobservable and question is not best]
    elsewhere = tuple(question.answer(other, proofs=k < _PROVED_BRANCHES) for k, (question, other) in enumerate(blind))
    answer = best.answer(rank)
    if not answer.hidden or (every and len(ranked) == 1):
        later = best.determined_later(rank) if answer.hidden and best.plant.discrete else ()
        lost = tuple(s for s in answer.hidden if s not in later)
        return replace(answer, lost=lost, later=later, elsewhere=elsewhere)
    symmetries = _shared(answer, best, [question for question, _ in ranked]) if every else ()
    unseen = {s for one in symmetries for s, _ in one.field}
    lost = tuple(s for s in answer.hidden if s in unseen)
    if best.may_be_left and lost:
        answer = replace(answer, symmetries=symmetries, hidden=lost)
    return replace(answer, lost=lost, elsewhere=elsewhere, passing=best.may_be_left and not lost)


def _shared(answer: Answer, best: _Question, questions: Sequence[_Question]) -> tuple[Symmetry, ...]:
    """Return the symmetries of the answer on the best branch that are symmetries on every branch."""
    unknowns, fields = best.model.unknowns, list[Sequence[sp.Expr]]()
    fields += [[dict(one.field).get(s, sp.S.Zero) for s in unknowns] for one in answer.symmetries if one.proved]
    count = -1
    while count != len(fields):
        count = len(fields)
        for question in questions:
            fields = question.symmetries(fields)
    return tuple(_symmetry(unknowns, field, True) for field in fields)


def _check(fact: str, claim: str, answer: Answer, whole: Observability) -> Check:
    id, rank = ClaimId("observability", fact), answer.rank
    pattern = "rank {rank} of {dimension} at a random point{where}, {method}"
    where = because(" on the invariants") if whole.system.invariants else NONE
    reason = because(pattern, rank=rank.rank, dimension=rank.dimension, where=where, method=whole.method)
    reason = reason if rank.final else NONE
    if answer.passing and not answer.hidden:
        why = because("it is that of samples where {condition}, which the plant may leave", condition=answer.condition)
        return Check(id, claim, Verdict.UNKNOWN, joined(reason, why, whole.scope))
    if not rank.unobservable:
        verdict = Verdict.WHERE if answer.elsewhere else Verdict.GENERIC
        modulo = because("the outputs give {states}", states=whole.system.modulo) if whole.system.modulo else NONE
        return Check(id, claim, verdict, joined(reason, *answer.exceptions, whole.scope, modulo))
    shared = () if answer.passing else answer.symmetries
    proofs = (because("no output sees {symmetry}", symmetry=one) for one in shared if one.proved)
    blind = not any(e.free_symbols & {*whole.system.states} for e in whole.system.output)
    why = because("no output reads a state") if blind else next(proofs, NONE)
    fix = f"{answer.advice[:1].upper()}{answer.advice[1:]}." if answer.advice else ""
    return Check(id, claim, answer.verdict, joined(reason, *answer.unseen, whole.scope, why), fix=fix)


def _values(pairs: Sequence[tuple[sp.Symbol, float]]) -> str:
    return ", ".join(f"{s} = {value:.3g}" for s, value in pairs)
