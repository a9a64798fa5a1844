"""What sampling says against the verified claims of a certificate, without the package: numbers of 40 digits, slopes by
small differences, and Python's own reading of the texts."""

import random
import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from types import CodeType
from typing import Any

import mpmath
import numpy as np
from mpmath import mp, mpf

Values = dict[str, Any]
POINTS = 6
STEP = mpf(10) ** -15
TOLERANCE = mpf(10) ** -12
_NUMBER = re.compile(r"(?<![A-Za-z_\d.])\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_KNOWN = {name: getattr(mpmath, name) for name in ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh")}
_KNOWN |= {name: getattr(mpmath, name) for name in ("cosh", "tanh", "asinh", "acosh", "atanh", "atan2", "sign", "pi")}
_KNOWN |= {"Abs": abs, "Min": min, "Max": max, "sqrt": mpmath.sqrt, "mpf": mpf}


def _table(slopes: Callable[[list[Any], list[Any]], list[Any]]) -> Callable[..., Any]:
    """The function of a certificate's table: the cubic through two points with these slopes at its ends, or where there
    are none the line, held beyond the first and the last point; its derivative of order m, of one side where it jumps.
    """

    def at(x: Any, m: Any, *points: Any) -> Any:
        xs, ys = list(points[::2]), list(points[1::2])
        if not xs[0] <= x <= xs[-1]:
            return mpf(0) if m else ys[0] if x < xs[0] else ys[-1]
        k = max(i for i in range(len(xs) - 1) if xs[i] <= x)
        h, d = xs[k + 1] - xs[k], slopes(xs, ys)
        chord = (ys[k + 1] - ys[k]) / h
        first, last = (d[k], d[k + 1]) if d else (chord, chord)
        piece = [ys[k], first, (3 * chord - 2 * first - last) / h, (first + last - 2 * chord) / h**2]
        for _ in range(int(m)):
            piece = [i * c for i, c in enumerate(piece)][1:]
        return sum((c * (x - xs[k]) ** i for i, c in enumerate(piece)), mpf(0))

    return at


def _monotone(xs: list[Any], ys: list[Any]) -> list[Any]:
    """The slopes of PCHIP (Fritsch, Butland 1984)."""
    h = [b - a for a, b in pairwise(xs)]
    chord = [(b - a) / w for (a, b), w in zip(pairwise(ys), h, strict=True)]
    if len(h) == 1:
        return [chord[0], chord[0]]
    inner = [
        mpf(0) if a * b <= 0 else (3 * (g + w)) / ((2 * w + g) / a + (w + 2 * g) / b)
        for (g, w), (a, b) in zip(pairwise(h), pairwise(chord), strict=True)
    ]
    return [_edge(*h[:2], *chord[:2]), *inner, _edge(*h[:-3:-1], *chord[:-3:-1])]


def _edge(h: Any, g: Any, a: Any, b: Any) -> Any:
    """The slope at an end, whose own chord is a of width h."""
    d = ((2 * h + g) * a - h * b) / (h + g)
    if d * a <= 0:
        return mpf(0)
    return 3 * a if a * b <= 0 and abs(d) > 3 * abs(a) else d


def _map(x: Any, y: Any, p: Any, q: Any, n: Any, *numbers: Any) -> Any:
    """The function of a certificate's map: of each row of points the line at y, and of their values the line at x."""
    count = int(n)
    width = (len(numbers) - count) // (count + 1)
    xs, ys, zs = numbers[:count], numbers[count : count + width], numbers[count + width :]
    rows = [zs[k * width : (k + 1) * width] for k in range(count)]
    along = [LINE(y, q, *(each for point in zip(ys, row, strict=True) for each in point)) for row in rows]
    return LINE(x, p, *(each for point in zip(xs, along, strict=True) for each in point))


LINE = _table(lambda xs, ys: [])
TABLES = {"Linear": LINE, "Monotone": _table(_monotone), "Bilinear": _map}
_KNOWN |= TABLES
_GLOBALS = {"__builtins__": {}, **_KNOWN}


