/* what is measured of a step: its memory, a sample, an estimate */
#include "$name.h"
typedef struct {
    ${name}_state s;
    ${name}_params p;
} memory;
#define BEGIN(m) $init, sample(m, record[0])

static void sample(memory *m, const real *row)
{
$locals
$given
    (void)$step;
}

static void estimate(const memory *m, real *values)
{
    ${name}_plant x;
    $estimate;
$states
}
