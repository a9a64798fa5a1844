"""C99 and Rust as `Syntax`: names, comments, and the differences that the borrow checker requires."""

# Takes apart: a user's words, the list of keywords, the parts of a name.

import re
from collections.abc import Collection, Sequence
from dataclasses import replace

import casadi as ca

from hgogen.emit.interface import Entry
from hgogen.emit.naming import c_name
from hgogen.emit.syntax import ATOM, BYTES, OR, PRODUCT, SELECT, UNARY, Real, Rows, Syntax


def comment(text: str) -> str:
    """Return text as a C comment; a */ in the text cannot end it."""
    return f"/* {comment_text(text)} */" if text else ""


def documented(text: str) -> str:
    """Return text as a Doxygen comment for the declaration below."""
    return f"/** {doxygen_text(text)} */" if text else ""


def trailing_doc(text: str) -> str:
    """Return text as a Doxygen comment for the declaration on the same line."""
    return f"{TRAILING_DOC}{doxygen_text(text)} */" if text else ""


TRAILING_DOC = "/**< "
_COMMAND = re.compile(r"[\\@]|<(?=[A-Za-z/!?])|[#%](?=\w)|&(?=[\w#]+;)|(?<=!)\[|(?<=\])\((?=\S)")


def doxygen_text(text: str) -> str:
    """Return text in which Doxygen finds no commands, links or tags."""
    return _COMMAND.sub(r"\\\g<0>", comment_text(text))


def comment_text(text: str) -> str:
    """Return text on one line that neither ends nor opens a C comment and has no trigraphs."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").splitlines())


def _c_limited(table: Rows) -> Sequence[str]:
    rows = (f"    {{{', '.join(row)}}}, /* {place} */" for place, row in zip(table.places, table.rows, strict=True))
    return (
        "{",
        "    static const struct {",
        f"        {table.type} low;",
        f"        {table.type} high;",
        f"        {table.type} nominal;",
        f"    }} range[{len(table.rows)}] = {{",
        *(f"    {row}" for row in rows),
        "    };",
        f"    {table.type} *const value[{len(table.rows)}] = {{{', '.join(f'&{place}' for place in table.places)}}};",
        f"    for (unsigned k = 0u; k < {table.count}; ++k) {{",
        f"        const {table.type} v = *value[k];",
        f"        *value[k] = {table.prefix}_keep(v, range[k].low, range[k].high, range[k].nominal, {table.largest});",
        "        if (!(v >= range[k].low && v <= range[k].high)) {",
        f"            {table.raised}",
        "        }",
        "    }",
        "}",
    )


_EXACT_COMPARISON = (  # an exact comparison of numbers, or a test for NaN
    (
        "#if defined(__GNUC__)",
        "#pragma GCC diagnostic push",
        '#pragma GCC diagnostic ignored "-Wfloat-equal"',
        "#endif",
    ),
    ("#if defined(__GNUC__)", "#pragma GCC diagnostic pop", "#endif"),
)

_BUILT_IN = "defined(__GNUC__) && !defined(__FRAMAC__)"  # one instruction with the same result

_C_STRUCTS = {"estimate": "plant", "parameters": "params"}

C = Syntax(
    language="C",
    reserved="a keyword or a macro",
    types={kind: kind for kind in ("float", "double", "unsigned", "bool", "void")}
    | {"index": "unsigned"}
    | {"whole float": "int32_t", "whole double": "int64_t", "word float": "uint32_t", "word double": "uint64_t"},
    suffixes={"float": "f", "double": "", "unsigned": "u"},
    truth_is_number=True,
    name=c_name,
    reach="{}->",
    parameters={},
    choice="{test} ? {yes} : {no}",
    chosen=(ATOM, OR),
    cast="({type}){value}",
    casted=UNARY,
    constant="const {type} {name} = {value};",
    variable="{type} {name} = {value};",
    array="{type} {name}[{size}];",
    fixed="static const {type} {name}[{size}] = {{{values}}};",
    gathered="const {type} {name}[{size}] = {{{values}}};",
    condition="if ({}) {{",
    repeated="while ({}) {{",
    loop=lambda k, first, end, also, _: (
        f"for (unsigned {k} = {first}; {k} < {end}{f' && {also}' if also else ''}; ++{k}) {{",
    ),
    falling="for (unsigned {k} = {first}; {k} > {end}; --{k}) {{",
    increment="++{};",
    index=lambda array, k: f"{array}[{k}]",
    member="{type} *const {name} = &{element};",
    read_member="const {type} *const {name} = &{element};",
    struct=lambda prefix, kind: f"{prefix}_{_C_STRUCTS.get(kind, kind)}",
    struct_member={True: "{type} {name}[{size}];", False: "{type} {name};"},
    passed={True: "{}", False: "{}"},
    parameter="{type} {name}",
    array_parameter={True: "{type} {name}[{size}]", False: "const {type} {name}[{size}]"},
    params="const {prefix}_params *p",
    function=("static {type} {name}({parameters})", "{{"),
    empty="void",
    result="return {};",
    raised="status |= {prefix}_{bit};",
    called=lambda prefix, of: f"status |= {prefix}_{of.inner or of.name}({', '.join(of.parameters)});",
    comment=comment,
    equal=True,
    limited=_c_limited,
    around={"equal": _EXACT_COMPARISON, "within": _EXACT_COMPARISON},
    analysed=True,
    aligned=("{}/{upper}_VECTOR*{upper}_VECTOR", PRODUCT),
    instead={
        "acts": ("defined(__FRAMAC__)", "(void)flag;", "return true;"),
        "abs": (_BUILT_IN, "return __builtin_fabs{suffix}(v);"),
        "within": (_BUILT_IN, "return __builtin_fabs{suffix}(v) <= limit;"),
        "nearest": (
            "!defined(__FLT_EVAL_METHOD__) || (__FLT_EVAL_METHOD__ != 0)",
            "const volatile {type} sum = v + {ROUNDS};",
            "return sum - {ROUNDS};",
        ),
        "power_of_two": (
            f"{_BUILT_IN} && (__SIZEOF_DOUBLE__ == 8)",
            "const {type} sum = x + {BIASED};",
            "{word} bits;",
            "{type} power;",
            "(void)__builtin_memcpy(&bits, &sum, sizeof(bits));",
            "bits <<= {SHIFT}u;",
            "(void)__builtin_memcpy(&power, &bits, sizeof(power));",
            "return power;",
        ),
    },
)


_KEYWORDS = """
    Self abstract as async await become box break const continue crate do dyn else enum extern false final fn for if
    impl in let loop macro match mod move mut override priv pub ref return self static struct super trait true try type
    typeof unsafe unsized use virtual where while yield