def value(text: str, at: Values) -> Any:
    """The value of a text at a point."""
    return mpf(eval(_code(text), _GLOBALS, at))


@cache
def _code(text: str) -> CodeType:
    """Numbers of all digits in the place of Python's."""
    return compile(_NUMBER.sub(lambda m: f'mpf("{m[0]}")', text).strip(), "text", "eval")


def end(text: str | None, infinite: float) -> Any:
    """An end of a range; an infinite one is far off."""
    if text is None:
        return mpf(infinite)
    exact = Fraction(text)
    return mpf(exact.numerator) / exact.denominator


def falsehood(content: dict[str, Any], verified: Sequence[str]) -> str:
    """A sentence on the first verified claim that is false at a point, or ""."""
    with mp.workdps(40):
        sampled = _Sampled(content)
        for claim in content["claims"]:
            if claim["id"] in verified and (contradiction := _said(sampled, claim)):
                return f"{claim['id']}: {contradiction}"
    return ""


def _said(sampled: "_Sampled", claim: dict[str, Any]) -> str:
    """By the first of the patterns that its id has."""
    for pattern, says in _SAYS:
        if match := re.fullmatch(pattern, claim["id"]):
            return says(sampled, claim, tuple(int(each) for each in match.groups() if each))
    return ""


class _Sampled:
    """A certificate at points of the plant's box, and of the form's."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content
        self.plant, self.form = content["plant"], content["form"]
        self.x, self.z = ([s["name"] for s in part["states"]] for part in (self.plant, self.form))
        self.u = [s["name"] for s in self.plant["inputs"]]
        shared = self.plant["inputs"] + self.plant["parameters"]
        self.outer, self.inner = ({s["name"]: s for s in part["states"] + shared} for part in (self.plant, self.form))
        self.draw = random.Random(3)

    def points(self, ranges: dict[str, Any], count: int = POINTS) -> Iterator[Values]:
        """Corners and points between."""
        for _ in range(count):
            at = {}
            for name, s in ranges.items():
                low, high = end(s.get("low"), -50), end(s.get("high"), 50)
                share = self.draw.choice((0, 1, self.draw.random(), self.draw.random()))
                at[name] = low + (high - low) * share
            yield at

    def rates(self, at: Values) -> list[Any]:
        """A z + b."""
        rows = zip(self.form["A"], self.form["b"], strict=True)
        return [
            value(rest, at) + sum(value(entry, at) * at[z] for entry, z in zip(row, self.z, strict=True))
            for row, rest in rows
        ]

    def slope(self, rows: Callable[[Values], Sequence[Any]], at: Values, names: Sequence[str]) -> list[list[Any]]:
        """Derivatives of rows, a row each, by a difference to whichever side is inside."""
        columns = []
        for name in names:
            low, high = ({**at, name: at[name] + side * STEP} for side in (-1, 1))
            columns.append([(b - a) / (2 * STEP) for a, b in zip(rows(low), rows(high), strict=True)])
        return [list(row) for row in zip(*columns, strict=True)]

    def away(self, at: Values, ranges: dict[str, Any]) -> Values:
        """The same point a little inside, so that differences are taken inside the box."""
        moved = {}
        for name, x in at.items():
            low, high = end(ranges[name].get("low"), -50), end(ranges[name].get("high"), 50)
            moved[name] = x + ((low + high) / 2 - x) * mpf("1e-9")
        return moved


def _ranged(s: _Sampled, claim: Any, place: Any) -> str:
    """The form's states keep to their ranges."""
    for at in s.points(s.outer):
        for name, row in zip(s.z, s.form["to_form"], strict=True):
            low, high = end(s.inner[name].get("low"), -1e300), end(s.inner[name].get("high"), 1e300)
            if not low - TOLERANCE <= value(row, at) <= high + TOLERANCE:
                return f"{name} leaves its range"
    return ""


