/* hindmarsh_rose: see hindmarsh_rose.h, and its manual hindmarsh_rose.md. */
#include "hindmarsh_rose.h"

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
#define HINDMARSH_ROSE_RARELY __attribute__((noinline))
#else
#define HINDMARSH_ROSE_RARELY
#endif

static float hindmarsh_rose_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float hindmarsh_rose_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool hindmarsh_rose_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float hindmarsh_rose_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool hindmarsh_rose_within(float v, float limit)
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

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float hindmarsh_rose_keep(float v, float low, float high, float otherwise, float limit)
{
    return hindmarsh_rose_within(v, limit) ? hindmarsh_rose_clamp(v, low, high) : otherwise;
}

/* the right-hand side of the observer's differential equation */
static void hindmarsh_rose_rate(const hindmarsh_rose_params *p, float z1, float z2, float z3, float u,
    float y, float valid, float dz[3])
{
    const float t1 = hindmarsh_rose_clamp(z1, -2.0f, 3.0f);
    const float t2 = t1*t1;
    const float t3 = t2*t1;
    const float t4 = 3.0f*t2;
    const float K1 = p->derived.K[0];
    const float t5 = valid*(y - z1);
    const float t6 = 6.0f*t1;
    const float t7 = t4 - t6 + 0.006f;
    const float t8 = t6 - t4;
    const float t9 = t8 - 1.0f;
    const float t10 = t7 + t9;
    const float K2 = p->derived.K[1];
    const float t11 = hindmarsh_rose_clamp(z2, -20.0f, 2.0f);
    const float t12 = hindmarsh_rose_clamp(z3, 0.0f, 5.0f);
    const float t13 = 6.0f*u - u*t1*6.0f + t2*t2*15.0f - 60.0f*t3 + 54.0f*t2 - t1*t11*6.0f + t1*t12*6.0f
        - 10.0f*t1;
    const float t14 = t13 + 6.0f*t11 - 6.0f*t12 - 0.024f;
    const float t15 = p->derived.K[2]/t10;
    dz[0] = z2 - z3 + (u - t3 + t4) + K1*t5;
    dz[1] = 1.0f - 5.0f*t2 - z2 + (t7/t10*K2 - (t8*t7 + t14)/t10*K1 + t15)*t5;
    dz[2] = 0.024f*z1 - 0.006f*z3 + 0.0384f + ((t8*t9 - t14)/t10*K1 - t9/t10*K2 + t15)*t5;
}

