/* lorenz: see lorenz.h, and its manual lorenz.md. */
#include "lorenz.h"

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
#define LORENZ_RARELY __attribute__((noinline))
#else
#define LORENZ_RARELY
#endif

static float lorenz_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float lorenz_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool lorenz_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float lorenz_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool lorenz_within(float v, float limit)
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
static float lorenz_limit(float v, float most)
{
    return lorenz_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float lorenz_keep(float v, float low, float high, float otherwise, float limit)
{
    return lorenz_within(v, limit) ? lorenz_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void lorenz_flow(float z1, float z2, float z3, float dz[3])
{
    const float t1 = lorenz_limit(z1, 20.0f);
    const float t2 = lorenz_limit(z2, 30.0f);
    dz[0] = 10.0f*z2 - 10.0f*t1;
    dz[1] = 28.0f*t1 - t2 - t1*z3;
    dz[2] = t1*t2 - 2.6666667f*lorenz_clamp(z3, 0.0f, 50.0f);
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void lorenz_jacobian(float z1, float z2, float z3, float F[4])
{
    const float t1 = lorenz_limit(z1, 20.0f);
    F[0] = 28.0f - lorenz_clamp(z3, 0.0f, 50.0f); /* F_21 */
    F[1] = lorenz_limit(z2, 30.0f); /* F_31 */
    F[2] = t1; /* F_32 */
    F[3] = -t1; /* F_23 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
LORENZ_RARELY
static unsigned lorenz_ready(lorenz_state *s, const lorenz_params *p)
{
    unsigned status = 0u;
    if (s->ready != LORENZ_READY) {
        lorenz_reset(s);
        status |= LORENZ_UNINITIALISED;
    }
    if (p->ready != LORENZ_READY) {
        lorenz_reset(s);
        status |= LORENZ_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
LORENZ_RARELY
static void lorenz_clear_fault_counts(lorenz_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 178.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 178.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
LORENZ_RARELY
static void lorenz_clear_rest(lorenz_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->D[0] = 400.0f;
    s->D[1] = 900.0f;
    s->D[2] = 600.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned lorenz_keep_in_box(lorenz_state *s, const lorenz_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = lorenz_within(s->z[0], 1e+30f) && lorenz_within(s->z[1], 1e+30f)
            && lorenz_within(s->z[2], 1e+30f);
        const bool t2 = t1 && lorenz_within(s->L[0], 1e+30f) && lorenz_within(s->L[1], 1e+30f)
            && lorenz_within(s->L[2], 1e+30f);
        const bool t3 = t2 && lorenz_within(s->D[0], 1e+30f) && lorenz_within(s->D[1], 1e+30f)
            && lorenz_within(s->D[2], 1e+30f);
        lost = !t3;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= LORENZ_RESTARTED;
        lorenz_clear_fault_counts(s);
        lorenz_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = lorenz_limit(z1, 60.0f);
        s->z[1] = lorenz_limit(z2, 90.0f);
        s->z[2] = lorenz_clamp(z3, -50.0f, 100.0f);
        if (lorenz_abs(z1) > 60.0f || lorenz_abs(z2) > 90.0f || z3 < -50.0f || z3 > 100.0f) {
            status |= LORENZ_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        s->L[0] = lorenz_limit(L21, 1.5e+09f);
        s->L[1] = lorenz_limit(L31, 1.25e+09f);
        s->L[2] = lorenz_limit(L32, 8.333333e+08f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        s->D[0] = lorenz_clamp(D1, 1e-16f, 3600.0f);
        s->D[1] = lorenz_clamp(D2, 2e-15f, 8100.0f);
        s->D[2] = lorenz_clamp(D3, 1e-15f, 5625.0f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned lorenz_run_predict(lorenz_state *s, const lorenz_params *p)
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
            const float D3 = s->D[2];
            const float L21 = s->L[0];
            const float L31 = s->L[1];
            const float L32 = s->L[2];
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            float k1_z[3];
            lorenz_flow(z1, z2, z3, k1_z);
            float k2_z[3];
            lorenz_flow(z1 + 0.0005f*k1_z[0], z2 + 0.0005f*k1_z[1], z3 + 0.0005f*k1_z[2], k2_z);
            const float t1 = z1 + 0.0005f*k2_z[0];
            const float t2 = z2 + 0.0005f*k2_z[1];
            const float t3 = z3 + 0.0005f*k2_z[2];
            float k3_z[3];
            lorenz_flow(t1, t2, t3, k3_z);
            float k4_z[3];
            lorenz_flow(z1 + 0.001f*k3_z[0], z2 + 0.001f*k3_z[1], z3 + 0.001f*k3_z[2], k4_z);
            float F_1[4];
            lorenz_jacobian(t1, t2, t3, F_1);
            const float t4 = 10.0f*F_1[0];
            const float Phi_11 = 0.99f + 5e-07f*(100.0f + t4);
            const float Phi_13 = 5e-06f*F_1[3];
            const float Phi_21 = 0.001f*F_1[0] + 5e-07f*(-10.0f*F_1[0] - F_1[0] + F_1[3]*F_1[1]);
            const float Phi_22 = 0.999f + 5e-07f*(t4 + 1.0f + F_1[3]*F_1[2]);
            const float Phi_23 = 0.001f*F_1[3] + 5e-07f*(-2.6666667f*F_1[3] - F_1[3]);
            const float Phi_31 = 0.001f*F_1[1] + 5e-07f*(F_1[2]*F_1[0] - 10.0f*F_1[1] - 2.6666667f*F_1[1]);
            const float Phi_32 = 0.001f*F_1[2] + 5e-07f*(10.0f*F_1[1] - F_1[2] - 2.6666667f*F_1[2]);
            const float Phi_33 = 0.99733335f + 5e-07f*(F_1[2]*F_1[3] + 7.111111f);
            const float w1_1 = Phi_11 + 0.009945f*L21 + Phi_13*L31;
            const float w1_2 = 0.009945f + Phi_13*L32;
            const float t5 = w1_1*D1;
            const float t6 = w1_2*D2;
            const float t7 = Phi_13*D3;
            const float t8 = 0.001f*p->gain.Q[0];
            const float d1 = w1_1*t5 + w1_2*t6 + Phi_13*t7 + t8;
            const float t9 = Phi_21 + Phi_22*L21 + Phi_23*L31;
            const float t10 = Phi_22 + Phi_23*L32;
            const float l21 = (t9*t5 + t10*t6 + Phi_23*t7)/d1;
            const float t11 = Phi_31 + Phi_32*L21 + Phi_33*L31;
            const float t12 = Phi_32 + Phi_33*L32;
            const float l31 = (t11*t5 + t12*t6 + Phi_33*t7)/d1;
            const float w2_1 = t9 - l21*w1_1;
            const float w2_2 = t10 - l21*w1_2;
            const float w2_3 = Phi_23 - l21*Phi_13;
            const float t13 = w2_1*D1;
            const float t14 = w2_2*D2;
            const float t15 = w2_3*D3;
            const float t16 = l21*t8;
            const float t17 = 0.001f*p->gain.Q[1];
            const float d2 = w2_1*t13 + w2_2*t14 + w2_3*t15 + l21*t16 + t17;
            const float t18 = t11 - l31*w1_1;
            const float t19 = t12 - l31*w1_2;
            const float t20 = Phi_33 - l31*Phi_13;
            const float l32 = (t18*t13 + t19*t14 + t20*t15 + l31*t16)/d2;
            const float w3_1 = t18 - l32*w2_1;
            const float w3_2 = t19 - l32*w2_2;
            const float w3_3 = t20 - l32*w2_3;
            const float w3_4 = l32*l21 - l31;
            const float d3 = w3_1*D1*w3_1 + w3_2*D2*w3_2 + w3_3*D3*w3_3 + w3_4*t8*w3_4 + l32*t17*l32
                + 0.001f*p->gain.Q[2];
            s->z[0] = z1 + 0.00016666666f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
            s->z[1] = z2 + 0.00016666666f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
            s->z[2] = z3 + 0.00016666666f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
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
            capped = D1 > 3600.0f || L21*L21*D1 + D2 > 8100.0f || L31*L31*D1 + L32*L32*D2 + s->D[2] > 5625.0f;
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
                const float t1 = lorenz_min(1.0f, 8100.0f/(L21*L21*D1 + D2));
                const float t2 = lorenz_min(1.0f, 3600.0f/D1);
                const float t3 = lorenz_min(1.0f, 5625.0f/(L31*L31*D1 + L32*L32*D2 + D3));
                s->L[0] = t1*L21/t2;
                s->L[1] = t3*L31/t2;
                s->L[2] = t3*L32/t1;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                s->D[2] = t3*t3*D3;
                status |= LORENZ_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z3 = s->z[2];
            const bool t1 = lorenz_within(s->z[0], 60.0f) && lorenz_within(s->z[1], 90.0f) && z3 >= -50.0f
                && z3 <= 100.0f;
            const bool t2 = t1 && lorenz_within(s->L[0], 1.5e+09f) && lorenz_within(s->L[1], 1.25e+09f)
                && lorenz_within(s->L[2], 8.333333e+08f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float D3 = s->D[2];
            const bool t3 = t2 && D1 >= 1e-16f && D1 <= 3600.0f && D2 >= 2e-15f && D2 <= 8100.0f
                && D3 >= 1e-15f && D3 <= 5625.0f;
            beyond = !t3;
        }
        if (lorenz_acts(beyond)) {
            status |= lorenz_keep_in_box(s, p);
        }
    } else {
        status |= lorenz_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned lorenz_guard_measurement_y(const lorenz_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = lorenz_within(reading, 60.0f) && lorenz_within(t1, 1e+16f);
        const bool t3 = lorenz_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= LORENZ_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= LORENZ_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned lorenz_use_sample_y(lorenz_state *s, const lorenz_params *p, float e)
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
        const float t1 = p->gain.R/0.001f;
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
        const float z3 = s->z[2];
        const bool t1 = lorenz_within(s->z[0], 60.0f) && lorenz_within(s->z[1], 90.0f) && z3 >= -50.0f
            && z3 <= 100.0f;
        const float D1 = s->D[0];
        beyond = !(t1 && D1 >= 1e-16f && D1 <= 3600.0f);
    }
    if (lorenz_acts(beyond)) {
        status |= lorenz_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned lorenz_suspect_y(const lorenz_state *s, float output_error, bool *suspect, bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z3 = s->z[2];
        const bool t1 = lorenz_abs(s->z[0]) > 20.0f || lorenz_abs(s->z[1]) > 30.0f || z3 < 0.0f || z3 > 50.0f;
        if (t1) {
            status |= LORENZ_OUTSIDE_BOX;
        }
        *suspect = lorenz_abs(output_error) > 4.0f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool lorenz_counts_spoiled_y(const lorenz_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 178.0f + lorenz_abs(fault_count_y)
            + (fault_limit_range - 178.0f + fault_count_range);
        const bool t2 = lorenz_abs(t1 - s->fault_checksum) < 0.5f && lorenz_within(fault_count_y, 182272.0f)
            && fault_limit_y >= 178.0f && fault_limit_y <= 182272.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 182272.0f
            && fault_limit_range >= 178.0f && fault_limit_range <= 182272.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void lorenz_find_signs_y(const lorenz_state *s, float *moves_y, float output_error, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = lorenz_within(output_error, 4.0f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -89.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned lorenz_recover_y(lorenz_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= lorenz_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z3 = s->z[2];
        const bool t3 = fault_limit_range > 178.0f || lorenz_abs(s->z[0]) > 40.0f
            || lorenz_abs(s->z[1]) > 60.0f || z3 < -25.0f || z3 > 75.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = lorenz_min(fault_limit_y, 91136.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = lorenz_min(2.0f*fault_limit_y, 182272.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = lorenz_min(fault_limit_range, 91136.0f);
            s->fault_limit_range = lorenz_min(2.0f*fault_limit_range, 182272.0f);
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
            s->z[0] = lorenz_keep(reading, -20.0f, 20.0f, z1, 1e+30f);
            s->z[1] = lorenz_keep(z2, -30.0f, 30.0f, z2, 1e+30f);
            s->z[2] = lorenz_keep(z3, 0.0f, 50.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= LORENZ_RESTARTED_FROM_SAMPLE;
        lorenz_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float L31 = s->L[1];
            const float D1 = s->D[0];
            const float t1 = L31*D1;
            const float t2 = z1 - lorenz_limit(z1, 20.0f);
            const float t3 = t2/D1;
            const float L21 = s->L[0];
            const float L32 = s->L[2];
            const float D2 = s->D[1];
            const float t4 = L32*D2;
            const float t5 = L21*D1;
            const float t6 = z2 - t5*t3;
            const float t7 = t6 - lorenz_limit(t6, 30.0f);
            const float t8 = t7/(t5*L21 + D2);
            const float t9 = z3 - t1*t3 - (t1*L21 + t4)*t8;
            const float t10 = t9 - lorenz_clamp(t9, 0.0f, 50.0f);
            const float t11 = t9 - t10 - z3;
            const float t12 = (t11 > 0.0f) ? 100.0f - z3 : z3 + 50.0f;
            const float t13 = t10/(t1*L31 + t4*L32 + s->D[2]);
            const float t14 = t6 - t7 - (t5*L31 + D2*L32)*t13 - z2;
            const float t15 = (t14 > 0.0f) ? 90.0f - z2 : z2 + 90.0f;
            const float t16 = z1 - t2 - D1*L21*t8 - D1*L31*t13 - z1;
            const float t17 = (t16 > 0.0f) ? 60.0f - z1 : z1 + 60.0f;
            const float t18 = lorenz_abs(t16);
            const float t19 = (t17 < t18) ? t17/t18 : 1.0f;
            const float t20 = lorenz_abs(t14);
            const float t21 = (t15 < t19*t20) ? t15/t20 : t19;
            const float t22 = lorenz_abs(t11);
            const float t23 = (t12 < t21*t22) ? t12/t22 : t21;
            s->z[0] = lorenz_keep(z1 + t23*t16, -60.0f, 60.0f, z1, 1e+30f);
            s->z[1] = lorenz_keep(z2 + t23*t14, -90.0f, 90.0f, z2, 1e+30f);
            s->z[2] = lorenz_keep(z3 + t23*t11, -50.0f, 100.0f, z3, 1e+30f);
            status |= LORENZ_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned lorenz_count_faults_y(lorenz_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = lorenz_counts_spoiled_y(s);
    if (spoiled) {
        lorenz_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z3 = s->z[2];
        moves_range = (lorenz_abs(s->z[0]) > 22.0f || lorenz_abs(s->z[1]) > 33.0f || z3 < -2.5f
            || z3 > 52.5f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = lorenz_clamp(fault_count_range + moves_range, 0.0f, 182272.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 178.0f : fault_limit_range;
    }
    lorenz_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = lorenz_clamp(lorenz_abs(fault_count_y) + moves_y, 0.0f, 182272.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 178.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= lorenz_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= lorenz_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 178.0f + lorenz_abs(s->fault_count_y)
        + (s->fault_limit_range - 178.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned lorenz_run_update_y(lorenz_state *s, const lorenz_params *p, const lorenz_output *measurement)
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
        status |= lorenz_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= lorenz_use_sample_y(s, p, e);
        }
        status |= lorenz_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || lorenz_within(reading, 60.0f);
            if (sampled) {
                status |= lorenz_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= LORENZ_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
LORENZ_RARELY
static void lorenz_nominal(lorenz_params *p)
{
    p->ready = LORENZ_READY;
    p->gain.Q[0] = 0.8f;
    p->gain.Q[1] = 2.0f;
    p->gain.Q[2] = 1.0f;
    p->gain.R = 1e-07f;
}

unsigned lorenz_predict(lorenz_state *s, const lorenz_params *p)
{
    unsigned status = 0u;
    if ((s->ready != LORENZ_READY) || (p->ready != LORENZ_READY)) {
        status = lorenz_ready(s, p);
    }
    if ((status & LORENZ_NO_PARAMETERS) == 0u) {
        status |= lorenz_run_predict(s, p);
    }
    return status;
}

unsigned lorenz_update_y(lorenz_state *s, const lorenz_params *p, const lorenz_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LORENZ_READY) || (p->ready != LORENZ_READY)) {
        status = lorenz_ready(s, p);
    }
    if ((status & LORENZ_NO_PARAMETERS) == 0u) {
        status |= lorenz_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned lorenz_step(lorenz_state *s, const lorenz_params *p, const lorenz_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LORENZ_READY) || (p->ready != LORENZ_READY)) {
        status = lorenz_ready(s, p);
    }
    if ((status & LORENZ_NO_PARAMETERS) == 0u) {
        status |= lorenz_run_predict(s, p);
        status |= lorenz_run_update_y(s, p, measurement);
    }
    return status;
}

void lorenz_estimate(const lorenz_state *s, const lorenz_params *p, lorenz_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->y_ = s->z[1];
    x->z = s->z[2];
}

unsigned lorenz_tune(lorenz_params *p)
{
    unsigned status = 0u;
    if (p->ready != LORENZ_READY) {
        lorenz_nominal(p);
        status = LORENZ_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float Q3 = p->gain.Q[2];
        const float R = p->gain.R;
        const bool t1 = !(Q1 >= 8e-07f && Q1 <= 2000000.0f) || !(Q2 >= 8e-07f && Q2 <= 2000000.0f)
            || !(Q3 >= 8e-07f && Q3 <= 2000000.0f);
        p->gain.Q[0] = lorenz_keep(Q1, 8e-07f, 2000000.0f, 0.8f, 3e+38f);
        p->gain.Q[1] = lorenz_keep(Q2, 8e-07f, 2000000.0f, 2.0f, 3e+38f);
        p->gain.Q[2] = lorenz_keep(Q3, 8e-07f, 2000000.0f, 1.0f, 3e+38f);
        p->gain.R = lorenz_keep(R, 1e-13f, 0.1f, 1e-07f, 3e+38f);
        if (t1 || !(R >= 1e-13f && R <= 0.1f)) {
            status |= LORENZ_PARAMETER_LIMITED;
        }
    }
    return status;
}

LORENZ_RARELY
void lorenz_reset(lorenz_state *s)
{
    s->ready = LORENZ_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->used_y = 1u;
    lorenz_clear_fault_counts(s);
    lorenz_clear_rest(s);
}

void lorenz_init(lorenz_state *s, lorenz_params *p)
{
    lorenz_nominal(p);
    (void)lorenz_tune(p);
    lorenz_reset(s);
}

static const unsigned char lorenz_layout[8] = {0x2Cu, 0x6Au, 0x5Du, 0xFDu, 0xCCu, 0xC6u, 0xC2u, 0xA8u};

/* CRC-32 of IEEE 802.3 */
static uint32_t lorenz_checksum(const unsigned char *bytes, size_t size)
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

void lorenz_save(const lorenz_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = lorenz_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = lorenz_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned lorenz_restore(lorenz_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == LORENZ_SAVED) {
        refused = 0u;
        uint32_t sum = lorenz_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == lorenz_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = LORENZ_READY;
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
