"""How a state of emitted Rust is saved and restored: its numbers one by one, so that the bytes are of no machine."""

# Takes apart: a template, whose lines it makes.

from collections.abc import Iterable

from hgogen.emit.code import indented
from hgogen.emit.pygraph import DTYPE
from hgogen.emit.rustsyntax import RUST
from hgogen.emit.saved import ADDED, CHECKSUM, DIGEST, POLYNOMIAL, layout
from hgogen.emit.syntax import Real
from hgogen.program import Field, Group
from hgogen.step import Step

INDEX_BYTES = 4
_FUNCTIONS = f"""
fn put_bytes(saved: &mut [u8; SAVED], at: usize, bytes: &[u8]) -> usize {{
    let end = at + bytes.len();
    saved[at..end].copy_from_slice(bytes);
    end
}}

fn take_bytes<const N: usize>(saved: &[u8], at: &mut usize) -> [u8; N] {{
    let mut bytes = [0; N];
    bytes.copy_from_slice(&saved[*at..*at + N]);
    *at += N;
    bytes
}}

/// CRC-32 of IEEE 802.3
fn checksum(bytes: &[u8]) -> u32 {{
    let mut sum = u32::MAX;
    for byte in bytes.iter() {{
        sum ^= *byte as u32;
        for _ in 0..8 {{
            sum = if sum & 1 != 0 {{ (sum >> 1) ^ 0x{POLYNOMIAL:08X} }} else {{ sum >> 1 }};
        }}
    }}
    !sum
}}
"""
FUNCTIONS = _FUNCTIONS.strip().split("\n")


def constants(step: Step, real: Real) -> list[str]:
    """Return the lines of the constants about a saved state."""
    size = ADDED + _size(step.layout.state, step.layout.groups, {"real": DTYPE[real]().itemsize, "index": INDEX_BYTES})
    digest = ", ".join(f"0x{byte:02X}" for byte in layout(step, real, "rust"))
    return [
        "/// A digest of the model, the observer, default gains, dt, the precision and the memory of a saved state.",
        f"pub const LAYOUT: [u8; {DIGEST}] = [{digest}];",
        "/// How many bytes a saved state has.",
        f"pub const SAVED: usize = {size};",
        "",
    ]


def save(step: Step) -> list[str]:
    """Return the lines of the method that saves a state."""
    fields = step.layout.state, step.layout.groups
    return [
        "/// the state as bytes, alike on every machine: `LAYOUT`, its numbers, a checksum",
        "pub fn save(&self) -> [u8; SAVED] {",
        "    let s = self;",
        "    let mut saved = [0; SAVED];",
        "    let mut at = put_bytes(&mut saved, 0, &LAYOUT);",
        *indented(_each("s", *fields, ".iter()", "at = put_bytes(&mut saved, at, &{}.to_le_bytes());")),
        "    let sum = checksum(&saved[..at]);",
        "    put_bytes(&mut saved, at, &sum.to_le_bytes());",
        "    saved",
        "}",
    ]


def restored(step: Step, real: Real) -> list[str]:
    """Return the lines of the function that makes a state of what was saved."""
    end = f"SAVED - {CHECKSUM}"
    read = "{} = {type}::from_le_bytes(take_bytes(saved, &mut at));"
    types = {"real": RUST.types[real], "index": RUST.types["unsigned"]}
    return [
        "/// the state that was saved; `None` where it is of another program, or a bit of it is another",
        "pub fn restored(saved: &[u8]) -> Option<State> {",
        f"    if saved.len() != SAVED || saved[..{DIGEST}] != LAYOUT {{",
        "        return None;",
        "    }",
        f"    if checksum(&saved[..{end}]).to_le_bytes() != saved[{end}..] {{",
        "        return None;",
        "    }",
        "    let mut s = State::new();",
        f"    let mut at = {DIGEST};",
        *indented(_each("s", step.layout.state, step.layout.groups, ".iter_mut()", read, types)),
        "    Some(s)",
        "}",
    ]


def _size(fields: Iterable[Field], groups: Iterable[Group], of: dict[str, int]) -> int:
    """The bytes of memory whose numbers lie one after the other."""
    inner = sum(group.count * _size(group.fields, group.groups, of) for group in groups)
    return inner + sum(of[field.kind] * field.size for field in fields)


def _each(
    start: str,
    fields: Iterable[Field],
    groups: Iterable[Group],
    through: str,
    text: str,
    types: dict[str, str] | None = None,
) -> list[str]:
    """What is done with each number of memory, in the order in which it lies."""
    lines = []
    for field in fields:
        place, kind = f"{start}.{field.name}", (types or {}).get(field.kind, "")
        if field.size > 1:
            element = "*v" if types else "v"
            lines += [f"for v in {place}{through} {{", f"    {text.format(element, type=kind)}", "}"]
        else:
            lines.append(text.format(place, type=kind))
    for group in groups:
        inner = _each("m", group.fields, group.groups, through, text, types)
        lines += [f"for m in {start}.{group.name}{through} {{", *indented(inner), "}"]
    return lines
