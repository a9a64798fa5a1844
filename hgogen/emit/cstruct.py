"""Structs of C: members with what is said of them."""

from collections.abc import Iterable
from dataclasses import replace

from hgogen.emit.cnames import c_name
from hgogen.emit.code import indented
from hgogen.emit.csyntax import beside
from hgogen.emit.described import described, own_name
from hgogen.program import Field

Member = tuple[str, str]  # the declaration of a struct's member, and what is said of it


def member(real: str, item: Field) -> Member:
    """A struct's member; said of it are meaning, elements, range, unit."""
    kind = "unsigned" if item.kind == "index" else real
    size = "" if item.size == 1 else f"[{item.size}]"
    return f"{kind} {item.name}{size};", described(item)


def named(item: Field) -> Field:
    """A field of the plant's parameters by its name in C, with its own beside it where that is another."""
    name = c_name(item.name)
    return item if name == item.name else replace(item, name=name, meaning=own_name(item.name, item.meaning))


def struct(name: str, lines: Iterable[str], head: str = "typedef struct {") -> list[str]:
    """typedef struct { ... } name;"""
    return [head, *indented(lines), f"}} {name};"]


def members(items: Iterable[Member]) -> list[str]:
    """Their lines, with the comments in one column."""
    items = list(items)
    width = max((len(declared) for declared, _ in items), default=0)
    return [f"{declared:{width}} {beside(text)}".rstrip() for declared, text in items]
