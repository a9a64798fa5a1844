"""The families of scrambled chains with one output: what is put into each, and which labels change with it."""

import random
from collections.abc import Callable, Sequence
from functools import cache

from tests.scramble import Chain, Labelled, chain, finish, touches
from tests.scramble_tables import (
    AFFINE,
    BENDS,
    BENT_INPUT,
    CONSTANT,
    HEADS,
    INPUT,
    KINKS,
    LINEAR_IN_DISGUISE,
    MEASURED,
    PARAMETER,
    ZEROS,
    Bend,
    Gain,
)


def size(rng: random.Random) -> int:
    """How many states, mostly few."""
    return rng.choice((2, 2, 3, 3, 3, 4, 5))


def plain(rng: random.Random, table: Sequence[Gain], must: Gain | None = None) -> Chain:
    """Gains of a table, one of which is `must`; mostly constants beside it."""
    gains = [rng.choice(table if rng.random() < 0.4 else CONSTANT) for _ in range(size(rng) - 1)]
    if must:
        gains[rng.randrange(len(gains))] = must
    made = chain(rng, gains)
    push(made)
    return made


def push(made: Chain) -> None:
    """Perhaps an input that drives, affine or not."""
    draw = made.rng.random()
    if draw < 0.4:
        text = made.rng.choice(AFFINE if draw < 0.3 else BENT_INPUT)
        row = made.rng.randrange(made.n)
        made.terms[row].append(text.format(d=made.driven(), **made.met(row)))


def breaks(made: Chain) -> None:
    """No order is left: the labels of the forms are false."""
    made.hidden |= dict.fromkeys(("triangular", "triangular_uy", "uof_structure", "uof"), False)
    made.hidden |= dict.fromkeys(("order", "a_ranges", "gb_uniform", "singular", "lipschitz"))


def gain_of_input(rng: random.Random) -> Chain:
    return plain(rng, INPUT, rng.choice(INPUT))


def gain_of_parameter(rng: random.Random) -> Chain:
    return plain(rng, PARAMETER, rng.choice(PARAMETER))


def gain_constant(rng: random.Random) -> Chain:
    return plain(rng, CONSTANT)


def gain_measured(rng: random.Random) -> Chain:
    must = rng.choice(MEASURED)
    gains: list[Gain | Bend] = [rng.choice(CONSTANT) for _ in range(size(rng) - 1)]
    gains[rng.randrange(len(gains))] = must
    made = chain(rng, gains)
    push(made)
    return made


def bent(rng: random.Random) -> Chain:
    gains: list[Gain | Bend] = [rng.choice(CONSTANT) for _ in range(size(rng) - 1)]
    gains[rng.randrange(len(gains))] = rng.choice(BENDS)
    made = chain(rng, gains)
    push(made)
    return made


def bent_head(rng: random.Random) -> Chain:
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(size(rng) - 1)], head=rng.choice(HEADS))
    push(made)
    return made


def head_of_input(rng: random.Random) -> Chain:
    """y = c(u) z_1 with c away from zero."""
    head = rng.choice([gain for gain in INPUT if not touches(gain)])
    return chain(rng, [rng.choice(CONSTANT) for _ in range(size(rng) - 1)], head=head)


def linear_in_disguise(rng: random.Random) -> Chain:
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(size(rng) - 1)])
    row = rng.randrange(made.n - 1)
    text, slope = rng.choice(LINEAR_IN_DISGUISE)
    made.terms[row][0] = text.format(n=f"z{row + 1}", p=f"z{row}")
    made.slopes[row + 1] = Gain(slope, {}, slope, slope)
    made.hidden |= {"lipschitz": None}
    return made


def cancelling(rng: random.Random) -> Chain:
    """Terms of later states that cancel, in rows that may not use them."""
    made = plain(rng, INPUT)
    for _ in range(rng.choice((1, 2, 3))):
        zero, row = rng.choice(ZEROS), rng.randrange(made.n)
        later = [f"z{k}" for k in range(made.n)]
        made.terms[row].append(zero.text.format(p=rng.choice(later), q=rng.choice(later)))
    made.hidden |= {"lipschitz": None, "gb_uniform": None}
    return made


def not_quite_cancelling(rng: random.Random) -> Chain:
    """The like, but the term is there: row 1 uses z_2 and a later state, or bends z_2 beside z_3."""
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(rng.choice((2, 3)))])
    miss = rng.choice([zero.miss for zero in ZEROS if "{q}" in zero.miss])
    made.terms[0].append(miss.format(p=f"z{made.n - 1}", q="z0"))
    breaks(made)
    return made


