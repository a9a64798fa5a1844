"""C functions that run a step on many records at once: NAME_lanes.c, for GNU compilers.

A register has one number of each of several records, its lanes. A call of `NAME_lanes_run` takes `NAME_LANES` records
side by side, as u (count, m, width) and y (count, p, width), and returns estimates, traces and statuses (count,
numbers, width). The width of u or y is 0 where all records have the same signal. State and parameters are in `memory`,
number by number in the order of the C structs. Without contraction (`-ffp-contract=off`) the bits are those of the
scalar C.
"""

from dataclasses import replace

from hgogen.emit.code import Code, braced, code, indented, joined
from hgogen.emit.lanewriter import LaneWriter, lane_prefix, prelude, table, with_uniform_counts
from hgogen.emit.lanewriter import lanes as in_lanes
from hgogen.emit.naming import c_name, demand_distinct, demand_file
from hgogen.emit.portable import functions, kernels, tables
from hgogen.emit.statements import routines
from hgogen.emit.structs import Struct, structs, typedefs
from hgogen.emit.syntax import Real, demand_real
from hgogen.emit.syntaxes import C
from hgogen.program import Program
from hgogen.step import Step, demand_step
from hgogen.stepping.discretise import demand_motion
from hgogen.target import Files


def lanes(step: Step, *, real: Real = "double") -> Files:
    """Return the step as C text for SIMD lanes (vector element k computes log k).

    Raises: `NoStep`, `BadReal`; `StepTooShort` where a state stands still in that precision; as `c99` does for names
    and numbers; `NoLanes` for a kernel that has no such text.
    """
    demand_step(step, "lanes")
    demand_real(real)
    demand_motion(step.observer.form, step.shortest, real)
    demand_file(step.name)
    demand_distinct(step, C)
    writer = LaneWriter(in_lanes(step.name, real), step, real)
    sections = [_section(writer, section.name, section.program) for section in step.code.sections]
    reports = (_section(writer, report.name, report.program) for report in step.code.reports)
    whole = joined([*sections, _section(writer, "estimate", step.code.estimate), *reports])
    text = routines(writer, whole.uses.routines) + whole
    includes = [f"#include <{name}.h>" for name in ("stdbool", "stddef", "stdint")]
    searches = tables(C, f"{lane_prefix(step.name)}_one", real, text.uses.lookups).lines
    vectors = prelude(step.name, real, 8 * step.layout.word.itemsize)
    looked = (table(step.name, real, each) for each in sorted(text.uses.lookups, key=lambda each: each.name))
    matrices = kernels(with_uniform_counts(step.name, real), step.name, real, text.uses.kernels)
    text = functions(writer.syntax, step.name, real, text.uses.helpers) + joined(looked) + matrices + text
    lines = [*includes, "", *_NEEDS, *searches, *vectors, *_structs(writer), *text.lines, *_many(writer)]
    return Files(((f"{step.name}_lanes.c", "\n".join(lines) + "\n"),))


_NEEDS = (  # vector types, conversions between them, and operations that round to the working precision
    "#if !defined(__GNUC__) || (!defined(__clang__) && (__GNUC__ < 9)) || (__FLT_EVAL_METHOD__ != 0)",
    '#error "needs vectors of GCC 9 or Clang, and FLT_EVAL_METHOD 0"',
    "#endif",
    "",
)


# --- functions


def _section(writer: LaneWriter, name: str, program: Program) -> Code:
    status = f"{lane_prefix(writer.prefix)}_status"
    parameters = ", ".join(f"{writer.prefix}_{kind} *{parameter}" for parameter, kind in _passed(writer.step).items())
    inner = code(f"{status} status = {{0}};") + writer.function(program) + code("return status;")
    return code(f"static {status} {writer.prefix}_{name}({parameters})") + braced("{", inner) + code("")


# --- memory

_STRUCTS = {"s": "state", "p": "params", "in": "input", "measurement": "output", "x": "plant"}


