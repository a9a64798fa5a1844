/* instructions of `sample`, over the nominal rows of a record and the worst of those after them; and its stack, over all
 * rows and memory that is spoiled */
#include <string.h>

#include "mps2.h"
static memory m, copies[COPIES];
volatile real last;

static unsigned since(unsigned start_) /* ticks, of a counter of 24 bits that begins anew */
{
    return (ticks() - start_) & 0xffffffu;
}

static unsigned over(int first, int count)
{
    const unsigned start_ = ticks();
    for (int k = first; k < first + count; ++k) {
        sample(&m, record[k]);
    }
    return since(start_);
}

static unsigned of_one(int k) /* the instructions of a sample, of so many runs of it */
{
    for (int i = 0; i < COPIES; ++i) {
        copies[i] = m;
    }
    const unsigned start_ = ticks();
    for (int i = 0; i < COPIES; ++i) {
        sample(&copies[i], record[k]);
    }
    const unsigned count = since(start_)*40u/COPIES;
    sample(&m, record[k]);
    return count;
}

static void spoiled(int byte, unsigned mark) /* a sample of memory that has this mark and is filled with a byte */
{
    (void)memset(&copies[0].s, byte, sizeof copies[0].s);
    (void)memcpy(&copies[0].s, &mark, sizeof mark);
    copies[0].p = m.p;
    sample(&copies[0], record[0]);
}

int board_main(void)
{
    BEGIN(&m);
    unsigned mark;
    (void)memcpy(&mark, &m.s, sizeof mark);
    paint();
    (void)over(1, 50);
    spoiled(0xFF, mark); /* no number is left */
    spoiled(0x7E, mark); /* every number is lost by its size */
    spoiled(0, 0u);      /* nothing has made it */
    for (int k = QUIET; k < RECORD; ++k) {
        copies[0] = m;
        sample(&copies[0], record[k]);
    }
    say_number("stack ", painted_over());
    say_number("nominal ", over(51, 200)*40u/200u);
    unsigned most = 0u;
    for (int k = QUIET; k < RECORD; ++k) {
        const unsigned count = of_one(k);
        most = (count > most) ? count : most;
    }
    say_number("worst ", most);
    say_number("ram ", sizeof m);
    real values[N];
    estimate(&m, values);
    last = values[0];
    return 0;
}
