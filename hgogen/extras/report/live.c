/* an observer beside its plant, for a page: the page writes and reads the numbers in `cells` */
#include "$name.h"
unsigned ${name}_check(void);
#define EXPORTED(name) __attribute__((export_name(name)))

$truth

enum { STATES = $states, OUTPUTS = $outputs, INPUTS = $inputs, PARAMETERS = $parameters };
static struct {
    double x[STATES], y[OUTPUTS], u[INPUTS + 1], p[PARAMETERS + 1];
    double given[$given + 1], samples[$samples], estimate[$estimated], gains[$gains + 1];
} cells;
static ${name}_state s;
static ${name}_params p;
static ${name}_plant x;

EXPORTED("cells") void *page_cells(void)
{
    return &cells;
}

static void rate(double t, const double *at, double *dx)
{
    static double work[$work];
    const double *arg[$arguments] = {at, &t, cells.p};
    double *res[$results] = {dx, cells.y, cells.u};
    (void)truth(arg, res, 0, work, 0);
}

/* the outputs and inputs at t */
EXPORTED("look") void page_look(double t)
{
    double dx[STATES];
    rate(t, cells.x, dx);
}

/* the plant from t to t + h */
EXPORTED("move") void page_move(double t, double h, int parts)
{
    double k[4][STATES], at[STATES];
    if ($discrete) {
        rate(t, cells.x, k[0]);
        for (int i = 0; i < STATES; ++i) {
            cells.x[i] = k[0][i];
        }
        return;
    }
    h /= parts;
    for (int part = 0; part < parts; ++part, t += h) {
        rate(t, cells.x, k[0]);
        for (int stage = 1; stage < 4; ++stage) {
            const double a = stage < 3 ? h/2 : h;
            for (int i = 0; i < STATES; ++i) {
                at[i] = cells.x[i] + a*k[stage - 1][i];
            }
            rate(t + a, at, k[stage]);
        }
        for (int i = 0; i < STATES; ++i) {
            cells.x[i] += h/6*(k[0][i] + 2*k[1][i] + 2*k[2][i] + k[3][i]);
        }
    }
}

static void read(void)
{
    $estimate;
$read
}

EXPORTED("tune") unsigned page_tune(void)
{
$written
    const unsigned status = $tune;
    read();
    return status;
}

EXPORTED("begin") void page_begin(void)
{
    $init;
    read();
}

EXPORTED("step") unsigned page_step(void)
{
$locals
$filled
    const unsigned status = $step;
    read();
    return status;
}

EXPORTED("check") unsigned page_check(void)
{
    return ${name}_check();
}
