"""The singular set of a plant, where det d(h, h', ..)/dx = 0 and it is not observable, and higher derivatives by which
it is observable there.

    O(x, u, u', ..) = d(y, y', .., y^(k))/dx,   singular where n chosen rows of O have determinant 0

On the zero set of a factor, such as u = 0, later rows may have full rank: the state is then observable by the next
jet, which reads higher derivatives of the input. That rank n at a point suffices for local observability there:
R. Hermann, A. Krener, "Nonlinear controllability and observability", IEEE TAC 22 (1977).

Uniform observability for every input of a control-affine plant with one output.

    x' = f(x) + sum_j g_j(x) u_j,   y = h(x)
    rank d(h, L_f h, .., L_f^(n-1) h) = n   and   d(L_g L_f^(i-1) h) in span(dh, .., d L_f^(i-1) h)  for all i, g

on an open dense set: then, and only then, the plant is observable whatever the real input there, and
z = (h, L_f h, ..) brings it to triangular form. J.-P. Gauthier, G. Bornard, "Observability for any u(t) of a class of
nonlinear systems", IEEE Trans. Automatic Control 26 (1981), theorem 4.

The gradients come from power series at a random point, their slope along g from the same series at the point moved
along g, in numbers modulo the square of a prime (or with balls): no Lie derivative is written out. A span that is
left at one point is left almost everywhere. An invariant span, or a rank below n, is tested at several points, which is
no proof. The theorem is about every real input, regardless of declared ranges.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from itertools import combinations_with_replacement
from typing import Any

import sympy as sp
from sympy.combinatorics import Permutation

from hgogen.analysis.determinant import (
    Determinant,
    determinant,
    independent,
    readable_determinant,
    surely_nonzero,
    zero_set,
)
from hgogen.analysis.maps import length, rates, size, time_derivative, without_derivative
from hgogen.analysis.undefined import on_box, on_branches, value_conditions, wrapped_angles
from hgogen.check import Check, ClaimId, Verdict
from hgogen.reading.given import cached, requires_any_plant
from hgogen.rigor.bounds import Interval, contains_zero, enclose, nonzero
from hgogen.rigor.box import box as box_of
from hgogen.rigor.box import exact
from hgogen.rigor.factors import ROUGH, Row, branches, codistribution_product, powers, split_roots, tower
from hgogen.rigor.field import TooLarge, is_zero
from hgogen.rigor.rank import (
    Model,
    NowhereDefined,
    at_random_point,
    demand_precise_zeros,
    exact_numbers,
    independent_rows,
    matrix_rows,
    modulus,
)
from hgogen.rigor.rank import branches as switches_of
from hgogen.rigor.series import Arithmetic, Plant, Point, evaluate, first_gradients
from hgogen.rigor.singular import NONZERO, minimal, reasons, singular
from hgogen.rigor.tape import NoTape
from hgogen.sentence import NONE, Encoded, Reason, Sentence, because, equations, joined
from hgogen.signal import times
from hgogen.system import System

# An observability matrix of more nodes is refused: its determinant takes seconds and fills pages.
LIMIT = 4000
ELIMINATION = 300_000  # products of terms, of a determinant with the inputs at 0
# Nodes of a derivative of an output, written out: the next derivative has a term for each node.
_WRITTEN = 30_000
_WITH_ROOTS = 2_000  # of a derivative with roots or real powers: its slopes take SymPy a millisecond for each node
# Derivatives beyond y^(n-1) that a jet on a zero set may use, and the depth of nested zero sets.
_FURTHER, _DEPTH = 2, 2
_BOXES = 500  # to decide whether a factor is 0
_PRINTED = 8  # terms of a sum
Where = tuple[tuple[sp.Symbol, sp.Expr], ...]
_STATES = ClaimId("singularity", "regular")


@dataclass(frozen=True)
class Jet:
    """A choice of n derivatives y_j^(k) of the outputs whose gradients by the states are independent on the set `where`
    (symbol to value), with the determinant of these gradients: where it is not 0, the state is locally observable.

    `rows`: (j, k) of each derivative; `factors`: those of the determinant, empty where it is never 0, the determinant
    itself where its zeros are not known, None where the gradients up to the last order tried, `order`, do not have full
    rank; `parts`: the derivatives, the rates that they contain and the entries of the Jacobian, on whose smoothness the
    determinant depends; `readable`: the determinant with its factors as it is printed, None where this is the same.
    """

    where: Where
    rows: tuple[Row, ...]
    determinant: sp.Expr
    factors: tuple[sp.Expr, ...] | None
    order: int
    parts: tuple[sp.Expr, ...] = ()
    readable: Determinant | None = None

    @property
    def text(self) -> sp.Expr:
        """The determinant as it is printed."""
        return self.readable.value if self.readable else self.determinant


@dataclass(frozen=True)
class Singularity(Encoded):
    """The singular set of a plant, where it is not observable by the first derivatives of its outputs, with further
    derivatives by which it is observable there.

    `jets`: for general states (an empty `where`), then for the zero sets of the determinant, outermost first; () where
    the matrix is too large, or the plant jumps, for the `reason`.
    """

    json_keys = "factors inputs determinants checks"

    plant: System
    jets: tuple[Jet, ...]
    reason: Reason = NONE

    @property
    def factors(self) -> tuple[sp.Expr, ...] | None:
        """The factors of det d(y, y', ..)/dx, whose zero sets together are the singular set; None where they are not
        known."""
        return self.jets[0].factors if self.jets else None

    @property
    def inputs(self) -> tuple[sp.Expr, ...]:
        """The singular inputs: factors of det d(y, y', ..)/dx in inputs and parameters alone that may be 0. Where one
        is 0, no state is observable by these derivatives."""
        return tuple(e for e in self.open_factors if e.free_symbols.isdisjoint(self.plant.states))

    @property
    def open_factors(self) -> tuple[sp.Expr, ...]:
        """The factors of det d(y, y', ..)/dx that are not proved to be nonzero on the box of states, inputs and
        parameters."""
        return _open(self.plant, self.factors or ())

    @property
    def determinants(self) -> tuple[sp.Expr, ...]:
        """The determinant of each jet, written out without names for repeated parts."""
        return tuple(jet.text for jet in self.jets)

    @property
    def checks(self) -> tuple[Check, ...]:
        """The checks of local observability: one for general states and one for each zero set of the determinant; each
        holds where the factors of its own determinant are not 0."""
        if not self.jets:
            return (Check(_STATES, "the state is observable", Verdict.UNKNOWN, self.reason),)
        return tuple(_check(self.plant, jet, k) for k, jet in enumerate(self.jets))

    @property
    def head(self) -> tuple[Sentence, ...]:
        """A title, and a line for each singular input if there are any."""
        title = "{plant}: where the outputs determine the state, and where not"
        inputs = (Sentence.of("  singular input: {factor} = 0", factor=e) for e in self.inputs)
        return (Sentence.of(title, plant=self.plant.name), *inputs)

    def __str__(self) -> str:
        return "\n".join([*map(str, self.head), *(f"  {check}" for check in self.checks)])

    def latex(self) -> str:
        """Return the determinants as LaTeX, an align environment with a line for each jet."""
        marks = (r"\dot{{{}}}", r"\ddot{{{}}}", r"\dddot{{{}}}")
        dots = {  # the inputs' derivatives, with dots or orders above
            u.derivative(k): (marks[k - 1] if k <= len(marks) else "{{{}}}^{{(" + str(k) + ")}}").format(sp.latex(u))
            for u in self.plant.inputs
            for k in range(1, len(self.plant.states) + _FURTHER)
        }
        rows = []
        for jet in self.jets:
            outputs = [(sp.latex(self.plant.outputs[j]), order) for j, order in jet.rows]
            names = ", ".join(f"{y}^{{({order})}}" if order else y for y, order in outputs)
            at = ", ".join(
                f"{sp.latex(s, symbol_names=dots)} = {sp.latex(value, symbol_names=dots)}" for s, value in jet.where
            )
            lhs = rf"\det \frac{{\partial ({names})}}{{\partial x}}" if jet.rows else r"\operatorname{rank} O"
            rhs = f"= {sp.latex(jet.text, symbol_names=dots)}" if jet.rows else f"< {len(self.plant.states)}"
            rows.append(f"{lhs} &{rhs}" + (rf" && \text{{at }} {at}" if at else ""))
        return "\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"


@requires_any_plant
@cached
def singularity(plant: System, limit: int = LIMIT) -> Singularity:
    """Return the singular set of a plant, and further derivatives of the outputs by which it is observable there;
    inputs vary with time, so that their derivatives occur.

    Parameters stay symbols. The zero set of a factor is examined where the factor is linear, with a constant
    coefficient, in one of the inputs, their derivatives or the states: its root is substituted for this symbol.
    `limit`: the most nodes of an expression.
    """
    if plant.discrete:
        return Singularity(
            plant, (), because("not known: it is found by derivatives, and the plant is discrete in time")
        )
    plain = on_box(plant)
    derived = _Derived(plain, rates(plain, len(plant.states) - 1 + _FURTHER), limit)
    try:
        generic = _triangle(plain) or _jet((), derived, len(plant.states) - 1)
        return Singularity(plant, (generic, *_followed(generic, derived, _DEPTH)))
    except (TooLarge, NoTape) as error:
        rough = without_derivative((*plant.flow, *plant.output)) if isinstance(error, NoTape) else NONE
        ask = because("not known: {rough}, and the derivatives of the outputs ask for it", rough=rough)
        return Singularity(plant, (), ask if rough else error.reason)


@dataclass(frozen=True)
class _Derived:
    """The outputs' derivatives y_j, y_j', .. along the plant (`chains`, by j), and in
    `rows` the gradient of y_j^(k) by the states with y_j^(k) appended, by (j, k).
    They are computed on demand, since each is longer than the one before."""

    plant: System
    flow: Mapping[sp.Symbol, sp.Expr]
    limit: int
    chains: dict[int, tuple[sp.Expr, ...]] = field(default_factory=dict)
    rows: dict[Row, list[sp.Expr]] = field(default_factory=dict)

    def order(self, k: int) -> dict[Row, list[sp.Expr]]:
        for j, h in enumerate(self.plant.output):
            chain = self.chains.get(j, (h,))
            while len(chain) <= k:
                _check_length(chain[-1])
                chain = (*chain, time_derivative(chain[-1], self.flow))
                self._small(chain)
            self.chains[j] = chain
            for i, derivative in enumerate(chain[: k + 1]):
                _check_length(derivative)
                if (j, i) not in self.rows:
                    self.rows[j, i] = [*(derivative.diff(x) for x in self.plant.states), derivative]
        self._small(e for row in self.rows.values() for e in row)
        return dict(sorted((row for row in self.rows.items() if row[0][1] <= k), key=lambda row: row[0][::-1]))

    def behind(self, rows: Iterable[Row]) -> tuple[sp.Expr, ...]:
        """Return the rates x' of the states that y_j, .., y_j^(k-1) read, (j, k) in `rows`: a pole of a rate may cancel
        in y_j^(k)."""
        expressions = [e for j, order in rows for e in self.chains[j][:order]]
        read = set[sp.Symbol]().union(*(e.free_symbols for e in expressions))
        return tuple(rate for x, rate in zip(self.plant.states, self.plant.flow, strict=True) if x in read)

    def _small(self, expressions: Iterable[sp.Expr]) -> None:
        nodes = size(expressions)
        if nodes > self.limit:
            raise TooLarge(f"the observability matrix, of {nodes} nodes, more than {self.limit},")


def _check_length(derivative: sp.Expr) -> None:
    rooted = any(not power.exp.is_Integer for power in derivative.atoms(sp.Pow))
    written, most = length(derivative), _WITH_ROOTS if rooted else _WRITTEN
    if written > most:
        raise TooLarge(f"a derivative of an output, written out with {written} nodes, more than {most},")


def _box(plant: System) -> dict[sp.Symbol, Interval]:
    orders = range(1, len(plant.states) + _FURTHER)
    return {**plant.box, **box_of(u.derivative(k) for u in plant.inputs for k in orders)}


def _open(plant: System, factors: Iterable[sp.Expr]) -> tuple[sp.Expr, ...]:
    box = _box(plant)
    return tuple(e for e in factors if not nonzero(e, box, boxes=_BOXES, refute=False).never)


def _jet(where: Where, derived: _Derived, last: int) -> Jet:
    """Return the first n derivatives y_j^(k), k up to `last`, with independent
    gradients on the set `where`, and the factors of their determinant."""
    n = len(derived.plant.states)
    for order in range((n - 1) // len(derived.plant.outputs), last + 1):
        gradients = derived.order(order)
        there = {row: [e.subs(where) for e in entries[:n]] for row, entries in gradients.items()}
        chosen = independent(there, n)
        if len(chosen) == n:
            square = [there[row] for row in chosen]
            det = determinant(square)
            parts = (*(e for row in gradients if row in chosen for e in gradients[row]), *derived.behind(chosen))
            factors = (det.value,) if det.factors is None else det.factors
            return Jet(where, chosen, det.value, factors, order, parts, readable_determinant(square, det))
    return Jet(where, (), sp.S.Zero, None, last)


def _triangle(plant: System) -> Jet | None:
    """Return det d(y, y', ..)/dz of a chain without computing a derivative of y. If y
    depends on z_1 alone and z_i' on no state beyond z_(i+1), the Jacobian is triangular,
    dy^(k)/dz_(k+1) = s_0 .. s_k with s_0 = dh/dz_1, s_i = dz_i'/dz_(i+1), and the
    determinant is prod_i s_i^(n-i). None for other plants, or with kinks or roots."""
    order: list[sp.Symbol] = []
    slopes, row, n = list[sp.Expr](), plant.output[0], len(plant.states)
    rows = []
    while len(order) < n:
        new = [x for x in plant.states if row.has(x) and x not in order]
        powers = row.atoms(sp.Pow)
        if len(plant.output) > 1 or len(new) != 1 or row.has(*ROUGH) or any(not p.exp.is_Integer for p in powers):
            return None
        rows.append(row)
        slopes.append(row.diff(new[0]))
        order += new
        row = plant.flow[plant.states.index(new[0])]
    if any(is_zero(slope) is not False for slope in slopes):
        return None
    sign = Permutation([plant.states.index(x) for x in order]).signature()
    each = [determinant([[slope]]) for slope in slopes]
    det = _powers(each, sign)
    readable = _powers([readable_determinant([[slope]], one) for slope, one in zip(slopes, each, strict=True)], sign)
    factors = (det.value,) if det.factors is None else det.factors
    return Jet((), tuple((0, k) for k in range(n)), det.value, factors, n - 1, (*rows, *slopes), readable)


def _powers(each: Sequence[Determinant], sign: int) -> Determinant:
    """Return the product sign prod_i s_i^(n-i), i = 0, .., n - 1,
    of the partial derivatives s_i in `each`, and its factors."""
    value = sign * sp.Mul(*(one.value ** (len(each) - i) for i, one in enumerate(each)))
    known = [one.factors for one in each if one.factors is not None]
    every = tuple(sorted({e for part in known for e in part}, key=sp.default_sort_key))
    return Determinant(value, every if len(known) == len(each) else None)


def _followed(jet: Jet, derived: _Derived, depth: int) -> list[Jet]:
    jets: list[Jet] = []
    last = len(derived.plant.states) - 1 + _FURTHER
    for factor in _open(derived.plant, jet.factors or ()) if depth else ():
        root = _root(factor)
        if root is not None and root[0] not in dict(jet.where):
            try:
                deeper = _jet((*jet.where, root), derived, last)
            except (TooLarge, NoTape):
                continue
            jets += [deeper, *_followed(deeper, derived, depth - 1)]
    return jets


def _root(factor: sp.Expr) -> tuple[sp.Symbol, sp.Expr] | None:
    for symbol in sorted(factor.free_symbols, key=str):
        slope = factor.diff(symbol)
        if slope.is_number and slope != 0:
            return symbol, sp.expand(symbol - factor / slope)
    return None


# ---------------------------------------------------------------- with the inputs at 0, for a library of models


def singular_set(
    flow: Sequence[sp.Expr],
    output: Sequence[sp.Expr],
    states: Sequence[sp.Symbol],
    inputs: Sequence[sp.Symbol] = (),
    limit: int = ELIMINATION,
) -> tuple[sp.Expr, ...] | str | None:
    """Return factors whose zero sets together are the zero set of det d(h, L_f h, .., L_f^(n-1) h)/dx with the inputs
    at 0.

    "none": the determinant has no zero; "all": it is 0 everywhere, decided at random numbers like generic ranks. With
    several outputs rows are added until they have rank n, ordered by derivatives first, and again by outputs first;
    both must give the same zero set. Parameters are symbols, and a factor may be one.

    None: no answer, because both orders differ, for a function with kinks, roots that depend on each other, or beyond
    `limit` products of terms.
    """
    off = dict.fromkeys(inputs, sp.S.Zero)
    drift, h = ([sp.sympify(e).subs(off) for e in rows] for rows in (flow, output))
    if any(e.has(*ROUGH) for e in (*drift, *h)):
        return None
    try:
        choices = _choices(drift, h, states)
        full = all(len(rows) == len(states) for rows in choices)
        if not full and all(p.exp.is_Integer for e in (*drift, *h) for p in e.atoms(sp.Pow)):
            return "all"
        plant = tower(drift, h, states)
        if branches(plant.field):
            return None
        if not full:
            return "all"
        zero_sets = set()
        for rows in {frozenset(rows): rows for rows in choices}.values():  # each set of rows once
            factors = codistribution_product(plant, rows, limit)
            if not surely_nonzero(plant.field, factors):
                return None
            zero_sets.add(zero_set(plant.field, split_roots(plant.field, powers(plant.field, factors)[1])))
    except (TooLarge, NoTape, NowhereDefined, ZeroDivisionError):
        return None
    one = zero_sets.pop()
    return None if zero_sets else "none" if one == () else one


def _choices(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], states: Sequence[sp.Symbol]) -> list[tuple[Row, ...]]:
    """Return choices of n (output, order of derivative) with independent gradients at a random point."""
    plant, n = Model(flow, output, states).plant, len(states)
    by_order = [(j, k) for k in range(n) for j in range(len(output))]

    def chosen(numbers: Arithmetic, point: Point) -> list[tuple[Row, ...]]:
        every = [matrix_rows(matrix) for matrix in first_gradients(plant, numbers, point, n)]
        prime = modulus(numbers)
        choices = []
        for order in (by_order, sorted(by_order)):
            new = independent_rows([every[k][j] for j, k in order], prime)
            choices.append(tuple(order[i] for i in new))
        if any(len(rows) < n for rows in choices):
            demand_precise_zeros(prime)
        return choices

    return at_random_point(plant, chosen)


# ---------------------------------------------------------------- words


def _brief(e: sp.Expr) -> sp.Expr:
    sums = [a for a in e.atoms(sp.Add) if len(a.args) > _PRINTED]
    abbreviations = {}
    for a in sums:
        first = sp.Add(*a.as_ordered_terms()[:2], evaluate=False)
        abbreviations[a] = sp.Symbol(f"({first} + .., {len(a.args)} terms)")
    return e.xreplace(abbreviations)


def _check(plant: System, jet: Jet, k: int) -> Check:
    marks = (f"{plant.outputs[j]}" + ("'" * order if order < 4 else f"^({order})") for j, order in jet.rows)
    rows = ", ".join(marks)
    id = ClaimId("singularity", "jet", k) if k else _STATES
    claim = Sentence.of("{rows} determine the state locally", rows=rows or "derivatives of the outputs")
    if jet.where:
        claim = Sentence.of("at {point: and } {claim}", point=equations(dict(jet.where)), claim=claim)
    if jet.factors is None:
        pattern = "derivatives up to order {order} leave the generic rank below {n}"
        return Check(id, claim, Verdict.UNKNOWN, because(pattern, order=jet.order, n=len(plant.states)))
    reason = because("the determinant of their Jacobian is {determinant}", determinant=_brief(jet.text))
    rough = sorted({node for part in jet.parts for node in part.atoms(*ROUGH)}, key=str)
    obstacle = because("{part} may not be smooth", part=rough[0]) if rough else plant.caveat
    if obstacle:
        return Check(id, claim, Verdict.UNKNOWN, joined(obstacle, reason))
    conditions = _conditions(plant, jet, jet.factors)
    if not conditions:
        return Check(id, claim, Verdict.PROVED, because("{reason}, which has no zero on the box", reason=reason))
    holds = because("holds where {conditions: and }", conditions=conditions)
    return Check(id, claim, Verdict.WHERE, joined(holds, reason))


def _conditions(plant: System, jet: Jet, factors: Sequence[sp.Expr]) -> list[Reason]:
    """Return the conditions, not proved on the box, under which a determinant of `factors` is defined and not 0."""
    doubtful = _open(plant, factors)
    readable = _open(plant, (jet.readable and jet.readable.factors) or ()) if doubtful else ()
    conditions = [because("{factor} != 0", factor=_brief(e)) for e in readable or doubtful]
    box = {**_box(plant), **{s: (Fraction(0),) * 2 for s, value in jet.where if value == 0}}
    every, angles = singular(map(exact, jet.parts), box), wrapped_angles(plant)
    smooth = [angles.get(node, condition) for node, condition in every.items()]
    smooth = [one for one in smooth if one.relation != NONZERO or contains_zero(enclose(one.of, box))]
    # new coordinates, or a derivative, may have lost a part of the plant as it is written
    return [*conditions, *reasons(minimal((*smooth, *value_conditions(plant))))]


# ---------------------------------------------------------------- gauthier bornard


POINTS = 3
_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo)


@dataclass(frozen=True)
class UniformObservability:
    """The uniform observability of a plant, that is for every input. `answer`: True or False, None where the test does
    not apply or does not decide; `reason`: why.

    `applies`: whether the test applies: the plant has one output, an input, a flow affine in the inputs, and an output
    free of them. `proved`: whether a False is proved, and not only decided by ranks at random points.
    """

    answer: bool | None
    applies: bool
    reason: Reason
    proved: bool = True

    @property
    def verdict(self) -> Verdict:
        """The verdict of the claim that the plant is observable for every real input, inside and outside its ranges."""
        if self.answer is None or not (self.answer or self.proved):
            return Verdict.UNKNOWN
        return Verdict.GENERIC if self.answer else Verdict.REFUTED


def gauthier_bornard(model: Model) -> UniformObservability:
    """Return the result of Gauthier and Bornard's test of observability for every input of a model, at random points.
    Raises: `NowhereDefined`; `NoTape` for a function without interval arithmetic."""
    plant, outside = model.plant, _outside(model.flow, model.output, model.inputs)
    if outside:
        return UniformObservability(None, False, outside)
    ranks = []
    for k in range(POINTS):
        rank, violation = at_random_point(plant, partial(_span_test, plant, model.inputs), first=k, power=2)
        if violation:
            return UniformObservability(False, True, violation)
        ranks.append(rank)
    if max(ranks) < plant.n:
        return _deficient(max(ranks), model)
    if switches_of(plant):
        pattern = "it holds at {points} points, but on one branch of {branches}"
        return UniformObservability(None, True, because(pattern, points=POINTS, branches=switches_of(plant)))
    kind = "modulo primes" if exact_numbers(plant) else "with balls"
    pattern = "rank {rank}, and every span is kept at {points} random points {kind}"
    return UniformObservability(True, True, because(pattern, rank=plant.n, points=POINTS, kind=kind))


def of_plant(plant: System) -> UniformObservability:
    """Return the result of Gauthier and Bornard's test of observability for every input of a plant, on each branch that
    the declared ranges reach. Parameters with a range are generic, others have their nominal values. Raises: as
    `gauthier_bornard`."""
    if plant.invariants:
        return UniformObservability(None, False, because("the test is for plants without invariants"))
    reached = on_branches(plant, plant.tunable)
    n, answers = len(plant.states), []
    if not reached.branches:
        raise NowhereDefined(reached.points)
    outside = _outside(plant.flow, plant.output, plant.inputs) if reached.branching else NONE
    if outside:
        return UniformObservability(None, False, outside)
    for branch in reached.branches:
        model = Model(branch.rows[:n], branch.rows[n:], plant.states, plant.inputs, places=branch.places)
        one = gauthier_bornard(model)
        if not reached.branching:
            return one
        at = because("where {conditions: and }: {reason}", conditions=branch.where, reason=one.reason)
        answers.append(replace(one, reason=at))
        if one.answer is False and one.proved:
            return answers[-1]
    doubtful = next((one for one in answers if one.answer is not True), None)
    smooth = because(
        "it holds on the {count} branches examined, and the theorem is of smooth plants", count=len(answers)
    )
    return doubtful or UniformObservability(None, True, smooth)


def _outside(flow: Sequence[sp.Expr], output: Sequence[sp.Expr], inputs: Sequence[sp.Symbol]) -> Reason:
    if len(output) != 1:
        return because("the test is for one output, and there are {count}", count=len(output))
    if not inputs:
        return because("there is no input")
    if times(inputs):
        return because("the test is for inputs of any course, and time has one")
    slopes = [(output[0].diff(u), because("the output depends on {input}", input=u)) for u in inputs]
    pairs = combinations_with_replacement(inputs, 2)
    curvatures = [(u, v, because("the flow is not affine in {inputs}", inputs=dict.fromkeys((u, v)))) for u, v in pairs]
    slopes += [(e.diff(u).diff(v), what) for e in flow for u, v, what in curvatures]
    for slope, what in slopes:
        zero = is_zero(slope)
        if not zero:
            return what if zero is False else because("it is not known whether {slope} is zero", slope=slope)
    return NONE


def _deficient(rank: int, model: Model) -> UniformObservability:
    states, inputs, n = model.states, model.inputs, len(model.states)
    reason = because("without input, d(h, .., L_f^{order} h) has rank {rank} of {n}", order=n - 1, rank=rank, n=n)
    drift = {x: rate.subs(dict.fromkeys(inputs, 0)) for x, rate in zip(states, model.flow, strict=True)}
    visible = [x for x in states if x in model.output[0].free_symbols]
    for x in visible:  # the list grows while it is read
        visible += [other for other in states if other in drift[x].free_symbols and other not in visible]
    hidden = [x for x in states if x not in visible]
    if not hidden or any(rate.has(*_INFINITE) for rate in drift.values()):
        random = because("{reason} at {points} random points, which is no proof", reason=reason, points=POINTS)
        return UniformObservability(False, True, random, proved=False)
    hides = because("{reason}: {inputs: = } = 0 hides {states}", reason=reason, inputs=inputs, states=hidden)
    return UniformObservability(False, True, hides)


def _span_test(plant: Plant, inputs: Sequence[sp.Symbol], numbers: Arithmetic, point: Point) -> tuple[int, Reason]:
    """Return the rank of d(h, L_f h, ..)/dx at this point, and at rank n a reason that names an
    i and j for which d(L_gj L_f^(i-1) h) is not in span(dh, .., d L_f^(i-1) h), or `NONE`."""
    n, prime = plant.n, modulus(numbers)
    point = replace(point, inputs=lambda j, order: [0] * order)
    rows = first_gradients(plant, numbers, point, n)
    flat = [[numbers.reduced(e) for e in row.entries()] for row in rows]
    rank = len(independent_rows(flat, prime))
    if rank < n:
        demand_precise_zeros(prime)
        return rank, NONE
    drift, drift_slope = _field(plant, numbers, point, None)
    for j, u in enumerate(inputs):
        driven, driven_slope = _field(plant, numbers, point, j)
        g, slope = [a - b for a, b in zip(driven, drift, strict=True)], driven_slope - drift_slope
        states = tuple(x + numbers.small_step * v for x, v in zip(point.states, g, strict=True))
        shifted = first_gradients(plant, numbers, replace(point, states=states), n)
        for i, (row, shifted_row) in enumerate(zip(rows, shifted, strict=True)):
            turn = [numbers.slope(a, b) for a, b in zip(shifted_row.entries(), row.entries(), strict=True)]
            tilted = (row * slope).entries()
            new = [numbers.reduced(a + numbers.reduced(b)) for a, b in zip(turn, tilted, strict=True)]
            if i + 1 in independent_rows([*flat[: i + 1], new], prime):
                pattern = "d(L_g L_f^{i} h), g of {input}, leaves the span of dh, .., d L_f^{i} h"
                return rank, because(pattern, i=i, input=u)
    demand_precise_zeros(prime)
    return rank, NONE


def _field(plant: Plant, numbers: Arithmetic, point: Point, j: int | None) -> tuple[list[Any], Any]:
    """Return x' and its Jacobian by the states at `point`, with input number `j` at 1 and the others at 0."""
    values = [numbers.series([x], 1) for x in point.states]
    values += [numbers.series([int(i == j)], 1) for i in range(plant.m)]
    values += [numbers.series([c], 1) for c in point.constants]
    rows = evaluate(plant, numbers, values, 1, 1)[: plant.n]
    entries = [numbers.coefficients(s[k], 1)[0] if k in s else 0 for _, s in rows for k in range(plant.n)]
    return [numbers.coefficients(f, 1)[0] for f, _ in rows], numbers.matrix(plant.n, plant.n, entries)
