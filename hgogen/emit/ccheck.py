"""NAME_check.c: the self-check of emitted C, recorded inputs and what must come of them."""

# Takes apart: a template, whose lines it makes.

from string import Template

from hgogen.emit.cfunction import address, prototypes, status_type, structs
from hgogen.emit.csyntax import C
from hgogen.emit.selfcheck import block, caller, filled, recorded
from hgogen.emit.syntax import Real
from hgogen.emit.vectors import MISSING, places
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
    here = caller(C, step, real)
    seen, values = map(here.number, places(step)), recorded(here, "{{{}}},", 16)
    text = _TEXT.substitute(
        values,
        faults=values["faults"].replace(", a", ",\n * a", 1),
        upper=step.name.upper(),
        blank=" " * len(step.name),
        status=status_type(step),
        cmsis=C.literal(CMSIS, real),
        missing=MISSING + 1,
        locals=block(each.local for each in structs(step)),
        fill=block(filled(here, "{place} = (k == {missing}u) ? none : given[k][{column}];"), 8),
        call=prototypes(step)["step"].call(address),
        compare="".join(f" || !{step.name}_near({number}, k, {i}u)" for i, number in enumerate(seen)),
    )
    return text.strip("\n").split("\n")
