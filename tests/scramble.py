"""Labelled systems: known forms, scrambled by order, sign, scale and terms that cancel, with the truth by construction.

A chain z_i' = F_i(z_1..z_{i+1}, u) is written down with the exact range of each slope; then x_j = s_j z_j are given
other names, another order and texts that hide the structure. The order of a chain is forced (y shows one state, its
row the next), so that a term that breaks a row breaks every order, and the labels follow.
"""

import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import sympy as sp

from tests.oracle.text import read
from tests.scramble_tables import (
    INPUT_NAMES,
    PARAMETER_NAMES,
    QUERIES,
    SMOOTH,
    STATE_NAMES,
    ZEROS,
    Bend,
    Boxes,
    End,
    Gain,
)

Number = sp.Expr
SCALES = ("1", "1", "-1", "2", "-1/2", "1/3", "-7/5", "10", "1/64", "-250")
PLAIN_BOXES: tuple[tuple[End, End], ...] = (
    (-1, 1),
    (-2, 3),
    ("-pi", "pi/3"),
    (0, 2),
    (-10, 5),
    ("1/3", 4),
    (-0.5, 0.7),
)


@dataclass(frozen=True)
class Labelled:
    """A model as the library reads it, and the fields whose truth is known.

    `truth["a_ranges"]` and `truth["bounds"]` are pairs of SymPy numbers, `truth["singular"]` is "none", "all" or an
    expression of the states; a field that is not there has no label.
    """

    kind: str
    model: dict[str, Any]
    truth: dict[str, Any]

    @property
    def name(self) -> str:
        """The model's name."""
        return str(self.model["name"])


@dataclass
class Chain:
    """A chain under construction, in the states z0, z1, ...; texts are in z, w (inputs) and c (parameters)."""

    rng: random.Random
    n: int
    inputs: int = 0
    parameters: int = 0
    boxes: dict[str, tuple[End, End]] = field(default_factory=dict)
    terms: list[list[str]] = field(default_factory=list)
    slopes: list[Gain] = field(default_factory=list)  # head, then the row of each state but the last
    kinds: list[str] = field(default_factory=list)  # of each slope: "gain", "measured" or "bend"
    head: str = "z0"
    drive: str = ""
    hidden: dict[str, Any] = field(default_factory=dict)  # labels that a family sets, None: no label

    def letters(self, boxes: Boxes, **states: str) -> dict[str, str]:
        """A new input or parameter for each letter that has a box; the boxes of states are set."""
        names = dict(states)
        for letter, box in boxes.items():
            if letter in "uv":
                names[letter], self.inputs = f"w{self.inputs}", self.inputs + 1
            elif letter in "km":
                names[letter], self.parameters = f"c{self.parameters}", self.parameters + 1
            self.boxes[names[letter]] = box
        return names

    def driven(self) -> str:
        """The input that drives, made where there is none yet."""
        if not self.drive:
            self.drive, self.inputs = f"w{self.inputs}", self.inputs + 1
            self.boxes[self.drive] = self.rng.choice(PLAIN_BOXES)
        return self.drive

    def met(self, row: int) -> dict[str, str]:
        """Two of the states that row `row` may use."""
        return {letter: f"z{self.rng.randint(0, row)}" for letter in "pq"}


def chain(rng: random.Random, gains: Sequence[Gain | Bend], *, head: Gain | Bend | None = None) -> Chain:
    """A chain whose row i brings in z_{i+1} by `gains[i]`, with smooth rests of the states before."""
    made = Chain(rng, len(gains) + 1)
    made.terms = [[] for _ in range(made.n)]
    head = head or Gain(rng.choice(("1", "1", "-2", "1/3")), {}, "1", "1")
    made.head = _link(made, head, 0)
    for row, gain in enumerate(gains):
        made.terms[row].append(_link(made, gain, row + 1))
    for row in range(made.n):
        for text in rng.sample(SMOOTH, rng.choice((0, 1, 1, 2))):
            made.terms[row].append(text.format(**made.met(row)))
    return made


def _link(made: Chain, gain: Gain | Bend, target: int) -> str:
    names = made.letters(gain.boxes, n=f"z{target}", f="z0", p=f"z{max(target - 1, 0)}")
    if isinstance(gain, Bend):
        made.slopes.append(Gain(gain.slope.format(**names), {}, gain.low, gain.high))
        made.kinds.append("bend")
        return gain.text.format(**names)
    slope = gain.text.format(**names)
    made.slopes.append(Gain(slope, {}, gain.low, gain.high))
    made.kinds.append("measured" if "f" in gain.boxes else "gain")
    return f"({slope})*z{target}"


