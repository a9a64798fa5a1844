"""A saved state: a digest of the program that it is of, its bytes, and a checksum of both; and the code that saves it.

    LAYOUT    8 bytes     the digest
    state     any         the memory of the state: of C unchanged, of Rust its numbers one by one, lowest byte first
    checksum  4 bytes     CRC-32 (IEEE 802.3) of all bytes before it, the lowest byte first

The digest is of what must be the same for a state to mean the same: the model with the values and ranges of its
signals and its tables, the form, the observer with its arguments, the parameters as they are generated, the method, dt,
the precision, and the fields of the memory in their order. The prefix of the code, and the estimate at the start, are
not in it. C has NAME_save and NAME_restore, Rust methods of `State`.
"""

# Takes apart: templates, whose lines it makes.

import hashlib
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from inspect import signature
from string import Template
from typing import Any

import numpy as np

from hgogen.emit.code import Code, Uses, indented
from hgogen.emit.interface import Parameter, Prototype, structs
from hgogen.emit.syntax import DTYPE, Real
from hgogen.emit.syntaxes import RUST
from hgogen.errors import BadArgument
from hgogen.observer import STARTS, Observer
from hgogen.program import Field, Group
from hgogen.reading.given import names_of
from hgogen.registry import version
from hgogen.step import Step
from hgogen.stepping.guards import mark_number
from hgogen.system import System

DIGEST, CHECKSUM = 8, 4  # bytes
ADDED = DIGEST + CHECKSUM  # bytes of a saved state besides those of the state
POLYNOMIAL = 0xEDB88320
# arguments that may be given in several ways, whose numbers are among the gains or in the equations
_IN_EQUATIONS = ("poles", "gains", "Q", "R", "U", "noise", "R_per_sample", "Q_per_sample", "density", "gate", "update")


class NotSaved(BadArgument):
    """The error for bytes that are no saved state of a step."""


@lru_cache(maxsize=8)  # each file of a step needs it
def layout(step: Step, real: Real, language: str = "c") -> bytes:
    """Return the digest (8 bytes) of a step's program, its precision and the layout of its memory in `language`."""
    observer, form = step.observer, step.observer.form
    system = form.system.declared
    lines = [version(), language, real, system.name, form.kind, observer.name, step.code.rule]
    clock = step.clock
    lines += [f"dt {step.dt!r}, {step.periods}, {clock.between}, {clock.guards}, {clock.prefer}"]
    lines += [f"first {clock.first}"] * (clock.first != "update")
    lines += [f"varying dt, at most {clock.varying.substeps} sub-steps"] if clock.varying else []
    lines += [str(observer.delays)]
    lines += [*_plant(system), *(_plant(form.system) if form.system is not system else ())]
    guards = f"{form.clamped} {form.limits} {form.free} {form.fallback}"
    lines += [*map(str, form.to_form), guards, *_observer(observer)]
    for parameters in (step.layout.plant, step.layout.gains):
        lines += (f"{field.name} {[DTYPE[real](value) for value in field.initial]}" for field in parameters)
    lines += [*_listed(step.layout.derived, ()), *_listed(step.layout.state, step.layout.groups)]
    return hashlib.sha256("\n".join(lines).encode()).digest()[:DIGEST]


def mark(step: Step, real: Real) -> int:
    """Return the number that tags initialised memory of a step in the precision `real`."""
    return mark_number(layout(step, real))


def sealed(step: Step, real: Real, state: bytes) -> bytes:
    """Return a saved state: the digest of the program, the bytes of a step's state, and a checksum."""
    body = layout(step, real) + state
    return body + struct.pack("<I", zlib.crc32(body))


def opened(step: Step, real: Real, saved: bytes, size: int) -> bytes:
    """Return the bytes (size) of a step's state from the bytes of a saved state (`saved`). Raises: `NotSaved` for
    damaged bytes, or those of another program."""
    what = f"a saved state of {len(saved)} bytes"
    if len(saved) != size + ADDED:
        raise NotSaved(what, f"is not of this step, of which {size + ADDED} are saved; give what save() gave")
    body, state = saved[:-CHECKSUM], saved[DIGEST:-CHECKSUM]
    if struct.pack("<I", zlib.crc32(body)) != saved[-CHECKSUM:]:
        raise NotSaved(what, "is damaged: its checksum differs; save again")
    marked = not step.layout.mark or state[:4] == struct.pack("=I", mark(step, real))
    if saved[:DIGEST] != layout(step, real) or not marked:
        raise NotSaved(what, "is of another model, observer, gains, dt or precision; restore it where it was saved")
    return state


def _plant(system: System) -> Iterator[str]:
    yield from (f"{parameter.name} {parameter.nominal}" for parameter in system.parameters)
    yield from (f"{signal.name} {signal.low} {signal.high} {signal.rates}" for signal in system.signals)
    yield from (f"{signal.name} turns by {signal.period}" for signal in system.signals if signal.period is not None)
    yield from (f"{system.next_mark} {row}" for row in system.flow)
    yield from (f"= {row}" for row in system.output)
    yield from (f"{table.name} {table.points}" for table in system.tables)


