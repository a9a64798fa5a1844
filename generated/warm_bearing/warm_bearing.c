/* warm_bearing: see warm_bearing.h, and its manual warm_bearing.md. */
#include "warm_bearing.h"

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
#define WARM_BEARING_RARELY __attribute__((noinline))
#else
#define WARM_BEARING_RARELY
#endif

static float warm_bearing_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float warm_bearing_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool warm_bearing_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float warm_bearing_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool warm_bearing_within(float v, float limit)
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
static float warm_bearing_limit(float v, float most)
{
    return warm_bearing_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float warm_bearing_keep(float v, float low, float high, float otherwise, float limit)
{
    return warm_bearing_within(v, limit) ? warm_bearing_clamp(v, low, high) : otherwise;
}

/* the table friction: bilinear, 11 x 4 points, held at its ends */
static float warm_bearing_table_friction(float x, float y)
{
    static const float start[12] = {
        -0.9f, -0.9f, -0.5f, -0.3f, -0.2f, -0.1f, 0.0f, 0.1f, 0.2f, 0.3f, 0.5f, 0.9f
    };
    static const float start_y[5] = {0.0f, 0.0f, 20.0f, 40.0f, 80.0f};
    static const float c00[60] = {
        -2.9f, -2.9f, -2.1f, -1.6f, -1.25f, -2.9f, -2.9f, -2.1f, -1.6f, -1.25f, -2.0f, -2.0f, -1.6f, -1.3f,
        -1.1f, -1.7f, -1.7f, -1.45f, -1.3f, -1.2f, -1.7f, -1.7f, -1.6f, -1.5f, -1.4f, -2.4f, -2.4f, -2.0f,
        -1.8f, -1.6f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 2.4f, 2.4f, 2.0f, 1.8f, 1.6f, 1.7f, 1.7f, 1.6f, 1.5f,
        1.4f, 1.7f, 1.7f, 1.45f, 1.3f, 1.2f, 2.0f, 2.0f, 1.6f, 1.3f, 1.1f, 2.9f, 2.9f, 2.1f, 1.6f, 1.25f
    };
    static const float c01[60] = {
        0.0f, 0.04f, 0.025f, 0.00875f, 0.0f, 0.0f, 0.04f, 0.025f, 0.00875f, 0.0f, 0.0f, 0.02f, 0.015f, 0.005f,
        0.0f, 0.0f, 0.0125f, 0.0075f, 0.0025f, 0.0f, 0.0f, 0.005f, 0.005f, 0.0025f, 0.0f, 0.0f, 0.02f, 0.01f,
        0.005f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, -0.02f, -0.01f, -0.005f, 0.0f, 0.0f, -0.005f,
        -0.005f, -0.0025f, 0.0f, 0.0f, -0.0125f, -0.0075f, -0.0025f, 0.0f, 0.0f, -0.02f, -0.015f, -0.005f,
        0.0f, 0.0f, -0.04f, -0.025f, -0.00875f, 0.0f
    };
    static const float c10[60] = {
        0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 2.25f, 2.25f, 1.25f, 0.75f, 0.375f, 1.5f, 1.5f, 0.75f, 0.0f, -0.5f,
        0.0f, 0.0f, -1.5f, -2.0f, -2.0f, -7.0f, -7.0f, -4.0f, -3.0f, -2.0f, 24.0f, 24.0f, 20.0f, 18.0f, 16.0f,
        24.0f, 24.0f, 20.0f, 18.0f, 16.0f, -7.0f, -7.0f, -4.0f, -3.0f, -2.0f, 0.0f, 0.0f, -1.5f, -2.0f, -2.0f,
        1.5f, 1.5f, 0.75f, 0.0f, -0.5f, 2.25f, 2.25f, 1.25f, 0.75f, 0.375f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f
    };
    static const float c11[60] = {
        0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, -0.05f, -0.025f, -0.009375f, 0.0f, 0.0f, -0.0375f, -0.0375f,
        -0.0125f, 0.0f, 0.0f, -0.075f, -0.025f, 0.0f, 0.0f, 0.0f, 0.15f, 0.05f, 0.025f, 0.0f, 0.0f, -0.2f,
        -0.1f, -0.05f, 0.0f, 0.0f, -0.2f, -0.1f, -0.05f, 0.0f, 0.0f, 0.15f, 0.05f, 0.025f, 0.0f, 0.0f,
        -0.075f, -0.025f, 0.0f, 0.0f, 0.0f, -0.0375f, -0.0375f, -0.0125f, 0.0f, 0.0f, -0.05f, -0.025f,
        -0.009375f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f
    };
    unsigned k = 0u;
    unsigned probe = 8u;
    while (probe > 0u) {
        if (k + probe <= 11u && start[k + probe] <= x) {
            k = k + probe;
        }
        probe = probe/2u;
    }
    const float d = x - start[k];
    unsigned j = 0u;
    probe = 4u;
    while (probe > 0u) {
        if (j + probe <= 4u && start_y[j + probe] <= y) {
            j = j + probe;
        }
        probe = probe/2u;
    }
    const float e = y - start_y[j];
    j = k*5u + j;
    return c00[j] + e*c01[j] + d*(c10[j] + e*c11[j]);
}

/* the right-hand side of the observer's differential equation */
static void warm_bearing_rate(const warm_bearing_params *p, float z1, float z2, float u1, float u2, float y,
    float valid, float dz[2])
{
    const float t1 = valid*(y - z1);
    dz[0] = z2 + p->derived.K[0]*t1;
    dz[1] = u1 - warm_bearing_table_friction(warm_bearing_limit(z2, 0.8f), u2) + p->derived.K[1]*t1;
}

/* memory without its mark is not used: the state begins anew, which the status says */
WARM_BEARING_RARELY
static unsigned warm_bearing_ready(warm_bearing_state *s, const warm_bearing_params *p)
{
    unsigned status = 0u;
    if (s->ready != WARM_BEARING_READY) {
        warm_bearing_reset(s);
        status |= WARM_BEARING_UNINITIALISED;
    }
    if (p->ready != WARM_BEARING_READY) {
        warm_bearing_reset(s);
        status |= WARM_BEARING_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
WARM_BEARING_RARELY
static void warm_bearing_clear_fault_counts(warm_bearing_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 2391.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 2391.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned warm_bearing_keep_in_box(warm_bearing_state *s, const warm_bearing_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    lost = !(warm_bearing_within(s->z[0], 1e+30f) && warm_bearing_within(s->z[1], 1e+30f));
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        status |= WARM_BEARING_RESTARTED;
        warm_bearing_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = warm_bearing_limit(z1, 6.0f);
        s->z[1] = warm_bearing_limit(z2, 80.0f);
        if (warm_bearing_abs(z1) > 6.0f || warm_bearing_abs(z2) > 80.0f) {
            status |= WARM_BEARING_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
WARM_BEARING_RARELY
static void warm_bearing_nominal(warm_bearing_params *p)
{
    p->ready = WARM_BEARING_READY;
    p->gain.theta = 100.0f;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned warm_bearing_guard_input(const warm_bearing_state *s, const warm_bearing_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = warm_bearing_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u[0];
        const float T = in->T;
        const bool T_usable = warm_bearing_within(T, 1e+15f);
        const float T_taken = T_usable ? T : s->u[1];
        u[0] = warm_bearing_limit(u_taken, 6.0f);
        u[1] = warm_bearing_clamp(T_taken, -10.0f, 90.0f);
        if (!u_usable) {
            status |= WARM_BEARING_REUSED_U;
        }
        if (warm_bearing_abs(u_taken) > 6.0f) {
            status |= WARM_BEARING_CLAMPED_U;
        }
        if (!T_usable) {
            status |= WARM_BEARING_REUSED_T;
        }
        if (T_taken < -10.0f || T_taken > 90.0f) {
            status |= WARM_BEARING_CLAMPED_T;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned warm_bearing_guard_measurements(const warm_bearing_state *s,
    const warm_bearing_output *measurement, float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = warm_bearing_within(reading, 6.6f) && warm_bearing_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = warm_bearing_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && warm_bearing_within(y_before, 6.6f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= WARM_BEARING_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= WARM_BEARING_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned warm_bearing_advance(warm_bearing_state *s, const warm_bearing_params *p, const float *u,
    float valid, float y, float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[2];
    float z_sum[2];
    /* z: one step of classical Runge-Kutta */
    /* its tableau: */
    /*     0 |  */
    /*   1/2 | 1/2 */
    /*   1/2 |   0 1/2 */
    /*     1 |   0   0   1 */
    /*   --------------------- */
    /*       | 1/6 1/3 1/3 1/6 */
    /* fraction is c of a stage; share is its b over that of the first; ahead is the next stage's a times
     * dt */
    z_sum[0] = 0.0f;
    z_sum[1] = 0.0f;
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
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
                const float z_at1 = z_at[0];
                const float z_at2 = z_at[1];
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float u_before1 = s->u[0];
                const float u_before2 = s->u[1];
                float k_z[2];
                warm_bearing_rate(p, z_at1, z_at2, u_before1 + fraction*(u[0] - u_before1), u_before2
                    + fraction*(u[1] - u_before2), y_last + fraction*(y - y_last), valid, k_z);
                z_sum[0] = z_sum1 + share*k_z[0];
                z_sum[1] = z_sum2 + share*k_z[1];
                z_at[0] = s->z[0] + ahead*k_z[0];
                z_at[1] = s->z[1] + ahead*k_z[1];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = z1 + 0.00016666666f*z_sum[0];
        s->z[1] = z2 + 0.00016666666f*z_sum[1];
    }
    /* is a value beyond its box, or lost? */
    beyond = !(warm_bearing_within(s->z[0], 6.0f) && warm_bearing_within(s->z[1], 80.0f));
    if (warm_bearing_acts(beyond)) {
        status |= warm_bearing_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned warm_bearing_suspect(const warm_bearing_state *s, const warm_bearing_output *measurement,
    bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = warm_bearing_abs(z1) > 2.0f || warm_bearing_abs(s->z[1]) > 0.8f;
        if (t1) {
            status |= WARM_BEARING_OUTSIDE_BOX;
        }
        *suspect = warm_bearing_abs(measurement->y - z1) > 0.44f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool warm_bearing_counts_spoiled(const warm_bearing_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 2391.0f + warm_bearing_abs(fault_count_y)
            + (fault_limit_range - 2391.0f + fault_count_range);
        const bool t2 = warm_bearing_abs(t1 - s->fault_checksum) < 0.5f
            && warm_bearing_within(fault_count_y, 2448384.0f);
        const bool t3 = t2 && fault_limit_y >= 2391.0f && fault_limit_y <= 2448384.0f
            && fault_count_range >= 0.0f && fault_count_range <= 2448384.0f;
        spoiled = !(t3 && fault_limit_range >= 2391.0f && fault_limit_range <= 2448384.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void warm_bearing_find_signs(const warm_bearing_state *s, const warm_bearing_output *measurement,
    float *moves_y, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = warm_bearing_within(t1, 0.44f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -1195.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned warm_bearing_recover(warm_bearing_state *s, const warm_bearing_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= warm_bearing_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = fault_limit_range > 2391.0f || warm_bearing_abs(s->z[0]) > 4.0f
            || warm_bearing_abs(s->z[1]) > 1.6f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = warm_bearing_min(fault_limit_y, 1224192.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = warm_bearing_min(2.0f*fault_limit_y, 2448384.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = warm_bearing_min(fault_limit_range, 1224192.0f);
            s->fault_limit_range = warm_bearing_min(2.0f*fault_limit_range, 2448384.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = warm_bearing_keep(measurement->y, -2.0f, 2.0f, z1, 1e+30f);
            s->z[1] = warm_bearing_keep(z2, -0.8f, 0.8f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= WARM_BEARING_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = warm_bearing_limit(z1, 2.0f);
            s->z[1] = warm_bearing_limit(z2, 0.8f);
            status |= WARM_BEARING_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned warm_bearing_count_faults(warm_bearing_state *s, const warm_bearing_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = warm_bearing_counts_spoiled(s);
    if (spoiled) {
        warm_bearing_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    moves_range = (warm_bearing_abs(s->z[0]) > 2.2f || warm_bearing_abs(s->z[1]) > 0.88f) ? 1.0f : -1.0f;
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = warm_bearing_clamp(fault_count_range + moves_range, 0.0f, 2448384.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 2391.0f : fault_limit_range;
    }
    warm_bearing_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = warm_bearing_clamp(warm_bearing_abs(fault_count_y) + moves_y, 0.0f, 2448384.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 2391.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= warm_bearing_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= warm_bearing_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 2391.0f + warm_bearing_abs(s->fault_count_y)
        + (s->fault_limit_range - 2391.0f + s->fault_count_range);
    return status;
}

unsigned warm_bearing_step(warm_bearing_state *s, const warm_bearing_params *p, const warm_bearing_input *in,
    const warm_bearing_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != WARM_BEARING_READY) || (p->ready != WARM_BEARING_READY)) {
        status = warm_bearing_ready(s, p);
    }
    if ((status & WARM_BEARING_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float u[2];
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        /* keep u in its box */
        {
            const float u_before1 = s->u[0];
            const float u_before2 = s->u[1];
            s->u[0] = warm_bearing_limit(u_before1, 6.0f);
            s->u[1] = warm_bearing_clamp(u_before2, -10.0f, 90.0f);
        }
        status |= warm_bearing_guard_input(s, in, u);
        status |= warm_bearing_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= warm_bearing_advance(s, p, u, valid, y, y_last);
        } else {
            status |= warm_bearing_keep_in_box(s, p);
        }
        /* remember the input */
        s->u[0] = u[0];
        s->u[1] = u[1];
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= warm_bearing_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || warm_bearing_within(measurement->y, 6.6f);
            if (sampled) {
                status |= warm_bearing_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void warm_bearing_estimate(const warm_bearing_state *s, const warm_bearing_params *p, warm_bearing_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->v = s->z[1];
}

unsigned warm_bearing_tune(warm_bearing_params *p)
{
    unsigned status = 0u;
    if (p->ready != WARM_BEARING_READY) {
        warm_bearing_nominal(p);
        status = WARM_BEARING_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = warm_bearing_keep(theta, 1.0f, 100.0f, 100.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 100.0f)) {
            status |= WARM_BEARING_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        p->derived.K[0] = 2.0f*theta;
        p->derived.K[1] = theta*theta;
    }
    return status;
}

WARM_BEARING_RARELY
void warm_bearing_reset(warm_bearing_state *s)
{
    s->ready = WARM_BEARING_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->calls = 0u;
    s->u[0] = 0.0f;
    s->u[1] = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    warm_bearing_clear_fault_counts(s);
}

void warm_bearing_init(warm_bearing_state *s, warm_bearing_params *p)
{
    warm_bearing_nominal(p);
    (void)warm_bearing_tune(p);
    warm_bearing_reset(s);
}

static const unsigned char warm_bearing_layout[8] = {0xC4u, 0xD7u, 0xB0u, 0xB6u, 0x96u, 0x3Fu, 0x75u, 0xFCu};

/* CRC-32 of IEEE 802.3 */
static uint32_t warm_bearing_checksum(const unsigned char *bytes, size_t size)
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

void warm_bearing_save(const warm_bearing_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = warm_bearing_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = warm_bearing_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned warm_bearing_restore(warm_bearing_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == WARM_BEARING_SAVED) {
        refused = 0u;
        uint32_t sum = warm_bearing_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == warm_bearing_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = WARM_BEARING_READY;
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
