"""The order of the states in a triangular form, of one output or several, or the reason why there is none.

y reads one state first; the rate of that state reads the next one. A row is a link,

    gain * state + offset,

of a shape: CONSTANT, the gain varies with inputs and parameters only; MEASURED, with z_1 too; UNIFORM, the row has any
slope in the state that is not zero identically. A row reads a symbol where its value is proved to depend on it. An
answer is True or False only where that is proved, else None.

Rows that are affine in some states are found here too, and the states that an output measures alone.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial

import casadi as ca
import sympy as sp

from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.evidence import ByForm
from hgogen.analysis.hypotheses import nonzero_slope
from hgogen.analysis.undefined import on_box
from hgogen.check import Check, ClaimId, Verdict
from hgogen.graph import Graph
from hgogen.rigor.box import substituted
from hgogen.rigor.field import Box, dependence, free_of, is_zero
from hgogen.rigor.slope import JUMPS
from hgogen.rigor.tape import slope, with_norms, without_norms
from hgogen.rigor.tape import slope as slope_of
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal
from hgogen.system import System

Answer = tuple[bool | None, Reason]

_INFINITE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds)


class Shape(Enum):
    """The kinds of links row = gain * (next state) + offset in a chain, by the signals with which the gain may vary.
    CONSTANT: inputs and parameters only; MEASURED: also the measured state z_1; UNIFORM: the row need not be linear,
    its partial derivative by the next state may vary with any signal but is not identically 0."""

    CONSTANT = "inputs and parameters only"
    MEASURED = "inputs, parameters and the measured state only"
    UNIFORM = "anything"


@dataclass(frozen=True)
class Rows:
    """The equations of a plant, x_i' = flow[i] and y_j = output[j], with the outputs' `names`, the `ranges` of symbols,
    and `constraints` that the flow keeps at 0.

    A symbol other than a state whose range is a single value has this value.
    """

    states: tuple[sp.Symbol, ...]
    flow: tuple[sp.Expr, ...]
    names: tuple[str, ...]
    output: tuple[sp.Expr, ...]
    ranges: Box
    constraints: tuple[sp.Expr, ...] = ()

    @cached_property
    def box(self) -> Box:
        """The ranges without states of a single value: dependence on a state is tested by varying the state."""
        return {s: (low, high) for s, (low, high) in self.ranges.items() if low != high or s not in self.states}

    def reads(self, row: sp.Expr, among: Iterable[sp.Symbol]) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...]]:
        """Return two groups of the symbols in `among`: those on which the expression `row` is proved to depend, and
        those for which this is not decided."""
        return dependence(row, among, self.box)

    def rate(self, state: sp.Symbol) -> sp.Expr:
        """Return the rate x' of a state."""
        return self.flow[self.states.index(state)]


def of_plant(plant: System) -> Rows:
    """Return the equations of a plant, with constants at their values, and with kinks replaced by the branch that holds
    on its whole box."""
    plain, around = on_box(plant), plant.box
    return Rows(plant.states, plain.flow, tuple(y.name for y in plant.outputs), plain.output, around, plant.constraints)


