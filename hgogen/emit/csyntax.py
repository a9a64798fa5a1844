"""C99 as a `Syntax`, and its comments."""

# Takes apart: a user's words, which become one line without commands of Doxygen.

import re
from collections.abc import Sequence

from hgogen.emit.cnames import c_name
from hgogen.emit.syntax import ATOM, OR, PRODUCT, UNARY, Rows, Syntax


def comment(text: str) -> str:
    """A C comment that its text cannot end."""
    return f"/* {harmless(text)} */" if text else ""


def documented(text: str) -> str:
    """A comment that Doxygen takes for what stands below it."""
    return f"/** {spoken(text)} */" if text else ""


def beside(text: str) -> str:
    """A comment that Doxygen takes for what stands before it."""
    return f"{BESIDE}{spoken(text)} */" if text else ""


BESIDE = "/**< "
_COMMAND = re.compile(r"[\\@]|<(?=[A-Za-z/!?])|[#%](?=\w)|&(?=[\w#]+;)|(?<=!)\[|(?<=\])\((?=\S)")


def spoken(text: str) -> str:
    """Harmless text in which Doxygen reads no command, link or tag."""
    return _COMMAND.sub(r"\\\g<0>", harmless(text))


def harmless(text: str) -> str:
    """Text that neither ends nor opens a comment, on one line and without trigraphs."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").splitlines())


def _loop(k: str, first: str, end: str, also: str, used: bool) -> Sequence[str]:
    return (f"for (unsigned {k} = {first}; {k} < {end}{f' && {also}' if also else ''}; ++{k}) {{",)


def _limited(of: Rows) -> Sequence[str]:
    """A table in read-only memory, and pointers to what it is of."""
    rows = (f"    {{{', '.join(row)}}}, /* {place} */" for place, row in zip(of.places, of.rows, strict=True))
    return (
        "{",
        "    static const struct {",
        f"        {of.type} low;",
        f"        {of.type} high;",
        f"        {of.type} nominal;",
        f"    }} range[{len(of.rows)}] = {{",
        *(f"    {row}" for row in rows),
        "    };",
        f"    {of.type} *const value[{len(of.rows)}] = {{{', '.join(f'&{place}' for place in of.places)}}};",
        f"    for (unsigned k = 0u; k < {of.count}; ++k) {{",
        f"        const {of.type} v = *value[k];",
        f"        *value[k] = {of.prefix}_keep(v, range[k].low, range[k].high, range[k].nominal, {of.largest});",
        "        if (!(v >= range[k].low && v <= range[k].high)) {",
        f"            {of.raised}",
        "        }",
        "    }",
        "}",
    )


_QUIET = (  # a comparison that asks whether a number is one, or is another one exactly
    (
        "#if defined(__GNUC__)",
        "#pragma GCC diagnostic push",
        '#pragma GCC diagnostic ignored "-Wfloat-equal"',
        "#endif",
    ),
    ("#if defined(__GNUC__)", "#pragma GCC diagnostic pop", "#endif"),
)

_BUILT_IN = "defined(__GNUC__) && !defined(__FRAMAC__)"  # one instruction, of the same result

_STRUCTS = {"estimate": "plant", "parameters": "params"}

C = Syntax(
    language="C",
    reserved="a keyword or a macro",
    types={
        "float": "float",
        "double": "double",
        "unsigned": "unsigned",
        "index": "unsigned",
        "bool": "bool",
        "void": "void",
    }
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
    loop=_loop,
    falling="for (unsigned {k} = {first}; {k} > {end}; --{k}) {{",
    increment="++{};",
    index=lambda array, k: f"{array}[{k}]",
    member="{type} *const {name} = &{element};",
    struct=lambda prefix, kind: f"{prefix}_{_STRUCTS.get(kind, kind)}",
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
    limited=_limited,
    around={"equal": _QUIET, "within": _QUIET},
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