"""
KEYWORDS = frozenset(_KEYWORDS.split())  # no name can be one, not even that of a crate
PRELUDE = frozenset({"Some", "None", "Ok", "Err"})  # values in scope everywhere, whose names no local can have
PARAMETERS = {"in": "input"}  # `in` is a keyword
TYPES = {"float": "f32", "double": "f64", "unsigned": "u32", "index": "usize", "bool": "bool", "void": "()"}


def rust_name(name: str) -> str:
    """Return a model's name in Rust: type_ for type, which is a keyword; most names are unchanged."""
    return f"{name}_" if name in KEYWORDS | PRELUDE else name


def line(text: str) -> str:
    """Return text with line breaks replaced, as one line."""
    return " ".join(text.splitlines())


def _rust_loop(k: str, first: str, end: str, also: str, used: bool) -> list[str]:
    leave = [f"if !({also}) {{", "    break;", "}"] if also else []
    return [f"for {k if used else '_'} in {first}..{end} {{", *leave]


def _rust_called(_: str, entry: Entry) -> str:
    arguments = (PARAMETERS.get(name, name) for name in entry.parameters if name != "s")
    return f"status |= s.{entry.name}({', '.join(arguments)});"


def _rust_limited(table: Rows) -> list[str]:
    """Return the lines of a Rust loop that clamps numbers to their ranges, over a table and
    copies of the numbers: two elements of an array cannot be borrowed mutably at once."""
    rows = (f"    ({', '.join(row)}), // {place}" for place, row in zip(table.places, table.rows, strict=True))
    return [
        "{",
        f"    const RANGE: [({table.type}, {table.type}, {table.type}); {table.count}] = [",
        *(f"    {row}" for row in rows),
        "    ];",
        f"    let mut value: [{table.type}; {table.count}] = [{', '.join(table.places)}];",
        "    for (v, (low, high, nominal)) in value.iter_mut().zip(RANGE) {",
        "        if !(*v >= low && *v <= high) {",
        f"            {table.raised}",
        "        }",
        f"        *v = {table.prefix}_keep(*v, low, high, nominal, {table.largest});",
        "    }",
        *(f"    {place} = value[{k}];" for k, place in enumerate(table.places)),
        "}",
    ]


_RUST_STRUCTS = {"input": "Inputs", "output": "Outputs"}

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
    loop=_rust_loop,
    falling="for {k} in ({end} + 1..{first} + 1).rev() {{",
    increment="{} += 1;",
    index=lambda array, k: f"{array}[{f'({k})' if ' ' in k else k} as usize]",
    member="let {name} = &mut {element};",
    read_member="let {name} = &{element};",
    struct=lambda _, kind: _RUST_STRUCTS.get(kind) or "".join(part.capitalize() for part in kind.split("_")),
    struct_member={True: "pub {name}: [{type}; {size}],", False: "pub {name}: {type},"},
    passed={True: "&mut {}", False: "&{}"},
    parameter="{name}: {type}",
    array_parameter={True: "{name}: &mut [{type}; {size}]", False: "{name}: &[{type}; {size}]"},
    params="p: &Parameters",
    function=("fn {name}({parameters}) -> {type} {{",),
    empty="",
    result="{}",
    raised="status |= status::{bit};",
    called=_rust_called,
    comment=lambda text: f"// {line(text)}".rstrip() if text else "",
    limited=_rust_limited,
    instead={"power_of_two": ("", "{type}::from_bits((x + {BIASED}).to_bits() << {SHIFT})")},
)


_ALIGNED = ("triangularise", "add")  # kernels with loops that may start at a multiple


def vectors(name: str, real: Real, used: Collection[tuple[str, int]]) -> tuple[Syntax, list[str]]:
    """Return the syntax of C functions with loops that a compiler can vectorise, and the lines that define the macros
    for that syntax and for the kernels in `used` (name, size); `name`: the prefix of the macros."""
    if not any(kernel in _ALIGNED for kernel, _ in used):
        return C, []
    upper = name.upper()
    syntax = replace(C, function=(f"static {upper}_OFTEN {{type}} {{name}}({{parameters}})", "{{"))
    return syntax, [
        "/* how many numbers an instruction takes at once: loops that may begin earlier begin at a multiple, and what",
        " * they call is a part of them */",
        "#if defined(__GNUC__) && !defined(__clang__) && !defined(__FRAMAC__) && defined(__SSE2__)",
        "#if defined(__AVX__)",
        f"#define {upper}_VECTOR {32 // BYTES[real]}u",
        "#else",
        f"#define {upper}_VECTOR {16 // BYTES[real]}u",
        "#endif",
        f"#define {upper}_OFTEN inline",
        "#else",
        f"#define {upper}_VECTOR 1u",
        f"#define {upper}_OFTEN",
        "#endif",
        "",
    ]
