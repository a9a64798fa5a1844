"""A C function that runs a step over a whole record, for use on a computer: NAME_record.c beside the files of `c99`.

Rows of u (count, m) and y (count, p) go in; rows of x (count, n), of the traces (count, number of traces) and the
status (count) come out.
"""

from hgogen.emit.cnames import c_name
from hgogen.emit.cprint import Real
from hgogen.emit.ctext import indented, status_type
from hgogen.step import Step
from hgogen.target import Files


def record(step: Step, *, real: Real = "double") -> Files:
    """The record runner of a step as C99 text."""
    name, m, p, n = step.name, len(step.inputs), len(step.outputs), len(step.states)
    traces = step.observer.traces
    call = ", ".join(["s", "p", *(["&in"] if m else []), "&out"])
    inner = [f"in.{c_name(s.name)} = u[{m}u*k + {j}u];" for j, s in enumerate(step.inputs)]
    inner += [f"out.{c_name(s.name)} = y[{p}u*k + {j}u];" for j, s in enumerate(step.outputs)]
    inner += [f"status[k] = {name}_step({call});", f"{name}_estimate(s, p, &plant);"]
    inner += [f"x[{n}u*k + {i}u] = plant.{c_name(s.name)};" for i, s in enumerate(step.states)]
    counters = {field.name for field in step.state if field.kind == "index"}
    values = [f"({real})s->{trace}" if trace in counters else f"s->{trace}" for trace in traces]
    inner += [f"traces[{len(traces)}u*k + {j}u] = {value};" for j, value in enumerate(values)]
    arguments = f"{name}_state *s, const {name}_params *p, size_t count, const {real} *u, const {real} *y"
    results = f"{real} *x, {real} *traces, {status_type(step)} *status"
    head = f"void {name}_record({arguments}, {results})"
    sizes = [f"size_t {name}_state_size(void)", f"size_t {name}_params_size(void)"]
    kinds = ("state", "params")
    lines = ["#include <stddef.h>", "", f'#include "{name}.h"', "", *(f"{s};" for s in (head, *sizes)), ""]
    for prototype, kind in zip(sizes, kinds, strict=True):
        lines += [prototype, "{", f"    return sizeof({name}_{kind});", "}", ""]
    unused = ([] if m else ["(void)u;"]) + ([] if traces else ["(void)traces;"])
    declared = [*([f"{name}_input in;"] if m else []), f"{name}_output out;", f"{name}_plant plant;", *unused]
    loop = ["for (size_t k = 0u; k < count; ++k) {", *indented(inner), "}"]
    lines += [head, "{", *indented([*declared, *loop]), "}"]
    return Files(((f"{name}_record.c", "\n".join(lines) + "\n"),))
