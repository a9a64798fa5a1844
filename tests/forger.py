"""A forger of certificates: changes of every kind at every place, the digests made anew."""

import copy
import json
import math
import random
import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any

from hgogen.recheck.file import digest, model_digest

Content = dict[str, Any]
Path = tuple[Any, ...]
NUMBER = re.compile(r"\d+(?:\.\d+)?")
NAME = re.compile(r"\b[A-Za-z_][A-Za-z0-9_]*\b")
ODD: tuple[Any, ...] = (
    *(
        "1.5/2",
        "9" * 500,
        "1/" + "9" * 500,
        "nan",
        "inf",
        "-inf",
        "1e400",
        "1e-400",
        "",
        " 1",
        "0x1",
        "1/0",
        "--1",
        "1/-2",
    ),
    *(
        None,
        True,
        False,
        7,
        0.5,
        1e400,
        [],
        {},
        [[[[["1"]]]]],
        "\ud800",
        "\x1b[32mverified",
        "é",
        "x" * 1000,
        "0",
        "1",
        "-1",
    ),
)
VERDICTS = ("proved", "refuted", "stated", "unknown", "where", "generic", "certain")


def sealed(content: Content) -> str:
    """As a forger would write it: with the digests of the changed content."""
    content = {**content, "model": model_digest(content)}
    return json.dumps({**content, "digest": digest(content)})


