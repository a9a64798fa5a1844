/* instructions and stack of `sample`, over the calm rows of a record and the worst of those after them */
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

int board_main(void)
{
    BEGIN(&m);
    paint();
    (void)over(1, 50);
    say_number("stack ", painted_over());
    say_number("quiet ", over(51, 200)*40u/200u);
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
