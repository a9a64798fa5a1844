"""The content of a certificate file, with its types checked: every part has its type, every name its range.

No part of the file is redundant without a check: the rules compare a claim's expressions with the form's.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from hashlib import sha256
from typing import Any

from .arithmetic import Unproved
from .box import Box, End
from .matrix import Matrix
from .text import Expression, RecheckError, expression, kind_of, number
from .turns import Turn, Turns, turn

FORMAT, VERSION = "hgogen certificate", "3"
LARGEST = 50_000_000  # characters of a file
ABOUT = ("plant", "form", "observer")  # the parts that describe the model
DIGEST_DIGITS = 16  # printed digits of their digest
LONGEST = 300  # printed characters of the file's words
DEEPEST = 20  # lists and objects in each other
_ID = re.compile(r"([a-z_0-9]{1,60})\.([A-Za-z_0-9]{1,60})\Z", re.ASCII)
_ROWS = re.compile(r"(.*?)((?:_[1-9][0-9]{0,3})*)\Z", re.ASCII)
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,99}\Z", re.ASCII)
_KEYS = {
    "the file": ("format", "version", "hgogen", *ABOUT, "model", "claims", "digest"),
    "plant": ("name", "states", "inputs", "parameters", "outputs", "periods", "times", "flow", "output"),
    "form": ("kind", "states", "periods", "to_form", "from_form", "A", "b", "output", "blocks", "alignment"),
    "a range": ("name", "low", "high"),
    "a claim": ("id", "verdict", "evidence"),
}


@dataclass(eq=False)
class NoCertificate(RecheckError):
    """The error that a file is no certificate."""

    reason: str

    def __str__(self) -> str:
        return f"this is no certificate: {self.reason}; write one with hgogen check MODEL --certificate FILE"


@dataclass(frozen=True)
class Equations:
    """The plant x' = `flow`, y = `output`, as expressions; `box`: the range of every name in them; `turns`: the periods
    of states and inputs that are angles, `periods`: those of the outputs, None without one."""

    states: tuple[str, ...]
    box: Box
    flow: tuple[Expression, ...]
    output: tuple[Expression, ...]
    turns: Turns
    periods: tuple[Turn | None, ...]


@dataclass(frozen=True)
class FormFile:
    """The plant in other coordinates, as the file states it: z = to_form(x), x = from_form(z), z' = A z + b, y =
    output. `blocks`: the sizes of the chains of integrators, in order; `alignment`: which states of other chains b may
    read; `turns`: the periods of states and inputs that are angles."""

    kind: str
    states: tuple[str, ...]
    box: Box
    to_form: tuple[Expression, ...]
    from_form: tuple[Expression, ...]
    A: tuple[tuple[Expression, ...], ...]
    b: tuple[Expression, ...]
    output: tuple[Expression, ...]
    blocks: tuple[int, ...]
    alignment: str
    turns: Turns


@dataclass(frozen=True)
class ObserverKeys:
    """The names of the arguments of an observer in a certificate: `numbers`, single or in lists; `optional` numbers;
    `expressions`, the entries of a gain, one for each state, or one for each state and chain."""

    numbers: tuple[str, ...]
    expressions: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()


@dataclass(frozen=True)
class Observer:
    """The observer of a certificate; if a claim is about it, with its `numbers` and with the `entries` of its gains by
    name, which may contain parameters."""

    name: str
    numbers: Mapping[str, Any]
    entries: Mapping[str, tuple[Expression, ...]] = field(default_factory=dict)

    @property
    def gains(self) -> tuple[Expression, ...]:
        """The entries of the gain that multiplies the output error."""
        return self.entries.get("gains", ())


@dataclass(frozen=True)
class Claim:
    """A claim of the file, with its stated verdict and its evidence. An id such as triangular.a_2 consists of the
    `maker` and, after the dot, `what`; this is the `fact`, a, followed by the row numbers `at`, (2)."""

    id: str
    verdict: str
    evidence: Mapping[str, Any]
    maker: str
    what: str
    fact: str
    at: tuple[int, ...]


@dataclass(frozen=True)
class Certificate:
    """A certificate as read from a file. `times`: the inputs that are times, whose rate is 1; `model`: the digest of
    plant, form and observer; `named`: whether the file states the same digest; `untouched`: whether the file's own
    digest is that of its content."""

    name: str
    plant: Equations
    form: FormFile
    observer: Observer | None
    inputs: tuple[str, ...]
    times: tuple[str, ...]
    parameters: tuple[str, ...]
    claims: tuple[Claim, ...]
    model: str
    named: bool
    untouched: bool

    def claim(self, id: str) -> Claim | None:
        """Return the claim with an id, or None."""
        return next((claim for claim in self.claims if claim.id == id), None)


def quoted(text: str) -> str:
    """Return a text of the file in quotes, so that it is not mistaken for the verifier's own words, nor controls a
    terminal."""
    return json.dumps(text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}...")


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest of the content without its own digest; it detects accidents only, since a forger can
    compute it."""
    return _hashed({key: value for key, value in content.items() if key != "digest"})


