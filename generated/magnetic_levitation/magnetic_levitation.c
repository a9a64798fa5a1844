/* magnetic_levitation: see magnetic_levitation.h, and its manual magnetic_levitation.md. */
#include "magnetic_levitation.h"

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
#define MAGNETIC_LEVITATION_RARELY __attribute__((noinline))
#else
#define MAGNETIC_LEVITATION_RARELY
#endif

static float magnetic_levitation_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float magnetic_levitation_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool magnetic_levitation_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float magnetic_levitation_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool magnetic_levitation_within(float v, float limit)
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
static float magnetic_levitation_limit(float v, float most)
{
    return magnetic_levitation_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float magnetic_levitation_keep(float v, float low, float high, float otherwise, float limit)
{
    return magnetic_levitation_within(v, limit) ? magnetic_levitation_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void magnetic_levitation_flow(float z1, float z2, float z3, float u, float dz[3])
{
    const float t1 = magnetic_levitation_clamp(z3, 0.1f, 3.0f);
    const float t2 = magnetic_levitation_clamp(z1, 0.005f, 0.03f);
    dz[0] = z2;
    dz[1] = 9.81f - t1*t1/(t2*t2)*0.001f;
    dz[2] = u - 20.0f*z3;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void magnetic_levitation_jacobian(float z1, float z3, float F[2])
{
    const float t1 = magnetic_levitation_clamp(z3, 0.1f, 3.0f);
    const float t2 = magnetic_levitation_clamp(z1, 0.005f, 0.03f);
    const float t3 = t2*t2;
    F[0] = t1*t1/t3/t3*(2.0f*t2)*0.001f; /* F_21 */
    F[1] = -(2.0f*t1/t3*0.001f); /* F_23 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
MAGNETIC_LEVITATION_RARELY
static unsigned magnetic_levitation_ready(magnetic_levitation_state *s, const magnetic_levitation_params *p)
{
    unsigned status = 0u;
    if (s->ready != MAGNETIC_LEVITATION_READY) {
        magnetic_levitation_reset(s);
        status |= MAGNETIC_LEVITATION_UNINITIALISED;
    }
    if (p->ready != MAGNETIC_LEVITATION_READY) {
        magnetic_levitation_reset(s);
        status |= MAGNETIC_LEVITATION_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
MAGNETIC_LEVITATION_RARELY
static void magnetic_levitation_clear_fault_counts(magnetic_levitation_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 1571.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 1571.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
MAGNETIC_LEVITATION_RARELY
static void magnetic_levitation_clear_rest(magnetic_levitation_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->D[0] = 0.0002f;
    s->D[1] = 1.0f;
    s->D[2] = 2.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned magnetic_levitation_keep_in_box(magnetic_levitation_state *s,
    const magnetic_levitation_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = magnetic_levitation_within(s->z[0], 1e+30f)
            && magnetic_levitation_within(s->z[1], 1e+30f) && magnetic_levitation_within(s->z[2], 1e+30f);
        const bool t2 = t1 && magnetic_levitation_within(s->L[0], 1e+30f)
            && magnetic_levitation_within(s->L[1], 1e+30f);
        const bool t3 = t2 && magnetic_levitation_within(s->L[2], 1e+30f)
            && magnetic_levitation_within(s->D[0], 1e+30f);
        const bool t4 = t3 && magnetic_levitation_within(s->D[1], 1e+30f)
            && magnetic_levitation_within(s->D[2], 1e+30f);
        lost = !t4;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.005f;
        s->z[1] = 0.0f;
        s->z[2] = 0.1f;
        status |= MAGNETIC_LEVITATION_RESTARTED;
        magnetic_levitation_clear_fault_counts(s);
        magnetic_levitation_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = magnetic_levitation_clamp(z1, -0.02f, 0.055f);
        s->z[1] = magnetic_levitation_limit(z2, 3.0f);
        s->z[2] = magnetic_levitation_clamp(z3, -2.8f, 5.9f);
        if (z1 < -0.02f || z1 > 0.055f || magnetic_levitation_abs(z2) > 3.0f || z3 < -2.8f || z3 > 5.9f) {
            status |= MAGNETIC_LEVITATION_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        s->L[0] = magnetic_levitation_limit(L21, 8e+10f);
        s->L[1] = magnetic_levitation_limit(L31, 1.16e+11f);
        s->L[2] = magnetic_levitation_limit(L32, 1.45e+09f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        s->D[0] = magnetic_levitation_clamp(D1, 1e-24f, 0.00140625f);
        s->D[1] = magnetic_levitation_clamp(D2, 1.5e-17f, 9.0f);
        s->D[2] = magnetic_levitation_clamp(D3, 3.5e-17f, 18.9225f);
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned magnetic_levitation_guard_input(const magnetic_levitation_state *s,
    const magnetic_levitation_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = magnetic_levitation_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = magnetic_levitation_clamp(u_taken, 0.0f, 100.0f);
        if (!u_usable) {
            status |= MAGNETIC_LEVITATION_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 100.0f) {
            status |= MAGNETIC_LEVITATION_CLAMPED_U;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned magnetic_levitation_advance(magnetic_levitation_state *s,
    const magnetic_levitation_params *p, float u)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
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
        const float D3 = s->D[2];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float u_before = s->u;
        float k1_z[3];
        magnetic_levitation_flow(z1, z2, z3, u_before, k1_z);
        const float t1 = u_before + 0.5f*(u - u_before);
        float k2_z[3];
        magnetic_levitation_flow(z1 + 2.5e-05f*k1_z[0], z2 + 2.5e-05f*k1_z[1], z3 + 2.5e-05f*k1_z[2], t1,
            k2_z);
        const float t2 = z1 + 2.5e-05f*k2_z[0];
        const float t3 = z3 + 2.5e-05f*k2_z[2];
        float k3_z[3];
        magnetic_levitation_flow(t2, z2 + 2.5e-05f*k2_z[1], t3, t1, k3_z);
        float k4_z[3];
        magnetic_levitation_flow(z1 + 5e-05f*k3_z[0], z2 + 5e-05f*k3_z[1], z3 + 5e-05f*k3_z[2], u, k4_z);
        float F_1[2];
        magnetic_levitation_jacobian(t2, t3, F_1);
        const float Phi_11 = 1.0f + 1.25e-09f*F_1[0];
        const float Phi_13 = 1.25e-09f*F_1[1];
        const float Phi_21 = 5e-05f*F_1[0];
        const float Phi_23 = 5e-05f*F_1[1] - 2.5e-08f*F_1[1];
        const float w1_1 = Phi_11 + 5e-05f*L21 + Phi_13*L31;
        const float w1_2 = 5e-05f + Phi_13*L32;
        const float t4 = w1_1*D1;
        const float t5 = w1_2*D2;
        const float t6 = Phi_13*D3;
        const float t7 = 5e-05f*p->gain.Q[0];
        const float d1 = w1_1*t4 + w1_2*t5 + Phi_13*t6 + t7;
        const float t8 = Phi_21 + Phi_11*L21 + Phi_23*L31;
        const float t9 = Phi_11 + Phi_23*L32;
        const float l21 = (t8*t4 + t9*t5 + Phi_23*t6)/d1;
        const float t10 = 0.9990005f*L31;
        const float t11 = 0.9990005f*L32;
        const float l31 = (t10*t4 + t11*t5 + 0.9990005f*t6)/d1;
        const float w2_1 = t8 - l21*w1_1;
        const float w2_2 = t9 - l21*w1_2;
        const float w2_3 = Phi_23 - l21*Phi_13;
        const float t12 = w2_1*D1;
        const float t13 = w2_2*D2;
        const float t14 = w2_3*D3;
        const float t15 = l21*t7;
        const float t16 = 5e-05f*p->gain.Q[1];
        const float d2 = w2_1*t12 + w2_2*t13 + w2_3*t14 + l21*t15 + t16;
        const float t17 = t10 - l31*w1_1;
        const float t18 = t11 - l31*w1_2;
        const float t19 = 0.9990005f - l31*Phi_13;
        const float l32 = (t17*t12 + t18*t13 + t19*t14 + l31*t15)/d2;
        const float w3_1 = t17 - l32*w2_1;
        const float w3_2 = t18 - l32*w2_2;
        const float w3_3 = t19 - l32*w2_3;
        const float w3_4 = l32*l21 - l31;
        const float d3 = w3_1*D1*w3_1 + w3_2*D2*w3_2 + w3_3*D3*w3_3 + w3_4*t7*w3_4 + l32*t16*l32
            + 5e-05f*p->gain.Q[2];
        s->z[0] = z1 + 8.333333e-06f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 8.333333e-06f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
        s->z[2] = z3 + 8.333333e-06f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
        s->L[0] = l21;
        s->L[1] = l31;
        s->L[2] = l32;
        s->D[0] = d1;
        s->D[1] = d2;
        s->D[2] = d3;
    }
    /* largest variances */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float D2 = s->D[1];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        capped = D1 > 0.00140625f || L21*L21*D1 + D2 > 9.0f || L31*L31*D1 + L32*L32*D2 + s->D[2] > 18.9225f;
    }
    if (capped) {
        /* cap */
        {
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float D3 = s->D[2];
            const float L21 = s->L[0];
            const float L31 = s->L[1];
            const float L32 = s->L[2];
            const float t1 = magnetic_levitation_min(1.0f, 9.0f/(L21*L21*D1 + D2));
            const float t2 = magnetic_levitation_min(1.0f, 0.00140625f/D1);
            const float t3 = magnetic_levitation_min(1.0f, 18.9225f/(L31*L31*D1 + L32*L32*D2 + D3));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t3*L32/t1;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            status |= MAGNETIC_LEVITATION_COVARIANCE_LIMITED;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t1 = z1 >= -0.02f && z1 <= 0.055f && magnetic_levitation_within(s->z[1], 3.0f)
            && z3 >= -2.8f && z3 <= 5.9f;
        const bool t2 = t1 && magnetic_levitation_within(s->L[0], 8e+10f)
            && magnetic_levitation_within(s->L[1], 1.16e+11f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && magnetic_levitation_within(s->L[2], 1.45e+09f) && D1 >= 1e-24f
            && D1 <= 0.00140625f && D2 >= 1.5e-17f && D2 <= 9.0f;
        const float D3 = s->D[2];
        beyond = !(t3 && D3 >= 3.5e-17f && D3 <= 18.9225f);
    }
    if (magnetic_levitation_acts(beyond)) {
        status |= magnetic_levitation_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned magnetic_levitation_run_predict(magnetic_levitation_state *s,
    const magnetic_levitation_params *p, const magnetic_levitation_input *in)
{
    unsigned status = 0u;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = magnetic_levitation_clamp(u_before, 0.0f, 100.0f);
    }
    status |= magnetic_levitation_guard_input(s, in, &u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= magnetic_levitation_advance(s, p, u);
    } else {
        status |= magnetic_levitation_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned magnetic_levitation_guard_measurement_y(const magnetic_levitation_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -0.02f && reading <= 0.055f && magnetic_levitation_within(t1, 1e+16f);
        const bool t3 = magnetic_levitation_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= MAGNETIC_LEVITATION_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= MAGNETIC_LEVITATION_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned magnetic_levitation_use_sample_y(magnetic_levitation_state *s,
    const magnetic_levitation_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float t1 = p->gain.R/5e-05f;
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->D[0] = K1*t1;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t1 = z1 >= -0.02f && z1 <= 0.055f && magnetic_levitation_within(s->z[1], 3.0f)
            && z3 >= -2.8f && z3 <= 5.9f;
        const float D1 = s->D[0];
        beyond = !(t1 && D1 >= 1e-24f && D1 <= 0.00140625f);
    }
    if (magnetic_levitation_acts(beyond)) {
        status |= magnetic_levitation_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned magnetic_levitation_suspect_y(const magnetic_levitation_state *s, float output_error,
    bool *suspect, bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t1 = z1 < 0.005f || z1 > 0.03f || magnetic_levitation_abs(s->z[1]) > 1.0f || z3 < 0.1f
            || z3 > 3.0f;
        if (t1) {
            status |= MAGNETIC_LEVITATION_OUTSIDE_BOX;
        }
        *suspect = magnetic_levitation_abs(output_error) > 0.0025f || t1 || !(s->fault_checksum <= 0.0f)
            || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool magnetic_levitation_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -0.02f && reading <= 0.055f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool magnetic_levitation_counts_spoiled_y(const magnetic_levitation_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 1571.0f + magnetic_levitation_abs(fault_count_y)
            + (fault_limit_range - 1571.0f + fault_count_range);
        const bool t2 = magnetic_levitation_abs(t1 - s->fault_checksum) < 0.5f
            && magnetic_levitation_within(fault_count_y, 1608704.0f);
        const bool t3 = t2 && fault_limit_y >= 1571.0f && fault_limit_y <= 1608704.0f
            && fault_count_range >= 0.0f && fault_count_range <= 1608704.0f;
        spoiled = !(t3 && fault_limit_range >= 1571.0f && fault_limit_range <= 1608704.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void magnetic_levitation_find_signs_y(const magnetic_levitation_state *s, float *moves_y,
    float output_error, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = magnetic_levitation_within(output_error, 0.0025f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -785.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned magnetic_levitation_recover_y(magnetic_levitation_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= magnetic_levitation_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t3 = z1 < -0.0075f || z1 > 0.0425f || magnetic_levitation_abs(s->z[1]) > 2.0f
            || z3 < -1.35f || z3 > 4.45f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 1571.0f || t3));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = magnetic_levitation_min(fault_limit_y, 804352.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = magnetic_levitation_min(2.0f*fault_limit_y, 1608704.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = magnetic_levitation_min(fault_limit_range, 804352.0f);
            s->fault_limit_range = magnetic_levitation_min(2.0f*fault_limit_range, 1608704.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.005f;
        s->z[1] = 0.0f;
        s->z[2] = 0.1f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = magnetic_levitation_keep(reading, 0.005f, 0.03f, z1, 1e+30f);
            s->z[1] = magnetic_levitation_keep(z2, -1.0f, 1.0f, z2, 1e+30f);
            s->z[2] = magnetic_levitation_keep(z3, 0.1f, 3.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= MAGNETIC_LEVITATION_RESTARTED_FROM_SAMPLE;
        magnetic_levitation_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float L31 = s->L[1];
            const float D1 = s->D[0];
            const float t1 = L31*D1;
            const float t2 = z1 - magnetic_levitation_clamp(z1, 0.005f, 0.03f);
            const float t3 = t2/D1;
            const float L21 = s->L[0];
            const float L32 = s->L[2];
            const float D2 = s->D[1];
            const float t4 = L32*D2;
            const float t5 = L21*D1;
            const float t6 = z2 - t5*t3;
            const float t7 = t6 - magnetic_levitation_limit(t6, 1.0f);
            const float t8 = t7/(t5*L21 + D2);
            const float t9 = z3 - t1*t3 - (t1*L21 + t4)*t8;
            const float t10 = t9 - magnetic_levitation_clamp(t9, 0.1f, 3.0f);
            const float t11 = t9 - t10 - z3;
            const float t12 = (t11 > 0.0f) ? 5.9f - z3 : z3 + 2.8f;
            const float t13 = t10/(t1*L31 + t4*L32 + s->D[2]);
            const float t14 = t6 - t7 - (t5*L31 + D2*L32)*t13 - z2;
            const float t15 = (t14 > 0.0f) ? 3.0f - z2 : z2 + 3.0f;
            const float t16 = z1 - t2 - D1*L21*t8 - D1*L31*t13 - z1;
            const float t17 = (t16 > 0.0f) ? 0.055f - z1 : z1 + 0.02f;
            const float t18 = magnetic_levitation_abs(t16);
            const float t19 = (t17 < t18) ? t17/t18 : 1.0f;
            const float t20 = magnetic_levitation_abs(t14);
            const float t21 = (t15 < t19*t20) ? t15/t20 : t19;
            const float t22 = magnetic_levitation_abs(t11);
            const float t23 = (t12 < t21*t22) ? t12/t22 : t21;
            s->z[0] = magnetic_levitation_keep(z1 + t23*t16, -0.02f, 0.055f, z1, 1e+30f);
            s->z[1] = magnetic_levitation_keep(z2 + t23*t14, -3.0f, 3.0f, z2, 1e+30f);
            s->z[2] = magnetic_levitation_keep(z3 + t23*t11, -2.8f, 5.9f, z3, 1e+30f);
            status |= MAGNETIC_LEVITATION_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned magnetic_levitation_count_faults_y(magnetic_levitation_state *s, float output_error,
    float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = magnetic_levitation_counts_spoiled_y(s);
    if (spoiled) {
        magnetic_levitation_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t1 = z1 < 0.00375f || z1 > 0.03125f || magnetic_levitation_abs(s->z[1]) > 1.1f
            || z3 < -0.045f || z3 > 3.145f;
        moves_range = t1 ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = magnetic_levitation_clamp(fault_count_range + moves_range, 0.0f, 1608704.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 1571.0f : fault_limit_range;
    }
    magnetic_levitation_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = magnetic_levitation_clamp(magnetic_levitation_abs(fault_count_y) + moves_y, 0.0f,
            1608704.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 1571.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= magnetic_levitation_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= magnetic_levitation_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 1571.0f + magnetic_levitation_abs(s->fault_count_y)
        + (s->fault_limit_range - 1571.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned magnetic_levitation_run_update_y(magnetic_levitation_state *s,
    const magnetic_levitation_params *p, const magnetic_levitation_output *measurement)
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
        status |= magnetic_levitation_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= magnetic_levitation_use_sample_y(s, p, e);
        }
        status |= magnetic_levitation_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = magnetic_levitation_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= magnetic_levitation_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= MAGNETIC_LEVITATION_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
MAGNETIC_LEVITATION_RARELY
static void magnetic_levitation_nominal(magnetic_levitation_params *p)
{
    p->ready = MAGNETIC_LEVITATION_READY;
    p->gain.Q[0] = 5e-05f;
    p->gain.Q[1] = 0.3f;
    p->gain.Q[2] = 0.7f;
    p->gain.R = 5e-17f;
}

unsigned magnetic_levitation_predict(magnetic_levitation_state *s, const magnetic_levitation_params *p,
    const magnetic_levitation_input *in)
{
    unsigned status = 0u;
    if ((s->ready != MAGNETIC_LEVITATION_READY) || (p->ready != MAGNETIC_LEVITATION_READY)) {
        status = magnetic_levitation_ready(s, p);
    }
    if ((status & MAGNETIC_LEVITATION_NO_PARAMETERS) == 0u) {
        status |= magnetic_levitation_run_predict(s, p, in);
    }
    return status;
}

unsigned magnetic_levitation_update_y(magnetic_levitation_state *s, const magnetic_levitation_params *p,
    const magnetic_levitation_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != MAGNETIC_LEVITATION_READY) || (p->ready != MAGNETIC_LEVITATION_READY)) {
        status = magnetic_levitation_ready(s, p);
    }
    if ((status & MAGNETIC_LEVITATION_NO_PARAMETERS) == 0u) {
        status |= magnetic_levitation_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned magnetic_levitation_step(magnetic_levitation_state *s, const magnetic_levitation_params *p,
    const magnetic_levitation_input *in, const magnetic_levitation_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != MAGNETIC_LEVITATION_READY) || (p->ready != MAGNETIC_LEVITATION_READY)) {
        status = magnetic_levitation_ready(s, p);
    }
    if ((status & MAGNETIC_LEVITATION_NO_PARAMETERS) == 0u) {
        status |= magnetic_levitation_run_predict(s, p, in);
        status |= magnetic_levitation_run_update_y(s, p, measurement);
    }
    return status;
}

void magnetic_levitation_estimate(const magnetic_levitation_state *s, const magnetic_levitation_params *p,
    magnetic_levitation_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->v = s->z[1];
    x->i = s->z[2];
}

unsigned magnetic_levitation_tune(magnetic_levitation_params *p)
{
    unsigned status = 0u;
    if (p->ready != MAGNETIC_LEVITATION_READY) {
        magnetic_levitation_nominal(p);
        status = MAGNETIC_LEVITATION_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float Q3 = p->gain.Q[2];
        const float R = p->gain.R;
        const bool t1 = !(Q1 >= 5e-11f && Q1 <= 700000.0f) || !(Q2 >= 5e-11f && Q2 <= 700000.0f)
            || !(Q3 >= 5e-11f && Q3 <= 700000.0f);
        p->gain.Q[0] = magnetic_levitation_keep(Q1, 5e-11f, 700000.0f, 5e-05f, 3e+38f);
        p->gain.Q[1] = magnetic_levitation_keep(Q2, 5e-11f, 700000.0f, 0.3f, 3e+38f);
        p->gain.Q[2] = magnetic_levitation_keep(Q3, 5e-11f, 700000.0f, 0.7f, 3e+38f);
        p->gain.R = magnetic_levitation_keep(R, 5e-23f, 5e-11f, 5e-17f, 3e+38f);
        if (t1 || !(R >= 5e-23f && R <= 5e-11f)) {
            status |= MAGNETIC_LEVITATION_PARAMETER_LIMITED;
        }
    }
    return status;
}

MAGNETIC_LEVITATION_RARELY
void magnetic_levitation_reset(magnetic_levitation_state *s)
{
    s->ready = MAGNETIC_LEVITATION_READY;
    s->z[0] = 0.005f;
    s->z[1] = 0.0f;
    s->z[2] = 0.1f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    magnetic_levitation_clear_fault_counts(s);
    magnetic_levitation_clear_rest(s);
}

void magnetic_levitation_init(magnetic_levitation_state *s, magnetic_levitation_params *p)
{
    magnetic_levitation_nominal(p);
    (void)magnetic_levitation_tune(p);
    magnetic_levitation_reset(s);
}

static const unsigned char magnetic_levitation_layout[8] = {
    0x2Bu, 0x10u, 0x56u, 0x02u, 0xCAu, 0x45u, 0xF6u, 0x2Cu
};

/* CRC-32 of IEEE 802.3 */
static uint32_t magnetic_levitation_checksum(const unsigned char *bytes, size_t size)
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

void magnetic_levitation_save(const magnetic_levitation_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = magnetic_levitation_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = magnetic_levitation_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned magnetic_levitation_restore(magnetic_levitation_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == MAGNETIC_LEVITATION_SAVED) {
        refused = 0u;
        uint32_t sum = magnetic_levitation_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == magnetic_levitation_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = MAGNETIC_LEVITATION_READY;
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
