"""The self-checks of emitted code, NAME_check.c and NAME_check.rs: recorded samples with their expected results."""

# Takes apart: templates, whose lines it makes.

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from string import Template

from hgogen.emit.code import indented
from hgogen.emit.heads import arguments, rust_status_type
from hgogen.emit.interface import Parameter, address, prototypes, reported, status_type, structs
from hgogen.emit.pystep import (
    MISSING,
    SAVED,
    Vectors,
    begun,
    compared,
    fault_words,
    lost_samples,
    record_vectors,
)
from hgogen.emit.statements import Writer
from hgogen.emit.syntax import Real, Syntax
from hgogen.emit.syntaxes import RUST, C
from hgogen.program import Place
from hgogen.step import Step


def caller(syntax: Syntax, step: Step, real: Real) -> Writer:
    """Return a writer of C or Rust code that calls a step, whose variables have the names of the step's parameters."""
    return Writer(replace(syntax, reach="{}."), step, real)


def recorded(here: Writer, row: str, across: int) -> dict[str, str]:
    """Return the texts that fill a self-check's template, by name. Computing the test vectors in them takes a while.

    Args: `here` the writer of the calling code; `row` the template of a row of numbers, with {}; `across` the statuses
    in a line.
    """
    step, syntax, real = here.step, here.syntax, here.real
    vectors = record_vectors(step, real)
    results = [here.lvalue(each.place, each.index, each.size) for each in compared(step)]
    signals = [here.place_text(place) for place, _ in _signals(step)]
    statuses = [f"{syntax.literal(value, 'unsigned')}," for value in vectors.status]

    def rows(table: Iterable[Sequence[float]]) -> str:
        numbers = ([syntax.literal(float(v) if v == v else 0.0, real) for v in each] for each in table)
        return block(row.format(", ".join(each)) for each in numbers)

    return {
        "name": step.name,
        "real": syntax.types[real],
        "count": str(len(vectors.status)),
        "faults": fault_words(step),
        "width": str(len(signals)),
        "signals": ", ".join(signals),
        "given": rows([*u, *y] for u, y in zip(vectors.u, vectors.y, strict=True)),
        "results": str(len(results)),
        "names": ", ".join(results),
        "wanted": rows(vectors.values),
        "tolerance": ", ".join(syntax.literal(float(value), real) for value in vectors.tolerance),
        "expected": block(" ".join(statuses[k : k + across]) for k in range(0, len(statuses), across)),
        "placed": block(_placed(here, vectors), 8),
    }


def _results(here: Writer) -> list[str]:
    return [here.number(each.place, each.index, each.size) for each in compared(here.step)]


def _placed(here: Writer, vectors: Vectors) -> Iterator[str]:
    """Yield the lines that give the state the values which a self-check sets before some samples."""
    for k, values in vectors.placed.items():
        yield here.syntax.condition.format(f"k == {here.syntax.number(k)}")
        for place, each in values.items():
            elements = (here.lvalue(place, i, len(each)) for i in range(len(each)))
            yield from indented(
                f"{element} = {here.syntax.literal(value, here.real)};"
                for element, value in zip(elements, each, strict=True)
            )
        yield "}"


def filled(here: Writer, text: str) -> list[str]:
    """Return the lines that assign the signals of a call, inputs first; `text`: the template of one assignment."""
    return [
        text.format(place=here.place_text(place), name=here.syntax.name(place.name), column=column, missing=missing)
        for column, (place, missing) in enumerate(_signals(here.step))
    ]


def block(lines: Iterable[str], by: int = 4) -> str:
    """Return lines as one text, indented `by` blanks."""
    return "\n".join(indented(lines, by))


def _signals(step: Step) -> list[tuple[Place, int]]:
    no_input, no_output = lost_samples(step)
    inputs = [(Place("input", signal.name), no_input) for signal in step.given]
    return inputs + [(Place("output", signal.name), no_output) for signal in step.samples]


# CMSIS-DSP interpolates sine and cosine on 512 intervals: an error of (2 pi/512)^2/8, 160 times float's rounding unit
CMSIS = 160