@dataclass(frozen=True)
class Link:
    """A link of a chain: the equation `row` of an output y or a rate x', called `name`, which depends on one more
    `state`.

    `gain`, `offset`: row = gain * state + offset where `affine`; `varies`: states that the gain is proved to vary with;
    `may_vary`: states for which this is not decided; `strays`: later states that the row may depend on as well;
    `slope`: the partial derivative of `row` by `state`; `sloped`: whether it is not identically zero. `affine`,
    `sloped` are None where not decided.
    """

    name: str
    row: sp.Expr
    state: sp.Symbol
    gain: sp.Expr
    offset: sp.Expr
    affine: bool | None
    varies: tuple[sp.Symbol, ...]
    may_vary: tuple[sp.Symbol, ...]
    strays: tuple[sp.Symbol, ...]
    slope: sp.Expr
    sloped: bool | None

    @property
    def jumps(self) -> sp.Expr | None:
        """A part of the row that may jump with `state`, such as sign(), whose partial derivative misses the jump; None
        without one."""
        rough = () if self.affine else (node for node in with_norms(self.row).atoms(*JUMPS) if node.has(self.state))
        return min(rough, key=str, default=None)

    def answer(self, shape: Shape, measured: sp.Symbol | None = None) -> Answer:
        """Return whether the link has the shape (CONSTANT, MEASURED or UNIFORM), and the reason. `measured`: the state
        z_1, which a gain of the shape MEASURED may vary with."""
        if shape is Shape.UNIFORM:
            if self.sloped is False:
                return False, because("{link} with a slope that is zero", link=self._reason)
            if self.strays:
                return None, self._straying
            unproved = because("{link} with a slope that is not shown to differ from zero", link=self._reason)
            return (True, self._reason) if self.sloped else (None, unproved)
        allowed = {measured} if shape is Shape.MEASURED else set()
        varies = [x for x in self.varies if x not in allowed]
        doubtful = [x for x in self.may_vary if x not in allowed]
        if varies and (self.affine is not False or self.slope.has(*varies)):
            pattern = "{link} with a slope that varies with {states}, {slope}; it may vary with {allowed}"
            return False, because(pattern, link=self._reason, states=varies, slope=self.slope, allowed=shape.value)
        if self.affine is False:
            return False, because("{link} in a way that is not linear", link=self._reason)
        if self.strays:
            return None, self._straying
        if doubtful:
            pattern = "{link} with a slope that may vary with {states}, {slope}"
            return None, because(pattern, link=self._reason, states=doubtful, slope=self.slope)
        if self.affine is None:
            return None, because("{link} in a way that is not shown to be linear", link=self._reason)
        return True, self._reason

    @property
    def _reason(self) -> Reason:
        return because("{row} brings in {state}", row=self.name, state=self.state)

    @property
    def _straying(self) -> Reason:
        return because("{link}, and {states} with it as far as is known", link=self._reason, states=self.strays)


@dataclass(frozen=True)
class Chains:
    """The states in triangular order: for each output the `links` of a chain y -> z_1 -> z_2 .., in which the rate of
    z_i depends on z_(i+1) next.

    `broken`: the reason why the chains do not reach every state, or `NONE`; `certain`: whether it is proved that no
    other order of states exists.
    """

    links: tuple[tuple[Link, ...], ...]
    broken: Reason = NONE
    certain: bool = True

    @property
    def order(self) -> tuple[sp.Symbol, ...]:
        """The states z in the order of the chains, one chain after the other."""
        return tuple(link.state for links in self.links for link in links)

    @property
    def blocks(self) -> tuple[int, ...]:
        """The length of each chain."""
        return tuple(map(len, self.links))

    def answer(self, shape: Shape) -> Answer:
        """Return whether all links have the `shape` and the chains contain all states (True, False, or None where not
        decided), and the reason."""
        unproved = NONE
        for links in self.links:
            for i, link in enumerate(links):
                answer, why = link.answer(shape if i or shape is Shape.UNIFORM else Shape.CONSTANT, links[0].state)
                if answer is False:
                    return (False if self.certain else None), why
                unproved = unproved or (NONE if answer else why)
        if self.broken:
            return (False if self.certain else None), self.broken
        if unproved:
            return None, unproved
        names = ([links[0].name, *(link.state.name for link in links)] for links in self.links if links)
        return True, because("{chains: and }", chains=[because("{names: -> }", names=each) for each in names])


def levelwise(rows: Rows) -> Chains:
    """Return a chain of states for each output, built level by level. The rate of a state may depend on the next state
    of its own chain, and on the states of its own and all earlier levels in every chain. With one output this is the
    triangular form.

    The order is forced. A rate with one new state must have this state as its next; a rate without a new state ends its
    chain; a rate with several new states, or two rates with the same next state, leave no order at all.
    """
    remaining, chains = list(rows.states), [list[Link]() for _ in rows.output]
    active = dict(enumerate(zip(rows.names, rows.output, strict=True)))
    certain, single = True, len(rows.output) == 1

    def broken(why: Reason, sure: bool = True) -> Chains:
        return Chains(tuple(map(tuple, chains)), why, certain and sure)

    while remaining:
        links: dict[int, Link] = {}
        for j, (name, row) in active.items():
            sure, maybe = rows.reads(row, remaining)
            if single and not sure and not maybe:  # the gain is 0 at the parameters' values, which its check reports
                sure = dependence(row, remaining)[0]
            if stop := _stop(name, sure, maybe, remaining, single or not chains[j]):
                return broken(*stop)
            if sure or maybe:
                certain = certain and (bool(sure) or single)
                links[j] = link(name, row, (*sure, *maybe), rows)
        no_row = NONE if links else because("no equation brings in {states}", states=remaining)
        if end := shared_state(links.values()) or no_row:
            return broken(end)
        for j, new in links.items():
            chains[j].append(new)
            remaining.remove(new.state)
        active = {j: (f"{new.state}'", rows.rate(new.state)) for j, new in links.items()}
    return Chains(tuple(map(tuple, chains)), certain=certain)


