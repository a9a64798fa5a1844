"""The structs of emitted Rust, with what is said of their members, and the values that they begin with."""

from collections.abc import Mapping

from hgogen.emit.code import indented
from hgogen.emit.rustsyntax import RUST, line
from hgogen.emit.structs import Struct
from hgogen.program import lines_of
from hgogen.step import Step

_SAID = {
    "input": "the inputs now",
    "output": "the measurements now",
    "parameters": "change `plant` or `gain`, then call `tune`",
}


def declared(step: Step, structs: Mapping[str, Struct]) -> list[str]:
    """All structs of a step."""
    groups, lines = {line[-1].name for line in lines_of(step.layout.groups)}, list[str]()
    for kind, struct in structs.items():
        said = _SAID.get(kind, struct.said)
        lines += doc(said if kind in groups else f"{said[0].upper()}{said[1:]}.")
        inner = [text for member in struct.members for text in (*doc(member.said), member.declared)]
        lines += ["#[derive(Clone, Copy, Debug, PartialEq)]", f"pub struct {RUST.struct('', kind)} {{"]
        lines += [*indented(inner), "}", ""]
    return lines


def doc(text: str) -> list[str]:
    """A documentation comment of one line, which is folded later."""
    return [f"/// {line(text)}"] if text else []


def initial(structs: Mapping[str, Struct], kind: str) -> list[str]:
    """The members of a struct with the values that it begins with."""
    lines: list[str] = []
    for member in structs[kind].members:
        if member.kind:
            start, end = ("[", f"; {member.count}]") if member.count else ("", "")
            inner = indented(initial(structs, member.kind))
            lines += [f"{member.name}: {start}{RUST.struct('', member.kind)} {{", *inner, f"}}{end},"]
        else:
            first, *others = member.begins
            values = f"{first}; {len(member.begins)}" if set(others) == {first} else ", ".join(member.begins)
            lines.append(f"{member.name}: {f'[{values}]' if others else first},")
    return lines