def _inverse(s: _Sampled, claim: Any, place: Any) -> str:
    """The form is the plant."""
    for at in s.points(s.outer):
        at = s.away(at, s.outer)
        z = {**at, **{name: value(row, at) for name, row in zip(s.z, s.form["to_form"], strict=True)}}
        f = [value(row, at) for row in s.plant["flow"]]
        J = s.slope(lambda p: [value(row, p) for row in s.form["to_form"]], at, s.x)
        speeds = [sum(a * b for a, b in zip(row, f, strict=True)) for row in J]
        pairs = [*zip(s.rates(z), speeds, strict=True)]
        pairs += [(value(a, z), value(b, at)) for a, b in zip(s.form["output"], s.plant["output"], strict=True)]
        pairs += [(value(row, z), at[x]) for row, x in zip(s.form["from_form"], s.x, strict=True)]
        if any(abs(a - b) > TOLERANCE * (1 + abs(a)) * 10 for a, b in pairs):
            return "the form is not the plant"
    return ""


def _equations(s: _Sampled, claim: Any, place: Any) -> str:
    """The form is the plant, in ranges that hold it; of ranges a recast claims itself."""
    recast = any(claim["id"] == "recast.range" for claim in s.content["claims"])
    return _inverse(s, claim, place) or ("" if recast else _ranged(s, claim, place))


def _triangular(s: _Sampled, claim: Any, place: Any) -> str:
    """b_i reads z_1 .. z_i, an a_i no state but z_1; of a uniform form row i reads one state more."""
    if contradiction := _equations(s, claim, place):
        return contradiction
    n, uniform = len(s.z), s.form["kind"] == "uniform"
    for at in s.points(s.inner):
        at = s.away(at, s.inner)
        J = s.slope(s.rates if uniform else lambda p: [value(row, p) for row in s.form["b"]], at, s.z)
        if any(abs(J[i][j]) > TOLERANCE for i in range(n) for j in range(i + 1 + uniform, n)):
            return "a row reads a state too early"
        if not uniform and n > 1:
            flat = s.slope(lambda p: [value(entry, p) for row in s.form["A"] for entry in row], at, s.z[1:])
            if any(abs(x) > TOLERANCE for row in flat for x in row):
                return "a gain reads an unmeasured state"
    return ""


def _blocks(s: _Sampled, claim: Any, place: Any) -> str:
    if contradiction := _equations(s, claim, place):
        return contradiction
    sizes = [int(size) for size in s.form["blocks"]]
    places = [(k, i) for k, size in enumerate(sizes) for i in range(size)]
    for at in s.points(s.inner, 3):
        J = s.slope(lambda p: [value(row, p) for row in s.form["b"]], s.away(at, s.inner), s.z)
        for i, (k, level) in enumerate(places):
            for j, (other, deep) in enumerate(places):
                beyond = deep > level if k == other or s.form["alignment"] == "top" else False
                if s.form["alignment"] == "end" and k != other:
                    beyond = deep > level + sizes[other] - sizes[k]
                if beyond and abs(J[i][j]) > TOLERANCE:
                    return "b reads a state that the alignment forbids"
    return ""


def _affine(s: _Sampled, claim: Any, place: Any) -> str:
    return _equations(s, claim, place)


def _coefficient(s: _Sampled, place: tuple[int, ...], at: Values) -> Any:
    chain, index = place if len(place) == 2 else (1, *place)
    head = sum(int(size) for size in s.form["blocks"][: chain - 1])
    if index == 1:
        return s.slope(lambda p: [value(s.form["output"][chain - 1], p)], at, [s.z[head]])[0][0]
    return value(s.form["A"][head + index - 2][head + index - 1], at)


