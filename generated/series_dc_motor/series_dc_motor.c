/* series_dc_motor: see series_dc_motor.h, and its manual series_dc_motor.md. */
#include "series_dc_motor.h"

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
#define SERIES_DC_MOTOR_RARELY __attribute__((noinline))
#else
#define SERIES_DC_MOTOR_RARELY
#endif

static float series_dc_motor_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float series_dc_motor_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool series_dc_motor_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float series_dc_motor_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool series_dc_motor_within(float v, float limit)
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
static float series_dc_motor_limit(float v, float most)
{
    return series_dc_motor_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float series_dc_motor_keep(float v, float low, float high, float otherwise, float limit)
{
    return series_dc_motor_within(v, limit) ? series_dc_motor_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void series_dc_motor_flow(float z1, float z2, float z3, float u, float dz[2])
{
    const float t1 = series_dc_motor_clamp(z1, 1.0f, 50.0f);
    dz[0] = u - 20.0f*t1 + 0.03f*t1*z2;
    dz[1] = z3 - (t1*t1*0.5f + 0.1f*series_dc_motor_clamp(z2, -300.0f, 0.0f));
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void series_dc_motor_jacobian(float z1, float z2, float F[3])
{
    const float t1 = series_dc_motor_clamp(z1, 1.0f, 50.0f);
    F[0] = 0.03f*series_dc_motor_clamp(z2, -300.0f, 0.0f) - 20.0f; /* F_11 */
    F[1] = -t1; /* F_21 */
    F[2] = 0.03f*t1; /* F_12 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
SERIES_DC_MOTOR_RARELY
static unsigned series_dc_motor_ready(series_dc_motor_state *s, const series_dc_motor_params *p)
{
    unsigned status = 0u;
    if (s->ready != SERIES_DC_MOTOR_READY) {
        series_dc_motor_reset(s);
        status |= SERIES_DC_MOTOR_UNINITIALISED;
    }
    if (p->ready != SERIES_DC_MOTOR_READY) {
        series_dc_motor_reset(s);
        status |= SERIES_DC_MOTOR_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
SERIES_DC_MOTOR_RARELY
static void series_dc_motor_clear_fault_counts(series_dc_motor_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 603.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 603.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
SERIES_DC_MOTOR_RARELY
static void series_dc_motor_clear_rest(series_dc_motor_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->D[0] = 600.0f;
    s->D[1] = 20000.0f;
    s->D[2] = 2000.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned series_dc_motor_keep_in_box(series_dc_motor_state *s, const series_dc_motor_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = series_dc_motor_within(s->z[0], 1e+30f) && series_dc_motor_within(s->z[1], 1e+30f)
            && series_dc_motor_within(s->z[2], 1e+30f);
        const bool t2 = t1 && series_dc_motor_within(s->L[0], 1e+30f)
            && series_dc_motor_within(s->L[1], 1e+30f) && series_dc_motor_within(s->L[2], 1e+30f);
        const bool t3 = t2 && series_dc_motor_within(s->D[0], 1e+30f)
            && series_dc_motor_within(s->D[1], 1e+30f) && series_dc_motor_within(s->D[2], 1e+30f);
        lost = !t3;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 1.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= SERIES_DC_MOTOR_RESTARTED;
        series_dc_motor_clear_fault_counts(s);
        series_dc_motor_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = series_dc_motor_clamp(z1, -48.0f, 99.0f);
        s->z[1] = series_dc_motor_clamp(z2, -600.0f, 300.0f);
        s->z[2] = series_dc_motor_limit(z3, 150.0f);
        if (z1 < -48.0f || z1 > 99.0f || z2 < -600.0f || z2 > 300.0f || series_dc_motor_abs(z3) > 150.0f) {
            status |= SERIES_DC_MOTOR_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        s->L[0] = series_dc_motor_limit(L21, 6.122449e+09f);
        s->L[1] = series_dc_motor_limit(L31, 2.0408164e+09f);
        s->L[2] = series_dc_motor_limit(L32, 3.3333334e+08f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        s->D[0] = series_dc_motor_clamp(D1, 1e-18f, 5402.25f);
        s->D[1] = series_dc_motor_clamp(D2, 9e-14f, 202500.0f);
        s->D[2] = series_dc_motor_clamp(D3, 1e-14f, 22500.0f);
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned series_dc_motor_guard_input(const series_dc_motor_state *s, const series_dc_motor_input *in,
    float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = series_dc_motor_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = series_dc_motor_clamp(u_taken, 0.0f, 5000.0f);
        if (!u_usable) {
            status |= SERIES_DC_MOTOR_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 5000.0f) {
            status |= SERIES_DC_MOTOR_CLAMPED_U;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned series_dc_motor_advance(series_dc_motor_state *s, const series_dc_motor_params *p, float u)
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
        float k1_z[2];
        series_dc_motor_flow(z1, z2, z3, u_before, k1_z);
        const float t1 = u_before + 0.5f*(u - u_before);
        float k2_z[2];
        series_dc_motor_flow(z1 + 0.0005f*k1_z[0], z2 + 0.0005f*k1_z[1], z3, t1, k2_z);
        const float t2 = z1 + 0.0005f*k2_z[0];
        const float t3 = z2 + 0.0005f*k2_z[1];
        float k3_z[2];
        series_dc_motor_flow(t2, t3, z3, t1, k3_z);
        float k4_z[2];
        series_dc_motor_flow(z1 + 0.001f*k3_z[0], z2 + 0.001f*k3_z[1], z3, u, k4_z);
        float F_1[3];
        series_dc_motor_jacobian(t2, t3, F_1);
        const float Phi_11 = 1.0f + 0.001f*F_1[0] + 5e-07f*(F_1[0]*F_1[0] + F_1[2]*F_1[1]);
        const float Phi_12 = 0.001f*F_1[2] + 5e-07f*(F_1[0]*F_1[2] - 0.1f*F_1[2]);
        const float Phi_13 = 5e-07f*F_1[2];
        const float Phi_21 = 0.001f*F_1[1] + 5e-07f*(F_1[1]*F_1[0] - 0.1f*F_1[1]);
        const float Phi_22 = 0.9999f + 5e-07f*(F_1[1]*F_1[2] + 0.01f);
        const float w1_1 = Phi_11 + Phi_12*L21 + Phi_13*L31;
        const float w1_2 = Phi_12 + Phi_13*L32;
        const float t4 = w1_1*D1;
        const float t5 = w1_2*D2;
        const float t6 = Phi_13*D3;
        const float t7 = 0.001f*p->gain.Q[0];
        const float d1 = w1_1*t4 + w1_2*t5 + Phi_13*t6 + t7;
        const float t8 = Phi_21 + Phi_22*L21 + 0.00099995f*L31;
        const float t9 = Phi_22 + 0.00099995f*L32;
        const float l21 = (t8*t4 + t9*t5 + 0.00099995f*t6)/d1;
        const float l31 = (L31*t4 + L32*t5 + t6)/d1;
        const float w2_1 = t8 - l21*w1_1;
        const float w2_2 = t9 - l21*w1_2;
        const float w2_3 = 0.00099995f - l21*Phi_13;
        const float t10 = w2_1*D1;
        const float t11 = w2_2*D2;
        const float t12 = w2_3*D3;
        const float t13 = l21*t7;
        const float t14 = 0.001f*p->gain.Q[1];
        const float d2 = w2_1*t10 + w2_2*t11 + w2_3*t12 + l21*t13 + t14;
        const float t15 = L31 - l31*w1_1;
        const float t16 = L32 - l31*w1_2;
        const float t17 = 1.0f - l31*Phi_13;
        const float l32 = (t15*t10 + t16*t11 + t17*t12 + l31*t13)/d2;
        const float w3_1 = t15 - l32*w2_1;
        const float w3_2 = t16 - l32*w2_2;
        const float w3_3 = t17 - l32*w2_3;
        const float w3_4 = l32*l21 - l31;
        const float d3 = w3_1*D1*w3_1 + w3_2*D2*w3_2 + w3_3*D3*w3_3 + w3_4*t7*w3_4 + l32*t14*l32
            + 0.001f*p->gain.Q[2];
        s->z[0] = z1 + 0.00016666666f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 0.00016666666f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
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
        capped = D1 > 5402.25f || L21*L21*D1 + D2 > 202500.0f || L31*L31*D1 + L32*L32*D2 + s->D[2] > 22500.0f;
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
            const float t1 = series_dc_motor_min(1.0f, 202500.0f/(L21*L21*D1 + D2));
            const float t2 = series_dc_motor_min(1.0f, 5402.25f/D1);
            const float t3 = series_dc_motor_min(1.0f, 22500.0f/(L31*L31*D1 + L32*L32*D2 + D3));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t3*L32/t1;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            status |= SERIES_DC_MOTOR_COVARIANCE_LIMITED;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 >= -48.0f && z1 <= 99.0f && z2 >= -600.0f && z2 <= 300.0f
            && series_dc_motor_within(s->z[2], 150.0f);
        const bool t2 = t1 && series_dc_motor_within(s->L[0], 6.122449e+09f)
            && series_dc_motor_within(s->L[1], 2.0408164e+09f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && series_dc_motor_within(s->L[2], 3.3333334e+08f) && D1 >= 1e-18f
            && D1 <= 5402.25f && D2 >= 9e-14f && D2 <= 202500.0f;
        const float D3 = s->D[2];
        beyond = !(t3 && D3 >= 1e-14f && D3 <= 22500.0f);
    }
    if (series_dc_motor_acts(beyond)) {
        status |= series_dc_motor_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned series_dc_motor_run_predict(series_dc_motor_state *s, const series_dc_motor_params *p,
    const series_dc_motor_input *in)
{
    unsigned status = 0u;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = series_dc_motor_clamp(u_before, 0.0f, 5000.0f);
    }
    status |= series_dc_motor_guard_input(s, in, &u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= series_dc_motor_advance(s, p, u);
    } else {
        status |= series_dc_motor_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned series_dc_motor_guard_measurement_y(const series_dc_motor_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -48.0f && reading <= 99.0f && series_dc_motor_within(t1, 1e+16f);
        const bool t3 = series_dc_motor_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= SERIES_DC_MOTOR_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= SERIES_DC_MOTOR_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned series_dc_motor_use_sample_y(series_dc_motor_state *s, const series_dc_motor_params *p,
    float e)
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
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 >= -48.0f && z1 <= 99.0f && z2 >= -600.0f && z2 <= 300.0f
            && series_dc_motor_within(s->z[2], 150.0f);
        const float D1 = s->D[0];
        beyond = !(t1 && D1 >= 1e-18f && D1 <= 5402.25f);
    }
    if (series_dc_motor_acts(beyond)) {
        status |= series_dc_motor_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned series_dc_motor_suspect_y(const series_dc_motor_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 1.0f || z1 > 50.0f || z2 < -300.0f || z2 > 0.0f
            || series_dc_motor_abs(s->z[2]) > 50.0f;
        if (t1) {
            status |= SERIES_DC_MOTOR_OUTSIDE_BOX;
        }
        *suspect = series_dc_motor_abs(output_error) > 4.9f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool series_dc_motor_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -48.0f && reading <= 99.0f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool series_dc_motor_counts_spoiled_y(const series_dc_motor_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 603.0f + series_dc_motor_abs(fault_count_y)
            + (fault_limit_range - 603.0f + fault_count_range);
        const bool t2 = series_dc_motor_abs(t1 - s->fault_checksum) < 0.5f
            && series_dc_motor_within(fault_count_y, 617472.0f);
        const bool t3 = t2 && fault_limit_y >= 603.0f && fault_limit_y <= 617472.0f
            && fault_count_range >= 0.0f && fault_count_range <= 617472.0f;
        spoiled = !(t3 && fault_limit_range >= 603.0f && fault_limit_range <= 617472.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void series_dc_motor_find_signs_y(const series_dc_motor_state *s, float *moves_y, float output_error,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = series_dc_motor_within(output_error, 4.9f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -301.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned series_dc_motor_recover_y(series_dc_motor_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= series_dc_motor_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t3 = z1 < -23.5f || z1 > 74.5f || z2 < -450.0f || z2 > 150.0f
            || series_dc_motor_abs(s->z[2]) > 100.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 603.0f || t3));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = series_dc_motor_min(fault_limit_y, 308736.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = series_dc_motor_min(2.0f*fault_limit_y, 617472.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = series_dc_motor_min(fault_limit_range, 308736.0f);
            s->fault_limit_range = series_dc_motor_min(2.0f*fault_limit_range, 617472.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 1.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = series_dc_motor_keep(reading, 1.0f, 50.0f, z1, 1e+30f);
            s->z[1] = series_dc_motor_keep(z2, -300.0f, 0.0f, z2, 1e+30f);
            s->z[2] = series_dc_motor_keep(z3, -50.0f, 50.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= SERIES_DC_MOTOR_RESTARTED_FROM_SAMPLE;
        series_dc_motor_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float L31 = s->L[1];
            const float D1 = s->D[0];
            const float t1 = L31*D1;
            const float t2 = z1 - series_dc_motor_clamp(z1, 1.0f, 50.0f);
            const float t3 = t2/D1;
            const float L21 = s->L[0];
            const float L32 = s->L[2];
            const float D2 = s->D[1];
            const float t4 = L32*D2;
            const float t5 = L21*D1;
            const float t6 = z2 - t5*t3;
            const float t7 = t6 - series_dc_motor_clamp(t6, -300.0f, 0.0f);
            const float t8 = t7/(t5*L21 + D2);
            const float t9 = z3 - t1*t3 - (t1*L21 + t4)*t8;
            const float t10 = t9 - series_dc_motor_limit(t9, 50.0f);
            const float t11 = t9 - t10 - z3;
            const float t12 = (t11 > 0.0f) ? 150.0f - z3 : z3 + 150.0f;
            const float t13 = t10/(t1*L31 + t4*L32 + s->D[2]);
            const float t14 = t6 - t7 - (t5*L31 + D2*L32)*t13 - z2;
            const float t15 = (t14 > 0.0f) ? 300.0f - z2 : z2 + 600.0f;
            const float t16 = z1 - t2 - D1*L21*t8 - D1*L31*t13 - z1;
            const float t17 = (t16 > 0.0f) ? 99.0f - z1 : z1 + 48.0f;
            const float t18 = series_dc_motor_abs(t16);
            const float t19 = (t17 < t18) ? t17/t18 : 1.0f;
            const float t20 = series_dc_motor_abs(t14);
            const float t21 = (t15 < t19*t20) ? t15/t20 : t19;
            const float t22 = series_dc_motor_abs(t11);
            const float t23 = (t12 < t21*t22) ? t12/t22 : t21;
            s->z[0] = series_dc_motor_keep(z1 + t23*t16, -48.0f, 99.0f, z1, 1e+30f);
            s->z[1] = series_dc_motor_keep(z2 + t23*t14, -600.0f, 300.0f, z2, 1e+30f);
            s->z[2] = series_dc_motor_keep(z3 + t23*t11, -150.0f, 150.0f, z3, 1e+30f);
            status |= SERIES_DC_MOTOR_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned series_dc_motor_count_faults_y(series_dc_motor_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = series_dc_motor_counts_spoiled_y(s);
    if (spoiled) {
        series_dc_motor_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < -1.45f || z1 > 52.45f || z2 < -315.0f || z2 > 15.0f
            || series_dc_motor_abs(s->z[2]) > 55.0f;
        moves_range = t1 ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = series_dc_motor_clamp(fault_count_range + moves_range, 0.0f, 617472.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 603.0f : fault_limit_range;
    }
    series_dc_motor_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = series_dc_motor_clamp(series_dc_motor_abs(fault_count_y) + moves_y, 0.0f, 617472.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 603.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= series_dc_motor_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= series_dc_motor_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 603.0f + series_dc_motor_abs(s->fault_count_y)
        + (s->fault_limit_range - 603.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned series_dc_motor_run_update_y(series_dc_motor_state *s, const series_dc_motor_params *p,
    const series_dc_motor_output *measurement)
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
        status |= series_dc_motor_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= series_dc_motor_use_sample_y(s, p, e);
        }
        status |= series_dc_motor_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = series_dc_motor_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= series_dc_motor_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= SERIES_DC_MOTOR_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
SERIES_DC_MOTOR_RARELY
static void series_dc_motor_nominal(series_dc_motor_params *p)
{
    p->ready = SERIES_DC_MOTOR_READY;
    p->gain.Q[0] = 2.0f;
    p->gain.Q[1] = 90.0f;
    p->gain.Q[2] = 10.0f;
    p->gain.R = 1e-09f;
}

unsigned series_dc_motor_predict(series_dc_motor_state *s, const series_dc_motor_params *p,
    const series_dc_motor_input *in)
{
    unsigned status = 0u;
    if ((s->ready != SERIES_DC_MOTOR_READY) || (p->ready != SERIES_DC_MOTOR_READY)) {
        status = series_dc_motor_ready(s, p);
    }
    if ((status & SERIES_DC_MOTOR_NO_PARAMETERS) == 0u) {
        status |= series_dc_motor_run_predict(s, p, in);
    }
    return status;
}

unsigned series_dc_motor_update_y(series_dc_motor_state *s, const series_dc_motor_params *p,
    const series_dc_motor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != SERIES_DC_MOTOR_READY) || (p->ready != SERIES_DC_MOTOR_READY)) {
        status = series_dc_motor_ready(s, p);
    }
    if ((status & SERIES_DC_MOTOR_NO_PARAMETERS) == 0u) {
        status |= series_dc_motor_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned series_dc_motor_step(series_dc_motor_state *s, const series_dc_motor_params *p,
    const series_dc_motor_input *in, const series_dc_motor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != SERIES_DC_MOTOR_READY) || (p->ready != SERIES_DC_MOTOR_READY)) {
        status = series_dc_motor_ready(s, p);
    }
    if ((status & SERIES_DC_MOTOR_NO_PARAMETERS) == 0u) {
        status |= series_dc_motor_run_predict(s, p, in);
        status |= series_dc_motor_run_update_y(s, p, measurement);
    }
    return status;
}

void series_dc_motor_estimate(const series_dc_motor_state *s, const series_dc_motor_params *p,
    series_dc_motor_plant *x)
{
    (void)p;
    /* the plant's state */
    x->i = s->z[0];
    x->w = -s->z[1];
    x->TL = s->z[2];
}

unsigned series_dc_motor_tune(series_dc_motor_params *p)
{
    unsigned status = 0u;
    if (p->ready != SERIES_DC_MOTOR_READY) {
        series_dc_motor_nominal(p);
        status = SERIES_DC_MOTOR_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float Q3 = p->gain.Q[2];
        const float R = p->gain.R;
        const bool t1 = !(Q1 >= 2e-06f && Q1 <= 9e+07f) || !(Q2 >= 2e-06f && Q2 <= 9e+07f)
            || !(Q3 >= 2e-06f && Q3 <= 9e+07f);
        p->gain.Q[0] = series_dc_motor_keep(Q1, 2e-06f, 9e+07f, 2.0f, 3e+38f);
        p->gain.Q[1] = series_dc_motor_keep(Q2, 2e-06f, 9e+07f, 90.0f, 3e+38f);
        p->gain.Q[2] = series_dc_motor_keep(Q3, 2e-06f, 9e+07f, 10.0f, 3e+38f);
        p->gain.R = series_dc_motor_keep(R, 1e-15f, 0.001f, 1e-09f, 3e+38f);
        if (t1 || !(R >= 1e-15f && R <= 0.001f)) {
            status |= SERIES_DC_MOTOR_PARAMETER_LIMITED;
        }
    }
    return status;
}

SERIES_DC_MOTOR_RARELY
void series_dc_motor_reset(series_dc_motor_state *s)
{
    s->ready = SERIES_DC_MOTOR_READY;
    s->z[0] = 1.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    series_dc_motor_clear_fault_counts(s);
    series_dc_motor_clear_rest(s);
}

void series_dc_motor_init(series_dc_motor_state *s, series_dc_motor_params *p)
{
    series_dc_motor_nominal(p);
    (void)series_dc_motor_tune(p);
    series_dc_motor_reset(s);
}

static const unsigned char series_dc_motor_layout[8] = {
    0x51u, 0xC8u, 0x65u, 0x9Au, 0xD0u, 0x1Cu, 0x18u, 0x19u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t series_dc_motor_checksum(const unsigned char *bytes, size_t size)
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

void series_dc_motor_save(const series_dc_motor_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = series_dc_motor_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = series_dc_motor_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned series_dc_motor_restore(series_dc_motor_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == SERIES_DC_MOTOR_SAVED) {
        refused = 0u;
        uint32_t sum = series_dc_motor_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == series_dc_motor_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = SERIES_DC_MOTOR_READY;
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
