/* cstr: see cstr.h, and its manual cstr.md. */
#include "cstr.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(CSTR_USE_LIBM)
#include <math.h>
#elif defined(CSTR_USE_CMSIS)
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
#define CSTR_RARELY __attribute__((noinline))
#else
#define CSTR_RARELY
#endif

static float cstr_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float cstr_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool cstr_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float cstr_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool cstr_within(float v, float limit)
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
static float cstr_limit(float v, float most)
{
    return cstr_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float cstr_keep(float v, float low, float high, float otherwise, float limit)
{
    return cstr_within(v, limit) ? cstr_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define CSTR_USE_LIBM for those of <math.h>, or CSTR_USE_CMSIS for CMSIS-DSP. */
#if defined(CSTR_USE_LIBM)
static float cstr_exp(float x)
{
    return expf(x);
}

#elif defined(CSTR_USE_CMSIS)
static float cstr_exp(float x)
{
    return expf(x);
}

#else
/* whole number nearest to v, where |v| is below a third of 1.2582912e+07f: sums near that are rounded to
 * whole numbers */
static float cstr_nearest(float v)
{
#if !defined(__FLT_EVAL_METHOD__) || (__FLT_EVAL_METHOD__ != 0)
    const volatile float sum = v + 1.2582912e+07f;
    return sum - 1.2582912e+07f;
#else
    return v + 1.2582912e+07f - 1.2582912e+07f;
#endif
}

static float cstr_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

/* 2^x for whole x, where that is a normal number */
static float cstr_power_of_two(float x)
{
#if defined(__GNUC__) && !defined(__FRAMAC__) && (__SIZEOF_DOUBLE__ == 8)
    const float sum = x + 1.2583039e+07f;
    uint32_t bits;
    float power;
    (void)__builtin_memcpy(&bits, &sum, sizeof(bits));
    bits <<= 23u;
    (void)__builtin_memcpy(&power, &bits, sizeof(power));
    return power;
#else
    const float t1 = 5.421011e-20f + ((x >= 0.0f) ? 1.0f : 0.0f);
    const float t2 = x + ((x < 0.0f) ? 128.0f : 0.0f);
    const bool t3 = t2 >= 64.0f;
    const float t4 = t2 - (t3 ? 64.0f : 0.0f);
    const bool t5 = t4 >= 32.0f;
    const float t6 = t4 - (t5 ? 32.0f : 0.0f);
    const bool t7 = t6 >= 16.0f;
    const float t8 = (1.0f + (t3 ? 1.8446744e+19f : 0.0f))*(1.0f + (t5 ? 4.2949673e+09f : 0.0f))*
        (1.0f + (t7 ? 65535.0f : 0.0f));
    const float t9 = t6 - (t7 ? 16.0f : 0.0f);
    const bool t10 = t9 >= 8.0f;
    const float t11 = t9 - (t10 ? 8.0f : 0.0f);
    const bool t12 = t11 >= 4.0f;
    const float t13 = t11 - (t12 ? 4.0f : 0.0f);
    const bool t14 = t13 >= 2.0f;
    const float t15 = t8*(1.0f + (t10 ? 255.0f : 0.0f))*(1.0f + (t12 ? 15.0f : 0.0f))*
        (1.0f + (t14 ? 3.0f : 0.0f))*(1.0f + ((t13 - (t14 ? 2.0f : 0.0f) >= 1.0f) ? 1.0f : 0.0f));
    return t1*t15*t1;
#endif
}

static float cstr_exp(float x)
{
    const float t1 = cstr_nearest((x*x < 16384.0f) ? 1.442695f*x : 0.0f);
    const float t2 = x - 0.69314575f*t1 - 1.4286068e-06f*t1;
    const float t3 = t2 + t2*t2*(0.5f + t2*(((0.0013940646f*t2 + 0.008366435f)*t2 + 0.041666403f)*t2
        + 0.16666545f));
    const float t4 = cstr_nearest(0.5f*t1);
    return (x > 88.896126f) ? cstr_inf() : ((x < -87.33655f) ? 0.0f
        : (1.0f + t3)*cstr_power_of_two(t4)*cstr_power_of_two(t1 - t4));
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void cstr_flow(float z1, float z2, float u, float dz[2])
{
    const float t1 = cstr_clamp(z1, 300.0f, 350.0f);
    const float t2 = cstr_exp(-8750.0f/t1);
    const float t3 = cstr_clamp(z2, 0.05f, 1.0f);
    dz[0] = 2.09f*u - 3.09f*t1 + 350.0f + 1.50624e+13f*t2*z2;
    dz[1] = 1.0f - (t3 + t3*t2*7.2e+10f);
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void cstr_jacobian(float z1, float z2, float F[4])
{
    const float t1 = cstr_clamp(z2, 0.05f, 1.0f);
    const float t2 = cstr_clamp(z1, 300.0f, 350.0f);
    const float t3 = -8750.0f/t2;
    const float t4 = cstr_exp(t3);
    const float t5 = t3/t2*t4;
    F[0] = -3.09f - 1.50624e+13f*t5*t1; /* F_11 */
    F[1] = t1*t5*7.2e+10f; /* F_21 */
    F[2] = 1.50624e+13f*t4; /* F_12 */
    F[3] = -(1.0f + 7.2e+10f*t4); /* F_22 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
CSTR_RARELY
static unsigned cstr_ready(cstr_state *s, const cstr_params *p)
{
    unsigned status = 0u;
    if (s->ready != CSTR_READY) {
        cstr_reset(s);
        status |= CSTR_UNINITIALISED;
    }
    if (p->ready != CSTR_READY) {
        cstr_reset(s);
        status |= CSTR_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
CSTR_RARELY
static void cstr_clear_fault_counts(cstr_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 239.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 239.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned cstr_keep_in_box(cstr_state *s, const cstr_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = cstr_within(s->z[0], 1e+30f) && cstr_within(s->z[1], 1e+30f)
            && cstr_within(s->L, 1e+30f) && cstr_within(s->D[0], 1e+30f);
        lost = !(t1 && cstr_within(s->D[1], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 300.0f;
        s->z[1] = 0.05f;
        status |= CSTR_RESTARTED;
        cstr_clear_fault_counts(s);
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 2000.0f;
        s->D[1] = 0.2f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = cstr_clamp(z1, 250.0f, 400.0f);
        s->z[1] = cstr_clamp(z2, -0.9f, 1.95f);
        if (z1 < 250.0f || z1 > 400.0f || z2 < -0.9f || z2 > 1.95f) {
            status |= CSTR_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = cstr_limit(L21, 1.5931984e+07f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = cstr_clamp(D1, 2e-15f, 8000.0f);
        s->D[1] = cstr_clamp(D2, 4.5e-18f, 2.030625f);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned cstr_run_predict(cstr_state *s, const cstr_params *p, const cstr_input *in)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = cstr_clamp(u_before, 280.0f, 320.0f);
    }
    /* guard the input */
    {
        const float Tc = in->Tc;
        const bool Tc_usable = cstr_within(Tc, 1e+15f);
        const float Tc_taken = Tc_usable ? Tc : s->u;
        u = cstr_clamp(Tc_taken, 280.0f, 320.0f);
        if (!Tc_usable) {
            status |= CSTR_REUSED_TC;
        }
        if (Tc_taken < 280.0f || Tc_taken > 320.0f) {
            status |= CSTR_CLAMPED_TC;
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
            cstr_flow(z1, z2, u_before, k1_z);
            const float t1 = u_before + 0.5f*(u - u_before);
            float k2_z[2];
            cstr_flow(z1 + 0.0025f*k1_z[0], z2 + 0.0025f*k1_z[1], t1, k2_z);
            const float t2 = z1 + 0.0025f*k2_z[0];
            const float t3 = z2 + 0.0025f*k2_z[1];
            float k3_z[2];
            cstr_flow(t2, t3, t1, k3_z);
            float k4_z[2];
            cstr_flow(z1 + 0.005f*k3_z[0], z2 + 0.005f*k3_z[1], u, k4_z);
            float F_1[4];
            cstr_jacobian(t2, t3, F_1);
            const float Phi_11 = 1.0f + 0.005f*F_1[0] + 1.25e-05f*(F_1[0]*F_1[0] + F_1[2]*F_1[1]);
            const float Phi_12 = 0.005f*F_1[2] + 1.25e-05f*(F_1[0]*F_1[2] + F_1[2]*F_1[3]);
            const float Phi_21 = 0.005f*F_1[1] + 1.25e-05f*(F_1[1]*F_1[0] + F_1[3]*F_1[1]);
            const float Phi_22 = 1.0f + 0.005f*F_1[3] + 1.25e-05f*(F_1[1]*F_1[2] + F_1[3]*F_1[3]);
            const float w1_1 = Phi_11 + Phi_12*L21;
            const float t4 = w1_1*D1;
            const float t5 = Phi_12*D2;
            const float t6 = 0.005f*p->gain.Q[0];
            const float d1 = w1_1*t4 + Phi_12*t5 + t6;
            const float t7 = Phi_21 + Phi_22*L21;
            const float l21 = (t7*t4 + Phi_22*t5)/d1;
            const float w2_1 = t7 - l21*w1_1;
            const float w2_2 = Phi_22 - l21*Phi_12;
            const float d2 = w2_1*D1*w2_1 + w2_2*D2*w2_2 + l21*t6*l21 + 0.005f*p->gain.Q[1];
            s->z[0] = z1 + 0.00083333335f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
            s->z[1] = z2 + 0.00083333335f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
            s->L = l21;
            s->D[0] = d1;
            s->D[1] = d2;
        }
        /* largest variances */
        {
            const float D1 = s->D[0];
            const float L21 = s->L;
            capped = D1 > 8000.0f || L21*L21*D1 + s->D[1] > 2.030625f;
        }
        if (capped) {
            /* cap */
            {
                const float D1 = s->D[0];
                const float D2 = s->D[1];
                const float L21 = s->L;
                const float t1 = cstr_min(1.0f, 2.030625f/(L21*L21*D1 + D2));
                const float t2 = cstr_min(1.0f, 8000.0f/D1);
                s->L = t1*L21/t2;
                s->D[0] = t2*t2*D1;
                s->D[1] = t1*t1*D2;
                status |= CSTR_COVARIANCE_LIMITED;
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const bool t1 = z1 >= 250.0f && z1 <= 400.0f && z2 >= -0.9f && z2 <= 1.95f
                && cstr_within(s->L, 1.5931984e+07f);
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            beyond = !(t1 && D1 >= 2e-15f && D1 <= 8000.0f && D2 >= 4.5e-18f && D2 <= 2.030625f);
        }
        if (cstr_acts(beyond)) {
            status |= cstr_keep_in_box(s, p);
        }
    } else {
        status |= cstr_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned cstr_guard_measurement_y(const cstr_state *s, float *e, float *output_error, float reading,
    bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= 250.0f && reading <= 400.0f && cstr_within(t1, 1e+16f);
        const bool t3 = cstr_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= CSTR_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= CSTR_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned cstr_use_sample_y(cstr_state *s, const cstr_params *p, float e)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = p->gain.R/0.005f;
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
        beyond = !(z1 >= 250.0f && z1 <= 400.0f && z2 >= -0.9f && z2 <= 1.95f && D1 >= 2e-15f
            && D1 <= 8000.0f);
    }
    if (cstr_acts(beyond)) {
        status |= cstr_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned cstr_suspect_y(const cstr_state *s, float output_error, bool *suspect, bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 300.0f || z1 > 350.0f || z2 < 0.05f || z2 > 1.0f;
        if (t1) {
            status |= CSTR_OUTSIDE_BOX;
        }
        *suspect = cstr_abs(output_error) > 5.0f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool cstr_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= 250.0f && reading <= 400.0f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool cstr_counts_spoiled_y(const cstr_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 239.0f + cstr_abs(fault_count_y)
            + (fault_limit_range - 239.0f + fault_count_range);
        const bool t2 = cstr_abs(t1 - s->fault_checksum) < 0.5f && cstr_within(fault_count_y, 244736.0f)
            && fault_limit_y >= 239.0f && fault_limit_y <= 244736.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 244736.0f
            && fault_limit_range >= 239.0f && fault_limit_range <= 244736.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void cstr_find_signs_y(const cstr_state *s, float *moves_y, float output_error, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = cstr_within(output_error, 5.0f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -119.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned cstr_recover_y(cstr_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= cstr_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t3 = t2 && (fault_limit_range > 239.0f || z1 < 275.0f || z1 > 375.0f || z2 < -0.425f
            || z2 > 1.475f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = cstr_min(fault_limit_y, 122368.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = cstr_min(2.0f*fault_limit_y, 244736.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = cstr_min(fault_limit_range, 122368.0f);
            s->fault_limit_range = cstr_min(2.0f*fault_limit_range, 244736.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 300.0f;
        s->z[1] = 0.05f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = cstr_keep(reading, 300.0f, 350.0f, z1, 1e+30f);
            s->z[1] = cstr_keep(z2, 0.05f, 1.0f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= CSTR_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->L = 0.0f;
        s->D[0] = 2000.0f;
        s->D[1] = 0.2f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - cstr_clamp(z1, 300.0f, 350.0f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - cstr_clamp(t3, 0.05f, 1.0f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 1.95f - z2 : z2 + 0.9f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 400.0f - z1 : z1 - 250.0f;
            const float t9 = cstr_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = cstr_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = cstr_keep(z1 + t12*t7, 250.0f, 400.0f, z1, 1e+30f);
            s->z[1] = cstr_keep(z2 + t12*t5, -0.9f, 1.95f, z2, 1e+30f);
            status |= CSTR_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned cstr_count_faults_y(cstr_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = cstr_counts_spoiled_y(s);
    if (spoiled) {
        cstr_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        moves_range = (z1 < 297.5f || z1 > 352.5f || z2 < 0.0025f || z2 > 1.0475f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = cstr_clamp(fault_count_range + moves_range, 0.0f, 244736.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 239.0f : fault_limit_range;
    }
    cstr_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = cstr_clamp(cstr_abs(fault_count_y) + moves_y, 0.0f, 244736.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 239.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= cstr_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= cstr_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 239.0f + cstr_abs(s->fault_count_y)
        + (s->fault_limit_range - 239.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned cstr_run_update_y(cstr_state *s, const cstr_params *p, const cstr_output *measurement)
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
        status |= cstr_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= cstr_use_sample_y(s, p, e);
        }
        status |= cstr_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = cstr_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= cstr_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= CSTR_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
CSTR_RARELY
static void cstr_nominal(cstr_params *p)
{
    p->ready = CSTR_READY;
    p->gain.Q[0] = 10.0f;
    p->gain.Q[1] = 0.0009f;
    p->gain.R = 1e-05f;
}

unsigned cstr_predict(cstr_state *s, const cstr_params *p, const cstr_input *in)
{
    unsigned status = 0u;
    if ((s->ready != CSTR_READY) || (p->ready != CSTR_READY)) {
        status = cstr_ready(s, p);
    }
    if ((status & CSTR_NO_PARAMETERS) == 0u) {
        status |= cstr_run_predict(s, p, in);
    }
    return status;
}

unsigned cstr_update_y(cstr_state *s, const cstr_params *p, const cstr_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CSTR_READY) || (p->ready != CSTR_READY)) {
        status = cstr_ready(s, p);
    }
    if ((status & CSTR_NO_PARAMETERS) == 0u) {
        status |= cstr_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned cstr_step(cstr_state *s, const cstr_params *p, const cstr_input *in, const cstr_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CSTR_READY) || (p->ready != CSTR_READY)) {
        status = cstr_ready(s, p);
    }
    if ((status & CSTR_NO_PARAMETERS) == 0u) {
        status |= cstr_run_predict(s, p, in);
        status |= cstr_run_update_y(s, p, measurement);
    }
    return status;
}

void cstr_estimate(const cstr_state *s, const cstr_params *p, cstr_plant *x)
{
    (void)p;
    /* the plant's state */
    x->C = s->z[1];
    x->T = s->z[0];
}

unsigned cstr_tune(cstr_params *p)
{
    unsigned status = 0u;
    if (p->ready != CSTR_READY) {
        cstr_nominal(p);
        status = CSTR_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float R = p->gain.R;
        p->gain.Q[0] = cstr_keep(Q1, 9e-10f, 1e+07f, 10.0f, 3e+38f);
        p->gain.Q[1] = cstr_keep(Q2, 9e-10f, 1e+07f, 0.0009f, 3e+38f);
        p->gain.R = cstr_keep(R, 1e-11f, 10.0f, 1e-05f, 3e+38f);
        if (!(Q1 >= 9e-10f && Q1 <= 1e+07f) || !(Q2 >= 9e-10f && Q2 <= 1e+07f)
            || !(R >= 1e-11f && R <= 10.0f)) {
            status |= CSTR_PARAMETER_LIMITED;
        }
    }
    return status;
}

CSTR_RARELY
void cstr_reset(cstr_state *s)
{
    s->ready = CSTR_READY;
    s->z[0] = 300.0f;
    s->z[1] = 0.05f;
    s->L = 0.0f;
    s->D[0] = 2000.0f;
    s->D[1] = 0.2f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 280.0f;
    cstr_clear_fault_counts(s);
}

void cstr_init(cstr_state *s, cstr_params *p)
{
    cstr_nominal(p);
    (void)cstr_tune(p);
    cstr_reset(s);
}

static const unsigned char cstr_layout[8] = {0x74u, 0x86u, 0x95u, 0x47u, 0x8Bu, 0x76u, 0xB9u, 0x34u};

/* CRC-32 of IEEE 802.3 */
static uint32_t cstr_checksum(const unsigned char *bytes, size_t size)
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

void cstr_save(const cstr_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = cstr_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = cstr_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned cstr_restore(cstr_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == CSTR_SAVED) {
        refused = 0u;
        uint32_t sum = cstr_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == cstr_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = CSTR_READY;
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
