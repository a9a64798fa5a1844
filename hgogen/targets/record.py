"""C functions that run a step on a computer: NAME_record.c, for the files of `c99`.

`NAME_record` takes a whole record, rows of u (count, m) and y (count, p), and returns rows of x (count, n), of the
traces (count, number of traces) and the status (count). NAME_kept is all memory of a sample; `NAME_kept_step`, or
`NAME_kept_SECTION` for a part of it, takes a sample from it and writes the estimate to it.
"""

from dataclasses import replace

from hgogen.emit.code import indented
from hgogen.emit.interface import Parameter, Prototype, prototypes, reported, status_type, structs
from hgogen.emit.naming import c_name
from hgogen.emit.statements import Writer
from hgogen.emit.syntax import Real, demand_real
from hgogen.emit.syntaxes import C
from hgogen.step import Step, demand_step
from hgogen.target import Files


def record(step: Step, *, real: Real = "double") -> Files:
    """Return the record runner of a step as C99 text. Raises: `NoStep`, `BadReal`."""
    demand_step(step, "record")
    demand_real(real)
    name, writer = step.name, Writer(C, step, real)
    sizes = {Prototype("size_t", f"{name}_{struct}_size"): f"{name}_{struct}" for struct in ("state", "params", "kept")}
    bodies = {prototype: [f"return sizeof({struct});"] for prototype, struct in sizes.items()}
    bodies |= _entries(step, _traces(writer, "k->{}."))
    bodies[_runner(step, real)] = _run(step, _traces(writer, "{}."))
    lines = ["#include <stddef.h>", "", f'#include "{name}.h"', "", *_sample(step, real), ""]
    lines += [*(f"{prototype};" for prototype in bodies), ""]
    for prototype, body in bodies.items():
        lines += [str(prototype), "{", *indented(body), "}", ""]
    return Files(((f"{name}_record.c", "\n".join(lines[:-1]) + "\n"),))


def _traces(writer: Writer, reach: str) -> list[str]:
    """Return the C texts of a step's traces, those of the observer's state as members of `s`; `reach`: the text of a
    report's struct."""
    of_reports = replace(writer, syntax=replace(writer.syntax, reach=reach))
    writers = ((writer if each.place.struct == "state" else of_reports, each) for each in writer.step.traced)
    return [here.number(each.place, each.index, each.size) for here, each in writers]


def _runner(step: Step, real: Real) -> Prototype:
    s, p, *_ = prototypes(step)["step"].parameters
    arguments = (Parameter("size_t", "count", pointer=False), *(Parameter(real, name, constant=True) for name in "uy"))
    results = (Parameter(real, "x"), Parameter(real, "traces"), Parameter(status_type(step), "status"))
    return Prototype("void", f"{step.name}_record", (s, p, *arguments, *results))


def _run(step: Step, traces: list[str]) -> list[str]:
    name, declared, m, p, n = step.name, prototypes(step), len(step.given), len(step.samples), len(step.states)
    arguments = {"s": "s", "p": "p", "in": "&in", "measurement": "&measurement", "x": "&plant"}
    arguments |= {report.name: f"&{report.name}" for report in step.code.reports}
    steps, estimates = (declared[key].call(lambda each: arguments[each.name]) for key in ("step", "estimate"))
    inner = [f"in.{c_name(s.name)} = u[{m}u*k + {j}u];" for j, s in enumerate(step.given)]
    inner += [f"measurement.{c_name(s.name)} = y[{p}u*k + {j}u];" for j, s in enumerate(step.samples)]
    reports = [f"{declared[each.name].call(lambda to: arguments[to.name])};" for each in step.code.reports]
    inner += [f"status[k] = {steps};", f"{estimates};", *reports]
    inner += [f"x[{n}u*k + {i}u] = plant.{c_name(s.name)};" for i, s in enumerate(step.states)]
    inner += [f"traces[{len(traces)}u*k + {j}u] = {value};" for j, value in enumerate(traces)]
    unused = ([] if m else ["(void)u;"]) + ([] if traces else ["(void)traces;"])
    structs = [*([f"{name}_input in;"] if m else []), f"{name}_output measurement;", f"{name}_plant plant;"]
    structs += [*(each.local for each in reported(step)), *unused]
    return [*structs, "for (size_t k = 0u; k < count; ++k) {", *indented(inner), "}"]


def _sample(step: Step, real: Real) -> list[str]:
    s, p, *others = (each.local for each in structs(step))
    counted = [*(["unsigned at;"] * bool(step.code.timed)), *([f"{real} t;"] * bool(step.code.time))]
    members = [s, p, *counted, *(each.local for each in reported(step)), *others]
    members += [f"{real} traces[{len(step.traces)}];"] if step.traces else []
    return ["typedef struct {", *indented(members), f"}} {step.name}_kept;"]


def _entries(step: Step, traces: list[str]) -> dict[Prototype, list[str]]:
    declared = prototypes(step)
    parts = [section.name for section in (*step.code.sections, *step.code.timed)] if step.code.separable else []
    calls = {name: declared[name].call(_argument) for name in ("step", *parts)} | {"estimate": "0u"}
    outputs = [
        *(f"{declared[name].call(_argument)};" for name in ("estimate", *(each.name for each in step.code.reports))),
        *(f"k->traces[{j}] = {value};" for j, value in enumerate(traces)),
    ]
    kind, s = status_type(step), f"{step.name}_state *s = &k->s;"
    functions = {
        _entry(step, name): [s, f"const {kind} status = {call};", *outputs, "return status;"]
        for name, call in calls.items()
    }
    return functions | {_entry(step, "tune"): [f"return {declared['tune'].call(_argument)};"]}


def _entry(step: Step, name: str) -> Prototype:
    return Prototype(status_type(step), f"{step.name}_kept_{name}", (Parameter(f"{step.name}_kept", "k"),))


def _argument(parameter: Parameter) -> str:
    if not parameter.pointer:
        return f"({parameter.type})k->{parameter.name}"
    return "s" if parameter.name == "s" else f"&k->{parameter.name}"
