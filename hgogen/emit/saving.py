"""How emitted code saves and restores a state: C the memory as it lies there, by NAME_save and NAME_restore, Rust its
numbers one by one, so that the bytes are of no machine.
"""

# Takes apart: templates, whose lines it makes.

import textwrap
from collections.abc import Iterable
from dataclasses import replace
from string import Template

import numpy as np

from hgogen.emit import pystep
from hgogen.emit.code import Code, Uses, indented
from hgogen.emit.interface import Parameter, Prototype, structs
from hgogen.emit.saved import ADDED, CHECKSUM, DIGEST, POLYNOMIAL, layout
from hgogen.emit.syntax import DTYPE, Real
from hgogen.emit.syntaxes import RUST, C
from hgogen.program import Field, Group
from hgogen.step import Step

SAVES = "the state as NAME_SAVED bytes: NAME_LAYOUT, what lies in memory, a checksum"
RESTORES = "the state that was saved, where it was saved by this program and no bit of it is another"
RETURNS = "0: restored; 1: refused, the state is as it was"
MEANINGS = {"saved": "NAME_SAVED bytes, which may lie anywhere", "size": "how many there are"}

_TEXT = Template("""
static const unsigned char ${name}_layout[$digest] = {$layout};

/* CRC-32 of IEEE 802.3 */
static uint32_t ${name}_checksum(const unsigned char *bytes, size_t size)
{
    uint32_t sum = 0xFFFFFFFFu;
    for (size_t k = 0u; k < size; ++k) {
        sum ^= (uint32_t)bytes[k];
        for (unsigned bit = 0u; bit < 8u; ++bit) {
            const uint32_t odd = sum & 1u;
            sum >>= 1u;
            sum ^= (odd != 0u) ? ${polynomial}u : 0u;
        }
    }
    return sum ^ 0xFFFFFFFFu;
}

$save
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < ${digest}u; ++k) {
        saved[k] = ${name}_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + ${digest}u] = bytes[k];
    }
    uint32_t sum = ${name}_checksum(saved, sizeof(*s) + ${digest}u);
    for (size_t k = 0u; k < ${checksum}u; ++k) {
        saved[k + sizeof(*s) + ${digest}u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

$restore
{
    unsigned refused = 1u;
    if (size == ${upper}_SAVED) {
        refused = 0u;
        uint32_t sum = ${name}_checksum(saved, sizeof(*s) + ${digest}u);
        for (size_t k = 0u; k < ${checksum}u; ++k) {
            refused |= (saved[k + sizeof(*s) + ${digest}u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < ${digest}u; ++k) {
            refused |= (saved[k] == ${name}_layout[k]) ? 0u : 1u;
        }
$marked
    }
    if (refused == 0u) {
        unsigned char *const bytes = (unsigned char *)s;
        for (size_t k = 0u; k < sizeof(*s); ++k) {
            bytes[k] = saved[k + ${digest}u];
        }
    }
    return refused;
}
""")
_MARKED = Template("""
        const unsigned ready = ${upper}_READY;
        const unsigned char *const mark = (const unsigned char *)&ready;
        for (size_t k = 0u; k < sizeof(ready); ++k) {
            refused |= (saved[k + ${digest}u] == mark[k]) ? 0u : 1u;
        }
""")
_BYTES = "unsigned char"


def prototypes(step: Step) -> tuple[Prototype, Prototype]:
    """Return the declarations of save and restore."""
    s, saved = structs(step)[0], Parameter(_BYTES, "saved")
    size, upper = Parameter("size_t", "size", pointer=False), step.name.upper()
    save = Prototype("void", f"{step.name}_save", (replace(s, constant=True), saved), SAVES.replace("NAME", upper))
    return save, Prototype("unsigned", f"{step.name}_restore", (s, replace(saved, constant=True), size), RESTORES)


def saving(step: Step, real: Real) -> Code:
    """Return the definitions of save and restore."""
    save, restore = prototypes(step)
    values = {
        "name": step.name,
        "upper": step.name.upper(),
        "digest": DIGEST,
        "checksum": CHECKSUM,
        "polynomial": f"0x{POLYNOMIAL:08X}",
        "layout": ", ".join(f"0x{byte:02X}u" for byte in layout(step, real)),
        "save": save,
        "restore": restore,
    }
    marked = _MARKED.substitute(values).strip("\n") if step.layout.mark else ""
    lines = _TEXT.substitute(values, marked=marked).strip("\n").replace("\n\n    }\n", "\n    }\n").split("\n")
    return Code(tuple(lines), Uses(types=frozenset({"uint32_t"})))


def initialiser(step: Step, real: Real) -> list[str]:
    """Return the lines of the macro that constant parameters begin with: nominal ones, tuned."""
    values = pystep.tuned(step, real)
    rows = ",\n".join(_row(step, real, values[kind]) for kind in values.dtype.names or ())
    return [f"#define {step.name.upper()}_PARAMS_INIT {{ \\", *(f"{line} \\" for line in rows.split("\n")), "}"]


def _row(step: Step, real: Real, values: np.ndarray) -> str:
    """The initialiser of a member of the parameters, in lines that are not too long."""
    if not values.dtype.names:
        return f"    {step.name.upper()}_READY" if step.layout.mark else "    0u"
    members = []
    for name in values.dtype.names:
        texts = ", ".join(C.literal(float(value), real) for value in np.ravel(values[name]))
        members.append(texts if values.dtype[name].subdtype is None else f"{{{texts}}}")
    text = f"{{{', '.join(members)}}}"
    return textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="     ", break_on_hyphens=False)


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
RUST_FUNCTIONS = _FUNCTIONS.strip().split("\n")


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
    return [
        "/// the state as bytes, alike on every machine: `LAYOUT`, its numbers, a checksum",
        "pub fn save(&self) -> [u8; SAVED] {",
        "    let s = self;",
        "    let mut saved = [0; SAVED];",
        "    let mut at = put_bytes(&mut saved, 0, &LAYOUT);",
        *indented(
            _each(
                "s",
                step.layout.state,
                step.layout.groups,
                ".iter()",
                "at = put_bytes(&mut saved, at, &{}.to_le_bytes());",
            )
        ),
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
    """The statements for each number of memory, in the order in which it lies."""
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
