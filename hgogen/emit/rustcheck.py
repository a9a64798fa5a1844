"""NAME_check.rs: the self-check of emitted Rust, recorded inputs and what must come of them, bit for bit."""

# Takes apart: a template, whose lines it makes.

from collections.abc import Iterable
from string import Template

from hgogen.emit.code import indented
from hgogen.emit.rustmanual import arguments
from hgogen.emit.rustsyntax import RUST, rust_name
from hgogen.emit.syntax import Real
from hgogen.emit.vectors import faults, lost, places, record, start
from hgogen.program import Place
from hgogen.signal import Signal
from hgogen.step import Step

_TEXT = Template("""
//! Self-check of $name.rs: $count recorded samples$faults.
//! It is a program of the host; it ends with 0 where every bit is as recorded.
//!
//!     rustc --edition 2021 -O --crate-type lib $name.rs
//!     rustc --edition 2021 -O --extern $name=lib$name.rlib ${name}_check.rs

use ::$name::{${structs}Outputs, Parameters, State};

/// $signals
const GIVEN: [[$real; $width]; $count] = [
$given
];

/// $seen
const WANTED: [[$real; $results]; $count] = [
$wanted
];

/// status
const EXPECTED: [u32; $count] = [
$expected
];

/// The first sample that differs, counted from 1.
fn differs() -> Option<usize> {
    let p = Parameters::new();
    let mut s = State::new();
$start
    for k in 0..$count {
$fill
        let status = s.step($arguments);
        let x = s.estimate(&p);
        let have: [$real; $results] = [$have];
        let same = have.iter().zip(WANTED[k].iter()).all(|(a, b)| a.to_bits() == b.to_bits());
        if status != EXPECTED[k] || !same {
            return Some(k + 1);
        }
    }
    None
}

fn main() {
    match differs() {
        None => println!("$name: $count samples as recorded"),
        Some(sample) => {
            println!("$name: sample {} differs", sample);
            std::process::exit(1);
        }
    }
}
""")


def check(step: Step, real: Real) -> list[str]:
    """The self-check's lines; computing its vectors takes a while."""
    vectors, kind = record(step, real), RUST.types[real]
    width = len(step.inputs) + len(step.samples)
    no_input, no_output = lost(step)
    fill = _fill("input", "Inputs", step.inputs, 0, no_input, kind) if step.inputs else []
    fill += _fill("output", "Outputs", step.samples, len(step.inputs), no_output, kind)
    text = _TEXT.substitute(
        name=step.name,
        structs="Inputs, " if step.inputs else "",
        real=kind,
        count=len(vectors.status),
        faults=faults(step),
        width=width,
        results=len(places(step)),
        signals=", ".join(signal.name for signal in (*step.inputs, *step.samples)),
        seen=", ".join(map(_seen, places(step))),
        given=_rows(([*u, *y] for u, y in zip(vectors.u, vectors.y, strict=True)), real),
        wanted=_rows(vectors.seen, real),
        expected="\n".join(indented(f"{value}," for value in vectors.status)),
        start="\n".join(indented(_start(step, real))),
        fill="\n".join(indented(fill, 8)),
        arguments=arguments(step),
        have=", ".join(_number(step, place, kind) for place in places(step)),
    )
    return text.strip("\n").split("\n")


def _seen(place: Place) -> str:
    return f"x.{rust_name(place.name)}" if place.struct == "estimate" else f"s.{rust_name(place.name)}"


def _number(step: Step, place: Place, kind: str) -> str:
    counters = {Place("state", item.name) for item in step.state if item.kind == "index"}
    return f"{_seen(place)} as {kind}" if place in counters else _seen(place)


def _start(step: Step, real: Real) -> list[str]:
    """The estimate off its rest."""
    return [
        f"s.{rust_name(place.name)}{f'[{i}]' if len(values) > 1 else ''} = {RUST.literal(value, real)};"
        for place, values in start(step).items()
        for i, value in enumerate(values)
    ]


def _fill(name: str, struct: str, signals: Iterable[Signal], first: int, missing: int, kind: str) -> list[str]:
    """One sample; sample `missing` is not a number."""
    members = (
        f"{rust_name(signal.name)}: if k == {missing} {{ {kind}::NAN }} else {{ GIVEN[k][{j}] }},"
        for j, signal in enumerate(signals, first)
    )
    return [f"let {name} = {struct} {{", *indented(members), "};"]


def _rows(table: Iterable[Iterable[float]], real: Real) -> str:
    rows = [", ".join(RUST.literal(float(v) if v == v else 0.0, real) for v in row) for row in table]
    return "\n".join(indented(f"[{row}]," for row in rows))
