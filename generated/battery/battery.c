/* battery: see battery.h, and its manual battery.md. */
#include "battery.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(BATTERY_USE_LIBM)
#include <math.h>
#elif defined(BATTERY_USE_CMSIS)
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
#define BATTERY_RARELY __attribute__((noinline))
#else
#define BATTERY_RARELY
#endif

static float battery_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float battery_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float battery_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool battery_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float battery_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool battery_within(float v, float limit)
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
static float battery_limit(float v, float most)
{
    return battery_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float battery_keep(float v, float low, float high, float otherwise, float limit)
{
    return battery_within(v, limit) ? battery_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define BATTERY_USE_LIBM for those of <math.h>, or BATTERY_USE_CMSIS for CMSIS-DSP. */
#if defined(BATTERY_USE_LIBM)
static float battery_log(float x)
{
    return logf(x);
}

#elif defined(BATTERY_USE_CMSIS)
static float battery_log(float x)
{
    return logf(x);
}

#else
static float battery_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float battery_nan(void)
{
    const float large = battery_inf();
    return large - large;
}

static float battery_log(float x)
{
    const bool t1 = x < 1.0f;
    const float t2 = x*(1.0f + (t1 ? 8.507059e+37f : 0.0f));
    const bool t3 = t2 < 1.8446744e+19f;
    const float t4 = t2*(5.421011e-20f + (t3 ? 1.0f : 0.0f));
    const bool t5 = t4 < 4.2949673e+09f;
    const float t6 = t4*(2.3283064e-10f + (t5 ? 1.0f : 0.0f));
    const bool t7 = t6 < 65536.0f;
    const float t8 = 127.0f - (t1 ? 126.0f : 0.0f) - (t3 ? 64.0f : 0.0f) - (t5 ? 32.0f : 0.0f)
        - (t7 ? 16.0f : 0.0f);
    const float t9 = t6*(1.5258789e-05f + (t7 ? 0.99998474f : 0.0f));
    const bool t10 = t9 < 256.0f;
    const float t11 = t9*(0.00390625f + (t10 ? 0.99609375f : 0.0f));
    const bool t12 = t11 < 16.0f;
    const float t13 = t11*(0.0625f + (t12 ? 0.9375f : 0.0f));
    const bool t14 = t13 < 4.0f;
    const float t15 = t13*(0.25f + (t14 ? 0.75f : 0.0f));
    const bool t16 = t15 < 2.0f;
    const float t17 = t15*(0.5f + (t16 ? 0.5f : 0.0f));
    const bool t18 = t17 > 1.4142135f;
    const float t19 = t8 - (t10 ? 8.0f : 0.0f) - (t12 ? 4.0f : 0.0f) - (t14 ? 2.0f : 0.0f)
        - (t16 ? 1.0f : 0.0f) + (t18 ? 1.0f : 0.0f);
    const float t20 = t17*(1.0f - (t18 ? 0.5f : 0.0f)) - 1.0f;
    const float t21 = t20*t20*0.5f;
    const float t22 = t20/(2.0f + t20);
    const float t23 = t22*t22;
    const float t24 = t21 - (t22*(t21 + t23*((0.298719f*t23 + 0.3997756f)*t23 + 0.66666776f))
        + 1.4286068e-06f*t19);
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? battery_nan() : 0.0f) - battery_inf()
        : ((x > 3.4028235e+38f) ? x : 0.69314575f*t19 - (t24 - t20));
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void battery_flow(float z2, float u, float dz[2])
{
    dz[0] = -0.00013888889f*u;
    dz[1] = 0.00066666666f*u - 0.016666668f*z2;
}

/* memory without its mark is not used: the state begins anew, which the status says */
BATTERY_RARELY
static unsigned battery_ready(battery_state *s, const battery_params *p)
{
    unsigned status = 0u;
    if (s->ready != BATTERY_READY) {
        battery_reset(s);
        status |= BATTERY_UNINITIALISED;
    }
    if (p->ready != BATTERY_READY) {
        battery_reset(s);
        status |= BATTERY_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
BATTERY_RARELY
static void battery_clear_fault_counts(battery_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 120.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 120.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned battery_keep_in_box(battery_state *s, const battery_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = battery_within(s->z[0], 1e+30f) && battery_within(s->z[1], 1e+30f)
            && battery_within(s->L, 1e+30f);
        lost = !(t1 && battery_within(s->D[0], 1e+30f) && battery_within(s->D[1], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.05f;
        s->z[1] = 0.0f;
        status |= BATTERY_RESTARTED;
        battery_clear_fault_counts(s);
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 0.2f;
        s->D[1] = 0.04f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = battery_clamp(z1, -0.85f, 1.85f);
        s->z[1] = battery_limit(z2, 0.6f);
        if (z1 < -0.85f || z1 > 1.85f || battery_abs(z2) > 0.6f) {
            status |= BATTERY_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = battery_limit(L21, 4.4444445e+08f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = battery_clamp(D1, 1e-18f, 1.8225f);
        s->D[1] = battery_clamp(D2, 9e-19f, 0.36f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned battery_run_predict(battery_state *s, const battery_params *p, const battery_input *in)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = battery_limit(u_before, 5.0f);
    }
    /* guard the input */
    {
        const float i_2 = in->i;
        const bool i_usable = battery_within(i_2, 1e+15f);
        const float i_taken = i_usable ? i_2 : s->u;
        u = battery_limit(i_taken, 5.0f);
        if (!i_usable) {
            status |= BATTERY_REUSED_I;
        }
        if (battery_abs(i_taken) > 5.0f) {
            status |= BATTERY_CLAMPED_I;
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
            battery_flow(z2, u_before, k1_z);
            const float t1 = u_before + 0.5f*(u - u_before);
            float k2_z[2];
            battery_flow(z2 + 0.5f*k1_z[1], t1, k2_z);
            float k3_z[2];
            battery_flow(z2 + 0.5f*k2_z[1], t1, k3_z);
            float k4_z[2];
            battery_flow(z2 + k3_z[1], u, k4_z);
            const float Q1 = p->gain.Q[0];
            const float d1 = D1 + Q1;
            const float t2 = 0.9834722f*L21;
            const float l21 = t2*D1/d1;
            const float w2_1 = t2 - l21;
            const float d2 = w2_1*D1*w2_1 + 0.9672176f*D2 + l21*Q1*l21 + p->gain.Q[1];
            s->z[0] = z1 + 0.16666667f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
            s->z[1] = z2 + 0.16666667f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
            s->L = l21;
            s->D[0] = d1;
            s->D[1] = d2;
        }
        /* largest variances */
        {
            const float D1 = s->D[0];
            const float L21 = s->L;
            capped = D1 > 1.8225f || L21*L21*D1 + s->D[1] > 0.36f;
        }
        if (capped) {
            /* cap */
            {
                const float D1 = s->D[0];
                const float D2 = s->D[1];
                const float L21 = s->L;
                const float t1 = battery_min(1.0f, 0.36f/(L21*L21*D1 + D2));
                const float t2 = battery_min(1.0f, 1.8225f/D1);
                s->L = t1*L21/t2;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                status |= BATTERY_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const bool t1 = z1 >= -0.85f && z1 <= 1.85f && battery_within(s->z[1], 0.6f)
                && battery_within(s->L, 4.4444445e+08f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            beyond = !(t1 && D1 >= 1e-18f && D1 <= 1.8225f && D2 >= 9e-19f && D2 <= 0.36f);
        }
        if (battery_acts(beyond)) {
            status |= battery_keep_in_box(s, p);
        }
    } else {
        status |= battery_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* move the estimate to the nearest one that fits the sample of y */
static void battery_fit_y(battery_state *s, float reading)
{
    /* from the sample of y */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = battery_clamp(z1, 0.05f, 0.95f);
        const float t2 = 0.05f/t1;
        const float t3 = 0.1f/t1;
        const float t4 = t3/t1;
        const float t5 = 0.8f + t2 + t4;
        const float t6 = 7.29f*t5;
        const float t7 = reading - (0.8f*z1 - z2 + (0.05f*battery_log(t1) - 0.02f*s->u + 3.2f - t3)
            + (t2 + t4)*(z1 - t1));
        const float t8 = t7/battery_max(t5*t6 + 1.44f, 1.1302767e-11f);
        s->z[0] = battery_keep(z1 + t6*t8, 0.05f, 0.95f, z1, 1e+30f);
        s->z[1] = battery_keep(z2 - 1.44f*t8, -0.2f, 0.2f, z2, 1e+30f);
    }
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned battery_guard_measurement_y(const battery_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float z1 = s->z[0];
        const float t1 = battery_clamp(z1, 0.05f, 0.95f);
        const float t2 = 0.1f/t1;
        const float t3 = 0.8f*z1 - s->z[1] + (0.05f*battery_log(t1) - 0.02f*s->u + 3.2f - t2)
            + (0.05f/t1 + t2/t1)*(z1 - t1);
        const float t4 = reading - t3;
        const bool t5 = reading >= -2.57175f && reading <= 7.51413f && battery_within(t4, 1e+16f);
        const bool t6 = battery_within(reading, 3e+38f);
        *e = t4;
        *output_error = t4;
        *valid = t5;
        if (!t6) {
            status |= BATTERY_MISSING_Y;
        }
        if (t6 && !t5) {
            status |= BATTERY_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned battery_use_sample_y(battery_state *s, const battery_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = battery_clamp(z1, 0.05f, 0.95f);
        const float t2 = 0.8f + 0.05f/t1 + 0.1f/t1/t1 - L21;
        const float t3 = D1*t2;
        const float R = p->gain.R;
        const float t4 = R + D2;
        const float t5 = t4 + t3*t2;
        const float K1 = t3/t5;
        const float K2 = (L21*t3 - D2)/t5;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->L = L21 + t2*D2/t4;
        s->D[0] = D1*t4/t5;
        s->D[1] = D2*R/t4;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 >= -0.85f && z1 <= 1.85f && battery_within(s->z[1], 0.6f)
            && battery_within(s->L, 4.4444445e+08f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        beyond = !(t1 && D1 >= 1e-18f && D1 <= 1.8225f && D2 >= 9e-19f && D2 <= 0.36f);
    }
    if (battery_acts(beyond)) {
        status |= battery_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned battery_suspect_y(const battery_state *s, float output_error, bool *suspect, bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < 0.05f || z1 > 0.95f || battery_abs(s->z[1]) > 0.2f;
        if (t1) {
            status |= BATTERY_OUTSIDE_BOX;
        }
        *suspect = battery_abs(output_error) > 0.3361959f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool battery_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -2.57175f && reading <= 7.51413f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool battery_counts_spoiled_y(const battery_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 120.0f + battery_abs(fault_count_y)
            + (fault_limit_range - 120.0f + fault_count_range);
        const bool t2 = battery_abs(t1 - s->fault_checksum) < 0.5f
            && battery_within(fault_count_y, 122880.0f) && fault_limit_y >= 120.0f
                && fault_limit_y <= 122880.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 122880.0f
            && fault_limit_range >= 120.0f && fault_limit_range <= 122880.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void battery_find_signs_y(const battery_state *s, float *moves_y, float output_error, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = battery_within(output_error, 0.3361959f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -60.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned battery_recover_y(battery_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= battery_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 120.0f || z1 < -0.4f || z1 > 1.4f
            || battery_abs(s->z[1]) > 0.4f));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = battery_min(fault_limit_y, 61440.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = battery_min(2.0f*fault_limit_y, 122880.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = battery_min(fault_limit_range, 61440.0f);
            s->fault_limit_range = battery_min(2.0f*fault_limit_range, 122880.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.05f;
        s->z[1] = 0.0f;
        battery_fit_y(s, reading);
        battery_fit_y(s, reading);
        battery_fit_y(s, reading);
        /* the estimate has restarted from the sample */
        status |= BATTERY_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 0.2f;
        s->D[1] = 0.04f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - battery_clamp(z1, 0.05f, 0.95f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - battery_limit(t3, 0.2f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 0.6f - z2 : z2 + 0.6f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 1.85f - z1 : z1 + 0.85f;
            const float t9 = battery_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = battery_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = battery_keep(z1 + t12*t7, -0.85f, 1.85f, z1, 1e+30f);
            s->z[1] = battery_keep(z2 + t12*t5, -0.6f, 0.6f, z2, 1e+30f);
            status |= BATTERY_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned battery_count_faults_y(battery_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = battery_counts_spoiled_y(s);
    if (spoiled) {
        battery_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        moves_range = (z1 < 0.005f || z1 > 0.995f || battery_abs(s->z[1]) > 0.22f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = battery_clamp(fault_count_range + moves_range, 0.0f, 122880.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 120.0f : fault_limit_range;
    }
    battery_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = battery_clamp(battery_abs(fault_count_y) + moves_y, 0.0f, 122880.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 120.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= battery_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= battery_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 120.0f + battery_abs(s->fault_count_y)
        + (s->fault_limit_range - 120.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned battery_run_update_y(battery_state *s, const battery_params *p,
    const battery_output *measurement)
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
        status |= battery_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= battery_use_sample_y(s, p, e);
        }
        status |= battery_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = battery_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= battery_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= BATTERY_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
BATTERY_RARELY
static void battery_nominal(battery_params *p)
{
    p->ready = BATTERY_READY;
    p->gain.Q[0] = 5e-06f;
    p->gain.Q[1] = 9e-07f;
    p->gain.R = 1e-06f;
}

unsigned battery_predict(battery_state *s, const battery_params *p, const battery_input *in)
{
    unsigned status = 0u;
    if ((s->ready != BATTERY_READY) || (p->ready != BATTERY_READY)) {
        status = battery_ready(s, p);
    }
    if ((status & BATTERY_NO_PARAMETERS) == 0u) {
        status |= battery_run_predict(s, p, in);
    }
    return status;
}

unsigned battery_update_y(battery_state *s, const battery_params *p, const battery_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != BATTERY_READY) || (p->ready != BATTERY_READY)) {
        status = battery_ready(s, p);
    }
    if ((status & BATTERY_NO_PARAMETERS) == 0u) {
        status |= battery_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned battery_step(battery_state *s, const battery_params *p, const battery_input *in,
    const battery_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != BATTERY_READY) || (p->ready != BATTERY_READY)) {
        status = battery_ready(s, p);
    }
    if ((status & BATTERY_NO_PARAMETERS) == 0u) {
        status |= battery_run_predict(s, p, in);
        status |= battery_run_update_y(s, p, measurement);
    }
    return status;
}

void battery_estimate(const battery_state *s, const battery_params *p, battery_plant *x)
{
    (void)p;
    /* the plant's state */
    x->soc = s->z[0];
    x->v = s->z[1];
}

unsigned battery_tune(battery_params *p)
{
    unsigned status = 0u;
    if (p->ready != BATTERY_READY) {
        battery_nominal(p);
        status = BATTERY_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float R = p->gain.R;
        p->gain.Q[0] = battery_keep(Q1, 9e-13f, 5.0f, 5e-06f, 3e+38f);
        p->gain.Q[1] = battery_keep(Q2, 9e-13f, 5.0f, 9e-07f, 3e+38f);
        p->gain.R = battery_keep(R, 1e-12f, 1.0f, 1e-06f, 3e+38f);
        if (!(Q1 >= 9e-13f && Q1 <= 5.0f) || !(Q2 >= 9e-13f && Q2 <= 5.0f) || !(R >= 1e-12f && R <= 1.0f)) {
            status |= BATTERY_PARAMETER_LIMITED;
        }
    }
    return status;
}

BATTERY_RARELY
void battery_reset(battery_state *s)
{
    s->ready = BATTERY_READY;
    s->z[0] = 0.05f;
    s->z[1] = 0.0f;
    s->L = 0.0f;
    s->D[0] = 0.2f;
    s->D[1] = 0.04f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    battery_clear_fault_counts(s);
}

void battery_init(battery_state *s, battery_params *p)
{
    battery_nominal(p);
    (void)battery_tune(p);
    battery_reset(s);
}

static const unsigned char battery_layout[8] = {0xD4u, 0x1Eu, 0x84u, 0x86u, 0xE5u, 0x99u, 0x2Eu, 0xC8u};

/* CRC-32 of IEEE 802.3 */
static uint32_t battery_checksum(const unsigned char *bytes, size_t size)
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

void battery_save(const battery_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = battery_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = battery_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned battery_restore(battery_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == BATTERY_SAVED) {
        refused = 0u;
        uint32_t sum = battery_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == battery_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = BATTERY_READY;
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
