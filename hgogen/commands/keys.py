"""The keys of a result in JSON with their types and meanings, read from its class (`hgogen.sentence.Encoded`)."""

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from inspect import getdoc
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from hgogen.sentence import keys_of

_WORDS = {bool: "true or false", int: "whole number", float: "number", type(None): "null", Any: "anything"}


class Meaning(NamedTuple):
    """A key at its `depth` below the result: the type of its value, and what it means."""

    name: str
    depth: int
    kind: str
    text: str
    optional: bool


def names(result: type) -> list[str]:
    """The keys of a result."""
    listed = list[str]()
    for key in keys_of(result):
        inner = None if key.name else _result_in(_at(result, key.path)[0])
        listed += names(inner) if inner else [key.name]
    return listed


def meanings(result: type, depth: int = 0, above: tuple[type, ...] = ()) -> Iterator[Meaning]:
    """The keys of a result, each followed by those of the results in it, which are not repeated within themselves."""
    for key in keys_of(result):
        annotation, text = _at(result, key.path)
        inner = _result_in(annotation)
        if key.name:
            yield Meaning(key.name, depth, _words(annotation), text, key.optional)
        if inner is None or inner in (*above, result):
            continue
        spread = not key.name and type(None) in _alternatives(annotation)
        for one in meanings(inner, depth + bool(key.name), (*above, result)):
            yield one._replace(optional=one.optional or (spread and one.depth == depth))


def _at(result: Any, path: str) -> tuple[Any, str]:
    """The type of what a path leads to, and what the field or property there says of itself."""
    annotation, text, none = result, "", False
    for name in path.split("."):
        none = none or type(None) in _alternatives(annotation)
        owner = next((one for one in _alternatives(annotation) if one is not type(None)), annotation)
        if name.isdigit():
            annotation = get_args(owner)[int(name)]
            continue
        hints = get_type_hints(owner, include_extras=True)
        if name in hints:
            annotation, text = hints[name], ""
        else:
            member = getattr(owner, name)
            made = getattr(member, "fget", None) or getattr(member, "func", member)  # of a property, cached or not
            annotation = get_type_hints(made, include_extras=True)["return"]
            text = " ".join((getdoc(made) or "").split("\n\n")[0].split())
        if get_origin(annotation) is Annotated:
            annotation, text = get_args(annotation)[:2]
    annotation = annotation | None if none else annotation
    return annotation, text[:1].lower() + text[1:].rstrip(".") if text[1:2].islower() or text.startswith("A ") else text


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


def _result_in(annotation: Any) -> type | None:
    """The result in a type, by itself, in a list, by name or with alternatives."""
    if is_dataclass(annotation):
        return annotation if isinstance(annotation, type) and getattr(annotation, "json_keys", "") is not None else None
    return next(filter(None, map(_result_in, get_args(annotation))), None)


def _words(annotation: Any) -> str:
    """A type in words."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_words, args)))
    if origin is Annotated:
        return _words(args[0])
    if origin is tuple and args[1:] != (...,):
        return f"[{', '.join(map(_words, args))}]"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"{_words(args[1])} by name"
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return f"list of {_words(args[0])}"
    if _result_in(annotation):
        return "object"
    return _WORDS.get(annotation, "text")