def places(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Every part of a value with its path."""
    if path:
        yield path, value
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(pairs):
        yield from places(inner, (*path, key))


def forged(draw: random.Random, content: Content, others: Sequence[Content]) -> tuple[str, Content]:
    """One to three changes of a certificate, and what they are."""
    result, applied = copy.deepcopy(content), []
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        change = draw.choice(CHANGES)
        applied.append(change.__name__)
        change(draw, result, others)
    return ", ".join(applied), result


def put(content: Content, path: Path, value: Any) -> None:
    """A value at a path."""
    holder: Any = content
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value


def _pick(draw: random.Random, content: Content, wanted: Callable[[Path, Any], bool]) -> tuple[Path, Any]:
    """A place that is wanted: of the plant, form and observer, or of the claims, equally often."""
    parts = draw.sample(("plant", "form", "observer", "claims", "claims"), 5)
    for part in parts:
        candidates = [(path, value) for path, value in places(content.get(part), (part,)) if wanted(path, value)]
        if candidates:
            return draw.choice(candidates)
    return ("hgogen",), content.get("hgogen")


def _listed(holder: Content, key: str) -> list[Any]:
    """A part that is a list; an empty one where an earlier change has left another value."""
    value = holder.get(key)
    return value if isinstance(value, list) else []


def number(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A number in a text is another."""
    path, text = _pick(draw, content, lambda path, value: isinstance(value, str) and bool(NUMBER.search(value)))
    match = draw.choice(list(NUMBER.finditer(str(text))) or [None])
    if match is None:
        return
    old = match[0]
    new = draw.choice((f"(-{old})", f"1{old}", "0", "1", f"({old}*99/100)", f"({old}*101/100)", old[:-1] + "7"))
    if re.fullmatch(r"-?[\d./]+", str(text)):  # a number, which is no expression
        new = draw.choice((f"1{old}", "0", "1", old[:-1] + "7", f"{old}7".lstrip("0")))
    sign = "-" if draw.random() < 0.2 and match.start() == 0 else ""
    put(content, path, f"{sign}{text[: match.start()]}{new}{text[match.end() :]}")


def name(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A name in a text is another of the file."""
    path, text = _pick(draw, content, lambda path, value: isinstance(value, str) and bool(NAME.search(value)))
    matches = list(NAME.finditer(str(text)))
    names = [value for at, value in places(content) if at[-1] == "name" and isinstance(value, str)]
    if matches and names:
        match = draw.choice(matches)
        put(content, path, f"{text[: match.start()]}{draw.choice(names)}{text[match.end() :]}")


def expression(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """An expression is another, of this file or made of it."""
    path, text = _pick(draw, content, lambda path, value: isinstance(value, str))
    _, other = _pick(draw, content, lambda path, value: isinstance(value, str))
    made = (
        other,
        "0",
        f"2*({text})",
        f"({text}) + 1",
        f"Abs({text})",
        f"sign({text})",
        f"-({text})",
        f"({text})*({other})",
    )
    put(content, path, draw.choice(made))


def odd(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A value of another type, or no value of its kind."""
    path, _ = _pick(draw, content, lambda path, value: True)
    put(content, path, copy.deepcopy(draw.choice(ODD)))


def swapped(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A part is that of another file, or of another place of this one."""
    path, value = _pick(draw, content, lambda path, value: True)
    holder: Any = draw.choice((content, *others))
    same = [other for at, other in places(holder) if at[-1] == path[-1] and type(other) is type(value)]
    if same:
        put(content, path, copy.deepcopy(draw.choice(same)))


def another_subject(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """The plant, the form, the observer or the claims are another file's."""
    part = draw.choice(("plant", "form", "observer", "claims"))
    content[part] = copy.deepcopy(draw.choice(others)[part])


def deleted(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A part is left out."""
    path, _ = _pick(draw, content, lambda path, value: len(path) > 1)
    holder: Any = content
    for key in path[:-1]:
        holder = holder[key]
    del holder[path[-1]]


def twice(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """An entry of a list stands twice."""
    _, value = _pick(draw, content, lambda path, value: isinstance(value, list) and bool(value))
    if isinstance(value, list):
        value.append(copy.deepcopy(draw.choice(value)))


def verdict(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A claim has another verdict, id or evidence."""
    claims = content.get("claims")
    if isinstance(claims, list) and claims:
        every = [claim for holder in (content, *others) for claim in holder["claims"] if isinstance(claim, dict)]
        claim, other = draw.choice(claims), draw.choice(every)
        if isinstance(claim, dict):
            key = draw.choice(("verdict", "verdict", "id", "evidence"))
            value = draw.choice(VERDICTS) if key == "verdict" else other.get(key)
            claim[key] = copy.deepcopy(value)
            if key == "verdict" and draw.random() < 0.5:
                claim["evidence"] = copy.deepcopy(draw.choice(({}, other.get("evidence"))))


def narrowed(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A range is one point, wherever it stands."""
    ranges = [
        value for _, value in places(content) if isinstance(value, dict) and value.keys() == {"name", "low", "high"}
    ]
    if ranges:
        one = draw.choice(ranges)
        end = one[draw.choice(("low", "high"))]
        for each in ranges:
            if each["name"] == one["name"]:
                each["low"] = each["high"] = end


def emptied(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """The plant stands still, or shows nothing."""
    plant = content.get("plant")
    if isinstance(plant, dict):
        key = draw.choice(("flow", "output"))
        plant[key] = ["0"] * len(_listed(plant, key))


def relabelled(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """The form is of another kind, known or not, and the claims that would rest on it are left out."""
    form = content.get("form")
    if isinstance(form, dict) and isinstance(content.get("claims"), list):
        old, form["kind"] = form.get("kind"), draw.choice(("phase", "original", "uniform", "banana", "state_affine"))
        content["claims"] = [c for c in content["claims"] if not str(c).startswith(f"{{'id': '{old}.")]


def altered(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """A row of the plant is another function, a little or much; the claims stay."""
    plant = content.get("plant")
    if not isinstance(plant, dict):
        return
    names = [s["name"] for s in _listed(plant, "states") if isinstance(s, dict) and isinstance(s.get("name"), str)]
    rows = plant.get(draw.choice(("flow", "output")))
    if names and isinstance(rows, list) and rows:
        i, x = draw.randrange(len(rows)), draw.choice(names)
        text = rows[i]
        made = (f"({text}) + {x}", f"({text})*(1 + {x}**2)", f"({text}) + Abs({x})", f"({text})*1001/1000")
        rows[i] = draw.choice(
            (*made, f"({text}) + exp(-1000)*{x}", f"Max({text}, {text} + {x})", f"({text}) + {x} - {x}")
        )


def alike(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """Plant and form are another plant's, alike, where the form keeps the states; the claims stay."""
    plant, form = content.get("plant"), content.get("form")
    if not isinstance(plant, dict) or not isinstance(form, dict):
        return
    x, z = ([s.get("name") for s in _listed(part, "states") if isinstance(s, dict)] for part in (plant, form))
    flow, b = plant.get("flow"), form.get("b")
    if (
        isinstance(flow, list)
        and isinstance(b, list)
        and form.get("to_form") == x
        and 0 < len(x) == len(z) == len(b) == len(flow)
    ):
        i, k = draw.randrange(len(x)), draw.randrange(len(x))
        more = draw.choice(("{} + 3*{}", "{} + {}**2", "({})*{}", "{} + Abs({})", "{} + sin(100*{})", "{} + 1/{}"))
        flow[i], b[i] = more.format(f"({flow[i]})", x[k]), more.format(f"({b[i]})", z[k])


def renamed(draw: random.Random, content: Content, others: Sequence[Content]) -> None:
    """The observer is another one by name, with its claims."""
    observer, claims = content.get("observer"), content.get("claims")
    if isinstance(observer, dict) and isinstance(claims, list):
        old, new = observer.get("name"), draw.choice(("high_gain", "filtered", "low_power", "stubborn", "kalman_like"))
        observer["name"] = new
        for claim in claims:
            if isinstance(claim, dict) and isinstance(claim.get("id"), str):
                claim["id"] = claim["id"].replace(f"{old}.", f"{new}.")


def enlarged(one: Content, inputs: int, most: Callable[[list[Fraction]], Fraction]) -> Content:
    """A bound of a norm that was shown with inputs, and the same bound in a norm that is s times as large.

    P, S and lambda are all that the inequality is linear in, so that it holds of s P, s S and s lambda too, and
    |e|_P <= 1 bounds every field by 1/sqrt(s) of what it did. It is a proof as long as sum(s lambda) <= alpha; s is
    the largest with most(s lambda) <= alpha.
    """
    lambdas = [Fraction(each) for each in one["S"][-inputs:]]
    s = Fraction(one["alpha"]) / most(lambdas)
    root = Fraction(math.isqrt(s.numerator * 10**40 // s.denominator), 10**20)
    return {
        **one,
        "P": [[str(s * Fraction(x)) for x in row] for row in one["P"]],
        "S": [str(s * Fraction(x)) for x in one["S"]],
        "bound": str(Fraction(one["bound"]) / root),
    }


def damaged(draw: random.Random, text: str) -> str:
    """The text itself is another: cut, doubled, too deep, a number that is none, a key twice, a character changed."""
    at = draw.randrange(len(text))
    value = draw.choice(("NaN", "1e999", "9" * 5000, '[[[["1"]]]]', '"\\ud800"', '"\u0661"', '"1_000"', '"1e99999999"'))
    power = draw.choice(("**999999999", "**(1/3)", "**-1", "**2**2**2**2**2", "**1e9", "**pi"))
    return draw.choice(
        (
            text[:at],
            text + draw.choice(("}", "x", "\x00", text)),
            "[" * 100_000 + text,
            text.replace('"1"', value),
            text.replace('"low"', draw.choice(('"LOW"', '"high"', '"low\\u0000"'))),
            text.replace('"claims"', '"claims": [], "claims"', 1),
            text[:at] + draw.choice('"{}[],:0-.e\u00e9\u202e\x1b') + text[at + 1 :],
            text.replace("**2", power),
        )
    )


CHANGES = (
    *(number, number, number, name, expression, expression, odd, odd, swapped, swapped, another_subject, deleted),
    *(twice, verdict, narrowed, emptied, relabelled, altered, alike, alike, renamed),
    *(altered, alike, alike, renamed),
)
