"""That the sizes of what enters an error follow from what a user says of it, on the plant's ranges.

    noise         the error of a sample itself
    rounded       half of the steps to which samples are rounded
    late          tau (|y'| + |dy/dz| m): the time by which a sample is taken beside its own
    disturbance   integral of exp(s h J) m over s from 0 to 1, |dF/dz| <= J:   m = |dT/dx| d of d in the plant's rows
    parameters    the same of m = |dF/dp| q, of parameters that are beside the program's by q

z' = F, z = T(x); each |.| is at most what the certificate says of it, shown by bisection. What a method leaves follows
in `remainder` and `left_by_core`, what a program rounds in `rounding`.
"""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from .box import NotShown, covered, ranged
from .context import Context, narrowed, only
from .file import column, matrix, part
from .matrix import Matrix, demand_enough, dot
from .plant_motion import demand_keys
from .slope import no_steeper

_TERMS = 60  # of the exponential's series
_FAST = 20  # up to which norm of h J it is summed
Shares = Mapping[str, Mapping[str, Any]]


def demand_followed(context: Context, h: Fraction, shares: Shares) -> int:
    """That the sizes of shares, by their names, are at least what they follow from; with how many boxes. Raises:
    `NotShown`."""
    n, p, boxes = len(context.z), len(context.form.output), 0
    moved, others = [Fraction(0)] * n, dict[str, tuple[Mapping[str, Any], list[Fraction]]]()
    for name, share in shares.items():
        follows = part(share, "follows", dict)
        keys = _KEYS.get(name, ())
        demand_keys(follows, keys, name)
        if name in _ROWS:
            rows, sizes, seen = _ROWS[name](context, follows)
            each = [dot(row, sizes) for row in rows]
            J = matrix(follows, "steepness", n, n)
            boxes += seen + no_steeper(context.rates, context.z, J, [Fraction(1)] * n, context.form.box)
            demand_enough(name, column(share, "beside", n), _on_its_way(h, J, each))
            moved = [x + y for x, y in zip(moved, each, strict=True)]
        elif keys:
            others[name] = follows, _signless(follows, "sizes", p)
    for name, (follows, sizes) in others.items():
        if name == "late":
            sizes, seen = _late(context, follows, sizes, moved)
            boxes += seen
        least = [size / 2 for size in sizes] if name == "rounded" else sizes
        demand_enough(name, column(shares[name], "samples", p), least)
    return boxes


def _signless(follows: Mapping[str, Any], key: str, count: int) -> list[Fraction]:
    """Numbers that are not negative. Raises: `NotShown`."""
    numbers = column(follows, key, count)
    if min(numbers, default=Fraction(0)) < 0:
        raise NotShown(f"one of its {key} is negative")
    return numbers


def _late(
    context: Context, follows: Mapping[str, Any], sizes: Sequence[Fraction], moved: Sequence[Fraction]
) -> tuple[list[Fraction], int]:
    """tau (speed + |dy/dz| m), and with how many boxes. Raises: `NotShown`."""
    speeds, least, boxes = _signless(follows, "speeds", len(sizes)), list[Fraction](), 0
    for j, (tau, speed) in enumerate(zip(sizes, speeds, strict=True)):
        if not tau:
            least.append(tau)
            continue
        context.demand_seen(j)
        slope = context.output_slope(j)
        only(context.form.output[j].names & set(context.file.inputs), (), "a late output")
        i = context.z.index(context.seen[j])
        most, row = speed / abs(slope), context.rates[i]
        boxes += covered(narrowed(context.form.box, row.names), ".", ranged(row, -most, most))
        least.append(tau * (speed + abs(slope) * moved[i]))
    return least, boxes


def _by_disturbance(context: Context, follows: Mapping[str, Any]) -> tuple[Matrix, list[Fraction], int]:
    """|dT/dx| and the disturbances. Raises: `NotShown`."""
    names, T = context.plant.states, context.form.to_form
    sizes = _signless(follows, "sizes", len(names))
    rows = matrix(follows, "rows", len(T), len(names))
    return rows, sizes, no_steeper(T, names, rows, sizes, context.plant.box)


def _by_parameters(context: Context, follows: Mapping[str, Any]) -> tuple[Matrix, list[Fraction], int]:
    """|dF/dp| and by how much the parameters are beside. Raises: `NotShown`."""
    form, names = context.form, context.file.parameters
    sizes = _signless(follows, "sizes", len(names))
    wrong = {name: size for name, size in zip(names, sizes, strict=True) if size}
    for text in (*form.to_form, *form.from_form, *form.output):
        only(text.names & set(wrong), (), "a coordinate or an output")
    rows = matrix(follows, "rows", len(context.z), len(names))
    box = {**form.box, **{name: (form.box[name][0] - size, form.box[name][1] + size) for name, size in wrong.items()}}
    return rows, sizes, no_steeper(context.rates, names, rows, sizes, box)


def _on_its_way(h: Fraction, J: Matrix, moved: Sequence[Fraction]) -> list[Fraction]:
    """At least the sum of (h J)^k m/(k + 1)! over all k. Raises: `NotShown`."""
    if any(x < 0 for row in J for x in row):
        raise NotShown("one of its steepness is negative")
    norm = h * max((sum(row, Fraction(0)) for row in J), default=Fraction(0))
    if norm > _FAST:
        raise NotShown("the plant is too fast for its dt")
    term, total = list(moved), list(moved)
    for k in range(2, _TERMS + 2):
        exact = [h * dot(row, term) / k for row in J]
        term = [Fraction(-(-x.numerator * 2**_BITS // x.denominator), 2**_BITS) for x in exact]  # or a little above
        total = [x + y for x, y in zip(total, term, strict=True)]
    left = max(term, default=Fraction(0))  # each term that is left out is at most half of the one before
    return [x + left if x > at_first else x for x, at_first in zip(total, moved, strict=True)]


_BITS = 400
_KEYS: Mapping[str, tuple[str, ...]] = {
    "noise": ("sizes",),
    "rounded": ("sizes",),
    "late": ("sizes", "speeds"),
    "disturbance": ("sizes", "rows", "steepness"),
    "parameters": ("sizes", "rows", "steepness"),
}
_ROWS: Mapping[str, Callable[..., tuple[Matrix, list[Fraction], int]]] = {
    "disturbance": _by_disturbance,
    "parameters": _by_parameters,
}