def _stop(
    name: str, sure: Sequence[sp.Symbol], maybe: Sequence[sp.Symbol], remaining: Sequence[sp.Symbol], must: bool
) -> tuple[Reason, bool] | None:
    """Return why a chain of integrators ends at the equation called `name`, and whether
    this is proved; None if it goes on. `sure`, `maybe`: the new states that the
    equation depends on, or may depend on; `remaining`: states in no chain yet."""
    if len(sure) > 1:
        pattern = "{row} brings in {states} together, and each equation may bring in only one new state"
        return because(pattern, row=name, states=sure), True
    if not sure and len(maybe) > 1:
        return because("{row} may bring in {states}, and none is shown to matter", row=name, states=maybe), False
    if must and not sure and not maybe:
        pattern = "{row} brings in no new state, so the output never shows {states}"
        return because(pattern, row=name, states=remaining), True
    return None


def link(name: str, row: sp.Expr, new: Sequence[sp.Symbol], rows: Rows) -> Link:
    """Return the `Link` of the equation `row`, called `name`, to the first of its `new` states; the others are its
    strays."""
    state, strays = new[0], tuple(new[1:])
    clean = free_of(row, [x for x in rows.states if x not in new], rows.box)
    slope = slope_of(clean, state)
    gain, offset, affine = _line(row, clean, state, slope, rows)
    varies, may_vary = rows.reads(gain, rows.states)
    if affine is False and not varies:
        varies = (state,)
    flat = is_zero(slope, rows.box)
    sloped = None if flat is None else not flat
    return Link(name, row, state, gain, offset, affine, varies, may_vary, strays, slope, sloped)


def _line(
    row: sp.Expr, clean: sp.Expr, state: sp.Symbol, slope: sp.Expr, rows: Rows
) -> tuple[sp.Expr, sp.Expr, bool | None]:
    """Return gain, offset, and whether row = gain * state + offset with both free of `state`.
    `clean`: the row without the states that it does not depend on. The gain is the partial
    derivative, if it is exact, else the difference of the row between state = 0 and 1."""
    gain = without_norms(free_of(slope, rows.states, rows.box))
    start, end = (_at(clean, state, value) for value in (0, 1))
    # row - gain * state is the same at every value of the state: at 0, or where that is 0/0 at 1, 2 or 3
    offsets = (_at(clean, state, value) - gain * value for value in range(4))
    offset = next((e for e in offsets if not e.has(*_INFINITE)), clean - gain * state)
    lines = [(gain, offset), (end - start, start)]
    for a, b in lines:
        if not (a.has(state, *_INFINITE) or b.has(state, *_INFINITE)) and is_zero(row - a * state - b, rows.box):
            return a, b, True
    # are there three values of the state, all else equal, at which the row is not on a line?
    a, b = (sp.Dummy(name, real=state.is_real) for name in ("a", "b"))
    ends = {s: rows.box[state] for s in (a, b) if state in rows.box}
    one, other = row.xreplace({state: a}), row.xreplace({state: b})
    curvature = (row - one) * (b - state) - (other - row) * (state - a)
    return gain, offset, False if is_zero(curvature, {**rows.box, **ends}) is False else None


def _at(row: sp.Expr, state: sp.Symbol, value: int) -> sp.Expr:
    at_value = substituted(row, {state: sp.Integer(value)})
    return sp.nan if at_value is None else at_value


def shared_state(links: Iterable[Link]) -> Reason:
    """Return a reason that names two links to the same state, the first such pair; `NONE` if all differ."""
    by_state: dict[sp.Symbol, Link] = {}
    for later in links:
        first = by_state.setdefault(later.state, later)
        if first is not later:
            pattern = "{row} and {other} bring in the same state, {state}"
            return because(pattern, row=first.name, other=later.name, state=later.state)
    return NONE


# ---------------------------------------------------------------- several outputs, one after the other or by their ends


