/* hyperjerk: see hyperjerk.h, and its manual hyperjerk.md. */
#include "hyperjerk.h"

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
#define HYPERJERK_RARELY __attribute__((noinline))
#else
#define HYPERJERK_RARELY
#endif

static float hyperjerk_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float hyperjerk_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool hyperjerk_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float hyperjerk_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool hyperjerk_within(float v, float limit)
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
static float hyperjerk_limit(float v, float most)
{
    return hyperjerk_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float hyperjerk_keep(float v, float low, float high, float otherwise, float limit)
{
    return hyperjerk_within(v, limit) ? hyperjerk_clamp(v, low, high) : otherwise;
}

/* the right-hand side of the observer's differential equation */
static void hyperjerk_rate(const hyperjerk_params *p, const float w[4], const float eta[4], float y,
    float valid, float dw[4], float deta[4])
{
    const float w1 = w[0];
    const float w2 = w[1];
    const float w3 = w[2];
    const float w4 = w[3];
    const float eta1 = eta[0];
    const float eta2 = eta[1];
    const float eta3 = eta[2];
    const float eta4 = eta[3];
    const float t1 = hyperjerk_limit(w1, 3.0f);
    const float t2 = t1*t1*4.5f - 2.7f*hyperjerk_limit(w2, 4.0f) - 5.2f*hyperjerk_limit(w3, 6.0f)
        - hyperjerk_limit(w4, 12.0f);
    const float theta = p->gain.theta;
    dw[0] = w2 + 6.0f*eta1;
    dw[1] = w3 + 15.0f*eta2;
    dw[2] = w4 + 18.0f*eta3;
    dw[3] = t2 - 4.5f + 10.0f*eta4;
    deta[0] = theta*(valid*(y - w1)*theta - 3.0f*eta1);
    deta[1] = theta*(theta*eta1 - 3.0f*eta2);
    deta[2] = theta*(theta*eta2 - 3.0f*eta3);
    deta[3] = theta*(theta*eta3 - 3.0f*eta4);
}

/* memory without its mark is not used: the state begins anew, which the status says */
HYPERJERK_RARELY
static unsigned hyperjerk_ready(hyperjerk_state *s, const hyperjerk_params *p)
{
    unsigned status = 0u;
    if (s->ready != HYPERJERK_READY) {
        hyperjerk_reset(s);
        status |= HYPERJERK_UNINITIALISED;
    }
    if (p->ready != HYPERJERK_READY) {
        hyperjerk_reset(s);
        status |= HYPERJERK_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
HYPERJERK_RARELY
static void hyperjerk_clear_fault_counts(hyperjerk_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 7523.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 7523.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
HYPERJERK_RARELY
static void hyperjerk_clear_rest(hyperjerk_state *s)
{
    /* as after a reset */
    s->eta[0] = 0.0f;
    s->eta[1] = 0.0f;
    s->eta[2] = 0.0f;
    s->eta[3] = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned hyperjerk_keep_in_box(hyperjerk_state *s, const hyperjerk_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = hyperjerk_within(s->w[0], 1e+30f) && hyperjerk_within(s->w[1], 1e+30f)
            && hyperjerk_within(s->w[2], 1e+30f);
        const bool t2 = t1 && hyperjerk_within(s->w[3], 1e+30f) && hyperjerk_within(s->eta[0], 1e+30f)
            && hyperjerk_within(s->eta[1], 1e+30f);
        lost = !(t2 && hyperjerk_within(s->eta[2], 1e+30f) && hyperjerk_within(s->eta[3], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->w[0] = 0.0f;
        s->w[1] = 0.0f;
        s->w[2] = 0.0f;
        s->w[3] = 0.0f;
        status |= HYPERJERK_RESTARTED;
        hyperjerk_clear_fault_counts(s);
        hyperjerk_clear_rest(s);
    }
    /* keep w in its box */
    {
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float w3 = s->w[2];
        const float w4 = s->w[3];
        s->w[0] = hyperjerk_limit(w1, 9.0f);
        s->w[1] = hyperjerk_limit(w2, 40.0f);
        s->w[2] = hyperjerk_limit(w3, 600.0f);
        s->w[3] = hyperjerk_limit(w4, 12000.0f);
        if (hyperjerk_abs(w1) > 9.0f || hyperjerk_abs(w2) > 40.0f || hyperjerk_abs(w3) > 600.0f
            || hyperjerk_abs(w4) > 12000.0f) {
            status |= HYPERJERK_STATE_LIMITED;
        }
    }
    /* keep eta in its box */
    {
        const float eta1 = s->eta[0];
        const float eta2 = s->eta[1];
        const float eta3 = s->eta[2];
        const float eta4 = s->eta[3];
        s->eta[0] = hyperjerk_limit(eta1, 1e+30f);
        s->eta[1] = hyperjerk_limit(eta2, 1e+30f);
        s->eta[2] = hyperjerk_limit(eta3, 1e+30f);
        s->eta[3] = hyperjerk_limit(eta4, 1e+30f);
    }
    return status;
}

/* nominal parameters */
HYPERJERK_RARELY
static void hyperjerk_nominal(hyperjerk_params *p)
{
    p->ready = HYPERJERK_READY;
    p->gain.theta = 10.0f;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned hyperjerk_guard_measurements(const hyperjerk_state *s, const hyperjerk_output *measurement,
    float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float w1 = s->w[0];
        const bool t1 = hyperjerk_within(reading, 9.0f) && hyperjerk_within(reading - w1, 1e+16f);
        const float t2 = t1 ? reading : w1;
        const float y_before = s->y;
        const bool t3 = hyperjerk_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && hyperjerk_within(y_before, 9.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= HYPERJERK_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= HYPERJERK_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned hyperjerk_advance(hyperjerk_state *s, const hyperjerk_params *p, float valid, float y,
    float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float eta_at[4];
    float eta_sum[4];
    float fraction = 0.0f;
    float share = 0.0f;
    float w_at[4];
    float w_sum[4];
    /* w, eta: one step of classical Runge-Kutta */
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
    w_sum[3] = 0.0f;
    eta_sum[0] = 0.0f;
    eta_sum[1] = 0.0f;
    eta_sum[2] = 0.0f;
    eta_sum[3] = 0.0f;
    w_at[0] = s->w[0];
    w_at[1] = s->w[1];
    w_at[2] = s->w[2];
    w_at[3] = s->w[3];
    eta_at[0] = s->eta[0];
    eta_at[1] = s->eta[1];
    eta_at[2] = s->eta[2];
    eta_at[3] = s->eta[3];
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
                const float eta_sum1 = eta_sum[0];
                const float eta_sum2 = eta_sum[1];
                const float eta_sum3 = eta_sum[2];
                const float eta_sum4 = eta_sum[3];
                const float w_sum1 = w_sum[0];
                const float w_sum2 = w_sum[1];
                const float w_sum3 = w_sum[2];
                const float w_sum4 = w_sum[3];
                float k_w[4];
                float k_eta[4];
                hyperjerk_rate(p, w_at, eta_at, y_last + fraction*(y - y_last), valid, k_w, k_eta);
                w_sum[0] = w_sum1 + share*k_w[0];
                w_sum[1] = w_sum2 + share*k_w[1];
                w_sum[2] = w_sum3 + share*k_w[2];
                w_sum[3] = w_sum4 + share*k_w[3];
                eta_sum[0] = eta_sum1 + share*k_eta[0];
                eta_sum[1] = eta_sum2 + share*k_eta[1];
                eta_sum[2] = eta_sum3 + share*k_eta[2];
                eta_sum[3] = eta_sum4 + share*k_eta[3];
                w_at[0] = s->w[0] + ahead*k_w[0];
                w_at[1] = s->w[1] + ahead*k_w[1];
                w_at[2] = s->w[2] + ahead*k_w[2];
                w_at[3] = s->w[3] + ahead*k_w[3];
                eta_at[0] = s->eta[0] + ahead*k_eta[0];
                eta_at[1] = s->eta[1] + ahead*k_eta[1];
                eta_at[2] = s->eta[2] + ahead*k_eta[2];
                eta_at[3] = s->eta[3] + ahead*k_eta[3];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float eta1 = s->eta[0];
        const float eta2 = s->eta[1];
        const float eta3 = s->eta[2];
        const float eta4 = s->eta[3];
        const float w1 = s->w[0];
        const float w2 = s->w[1];
        const float w3 = s->w[2];
        const float w4 = s->w[3];
        s->w[0] = w1 + 0.00016666666f*w_sum[0];
        s->w[1] = w2 + 0.00016666666f*w_sum[1];
        s->w[2] = w3 + 0.00016666666f*w_sum[2];
        s->w[3] = w4 + 0.00016666666f*w_sum[3];
        s->eta[0] = eta1 + 0.00016666666f*eta_sum[0];
        s->eta[1] = eta2 + 0.00016666666f*eta_sum[1];
        s->eta[2] = eta3 + 0.00016666666f*eta_sum[2];
        s->eta[3] = eta4 + 0.00016666666f*eta_sum[3];
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = hyperjerk_within(s->w[0], 9.0f) && hyperjerk_within(s->w[1], 40.0f)
            && hyperjerk_within(s->w[2], 600.0f);
        const bool t2 = t1 && hyperjerk_within(s->w[3], 12000.0f) && hyperjerk_within(s->eta[0], 1e+30f)
            && hyperjerk_within(s->eta[1], 1e+30f);
        beyond = !(t2 && hyperjerk_within(s->eta[2], 1e+30f) && hyperjerk_within(s->eta[3], 1e+30f));
    }
    if (hyperjerk_acts(beyond)) {
        status |= hyperjerk_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned hyperjerk_suspect(const hyperjerk_state *s, const hyperjerk_output *measurement,
    bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float w1 = s->w[0];
        const bool t1 = hyperjerk_abs(w1) > 3.0f || hyperjerk_abs(s->w[1]) > 4.0f
            || hyperjerk_abs(s->w[2]) > 6.0f || hyperjerk_abs(s->w[3]) > 12.0f;
        if (t1) {
            status |= HYPERJERK_OUTSIDE_BOX;
        }
        *suspect = hyperjerk_abs(measurement->y - w1) > 0.6f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool hyperjerk_counts_spoiled(const hyperjerk_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 7523.0f + hyperjerk_abs(fault_count_y)
            + (fault_limit_range - 7523.0f + fault_count_range);
        const bool t2 = hyperjerk_abs(t1 - s->fault_checksum) < 0.5f
            && hyperjerk_within(fault_count_y, 4194304.0f) && fault_limit_y >= 7523.0f
                && fault_limit_y <= 4194304.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 4194304.0f
            && fault_limit_range >= 7523.0f && fault_limit_range <= 4194304.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void hyperjerk_find_signs(const hyperjerk_state *s, const hyperjerk_output *measurement,
    float *moves_y, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->w[0];
        const bool t2 = hyperjerk_within(t1, 0.6f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -448.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned hyperjerk_recover(hyperjerk_state *s, const hyperjerk_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= hyperjerk_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = hyperjerk_abs(s->w[0]) > 6.0f || hyperjerk_abs(s->w[1]) > 8.0f
            || hyperjerk_abs(s->w[2]) > 12.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 7523.0f || t3 || hyperjerk_abs(s->w[3]) > 24.0f));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = hyperjerk_min(fault_limit_y, 2097152.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = hyperjerk_min(2.0f*fault_limit_y, 4194304.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = hyperjerk_min(fault_limit_range, 2097152.0f);
            s->fault_limit_range = hyperjerk_min(2.0f*fault_limit_range, 4194304.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->w[0] = 0.0f;
        s->w[1] = 0.0f;
        s->w[2] = 0.0f;
        s->w[3] = 0.0f;
        /* from the sample of y */
        {
            const float w1 = s->w[0];
            const float w2 = s->w[1];
            const float w3 = s->w[2];
            const float w4 = s->w[3];
            s->w[0] = hyperjerk_keep(measurement->y, -3.0f, 3.0f, w1, 1e+30f);
            s->w[1] = hyperjerk_keep(w2, -4.0f, 4.0f, w2, 1e+30f);
            s->w[2] = hyperjerk_keep(w3, -6.0f, 6.0f, w3, 1e+30f);
            s->w[3] = hyperjerk_keep(w4, -12.0f, 12.0f, w4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= HYPERJERK_RESTARTED_FROM_SAMPLE;
        hyperjerk_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float w1 = s->w[0];
            const float w2 = s->w[1];
            const float w3 = s->w[2];
            const float w4 = s->w[3];
            s->w[0] = hyperjerk_limit(w1, 3.0f);
            s->w[1] = hyperjerk_limit(w2, 4.0f);
            s->w[2] = hyperjerk_limit(w3, 6.0f);
            s->w[3] = hyperjerk_limit(w4, 12.0f);
            status |= HYPERJERK_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned hyperjerk_count_faults(hyperjerk_state *s, const hyperjerk_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = hyperjerk_counts_spoiled(s);
    if (spoiled) {
        hyperjerk_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = hyperjerk_abs(s->w[0]) > 3.3f || hyperjerk_abs(s->w[1]) > 4.4f
            || hyperjerk_abs(s->w[2]) > 6.6f;
        moves_range = (t1 || hyperjerk_abs(s->w[3]) > 13.2f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = hyperjerk_clamp(fault_count_range + moves_range, 0.0f, 4194304.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 7523.0f : fault_limit_range;
    }
    hyperjerk_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = hyperjerk_clamp(hyperjerk_abs(fault_count_y) + moves_y, 0.0f, 4194304.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 7523.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= hyperjerk_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= hyperjerk_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 7523.0f + hyperjerk_abs(s->fault_count_y)
        + (s->fault_limit_range - 7523.0f + s->fault_count_range);
    return status;
}

unsigned hyperjerk_step(hyperjerk_state *s, const hyperjerk_params *p, const hyperjerk_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != HYPERJERK_READY) || (p->ready != HYPERJERK_READY)) {
        status = hyperjerk_ready(s, p);
    }
    if ((status & HYPERJERK_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        status |= hyperjerk_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= hyperjerk_advance(s, p, valid, y, y_last);
        } else {
            status |= hyperjerk_keep_in_box(s, p);
        }
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= hyperjerk_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || hyperjerk_within(measurement->y, 9.0f);
            if (sampled) {
                status |= hyperjerk_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void hyperjerk_estimate(const hyperjerk_state *s, const hyperjerk_params *p, hyperjerk_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x1 = s->w[0];
    x->x2 = s->w[1];
    x->x3 = s->w[2];
    x->x4 = s->w[3];
}

unsigned hyperjerk_tune(hyperjerk_params *p)
{
    unsigned status = 0u;
    if (p->ready != HYPERJERK_READY) {
        hyperjerk_nominal(p);
        status = HYPERJERK_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = hyperjerk_keep(theta, 1.0f, 10.0f, 10.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 10.0f)) {
            status |= HYPERJERK_PARAMETER_LIMITED;
        }
    }
    return status;
}

HYPERJERK_RARELY
void hyperjerk_reset(hyperjerk_state *s)
{
    s->ready = HYPERJERK_READY;
    s->w[0] = 0.0f;
    s->w[1] = 0.0f;
    s->w[2] = 0.0f;
    s->w[3] = 0.0f;
    s->calls = 0u;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    hyperjerk_clear_fault_counts(s);
    hyperjerk_clear_rest(s);
}

void hyperjerk_init(hyperjerk_state *s, hyperjerk_params *p)
{
    hyperjerk_nominal(p);
    (void)hyperjerk_tune(p);
    hyperjerk_reset(s);
}

static const unsigned char hyperjerk_layout[8] = {0xDAu, 0x50u, 0xC5u, 0x7Cu, 0x20u, 0x13u, 0x56u, 0xECu};

/* CRC-32 of IEEE 802.3 */
static uint32_t hyperjerk_checksum(const unsigned char *bytes, size_t size)
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

void hyperjerk_save(const hyperjerk_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = hyperjerk_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = hyperjerk_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned hyperjerk_restore(hyperjerk_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == HYPERJERK_SAVED) {
        refused = 0u;
        uint32_t sum = hyperjerk_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == hyperjerk_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = HYPERJERK_READY;
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