@cache
def number(end: End) -> sp.Expr:
    """An end of a box, exactly; a float is its shortest decimal."""
    return read(repr(end) if isinstance(end, float) else end, rational=True)


def touches(gain: Gain) -> bool:
    """Whether the slope is zero somewhere on its closed box."""
    return bool(number(gain.low) <= 0) and bool(number(gain.high) >= 0)


def finish(made: Chain, kind: str, name: str, *, boxed: bool = True) -> Labelled:
    """The chain scrambled, and what is true of it."""
    rng, n = made.rng, made.n
    scale = [sp.Rational(rng.choice(SCALES)) for _ in range(n)]
    pools = (rng.choice(STATE_NAMES), rng.choice(INPUT_NAMES), rng.choice(PARAMETER_NAMES))
    picked = rng.sample(pools[0], n) if n <= 10 else [f"x{k}" for k in range(n)]
    new = {f"z{k}": sp.Symbol(picked[k]) for k in range(n)}
    new |= {f"w{k}": sp.Symbol(pools[1][k] if k < 8 else f"w{k}") for k in range(made.inputs)}
    new |= {f"c{k}": sp.Symbol(pools[2][k] if k < 8 else f"k{k + 1}") for k in range(made.parameters)}
    back = {f"z{k}": new[f"z{k}"] / scale[k] for k in range(n)}
    reading = new | back
    for k in range(n):  # every state has a box
        made.boxes.setdefault(f"z{k}", rng.choice(PLAIN_BOXES))
    place = rng.sample(range(n), n)
    flow = {k: written(rng, made.terms[k], reading, scale[k]) for k in range(n)}
    model: dict[str, Any] = {
        "name": name,
        "kind": kind,
        "states": [picked[k] for k in place],
        "unknown_params": [],
        "known_params": [new[f"c{k}"].name for k in range(made.parameters)],
        "inputs": [new[f"w{k}"].name for k in range(made.inputs)],
        "outputs": ["y"],
        "f": [flow[k] for k in place],
        "h": [written(rng, [made.head], reading, sp.Integer(1))],
    }
    if boxed:
        boxes = {new[key].name: scaled(box, scale, key) for key, box in made.boxes.items()}
        model["x_box"] = {picked[k]: boxes[picked[k]] for k in place}
        model["u_box"] = {u: boxes[u] for u in model["inputs"]}
        model["param_ranges"] = {c: boxes[c] for c in model["known_params"]}
    truth = labels(made, boxed) | made.hidden
    truth = {key: value for key, value in truth.items() if value is not None}
    if "order" in truth:
        truth["order"] = [picked[k] for k in truth["order"]]
        truth["observable_params_known"] = sorted(truth["order"])
        truth["rank_params_known"] = len(truth["order"])
    if "a_ranges" in truth:
        truth["a_ranges"] = [
            tuple(abs(scale[k] / scale[k + 1]) * end for end in pair) for k, pair in enumerate(truth["a_ranges"])
        ]
    if isinstance(truth.get("singular"), sp.Expr):
        truth["singular"] = truth["singular"].subs({sp.Symbol(f"z{k}"): back[f"z{k}"] for k in range(n)})
    return Labelled(kind, model, truth)


def labels(made: Chain, boxed: bool) -> dict[str, Any]:
    """What is true of a chain in its own coordinates, by the definitions of the fields."""
    head, *slopes = made.slopes
    kinds = made.kinds
    gains = kinds[0] == "gain" and all(kind == "gain" for kind in kinds[1:])
    measured = kinds[0] == "gain" and all(kind != "bend" for kind in kinds[1:])
    clear = not any(map(touches, slopes))
    truth: dict[str, Any] = {
        "order": list(range(made.n)),
        "triangular": gains and (clear or not boxed),
        "triangular_uy": (gains or measured) and (clear or not boxed),
        "uof_structure": True,
        "uof": (clear and not touches(head)) if boxed else None,
        "gb_uniform": uniform(made),
        "singular": singular(made),
        "lipschitz": True if boxed and gains else None,
    }
    if boxed and measured:
        truth["a_ranges"] = [magnitude(gain) for gain in slopes]
    return truth


def magnitude(gain: Gain) -> tuple[Number, Number]:
    """The range of |a|."""
    low, high = number(gain.low), number(gain.high)
    if low > 0 or high < 0:
        return (low, high) if low > 0 else (-high, -low)
    return sp.Integer(0), sp.Max(-low, high)


def _inputs(made: Chain) -> list[sp.Symbol]:
    return [sp.Symbol(f"w{k}") for k in range(made.inputs)]