def _gain(s: _Sampled, claim: Any, place: tuple[int, ...]) -> str:
    evidence = claim["evidence"]
    if claim["verdict"] == "refuted":
        at = {**next(s.points(s.inner, 1)), **{name: end(x, 0) for name, x in evidence["witness"].items()}}
        return "it is positive at its witness" if _coefficient(s, place, at) > TOLERANCE else ""
    low, high = end(evidence["low"], 0), end(evidence["high"], 0)
    for at in s.points(s.inner):
        a = _coefficient(s, place, s.away(at, s.inner))
        if not (low > 0 and low - TOLERANCE * (1 + abs(a)) <= a <= high + TOLERANCE * (1 + abs(a))):
            return f"{a} is outside of [{low}, {high}]"
    return ""


def _offset(s: _Sampled, claim: Any, place: tuple[int, ...]) -> str:
    chain = place[0] if place else 1
    head = s.z[sum(int(size) for size in s.form["blocks"][: chain - 1])]
    low, high = (end(claim["evidence"][key], 0) for key in ("low", "high"))
    for at in s.points(s.inner):
        c = value(s.form["output"][chain - 1], {**at, head: mpf(0)})
        if not low - TOLERANCE <= c <= high + TOLERANCE:
            return f"{c} is outside of [{low}, {high}]"
    return ""


def _steep(which: str) -> Callable[[_Sampled, Any, Any], str]:
    def says(s: _Sampled, claim: Any, place: Any) -> str:
        def rows(at: Values) -> list[Any]:
            if which == "b":
                return [value(row, at) for row in s.form["b"]]
            if which == "all":
                return [*s.rates(at), *(value(row, at) for row in s.form["output"])]
            if which == "rates":
                return s.rates(at)
            linear = [
                sum(
                    value(entry, at) * at[z]
                    for entry, z in zip(row, s.z, strict=True)
                    if not any(re.search(rf"\b{name}\b", entry) for name in s.z)
                )
                for row in s.form["A"]
            ]
            return [a - b for a, b in zip(s.rates(at), linear, strict=True)]

        bound = float(end(claim["evidence"]["bound"], 0))
        for at in s.points(s.inner):
            J = np.array(s.slope(rows, s.away(at, s.inner), s.z), dtype=float)
            if np.linalg.norm(J, 2) > bound * (1 + 1e-9) + 1e-9:
                return f"the slope is {np.linalg.norm(J, 2)}, above {bound}"
        return ""

    return says


def _uniform_slope(s: _Sampled, claim: Any, place: tuple[int, ...]) -> str:
    (i,) = place
    evidence = claim["evidence"]

    def rate(at: Values) -> list[Any]:
        return [value(s.form["output"][0], at) if i == 1 else s.rates(at)[i - 2]]

    if claim["verdict"] == "refuted":
        rates = []
        for key in ("witness", "other"):
            if key in evidence:
                at = {**next(s.points(s.inner, 1)), **{name: end(x, 0) for name, x in evidence[key].items()}}
                z = s.z[i - 1]
                for side in (-1, 1):  # a kink has two slopes, and neither is the mean
                    there = {**at, z: at[z] + side * STEP}
                    rates.append((rate(there)[0] - rate(at)[0]) / (side * STEP))
        if len(rates) == 2 and max(map(abs, rates)) > mpf("1e-6"):
            return f"the slopes at its witness are {rates}"
        if len(rates) == 4 and min(rates) * max(rates) > 0:
            return f"the slopes have one sign: {rates}"
        return ""
    low, high = end(evidence["low"], 0), end(evidence["high"], 0)
    for at in s.points(s.inner):
        x = s.slope(rate, s.away(at, s.inner), [s.z[i - 1]])[0][0]
        if not (low * high > 0 and low - TOLERANCE * (1 + abs(x)) <= x <= high + TOLERANCE * (1 + abs(x))):
            return f"{x} is outside of [{low}, {high}]"
    return ""