def _passed(step: Step) -> dict[str, str]:
    """Return the structs that are parameters of every function in lanes, by the names of the parameters."""
    return _STRUCTS | {report.name: report.struct for report in step.code.reports}


def _structs(writer: LaneWriter) -> list[str]:
    p, none = writer.prefix, f"{writer.syntax.types[writer.real]} none;"
    known = {"input": Struct("input", "", ())} | structs(writer.step, writer.syntax, writer.real, marked=True)
    lines = [line for each in typedefs(p, known, none, lambda _: "") for line in each]
    return [*lines, "typedef struct {", f"    {p}_state s;", f"    {p}_params p;", f"}} {lane_prefix(p)}_kept;", ""]


# --- many records


def _many(writer: LaneWriter) -> list[str]:
    """Return the lines of the C function that calls the step for each row of a log in all lanes (one log in each vector
    element), and of the constants with the sizes that a caller needs."""
    step, p, real = writer.step, writer.prefix, writer.real
    inputs = [_loaded(p, "u", len(step.given), j, f"in.{c_name(each.name)}") for j, each in enumerate(step.given)]
    outputs = [
        _loaded(p, "y", len(step.samples), j, f"measurement.{c_name(each.name)}") for j, each in enumerate(step.samples)
    ]
    locals_ = {"in": "in", "measurement": "measurement", "x": "plant"}
    locals_ |= {report.name: report.name for report in step.code.reports}
    arguments = ", ".join(["&memory->s", "&memory->p", *(f"&{name}" for name in locals_.values())])
    sections = (f"status |= {p}_{section.name}({arguments});" for section in step.code.sections)
    x = [_stored(p, "x", len(step.states), i, f"plant.{c_name(each.name)}") for i, each in enumerate(step.states)]
    inside = replace(writer, syntax=replace(writer.syntax, reach="memory->{}."))
    here = replace(writer, syntax=replace(writer.syntax, reach="{}."))
    places = ((inside if each.place.struct == "state" else here, each) for each in step.traced)
    values = (one.number(each.place, each.index, each.size) for one, each in places)
    traces = [_stored(p, "traces", len(step.traces), j, value) for j, value in enumerate(values)]
    reports = [f"(void){p}_{report.name}({arguments});" for report in step.code.reports]
    body = [
        *(f"{p}_{_passed(step)[parameter]} {name};" for parameter, name in locals_.items()),
        f"{lane_prefix(p)}_status status = {{0}};",
        *(*inputs, *outputs, *sections, f"(void){p}_estimate({arguments});", *x),
        *(["if (traces) {", *indented([*reports, *traces]), "}"] if traces else []),
        f"*({lane_prefix(p)}_word *)&statuses[width[2]*k] = __builtin_convertvector(status, {lane_prefix(p)}_word);",
    ]
    sizes = {"width": f"{p.upper()}_LANES", "size": f"sizeof({lane_prefix(p)}_kept)"}
    return [
        *(f"size_t {lane_prefix(p)}_{name}(void) {{ return {value}; }}" for name, value in sizes.items()),
        f"void {lane_prefix(p)}_run({lane_prefix(p)}_kept *memory, size_t count, const size_t width[3],",
        f"    const {real} *u, const {real} *y, {real} *x, {real} *traces, {step.layout.word}_t *statuses)",
        *("{", "    for (size_t k = 0u; k < count; ++k) {", *indented(body, 8), "    }", "}"),
    ]


def _loaded(p: str, array: str, size: int, j: int, place: str) -> str:
    width, at, p = f"width[{'uy'.index(array)}]", f"{size}u*k + {j}u", lane_prefix(p)
    by_lane = f"({p}_numbers)*(const {p}_row *)&{array}[({at})*{width}]"
    return f"{place} = {width} ? {by_lane} : {p}_fill({array}[{at}]);"


def _stored(p: str, array: str, size: int, j: int, value: str) -> str:
    return f"*({lane_prefix(p)}_row *)&{array}[({size}u*k + {j}u)*width[2]] = {value};"
