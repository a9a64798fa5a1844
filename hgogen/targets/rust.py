"""Rust for firmware: NAME.rs, a crate without `std`, and NAME_check.rs with recorded vectors.

No unsafe code, no heap, no statics, no crates; the same memory but for its mark, order of operations and functions as
in C, so the same bits. Its documentation is the manual. It compiles with Rust 1.63 and later.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from hgogen.emit import saved
from hgogen.emit.code import Code, code, indented, joined, spaced
from hgogen.emit.heads import documentation, rust_status, rust_status_type
from hgogen.emit.interface import Entry, entries
from hgogen.emit.manual import proved_above
from hgogen.emit.naming import demand_distinct, sources
from hgogen.emit.portable import functions, kernels, tables
from hgogen.emit.selfcheck import rust_check
from hgogen.emit.statements import Writer, called, reading, routines
from hgogen.emit.structs import Struct, doc, rust_initial, rust_structs, structs
from hgogen.emit.syntax import Real, demand_real
from hgogen.emit.syntaxes import KEYWORDS, RUST
from hgogen.errors import HgogenError
from hgogen.reading.given import demand_switch
from hgogen.step import Step, demand_step
from hgogen.stepping.discretise import demand_motion
from hgogen.target import Recipe, Sources

_CRATES = {"alloc", "core", "proc_macro", "std", "test"}
_ATTRIBUTES = (
    "#![no_std]",
    "#![forbid(unsafe_code)]",
    "// names are the model's; locals begin with a value, for a branch may leave them without one of its own;",
    "// a unit in brackets is no link",
    "#![allow(non_snake_case, non_upper_case_globals, unused_assignments, unused_mut)]",
    "#![allow(clippy::all, rustdoc::all)]",
)
_ARGUMENTS = {"p": "p: &Parameters", "in": "input: &Inputs", "measurement": "measurement: &Outputs", "at": "at: u16"}


@dataclass(eq=False)
class NoCrate(HgogenError):
    """The error for a model whose name no crate can have."""

    text = "the model {name} cannot be a crate of Rust, where that is a crate or a keyword; rename the model"
    name: str


def rust(step: Step, *, real: Real = "float", command: str = "", check: bool = True) -> Sources:
    """Return the step as a Rust crate and its self-check, by file name.

    Args: `real` "float" or "double"; `command` what made it, for the banner; `check` whether to add the
    self-check, whose vectors take a while to compute.

    Raises: `NoStep`, `BadReal`; `StepTooShort` where a state stands still in that precision; `NoCrate`, `OneName` for
    names that Rust cannot carry; `BeyondFloat`, `NotPrintable` for a number, an operation that has no text;
    `PointsMerge` for a table.
    """
    demand_step(step, "rust")
    demand_switch("rust, check=", check)
    demand_real(real)
    demand_motion(step.observer.form, step.shortest, real)
    if step.name in _CRATES | KEYWORDS:
        raise NoCrate(step.name)
    demand_distinct(step, RUST)
    files = {f"{step.name}.rs": _source(step, real, command)}
    files |= {f"{step.name}_check.rs": rust_check(step, real)} if check else {}
    compiler, name = ("rustc", "--edition", "2021", "-O"), step.name
    recipe: Recipe = (  # of the self-check
        (*compiler, "--crate-type", "lib", f"{name}.rs"),
        (*compiler, "--extern", f"{name}=lib{name}.rlib", f"{name}_check.rs", "-o", "check"),
        ("./check",),
    )
    return sources(step, RUST, files, recipe if check else ())


def _source(step: Step, real: Real, command: str) -> list[str]:
    writer, memory = Writer(RUST, step, real), structs(step, RUST, real, marked=False, notes=proved_above(step))
    state, parameters = _methods(writer, memory)
    shared = routines(writer, state.uses.routines)
    used = (state + parameters + shared).uses
    private = functions(RUST, step.name, real, used.helpers) + tables(RUST, step.name, real, used.lookups)
    private += kernels(RUST, step.name, real, used.kernels) + shared
    return [
        *documentation(step, real, command),
        *_ATTRIBUTES,
        "",
        *rust_status(step),
        *saved.rust_constants(step, real),
        *rust_structs(step, memory),
        "impl Parameters {",
        *parameters.indented().lines,
        "}",
        "",
        "impl State {",
        *state.indented().lines,
        "}",
        *(["", *private.lines[:-1]] if private.lines else []),  # each of them ends with an empty line
        "",
        *saved.RUST_FUNCTIONS,
    ]


def _methods(writer: Writer, memory: Mapping[str, Struct]) -> tuple[Code, Code]:
    step = writer.step
    known = entries(step)
    functions = (*step.code.inner, *step.code.parts, *step.code.timed)
    bodies = {section.name: writer.function(section.program) for section in functions}
    calls = joined(called(RUST, step, section) for section in step.code.parts)
    bodies["step"] = calls if step.code.parts else writer.function(step.code.sections[0].program)
    fresh = indented(["State {", *indented(rust_initial(memory, "state")), "}"])
    meaning = doc(known["reset"].meaning)
    if step.code.time:
        (section,), time = step.code.time, f"t: {RUST.types[writer.real]}"
        begun = [f"let mut s = State::{saved.initial_state_call(step)};", f"s.{section.name}(t);", "s"]
        setting = code("let s = self;") + writer.function(section.program)
        of_state = [
            code("const fn initial() -> State {", *fresh, "}"),
            code(*meaning, f"pub fn new({time}) -> State {{", *indented(begun), "}"),
            code(*meaning, f"pub fn reset(&mut self, {time}) {{", "    *self = State::new(t);", "}"),
            code(*doc(section.meaning), f"pub fn {section.name}(&mut self, {time}) {{")
            + setting.indented()
            + code("}"),
        ]
    else:
        of_state = [code(*meaning, "pub const fn new() -> State {", *fresh, "}")]
        of_state.append(code(*meaning, "pub fn reset(&mut self) {", "    *self = State::new();", "}"))
    of_state += [_method(step, known[name], body) for name, body in bodies.items()]
    of_state += [code(*saved.rust_save(step)), code(*saved.rust_restored(step, writer.real))]
    of_state.append(_reading(known["estimate"], memory["estimate"], writer.function(step.code.estimate)))
    for report in step.code.reports:
        body = reading(RUST, step, writer.real).function(report.program)
        of_state.append(_reading(known[report.name], memory[report.struct], body))
    tuned = code("let mut p = Parameters {", *indented(rust_initial(memory, "parameters")), "};", "p.tune();", "p")
    new = code("/// nominal parameters, tuned", "pub fn new() -> Parameters {") + tuned.indented() + code("}")
    of_parameters = [new, _method(step, known["tune"], writer.function(step.code.tuning))]
    return spaced(of_state), spaced(of_parameters)


def _method(step: Step, entry: Entry, body: Code) -> Code:
    (written,) = entry.written
    others = [name for name in entry.parameters if name != written]
    parameters = ", ".join(["&mut self", *(_ARGUMENTS[name] for name in others)])
    head = f"{'pub ' if entry.public else ''}fn {entry.name}({parameters}) -> {rust_status_type(step)} {{"
    start = [f"let {written} = self;"] if written in body.uses.parameters else []
    inner = code(*start, *_idle(others, body), "let mut status = 0;") + body + code("status")
    return code(*doc(entry.meaning), head) + inner.indented() + code("}")


def _reading(entry: Entry, struct: Struct, body: Code) -> Code:
    (result,) = entry.written
    kind = RUST.struct("", struct.kind)
    start = ["let s = self;"] if "s" in body.uses.parameters else []
    initial = [f"let mut {result} = {kind} {{", *indented(rust_initial({struct.kind: struct}, struct.kind)), "};"]
    if all(len(member.initial) == 1 for member in struct.members):
        zeros = ", ".join(f"{member.name}: {member.initial[0]}" for member in struct.members)
        initial = [f"let mut {result} = {kind} {{ {zeros} }};"]
    inner = code(*start, *_idle(["p"], body), *initial) + body + code(result)
    head = f"pub fn {entry.name}(&self, p: &Parameters) -> {kind} {{"
    return code(*doc(entry.meaning), head) + inner.indented() + code("}")


def _idle(names: list[str], body: Code) -> list[str]:
    idle = (RUST.parameters.get(name, name) for name in names if name not in body.uses.parameters)
    return [f"let _ = {name};" for name in idle]