def _chain(s: _Sampled, claim: Any, place: Any) -> str:
    """Each entry is the derivative of the one before along the plant's flow."""
    Phi, n = claim["evidence"]["chain"], len(s.x)
    for at in s.points(_with_rates(s, n), 4):
        if abs(value(Phi[0], at) - value(s.plant["output"][0], at)) > TOLERANCE:
            return "it does not begin with the output"
        speeds = {x: value(row, at) for x, row in zip(s.x, s.plant["flow"], strict=True)}
        speeds |= {name: at[after] for name, after in _after(s, n) if after in at}
        for before, after in pairwise(Phi):
            there = [{**at, **{name: at[name] + side * STEP * v for name, v in speeds.items()}} for side in (-1, 1)]
            speed = (value(before, there[1]) - value(before, there[0])) / (2 * STEP)
            if abs(value(after, at) - speed) > TOLERANCE * 100 * (1 + abs(speed)):
                return "an entry is not the derivative of the one before"
    return ""


def _after(s: _Sampled, n: int) -> Iterator[tuple[str, str]]:
    derived = {f"{u.rstrip('_')}_{k}" for u in s.u for k in ("dot", "ddot", "dddot")}
    for u in s.u:
        if u not in derived:
            names = [u, *(f"{u.rstrip('_')}_{'d' * k}ot" for k in range(1, min(n, 3) + 1))]
            yield from pairwise(names)


def _with_rates(s: _Sampled, n: int) -> dict[str, Any]:
    return {**{after: {"low": "-1", "high": "1"} for _, after in _after(s, n)}, **s.outer}


def _rank(s: _Sampled, claim: Any, place: Any) -> str:
    Phi = next((c["evidence"]["chain"] for c in s.content["claims"] if c["id"] == "phase.chain"), None)
    if Phi is None:
        return "there is no Phi"
    low, high = (end(claim["evidence"][key], 0) for key in ("low", "high"))
    ranges = _with_rates(s, len(s.x))
    for at in s.points(ranges, 4):
        J = s.slope(lambda p: [value(row, p) for row in Phi], s.away(at, ranges), s.x)
        d = mpmath.det(mpmath.matrix(J))
        if not (low * high > 0 and low - TOLERANCE * 100 * (1 + abs(d)) <= d <= high + TOLERANCE * 100 * (1 + abs(d))):
            return f"{d} is outside of [{low}, {high}]"
    return ""


def _dissipates(what: str) -> Callable[[_Sampled, Any, Any], str]:
    def says(s: _Sampled, claim: Any, place: Any) -> str:
        system = claim["evidence"]["system"]
        errors = {e["name"]: e for e in system["errors"]}
        names, mu = list(errors), end(system["mu"], 0)
        if names != [f"e_{x}" for x in s.x]:
            return "its errors are not the plant's"
        for at in s.points({**s.outer, **errors}, 40):
            e = mpmath.matrix([at[name] for name in names])
            behind = {**at, **{x: at[x] - at[f"e_{x}"] for x in s.x}}
            V = value(system["V"], at)
            edge = any(at[name] in (end(r["low"], 0), end(r["high"], 0)) for name, r in errors.items())
            size = mpmath.norm(e)
            if what == "positive" and V <= 0 < size:
                return f"V = {V}"
            if what == "level" and edge and end(claim["evidence"]["floor"], 0) > V + TOLERANCE:
                return f"V = {V} on a face"
            if what == "inequality" and size:
                try:
                    F, G = (_observed if "observer" in system else _injected)(s, system, at, behind)
                except ZeroDivisionError:  # the observer has no value there
                    continue
                p = mpmath.matrix(s.slope(lambda q: [value(system["V"], q)], at, names))
                left = (p * F)[0] + size**2 / 2 + (mpmath.norm(p * G) ** 2 / (2 * mu**2) if G.cols else 0)
                if left >= TOLERANCE * size**2:
                    return f"the left side is {left}"
        return ""

    return says


