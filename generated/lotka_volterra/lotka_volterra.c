/* lotka_volterra: see lotka_volterra.h, and its manual lotka_volterra.md. */
#include "lotka_volterra.h"

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
#define LOTKA_VOLTERRA_RARELY __attribute__((noinline))
#else
#define LOTKA_VOLTERRA_RARELY
#endif

static float lotka_volterra_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float lotka_volterra_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool lotka_volterra_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float lotka_volterra_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool lotka_volterra_within(float v, float limit)
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
static float lotka_volterra_limit(float v, float most)
{
    return lotka_volterra_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float lotka_volterra_keep(float v, float low, float high, float otherwise, float limit)
{
    return lotka_volterra_within(v, limit) ? lotka_volterra_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void lotka_volterra_flow(float z1, float z2, float dz[2])
{
    const float t1 = lotka_volterra_clamp(z1, 1.0f, 80.0f);
    const float t2 = lotka_volterra_clamp(z2, -40.0f, -1.0f);
    dz[0] = 0.02f*t1*z2 + 0.5f*t1;
    dz[1] = t1*t2*0.01f - 0.3f*t2;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void lotka_volterra_jacobian(float z1, float z2, float F[4])
{
    const float t1 = lotka_volterra_clamp(z2, -40.0f, -1.0f);
    const float t2 = lotka_volterra_clamp(z1, 1.0f, 80.0f);
    F[0] = 0.5f + 0.02f*t1; /* F_11 */
    F[1] = 0.01f*t1; /* F_21 */
    F[2] = 0.02f*t2; /* F_12 */
    F[3] = 0.01f*t2 - 0.3f; /* F_22 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
LOTKA_VOLTERRA_RARELY
static unsigned lotka_volterra_ready(lotka_volterra_state *s, const lotka_volterra_params *p)
{
    unsigned status = 0u;
    if (s->ready != LOTKA_VOLTERRA_READY) {
        lotka_volterra_reset(s);
        status |= LOTKA_VOLTERRA_UNINITIALISED;
    }
    if (p->ready != LOTKA_VOLTERRA_READY) {
        lotka_volterra_reset(s);
        status |= LOTKA_VOLTERRA_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
LOTKA_VOLTERRA_RARELY
static void lotka_volterra_clear_fault_counts(lotka_volterra_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 478.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 478.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned lotka_volterra_keep_in_box(lotka_volterra_state *s, const lotka_volterra_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = lotka_volterra_within(s->z[0], 1e+30f) && lotka_volterra_within(s->z[1], 1e+30f)
            && lotka_volterra_within(s->L, 1e+30f);
        lost = !(t1 && lotka_volterra_within(s->D[0], 1e+30f) && lotka_volterra_within(s->D[1], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 1.0f;
        s->z[1] = -1.0f;
        status |= LOTKA_VOLTERRA_RESTARTED;
        lotka_volterra_clear_fault_counts(s);
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 2000.0f;
        s->D[1] = 400.0f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = lotka_volterra_clamp(z1, -78.0f, 159.0f);
        s->z[1] = lotka_volterra_clamp(z2, -79.0f, 38.0f);
        if (z1 < -78.0f || z1 > 159.0f || z2 < -79.0f || z2 > 38.0f) {
            status |= LOTKA_VOLTERRA_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = lotka_volterra_limit(L21, 4.9367088e+08f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = lotka_volterra_clamp(D1, 1e-14f, 14042.25f);
        s->D[1] = lotka_volterra_clamp(D2, 3e-15f, 3422.25f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned lotka_volterra_run_predict(lotka_volterra_state *s, const lotka_volterra_params *p)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    bool running = false;
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        /* z by classical Runge-Kutta; P = L D L' by P <- Phi P Phi' + h Q_theta */
        /* the tableau of z: */
        /*     0 |  */
        /*   1/2 | 1/2 */
        /*   1/2 |   0 1/2 */
        /*     1 |   0   0   1 */
        /*   --------------------- */
        /*       | 1/6 1/3 1/3 1/6 */
        {
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float L21 = s->L;
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            float k1_z[2];
            lotka_volterra_flow(z1, z2, k1_z);
            float k2_z[2];
            lotka_volterra_flow(z1 + 0.005f*k1_z[0], z2 + 0.005f*k1_z[1], k2_z);
            const float t1 = z1 + 0.005f*k2_z[0];
            const float t2 = z2 + 0.005f*k2_z[1];
            float k3_z[2];
            lotka_volterra_flow(t1, t2, k3_z);
            float k4_z[2];
            lotka_volterra_flow(z1 + 0.01f*k3_z[0], z2 + 0.01f*k3_z[1], k4_z);
            float F_1[4];
            lotka_volterra_jacobian(t1, t2, F_1);
            const float Phi_11 = 1.0f + 0.01f*F_1[0] + 5e-05f*(F_1[0]*F_1[0] + F_1[2]*F_1[1]);
            const float Phi_12 = 0.01f*F_1[2] + 5e-05f*(F_1[0]*F_1[2] + F_1[2]*F_1[3]);
            const float Phi_21 = 0.01f*F_1[1] + 5e-05f*(F_1[1]*F_1[0] + F_1[3]*F_1[1]);
            const float Phi_22 = 1.0f + 0.01f*F_1[3] + 5e-05f*(F_1[1]*F_1[2] + F_1[3]*F_1[3]);
            const float w1_1 = Phi_11 + Phi_12*L21;
            const float t3 = w1_1*D1;
            const float t4 = Phi_12*D2;
            const float t5 = 0.01f*p->gain.Q[0];
            const float d1 = w1_1*t3 + Phi_12*t4 + t5;
            const float t6 = Phi_21 + Phi_22*L21;
            const float l21 = (t6*t3 + Phi_22*t4)/d1;
            const float w2_1 = t6 - l21*w1_1;
            const float w2_2 = Phi_22 - l21*Phi_12;
            const float d2 = w2_1*D1*w2_1 + w2_2*D2*w2_2 + l21*t5*l21 + 0.01f*p->gain.Q[1];
            s->z[0] = z1 + 0.0016666667f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
            s->z[1] = z2 + 0.0016666667f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
            s->L = l21;
            s->D[0] = d1;
            s->D[1] = d2;
        }
        /* largest variances */
        {
            const float D1 = s->D[0];
            const float L21 = s->L;
            capped = D1 > 14042.25f || L21*L21*D1 + s->D[1] > 3422.25f;
        }
        if (capped) {
            /* cap */
            {
                const float D1 = s->D[0];
                const float D2 = s->D[1];
                const float L21 = s->L;
                const float t1 = lotka_volterra_min(1.0f, 3422.25f/(L21*L21*D1 + D2));
                const float t2 = lotka_volterra_min(1.0f, 14042.25f/D1);
                s->L = t1*L21/t2;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                status |= LOTKA_VOLTERRA_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const bool t1 = z1 >= -78.0f && z1 <= 159.0f && z2 >= -79.0f && z2 <= 38.0f
                && lotka_volterra_within(s->L, 4.9367088e+08f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            beyond = !(t1 && D1 >= 1e-14f && D1 <= 14042.25f && D2 >= 3e-15f && D2 <= 3422.25f);
        }
        if (lotka_volterra_acts(beyond)) {
            status |= lotka_volterra_keep_in_box(s, p);
        }
    } else {
        status |= lotka_volterra_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned lotka_volterra_guard_measurement_y(const lotka_volterra_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -78.0f && reading <= 159.0f && lotka_volterra_within(t1, 1e+16f);
        const bool t3 = lotka_volterra_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= LOTKA_VOLTERRA_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= LOTKA_VOLTERRA_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned lotka_volterra_use_sample_y(lotka_volterra_state *s, const lotka_volterra_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = p->gain.R/0.01f;
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->D[0] = K1*t1;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float D1 = s->D[0];
        const bool t1 = z1 >= -78.0f && z1 <= 159.0f && z2 >= -79.0f && z2 <= 38.0f && D1 >= 1e-14f
            && D1 <= 14042.25f;
        beyond = !t1;
    }
    if (lotka_volterra_acts(beyond)) {
        status |= lotka_volterra_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned lotka_volterra_suspect_y(const lotka_volterra_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 1.0f || z1 > 80.0f || z2 < -40.0f || z2 > -1.0f;
        if (t1) {
            status |= LOTKA_VOLTERRA_OUTSIDE_BOX;
        }
        *suspect = lotka_volterra_abs(output_error) > 7.9f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool lotka_volterra_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -78.0f && reading <= 159.0f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool lotka_volterra_counts_spoiled_y(const lotka_volterra_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 478.0f + lotka_volterra_abs(fault_count_y)
            + (fault_limit_range - 478.0f + fault_count_range);
        const bool t2 = lotka_volterra_abs(t1 - s->fault_checksum) < 0.5f
            && lotka_volterra_within(fault_count_y, 489472.0f);
        const bool t3 = t2 && fault_limit_y >= 478.0f && fault_limit_y <= 489472.0f
            && fault_count_range >= 0.0f && fault_count_range <= 489472.0f;
        spoiled = !(t3 && fault_limit_range >= 478.0f && fault_limit_range <= 489472.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void lotka_volterra_find_signs_y(const lotka_volterra_state *s, float *moves_y, float output_error,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = lotka_volterra_within(output_error, 7.9f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -239.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned lotka_volterra_recover_y(lotka_volterra_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= lotka_volterra_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t3 = t2 && (fault_limit_range > 478.0f || z1 < -38.5f || z1 > 119.5f || z2 < -59.5f
            || z2 > 18.5f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = lotka_volterra_min(fault_limit_y, 244736.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = lotka_volterra_min(2.0f*fault_limit_y, 489472.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = lotka_volterra_min(fault_limit_range, 244736.0f);
            s->fault_limit_range = lotka_volterra_min(2.0f*fault_limit_range, 489472.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 1.0f;
        s->z[1] = -1.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = lotka_volterra_keep(reading, 1.0f, 80.0f, z1, 1e+30f);
            s->z[1] = lotka_volterra_keep(z2, -40.0f, -1.0f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= LOTKA_VOLTERRA_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 2000.0f;
        s->D[1] = 400.0f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - lotka_volterra_clamp(z1, 1.0f, 80.0f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - lotka_volterra_clamp(t3, -40.0f, -1.0f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 38.0f - z2 : z2 + 79.0f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 159.0f - z1 : z1 + 78.0f;
            const float t9 = lotka_volterra_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = lotka_volterra_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = lotka_volterra_keep(z1 + t12*t7, -78.0f, 159.0f, z1, 1e+30f);
            s->z[1] = lotka_volterra_keep(z2 + t12*t5, -79.0f, 38.0f, z2, 1e+30f);
            status |= LOTKA_VOLTERRA_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned lotka_volterra_count_faults_y(lotka_volterra_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = lotka_volterra_counts_spoiled_y(s);
    if (spoiled) {
        lotka_volterra_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        moves_range = (z1 < -2.95f || z1 > 83.95f || z2 < -41.95f || z2 > 0.95f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = lotka_volterra_clamp(fault_count_range + moves_range, 0.0f, 489472.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 478.0f : fault_limit_range;
    }
    lotka_volterra_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = lotka_volterra_clamp(lotka_volterra_abs(fault_count_y) + moves_y, 0.0f, 489472.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 478.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= lotka_volterra_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= lotka_volterra_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 478.0f + lotka_volterra_abs(s->fault_count_y)
        + (s->fault_limit_range - 478.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned lotka_volterra_run_update_y(lotka_volterra_state *s, const lotka_volterra_params *p,
    const lotka_volterra_output *measurement)
{
    unsigned status = 0u;
    float e = 0.0f;
    bool fresh = false;
    float output_error = 0.0f;
    float reading = 0.0f;
    bool sampled = false;
    bool suspect = false;
    bool valid = false;
    /* is a sample of y awaited? */
    fresh = s->used_y < 1u;
    if (fresh) {
        /* the measurement of y */
        reading = measurement->y;
        status |= lotka_volterra_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= lotka_volterra_use_sample_y(s, p, e);
        }
        status |= lotka_volterra_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = lotka_volterra_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= lotka_volterra_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= LOTKA_VOLTERRA_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
LOTKA_VOLTERRA_RARELY
static void lotka_volterra_nominal(lotka_volterra_params *p)
{
    p->ready = LOTKA_VOLTERRA_READY;
    p->gain.Q[0] = 1.0f;
    p->gain.Q[1] = 0.3f;
    p->gain.R = 0.0001f;
}

unsigned lotka_volterra_predict(lotka_volterra_state *s, const lotka_volterra_params *p)
{
    unsigned status = 0u;
    if ((s->ready != LOTKA_VOLTERRA_READY) || (p->ready != LOTKA_VOLTERRA_READY)) {
        status = lotka_volterra_ready(s, p);
    }
    if ((status & LOTKA_VOLTERRA_NO_PARAMETERS) == 0u) {
        status |= lotka_volterra_run_predict(s, p);
    }
    return status;
}

unsigned lotka_volterra_update_y(lotka_volterra_state *s, const lotka_volterra_params *p,
    const lotka_volterra_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LOTKA_VOLTERRA_READY) || (p->ready != LOTKA_VOLTERRA_READY)) {
        status = lotka_volterra_ready(s, p);
    }
    if ((status & LOTKA_VOLTERRA_NO_PARAMETERS) == 0u) {
        status |= lotka_volterra_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned lotka_volterra_step(lotka_volterra_state *s, const lotka_volterra_params *p,
    const lotka_volterra_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LOTKA_VOLTERRA_READY) || (p->ready != LOTKA_VOLTERRA_READY)) {
        status = lotka_volterra_ready(s, p);
    }
    if ((status & LOTKA_VOLTERRA_NO_PARAMETERS) == 0u) {
        status |= lotka_volterra_run_predict(s, p);
        status |= lotka_volterra_run_update_y(s, p, measurement);
    }
    return status;
}

void lotka_volterra_estimate(const lotka_volterra_state *s, const lotka_volterra_params *p,
    lotka_volterra_plant *x)
{
    (void)p;
    /* the plant's state */
    x->N = s->z[0];
    x->P = -s->z[1];
}

unsigned lotka_volterra_tune(lotka_volterra_params *p)
{
    unsigned status = 0u;
    if (p->ready != LOTKA_VOLTERRA_READY) {
        lotka_volterra_nominal(p);
        status = LOTKA_VOLTERRA_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float R = p->gain.R;
        p->gain.Q[0] = lotka_volterra_keep(Q1, 3e-07f, 1000000.0f, 1.0f, 3e+38f);
        p->gain.Q[1] = lotka_volterra_keep(Q2, 3e-07f, 1000000.0f, 0.3f, 3e+38f);
        p->gain.R = lotka_volterra_keep(R, 1e-10f, 100.0f, 0.0001f, 3e+38f);
        if (!(Q1 >= 3e-07f && Q1 <= 1000000.0f) || !(Q2 >= 3e-07f && Q2 <= 1000000.0f)
            || !(R >= 1e-10f && R <= 100.0f)) {
            status |= LOTKA_VOLTERRA_PARAMETER_LIMITED;
        }
    }
    return status;
}

LOTKA_VOLTERRA_RARELY
void lotka_volterra_reset(lotka_volterra_state *s)
{
    s->ready = LOTKA_VOLTERRA_READY;
    s->z[0] = 1.0f;
    s->z[1] = -1.0f;
    s->L = 0.0f;
    s->D[0] = 2000.0f;
    s->D[1] = 400.0f;
    s->calls = 0u;
    s->used_y = 1u;
    lotka_volterra_clear_fault_counts(s);
}

void lotka_volterra_init(lotka_volterra_state *s, lotka_volterra_params *p)
{
    lotka_volterra_nominal(p);
    (void)lotka_volterra_tune(p);
    lotka_volterra_reset(s);
}

static const unsigned char lotka_volterra_layout[8] = {
    0xAEu, 0x5Du, 0xE0u, 0x93u, 0x15u, 0x62u, 0x61u, 0x50u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t lotka_volterra_checksum(const unsigned char *bytes, size_t size)
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

void lotka_volterra_save(const lotka_volterra_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = lotka_volterra_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = lotka_volterra_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned lotka_volterra_restore(lotka_volterra_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == LOTKA_VOLTERRA_SAVED) {
        refused = 0u;
        uint32_t sum = lotka_volterra_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == lotka_volterra_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = LOTKA_VOLTERRA_READY;
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
