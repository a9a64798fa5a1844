"""Rust as a `Syntax`: names, comments, and the differences that the borrow checker asks for."""

# Takes apart: a user's words, the list of keywords, the parts of a name.

from functools import cache

import casadi as ca

from hgogen.emit.interface import Entry
from hgogen.emit.syntax import SELECT, Rows, Syntax

_KEYWORDS = """
    Self abstract as async await become box break const continue crate do dyn else enum extern false final fn for if
    impl in let loop macro match mod move mut override priv pub ref return self static struct super trait true try type
    typeof unsafe unsized use virtual where while yield
"""
PRELUDE = frozenset({"Some", "None", "Ok", "Err"})  # values that are there unasked, which no local can be
PARAMETERS = {"in": "input", "out": "output"}  # `in` is a keyword
TYPES = {"float": "f32", "double": "f64", "unsigned": "u32", "index": "usize", "bool": "bool", "void": "()"}


@cache
def keywords() -> frozenset[str]:
    """Words that no name can be, not even that of a crate."""
    return frozenset(_KEYWORDS.split())


def rust_name(name: str) -> str:
    """The name in Rust: `type_` for type, which is a keyword; almost always the name itself."""
    return f"{name}_" if name in keywords() | PRELUDE else name


def line(text: str) -> str:
    """Text on one line."""
    return " ".join(text.splitlines())


def _loop(k: str, first: str, end: str, also: str, used: bool) -> list[str]:
    leave = [f"if !({also}) {{", "    break;", "}"] if also else []
    return [f"for {k if used else '_'} in {first}..{end} {{", *leave]


def _called(_: str, entry: Entry) -> str:
    arguments = (PARAMETERS.get(name, name) for name in entry.parameters if name != "s")
    return f"status |= s.{entry.name}({', '.join(arguments)});"


def _limited(of: Rows) -> list[str]:
    """A table, and a copy of what it is of: two elements of an array cannot be borrowed at once."""
    rows = (f"    ({', '.join(row)}), // {place}" for place, row in zip(of.places, of.rows, strict=True))
    return [
        "{",
        f"    const RANGE: [({of.type}, {of.type}, {of.type}); {of.count}] = [",
        *(f"    {row}" for row in rows),
        "    ];",
        f"    let mut value: [{of.type}; {of.count}] = [{', '.join(of.places)}];",
        "    for (v, (low, high, nominal)) in value.iter_mut().zip(RANGE) {",
        "        if !(*v >= low && *v <= high) {",
        f"            {of.raised}",
        "        }",
        f"        *v = {of.prefix}_keep(*v, low, high, nominal, {of.largest});",
        "    }",
        *(f"    {place} = value[{k}];" for k, place in enumerate(of.places)),
        "}",
    ]


_STRUCTS = {"input": "Inputs", "output": "Outputs"}

RUST = Syntax(
    language="Rust",
    reserved="a keyword or a value of the prelude",
    types=TYPES | {"whole float": "i32", "whole double": "i64"},
    suffixes={"float": "", "double": "", "unsigned": ""},
    truth_is_number=False,
    name=rust_name,
    reach="{}.",
    parameters=PARAMETERS,
    choice="if {test} {{ {yes} }} else {{ {no} }}",
    chosen=(SELECT, SELECT),
    cast="{value} as {type}",
    casted=SELECT,
    counted={
        ca.OP_ADD: "u32::wrapping_add({}, {})",
        ca.OP_SUB: "u32::wrapping_sub({}, {})",
        ca.OP_MUL: "u32::wrapping_mul({}, {})",
    },
    constant="let {name}: {type} = {value};",
    variable="let mut {name}: {type} = {value};",
    fixed="const {name}: [{type}; {size}] = [{values}];",
    gathered="let {name}: [{type}; {size}] = [{values}];",
    array="let mut {name}: [{type}; {size}] = [{value}; {size}];",
    condition="if {} {{",
    repeated="while {} {{",
    loop=_loop,
    falling="for {k} in ({end} + 1..{first} + 1).rev() {{",
    increment="{} += 1;",
    index=lambda array, k: f"{array}[{f'({k})' if ' ' in k else k} as usize]",
    member="let {name} = &mut {element};",
    struct=lambda _, kind: _STRUCTS.get(kind) or "".join(part.capitalize() for part in kind.split("_")),
    struct_member={True: "pub {name}: [{type}; {size}],", False: "pub {name}: {type},"},
    passed={True: "&mut {}", False: "&{}"},
    parameter="{name}: {type}",
    array_parameter={True: "{name}: &mut [{type}; {size}]", False: "{name}: &[{type}; {size}]"},
    params="p: &Parameters",
    function=("fn {name}({parameters}) -> {type} {{",),
    empty="",
    result="{}",
    raised="status |= status::{bit};",
    called=_called,
    comment=lambda text: f"// {line(text)}" if text else "",
    limited=_limited,
    instead={"power_of_two": ("", "{type}::from_bits((x + {BIASED}).to_bits() << {SHIFT})")},
)
