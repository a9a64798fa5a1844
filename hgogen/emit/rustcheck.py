"""NAME_check.rs: the self-check of emitted Rust, recorded inputs and what must come of them, bit for bit."""

# Takes apart: a template, whose lines it makes.

from string import Template

from hgogen.emit.code import indented
from hgogen.emit.rustmanual import arguments, status_type
from hgogen.emit.rustsyntax import RUST
from hgogen.emit.selfcheck import block, caller, filled, recorded
from hgogen.emit.syntax import Real
from hgogen.emit.vectors import places
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
const EXPECTED: [$status; $count] = [
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
    here, kind, many = caller(RUST, step, real), RUST.types[real], len(step.inputs)
    fill = filled(here, f"{{name}}: if k == {{missing}} {{{{ {kind}::NAN }}}} else {{{{ GIVEN[k][{{column}}] }}}},")
    inputs = ["let input = Inputs {", *indented(fill[:many]), "};"] if many else []
    text = _TEXT.substitute(
        recorded(here, "[{}],", 1),
        status=status_type(step),
        structs="Inputs, " if many else "",
        signals=", ".join(signal.name for signal in (*step.inputs, *step.samples)),
        fill=block([*inputs, "let output = Outputs {", *indented(fill[many:]), "};"], 8),
        arguments=arguments(step),
        have=", ".join(map(here.number, places(step))),
    )
    return text.strip("\n").split("\n")
