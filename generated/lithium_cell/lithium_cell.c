/* lithium_cell: see lithium_cell.h, and its manual lithium_cell.md. */
#include "lithium_cell.h"

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
#define LITHIUM_CELL_RARELY __attribute__((noinline))
#else
#define LITHIUM_CELL_RARELY
#endif

static float lithium_cell_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float lithium_cell_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float lithium_cell_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool lithium_cell_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float lithium_cell_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool lithium_cell_within(float v, float limit)
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
static float lithium_cell_limit(float v, float most)
{
    return lithium_cell_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float lithium_cell_keep(float v, float low, float high, float otherwise, float limit)
{
    return lithium_cell_within(v, limit) ? lithium_cell_clamp(v, low, high) : otherwise;
}

/* the slope of the table ocv: monotone, 14 points, with its slopes held at its ends */
static float lithium_cell_slope_ocv(float x)
{
    static const float start[15] = {
        0.0f, 0.0f, 0.03f, 0.08f, 0.15f, 0.25f, 0.35f, 0.45f, 0.55f, 0.65f, 0.75f, 0.85f, 0.93f, 0.97f, 1.0f
    };
    static const float c0[15] = {
        10.725f, 10.725f, 6.084507f, 2.5290048f, 1.1594784f, 0.66785717f, 0.495f, 0.5318182f, 0.7548387f,
        0.9f, 0.92432433f, 1.0051867f, 1.0963376f, 1.2945205f, 1.6607143f
    };
    static const float c1[15] = {
        0.0f, -35.633804f, -59.920753f, -30.70374f, -8.73628f, -3.6142857f, -3.4363637f, 2.6304986f,
        5.806452f, -0.4864865f, -0.076707415f, 2.0197244f, -5.6097856f, 16.682974f, 0.0f
    };
    static const float c2[15] = {
        0.0f, -3968.3098f, -223.7858f, 159.12967f, 38.200672f, 18.857143f, 38.045456f, -4.0029325f,
        -43.548386f, 7.2972975f, 8.853313f, -11.004233f, 264.10898f, -149.21722f, 0.0f
    };
    unsigned k = 0u;
    unsigned probe = 8u;
    while (probe > 0u) {
        if (k + probe <= 14u && start[k + probe] <= x) {
            k = k + probe;
        }
        probe = probe/2u;
    }
    const float d = x - start[k];
    return c0[k] + d*(c1[k] + d*c2[k]);
}

/* the table ocv: monotone, 14 points, held at its ends */
static float lithium_cell_table_ocv(float x)
{
    static const float start[15] = {
        0.0f, 0.0f, 0.03f, 0.08f, 0.15f, 0.25f, 0.35f, 0.45f, 0.55f, 0.65f, 0.75f, 0.85f, 0.93f, 0.97f, 1.0f
    };
    static const float c0[15] = {
        2.85f, 2.85f, 3.12f, 3.34f, 3.46f, 3.545f, 3.6f, 3.645f, 3.71f, 3.8f, 3.89f, 3.985f, 4.07f, 4.115f,
        4.16f
    };
    static const float c1[15] = {
        0.0f, 10.725f, 6.084507f, 2.5290048f, 1.1594784f, 0.66785717f, 0.495f, 0.5318182f, 0.7548387f, 0.9f,
        0.92432433f, 1.0051867f, 1.0963376f, 1.2945205f, 0.0f
    };
    static const float c2[15] = {
        0.0f, -17.816902f, -29.960377f, -15.35187f, -4.36814f, -1.8071429f, -1.7181818f, 1.3152493f,
        2.903226f, -0.24324325f, -0.038353708f, 1.0098622f, -2.8048928f, 8.341487f, 0.0f
    };
    static const float c3[15] = {
        0.0f, -1322.7699f, -74.59527f, 53.043224f, 12.733558f, 6.285714f, 12.681818f, -1.3343109f,
        -14.5161295f, 2.4324324f, 2.9511046f, -3.668078f, 88.03633f, -49.739075f, 0.0f
    };
    unsigned k = 0u;
    unsigned probe = 8u;
    while (probe > 0u) {
        if (k + probe <= 14u && start[k + probe] <= x) {
            k = k + probe;
        }
        probe = probe/2u;
    }
    const float d = x - start[k];
    return c0[k] + d*(c1[k] + d*(c2[k] + d*c3[k]));
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void lithium_cell_flow(float z2, float u, float dz[1])
{
    dz[0] = -0.00011111111f*z2 - 0.00011111111f*u;
}

/* memory without its mark is not used: the state begins anew, which the status says */
LITHIUM_CELL_RARELY
static unsigned lithium_cell_ready(lithium_cell_state *s, const lithium_cell_params *p)
{
    unsigned status = 0u;
    if (s->ready != LITHIUM_CELL_READY) {
        lithium_cell_reset(s);
        status |= LITHIUM_CELL_UNINITIALISED;
    }
    if (p->ready != LITHIUM_CELL_READY) {
        lithium_cell_reset(s);
        status |= LITHIUM_CELL_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
LITHIUM_CELL_RARELY
static void lithium_cell_clear_fault_counts(lithium_cell_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 952.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 952.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned lithium_cell_keep_in_box(lithium_cell_state *s, const lithium_cell_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = lithium_cell_within(s->z[0], 1e+30f) && lithium_cell_within(s->z[1], 1e+30f)
            && lithium_cell_within(s->L, 1e+30f);
        lost = !(t1 && lithium_cell_within(s->D[0], 1e+30f) && lithium_cell_within(s->D[1], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.03f;
        s->z[1] = 0.0f;
        status |= LITHIUM_CELL_RESTARTED;
        lithium_cell_clear_fault_counts(s);
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 0.05f;
        s->D[1] = 0.1f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = lithium_cell_clamp(z1, -0.91f, 1.91f);
        s->z[1] = lithium_cell_limit(z2, 1.5f);
        if (z1 < -0.91f || z1 > 1.91f || lithium_cell_abs(z2) > 1.5f) {
            status |= LITHIUM_CELL_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = lithium_cell_limit(L21, 1.06382976e+09f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = lithium_cell_clamp(D1, 1e-20f, 1.9881f);
        s->D[1] = lithium_cell_clamp(D2, 1e-18f, 2.25f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned lithium_cell_run_predict(lithium_cell_state *s, const lithium_cell_params *p,
    const lithium_cell_input *in)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = lithium_cell_limit(u_before, 5.0f);
    }
    /* guard the input */
    {
        const float i_2 = in->i;
        const bool i_usable = lithium_cell_within(i_2, 1e+15f);
        const float i_taken = i_usable ? i_2 : s->u;
        u = lithium_cell_limit(i_taken, 5.0f);
        if (!i_usable) {
            status |= LITHIUM_CELL_REUSED_I;
        }
        if (lithium_cell_abs(i_taken) > 5.0f) {
            status |= LITHIUM_CELL_CLAMPED_I;
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
            float k1_z[1];
            lithium_cell_flow(z2, u_before, k1_z);
            const float t1 = u_before + 0.5f*(u - u_before);
            float k2_z[1];
            lithium_cell_flow(z2, t1, k2_z);
            float k3_z[1];
            lithium_cell_flow(z2, t1, k3_z);
            float k4_z[1];
            lithium_cell_flow(z2, u, k4_z);
            const float w1_1 = 1.0f - 0.00011111111f*L21;
            const float t2 = w1_1*D1;
            const float Q1 = p->gain.Q[0];
            const float d1 = w1_1*t2 + 1.2345679e-08f*D2 + Q1;
            const float l21 = (L21*t2 - 0.00011111111f*D2)/d1;
            const float w2_1 = L21 - l21*w1_1;
            const float w2_2 = 1.0f + 0.00011111111f*l21;
            const float d2 = w2_1*D1*w2_1 + w2_2*D2*w2_2 + l21*Q1*l21 + p->gain.Q[1];
            s->z[0] = z1 + 0.16666667f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
            s->L = l21;
            s->D[0] = d1;
            s->D[1] = d2;
        }
        /* largest variances */
        {
            const float D1 = s->D[0];
            const float L21 = s->L;
            capped = D1 > 1.9881f || L21*L21*D1 + s->D[1] > 2.25f;
        }
        if (capped) {
            /* cap */
            {
                const float D1 = s->D[0];
                const float D2 = s->D[1];
                const float L21 = s->L;
                const float t1 = lithium_cell_min(1.0f, 2.25f/(L21*L21*D1 + D2));
                const float t2 = lithium_cell_min(1.0f, 1.9881f/D1);
                s->L = t1*L21/t2;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                status |= LITHIUM_CELL_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const bool t1 = z1 >= -0.91f && z1 <= 1.91f && lithium_cell_within(s->z[1], 1.5f)
                && lithium_cell_within(s->L, 1.06382976e+09f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            beyond = !(t1 && D1 >= 1e-20f && D1 <= 1.9881f && D2 >= 1e-18f && D2 <= 2.25f);
        }
        if (lithium_cell_acts(beyond)) {
            status |= lithium_cell_keep_in_box(s, p);
        }
    } else {
        status |= lithium_cell_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* move the estimate to the nearest one that fits the sample of y */
static void lithium_cell_fit_y(lithium_cell_state *s, float reading)
{
    /* from the sample of y */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = lithium_cell_clamp(z1, 0.03f, 0.97f);
        const float t2 = lithium_cell_slope_ocv(t1);
        const float t3 = 7.9524f*t2;
        const float t4 = (reading - (lithium_cell_table_ocv(t1) - 0.03f*s->u
            + t2*(z1 - t1)))/lithium_cell_max(t2*t3, 1.677025e-12f);
        s->z[0] = lithium_cell_keep(z1 + t3*t4, 0.03f, 0.97f, z1, 1e+30f);
        s->z[1] = lithium_cell_keep(z2, -0.5f, 0.5f, z2, 1e+30f);
    }
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned lithium_cell_guard_measurement_y(const lithium_cell_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float z1 = s->z[0];
        const float t1 = lithium_cell_clamp(z1, 0.03f, 0.97f);
        const float t2 = reading - (lithium_cell_table_ocv(t1) - 0.03f*s->u + lithium_cell_slope_ocv(t1)*
            (z1 - t1));
        const bool t3 = reading >= 1.675f && reading <= 5.56f && lithium_cell_within(t2, 1e+16f);
        const bool t4 = lithium_cell_within(reading, 3e+38f);
        *e = t2;
        *output_error = t2;
        *valid = t3;
        if (!t4) {
            status |= LITHIUM_CELL_MISSING_Y;
        }
        if (t4 && !t3) {
            status |= LITHIUM_CELL_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned lithium_cell_use_sample_y(lithium_cell_state *s, const lithium_cell_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = lithium_cell_slope_ocv(lithium_cell_clamp(z1, 0.03f, 0.97f));
        const float t2 = D1*t1;
        const float R = p->gain.R;
        const float t3 = R + t2*t1;
        const float K1 = t2/t3;
        const float K2 = L21*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->D[0] = D1*R/t3;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float D1 = s->D[0];
        const bool t1 = z1 >= -0.91f && z1 <= 1.91f && lithium_cell_within(s->z[1], 1.5f) && D1 >= 1e-20f
            && D1 <= 1.9881f;
        beyond = !t1;
    }
    if (lithium_cell_acts(beyond)) {
        status |= lithium_cell_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned lithium_cell_suspect_y(const lithium_cell_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < 0.03f || z1 > 0.97f || lithium_cell_abs(s->z[1]) > 0.5f;
        if (t1) {
            status |= LITHIUM_CELL_OUTSIDE_BOX;
        }
        *suspect = lithium_cell_abs(output_error) > 0.1295f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool lithium_cell_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= 1.675f && reading <= 5.56f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool lithium_cell_counts_spoiled_y(const lithium_cell_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 952.0f + lithium_cell_abs(fault_count_y)
            + (fault_limit_range - 952.0f + fault_count_range);
        const bool t2 = lithium_cell_abs(t1 - s->fault_checksum) < 0.5f
            && lithium_cell_within(fault_count_y, 974848.0f);
        const bool t3 = t2 && fault_limit_y >= 952.0f && fault_limit_y <= 974848.0f
            && fault_count_range >= 0.0f && fault_count_range <= 974848.0f;
        spoiled = !(t3 && fault_limit_range >= 952.0f && fault_limit_range <= 974848.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void lithium_cell_find_signs_y(const lithium_cell_state *s, float *moves_y, float output_error,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = lithium_cell_within(output_error, 0.1295f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -476.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned lithium_cell_recover_y(lithium_cell_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= lithium_cell_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const bool t3 = t2 && (fault_limit_range > 952.0f || z1 < -0.44f || z1 > 1.44f
            || lithium_cell_abs(s->z[1]) > 1.0f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = lithium_cell_min(fault_limit_y, 487424.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = lithium_cell_min(2.0f*fault_limit_y, 974848.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = lithium_cell_min(fault_limit_range, 487424.0f);
            s->fault_limit_range = lithium_cell_min(2.0f*fault_limit_range, 974848.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.03f;
        s->z[1] = 0.0f;
        lithium_cell_fit_y(s, reading);
        lithium_cell_fit_y(s, reading);
        lithium_cell_fit_y(s, reading);
        /* the estimate has restarted from the sample */
        status |= LITHIUM_CELL_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 0.05f;
        s->D[1] = 0.1f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - lithium_cell_clamp(z1, 0.03f, 0.97f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - lithium_cell_limit(t3, 0.5f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 1.5f - z2 : z2 + 1.5f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 1.91f - z1 : z1 + 0.91f;
            const float t9 = lithium_cell_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = lithium_cell_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = lithium_cell_keep(z1 + t12*t7, -0.91f, 1.91f, z1, 1e+30f);
            s->z[1] = lithium_cell_keep(z2 + t12*t5, -1.5f, 1.5f, z2, 1e+30f);
            status |= LITHIUM_CELL_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned lithium_cell_count_faults_y(lithium_cell_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = lithium_cell_counts_spoiled_y(s);
    if (spoiled) {
        lithium_cell_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        moves_range = (z1 < -0.017f || z1 > 1.017f || lithium_cell_abs(s->z[1]) > 0.55f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = lithium_cell_clamp(fault_count_range + moves_range, 0.0f, 974848.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 952.0f : fault_limit_range;
    }
    lithium_cell_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = lithium_cell_clamp(lithium_cell_abs(fault_count_y) + moves_y, 0.0f, 974848.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 952.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= lithium_cell_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= lithium_cell_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 952.0f + lithium_cell_abs(s->fault_count_y)
        + (s->fault_limit_range - 952.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned lithium_cell_run_update_y(lithium_cell_state *s, const lithium_cell_params *p,
    const lithium_cell_output *measurement)
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
        status |= lithium_cell_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= lithium_cell_use_sample_y(s, p, e);
        }
        status |= lithium_cell_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = lithium_cell_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= lithium_cell_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= LITHIUM_CELL_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
LITHIUM_CELL_RARELY
static void lithium_cell_nominal(lithium_cell_params *p)
{
    p->ready = LITHIUM_CELL_READY;
    p->gain.Q[0] = 1e-08f;
    p->gain.Q[1] = 1e-06f;
    p->gain.R = 1e-06f;
}

unsigned lithium_cell_predict(lithium_cell_state *s, const lithium_cell_params *p,
    const lithium_cell_input *in)
{
    unsigned status = 0u;
    if ((s->ready != LITHIUM_CELL_READY) || (p->ready != LITHIUM_CELL_READY)) {
        status = lithium_cell_ready(s, p);
    }
    if ((status & LITHIUM_CELL_NO_PARAMETERS) == 0u) {
        status |= lithium_cell_run_predict(s, p, in);
    }
    return status;
}

unsigned lithium_cell_update_y(lithium_cell_state *s, const lithium_cell_params *p,
    const lithium_cell_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LITHIUM_CELL_READY) || (p->ready != LITHIUM_CELL_READY)) {
        status = lithium_cell_ready(s, p);
    }
    if ((status & LITHIUM_CELL_NO_PARAMETERS) == 0u) {
        status |= lithium_cell_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned lithium_cell_step(lithium_cell_state *s, const lithium_cell_params *p, const lithium_cell_input *in,
    const lithium_cell_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != LITHIUM_CELL_READY) || (p->ready != LITHIUM_CELL_READY)) {
        status = lithium_cell_ready(s, p);
    }
    if ((status & LITHIUM_CELL_NO_PARAMETERS) == 0u) {
        status |= lithium_cell_run_predict(s, p, in);
        status |= lithium_cell_run_update_y(s, p, measurement);
    }
    return status;
}

void lithium_cell_estimate(const lithium_cell_state *s, const lithium_cell_params *p, lithium_cell_plant *x)
{
    (void)p;
    /* the plant's state */
    x->soc = s->z[0];
    x->offset = s->z[1];
}

unsigned lithium_cell_tune(lithium_cell_params *p)
{
    unsigned status = 0u;
    if (p->ready != LITHIUM_CELL_READY) {
        lithium_cell_nominal(p);
        status = LITHIUM_CELL_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float R = p->gain.R;
        p->gain.Q[0] = lithium_cell_keep(Q1, 1e-14f, 1.0f, 1e-08f, 3e+38f);
        p->gain.Q[1] = lithium_cell_keep(Q2, 1e-14f, 1.0f, 1e-06f, 3e+38f);
        p->gain.R = lithium_cell_keep(R, 1e-12f, 1.0f, 1e-06f, 3e+38f);
        if (!(Q1 >= 1e-14f && Q1 <= 1.0f) || !(Q2 >= 1e-14f && Q2 <= 1.0f) || !(R >= 1e-12f && R <= 1.0f)) {
            status |= LITHIUM_CELL_PARAMETER_LIMITED;
        }
    }
    return status;
}

LITHIUM_CELL_RARELY
void lithium_cell_reset(lithium_cell_state *s)
{
    s->ready = LITHIUM_CELL_READY;
    s->z[0] = 0.03f;
    s->z[1] = 0.0f;
    s->L = 0.0f;
    s->D[0] = 0.05f;
    s->D[1] = 0.1f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    lithium_cell_clear_fault_counts(s);
}

void lithium_cell_init(lithium_cell_state *s, lithium_cell_params *p)
{
    lithium_cell_nominal(p);
    (void)lithium_cell_tune(p);
    lithium_cell_reset(s);
}

static const unsigned char lithium_cell_layout[8] = {0x03u, 0x2Bu, 0x8Eu, 0x31u, 0xF0u, 0xF9u, 0x1Au, 0xF6u};

/* CRC-32 of IEEE 802.3 */
static uint32_t lithium_cell_checksum(const unsigned char *bytes, size_t size)
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

void lithium_cell_save(const lithium_cell_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = lithium_cell_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = lithium_cell_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned lithium_cell_restore(lithium_cell_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == LITHIUM_CELL_SAVED) {
        refused = 0u;
        uint32_t sum = lithium_cell_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == lithium_cell_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = LITHIUM_CELL_READY;
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