def _injected(s: _Sampled, system: Any, at: Values, behind: Values) -> tuple[Any, Any]:
    """F and G of an observer with a gain."""
    f, h = ([value(row, at) - value(row, behind) for row in s.plant[key]] for key in ("flow", "output"))
    gain = mpmath.matrix([[value(cell, behind) for cell in row] for row in system["gain"]])
    F = mpmath.matrix(f) - gain * mpmath.matrix(h)
    if not system["G1"][0]:
        return F, mpmath.matrix(len(f), 0)
    G1, G2 = (mpmath.matrix([[value(c, at) for c in row] for row in system[k]]) for k in ("G1", "G2"))
    return F, G1 - gain * G2


def _observed(s: _Sampled, system: Any, at: Values, behind: Values) -> tuple[Any, Any]:
    """F and G of an observer of any equations, by its error's rate at w = 0 and at unit vectors, on the told set."""
    at = {**at, **{x: value(text, at) for x, text in system["along"].items()}}

    def rate(w: Values) -> Any:
        here = {**at, **w}
        y = {f"y_{k}": value(row, here) for k, row in enumerate(s.plant["output"], 1)}
        there = {**here, **y, **{x: here[x] - at[f"e_{x}"] for x in s.x}}
        rows = zip(s.plant["flow"], system["observer"], strict=True)
        return mpmath.matrix([value(f, here) - value(g, there) for f, g in rows])

    none = dict.fromkeys(system["unknown"], mpf(0))
    F = rate(none)
    columns = [rate({**none, w: mpf(1)}) - F for w in system["unknown"]]
    return F, mpmath.matrix([[column[i] for column in columns] for i in range(len(F))])


def _shows(s: _Sampled, claim: Any, place: Any) -> str:
    """The Gramian of the told inputs over two periods."""
    evidence = claim["evidence"]
    T, n, count = 2 * value(evidence.get("period", "1"), {}), len(s.z), 400
    for at in s.points({p["name"]: p for p in s.plant["parameters"]}, 2):
        Phi, W, h = np.eye(n), np.zeros((n, n)), float(T) / count
        for k in range(count):
            A, C = [], []
            for share in (0.0, 0.5):
                now = {"t": mpf(h * (k + share))}
                here = {**at, **{name: value(text, now) for name, text in evidence["inputs"].items()}}
                here |= dict.fromkeys(s.z, mpf(0))
                A.append(np.array([[value(entry, here) for entry in row] for row in s.form["A"]], dtype=float))
                C = C or s.slope(lambda p: [value(row, p) for row in s.form["output"]], here, s.z)
            CPhi = np.array(C, dtype=float) @ Phi
            W += h * CPhi.T @ CPhi
            Phi = Phi + h * A[1] @ (Phi + h / 2 * A[0] @ Phi)
        values = np.linalg.eigvalsh(W)
        if values[0] <= 1e-12 * values[-1]:
            return f"the Gramian's eigenvalues are {values}"
    return ""


_SAYS: tuple[tuple[str, Callable[[_Sampled, Any, Any], str]], ...] = (
    (r"(?:triangular|uniform)\.structure", _triangular),
    (r"block_triangular\.structure", _blocks),
    (r"state_affine\.structure", _affine),
    (r"recast\.inverse", _inverse),
    (r"recast\.range", _ranged),
    (r"(?:triangular|block_triangular)\.a_(\d+)(?:_(\d+))?", lambda s, c, p: _gain(s, c, tuple(p))),
    (r"(?:triangular|block_triangular)\.offset(?:_(\d+))?", _offset),
    (r"(?:triangular|block_triangular)\.lipschitz", _steep("nonlinear")),
    (r"uniform\.lipschitz", _steep("all")),
    (r"state_affine\.lipschitz", _steep("rates")),
    (r"(?!phase\.)[a-z_]+\.lipschitz", _steep("b")),
    (r"uniform\.slope_(\d+)", _uniform_slope),
    (r"phase\.chain", _chain),
    (r"phase\.rank", _rank),
    (r"dissipation\.positive", _dissipates("positive")),
    (r"dissipation\.inequality", _dissipates("inequality")),
    (r"dissipation\.level", _dissipates("level")),
    (r"kalman_like\.persistence", _shows),
)
