/* cascaded_tanks: see cascaded_tanks.h, and its manual cascaded_tanks.md. */
#include "cascaded_tanks.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(CASCADED_TANKS_USE_LIBM)
#include <math.h>
#elif defined(CASCADED_TANKS_USE_CMSIS)
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
#define CASCADED_TANKS_RARELY __attribute__((noinline))
#else
#define CASCADED_TANKS_RARELY
#endif

static float cascaded_tanks_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float cascaded_tanks_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float cascaded_tanks_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool cascaded_tanks_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float cascaded_tanks_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool cascaded_tanks_within(float v, float limit)
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
static float cascaded_tanks_limit(float v, float most)
{
    return cascaded_tanks_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float cascaded_tanks_keep(float v, float low, float high, float otherwise, float limit)
{
    return cascaded_tanks_within(v, limit) ? cascaded_tanks_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define CASCADED_TANKS_USE_LIBM for those of <math.h>, or CASCADED_TANKS_USE_CMSIS for CMSIS-DSP. */
#if defined(CASCADED_TANKS_USE_LIBM)
static float cascaded_tanks_sqrt(float x)
{
    return sqrtf(x);
}

static float cascaded_tanks_exp(float x)
{
    return expf(x);
}

#elif defined(CASCADED_TANKS_USE_CMSIS)
static float cascaded_tanks_sqrt(float x)
{
    return sqrtf(x);
}

static float cascaded_tanks_exp(float x)
{
    return expf(x);
}

#else
/* whole number nearest to v, where |v| is below a third of 1.2582912e+07f: sums near that are rounded to
 * whole numbers */
static float cascaded_tanks_nearest(float v)
{
#if !defined(__FLT_EVAL_METHOD__) || (__FLT_EVAL_METHOD__ != 0)
    const volatile float sum = v + 1.2582912e+07f;
    return sum - 1.2582912e+07f;
#else
    return v + 1.2582912e+07f - 1.2582912e+07f;
#endif
}

static float cascaded_tanks_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float cascaded_tanks_nan(void)
{
    const float large = cascaded_tanks_inf();
    return large - large;
}

/* 2^x for whole x, where that is a normal number */
static float cascaded_tanks_power_of_two(float x)
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

static float cascaded_tanks_sqrt(float x)
{
    const float t1 = x*(1.0f + ((x < 1.0f) ? 8.507059e+37f : 0.0f));
    const bool t2 = t1 < 1.8446744e+19f;
    const float t3 = t1*(5.421011e-20f + (t2 ? 1.0f : 0.0f));
    const bool t4 = t3 < 4.2949673e+09f;
    const float t5 = t3*(2.3283064e-10f + (t4 ? 1.0f : 0.0f));
    const bool t6 = t5 < 65536.0f;
    const float t7 = t5*(1.5258789e-05f + (t6 ? 0.99998474f : 0.0f));
    const bool t8 = t7 < 256.0f;
    const float t9 = t7*(0.00390625f + (t8 ? 0.99609375f : 0.0f));
    const bool t10 = t9 < 16.0f;
    const float t11 = t9*(0.0625f + (t10 ? 0.9375f : 0.0f));
    const float t12 = 0.22222222f*t11 + 0.8888889f;
    const float t13 = 0.5f*(t12 + t11/t12);
    const float t14 = 0.5f*(t13 + t11/t13);
    const float t15 = (2.3283064e-10f + (t2 ? 1.0f : 0.0f))*(1.5258789e-05f + (t4 ? 0.99998474f : 0.0f))*
        (0.00390625f + (t6 ? 0.99609375f : 0.0f));
    const float t16 = 0.5f*(t14 + t11/t14)/(t15*(0.0625f + (t8 ? 0.9375f : 0.0f))*
        (0.25f + (t10 ? 0.75f : 0.0f)))*(1.0842022e-19f + ((x >= 1.0f) ? 1.0f : 0.0f));
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? cascaded_tanks_nan() : 0.0f)
        : ((x > 3.4028235e+38f) ? x : t16);
}

static float cascaded_tanks_exp(float x)
{
    const float t1 = cascaded_tanks_nearest((x*x < 16384.0f) ? 1.442695f*x : 0.0f);
    const float t2 = x - 0.69314575f*t1 - 1.4286068e-06f*t1;
    const float t3 = t2 + t2*t2*(0.5f + t2*(((0.0013940646f*t2 + 0.008366435f)*t2 + 0.041666403f)*t2
        + 0.16666545f));
    const float t4 = cascaded_tanks_nearest(0.5f*t1);
    const float t5 = (x < -87.33655f) ? 0.0f
        : (1.0f + t3)*cascaded_tanks_power_of_two(t4)*cascaded_tanks_power_of_two(t1 - t4);
    return (x > 88.896126f) ? cascaded_tanks_inf() : t5;
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void cascaded_tanks_flow(float z1, float z2, float u, float dz[2])
{
    dz[0] = 0.05646f*z2 - 0.04425f*cascaded_tanks_sqrt(cascaded_tanks_clamp(z1, 0.25f, 11.0f));
    dz[1] = u/cascaded_tanks_clamp(z2, 0.52f, 3.1623f)*0.018575f - 0.02823f;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void cascaded_tanks_jacobian(float z1, float z2, float u, float F[2])
{
    const float t1 = cascaded_tanks_clamp(z2, 0.52f, 3.1623f);
    F[0] = -0.04425f/(2.0f*cascaded_tanks_sqrt(cascaded_tanks_clamp(z1, 0.25f, 11.0f))); /* F_11 */
    F[1] = -(u/t1/t1*0.018575f); /* F_22 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
CASCADED_TANKS_RARELY
static unsigned cascaded_tanks_ready(cascaded_tanks_state *s, const cascaded_tanks_params *p)
{
    unsigned status = 0u;
    if (s->ready != CASCADED_TANKS_READY) {
        cascaded_tanks_reset(s);
        status |= CASCADED_TANKS_UNINITIALISED;
    }
    if (p->ready != CASCADED_TANKS_READY) {
        cascaded_tanks_reset(s);
        status |= CASCADED_TANKS_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
CASCADED_TANKS_RARELY
static void cascaded_tanks_clear_fault_counts(cascaded_tanks_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 30.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 30.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
CASCADED_TANKS_RARELY
static void cascaded_tanks_clear_rest(cascaded_tanks_state *s)
{
    /* as after a reset */
    s->L = 0.0f;
    s->D[0] = 0.25f;
    s->D[1] = 0.25f;
    s->innovation = 0.0f;
    s->theta = 1.0f;
    /* counters as after a reset */
    s->oldest = 0u;
    s->tick = 0u;
    for (unsigned k = 0u; k < 5u; ++k) {
        cascaded_tanks_predictor *const predictor = &s->predictor[k];
        /* from the estimate */
        predictor->z[0] = s->z[0];
        predictor->z[1] = s->z[1];
        /* as after a reset */
        predictor->sum = 0.0f;
        /* counters as after a reset */
        predictor->samples = 0u;
    }
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned cascaded_tanks_keep_in_box(cascaded_tanks_state *s, const cascaded_tanks_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = cascaded_tanks_within(s->z[0], 1e+30f) && cascaded_tanks_within(s->z[1], 1e+30f)
            && cascaded_tanks_within(s->L, 1e+30f);
        const bool t2 = t1 && cascaded_tanks_within(s->D[0], 1e+30f)
            && cascaded_tanks_within(s->D[1], 1e+30f) && cascaded_tanks_within(s->innovation, 1e+30f);
        lost = !(t2 && cascaded_tanks_within(s->theta, 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 5.0f;
        s->z[1] = 1.7525125f;
        status |= CASCADED_TANKS_RESTARTED;
        cascaded_tanks_clear_fault_counts(s);
        cascaded_tanks_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = cascaded_tanks_clamp(z1, -10.5f, 21.75f);
        s->z[1] = cascaded_tanks_clamp(z2, -3.44345f, 7.12575f);
        if (z1 < -10.5f || z1 > 21.75f || z2 < -3.44345f || z2 > 7.12575f) {
            status |= CASCADED_TANKS_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L;
        s->L = cascaded_tanks_limit(L21, 3.2772714e+08f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        s->D[0] = cascaded_tanks_clamp(D1, 1e-16f, 260.01562f);
        s->D[1] = cascaded_tanks_clamp(D2, 5.6e-15f, 27.926996f);
    }
    /* keep innovation in its box */
    {
        const float innovation = s->innovation;
        s->innovation = cascaded_tanks_clamp(innovation, 0.0f, 1e+30f);
    }
    /* keep theta in its box */
    {
        const float theta = s->theta;
        s->theta = cascaded_tanks_clamp(theta, 1.0f, 4.0f);
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned cascaded_tanks_guard_input(const cascaded_tanks_state *s, const cascaded_tanks_input *in,
    float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = cascaded_tanks_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = cascaded_tanks_clamp(u_taken, 0.0f, 7.0f);
        if (!u_usable) {
            status |= CASCADED_TANKS_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 7.0f) {
            status |= CASCADED_TANKS_CLAMPED_U;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned cascaded_tanks_advance(cascaded_tanks_state *s, const cascaded_tanks_params *p, float u)
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
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float u_before = s->u;
        float k1_z[2];
        cascaded_tanks_flow(z1, z2, u_before, k1_z);
        const float t1 = u_before + 0.5f*(u - u_before);
        float k2_z[2];
        cascaded_tanks_flow(z1 + 2.0f*k1_z[0], z2 + 2.0f*k1_z[1], t1, k2_z);
        const float t2 = 2.0f*k2_z[0];
        const float t3 = z1 + t2;
        const float t4 = 2.0f*k2_z[1];
        const float t5 = z2 + t4;
        float k3_z[2];
        cascaded_tanks_flow(t3, t5, t1, k3_z);
        float k4_z[2];
        cascaded_tanks_flow(z1 + 4.0f*k3_z[0], z2 + 4.0f*k3_z[1], u, k4_z);
        float F_1[2];
        cascaded_tanks_jacobian(t3, t5, t1, F_1);
        const float Phi_11 = 1.0f + 4.0f*F_1[0] + F_1[0]*F_1[0]*8.0f;
        const float Phi_12 = 0.22584f + 8.0f*(0.05646f*F_1[0] + 0.05646f*F_1[1]);
        const float Phi_22 = 1.0f + 4.0f*F_1[1] + F_1[1]*F_1[1]*8.0f;
        const float w1_1 = Phi_11 + Phi_12*L21;
        const float t6 = w1_1*D1;
        const float t7 = Phi_12*D2;
        const float theta = s->theta;
        const float t8 = 4.0f*theta;
        const float t9 = t8*p->gain.Q[0];
        const float d1 = w1_1*t6 + Phi_12*t7 + t9;
        const float t10 = Phi_22*L21;
        const float l21 = (t10*t6 + Phi_22*t7)/d1;
        const float w2_1 = t10 - l21*w1_1;
        const float w2_2 = Phi_22 - l21*Phi_12;
        const float d2 = w2_1*D1*w2_1 + w2_2*D2*w2_2 + l21*t9*l21 + t8*p->gain.Q[1]*theta*theta;
        s->z[0] = z1 + 0.6666667f*(k1_z[0] + t2 + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 0.6666667f*(k1_z[1] + t4 + 2.0f*k3_z[1] + k4_z[1]);
        s->L = l21;
        s->D[0] = d1;
        s->D[1] = d2;
    }
    /* largest variances */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        capped = D1 > 260.01562f || L21*L21*D1 + s->D[1] > 27.926996f;
    }
    if (capped) {
        /* cap */
        {
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float L21 = s->L;
            const float t1 = cascaded_tanks_min(1.0f, 27.926996f/(L21*L21*D1 + D2));
            const float t2 = cascaded_tanks_min(1.0f, 260.01562f/D1);
            s->L = t1*L21/t2;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            status |= CASCADED_TANKS_COVARIANCE_LIMITED;
        }
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        cascaded_tanks_predictor *const predictor = &s->predictor[k];
        /* each predictor by Heun, without correction */
        {
            const float z1 = predictor->z[0];
            const float z2 = predictor->z[1];
            float dz_1[2];
            cascaded_tanks_flow(z1, z2, s->u, dz_1);
            float dz_2[2];
            cascaded_tanks_flow(z1 + 4.0f*dz_1[0], z2 + 4.0f*dz_1[1], u, dz_2);
            predictor->z[0] = z1 + 2.0f*(dz_1[0] + dz_2[0]);
            predictor->z[1] = z2 + 2.0f*(dz_1[1] + dz_2[1]);
        }
        /* is it beyond its box, or lost? */
        {
            const float z1 = predictor->z[0];
            const float z2 = predictor->z[1];
            beyond = !(z1 >= -10.5f && z1 <= 21.75f && z2 >= -3.44345f && z2 <= 7.12575f);
        }
        if (cascaded_tanks_acts(beyond)) {
            /* keep it in its box */
            {
                const float z1 = predictor->z[0];
                const float z2 = predictor->z[1];
                predictor->z[0] = cascaded_tanks_keep(z1, -10.5f, 21.75f, 5.0f, 1e+15f);
                predictor->z[1] = cascaded_tanks_keep(z2, -3.44345f, 7.12575f, 1.7525125f, 1e+15f);
            }
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 >= -10.5f && z1 <= 21.75f && z2 >= -3.44345f && z2 <= 7.12575f
            && cascaded_tanks_within(s->L, 3.2772714e+08f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        beyond = !(t1 && D1 >= 1e-16f && D1 <= 260.01562f && D2 >= 5.6e-15f && D2 <= 27.926996f);
    }
    if (cascaded_tanks_acts(beyond)) {
        status |= cascaded_tanks_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned cascaded_tanks_run_predict(cascaded_tanks_state *s, const cascaded_tanks_params *p,
    const cascaded_tanks_input *in)
{
    unsigned status = 0u;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = cascaded_tanks_clamp(u_before, 0.0f, 7.0f);
    }
    status |= cascaded_tanks_guard_input(s, in, &u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = (calls < 2u) ? calls + 1u : 2u;
    }
    if (running) {
        status |= cascaded_tanks_advance(s, p, u);
    } else {
        status |= cascaded_tanks_keep_in_box(s, p);
        for (unsigned k = 0u; k < 5u; ++k) {
            cascaded_tanks_predictor *const predictor = &s->predictor[k];
            /* from the estimate */
            predictor->z[0] = s->z[0];
            predictor->z[1] = s->z[1];
        }
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned cascaded_tanks_guard_measurement_y(const cascaded_tanks_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -10.0f && reading <= 20.0f && cascaded_tanks_within(t1, 1e+16f);
        const bool t3 = cascaded_tanks_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= CASCADED_TANKS_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= CASCADED_TANKS_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned cascaded_tanks_use_sample_y(cascaded_tanks_state *s, const cascaded_tanks_params *p, float e,
    float reading)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float t1 = p->gain.R/(4.0f*s->theta);
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->D[0] = K1*t1;
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        cascaded_tanks_predictor *const predictor = &s->predictor[k];
        /* its squared output error */
        {
            const float sum = predictor->sum;
            const float t1 = reading - predictor->z[0];
            predictor->sum = cascaded_tanks_min(sum + 4.0f*t1*t1, 1e+30f);
        }
        /* one more sample */
        {
            const unsigned samples = predictor->samples;
            predictor->samples = (samples < 11u) ? samples + 1u : 11u;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float D1 = s->D[0];
        const bool t1 = z1 >= -10.5f && z1 <= 21.75f && z2 >= -3.44345f && z2 <= 7.12575f && D1 >= 1e-16f
            && D1 <= 260.01562f;
        beyond = !t1;
    }
    if (cascaded_tanks_acts(beyond)) {
        status |= cascaded_tanks_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned cascaded_tanks_suspect_y(const cascaded_tanks_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 0.25f || z1 > 11.0f || z2 < 0.52f || z2 > 3.1623f;
        if (t1) {
            status |= CASCADED_TANKS_OUTSIDE_BOX;
        }
        *suspect = cascaded_tanks_abs(output_error) > 1.0f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool cascaded_tanks_sample_in_plausible_range_y(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -10.0f && reading <= 20.0f);
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool cascaded_tanks_counts_spoiled_y(const cascaded_tanks_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 30.0f + cascaded_tanks_abs(fault_count_y)
            + (fault_limit_range - 30.0f + fault_count_range);
        const bool t2 = cascaded_tanks_abs(t1 - s->fault_checksum) < 0.5f
            && cascaded_tanks_within(fault_count_y, 30720.0f);
        const bool t3 = t2 && fault_limit_y >= 30.0f && fault_limit_y <= 30720.0f
            && fault_count_range >= 0.0f && fault_count_range <= 30720.0f;
        spoiled = !(t3 && fault_limit_range >= 30.0f && fault_limit_range <= 30720.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void cascaded_tanks_find_signs_y(const cascaded_tanks_state *s, float *moves_y, float output_error,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = cascaded_tanks_within(output_error, 1.0f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -12.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned cascaded_tanks_recover_y(cascaded_tanks_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= cascaded_tanks_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t3 = t2 && (fault_limit_range > 30.0f || z1 < -5.125f || z1 > 16.375f || z2 < -0.80115f
            || z2 > 4.48345f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = cascaded_tanks_min(fault_limit_y, 15360.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = cascaded_tanks_min(2.0f*fault_limit_y, 30720.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = cascaded_tanks_min(fault_limit_range, 15360.0f);
            s->fault_limit_range = cascaded_tanks_min(2.0f*fault_limit_range, 30720.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 5.0f;
        s->z[1] = 1.7525125f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = cascaded_tanks_keep(reading, 0.25f, 11.0f, z1, 1e+30f);
            s->z[1] = cascaded_tanks_keep(z2, 0.52f, 3.1623f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= CASCADED_TANKS_RESTARTED_FROM_SAMPLE;
        cascaded_tanks_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float L21 = s->L;
            const float D1 = s->D[0];
            const float t1 = L21*D1;
            const float t2 = z1 - cascaded_tanks_clamp(z1, 0.25f, 11.0f);
            const float t3 = z2 - t2/D1*t1;
            const float t4 = t3 - cascaded_tanks_clamp(t3, 0.52f, 3.1623f);
            const float t5 = t3 - t4 - z2;
            const float t6 = (t5 > 0.0f) ? 7.12575f - z2 : z2 + 3.44345f;
            const float t7 = z1 - t2 - D1*L21*(t4/(t1*L21 + s->D[1])) - z1;
            const float t8 = (t7 > 0.0f) ? 21.75f - z1 : z1 + 10.5f;
            const float t9 = cascaded_tanks_abs(t7);
            const float t10 = (t8 < t9) ? t8/t9 : 1.0f;
            const float t11 = cascaded_tanks_abs(t5);
            const float t12 = (t6 < t10*t11) ? t6/t11 : t10;
            s->z[0] = cascaded_tanks_keep(z1 + t12*t7, -10.5f, 21.75f, z1, 1e+30f);
            s->z[1] = cascaded_tanks_keep(z2 + t12*t5, -3.44345f, 7.12575f, z2, 1e+30f);
            status |= CASCADED_TANKS_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned cascaded_tanks_count_faults_y(cascaded_tanks_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = cascaded_tanks_counts_spoiled_y(s);
    if (spoiled) {
        cascaded_tanks_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        moves_range = (z1 < -0.2875f || z1 > 11.5375f || z2 < 0.387885f || z2 > 3.294415f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = cascaded_tanks_clamp(fault_count_range + moves_range, 0.0f, 30720.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 30.0f : fault_limit_range;
    }
    cascaded_tanks_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = cascaded_tanks_clamp(cascaded_tanks_abs(fault_count_y) + moves_y, 0.0f, 30720.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 30.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= cascaded_tanks_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= cascaded_tanks_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 30.0f + cascaded_tanks_abs(s->fault_count_y)
        + (s->fault_limit_range - 30.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned cascaded_tanks_run_update_y(cascaded_tanks_state *s, const cascaded_tanks_params *p,
    const cascaded_tanks_output *measurement)
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
        status |= cascaded_tanks_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= cascaded_tanks_use_sample_y(s, p, e, reading);
        }
        status |= cascaded_tanks_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = cascaded_tanks_sample_in_plausible_range_y(reading, valid);
            if (sampled) {
                status |= cascaded_tanks_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= CASCADED_TANKS_OUT_OF_ORDER;
    }
    return status;
}

/* part of a step: adapt the gain; once after the updates */
static unsigned cascaded_tanks_run_adapt(cascaded_tanks_state *s, const cascaded_tanks_params *p)
{
    unsigned status = 0u;
    bool beyond = false;
    bool moves = false;
    float mu = 0.0f;
    bool restart = false;
    bool running = false;
    /* no time has passed before the second call */
    running = s->calls >= 2u;
    if (running) {
        {
            cascaded_tanks_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
            /* innovation: the sum of the oldest predictor, scaled to the window, never scaled up */
            s->innovation = 8.0f/cascaded_tanks_max((float)predictor->samples, 8.0f)*predictor->sum;
        }
        /* one predictor restarts every 2 samples */
        {
            const unsigned tick = s->tick;
            const unsigned t1 = tick + 1u;
            const bool t2 = t1 >= 2u;
            restart = t2;
            s->tick = t2 ? 0u : t1;
        }
        if (restart) {
            {
                cascaded_tanks_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
                /* the oldest predictor restarts from the estimate */
                predictor->z[0] = s->z[0];
                predictor->z[1] = s->z[1];
                predictor->sum = 0.0f;
                /* no sample yet */
                predictor->samples = 0u;
            }
            /* the next one is the oldest */
            {
                const unsigned oldest = s->oldest;
                const unsigned t1 = oldest + 1u;
                s->oldest = (t1 >= 5u) ? 0u : t1;
            }
        }
        /* how much growth the innovation asks for, 0 to 1 */
        {
            const float gamma_0 = p->gain.gamma_0;
            const float t1 = cascaded_tanks_clamp((s->innovation
                - gamma_0)/cascaded_tanks_max(p->gain.gamma_1 - gamma_0, 1e-06f), 0.0f, 1.0f);
            mu = t1*t1*(3.0f - 2.0f*t1);
        }
        /* is theta at rest? */
        {
            const float theta = s->theta;
            moves = !(mu <= 0.0f && theta >= 1.0f && theta <= 1.0f);
        }
        if (moves) {
            /* theta by the exact sub-flows of its law: rise, then decay */
            {
                const float theta = s->theta;
                const float t1 = 4.0f*mu/p->gain.rise_time;
                const float t2 = 1.0f/theta;
                const float theta_1 = p->gain.theta_1;
                const float t3 = 1.0f/theta_1;
                const float t4 = cascaded_tanks_max(t2 - t3, 0.0f);
                const float t5 = 2.0f*theta_1;
                const float t6 = t5 - cascaded_tanks_max(theta, theta_1);
                const float risen = (t1 <= t4 && theta <= theta_1) ? 1.0f/cascaded_tanks_max(t2 - t1, t3)
                    : t5 - t6/(1.0f + t6*(t1 - t4));
                const float decay = cascaded_tanks_exp(-(4.0f*p->gain.rate*(1.0f - mu)));
                s->theta = cascaded_tanks_clamp(1.0f + (risen - 1.0f)*decay, 1.0f, t5);
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float innovation = s->innovation;
            const float theta = s->theta;
            beyond = !(innovation >= 0.0f && innovation <= 1e+30f && theta >= 1.0f && theta <= 4.0f);
        }
        if (cascaded_tanks_acts(beyond)) {
            status |= cascaded_tanks_keep_in_box(s, p);
        }
    }
    return status;
}

/* nominal parameters */
CASCADED_TANKS_RARELY
static void cascaded_tanks_nominal(cascaded_tanks_params *p)
{
    p->ready = CASCADED_TANKS_READY;
    p->gain.Q[0] = 0.0001f;
    p->gain.Q[1] = 0.0014f;
    p->gain.R = 0.0016f;
    p->gain.theta_1 = 2.0f;
    p->gain.rise_time = 4.0f;
    p->gain.rate = 0.25f;
    p->gain.gamma_0 = 0.7f;
    p->gain.gamma_1 = 1.0f;
}

unsigned cascaded_tanks_predict(cascaded_tanks_state *s, const cascaded_tanks_params *p,
    const cascaded_tanks_input *in)
{
    unsigned status = 0u;
    if ((s->ready != CASCADED_TANKS_READY) || (p->ready != CASCADED_TANKS_READY)) {
        status = cascaded_tanks_ready(s, p);
    }
    if ((status & CASCADED_TANKS_NO_PARAMETERS) == 0u) {
        status |= cascaded_tanks_run_predict(s, p, in);
    }
    return status;
}

unsigned cascaded_tanks_update_y(cascaded_tanks_state *s, const cascaded_tanks_params *p,
    const cascaded_tanks_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CASCADED_TANKS_READY) || (p->ready != CASCADED_TANKS_READY)) {
        status = cascaded_tanks_ready(s, p);
    }
    if ((status & CASCADED_TANKS_NO_PARAMETERS) == 0u) {
        status |= cascaded_tanks_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned cascaded_tanks_adapt(cascaded_tanks_state *s, const cascaded_tanks_params *p)
{
    unsigned status = 0u;
    if ((s->ready != CASCADED_TANKS_READY) || (p->ready != CASCADED_TANKS_READY)) {
        status = cascaded_tanks_ready(s, p);
    }
    if ((status & CASCADED_TANKS_NO_PARAMETERS) == 0u) {
        status |= cascaded_tanks_run_adapt(s, p);
    }
    return status;
}

unsigned cascaded_tanks_step(cascaded_tanks_state *s, const cascaded_tanks_params *p,
    const cascaded_tanks_input *in, const cascaded_tanks_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CASCADED_TANKS_READY) || (p->ready != CASCADED_TANKS_READY)) {
        status = cascaded_tanks_ready(s, p);
    }
    if ((status & CASCADED_TANKS_NO_PARAMETERS) == 0u) {
        status |= cascaded_tanks_run_predict(s, p, in);
        status |= cascaded_tanks_run_update_y(s, p, measurement);
        status |= cascaded_tanks_run_adapt(s, p);
    }
    return status;
}

void cascaded_tanks_estimate(const cascaded_tanks_state *s, const cascaded_tanks_params *p,
    cascaded_tanks_plant *x)
{
    (void)p;
    /* the plant's state */
    {
        const float t1 = cascaded_tanks_max(s->z[1], 0.52f);
        x->x1 = t1*t1;
        x->x2 = s->z[0];
    }
}

unsigned cascaded_tanks_tune(cascaded_tanks_params *p)
{
    unsigned status = 0u;
    if (p->ready != CASCADED_TANKS_READY) {
        cascaded_tanks_nominal(p);
        status = CASCADED_TANKS_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[8] = {
            {1e-10f, 1400.0f, 0.0001f}, /* p->gain.Q[0] */
            {1e-10f, 1400.0f, 0.0014f}, /* p->gain.Q[1] */
            {1.6e-09f, 1600.0f, 0.0016f}, /* p->gain.R */
            {1.0f, 2.0f, 2.0f}, /* p->gain.theta_1 */
            {0.004f, 4000.0f, 4.0f}, /* p->gain.rise_time */
            {0.0f, 250.0f, 0.25f}, /* p->gain.rate */
            {0.0f, 1000000.0f, 0.7f}, /* p->gain.gamma_0 */
            {0.0f, 1000000.0f, 1.0f}, /* p->gain.gamma_1 */
        };
        float *const value[8] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.R,
            &p->gain.theta_1,
            &p->gain.rise_time,
            &p->gain.rate,
            &p->gain.gamma_0,
            &p->gain.gamma_1
        };
        for (unsigned k = 0u; k < 8u; ++k) {
            const float v = *value[k];
            *value[k] = cascaded_tanks_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= CASCADED_TANKS_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

CASCADED_TANKS_RARELY
void cascaded_tanks_reset(cascaded_tanks_state *s)
{
    s->ready = CASCADED_TANKS_READY;
    s->z[0] = 5.0f;
    s->z[1] = 1.7525125f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 3.0f;
    cascaded_tanks_clear_fault_counts(s);
    cascaded_tanks_clear_rest(s);
}

void cascaded_tanks_init(cascaded_tanks_state *s, cascaded_tanks_params *p)
{
    cascaded_tanks_nominal(p);
    (void)cascaded_tanks_tune(p);
    cascaded_tanks_reset(s);
}

static const unsigned char cascaded_tanks_layout[8] = {
    0xB3u, 0xF3u, 0xB9u, 0x7Eu, 0x8Fu, 0x13u, 0x55u, 0x1Eu
};

/* CRC-32 of IEEE 802.3 */
static uint32_t cascaded_tanks_checksum(const unsigned char *bytes, size_t size)
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

void cascaded_tanks_save(const cascaded_tanks_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = cascaded_tanks_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = cascaded_tanks_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned cascaded_tanks_restore(cascaded_tanks_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == CASCADED_TANKS_SAVED) {
        refused = 0u;
        uint32_t sum = cascaded_tanks_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == cascaded_tanks_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = CASCADED_TANKS_READY;
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