@cache
def _read(text: str) -> sp.Expr:
    """A text in z, w and c, none of which has another meaning."""
    return read(text)


def uniform(made: Chain) -> bool | str | None:
    """`gb_uniform`: with gains free of the input a chain is uniformly observable; with an affine one it is not."""
    inputs = _inputs(made)
    everything = [_read(term) for row in [[made.head], *made.terms] for term in row]
    if not inputs or not everything[0].free_symbols.isdisjoint(inputs):
        return "na"
    if any(sp.diff(e, u, v) != 0 for e in everything for u in inputs for v in inputs):
        return "na"
    slopes = [_read(gain.text) for gain in made.slopes]
    if any(slope.subs(dict.fromkeys(inputs, 0)) == 0 for slope in slopes):
        return None  # the drift alone does not show every state: false, or "na", as one reads it
    return all(slope.free_symbols.isdisjoint(inputs) for slope in slopes)


def singular(made: Chain) -> Any:
    """The determinant of a chain at u = 0 is the product of the powers of its slopes."""
    inputs = _inputs(made)
    product = sp.Integer(1)
    for gain in made.slopes:
        slope = _read(gain.text).subs(dict.fromkeys(inputs, 0))
        if slope.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
            return None
        product *= slope
    if product == 0:
        return "all"
    if any(name.startswith("c") for name in map(str, product.free_symbols)) and not product.has(sp.Symbol("z0")):
        return None  # a parameter alone: whether its zero belongs to the set is a matter of reading
    return "none" if product.is_number else product


def scaled(box: tuple[End, End], scale: Sequence[sp.Rational], key: str) -> list[End]:
    """The box of x_k = s_k z_k, numbers where they are whole or short decimals, else texts."""
    factor = scale[int(key[1:])] if key[0] == "z" else sp.Integer(1)
    ends = sorted((factor * number(end) for end in box), key=float)
    return [int(end) if end.is_Integer else float(end) if _decimal(end) else str(end) for end in ends]


def _decimal(end: sp.Expr) -> bool:
    return bool(end.is_Rational) and number(float(end)) == end


def written(rng: random.Random, terms: Sequence[str], reading: Mapping[str, sp.Expr], factor: sp.Expr) -> str:
    """A row as text: each term in the new names, some multiplied out, in any order; the text is not simplified."""
    texts = []
    for term in rng.sample(list(terms), len(terms)):
        texts.append(renamed(term, reading) if factor == 1 else f"{factor}*({renamed(term, reading)})")
    text = " + ".join(f"({one})" if rng.random() < 0.3 else one for one in texts) or "0"
    return text.replace("+ -", "- ") if rng.random() < 0.5 else text


def renamed(term: str, reading: Mapping[str, sp.Expr]) -> str:
    """A term's text with each name replaced, by text, so that nothing cancels on the way."""
    return re.sub(r"\b([zwc]\d+(?:_\d+)?)\b", lambda name: _bracketed(reading[name[1]]), term)


def _bracketed(expression: sp.Expr) -> str:
    return str(expression) if expression.is_Symbol else f"({expression})"


@cache
def queries(seed: int = 0) -> tuple[Labelled, ...]:
    """Ranges of expressions over the boxes of an integrator chain, each scaled and perhaps with a disguised zero."""
    return tuple(_query(k, seed, *query) for k, query in enumerate(QUERIES))


def _query(k: int, seed: int, text: str, boxes: Sequence[tuple[End, End]], low: End, high: End) -> Labelled:
    rng = random.Random(f"{seed} query {k}")
    names = rng.sample(rng.choice(STATE_NAMES), len(boxes))
    scale = [sp.Rational(rng.choice(SCALES)) for _ in names]
    values = [_bracketed(sp.Symbol(name) / s) for name, s in zip(names, scale, strict=True)]
    hidden = rng.choice(ZEROS[:2]).text.format(p=values[0], q=values[-1]) if k % 7 == 3 else ""
    query = text.format(*values) + (f" + {hidden}" if hidden else "")
    x_box = {name: scaled(box, scale, f"z{i}") for i, (name, box) in enumerate(zip(names, boxes, strict=True))}
    model = {
        "name": f"query_{k}",
        "kind": "query",
        "states": names,
        "unknown_params": [],
        "known_params": [],
        "inputs": [],
        "outputs": ["y"],
        "f": [*names[1:], "0"],
        "h": [names[0]],
        "x_box": x_box,
        "bound_queries": [query],
    }
    truth = {"bounds": [(number(low), number(high))], "triangular": True, "order": names, "uof": True}
    return Labelled("query", model, truth)
