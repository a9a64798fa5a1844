"""Labelled systems with two and three outputs: level-wise, cascade, both, neither, and bent level-wise.

Chains z_{i,j}, j = 1..n_i, y_i = c z_{i,1}. Level-wise: row (i, j) uses levels up to j of every chain and a(u) times
its own next. Cascade: all states of earlier chains and its own up to j. Heads are forced by the outputs.
"""

import random
from functools import cache
from typing import Any

import sympy as sp

from tests.scramble import PLAIN_BOXES, SCALES, Labelled, number, scaled, touches, written
from tests.scramble_tables import BENDS, CONSTANT, INPUT, SMOOTH, STATE_NAMES, Gain

LENGTHS = ((1, 1), (2, 1), (2, 2), (3, 2), (1, 3), (2, 2, 1), (1, 2, 2))
KINDS = ("levelwise", "cascade", "both", "neither", "bent", "levelwise", "cascade", "bent")
State = tuple[int, int]


@cache
def several(seed: int = 0, count: int = 40) -> tuple[Labelled, ...]:
    """Systems of each kind in turn."""
    kinds = [(k, KINDS[k % len(KINDS)]) for k in range(count)]
    return tuple(_system(random.Random(f"{seed} several {k}"), kind, f"several_{kind}_{k}") for k, kind in kinds)


def _couplings(rng: random.Random, kind: str, lengths: tuple[int, ...]) -> dict[State, list[str]]:
    """What each row uses besides its next state, such that the kind holds and, for one kind, the other does not."""
    every = [(i, j) for i, n in enumerate(lengths) for j in range(n)]
    allowed = {
        "levelwise": lambda a, b: b[1] <= a[1],
        "bent": lambda a, b: b[1] <= a[1],
        "cascade": lambda a, b: b[0] < a[0] or (b[0] == a[0] and b[1] <= a[1]),
        "both": lambda a, b: b[0] == a[0] and b[1] <= a[1],
        "neither": lambda a, b: b[1] <= a[1],
    }[kind]
    rests: dict[State, list[str]] = {}
    for row in every:
        usable = [_name(*other) for other in every if allowed(row, other)]
        texts = rng.sample(SMOOTH, rng.choice((0, 1, 2)))
        rests[row] = [text.format(p=rng.choice(usable), q=rng.choice(usable)) for text in texts]
    if kind in ("levelwise", "bent", "neither"):  # two heads use each other: no cascade
        rests[0, 0].append("-z1_0")
        rests[1, 0].append("z0_0**2")
    longest = max(range(len(lengths)), key=lambda i: lengths[i])
    if kind == "neither":  # a head uses the second level of another chain
        rests[(longest + 1) % len(lengths), 0].append(f"z{longest}_1/7")
    if kind == "cascade" and max(lengths[:-1]) > 1:
        deep = next(i for i, n in enumerate(lengths) if n > 1)
        rests[len(lengths) - 1, 0].append(f"sin(z{deep}_1)")
    return rests


def _name(chain: int, level: int) -> str:
    return f"z{chain}_{level}"


def _system(rng: random.Random, kind: str, name: str) -> Labelled:
    lengths = rng.choice([one for one in LENGTHS if kind not in ("neither", "bent") or max(one) > 1])
    every = [(i, j) for i, n in enumerate(lengths) for j in range(n)]
    rests = _couplings(rng, kind, lengths)
    boxes: dict[str, Any] = {_name(*state): rng.choice(PLAIN_BOXES) for state in every}
    clear, inputs, bent = True, 0, False
    for i, j in every:
        if j + 1 == lengths[i]:
            continue
        nxt = _name(i, j + 1)
        if kind == "bent" and not bent:
            bend = rng.choice([one for one in BENDS if set(one.boxes) == {"n"} and "10**9" not in one.text])
            boxes[nxt], bent = bend.boxes["n"], True
            clear &= not touches(Gain("", {}, bend.low, bend.high))
            rests[i, j].append(bend.text.format(n=nxt))
            continue
        gain = rng.choice([one for one in INPUT if set(one.boxes) == {"u"}] if rng.random() < 0.4 else CONSTANT)
        if gain.boxes:
            boxes[f"w{inputs}"], inputs = gain.boxes["u"], inputs + 1
        clear &= not touches(gain)
        rests[i, j].append(f"({gain.text.format(u=f'w{inputs - 1}')})*{nxt}")
    return _scrambled(rng, kind, name, rests, boxes, inputs, _truth(kind, lengths, clear))


def _truth(kind: str, lengths: tuple[int, ...], clear: bool) -> dict[str, bool]:
    levelwise = kind in ("levelwise", "both") or (kind == "cascade" and max(lengths[:-1]) == 1 and None)
    truth = {
        "mimo_levelwise": levelwise if kind != "cascade" or levelwise is not None else None,
        "mimo_cascade": kind in ("cascade", "both"),
        "mimo_uof": clear if kind in ("levelwise", "both", "bent") else None if levelwise is None else False,
    }
    if not clear:  # the definitions do not say whether a gain may vanish
        truth = {key: None if value and key != "mimo_uof" else value for key, value in truth.items()}
    return {key: value for key, value in truth.items() if value is not None}


def _scrambled(
    rng: random.Random,
    kind: str,
    name: str,
    rests: dict[State, list[str]],
    boxes: dict[str, Any],
    inputs: int,
    truth: dict[str, bool],
) -> Labelled:
    every = list(rests)
    order = {_name(*state): f"z{k}" for k, state in enumerate(every)}
    scale = [sp.Rational(rng.choice(SCALES)) for _ in every]
    picked = rng.sample(rng.choice(STATE_NAMES), len(every))
    states = [sp.Symbol(one) for one in picked]
    reading = {key: states[k] / scale[k] for k, key in enumerate(order)}
    reading |= {f"w{k}": sp.Symbol(f"u_{k}") for k in range(inputs)}
    place, heads = rng.sample(range(len(every)), len(every)), [k for k, state in enumerate(every) if state[1] == 0]
    rng.shuffle(heads)
    flow = [written(rng, rests[state], reading, scale[k]) for k, state in enumerate(every)]
    model = {
        "name": name,
        "kind": kind,
        "states": [picked[k] for k in place],
        "unknown_params": [],
        "known_params": [],
        "inputs": [f"u_{k}" for k in range(inputs)],
        "outputs": [f"y{k}" for k in range(len(heads))],
        "f": [flow[k] for k in place],
        "h": [rng.choice(("{}", "-{}", "3*{}")).format(picked[k]) for k in heads],
        "x_box": {picked[k]: scaled(boxes[_name(*every[k])], scale, f"z{k}") for k in place},
        "u_box": {f"u_{k}": [_plain(end) for end in boxes[f"w{k}"]] for k in range(inputs)},
    }
    return Labelled(kind, model, truth)


def _plain(end: Any) -> Any:
    return end if not isinstance(end, str) else str(number(end))
