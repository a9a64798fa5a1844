"""The functions NAME_save and NAME_restore of emitted C, and the constants of its header about them."""

# Takes apart: templates, whose lines it makes.

import textwrap
from dataclasses import replace
from string import Template

import numpy as np

from hgogen.emit import pystep
from hgogen.emit.cfunction import Parameter, Prototype, structs
from hgogen.emit.code import Code, Uses
from hgogen.emit.csyntax import C
from hgogen.emit.saved import CHECKSUM, DIGEST, POLYNOMIAL, layout
from hgogen.emit.syntax import Real
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
