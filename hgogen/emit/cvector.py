"""C for compilers that make one instruction of several rounds of a loop: where its loops begin, and what becomes a part
of them.

GCC takes a call for a bar, and rounds that are left over before and after whole vectors for loops of their own. Other
compilers take a function into a loop unasked, and others yet have no vectors: for them nothing is different.
"""

from collections.abc import Collection
from dataclasses import replace

from hgogen.emit.csyntax import C
from hgogen.emit.syntax import BYTES, Real, Syntax

_ALIGNED = ("triangularise", "add")  # kernels with loops that may begin at a multiple


def vectors(name: str, real: Real, used: Collection[tuple[str, int]]) -> tuple[Syntax, list[str]]:
    """The syntax of the functions that loops call, and the macros that it and the kernels in `used` need."""
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