_C_TEXT = Template("""
/*
 * Self-check of $name.c: $count recorded samples$faults.
 * ${name}_check() returns 0, or the number of the first sample that differs: $missing at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   ${upper}_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   ${upper}_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *   ${blank}             FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *   ${blank}             rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef ${upper}_CHECK_MAIN
#include <stdio.h>
#endif

#include "$name.h"

#if defined(${upper}_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define ${upper}_EVERY_BIT
#endif

unsigned ${name}_check(void);

static const $real given[$count][$width] = { /* $signals */
$given
};

static const $real wanted[$count][$results] = { /* $names */
$wanted
};

static const $status expected[$count] = { /* status */
$expected
};

#ifndef ${upper}_EVERY_BIT
static const $real tolerance[$results] = {$tolerance};
#endif

static bool ${name}_near($real have, unsigned k, unsigned i)
{
#if defined(${upper}_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(${upper}_USE_CMSIS)
    const $real room = $cmsis*tolerance[i];
#else
    const $real room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned ${name}_check(void)
{
    volatile const $real nan_given = ($real)NAN;
    const $real none = nan_given;
    unsigned bad = (none >= none) ? ${missing}u : 0u; /* compiled to take it for a number: sample $missing is lost */
$locals
    unsigned char saved[${upper}_SAVED];
    $init;
    for (unsigned k = 0u; k < ${count}u && bad == 0u; ++k) {
$placed
        if (k == ${restored}u) {
            ${name}_save(&s, saved);
            $reset;
            (void)${name}_restore(&s, saved, sizeof(saved)); /* refused, it leaves the reset state, which differs */
        }
$fill
        const $status status = $call;
        ${name}_estimate(&s, &p, &x);$reports
        if (status != expected[k]$compare) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef ${upper}_CHECK_MAIN
int main(void)
{
    const unsigned bad = ${name}_check();
    if (bad != 0u) {
        (void)printf("$name: sample %u differs\\n", bad);
    } else {
#if defined(${upper}_EXACT) && !defined(${upper}_EVERY_BIT)
        (void)printf("$name: $count samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\\n");
#else
        (void)printf("$name: $count samples as recorded\\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
""")


def c_check(step: Step, real: Real) -> list[str]:
    """Return the lines of a step's self-check in C, whose test vectors take a while to compute."""
    here = caller(C, step, real)
    results, values = _results(here), recorded(here, "{{{}}},", 16)

    def begin(parameter: Parameter) -> str:
        return C.literal(begun(step, real), real) if parameter.name == "t" else address(parameter)

    text = _C_TEXT.substitute(
        values,
        faults=values["faults"].replace(", a", ",\n * a", 1),
        upper=step.name.upper(),
        blank=" " * len(step.name),
        status=status_type(step),
        cmsis=C.literal(CMSIS, real),
        missing=MISSING + 1,
        restored=SAVED,
        init=prototypes(step)["init"].call(begin),
        reset=prototypes(step)["reset"].call(begin),
        locals=block(each.local for each in (*structs(step), *reported(step))),
        reports="".join(f"\n        {prototypes(step)[each.name].call(address)};" for each in step.code.reports),
        fill=block(filled(here, "{place} = (k == {missing}u) ? none : given[k][{column}];"), 8),
        call=prototypes(step)["step"].call(address),
        compare="".join(f" || !{step.name}_near({number}, k, {i}u)" for i, number in enumerate(results)),
    )
    return text.strip("\n").split("\n")


_RUST_TEXT = Template("""
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

/// $names
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
    let mut s = State::new($begun);
    for k in 0..$count {
$placed
        if k == $restored {
            s = State::restored(&s.save()).unwrap_or_else(${unread});
        }
$fill
        let status = s.step($arguments);
        let x = s.estimate(&p);$reports
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


def rust_check(step: Step, real: Real) -> list[str]:
    """Return the lines of a step's self-check in Rust, whose test vectors take a while to compute."""
    here, kind, many = caller(RUST, step, real), RUST.types[real], len(step.given)
    begin = RUST.literal(begun(step, real), real)
    fill = filled(here, f"{{name}}: if k == {{missing}} {{{{ {kind}::NAN }}}} else {{{{ GIVEN[k][{{column}}] }}}},")
    inputs = ["let input = Inputs {", *indented(fill[:many]), "};"] if many else []
    text = _RUST_TEXT.substitute(
        recorded(here, "[{}],", 1),
        status=rust_status_type(step),
        restored=SAVED,
        begun=begin if step.code.time else "",
        unread=f"|| State::new({begin})" if step.code.time else "State::new",
        structs="Inputs, " if many else "",
        signals=", ".join(signal.name for signal in (*step.given, *step.samples)),
        fill=block([*inputs, "let measurement = Outputs {", *indented(fill[many:]), "};"], 8),
        arguments=arguments(step),
        have=", ".join(_results(here)),
        reports="".join(f"\n        let {each.name} = s.{each.name}(&p);" for each in step.code.reports),
    )
    return text.strip("\n").split("\n")
