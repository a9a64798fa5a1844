"""Chains for several outputs that are not followed level by level: one after the other, or aligned at their ends."""

from collections.abc import Callable, Sequence
from functools import partial

import sympy as sp

from hgogen.sentence import NONE, Reason, because
from hgogen.structure.chain import Chains, Link, Rows, Shape, levelwise, link, same_state, twice


def cascade(rows: Rows, shape: Shape = Shape.CONSTANT) -> Chains:
    """A chain for each output, one after the other: a row reads all states of the chains before, those of its own
    chain up to its own, and its next state; another output's first state is no next.

    Greedy: a chain is taken as soon as it can be followed to its end. That is exact. The states of the chains taken
    are closed, their rows read nothing else. With more states taken, a chain that could be followed before still can: a
    prefix of it remains, and by closedness the rest of it is taken already. So if some order of the chains works, the
    first chain of it that is not taken yet can be taken next.
    """
    first = _heads(rows)
    if isinstance(first, Chains):
        return first
    states, taken = {head.state for head in first}, list[sp.Symbol]()
    done: dict[int, tuple[Link, ...]] = {}
    while len(done) < len(first):
        tries = {j: _path(head, states, taken, rows, shape) for j, head in enumerate(first) if j not in done}
        ready = next((j for j, tried in tries.items() if not tried[1]), None)
        if ready is None:
            links = tuple(done.get(j, tries[j][0] if j in tries else ()) for j in range(len(first)))
            return Chains(links, next(iter(tries.values()))[1], all(tried[2] for tried in tries.values()))
        done[ready] = tries[ready][0]
        taken += [each.state for each in done[ready]]
    left = [x for x in rows.states if x not in taken]
    links = tuple(done[j] for j in range(len(first)))
    return Chains(links, because("no row brings in {states}", states=left) if left else NONE)


def _heads(rows: Rows) -> list[Link] | Chains:
    """The first link of each output, or why there is none."""
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
    both = twice(heads)
    return Chains((), same_state(*both)) if both else heads


def _path(
    head: Link, heads: set[sp.Symbol], taken: Sequence[sp.Symbol], rows: Rows, shape: Shape
) -> tuple[tuple[Link, ...], Reason, bool]:
    """The chain of an output after the states taken, the reason why it stops early or `NONE`, and whether this is
    proved."""
    links = [head]
    while True:
        state = links[-1].state
        own = [each.state for each in links]
        sure, maybe = rows.reads(rows.rate(state), [x for x in rows.states if x not in (*taken, *own)])
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
    """Chains whose row j of chain i reads x_(k, l) only for l <= j + n_k - n_i, and its own next state.

    The lengths decide what a row may read, so the order is not forced. Tried are the chains level by level, those one
    after the other, and two sweeps over all outputs; what is found is proved, what is not found is not refuted.

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
    """The first row that reads, or may read, a state too close to the end of its chain; else `NONE`."""
    sizes = chains.blocks
    place = {each.state: (k, i) for k, links in enumerate(chains.links) for i, each in enumerate(links, 1)}
    for state, (i, j) in place.items():
        following = [x for x, (k, level) in place.items() if k == i and level == j + 1]
        late = [x for x, (k, level) in place.items() if level > j + sizes[k] - sizes[i] and x not in following]
        sure, maybe = rows.reads(rows.rate(state), late)
        if sure or maybe:
            pattern = "{state}' reads {states}, nearer to the end of its chain"
            return because(pattern, state=state, states=(*sure, *maybe))
    return NONE


def _swept(rows: Rows, priority: Sequence[int]) -> Chains:
    """All chains at once, one state each sweep; a row that ever brought in several waits until no other moves on.

    A long chain's rows read what is far from the ends, and so move on first; a last row reads anything.
    """
    heads = _heads(rows)
    if isinstance(heads, Chains):
        return heads
    chains = [[head] for head in heads]
    left = [x for x in rows.states if x not in {head.state for head in heads}]
    waiting: set[int] = set()
    while left:
        moved = [j for j in priority if j not in waiting and _moved(chains[j], left, rows, waiting, j)]
        if not moved and not any(_moved(chains[j], left, rows, set(), j) for j in sorted(waiting)):
            return Chains(tuple(map(tuple, chains)), because("no row brings in {states}", states=left), certain=False)
    return Chains(tuple(map(tuple, chains)), certain=False)


def _moved(links: list[Link], left: list[sp.Symbol], rows: Rows, waiting: set[int], j: int) -> bool:
    """Append the next state of a chain, where its last row brings in exactly one; several make it wait."""
    state = links[-1].state
    sure, maybe = rows.reads(rows.rate(state), left)
    if len(sure) + len(maybe) > 1:
        waiting.add(j)
    if len(sure) != 1 or maybe:
        return False
    links.append(link(f"{state}'", rows.rate(state), sure, rows))
    left.remove(sure[0])
    return True