def extra_term(rng: random.Random) -> Chain:
    """A row uses a state that comes two or more later, if only a little, or only through a parameter or an input."""
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(rng.choice((2, 3, 4)))])
    row = rng.randrange(made.n - 2)
    later = f"z{rng.randint(row + 2, made.n - 1)}"
    form = rng.choice(("{e}*{l}", "1e-9*{l}", "{c}*{l}", "{d}*{l}", "{l}**3/1000", "{l}*z0", "sin({l})*1e-6"))
    if "{c}" in form:
        made.boxes["c0"], made.parameters = (0, 1), 1
    driven = made.driven() if "{d}" in form else ""
    made.terms[row].append(form.format(e="1e-30", l=later, c="c0", d=driven))
    breaks(made)
    return made


def extra_in_the_last_row(rng: random.Random) -> Chain:
    """The last row may use every state."""
    made = plain(rng, PARAMETER)
    for k in range(made.n):
        made.terms[-1].append(rng.choice(("z{0}**3", "-3*z{0}", "z{0}*z0", "sin(z{0})")).format(k))
    return made


def two_states_in_the_output(rng: random.Random) -> Chain:
    """y mixes two states: uniform observability may hold, no permutation does."""
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(rng.choice((1, 2, 3)))])
    made.head = f"{made.head} + {rng.choice(('1e-9', '1', '-2'))}*z{made.n - 1}"
    breaks(made)
    return made


def broken(rng: random.Random) -> Chain:
    """A row brings in nothing: the states after it are not seen."""
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(rng.choice((1, 2, 3)))])
    made.terms[rng.randrange(made.n - 1)][0] = rng.choice(("0", "1", "z0"))
    breaks(made)
    return made


def gain_of_a_later_state(rng: random.Random) -> Chain:
    """a_2(z_2) z_3: no triangular form, but a uniform one."""
    made = chain(rng, [rng.choice(CONSTANT) for _ in range(rng.choice((2, 3)))])
    gain = rng.choice([one for one in MEASURED if set(one.boxes) == {"f"}])
    made.boxes["z1"] = gain.boxes["f"]
    slope = gain.text.format(f="z1")
    made.terms[1][0] = f"({slope})*z2"
    made.slopes[2], made.kinds[2] = Gain(slope, {}, gain.low, gain.high), "bend"
    return made


def kinked(rng: random.Random) -> Chain:
    """A rest that is Lipschitz, or is not."""
    made = plain(rng, [gain for gain in INPUT if not touches(gain)])
    kink, state = rng.choice(KINKS), rng.randrange(made.n)
    made.boxes[f"z{state}"] = kink.box
    made.terms[rng.randint(state, made.n - 1)].append(
        f"{rng.choice(('1', '-2', '1/5'))}*({kink.text})".format(p=f"z{state}")
    )
    made.hidden |= {"lipschitz": kink.lipschitz, "gb_uniform": None, "singular": None}
    return made


def long(rng: random.Random) -> Chain:
    """Ten states."""
    made = chain(rng, [rng.choice(CONSTANT + PARAMETER) for _ in range(9)])
    made.hidden |= {"singular": None}
    return made


FAMILIES: tuple[tuple[Callable[[random.Random], Chain], int], ...] = (
    (gain_constant, 10),
    (gain_of_input, 60),
    (gain_of_parameter, 15),
    (gain_measured, 25),
    (bent, 30),
    (bent_head, 10),
    (head_of_input, 8),
    (linear_in_disguise, 10),
    (cancelling, 30),
    (not_quite_cancelling, 12),
    (extra_term, 20),
    (extra_in_the_last_row, 8),
    (two_states_in_the_output, 6),
    (broken, 6),
    (gain_of_a_later_state, 8),
    (kinked, 40),
    (long, 2),
)


@cache
def singles(seed: int = 0) -> tuple[Labelled, ...]:
    """Every family with one output; the last of each without boxes."""
    return tuple(_single(family, count, k, seed) for family, count in FAMILIES for k in range(count))


def _single(family: Callable[[random.Random], Chain], count: int, k: int, seed: int) -> Labelled:
    name = f"{family.__name__}_{k}"
    rng = random.Random(f"{seed} {name}")
    return finish(family(rng), family.__name__, name, boxed=k < max(count - count // 8, 1))
