/* disturbed_pendulum: see disturbed_pendulum.h, and its manual disturbed_pendulum.md. */
#include "disturbed_pendulum.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(DISTURBED_PENDULUM_USE_LIBM)
#include <math.h>
#elif defined(DISTURBED_PENDULUM_USE_CMSIS)
#include "arm_math.h"
#include <math.h>
#endif

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "needs IEEE 754 comparisons: -ffast-math drops the guards against what is not a number"
#endif
#if defined(__ASSOCIATIVE_MATH__)
#error "needs sums in their order: -funsafe-math-optimizations spoils the bundled functions"
#endif

/* for a function that runs rarely: it is not inlined */
#if defined(__GNUC__)
#define DISTURBED_PENDULUM_RARELY __attribute__((noinline))
#else
#define DISTURBED_PENDULUM_RARELY
#endif

static float disturbed_pendulum_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float disturbed_pendulum_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool disturbed_pendulum_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float disturbed_pendulum_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool disturbed_pendulum_within(float v, float limit)
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
static float disturbed_pendulum_limit(float v, float most)
{
    return disturbed_pendulum_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float disturbed_pendulum_keep(float v, float low, float high, float otherwise, float limit)
{
    return disturbed_pendulum_within(v, limit) ? disturbed_pendulum_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define DISTURBED_PENDULUM_USE_LIBM for those of <math.h>, or DISTURBED_PENDULUM_USE_CMSIS for CMSIS-DSP. */
#if defined(DISTURBED_PENDULUM_USE_LIBM)
static float disturbed_pendulum_small_sin(float x)
{
    return sinf(x);
}

#elif defined(DISTURBED_PENDULUM_USE_CMSIS)
static float disturbed_pendulum_small_sin(float x)
{
    return arm_sin_f32(x);
}

#else
static float disturbed_pendulum_small_sin(float x)
{
    const float t1 = disturbed_pendulum_within(x, 1.5707964f) ? x
        : ((x > 0.0f) ? 3.1415927f - x - 8.742278e-08f : -3.1415927f - x + 8.742278e-08f);
    const float t2 = t1*t1;
    return t1 + t1*(((2.606055e-06f*t2 - 0.00019809768f)*t2 + 0.008333069f)*t2 - 0.1666666f)*t2;
}
#endif

/* the right-hand side of the observer's differential equation */
static void disturbed_pendulum_rate(const disturbed_pendulum_params *p, float w1, float w2, float w3,
    float gamma, float y, float valid, float dw[3], float dgamma[1])
{
    const float t1 = disturbed_pendulum_clamp(gamma, 20.53f, 80.0f);
    const float t2 = y - w1;
    const float t3 = valid*t2;
    const float t4 = t1*t1;
    const float t5 = 0.5f*disturbed_pendulum_limit(w2, 50.0f)
        + 0.5f*disturbed_pendulum_small_sin(disturbed_pendulum_limit(w1, 4.0f));
    dw[0] = w2 + 8.9661f*t1*t3;
    dw[1] = w3 + 16.5213f*t4*t3 - t5;
    dw[2] = t4*t1*9.1275f*t3;
    dgamma[0] = t1*((p->gain.threshold < disturbed_pendulum_abs(t2)) ? p->gain.rise
        : -(p->gain.sigma*t1))*valid;
}

/* memory without its mark is not used: the state begins anew, which the status says */
DISTURBED_PENDULUM_RARELY
static unsigned disturbed_pendulum_ready(disturbed_pendulum_state *s, const disturbed_pendulum_params *p)
{
    unsigned status = 0u;
    if (s->ready != DISTURBED_PENDULUM_READY) {
        disturbed_pendulum_reset(s);
        status |= DISTURBED_PENDULUM_UNINITIALISED;
    }
    if (p->ready != DISTURBED_PENDULUM_READY) {
        disturbed_pendulum_reset(s);
        status |= DISTURBED_PENDULUM_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
DISTURBED_PENDULUM_RARELY
static void disturbed_pendulum_clear_fault_counts(disturbed_pendulum_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 3499.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 3499.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned disturbed_pendulum_keep_in_box(disturbed_pendulum_state *s,
    const disturbed_pendulum_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = disturbed_pendulum_within(s->w[0], 1e+30f)
            && disturbed_pendulum_within(s->w[1], 1e+30f) && disturbed_pendulum_within(s->w[2], 1e+30f);
        lost = !(t1 && disturbed_pendulum_within(s->gamma, 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->w[0] = 1.0f;
        s->w[1] = 1.0f;
        s->w[2] = 1.0f;
        status |= DISTURBED_PENDULUM_RESTARTED;
        disturbed_pendulum_clear_fault_counts(s);
        /* as after a reset */
        s->gamma = 20.53f;
    }
    /* keep w in its box */
    {
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float w3 = s->w[2];
        s->w[0] = disturbed_pendulum_limit(w1, 12.0f);
        s->w[1] = disturbed_pendulum_limit(w2, 4000.0f);
        s->w[2] = disturbed_pendulum_limit(w3, 32000.0f);
        if (disturbed_pendulum_abs(w1) > 12.0f || disturbed_pendulum_abs(w2) > 4000.0f
            || disturbed_pendulum_abs(w3) > 32000.0f) {
            status |= DISTURBED_PENDULUM_STATE_LIMITED;
        }
    }
    /* keep gamma in its box */
    {
        const float gamma = s->gamma;
        s->gamma = disturbed_pendulum_clamp(gamma, 20.53f, 80.0f);
    }
    return status;
}

/* nominal parameters */
DISTURBED_PENDULUM_RARELY
static void disturbed_pendulum_nominal(disturbed_pendulum_params *p)
{
    p->ready = DISTURBED_PENDULUM_READY;
    p->gain.rise = 50.0f;
    p->gain.threshold = 0.1f;
    p->gain.sigma = 0.05f;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned disturbed_pendulum_guard_measurements(const disturbed_pendulum_state *s,
    const disturbed_pendulum_output *measurement, float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float w1 = s->w[0];
        const bool t1 = disturbed_pendulum_within(reading, 12.0f)
            && disturbed_pendulum_within(reading - w1, 1e+16f);
        const float t2 = t1 ? reading : w1;
        const float y_before = s->y;
        const bool t3 = disturbed_pendulum_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && disturbed_pendulum_within(y_before, 12.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= DISTURBED_PENDULUM_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= DISTURBED_PENDULUM_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned disturbed_pendulum_advance(disturbed_pendulum_state *s, const disturbed_pendulum_params *p,
    float valid, float y, float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float gamma_at = 0.0f;
    float gamma_sum = 0.0f;
    float share = 0.0f;
    float w_at[3];
    float w_sum[3];
    /* w, gamma: one step of classical Runge-Kutta */
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
    w_sum[2] = 0.0f;
    gamma_sum = 0.0f;
    w_at[0] = s->w[0];
    w_at[1] = s->w[1];
    w_at[2] = s->w[2];
    gamma_at = s->gamma;
    {
        static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
        static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
        static const float each_ahead[4] = {0.0005f, 0.0005f, 0.001f, 0.0f};
        for (unsigned r = 0u; r < 4u; ++r) {
            fraction = each_fraction[r];
            share = each_share[r];
            ahead = each_ahead[r];
            /* a stage */
            {
                const float gamma_at_2 = gamma_at;
                const float gamma_sum_2 = gamma_sum;
                const float w_at1 = w_at[0];
                const float w_at2 = w_at[1];
                const float w_at3 = w_at[2];
                const float w_sum1 = w_sum[0];
                const float w_sum2 = w_sum[1];
                const float w_sum3 = w_sum[2];
                float k_w[3];
                float k_gamma[1];
                disturbed_pendulum_rate(p, w_at1, w_at2, w_at3, gamma_at_2, y_last + fraction*(y - y_last),
                    valid, k_w, k_gamma);
                w_sum[0] = w_sum1 + share*k_w[0];
                w_sum[1] = w_sum2 + share*k_w[1];
                w_sum[2] = w_sum3 + share*k_w[2];
                gamma_sum = gamma_sum_2 + share*k_gamma[0];
                w_at[0] = s->w[0] + ahead*k_w[0];
                w_at[1] = s->w[1] + ahead*k_w[1];
                w_at[2] = s->w[2] + ahead*k_w[2];
                gamma_at = s->gamma + ahead*k_gamma[0];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float gamma = s->gamma;
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float w3 = s->w[2];
        s->w[0] = w1 + 0.00016666666f*w_sum[0];
        s->w[1] = w2 + 0.00016666666f*w_sum[1];
        s->w[2] = w3 + 0.00016666666f*w_sum[2];
        s->gamma = gamma + 0.00016666666f*gamma_sum;
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = disturbed_pendulum_within(s->w[0], 12.0f)
            && disturbed_pendulum_within(s->w[1], 4000.0f) && disturbed_pendulum_within(s->w[2], 32000.0f);
        const float gamma = s->gamma;
        beyond = !(t1 && gamma >= 20.53f && gamma <= 80.0f);
    }
    if (disturbed_pendulum_acts(beyond)) {
        status |= disturbed_pendulum_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned disturbed_pendulum_suspect(const disturbed_pendulum_state *s,
    const disturbed_pendulum_output *measurement, bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float w1 = s->w[0];
        const bool t1 = disturbed_pendulum_abs(w1) > 4.0f || disturbed_pendulum_abs(s->w[1]) > 50.0f
            || disturbed_pendulum_abs(s->w[2]) > 5.0f;
        if (t1) {
            status |= DISTURBED_PENDULUM_OUTSIDE_BOX;
        }
        *suspect = disturbed_pendulum_abs(measurement->y - w1) > 0.8f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool disturbed_pendulum_counts_spoiled(const disturbed_pendulum_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 3499.0f + disturbed_pendulum_abs(fault_count_y)
            + (fault_limit_range - 3499.0f + fault_count_range);
        const bool t2 = disturbed_pendulum_abs(t1 - s->fault_checksum) < 0.5f
            && disturbed_pendulum_within(fault_count_y, 3582976.0f);
        const bool t3 = t2 && fault_limit_y >= 3499.0f && fault_limit_y <= 3582976.0f
            && fault_count_range >= 0.0f && fault_count_range <= 3582976.0f;
        spoiled = !(t3 && fault_limit_range >= 3499.0f && fault_limit_range <= 3582976.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void disturbed_pendulum_find_signs(const disturbed_pendulum_state *s,
    const disturbed_pendulum_output *measurement, float *moves_y, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->w[0];
        const bool t2 = disturbed_pendulum_within(t1, 0.8f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -1749.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned disturbed_pendulum_recover(disturbed_pendulum_state *s,
    const disturbed_pendulum_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= disturbed_pendulum_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = disturbed_pendulum_abs(s->w[0]) > 8.0f || disturbed_pendulum_abs(s->w[1]) > 100.0f
            || disturbed_pendulum_abs(s->w[2]) > 10.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 3499.0f || t3));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = disturbed_pendulum_min(fault_limit_y, 1791488.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = disturbed_pendulum_min(2.0f*fault_limit_y, 3582976.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = disturbed_pendulum_min(fault_limit_range, 1791488.0f);
            s->fault_limit_range = disturbed_pendulum_min(2.0f*fault_limit_range, 3582976.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->w[0] = 1.0f;
        s->w[1] = 1.0f;
        s->w[2] = 1.0f;
        /* from the sample of y */
        {
            const float w1 = s->w[0];
            const float w2 = s->w[1];
            const float w3 = s->w[2];
            s->w[0] = disturbed_pendulum_keep(measurement->y, -4.0f, 4.0f, w1, 1e+30f);
            s->w[1] = disturbed_pendulum_keep(w2, -50.0f, 50.0f, w2, 1e+30f);
            s->w[2] = disturbed_pendulum_keep(w3, -5.0f, 5.0f, w3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= DISTURBED_PENDULUM_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->gamma = 20.53f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float w1 = s->w[0];
            const float w2 = s->w[1];
            const float w3 = s->w[2];
            s->w[0] = disturbed_pendulum_limit(w1, 4.0f);
            s->w[1] = disturbed_pendulum_limit(w2, 50.0f);
            s->w[2] = disturbed_pendulum_limit(w3, 5.0f);
            status |= DISTURBED_PENDULUM_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned disturbed_pendulum_count_faults(disturbed_pendulum_state *s,
    const disturbed_pendulum_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = disturbed_pendulum_counts_spoiled(s);
    if (spoiled) {
        disturbed_pendulum_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = disturbed_pendulum_abs(s->w[0]) > 4.4f || disturbed_pendulum_abs(s->w[1]) > 55.0f
            || disturbed_pendulum_abs(s->w[2]) > 5.5f;
        moves_range = t1 ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = disturbed_pendulum_clamp(fault_count_range + moves_range, 0.0f, 3582976.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 3499.0f : fault_limit_range;
    }
    disturbed_pendulum_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = disturbed_pendulum_clamp(disturbed_pendulum_abs(fault_count_y) + moves_y, 0.0f,
            3582976.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 3499.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= disturbed_pendulum_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= disturbed_pendulum_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 3499.0f + disturbed_pendulum_abs(s->fault_count_y)
        + (s->fault_limit_range - 3499.0f + s->fault_count_range);
    return status;
}

unsigned disturbed_pendulum_step(disturbed_pendulum_state *s, const disturbed_pendulum_params *p,
    const disturbed_pendulum_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != DISTURBED_PENDULUM_READY) || (p->ready != DISTURBED_PENDULUM_READY)) {
        status = disturbed_pendulum_ready(s, p);
    }
    if ((status & DISTURBED_PENDULUM_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        status |= disturbed_pendulum_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= disturbed_pendulum_advance(s, p, valid, y, y_last);
        } else {
            status |= disturbed_pendulum_keep_in_box(s, p);
        }
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= disturbed_pendulum_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || disturbed_pendulum_within(measurement->y, 12.0f);
            if (sampled) {
                status |= disturbed_pendulum_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void disturbed_pendulum_estimate(const disturbed_pendulum_state *s, const disturbed_pendulum_params *p,
    disturbed_pendulum_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x1 = s->w[0];
    x->x2 = s->w[1];
    x->x3 = s->w[2];
}

unsigned disturbed_pendulum_tune(disturbed_pendulum_params *p)
{
    unsigned status = 0u;
    if (p->ready != DISTURBED_PENDULUM_READY) {
        disturbed_pendulum_nominal(p);
        status = DISTURBED_PENDULUM_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float rise = p->gain.rise;
        const float sigma = p->gain.sigma;
        const float threshold = p->gain.threshold;
        p->gain.rise = disturbed_pendulum_keep(rise, 0.05f, 50000.0f, 50.0f, 3e+38f);
        p->gain.threshold = disturbed_pendulum_keep(threshold, 0.0001f, 100.0f, 0.1f, 3e+38f);
        p->gain.sigma = disturbed_pendulum_keep(sigma, 0.0f, 0.05f, 0.05f, 3e+38f);
        if (!(rise >= 0.05f && rise <= 50000.0f) || !(threshold >= 0.0001f && threshold <= 100.0f)
            || !(sigma >= 0.0f && sigma <= 0.05f)) {
            status |= DISTURBED_PENDULUM_PARAMETER_LIMITED;
        }
    }
    return status;
}

DISTURBED_PENDULUM_RARELY
void disturbed_pendulum_reset(disturbed_pendulum_state *s)
{
    s->ready = DISTURBED_PENDULUM_READY;
    s->w[0] = 1.0f;
    s->w[1] = 1.0f;
    s->w[2] = 1.0f;
    s->gamma = 20.53f;
    s->calls = 0u;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    disturbed_pendulum_clear_fault_counts(s);
}

void disturbed_pendulum_init(disturbed_pendulum_state *s, disturbed_pendulum_params *p)
{
    disturbed_pendulum_nominal(p);
    (void)disturbed_pendulum_tune(p);
    disturbed_pendulum_reset(s);
}

static const unsigned char disturbed_pendulum_layout[8] = {
    0xCCu, 0xDDu, 0xFAu, 0x6Eu, 0xCDu, 0x41u, 0x97u, 0xADu
};

/* CRC-32 of IEEE 802.3 */
static uint32_t disturbed_pendulum_checksum(const unsigned char *bytes, size_t size)
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

void disturbed_pendulum_save(const disturbed_pendulum_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = disturbed_pendulum_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = disturbed_pendulum_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned disturbed_pendulum_restore(disturbed_pendulum_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == DISTURBED_PENDULUM_SAVED) {
        refused = 0u;
        uint32_t sum = disturbed_pendulum_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == disturbed_pendulum_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = DISTURBED_PENDULUM_READY;
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