def cascade(rows: Rows, shape: Shape = Shape.CONSTANT) -> Chains:
    """Return a chain of states for each output, one chain after the other, with links of the shape. The rate of a state
    may depend on all states of earlier chains, on the states of its own chain up to itself, and on the next state. The
    first state of another output is no next state.

    The search is greedy: a chain is chosen as soon as it can be followed to its end. This is exact. The rates in chosen
    chains depend on states of chosen chains only. With more states chosen, a chain that could be followed before still
    can: a prefix of it remains, and the states after the prefix are chosen already. So if some order of the chains
    works, the first chain in it that is not chosen yet can be chosen next.
    """
    first = _heads(rows)
    if isinstance(first, Chains):
        return first
    states, chosen = {head.state for head in first}, list[sp.Symbol]()
    done: dict[int, tuple[Link, ...]] = {}
    while len(done) < len(first):
        tries = {j: _path(head, states, chosen, rows, shape) for j, head in enumerate(first) if j not in done}
        ready = next((j for j, tried in tries.items() if not tried[1]), None)
        if ready is None:
            links = tuple(done.get(j, tries[j][0] if j in tries else ()) for j in range(len(first)))
            return Chains(links, next(iter(tries.values()))[1], all(tried[2] for tried in tries.values()))
        done[ready] = tries[ready][0]
        chosen += [each.state for each in done[ready]]
    unreached = [x for x in rows.states if x not in chosen]
    links = tuple(done[j] for j in range(len(first)))
    return Chains(links, because("no equation brings in {states}", states=unreached) if unreached else NONE)


def _heads(rows: Rows) -> list[Link] | Chains:
    heads = []
    for name, row in zip(rows.names, rows.output, strict=True):
        sure, maybe = rows.reads(row, rows.states)
        if len(sure) > 1:
            pattern = "{output} brings in {states} together, and an output may read one state"
            return Chains((), because(pattern, output=name, states=sure))
        if not maybe and not sure:
            return Chains((), because("{output} shows no state", output=name))
        if not sure:
            return Chains((), because("{output} may not show {state}", output=name, state=maybe[0]), certain=False)
        heads.append(link(name, row, (*sure, *maybe), rows))
    both = shared_state(heads)
    return Chains((), both) if both else heads


def _path(
    head: Link, heads: set[sp.Symbol], chosen: Sequence[sp.Symbol], rows: Rows, shape: Shape
) -> tuple[tuple[Link, ...], Reason, bool]:
    links = [head]
    while True:
        state = links[-1].state
        in_path = [each.state for each in links]
        sure, maybe = rows.reads(rows.rate(state), [x for x in rows.states if x not in (*chosen, *in_path)])
        if not sure and not maybe:
            return tuple(links), NONE, True
        if len(sure) > 1:
            return tuple(links), because("{state}' brings in {states} together", state=state, states=sure), True
        if not sure:
            return tuple(links), because("{state}' may bring in {states}", state=state, states=maybe), False
        if sure[0] in heads:
            pattern = "{state}' brings in {next}, which another output starts with"
            return tuple(links), because(pattern, state=state, next=sure[0]), True
        links.append(link(f"{state}'", rows.rate(state), (*sure, *maybe), rows))
        answer, why = links[-1].answer(shape, head.state)
        if not answer:
            return tuple(links), why, answer is False


def end_aligned(rows: Rows) -> Chains:
    """Return chains aligned at their ends: x_(i,j)', the rate of state j of chain i (n_i states), depends on its next
    state, and otherwise on x_(k,l) only for l <= j + n_k - n_i.

    The lengths of the chains decide which states a rate may depend on, so the order is not forced. The search tries the
    chains level by level, one after the other, and in two sweeps over all outputs. Chains that result are proved; a
    search without success refutes nothing.

    Source: N. Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5.
    """
    why = NONE
    outputs = range(len(rows.output))
    sweeps = (partial(_swept, priority=order) for order in (outputs, outputs[::-1]))
    searches: list[Callable[[Rows], Chains]] = [levelwise, cascade, *sweeps]
    for search in searches:
        chains = search(rows)
        answer, reason = chains.answer(Shape.CONSTANT)
        late = _too_late(chains, rows) if answer else reason
        if not late:
            return chains
        why = why or late
    return Chains((), because("no chains aligned at their ends were found: {why}", why=why), certain=False)


def _too_late(chains: Chains, rows: Rows) -> Reason:
    """Return a reason naming the first rate x_(i,j)' that may
    depend on x_(k,l), l > j + n_k - n_i; else `NONE`."""
    sizes = chains.blocks
    place = {each.state: (k, i) for k, links in enumerate(chains.links) for i, each in enumerate(links, 1)}
    for state, (i, j) in place.items():
        following = [x for x, (k, level) in place.items() if k == i and level == j + 1]
        late = [x for x, (k, level) in place.items() if level > j + sizes[k] - sizes[i] and x not in following]
        sure, maybe = rows.reads(rows.rate(state), late)
        if sure or maybe:
            pattern = "{state}' depends on {states}, nearer to the end of its chain"
            return because(pattern, state=state, states=(*sure, *maybe))
    return NONE


