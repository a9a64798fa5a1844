"""Structs of C: members with what is said of them."""

from collections.abc import Callable, Iterable, Iterator, Mapping

from hgogen.emit.code import indented
from hgogen.emit.csyntax import C, beside, documented
from hgogen.emit.structs import Member, Struct


def typedefs(prefix: str, structs: Mapping[str, Struct], none: str, said: Callable[[str], str]) -> Iterator[list[str]]:
    """typedef struct { ... } PREFIX_KIND; for each, those of the parameters in theirs, where `none` stands for there is
    none; `said`: what is said beside a member, of its text."""
    inside = structs["parameters"].members
    for kind, each in structs.items():
        if kind in {member.kind for member in inside if member.kind}:
            continue
        inner = _members(each.members, said)
        if kind == "parameters":
            inner = _members((member for member in inside if not member.kind), said)
            inner += [line for member in inside if member.kind for line in _nested(structs[member.kind], said)]
            inner = inner or [none]
        about = list(filter(None, [documented(said(each.said))]))
        yield [*about, "typedef struct {", *indented(inner), f"}} {C.struct(prefix, kind)};"]


def _nested(struct: Struct, said: Callable[[str], str]) -> list[str]:
    """A struct in a struct, with its comment before it and beside its name: they are two things to Doxygen."""
    about, text = list(filter(None, [documented(said(struct.said))])), said(struct.said)
    inner = indented(_members(struct.members, said))
    return [*about, "struct {", *inner, f"}} {struct.kind}; {beside(text)}".rstrip()]


def _members(members: Iterable[Member], said: Callable[[str], str]) -> list[str]:
    """Their lines, with the comments in one column."""
    members = tuple(members)
    width = max((len(member.declared) for member in members), default=0)
    return [f"{member.declared:{width}} {beside(said(member.said))}".rstrip() for member in members]
