/* bioreactor: see bioreactor.h, and its manual bioreactor.md. */
#include "bioreactor.h"

#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "needs IEEE 754 comparisons: -ffast-math drops the guards against what is not a number"
#endif
#if defined(__ASSOCIATIVE_MATH__)
#error "needs sums in their order: -funsafe-math-optimizations spoils the bundled functions"
#endif

/* for a function that runs rarely: it is not inlined */
#if defined(__GNUC__)
#define BIOREACTOR_RARELY __attribute__((noinline))
#else
#define BIOREACTOR_RARELY
#endif

static float bioreactor_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float bioreactor_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float bioreactor_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool bioreactor_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float bioreactor_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool bioreactor_within(float v, float limit)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v) <= limit;
#else
    return v == v && v >= -limit && v <= limit;
#endif
}
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

/* v in [-most, most] */
static float bioreactor_limit(float v, float most)
{
    return bioreactor_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float bioreactor_keep(float v, float low, float high, float otherwise, float limit)
{
    return bioreactor_within(v, limit) ? bioreactor_clamp(v, low, high) : otherwise;
}

static float bioreactor_sign(float v)
{
    return ((v > 0.0f) ? 1.0f : 0.0f) - ((v < 0.0f) ? 1.0f : 0.0f);
}

/* the right-hand side of the observer's differential equation */
static void bioreactor_rate(const bioreactor_params *p, float w1, float w2, float k, float y, float valid,
    float dw[2], float dk[1])
{
    const float t1 = valid*(y - w1);
    const float strip = p->gain.strip;
    const float t2 = bioreactor_clamp(bioreactor_abs(t1) - strip, 0.0f,
        bioreactor_max(p->gain.reach - strip, 0.0f));
    dw[0] = w2 + k*t1;
    dw[1] = k*k*0.2f*t1;
    dk[0] = t2*t2*p->gain.gamma;
}

/* memory without its mark is not used: the state begins anew, which the status says */
BIOREACTOR_RARELY
static unsigned bioreactor_ready(bioreactor_state *s, const bioreactor_params *p)
{
    unsigned status = 0u;
    if (s->ready != BIOREACTOR_READY) {
        bioreactor_reset(s);
        status |= BIOREACTOR_UNINITIALISED;
    }
    if (p->ready != BIOREACTOR_READY) {
        bioreactor_reset(s);
        status |= BIOREACTOR_NO_PARAMETERS;
    }
    return status;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned bioreactor_keep_in_box(bioreactor_state *s, const bioreactor_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = bioreactor_within(s->w[0], 1e+30f) && bioreactor_within(s->w[1], 1e+30f)
            && bioreactor_within(s->k, 1e+30f);
        const bool t2 = t1 && bioreactor_within(s->quiet, 1e+30f) && bioreactor_within(s->settled, 1e+30f)
            && bioreactor_within(s->turns, 1e+30f);
        lost = !(t2 && bioreactor_within(s->falls, 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->w[0] = 0.0f;
        s->w[1] = 0.0f;
        s->k = 0.1f;
        s->settled = 0.0f;
        s->turns = 0.0f;
        s->falls = 0.0f;
        status |= BIOREACTOR_RESTARTED;
        /* as after a reset */
        s->fault_count_y = 0.0f;
        s->fault_limit_y = 6360.0f;
        s->fault_checksum = 0.0f;
        /* as after a reset */
        s->quiet = 0.0f;
    }
    /* keep w in its box */
    {
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        s->w[0] = bioreactor_clamp(w1, -0.13f, 0.29f);
        s->w[1] = bioreactor_clamp(w2, -0.19518037f, 0.25633296f);
        if (w1 < -0.13f || w1 > 0.29f || w2 < -0.19518037f || w2 > 0.25633296f) {
            status |= BIOREACTOR_STATE_LIMITED;
        }
    }
    /* keep k in its box */
    {
        const float k_2 = s->k;
        s->k = bioreactor_clamp(k_2, 0.1f, 5.0f);
    }
    /* keep quiet in its box */
    {
        const float quiet = s->quiet;
        s->quiet = bioreactor_clamp(quiet, 0.0f, 44.969326f);
    }
    /* keep settled in its box */
    {
        const float settled = s->settled;
        s->settled = bioreactor_clamp(settled, 0.0f, 1.0f);
    }
    /* keep turns in its box */
    {
        const float turns = s->turns;
        s->turns = bioreactor_limit(turns, 16.0f);
    }
    /* keep falls in its box */
    {
        const float falls = s->falls;
        s->falls = bioreactor_clamp(falls, 0.0f, 6.0f);
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned bioreactor_guard_input(const bioreactor_state *s, const bioreactor_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = bioreactor_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = bioreactor_clamp(u_taken, 0.0f, 0.1f);
        if (!u_usable) {
            status |= BIOREACTOR_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 0.1f) {
            status |= BIOREACTOR_CLAMPED_U;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned bioreactor_guard_measurements(const bioreactor_state *s,
    const bioreactor_output *measurement, float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float w1 = s->w[0];
        const bool t1 = reading >= -0.35f && reading <= 0.55f && bioreactor_within(reading - w1, 1e+16f);
        const float t2 = t1 ? reading : w1;
        const float y_before = s->y;
        const bool t3 = bioreactor_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && y_before >= -0.35f && y_before <= 0.55f) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= BIOREACTOR_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= BIOREACTOR_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned bioreactor_advance(bioreactor_state *s, const bioreactor_params *p, float valid, float y,
    float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float k_at = 0.0f;
    float k_sum = 0.0f;
    float share = 0.0f;
    float w_at[2];
    float w_sum[2];
    /* w, k: one step of classical Runge-Kutta */
    /* its tableau: */
    /*     0 |  */
    /*   1/2 | 1/2 */
    /*   1/2 |   0 1/2 */
    /*     1 |   0   0   1 */
    /*   --------------------- */
    /*       | 1/6 1/3 1/3 1/6 */
    /* fraction is c of a stage; share is its b over that of the first; ahead is the next stage's a times
     * dt */
    w_sum[0] = 0.0f;
    w_sum[1] = 0.0f;
    k_sum = 0.0f;
    w_at[0] = s->w[0];
    w_at[1] = s->w[1];
    k_at = s->k;
    {
        static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
        static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
        static const float each_ahead[4] = {0.005f, 0.005f, 0.01f, 0.0f};
        for (unsigned r = 0u; r < 4u; ++r) {
            fraction = each_fraction[r];
            share = each_share[r];
            ahead = each_ahead[r];
            /* a stage */
            {
                const float k_at_2 = k_at;
                const float k_sum_2 = k_sum;
                const float w_at1 = w_at[0];
                const float w_at2 = w_at[1];
                const float w_sum1 = w_sum[0];
                const float w_sum2 = w_sum[1];
                float k_w[2];
                float k_k[1];
                bioreactor_rate(p, w_at1, w_at2, k_at_2, y_last + fraction*(y - y_last), valid, k_w, k_k);
                w_sum[0] = w_sum1 + share*k_w[0];
                w_sum[1] = w_sum2 + share*k_w[1];
                k_sum = k_sum_2 + share*k_k[0];
                w_at[0] = s->w[0] + ahead*k_w[0];
                w_at[1] = s->w[1] + ahead*k_w[1];
                k_at = s->k + ahead*k_k[0];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float k_2 = s->k;
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        s->w[0] = w1 + 0.0016666667f*w_sum[0];
        s->w[1] = w2 + 0.0016666667f*w_sum[1];
        s->k = k_2 + 0.0016666667f*k_sum;
    }
    /* is a value beyond its box, or lost? */
    {
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float k_2 = s->k;
        const bool t1 = w1 >= -0.13f && w1 <= 0.29f && w2 >= -0.19518037f && w2 <= 0.25633296f && k_2 >= 0.1f
            && k_2 <= 5.0f;
        beyond = !t1;
    }
    if (bioreactor_acts(beyond)) {
        status |= bioreactor_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned bioreactor_suspect(const bioreactor_state *s, const bioreactor_output *measurement,
    bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float t1 = bioreactor_clamp(w1, 0.01f, 0.15f);
        const float u_before = s->u;
        const float t2 = bioreactor_clamp(w2, -0.014575033f, 0.075727634f);
        const float t3 = bioreactor_max(0.0001666f, t1 - u_before*t1 - t2);
        const float t4 = t1*t1*u_before/t3 + t1*t2/t3;
        if (w1 < 0.01f || w1 > 0.15f || w2 < -0.014575033f || w2 > 0.075727634f || t4 < 0.001f
            || t4 > 0.15f) {
            status |= BIOREACTOR_OUTSIDE_BOX;
        }
        *suspect = bioreactor_abs(measurement->y - w1) > 0.03f || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool bioreactor_sample_in_plausible_range(const bioreactor_output *measurement, float valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    {
        const float reading = measurement->y;
        sampled = valid > 0.0f || (reading >= -0.35f && reading <= 0.55f);
    }
    return sampled;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned bioreactor_count_faults(bioreactor_state *s, const bioreactor_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    bool lost = false;
    float moves_y = 0.0f;
    bool over_y = false;
    float side_y = 0.0f;
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const bool t1 = bioreactor_abs(fault_limit_y - 6360.0f + bioreactor_abs(fault_count_y)
            - s->fault_checksum) < 0.5f;
        const bool t2 = t1 && bioreactor_within(fault_count_y, 6512640.0f) && fault_limit_y >= 6360.0f
            && fault_limit_y <= 6512640.0f;
        spoiled = !t2;
    }
    if (spoiled) {
        /* as after a reset */
        s->fault_count_y = 0.0f;
        s->fault_limit_y = 6360.0f;
        s->fault_checksum = 0.0f;
    }
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->w[0];
        const bool t2 = bioreactor_within(t1, 0.03f);
        const float fault_count_y = s->fault_count_y;
        moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -3180.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = bioreactor_clamp(bioreactor_abs(fault_count_y) + moves_y, 0.0f, 6512640.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 6360.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= bioreactor_abs(s->fault_count_y);
    if (acts) {
        /* which fault counts are at their limits, and must the estimate restart? */
        {
            const bool t1 = s->fault_limit_y <= bioreactor_abs(s->fault_count_y);
            over_y = t1;
            lost = t1;
        }
        if (over_y) {
            /* the fault limit doubles */
            {
                const float fault_count_y = s->fault_count_y;
                const float fault_limit_y = s->fault_limit_y;
                const float t1 = bioreactor_min(fault_limit_y, 3256320.0f);
                s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
                s->fault_limit_y = bioreactor_min(2.0f*fault_limit_y, 6512640.0f);
            }
        }
        if (lost) {
            /* the estimate restarts */
            s->w[0] = 0.0f;
            s->w[1] = 0.0f;
            /* from the sample of y */
            {
                const float w1 = s->w[0];
                const float w2 = s->w[1];
                s->w[0] = bioreactor_keep(measurement->y, 0.01f, 0.15f, w1, 1e+30f);
                s->w[1] = bioreactor_keep(w2, -0.014575033f, 0.075727634f, w2, 1e+30f);
            }
            /* the estimate has restarted from the sample */
            status |= BIOREACTOR_RESTARTED_FROM_SAMPLE;
            /* as after a reset */
            s->quiet = 0.0f;
        }
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 6360.0f + bioreactor_abs(s->fault_count_y);
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned bioreactor_predict(bioreactor_state *s, const bioreactor_params *p,
    const bioreactor_input *in, const bioreactor_output *measurement)
{
    unsigned status = 0u;
    bool running = false;
    bool sampled = false;
    bool suspect = false;
    float u = 0.0f;
    float valid = 0.0f;
    float y = 0.0f;
    float y_last = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = bioreactor_clamp(u_before, 0.0f, 0.1f);
    }
    status |= bioreactor_guard_input(s, in, &u);
    status |= bioreactor_guard_measurements(s, measurement, &valid, &y, &y_last);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = (calls < 2u) ? calls + 1u : 2u;
    }
    if (running) {
        status |= bioreactor_advance(s, p, valid, y, y_last);
    } else {
        status |= bioreactor_keep_in_box(s, p);
    }
    /* remember the input */
    s->u = u;
    /* remember the sample */
    s->y = y;
    s->y_valid = valid;
    status |= bioreactor_suspect(s, measurement, &suspect, valid);
    if (suspect) {
        sampled = bioreactor_sample_in_plausible_range(measurement, valid);
        if (sampled) {
            status |= bioreactor_count_faults(s, measurement);
        }
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool bioreactor_beyond_box(const bioreactor_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const float k_2 = s->k;
        const float quiet = s->quiet;
        const float settled = s->settled;
        const bool t1 = k_2 >= 0.1f && k_2 <= 5.0f && quiet >= 0.0f && quiet <= 44.969326f && settled >= 0.0f
            && settled <= 1.0f;
        const float falls = s->falls;
        beyond = !(t1 && bioreactor_within(s->turns, 16.0f) && falls >= 0.0f && falls <= 6.0f);
    }
    return beyond;
}

/* adapt the gain */
static unsigned bioreactor_adapt_gain(bioreactor_state *s, const bioreactor_params *p)
{
    unsigned status = 0u;
    bool beyond = false;
    bool falling = false;
    /* has the output error stayed inside the strip? */
    {
        const float falls = s->falls;
        const float quiet = s->quiet;
        const float settled = s->settled;
        const float turns = s->turns;
        const bool t1 = s->y_valid > 0.0f;
        const float t2 = s->y - s->w[0];
        const float strip = p->gain.strip;
        const bool t3 = bioreactor_min(p->gain.reach, bioreactor_max(2.0f*strip, 0.03f)) < bioreactor_abs(t2);
        const float t4 = bioreactor_abs(turns);
        s->quiet = t1 ? (bioreactor_within(t2, strip) ? bioreactor_min(quiet + 0.01f*s->k, 44.969326f)
            : 0.0f) : quiet;
        s->turns = (t1 && t3) ? ((t2*turns > 0.0f) ? turns : bioreactor_sign(t2)*bioreactor_min(t4 + 1.0f,
            16.0f)) : turns;
        s->falls = t1 ? ((t3 && (settled > 0.0f || t4 >= 16.0f)) ? 6.0f : falls) : falls;
        s->settled = bioreactor_max(settled, quiet >= 3.618034f ? 1.0f : 0.0f);
    }
    /* may the gain fall? */
    falling = s->quiet >= 44.969326f && s->falls >= 1.0f && s->k > 0.1f;
    if (falling) {
        /* it falls by half */
        {
            const float falls = s->falls;
            const float k_2 = s->k;
            s->quiet = 0.0f;
            s->falls = bioreactor_max(falls - 1.0f, 0.0f);
            s->k = bioreactor_max(k_2/2.0f, 0.1f);
        }
    }
    /* has the gain reached its cap? */
    if (s->k >= 5.0f) {
        status |= BIOREACTOR_GAIN_LIMITED;
    }
    beyond = bioreactor_beyond_box(s);
    if (bioreactor_acts(beyond)) {
        status |= bioreactor_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: adapt the gain; once after the updates */
static unsigned bioreactor_adapt(bioreactor_state *s, const bioreactor_params *p)
{
    unsigned status = 0u;
    bool running = false;
    /* no time has passed before the second call */
    running = s->calls >= 2u;
    if (running) {
        status |= bioreactor_adapt_gain(s, p);
    }
    return status;
}

/* nominal parameters */
BIOREACTOR_RARELY
static void bioreactor_nominal(bioreactor_params *p)
{
    p->ready = BIOREACTOR_READY;
    p->gain.gamma = 100.0f;
    p->gain.strip = 0.02f;
    p->gain.reach = 0.5f;
}

unsigned bioreactor_step(bioreactor_state *s, const bioreactor_params *p, const bioreactor_input *in,
    const bioreactor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != BIOREACTOR_READY) || (p->ready != BIOREACTOR_READY)) {
        status = bioreactor_ready(s, p);
    }
    if ((status & BIOREACTOR_NO_PARAMETERS) == 0u) {
        status |= bioreactor_predict(s, p, in, measurement);
        status |= bioreactor_adapt(s, p);
    }
    return status;
}

void bioreactor_estimate(const bioreactor_state *s, const bioreactor_params *p, bioreactor_plant *x)
{
    (void)p;
    /* the plant's state */
    {
        const float w1 = s->w[0];
        const float t1 = bioreactor_clamp(w1, 0.01f, 0.15f);
        const float u_before = s->u;
        const float t2 = bioreactor_clamp(s->w[1], -0.014575033f, 0.075727634f);
        const float t3 = bioreactor_max(0.0001666f, t1 - u_before*t1 - t2);
        x->m = bioreactor_clamp(w1, 0.01f, 0.15f);
        x->s = bioreactor_clamp(t1*t1*u_before/t3 + t1*t2/t3, 0.001f, 0.15f);
    }
}

unsigned bioreactor_tune(bioreactor_params *p)
{
    unsigned status = 0u;
    if (p->ready != BIOREACTOR_READY) {
        bioreactor_nominal(p);
        status = BIOREACTOR_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float gamma = p->gain.gamma;
        const float reach = p->gain.reach;
        const float strip = p->gain.strip;
        p->gain.gamma = bioreactor_keep(gamma, 0.1f, 100000.0f, 100.0f, 3e+38f);
        p->gain.strip = bioreactor_keep(strip, 2e-05f, 0.26f, 0.02f, 3e+38f);
        p->gain.reach = bioreactor_keep(reach, 0.5f, 500.0f, 0.5f, 3e+38f);
        if (!(gamma >= 0.1f && gamma <= 100000.0f) || !(strip >= 2e-05f && strip <= 0.26f)
            || !(reach >= 0.5f && reach <= 500.0f)) {
            status |= BIOREACTOR_PARAMETER_LIMITED;
        }
    }
    return status;
}

BIOREACTOR_RARELY
void bioreactor_reset(bioreactor_state *s)
{
    s->ready = BIOREACTOR_READY;
    s->w[0] = 0.0f;
    s->w[1] = 0.0f;
    s->k = 0.1f;
    s->quiet = 0.0f;
    s->settled = 0.0f;
    s->turns = 0.0f;
    s->falls = 0.0f;
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 6360.0f;
    s->fault_checksum = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
}

void bioreactor_init(bioreactor_state *s, bioreactor_params *p)
{
    bioreactor_nominal(p);
    (void)bioreactor_tune(p);
    bioreactor_reset(s);
}

static const unsigned char bioreactor_layout[8] = {0x0Fu, 0x2Au, 0xF7u, 0x7Eu, 0x97u, 0x41u, 0x40u, 0x04u};

/* CRC-32 of IEEE 802.3 */
static uint32_t bioreactor_checksum(const unsigned char *bytes, size_t size)
{
    uint32_t sum = 0xFFFFFFFFu;
    for (size_t k = 0u; k < size; ++k) {
        sum ^= (uint32_t)bytes[k];
        for (unsigned bit = 0u; bit < 8u; ++bit) {
            const uint32_t odd = sum & 1u;
            sum >>= 1u;
            sum ^= (odd != 0u) ? 0xEDB88320u : 0u;
        }
    }
    return sum ^ 0xFFFFFFFFu;
}

void bioreactor_save(const bioreactor_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = bioreactor_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = bioreactor_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned bioreactor_restore(bioreactor_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == BIOREACTOR_SAVED) {
        refused = 0u;
        uint32_t sum = bioreactor_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == bioreactor_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = BIOREACTOR_READY;
        const unsigned char *const mark = (const unsigned char *)&ready;
        for (size_t k = 0u; k < sizeof(ready); ++k) {
            refused |= (saved[k + 8u] == mark[k]) ? 0u : 1u;
        }
    }
    if (refused == 0u) {
        unsigned char *const bytes = (unsigned char *)s;
        for (size_t k = 0u; k < sizeof(*s); ++k) {
            bytes[k] = saved[k + 8u];
        }
    }
    return refused;
}