/* memory without its mark is not used: the state begins anew, which the status says */
HINDMARSH_ROSE_RARELY
static unsigned hindmarsh_rose_ready(hindmarsh_rose_state *s, const hindmarsh_rose_params *p)
{
    unsigned status = 0u;
    if (s->ready != HINDMARSH_ROSE_READY) {
        hindmarsh_rose_reset(s);
        status |= HINDMARSH_ROSE_UNINITIALISED;
    }
    if (p->ready != HINDMARSH_ROSE_READY) {
        hindmarsh_rose_reset(s);
        status |= HINDMARSH_ROSE_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
HINDMARSH_ROSE_RARELY
static void hindmarsh_rose_clear_fault_counts(hindmarsh_rose_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 1101.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 1101.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned hindmarsh_rose_keep_in_box(hindmarsh_rose_state *s, const hindmarsh_rose_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = hindmarsh_rose_within(s->z[0], 1e+30f) && hindmarsh_rose_within(s->z[1], 1e+30f)
            && hindmarsh_rose_within(s->z[2], 1e+30f);
        lost = !t1;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= HINDMARSH_ROSE_RESTARTED;
        hindmarsh_rose_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = hindmarsh_rose_clamp(z1, -249.5f, 250.5f);
        s->z[1] = hindmarsh_rose_clamp(z2, -1109.0f, 1091.0f);
        s->z[2] = hindmarsh_rose_clamp(z3, -247.5f, 252.5f);
        if (z1 < -249.5f || z1 > 250.5f || z2 < -1109.0f || z2 > 1091.0f || z3 < -247.5f || z3 > 252.5f) {
            status |= HINDMARSH_ROSE_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
HINDMARSH_ROSE_RARELY
static void hindmarsh_rose_nominal(hindmarsh_rose_params *p)
{
    p->ready = HINDMARSH_ROSE_READY;
    p->gain.theta = 10.0f;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned hindmarsh_rose_guard_input(const hindmarsh_rose_state *s, const hindmarsh_rose_input *in,
    float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = hindmarsh_rose_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = hindmarsh_rose_clamp(u_taken, 0.0f, 4.0f);
        if (!u_usable) {
            status |= HINDMARSH_ROSE_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 4.0f) {
            status |= HINDMARSH_ROSE_CLAMPED_U;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned hindmarsh_rose_guard_measurements(const hindmarsh_rose_state *s,
    const hindmarsh_rose_output *measurement, float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = reading >= -7.0f && reading <= 8.0f && hindmarsh_rose_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = hindmarsh_rose_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && y_before >= -7.0f && y_before <= 8.0f) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= HINDMARSH_ROSE_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= HINDMARSH_ROSE_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned hindmarsh_rose_advance(hindmarsh_rose_state *s, const hindmarsh_rose_params *p, float u,
    float valid, float y, float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[3];
    float z_sum[3];
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
    z_sum[2] = 0.0f;
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
    z_at[2] = s->z[2];
    {
        static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
        static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
        static const float each_ahead[4] = {0.0025f, 0.0025f, 0.005f, 0.0f};
        for (unsigned r = 0u; r < 4u; ++r) {
            fraction = each_fraction[r];
            share = each_share[r];
            ahead = each_ahead[r];
            /* a stage */
            {
                const float z_at1 = z_at[0];
                const float z_at2 = z_at[1];
                const float z_at3 = z_at[2];
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float z_sum3 = z_sum[2];
                const float u_before = s->u;
                float k_z[3];
                hindmarsh_rose_rate(p, z_at1, z_at2, z_at3, u_before + fraction*(u - u_before), y_last
                    + fraction*(y - y_last), valid, k_z);
                z_sum[0] = z_sum1 + share*k_z[0];
                z_sum[1] = z_sum2 + share*k_z[1];
                z_sum[2] = z_sum3 + share*k_z[2];
                z_at[0] = s->z[0] + ahead*k_z[0];
                z_at[1] = s->z[1] + ahead*k_z[1];
                z_at[2] = s->z[2] + ahead*k_z[2];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = z1 + 0.00083333335f*z_sum[0];
        s->z[1] = z2 + 0.00083333335f*z_sum[1];
        s->z[2] = z3 + 0.00083333335f*z_sum[2];
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const bool t1 = z1 >= -249.5f && z1 <= 250.5f && z2 >= -1109.0f && z2 <= 1091.0f && z3 >= -247.5f
            && z3 <= 252.5f;
        beyond = !t1;
    }
    if (hindmarsh_rose_acts(beyond)) {
        status |= hindmarsh_rose_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned hindmarsh_rose_suspect(const hindmarsh_rose_state *s,
    const hindmarsh_rose_output *measurement, bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const bool t1 = z1 < -2.0f || z1 > 3.0f || z2 < -20.0f || z2 > 2.0f || z3 < 0.0f || z3 > 5.0f;
        if (t1) {
            status |= HINDMARSH_ROSE_OUTSIDE_BOX;
        }
        *suspect = hindmarsh_rose_abs(measurement->y - z1) > 0.5f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool hindmarsh_rose_sample_in_plausible_range(const hindmarsh_rose_output *measurement, float valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    {
        const float reading = measurement->y;
        sampled = valid > 0.0f || (reading >= -7.0f && reading <= 8.0f);
    }
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool hindmarsh_rose_counts_spoiled(const hindmarsh_rose_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 1101.0f + hindmarsh_rose_abs(fault_count_y)
            + (fault_limit_range - 1101.0f + fault_count_range);
        const bool t2 = hindmarsh_rose_abs(t1 - s->fault_checksum) < 0.5f
            && hindmarsh_rose_within(fault_count_y, 1127424.0f);
        const bool t3 = t2 && fault_limit_y >= 1101.0f && fault_limit_y <= 1127424.0f
            && fault_count_range >= 0.0f && fault_count_range <= 1127424.0f;
        spoiled = !(t3 && fault_limit_range >= 1101.0f && fault_limit_range <= 1127424.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void hindmarsh_rose_find_signs(const hindmarsh_rose_state *s,
    const hindmarsh_rose_output *measurement, float *moves_y, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = hindmarsh_rose_within(t1, 0.5f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -550.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned hindmarsh_rose_recover(hindmarsh_rose_state *s, const hindmarsh_rose_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= hindmarsh_rose_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const bool t3 = fault_limit_range > 1101.0f || z1 < -4.5f || z1 > 5.5f || z2 < -31.0f || z2 > 13.0f
            || z3 < -2.5f || z3 > 7.5f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = hindmarsh_rose_min(fault_limit_y, 563712.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = hindmarsh_rose_min(2.0f*fault_limit_y, 1127424.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = hindmarsh_rose_min(fault_limit_range, 563712.0f);
            s->fault_limit_range = hindmarsh_rose_min(2.0f*fault_limit_range, 1127424.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = hindmarsh_rose_keep(measurement->y, -2.0f, 3.0f, z1, 1e+30f);
            s->z[1] = hindmarsh_rose_keep(z2, -20.0f, 2.0f, z2, 1e+30f);
            s->z[2] = hindmarsh_rose_keep(z3, 0.0f, 5.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= HINDMARSH_ROSE_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = hindmarsh_rose_clamp(z1, -2.0f, 3.0f);
            s->z[1] = hindmarsh_rose_clamp(z2, -20.0f, 2.0f);
            s->z[2] = hindmarsh_rose_clamp(z3, 0.0f, 5.0f);
            status |= HINDMARSH_ROSE_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned hindmarsh_rose_count_faults(hindmarsh_rose_state *s, const hindmarsh_rose_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = hindmarsh_rose_counts_spoiled(s);
    if (spoiled) {
        hindmarsh_rose_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        moves_range = (z1 < -2.25f || z1 > 3.25f || z2 < -21.1f || z2 > 3.1f || z3 < -0.25f || z3 > 5.25f)
            ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = hindmarsh_rose_clamp(fault_count_range + moves_range, 0.0f, 1127424.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 1101.0f : fault_limit_range;
    }
    hindmarsh_rose_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = hindmarsh_rose_clamp(hindmarsh_rose_abs(fault_count_y) + moves_y, 0.0f, 1127424.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 1101.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= hindmarsh_rose_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= hindmarsh_rose_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 1101.0f + hindmarsh_rose_abs(s->fault_count_y)
        + (s->fault_limit_range - 1101.0f + s->fault_count_range);
    return status;
}

unsigned hindmarsh_rose_step(hindmarsh_rose_state *s, const hindmarsh_rose_params *p,
    const hindmarsh_rose_input *in, const hindmarsh_rose_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != HINDMARSH_ROSE_READY) || (p->ready != HINDMARSH_ROSE_READY)) {
        status = hindmarsh_rose_ready(s, p);
    }
    if ((status & HINDMARSH_ROSE_NO_PARAMETERS) == 0u) {
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
            s->u = hindmarsh_rose_clamp(u_before, 0.0f, 4.0f);
        }
        status |= hindmarsh_rose_guard_input(s, in, &u);
        status |= hindmarsh_rose_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= hindmarsh_rose_advance(s, p, u, valid, y, y_last);
        } else {
            status |= hindmarsh_rose_keep_in_box(s, p);
        }
        /* remember the input */
        s->u = u;
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= hindmarsh_rose_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            sampled = hindmarsh_rose_sample_in_plausible_range(measurement, valid);
            if (sampled) {
                status |= hindmarsh_rose_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void hindmarsh_rose_estimate(const hindmarsh_rose_state *s, const hindmarsh_rose_params *p,
    hindmarsh_rose_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->w = s->z[1];
    x->z = s->z[2];
}

unsigned hindmarsh_rose_tune(hindmarsh_rose_params *p)
{
    unsigned status = 0u;
    if (p->ready != HINDMARSH_ROSE_READY) {
        hindmarsh_rose_nominal(p);
        status = HINDMARSH_ROSE_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = hindmarsh_rose_keep(theta, 1.0f, 10.0f, 10.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 10.0f)) {
            status |= HINDMARSH_ROSE_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        const float t1 = theta*theta;
        p->derived.K[0] = 3.0f*theta;
        p->derived.K[1] = 3.0f*t1;
        p->derived.K[2] = t1*theta;
    }
    return status;
}

HINDMARSH_ROSE_RARELY
void hindmarsh_rose_reset(hindmarsh_rose_state *s)
{
    s->ready = HINDMARSH_ROSE_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    hindmarsh_rose_clear_fault_counts(s);
}

void hindmarsh_rose_init(hindmarsh_rose_state *s, hindmarsh_rose_params *p)
{
    hindmarsh_rose_nominal(p);
    (void)hindmarsh_rose_tune(p);
    hindmarsh_rose_reset(s);
}

static const unsigned char hindmarsh_rose_layout[8] = {
    0xA5u, 0x54u, 0x7Bu, 0x19u, 0xB8u, 0x62u, 0x53u, 0x16u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t hindmarsh_rose_checksum(const unsigned char *bytes, size_t size)
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

void hindmarsh_rose_save(const hindmarsh_rose_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = hindmarsh_rose_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = hindmarsh_rose_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned hindmarsh_rose_restore(hindmarsh_rose_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == HINDMARSH_ROSE_SAVED) {
        refused = 0u;
        uint32_t sum = hindmarsh_rose_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == hindmarsh_rose_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = HINDMARSH_ROSE_READY;
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
