"""The text of a program that steps over a record: of a step's own functions, and of what counts them on the board."""

from functools import cache
from importlib.resources import files
from string import Template

import numpy as np

from hgogen.emit.code import indented
from hgogen.emit.interface import Parameter, assigned, prototypes, structs
from hgogen.emit.naming import c_name
from hgogen.emit.syntax import Real
from hgogen.step import Step

ROWS = 600  # of a record in the flash of the board: a calm half, and a hostile one
COPIES = 40  # of the state, so that a tick of 40 instructions tells one of them
_WORST = (np.nan, np.inf, -np.inf, 1e30, -1e12, 1e-40, 50.0, -3.0)


@cache
def text(name: str) -> str:
    """A file of C of this folder."""
    return files("hgogen.extras").joinpath(name).read_text(encoding="ascii")


def harness() -> dict[str, str]:
    """The board's own files by name."""
    return {name: text(name) for name in ("mps2.c", "mps2.h", "mps2.ld")}


def hostile(rows: np.ndarray) -> np.ndarray:
    """The same rows with what a sensor and a bus do at their worst: gaps, numbers that are none, jumps."""
    draw, rows = np.random.default_rng(8), rows.copy()
    for column in rows.T:
        hit = draw.random(len(column)) < 0.3
        column[hit] = draw.choice(_WORST, size=int(hit.sum()))
    return rows


def head(rows: np.ndarray, real: Real, states: int, quiet: int) -> str:
    """The record (N, columns) and the sizes; `quiet`: how many of its rows are calm."""
    lines = ",\n".join("    {" + ", ".join(literal(v, real) for v in row) + "}" for row in rows.tolist())
    sizes = {"N": states, "COLUMNS": rows.shape[1], "RECORD": len(rows), "QUIET": quiet}
    defined = f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};\n"  # no member is one
    includes = "#include <math.h>\n#include <stddef.h>\n"
    return f"{includes}{defined}typedef {real} real;\nstatic const real record[RECORD][COLUMNS] = {{\n{lines}\n}};\n"


def literal(value: float, real: Real) -> str:
    """A number in C, which may be infinite or none."""
    if not np.isfinite(value):
        return "NAN" if np.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"
    return f"{value!r}f" if real == "float" else repr(value)


def driver(step: Step) -> str:
    """What calls a step: `memory`, BEGIN, `sample` and `estimate`."""
    declared, inner = prototypes(step), [each for each in structs(step) if each.name in ("in", "out")]
    filled = [f"{short}.{c_name(s.name)} = row[{column}];" for column, (short, s) in enumerate(assigned(step))]
    states = [f"values[{i}] = x.{c_name(s.name)};" for i, s in enumerate(step.states)]
    return Template(text("step.c")).substitute(
        name=step.name,
        locals="\n".join(indented(each.local for each in inner)),
        given="\n".join(indented(filled)),
        step=declared["step"].call(_argument),
        estimate=declared["estimate"].call(_argument),
        states="\n".join(indented(states)),
    )


def counting(called: str) -> str:
    """The main of the board around what `driver` gives, or the like of it."""
    return f"{called}\nenum {{ COPIES = {COPIES} }};\n{text('count.c')}"


def _argument(parameter: Parameter) -> str:
    """The argument from a function that has a pointer `m` to state and parameters."""
    return f"&m->{parameter.name}" if parameter.name in ("s", "p") else f"&{parameter.name}"
