/*
 * %{name} on a board, one call every %{pace}.
 * A timer's interrupt takes the measurements and calls the step; the rest reads a copy of the estimate.
 * Replace what is marked as yours. On a host, as it stands, the program calls the interrupt itself.
 */
#include <stdbool.h>
#include <stdint.h>

#include "%{name}.h"

static %{name}_state s; /* of the interrupt alone, after init */
static %{name}_params p;

/* The last two estimates: the interrupt writes the one that is not shown, then shows it. */
static volatile %{name}_plant estimates[2];
static volatile uint32_t samples; /* written at once on a machine of 32 bits */
static volatile %{word} bits;    /* of the status, since the program last took them */

/* Yours: what sensors measure, NAN of <math.h> where nothing is new, and what actuators were told. */
%{readers}

/* Yours: the handler of the timer, such as TIM2_IRQHandler, by its name in the vector table. */
static void timer_interrupt(void)
{
%{called}
    const %{word} status = %{step};
    %{estimate};
    estimates[(samples + 1u) & 1u] = x;
    ++samples;
    bits |= status;
}

/* A copy that no interrupt has torn. */
static %{name}_plant latest(void)
{
    uint32_t before = samples;
    for (;;) {
        const %{name}_plant x = estimates[before & 1u];
        const uint32_t after = samples;
        if (after == before) {
            return x;
        }
        before = after;
    }
}

/* Yours, with the interrupt of the timer disabled around it. */
static %{word} taken_bits(void)
{
    const %{word} since = bits;
    bits = 0u;
    return since;
}

/* Yours: sleep until the next interrupt, such as by __WFI(), and go on for ever. */
static bool sample_came(void)
{
    timer_interrupt();
    return samples <= 1000u;
}

int main(void)
{
    %{init}; /* then start the timer, with a period of %{upper}_DT */
    while (sample_came()) {
        const %{name}_plant x = latest();
        if (taken_bits() == 0u) { /* else README.md says what each bit asks */
%{used}
        }
    }
    return 0;
}