def _observer(observer: Observer) -> Iterator[str]:
    yield from observer.equations
    if observer.construction is None:
        return
    bound = signature(observer.construction.func).bind(*observer.construction.args, **observer.construction.keywords)
    bound.apply_defaults()
    (_, base), *others = bound.arguments.items()
    form = observer.form
    orders = (form.names, names_of(form.system.states), names_of(form.system.outputs))
    excluded = (*STARTS, *_IN_EQUATIONS, "accept")
    yield from (f"{name} {_text(value, orders)}" for name, value in others if name not in excluded)
    yield from _observer(base) if isinstance(base, Observer) else ()


def _text(value: Any, orders: Sequence[Sequence[str]]) -> str:
    match value:
        case Mapping():
            for names in orders:
                if value.keys() == {*names}:
                    return _text([value[name] for name in names], orders)
            return f"{{{', '.join(sorted(f'{name}: {_text(each, orders)}' for name, each in value.items()))}}}"
        case np.ndarray():
            return _text(value.tolist(), orders)
        case list() | tuple():
            return f"[{', '.join(_text(each, orders) for each in value)}]"
        case int() | float() | complex() | np.number():
            return repr(complex(value))
    if is_dataclass(value) and not isinstance(value, type):
        each = (f"{field.name}={_text(getattr(value, field.name), orders)}" for field in fields(value))
        return f"{type(value).__name__}({', '.join(each)})"
    return str(getattr(value, "__qualname__", value))


def _listed(fields: Iterable[Field], groups: Iterable[Group]) -> Iterator[str]:
    yield from (f"{field.kind} {field.name}[{field.size}]: {', '.join(field.labels)}" for field in fields)
    for group in groups:
        yield f"{group.name}[{group.count}]"
        yield from _listed(group.fields, group.groups)


# --- the functions of C

RETURNS = "0: restored; 1: refused, the state is unchanged"

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


def meanings(step: Step) -> dict[str, str]:
    """Return the meanings of the parameters of the C functions save and restore, by name."""
    return {"saved": f"{step.name.upper()}_SAVED bytes, at any address", "size": "how many bytes there are"}


def prototypes(step: Step) -> tuple[Prototype, Prototype]:
    """Return the C declarations of the functions save and restore of a step's state."""
    s, saved = structs(step)[0], Parameter(_BYTES, "saved")
    size, upper = Parameter("size_t", "size", pointer=False), step.name.upper()
    saves = f"write the state as {upper}_SAVED bytes: {upper}_LAYOUT, the memory of the struct, a checksum"
    restores = "read a state that this program saved; refuse any other, and one with another bit"
    save = Prototype("void", f"{step.name}_save", (replace(s, constant=True), saved), saves)
    return save, Prototype("unsigned", f"{step.name}_restore", (s, replace(saved, constant=True), size), restores)


def saving(step: Step, real: Real) -> Code:
    """Return the C definitions of the functions save and restore of a step's state."""
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


# --- the functions of Rust

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


def rust_constants(step: Step, real: Real) -> list[str]:
    """Return the lines of a Rust crate that define the constants of a saved state, such as its size and digest."""
    size = ADDED + _size(step.layout.state, step.layout.groups, {"real": DTYPE[real]().itemsize, "index": INDEX_BYTES})
    digest = ", ".join(f"0x{byte:02X}" for byte in layout(step, real, "rust"))
    return [
        "/// A digest of the model, the observer, default gains, dt, the precision and the memory of a saved state.",
        f"pub const LAYOUT: [u8; {DIGEST}] = [{digest}];",
        "/// How many bytes a saved state has.",
        f"pub const SAVED: usize = {size};",
        "",
    ]


def rust_save(step: Step) -> list[str]:
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


def initial_state_call(step: Step) -> str:
    """Return the Rust call that creates a state as before the first call, without the time of that call."""
    return "initial()" if step.code.time else "new()"


def rust_restored(step: Step, real: Real) -> list[str]:
    """Return the lines of the function that restores a saved state."""
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
        f"    let mut s = State::{initial_state_call(step)};",
        f"    let mut at = {DIGEST};",
        *indented(_each("s", step.layout.state, step.layout.groups, ".iter_mut()", read, types)),
        "    Some(s)",
        "}",
    ]


def _size(fields: Iterable[Field], groups: Iterable[Group], widths: dict[str, int]) -> int:
    inner = sum(group.count * _size(group.fields, group.groups, widths) for group in groups)
    return inner + sum(widths[field.kind] * field.size for field in fields)


def _each(
    start: str,
    fields: Iterable[Field],
    groups: Iterable[Group],
    through: str,
    text: str,
    types: dict[str, str] | None = None,
) -> list[str]:
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