def _swept(rows: Rows, priority: Sequence[int]) -> Chains:
    """Return chains of integrators that grow by one state each in sweeps over all outputs, in the
    order `priority`. A rate with several new states waits until no other chain can be extended: the
    rates of a long chain depend on states far from the ends, the last rate of a chain on any state."""
    heads = _heads(rows)
    if isinstance(heads, Chains):
        return heads
    chains = [[head] for head in heads]
    remaining = [x for x in rows.states if x not in {head.state for head in heads}]
    waiting: set[int] = set()
    while remaining:
        extended = [j for j in priority if j not in waiting and _extended(chains[j], remaining, rows, waiting, j)]
        if not extended and not any(_extended(chains[j], remaining, rows, set(), j) for j in sorted(waiting)):
            why = because("no equation brings in {states}", states=remaining)
            return Chains(tuple(map(tuple, chains)), why, certain=False)
    return Chains(tuple(map(tuple, chains)), certain=False)


def _extended(links: list[Link], remaining: list[sp.Symbol], rows: Rows, waiting: set[int], j: int) -> bool:
    state = links[-1].state
    sure, maybe = rows.reads(rows.rate(state), remaining)
    if len(sure) + len(maybe) > 1:
        waiting.add(j)
    if len(sure) != 1 or maybe:
        return False
    links.append(link(f"{state}'", rows.rate(state), sure, rows))
    remaining.remove(sure[0])
    return True


# ---------------------------------------------------------------- checks


def without_jumps(check: Check, link: Link) -> Check:
    """Return the `check` about a link's partial derivative, with the verdict unknown instead of proved where the row
    may jump with its state: a derivative of one sign then does not make the row one to one."""
    if check.verdict is not Verdict.PROVED or link.jumps is None:
        return check
    pattern = "{row} may jump with {state}, at a step of {part}, where it has no slope"
    reason = because(pattern, row=link.name, state=link.state, part=link.jumps)
    fix = f"Narrow the range of {link.state} to one branch, or smooth the step."
    return replace(check, verdict=Verdict.UNKNOWN, reason=reason, fix=fix, subject=None, proofs=())


def structure(maker: str, claim: str, answer: Answer, fix: str) -> Check:
    """Return the check `MAKER.structure`, that a plant's states form chains, with the verdict and the reason in
    `answer`. `maker`: the form's name; `claim`: the text; `fix`: the remedy."""
    is_so, why = answer
    verdict = Verdict.PROVED if is_so else Verdict.UNKNOWN if is_so is None else Verdict.REFUTED
    proofs = (ByForm(),) if is_so else ()
    return Check(ClaimId(maker, "structure"), claim, verdict, why, fix="" if is_so else fix, proofs=proofs)


def affecting_states(rows: Rows, *, sure: bool = False) -> list[sp.Symbol]:
    """Return the states that affect an output, directly or through rates and constraints, or for which this is not
    decided; with `sure` only those proved to do so."""

    def read(row: sp.Expr) -> tuple[sp.Symbol, ...]:
        known, maybe = rows.reads(row, rows.states)
        return tuple(x for x in rows.states if x in known or (x in maybe and not sure))

    order = list(dict.fromkeys(x for row in rows.output for x in read(row)))
    for x in order:  # it grows while it is read
        of_x = [rows.rate(x), *(c for c in rows.constraints if x in read(c))]
        order.extend(dict.fromkeys(other for row in of_x for other in read(row) if other not in order))
    return order


def connected(maker: str, hidden: Sequence[sp.Symbol], doubtful: Sequence[sp.Symbol] = ()) -> Check:
    """Return the check `MAKER.connected`, that every state affects an output directly or through rates. It is refuted
    by `hidden` states, which affect none, and unknown for `doubtful` ones."""
    id = ClaimId(maker, "connected")
    claim = "every state appears in an output, or in the equation of a state that is reached from an output"
    if not hidden and doubtful:
        reason = because("it is not proved that {states} affects the equation in which it appears", states=doubtful)
        return Check(id, claim, Verdict.UNKNOWN, reason)
    if not hidden:
        return Check(id, claim, Verdict.PROVED, because("by following dependencies from the outputs"))
    names = ", ".join(x.name for x in hidden)
    fix = f"Leave {names} out of the model, or measure something that depends on it."
    return Check(id, claim, Verdict.REFUTED, because("no output ever shows {states}", states=hidden), fix=fix)


