"""NAME_check.c: the self-check of emitted C, recorded inputs and what must come of them."""

# Takes apart: a template, whose lines it makes.

from collections.abc import Iterable
from string import Template

from hgogen.emit.cfunction import address, prototypes, status_type, structs
from hgogen.emit.cnames import c_name
from hgogen.emit.code import indented
from hgogen.emit.csyntax import C
from hgogen.emit.syntax import Real
from hgogen.emit.vectors import MISSING, faults, lost, places, record, start
from hgogen.program import Place
from hgogen.step import Step

# CMSIS-DSP interpolates sine and cosine on 512 intervals: an error of (2 pi/512)^2/8, 160 times float's rounding unit
CMSIS = 160

_TEXT = Template("""
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

static const $real wanted[$count][$results] = { /* $seen */
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
    ${name}_init(&s, &p);
$start
    for (unsigned k = 0u; k < ${count}u && bad == 0u; ++k) {
$fill
        const $status status = $call;
        ${name}_estimate(&s, &p, &x);
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


def check(step: Step, real: Real) -> list[str]:
    """The self-check's lines; computing its vectors takes a while."""
    vectors, seen = record(step, real), list(map(_seen, places(step)))
    no_input, no_output = lost(step)
    inputs, outputs = [f"in.{c_name(s.name)}" for s in step.inputs], [f"out.{c_name(s.name)}" for s in step.samples]
    text = _TEXT.substitute(
        name=step.name,
        upper=step.name.upper(),
        blank=" " * len(step.name),
        real=real,
        status=status_type(step),
        count=len(vectors.status),
        width=len(inputs) + len(outputs),
        results=len(seen),
        signals=", ".join([*inputs, *outputs]),
        seen=", ".join(seen),
        given=_rows(([*u, *y] for u, y in zip(vectors.u, vectors.y, strict=True)), real),
        wanted=_rows(vectors.seen, real),
        expected=_block([f"{value}u" for value in vectors.status]),
        tolerance=", ".join(C.literal(float(value), real) for value in vectors.tolerance),
        cmsis=C.literal(CMSIS, real),
        locals="\n".join(indented(each.local for each in structs(step))),
        start="\n".join(indented(_start(step, real))),
        missing=MISSING + 1,
        faults=faults(step).replace(", a", ",\n * a", 1),
        fill="\n".join(indented((*_fill(inputs, 0, no_input), *_fill(outputs, len(inputs), no_output)), 8)),
        call=prototypes(step)["step"].call(address),
        compare="".join(
            f" || !{step.name}_near({name}, k, {i}u)" for i, name in enumerate(_as_numbers(step, real, seen))
        ),
    )
    return text.strip("\n").split("\n")


def _seen(place: Place) -> str:
    return f"x.{c_name(place.name)}" if place.struct == "estimate" else f"s.{place.name}"


def _as_numbers(step: Step, real: Real, seen: Iterable[str]) -> list[str]:
    """What is seen, counters as real numbers."""
    counters = {f"s.{field.name}" for field in step.state if field.kind == "index"}
    return [f"({real}){name}" if name in counters else name for name in seen]


def _start(step: Step, real: Real) -> list[str]:
    """The estimate off its rest."""
    members = {f"s.{place.name}": values for place, values in start(step).items()}
    return [
        f"{member}{f'[{i}]' if len(values) > 1 else ''} = {C.literal(v, real)};"
        for member, values in members.items()
        for i, v in enumerate(values)
    ]


def _fill(signals: list[str], first: int, missing: int) -> list[str]:
    """Assignments of one sample; at sample `missing` it is not a number."""
    return [f"{signal} = (k == {missing}u) ? none : given[k][{j}];" for j, signal in enumerate(signals, first)]


def _rows(table: Iterable[Iterable[float]], real: Real) -> str:
    rows = [", ".join(C.literal(float(v) if v == v else 0.0, real) for v in row) for row in table]
    return "\n".join(indented(f"{{{row}}}," for row in rows))


def _block(items: list[str], width: int = 16) -> str:
    return "\n".join(indented(", ".join(items[i : i + width]) + "," for i in range(0, len(items), width)))
