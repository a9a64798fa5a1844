"""C functions that run a step on a computer: NAME_record.c beside the files of `c99`.

`NAME_record` takes a whole record: rows of u (count, m) and y (count, p) go in; rows of x (count, n), of the traces
(count, number of traces) and the status (count) come out. NAME_kept holds all that a sample works on, and
`NAME_kept_step`, or `NAME_kept_SECTION` for a part of it, takes a sample from it and leaves the estimate in it.
"""

from hgogen.emit.cnames import c_name
from hgogen.emit.cprint import Real
from hgogen.emit.ctext import arguments, indented, status_type
from hgogen.step import Step
from hgogen.target import Files


def record(step: Step, *, real: Real = "double") -> Files:
    """The record runner of a step as C99 text."""
    name, m, p, n, kind = step.name, len(step.inputs), len(step.outputs), len(step.states), status_type(step)
    traces = _traces(step, real)
    of_record = f"{name}_state *s, const {name}_params *p, size_t count, const {real} *u, const {real} *y"
    sizes = [f"size_t {name}_{struct}_size(void)" for struct in ("state", "params", "kept")]
    bodies = {size: [f"return sizeof({size.split()[1].removesuffix('_size(void)')});"] for size in sizes}
    bodies |= _entries(step, traces)
    inner = [f"in.{c_name(s.name)} = u[{m}u*k + {j}u];" for j, s in enumerate(step.inputs)]
    inner += [f"out.{c_name(s.name)} = y[{p}u*k + {j}u];" for j, s in enumerate(step.outputs)]
    inner += [f"status[k] = {name}_step({', '.join(['s', 'p', *(['&in'] if m else []), '&out'])});"]
    inner += [f"{name}_estimate(s, p, &plant);"]
    inner += [f"x[{n}u*k + {i}u] = plant.{c_name(s.name)};" for i, s in enumerate(step.states)]
    inner += [f"traces[{len(traces)}u*k + {j}u] = {value};" for j, value in enumerate(traces)]
    unused = ([] if m else ["(void)u;"]) + ([] if traces else ["(void)traces;"])
    declared = [*([f"{name}_input in;"] if m else []), f"{name}_output out;", f"{name}_plant plant;", *unused]
    bodies[f"void {name}_record({of_record}, {real} *x, {real} *traces, {kind} *status)"] = [
        *declared,
        "for (size_t k = 0u; k < count; ++k) {",
        *indented(inner),
        "}",
    ]
    lines = ["#include <stddef.h>", "", f'#include "{name}.h"', "", *_kept(step, real), ""]
    lines += [*(f"{prototype};" for prototype in bodies), ""]
    for prototype, body in bodies.items():
        lines += [prototype, "{", *indented(body), "}", ""]
    return Files(((f"{name}_record.c", "\n".join(lines[:-1]) + "\n"),))


def _traces(step: Step, real: Real) -> list[str]:
    counters = {field.name for field in step.state if field.kind == "index"}
    return [f"({real})s->{trace}" if trace in counters else f"s->{trace}" for trace in step.observer.traces]


def _kept(step: Step, real: Real) -> list[str]:
    """The struct of a sample, as `layout.kept_type` has it."""
    kinds = {"input": ("in", step.inputs), "output": ("out", step.outputs), "plant": ("x", step.states)}
    members = [f"{step.name}_state s;", f"{step.name}_params p;", *(["unsigned at;"] if step.timed else [])]
    members += [f"{step.name}_{kind} {short};" for kind, (short, signals) in kinds.items() if signals]
    members += [f"{real} traces[{len(step.observer.traces)}];"] if step.observer.traces else []
    return ["typedef struct {", *indented(members), f"}} {step.name}_kept;"]


def _entries(step: Step, traces: list[str]) -> dict[str, list[str]]:
    """The functions of a sample, by prototype."""
    name, kind = step.name, status_type(step)
    places = {"s": "s", "p": "&k->p", "in": "&k->in", "out": "&k->out", "at": "(uint16_t)k->at"}
    called = {"step": arguments(step)}
    if step.apart:
        called |= {part.name: arguments(step, part.program) for part in (*step.sections, *step.timed)}
    given = {
        section: ", ".join(places[text.replace("*", " ").split()[-1]] for text in texts)
        for section, texts in called.items()
    }
    calls = {section: f"const {kind} status = {name}_{section}({text});" for section, text in given.items()}
    shown = [f"{name}_estimate(s, &k->p, &k->x);", *(f"k->traces[{j}] = {value};" for j, value in enumerate(traces))]
    found = {
        f"{kind} {name}_kept_{section}({name}_kept *k)": [f"{name}_state *s = &k->s;", call, *shown, "return status;"]
        for section, call in (calls | {"estimate": f"const {kind} status = 0u;"}).items()
    }
    return found | {f"{kind} {name}_kept_tune({name}_kept *k)": [f"return {name}_tune(&k->p);"]}