def model_digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest of the model: the equations, ranges and numbers of plant, form and observer."""
    return _hashed({key: content.get(key) for key in ABOUT})


def _hashed(value: Mapping[str, Any]) -> str:
    return sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def read(text: str, observers: Mapping[str, ObserverKeys]) -> Certificate:
    """Return the certificate in a JSON text; `observers`: the argument names of each observer.

    Raises: `NoCertificate` for a text that is no JSON or lacks a part; `Unreadable` for an expression or number.
    """
    if len(text) > LARGEST:
        raise NoCertificate(f"it has more than {LARGEST} characters")
    try:
        content = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except RecursionError:
        raise NoCertificate("its JSON is nested too deep") from None
    except ValueError as error:
        raise NoCertificate(f"its JSON cannot be read ({error})") from None
    _shallow(content)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise NoCertificate(f'it does not say "format": "{FORMAT}"')
    if content.get("version") != VERSION:
        raise NoCertificate(f"its version is not {VERSION!r}, which this reader has")
    return _read(content, observers)


def _shallow(content: Any) -> None:
    pending = [(content, 0)]
    while pending:
        value, depth = pending.pop()
        if depth > DEEPEST:
            raise NoCertificate("its JSON is nested too deep")
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        pending += [(each, depth + 1) for each in inner]


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key stands twice")
    return content


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no number here")


def _read(content: Mapping[str, Any], observers: Mapping[str, ObserverKeys]) -> Certificate:
    plant, form = part(content, "plant", dict), part(content, "form", dict)
    _known("the file", content)
    _known("plant", plant)
    _known("form", form)
    states, inputs, parameters = ({**signals(plant, kind)} for kind in ("states", "inputs", "parameters"))
    common = {**inputs, **parameters}
    z = signals(form, "states")
    x_box, z_box = {**states, **common}, {**z, **common}
    if len(x_box) < len(states) + len(inputs) + len(parameters) or len(z_box) < len(z) + len(common):
        raise NoCertificate("a name is declared twice")
    n, m = len(states), len(part(plant, "outputs", list))
    if not (n and m and z):
        raise NoCertificate("its plant or its form has no states, or there are no outputs")
    outputs = _names(plant["outputs"])
    turns = _periods(plant, (*states, *inputs, *outputs))
    of_inputs = {name: turns[name] for name in inputs if name in turns}
    return Certificate(
        name=part(plant, "name", str),
        plant=Equations(
            states=tuple(states),
            box=x_box,
            flow=_rows(plant, "flow", x_box, n),
            output=_rows(plant, "output", x_box, m),
            turns={name: period for name, period in turns.items() if name in x_box},
            periods=tuple(map(turns.get, outputs)),
        ),
        form=FormFile(
            kind=part(form, "kind", str),
            states=tuple(z),
            box=z_box,
            to_form=_rows(form, "to_form", x_box, len(z)),
            from_form=_rows(form, "from_form", z_box, n),
            A=tuple(_texts(row, z_box, len(z)) for row in _sized(part(form, "A", list), len(z))),
            b=_rows(form, "b", z_box, len(z)),
            output=_rows(form, "output", z_box, m),
            blocks=_blocks(form, len(z)),
            alignment=part(form, "alignment", str),
            turns=_periods(form, z) | of_inputs,
        ),
        observer=_observer(content, observers, z_box, _blocks(form, len(z))),
        inputs=tuple(inputs),
        times=_times(plant, inputs),
        parameters=tuple(parameters),
        claims=_claims(content),
        model=model_digest(content),
        named=content.get("model") == model_digest(content),
        untouched=content.get("digest") == digest(content),
    )


def part(holder: Mapping[str, Any], key: str, kind: type) -> Any:
    """Return the value under a key of a JSON object. Raises: `NoCertificate` if it is missing or not of the type
    `kind`."""
    value = holder.get(key)
    if not isinstance(value, kind):
        raise NoCertificate(f"its part {key!r} is missing or no {kind.__name__}")
    return value


def _known(what: str, holder: Mapping[str, Any], known: Iterable[str] | None = None) -> None:
    strange = sorted(holder.keys() - set(_KEYS[what] if known is None else known))
    if strange:
        raise NoCertificate(f"{what} has a part {quoted(strange[0])}, which is unknown here")


def _names(values: Iterable[Any]) -> tuple[str, ...]:
    return tuple(value if isinstance(value, str) else "" for value in values)


def _times(plant: Mapping[str, Any], inputs: Iterable[str]) -> tuple[str, ...]:
    times = _names(part({"times": [], **plant}, "times", list))
    if strange := sorted({*times} - set(inputs)):
        raise NoCertificate(f"{quoted(strange[0])} is a time, and no input")
    return times


def _periods(holder: Mapping[str, Any], names: Iterable[str]) -> dict[str, Turn]:
    """Return the periods by name in the JSON object under the key "periods", {} if there is none. Raises:
    `NoCertificate`."""
    known = part({"periods": {}, **holder}, "periods", dict)
    if strange := sorted(known.keys() - set(names)):
        raise NoCertificate(f"{quoted(strange[0])} has a period, and is no state, input or output")
    try:
        return {name: turn(text) for name, text in known.items()}
    except Unproved as error:
        raise NoCertificate(str(error)) from None


def _blocks(form: Mapping[str, Any], count: int) -> tuple[int, ...]:
    sizes = [number(size) for size in part(form, "blocks", list)]
    if any(size.denominator > 1 or size < 0 for size in sizes) or sum(sizes) != count:
        raise NoCertificate("its blocks are not the sizes of chains of the form's states")
    return tuple(map(int, sizes))


def _observer(
    content: Mapping[str, Any], observers: Mapping[str, ObserverKeys], names: Mapping[str, Any], blocks: Sequence[int]
) -> Observer | None:
    if content.get("observer", 0) is None:
        return None
    parts = dict(part(content, "observer", dict))
    name = part(parts, "name", str)
    if not _NAME.match(name):
        raise NoCertificate(f"{quoted(name)} is no name of an observer")
    del parts["name"]
    if not parts:
        return Observer(name, {})
    known = observers.get(name, ObserverKeys(()))
    wanted = (*known.numbers, *known.expressions)
    _known("observer", parts, (*wanted, *known.optional))
    if missing := sorted(set(wanted) - parts.keys()):
        raise NoCertificate(f"its observer {name!r} has no part {missing[0]!r}")
    entries = {key: part(parts, key, list) for key in known.expressions}
    chains, states = sum(size > 0 for size in blocks), sum(blocks)
    if any(len(gain) not in (states, states * chains) for gain in entries.values()):
        raise NoCertificate(f"its gains are not {states} entries, nor {states} for each of {chains} chains")
    gains = {key: tuple(expression(text, names) for text in gain) for key, gain in entries.items()}
    numbers = (*known.numbers, *(key for key in known.optional if key in parts))
    return Observer(name, {key: _numbers(parts[key]) for key in numbers}, gains)


def _numbers(value: Any, depth: int = 0) -> Any:
    if isinstance(value, list) and depth < 2:
        return [_numbers(each, depth + 1) for each in value]
    return number(value)


def _sized(rows: Any, count: int) -> list[Any]:
    if not isinstance(rows, list) or len(rows) != count:
        raise NoCertificate(f"a list has not its {count} entries")
    return rows


def _texts(texts: Any, names: Mapping[str, Any], count: int) -> tuple[Expression, ...]:
    return tuple(expression(text, names) for text in _sized(texts, count))


def _rows(holder: Mapping[str, Any], key: str, names: Mapping[str, Any], count: int) -> tuple[Expression, ...]:
    return _texts(part(holder, key, list), names, count)


def signals(holder: Mapping[str, Any], key: str) -> dict[str, tuple[End, End]]:
    """Return the closed range of each signal by name, from the JSON list under a key; there null is an infinite end,
    and equal ends are a constant."""
    ranges: dict[str, tuple[End, End]] = {}
    for entry in part(holder, key, list):
        if not isinstance(entry, dict):
            raise NoCertificate(f"an entry of {key!r} is no object")
        _known("a range", entry)
        name = part(entry, "name", str)
        if not _NAME.match(name) or name in ranges:
            raise NoCertificate(f"{quoted(name)} in {key!r} is no name, or stands twice")
        ranges[name] = ends(entry.get("low"), entry.get("high"), name)
    return ranges


def ends(low: object, high: object, name: str) -> tuple[End, End]:
    """Return a closed range with None read as an infinite end. Raises: `NoCertificate` for an empty range."""
    least = -math.inf if low is None else number(low)
    most = math.inf if high is None else number(high)
    if not least <= most:
        raise NoCertificate(f"the range of {name} is empty")
    return least, most


def _claims(content: Mapping[str, Any]) -> tuple[Claim, ...]:
    claims = []
    for entry in part(content, "claims", list):
        if not isinstance(entry, dict):
            raise NoCertificate("a claim is no object")
        _known("a claim", entry)
        claims.append(_claim(part(entry, "id", str), entry))
    return tuple(claims)


def _claim(id: str, entry: Mapping[str, Any]) -> Claim:
    named = _ID.match(id)
    if not named:
        raise NoCertificate(f"{quoted(id)} is no id of a claim")
    maker, what = named.groups()
    rows = _ROWS.match(what)
    assert rows is not None  # it matches any text
    fact, at = rows[1], tuple(map(int, rows[2].split("_")[1:]))
    return Claim(id, part(entry, "verdict", str), part(entry, "evidence", dict), maker, what, fact, at)


# --- numbers of the evidence

MOST_ROWS = 40  # or columns: an elimination of more in fractions takes too long


def entries(holder: Mapping[str, Any], key: str, count: int) -> list[Any]:
    """Return the list under a key of a JSON object, which must have `count` entries. Raises: `Unproved`."""
    values = holder.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise Unproved(f"its {key} has not {count} entries")
    return values


def fields(one: Any, what: str, keys: Sequence[str]) -> Mapping[str, Any]:
    """Return the JSON object `one`, which must have exactly these keys; `what`: its description in the error. Raises:
    `Unproved`."""
    if not isinstance(one, dict) or set(one) != set(keys):
        *first, last = keys
        raise Unproved(f"{what} is no object of {', '.join(first)} and {last}")
    return one


def column(holder: Mapping[str, Any], key: str, count: int) -> list[Fraction]:
    """Return the list of `count` numbers under a key of a JSON object. Raises: `Unproved`."""
    return [_number_of(value, key) for value in entries(holder, key, count)]


def matrix(holder: Mapping[str, Any], key: str, rows: int, columns: int) -> Matrix:
    """Return the matrix of numbers (rows, columns) under a key of a JSON object. Raises: `Unproved`."""
    lists = entries(holder, key, rows)
    if max(rows, columns) > MOST_ROWS:
        raise Unproved(f"its {key} has more than {MOST_ROWS} rows or columns")
    if any(not isinstance(row, list) or len(row) != columns for row in lists):
        raise Unproved(f"its {key} is not {rows} x {columns}")
    return Matrix([[_number_of(value, key) for value in row] for row in lists], columns)


def scalar(holder: Mapping[str, Any], key: str) -> Fraction:
    """Return the number under a key of a JSON object. Raises: `Unproved`."""
    if holder.get(key) is None:
        raise Unproved(f"its {key} is missing")
    return _number_of(holder[key], key)


def _number_of(value: Any, key: str) -> Fraction:
    if not isinstance(value, str | Fraction):
        raise Unproved(f"its {key} has {kind_of(value)} where a number should stand")
    return value if isinstance(value, Fraction) else number(value)


def whole(holder: Mapping[str, Any], key: str, least: int, most: int) -> int:
    """Return the integer from `least` to `most` under a key of a JSON object. Raises: `Unproved` for another number."""
    value = scalar(holder, key)
    if value.denominator > 1 or not least <= value <= most:
        raise Unproved(f"its {key} is none of {least} to {most}")
    return int(value)


def above_zero(holder: Mapping[str, Any], key: str) -> Fraction:
    """Return the number > 0 under a key of a JSON object. Raises: `Unproved`."""
    value = scalar(holder, key)
    if value <= 0:
        raise Unproved(f"its {key} is not positive")
    return value


def signless(holder: Mapping[str, Any], key: str) -> Fraction:
    """Return the number >= 0 under a key of a JSON object. Raises: `Unproved`."""
    value = scalar(holder, key)
    if value < 0:
        raise Unproved(f"its {key} is negative")
    return value


__all__ = ["DIGEST_DIGITS", "FORMAT", "VERSION", "Certificate", "Claim", "NoCertificate", "ObserverKeys"]