def cut_off_check(maker: str, plant: System) -> tuple[Check, ...]:
    """Return the refuted check `MAKER.connected`, as the only entry, for a plant with states that affect no output; ()
    for any other."""
    visible = affecting_states(of_plant(plant))
    hidden = [x for x in plant.states if x not in visible]
    return (connected(maker, hidden),) if hidden else ()


# ---------------------------------------------------------------- affine


@dataclass(frozen=True)
class Affine:
    """An expression written as an affine function sum_k slopes[k] x_k + offset of states x, `slopes` and `offset` free
    of them. `answer`: whether this equality is proved (True), refuted (False) or neither (None); `why`: the reason."""

    slopes: tuple[sp.Expr, ...]
    offset: sp.Expr
    answer: bool | None = True
    why: Reason = NONE


@dataclass(frozen=True)
class Measurement:
    """A state that is measured by an output of it alone: y_output = gain * x_state + offset, `output` and `state` by
    index, `gain` and `offset` free of states, |gain| >= m > 0 on the box."""

    state: int
    output: int
    gain: sp.Expr
    offset: sp.Expr


def affine(name: str, row: sp.Expr, states: Sequence[Signal], rows: Rows) -> Affine:
    """Return the expression `row`, called `name`, as an affine function of the states. It is refuted if a partial
    derivative or the offset is proved to vary with one of the states, and proved if none does."""
    none, slopes, offset, may = (sp.S.Zero,) * len(states), [], with_norms(row), list[sp.Symbol]()
    for x in states:
        sure, maybe = rows.reads(row, (x,))
        gain = free_of(slope(row, x), states, rows.box) if sure or maybe else sp.S.Zero
        varies, may_vary = rows.reads(gain, states)
        if varies:
            pattern = "{name} has the slope {gain} in {state}, which varies with {states}"
            return Affine(none, row, False, because(pattern, name=name, gain=gain, state=x, states=varies))
        may += may_vary
        slopes.append(gain)
        offset -= gain * x
    offset = free_of(sp.expand(offset), states, rows.box)
    sure, maybe = rows.reads(offset, states)
    if sure:
        return Affine(none, row, False, because("{name} is not affine in {states}", name=name, states=sure))
    doubtful = list(dict.fromkeys((*may, *maybe)))
    if doubtful:
        why = because("{name} is not shown to be affine in {states}", name=name, states=doubtful)
        return Affine(tuple(slopes), offset, None, why)
    return Affine(tuple(slopes), offset)


_GAIN = ClaimId("state_affine", "gain")  # of which the verdict alone is read


def measurements(plant: System) -> tuple[Measurement, ...]:
    """Return the measured states: those with an output y_j = gain * x_i + offset of this state alone, each with the
    first such output."""
    rows, by_state = of_plant(plant), dict[int, Measurement]()
    for j, (name, row) in enumerate(zip(rows.names, rows.output, strict=True)):
        line = affine(name, row, plant.states, rows)
        read = [(k, gain) for k, gain in enumerate(line.slopes) if gain != 0]
        if line.answer and len(read) == 1 and nonzero_slope(_GAIN, "c", read[0][1], plant).verdict is Verdict.PROVED:
            by_state.setdefault(read[0][0], Measurement(read[0][0], j, read[0][1], line.offset))
    return tuple(by_state.values())


def with_measured_states(dynamics: Dynamics) -> Callable[[Graph, Graph, Graph, Graph], Graph]:
    """Return a function (z, u, y, valid) -> z of SX columns (n), (m), (p), (p) that replaces the estimates of measured
    states by the values computed from valid outputs. The form of `dynamics` has the plant's own coordinates."""
    measured = measurements(dynamics.form.system)

    def replaced(z: Graph, u: Graph, y: Graph, valid: Graph) -> Graph:
        values = [z[i] for i in range(dynamics.n)]
        offset = dynamics.output(ca.SX.zeros(dynamics.n), u)
        slope = dynamics.output_jacobian(z, u)
        for one in measured:
            state = (y[one.output] - offset[one.output]) / slope[one.output, one.state]
            values[one.state] = ca.if_else(valid[one.output], state, values[one.state])
        return ca.vertcat(*values)

    return replaced
