/* contois: see contois.h, and its manual contois.md. */
#include "contois.h"

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
#define CONTOIS_RARELY __attribute__((noinline))
#else
#define CONTOIS_RARELY
#endif

static float contois_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float contois_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool contois_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float contois_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool contois_within(float v, float limit)
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
static float contois_limit(float v, float most)
{
    return contois_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float contois_keep(float v, float low, float high, float otherwise, float limit)
{
    return contois_within(v, limit) ? contois_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void contois_flow(float z1, float z2, float u, float dz[2])
{
    const float t1 = contois_clamp(z1, 0.1f, 5.0f);
    const float t2 = contois_clamp(z2, 0.1f, 10.0f);
    const float t3 = t1*t2/(t1 + t2);
    dz[0] = t3 - u*z1;
    dz[1] = 0.1f*u - t3 - u*z2;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void contois_jacobian(float z1, float z2, float u, float F[4])
{
    const float t1 = contois_clamp(z2, 0.1f, 10.0f);
    const float t2 = contois_clamp(z1, 0.1f, 5.0f);
    const float t3 = t2 + t1;
    const float t4 = t2*t1/t3/t3;
    const float t5 = t1/t3 - t4;
    const float t6 = t2/t3 - t4;
    F[0] = t5 - u; /* F_11 */
    F[1] = -t5; /* F_21 */
    F[2] = t6; /* F_12 */
    F[3] = -(u + t6); /* F_22 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
CONTOIS_RARELY
static unsigned contois_ready(contois_state *s, const contois_params *p)
{
    unsigned status = 0u;
    if (s->ready != CONTOIS_READY) {
        contois_reset(s);
        status |= CONTOIS_UNINITIALISED;
    }
    if (p->ready != CONTOIS_READY) {
        contois_reset(s);
        status |= CONTOIS_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
CONTOIS_RARELY
static void contois_clear_fault_counts(contois_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 600.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 600.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned contois_keep_in_box(contois_state *s, const contois_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = contois_within(s->z[0], 1e+30f) && contois_within(s->z[1], 1e+30f)
            && contois_within(s->L, 1e+30f);
        lost = !(t1 && contois_within(s->D[0], 1e+30f) && contois_within(s->D[1], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.1f;
        s->z[1] = 0.1f;
        status |= CONTOIS_RESTARTED;
        contois_clear_fault_counts(s);
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 6.0f;
        s->D[1] = 20.0f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = contois_clamp(z1, -4.8f, 9.9f);
        s->z[1] = contois_clamp(z2, -9.8f, 19.9f);
        if (z1 < -4.8f || z1 > 9.9f || z2 < -9.8f || z2 > 19.9f) {
            status |= CONTOIS_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = contois_limit(L21, 1.5333456e+10f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = contois_clamp(D1, 5e-19f, 54.0225f);
        s->D[1] = contois_clamp(D2, 1e-15f, 12701.493f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned contois_run_predict(contois_state *s, const contois_params *p, const contois_input *in)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = contois_clamp(u_before, 0.0f, 0.5f);
    }
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = contois_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        u = contois_clamp(u_taken, 0.0f, 0.5f);
        if (!u_usable) {
            status |= CONTOIS_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 0.5f) {
            status |= CONTOIS_CLAMPED_U;
        }
    }
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
            const float u_before = s->u;
            float k1_z[2];
            contois_flow(z1, z2, u_before, k1_z);
            const float t1 = u_before + 0.5f*(u - u_before);
            float k2_z[2];
            contois_flow(z1 + 0.005f*k1_z[0], z2 + 0.005f*k1_z[1], t1, k2_z);
            const float t2 = z1 + 0.005f*k2_z[0];
            const float t3 = z2 + 0.005f*k2_z[1];
            float k3_z[2];
            contois_flow(t2, t3, t1, k3_z);
            float k4_z[2];
            contois_flow(z1 + 0.01f*k3_z[0], z2 + 0.01f*k3_z[1], u, k4_z);
            float F_1[4];
            contois_jacobian(t2, t3, t1, F_1);
            const float Phi_11 = 1.0f + 0.01f*F_1[0] + 5e-05f*(F_1[0]*F_1[0] + F_1[2]*F_1[1]);
            const float Phi_12 = 0.01f*F_1[2] + 5e-05f*(F_1[0]*F_1[2] + F_1[2]*F_1[3]);
            const float Phi_21 = 0.01f*F_1[1] + 5e-05f*(F_1[1]*F_1[0] + F_1[3]*F_1[1]);
            const float Phi_22 = 1.0f + 0.01f*F_1[3] + 5e-05f*(F_1[1]*F_1[2] + F_1[3]*F_1[3]);
            const float w1_1 = Phi_11 + Phi_12*L21;
            const float t4 = w1_1*D1;
            const float t5 = Phi_12*D2;
            const float theta = p->gain.theta;
            const float t6 = 0.01f*theta;
            const float t7 = t6*p->gain.Q[0];
            const float d1 = w1_1*t4 + Phi_12*t5 + t7;
            const float t8 = Phi_21 + Phi_22*L21;
            const float l21 = (t8*t4 + Phi_22*t5)/d1;
            const float w2_1 = t8 - l21*w1_1;
            const float w2_2 = Phi_22 - l21*Phi_12;
            const float d2 = w2_1*D1*w2_1 + w2_2*D2*w2_2 + l21*t7*l21 + t6*p->gain.Q[1]*theta*theta;
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
            capped = D1 > 54.0225f || L21*L21*D1 + s->D[1] > 12701.493f;
        }
        if (capped) {
            /* cap */
            {
                const float D1 = s->D[0];
                const float D2 = s->D[1];
                const float L21 = s->L;
                const float t1 = contois_min(1.0f, 12701.493f/(L21*L21*D1 + D2));
                const float t2 = contois_min(1.0f, 54.0225f/D1);
                s->L = t1*L21/t2;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                status |= CONTOIS_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const bool t1 = z1 >= -4.8f && z1 <= 9.9f && z2 >= -9.8f && z2 <= 19.9f
                && contois_within(s->L, 1.5333456e+10f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            beyond = !(t1 && D1 >= 5e-19f && D1 <= 54.0225f && D2 >= 1e-15f && D2 <= 12701.493f);
        }
        if (contois_acts(beyond)) {
            status |= contois_keep_in_box(s, p);
        }
    } else {
        status |= contois_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned contois_guard_measurement_y(const contois_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -4.8f && reading <= 9.9f && contois_within(t1, 1e+16f);
        const bool t3 = contois_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= CONTOIS_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= CONTOIS_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned contois_use_sample_y(contois_state *s, const contois_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = p->gain.R/(0.01f*p->gain.theta);
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
        beyond = !(z1 >= -4.8f && z1 <= 9.9f && z2 >= -9.8f && z2 <= 19.9f && D1 >= 5e-19f && D1 <= 54.0225f);
    }
    if (contois_acts(beyond)) {
        status |= contois_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned contois_suspect_y(const contois_state *s, float output_error, bool *suspect, bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 0.1f || z1 > 5.0f || z2 < 0.1f || z2 > 10.0f;
        if (t1) {
            status |= CONTOIS_OUTSIDE_BOX;
        }
        *suspect = contois_abs(output_error) > 0.49f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool contois_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -4.8f && reading <= 9.9f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool contois_counts_spoiled_y(const contois_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 600.0f + contois_abs(fault_count_y)
            + (fault_limit_range - 600.0f + fault_count_range);
        const bool t2 = contois_abs(t1 - s->fault_checksum) < 0.5f
            && contois_within(fault_count_y, 614400.0f) && fault_limit_y >= 600.0f
                && fault_limit_y <= 614400.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 614400.0f
            && fault_limit_range >= 600.0f && fault_limit_range <= 614400.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void contois_find_signs_y(const contois_state *s, float *moves_y, float output_error, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = contois_within(output_error, 0.49f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -300.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned contois_recover_y(contois_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= contois_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t3 = t2 && (fault_limit_range > 600.0f || z1 < -2.35f || z1 > 7.45f || z2 < -4.85f
            || z2 > 14.95f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = contois_min(fault_limit_y, 307200.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = contois_min(2.0f*fault_limit_y, 614400.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = contois_min(fault_limit_range, 307200.0f);
            s->fault_limit_range = contois_min(2.0f*fault_limit_range, 614400.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.1f;
        s->z[1] = 0.1f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = contois_keep(reading, 0.1f, 5.0f, z1, 1e+30f);
            s->z[1] = contois_keep(z2, 0.1f, 10.0f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= CONTOIS_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 6.0f;
        s->D[1] = 20.0f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - contois_clamp(z1, 0.1f, 5.0f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - contois_clamp(t3, 0.1f, 10.0f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 19.9f - z2 : z2 + 9.8f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 9.9f - z1 : z1 + 4.8f;
            const float t9 = contois_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = contois_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = contois_keep(z1 + t12*t7, -4.8f, 9.9f, z1, 1e+30f);
            s->z[1] = contois_keep(z2 + t12*t5, -9.8f, 19.9f, z2, 1e+30f);
            status |= CONTOIS_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned contois_count_faults_y(contois_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = contois_counts_spoiled_y(s);
    if (spoiled) {
        contois_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        moves_range = (z1 < -0.145f || z1 > 5.245f || z2 < -0.395f || z2 > 10.495f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = contois_clamp(fault_count_range + moves_range, 0.0f, 614400.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 600.0f : fault_limit_range;
    }
    contois_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = contois_clamp(contois_abs(fault_count_y) + moves_y, 0.0f, 614400.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 600.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= contois_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= contois_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 600.0f + contois_abs(s->fault_count_y)
        + (s->fault_limit_range - 600.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned contois_run_update_y(contois_state *s, const contois_params *p,
    const contois_output *measurement)
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
        status |= contois_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= contois_use_sample_y(s, p, e);
        }
        status |= contois_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = contois_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= contois_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= CONTOIS_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
CONTOIS_RARELY
static void contois_nominal(contois_params *p)
{
    p->ready = CONTOIS_READY;
    p->gain.Q[0] = 0.0001f;
    p->gain.Q[1] = 0.1f;
    p->gain.R = 1e-08f;
    p->gain.theta = 2.0f;
}

unsigned contois_predict(contois_state *s, const contois_params *p, const contois_input *in)
{
    unsigned status = 0u;
    if ((s->ready != CONTOIS_READY) || (p->ready != CONTOIS_READY)) {
        status = contois_ready(s, p);
    }
    if ((status & CONTOIS_NO_PARAMETERS) == 0u) {
        status |= contois_run_predict(s, p, in);
    }
    return status;
}

unsigned contois_update_y(contois_state *s, const contois_params *p, const contois_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CONTOIS_READY) || (p->ready != CONTOIS_READY)) {
        status = contois_ready(s, p);
    }
    if ((status & CONTOIS_NO_PARAMETERS) == 0u) {
        status |= contois_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned contois_step(contois_state *s, const contois_params *p, const contois_input *in,
    const contois_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CONTOIS_READY) || (p->ready != CONTOIS_READY)) {
        status = contois_ready(s, p);
    }
    if ((status & CONTOIS_NO_PARAMETERS) == 0u) {
        status |= contois_run_predict(s, p, in);
        status |= contois_run_update_y(s, p, measurement);
    }
    return status;
}

void contois_estimate(const contois_state *s, const contois_params *p, contois_plant *x)
{
    (void)p;
    /* the plant's state */
    x->m = s->z[0];
    x->s = s->z[1];
}

unsigned contois_tune(contois_params *p)
{
    unsigned status = 0u;
    if (p->ready != CONTOIS_READY) {
        contois_nominal(p);
        status = CONTOIS_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float R = p->gain.R;
        const float theta = p->gain.theta;
        const bool t1 = !(Q1 >= 1e-10f && Q1 <= 100000.0f) || !(Q2 >= 1e-10f && Q2 <= 100000.0f)
            || !(R >= 1e-14f && R <= 0.01f);
        p->gain.Q[0] = contois_keep(Q1, 1e-10f, 100000.0f, 0.0001f, 3e+38f);
        p->gain.Q[1] = contois_keep(Q2, 1e-10f, 100000.0f, 0.1f, 3e+38f);
        p->gain.R = contois_keep(R, 1e-14f, 0.01f, 1e-08f, 3e+38f);
        p->gain.theta = contois_keep(theta, 1.0f, 2.0f, 2.0f, 3e+38f);
        if (t1 || !(theta >= 1.0f && theta <= 2.0f)) {
            status |= CONTOIS_PARAMETER_LIMITED;
        }
    }
    return status;
}

CONTOIS_RARELY
void contois_reset(contois_state *s)
{
    s->ready = CONTOIS_READY;
    s->z[0] = 0.1f;
    s->z[1] = 0.1f;
    s->L = 0.0f;
    s->D[0] = 6.0f;
    s->D[1] = 20.0f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    contois_clear_fault_counts(s);
}

void contois_init(contois_state *s, contois_params *p)
{
    contois_nominal(p);
    (void)contois_tune(p);
    contois_reset(s);
}

static const unsigned char contois_layout[8] = {0x45u, 0x5Du, 0x2Fu, 0x06u, 0x13u, 0x6Du, 0x81u, 0x37u};

/* CRC-32 of IEEE 802.3 */
static uint32_t contois_checksum(const unsigned char *bytes, size_t size)
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

void contois_save(const contois_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = contois_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = contois_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned contois_restore(contois_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == CONTOIS_SAVED) {
        refused = 0u;
        uint32_t sum = contois_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == contois_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = CONTOIS_READY;
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
