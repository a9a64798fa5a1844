/* geared_motor: see geared_motor.h, and its manual geared_motor.md. */
#include "geared_motor.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(GEARED_MOTOR_USE_LIBM)
#include <math.h>
#elif defined(GEARED_MOTOR_USE_CMSIS)
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
#define GEARED_MOTOR_RARELY __attribute__((noinline))
#else
#define GEARED_MOTOR_RARELY
#endif

static float geared_motor_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float geared_motor_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float geared_motor_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool geared_motor_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float geared_motor_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool geared_motor_within(float v, float limit)
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
static float geared_motor_limit(float v, float most)
{
    return geared_motor_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float geared_motor_keep(float v, float low, float high, float otherwise, float limit)
{
    return geared_motor_within(v, limit) ? geared_motor_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define GEARED_MOTOR_USE_LIBM for those of <math.h>, or GEARED_MOTOR_USE_CMSIS for CMSIS-DSP. */
#if defined(GEARED_MOTOR_USE_LIBM)
static float geared_motor_sqrt(float x)
{
    return sqrtf(x);
}

static float geared_motor_exp(float x)
{
    return expf(x);
}

static float geared_motor_tanh(float x)
{
    return tanhf(x);
}

#elif defined(GEARED_MOTOR_USE_CMSIS)
static float geared_motor_sqrt(float x)
{
    return sqrtf(x);
}

static float geared_motor_exp(float x)
{
    return expf(x);
}

static float geared_motor_tanh(float x)
{
    return tanhf(x);
}

#else
/* whole number nearest to v, where |v| is below a third of 1.2582912e+07f: sums near that are rounded to
 * whole numbers */
static float geared_motor_nearest(float v)
{
#if !defined(__FLT_EVAL_METHOD__) || (__FLT_EVAL_METHOD__ != 0)
    const volatile float sum = v + 1.2582912e+07f;
    return sum - 1.2582912e+07f;
#else
    return v + 1.2582912e+07f - 1.2582912e+07f;
#endif
}

static float geared_motor_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float geared_motor_nan(void)
{
    const float large = geared_motor_inf();
    return large - large;
}

/* 2^x for whole x, where that is a normal number */
static float geared_motor_power_of_two(float x)
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

static float geared_motor_sqrt(float x)
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
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? geared_motor_nan() : 0.0f) : ((x > 3.4028235e+38f) ? x : t16);
}

static float geared_motor_exp(float x)
{
    const float t1 = geared_motor_nearest((x*x < 16384.0f) ? 1.442695f*x : 0.0f);
    const float t2 = x - 0.69314575f*t1 - 1.4286068e-06f*t1;
    const float t3 = t2 + t2*t2*(0.5f + t2*(((0.0013940646f*t2 + 0.008366435f)*t2 + 0.041666403f)*t2
        + 0.16666545f));
    const float t4 = geared_motor_nearest(0.5f*t1);
    const float t5 = (x < -87.33655f) ? 0.0f
        : (1.0f + t3)*geared_motor_power_of_two(t4)*geared_motor_power_of_two(t1 - t4);
    return (x > 88.896126f) ? geared_motor_inf() : t5;
}

static float geared_motor_tanh(float x)
{
    const float t1 = 1.0f - ((x < 0.0f) ? 2.0f : 0.0f);
    const float t2 = t1*x;
    const float t3 = (2.0f*t2 > 18.714973f) ? 18.714973f : 2.0f*t2;
    const float t4 = geared_motor_nearest((t3*t3 < 16384.0f) ? 1.442695f*t3 : 0.0f);
    const float t5 = geared_motor_power_of_two(t4);
    const float t6 = t3 - 0.69314575f*t4 - 1.4286068e-06f*t4;
    const float t7 = t6 + t6*t6*(0.5f + t6*(((0.0013940646f*t6 + 0.008366435f)*t6 + 0.041666403f)*t6
        + 0.16666545f));
    const float t8 = t5 - 1.0f + t5*t7;
    return t8/(t8 + 2.0f)*t1;
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void geared_motor_flow(float z2, float z3, float z4, float u, float dz[3])
{
    const float t1 = geared_motor_limit(z3, 300.0f);
    const float t2 = geared_motor_limit(z2, 15.0f);
    dz[0] = -t1;
    dz[1] = 50.0f*u - 50.0f*t2 + 2.5f*z3;
    dz[2] = 5000.0f*z4 - (250.0f*t2 + 0.1f*t1 + 50.0f*geared_motor_tanh(0.2f*t1));
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void geared_motor_jacobian(float z3, float F[1])
{
    const float t1 = geared_motor_tanh(0.2f*geared_motor_limit(z3, 300.0f));
    F[0] = -(0.1f + 10.0f*(1.0f - t1*t1)); /* F_33 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
GEARED_MOTOR_RARELY
static unsigned geared_motor_ready(geared_motor_state *s, const geared_motor_params *p)
{
    unsigned status = 0u;
    if (s->ready != GEARED_MOTOR_READY) {
        geared_motor_reset(s);
        status |= GEARED_MOTOR_UNINITIALISED;
    }
    if (p->ready != GEARED_MOTOR_READY) {
        geared_motor_reset(s);
        status |= GEARED_MOTOR_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
GEARED_MOTOR_RARELY
static void geared_motor_clear_fault_counts(geared_motor_state *s)
{
    /* as after a reset */
    s->fault_count_y_y2 = 0.0f;
    s->fault_limit_y_y2 = 80.0f;
    s->fault_count_y_y1 = 0.0f;
    s->fault_limit_y_y1 = 80.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 160.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
GEARED_MOTOR_RARELY
static void geared_motor_clear_rest(geared_motor_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->L[3] = 0.0f;
    s->L[4] = 0.0f;
    s->L[5] = 0.0f;
    s->D[0] = 1.0f;
    s->D[1] = 1.0f;
    s->D[2] = 100.0f;
    s->D[3] = 0.01f;
    s->innovation = 0.0f;
    s->theta = 1.0f;
    /* counters as after a reset */
    s->oldest = 0u;
    s->tick = 0u;
    for (unsigned k = 0u; k < 5u; ++k) {
        geared_motor_predictor *const predictor = &s->predictor[k];
        /* from the estimate */
        predictor->z[0] = s->z[0];
        predictor->z[1] = s->z[1];
        predictor->z[2] = s->z[2];
        predictor->z[3] = s->z[3];
        /* as after a reset */
        predictor->sum[0] = 0.0f;
        predictor->sum[1] = 0.0f;
        /* counters as after a reset */
        predictor->samples[0] = 0u;
        predictor->samples[1] = 0u;
    }
}

/* is a number of the state not finite, or beyond 1e30? */
static bool geared_motor_value_lost(const geared_motor_state *s)
{
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = geared_motor_within(s->z[0], 1e+30f) && geared_motor_within(s->z[1], 1e+30f)
            && geared_motor_within(s->z[2], 1e+30f);
        const bool t2 = t1 && geared_motor_within(s->z[3], 1e+30f) && geared_motor_within(s->L[0], 1e+30f)
            && geared_motor_within(s->L[1], 1e+30f);
        const bool t3 = t2 && geared_motor_within(s->L[2], 1e+30f) && geared_motor_within(s->L[3], 1e+30f)
            && geared_motor_within(s->L[4], 1e+30f);
        const bool t4 = t3 && geared_motor_within(s->L[5], 1e+30f) && geared_motor_within(s->D[0], 1e+30f)
            && geared_motor_within(s->D[1], 1e+30f);
        const bool t5 = t4 && geared_motor_within(s->D[2], 1e+30f) && geared_motor_within(s->D[3], 1e+30f)
            && geared_motor_within(s->innovation, 1e+30f);
        lost = !(t5 && geared_motor_within(s->theta, 1e+30f));
    }
    return lost;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned geared_motor_keep_in_box(geared_motor_state *s, const geared_motor_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    lost = geared_motor_value_lost(s);
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        status |= GEARED_MOTOR_RESTARTED;
        geared_motor_clear_fault_counts(s);
        geared_motor_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = geared_motor_abs(z1) > 3200.0f || geared_motor_abs(z2) > 45.0f
            || geared_motor_abs(z3) > 1200.0f;
        s->z[0] = geared_motor_limit(z1, 3200.0f);
        s->z[1] = geared_motor_limit(z2, 45.0f);
        s->z[2] = geared_motor_limit(z3, 1200.0f);
        s->z[3] = geared_motor_limit(z4, 3.2f);
        if (t1 || geared_motor_abs(z4) > 3.2f) {
            status |= GEARED_MOTOR_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L32 = s->L[3];
        const float L42 = s->L[4];
        const float L43 = s->L[5];
        s->L[0] = geared_motor_limit(L21, 1.40625e+07f);
        s->L[1] = geared_motor_limit(L31, 3.75e+08f);
        s->L[2] = geared_motor_limit(L41, 1000000.0f);
        s->L[3] = geared_motor_limit(L32, 2.6666666e+10f);
        s->L[4] = geared_motor_limit(L42, 7.111111e+07f);
        s->L[5] = geared_motor_limit(L43, 2666666.8f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        const float D4 = s->D[3];
        s->D[0] = geared_motor_clamp(D1, 1e-18f, 1.024e+07f);
        s->D[1] = geared_motor_clamp(D2, 1e-15f, 2025.0f);
        s->D[2] = geared_motor_clamp(D3, 1e-14f, 1440000.0f);
        s->D[3] = geared_motor_clamp(D4, 1e-20f, 10.24f);
    }
    /* keep innovation in its box */
    {
        const float innovation = s->innovation;
        s->innovation = geared_motor_clamp(innovation, 0.0f, 1e+30f);
    }
    /* keep theta in its box */
    {
        const float theta = s->theta;
        s->theta = geared_motor_clamp(theta, 1.0f, 4.0f);
    }
    return status;
}

/* part of a step: check the fault counts, and count the range */
static unsigned geared_motor_count_range(geared_motor_state *s, const geared_motor_params *p)
{
    unsigned status = 0u;
    (void)p;
    float moves_range = 0.0f;
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float fault_limit_y_y2 = s->fault_limit_y_y2;
        const float fault_count_y_y1 = s->fault_count_y_y1;
        const float fault_limit_y_y1 = s->fault_limit_y_y1;
        const float t1 = fault_limit_y_y2 - 80.0f + geared_motor_abs(fault_count_y_y2)
            + (fault_limit_y_y1 - 80.0f + geared_motor_abs(fault_count_y_y1));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = geared_motor_abs(fault_limit_range - 160.0f + fault_count_range + t1
            - s->fault_checksum) < 0.5f;
        const bool t3 = t2 && geared_motor_within(fault_count_y_y2, 81920.0f) && fault_limit_y_y2 >= 80.0f
            && fault_limit_y_y2 <= 81920.0f;
        const bool t4 = t3 && geared_motor_within(fault_count_y_y1, 81920.0f) && fault_limit_y_y1 >= 80.0f
            && fault_limit_y_y1 <= 81920.0f;
        const bool t5 = t4 && fault_count_range >= 0.0f && fault_count_range <= 163840.0f
            && fault_limit_range >= 160.0f && fault_limit_range <= 163840.0f;
        spoiled = !t5;
    }
    if (spoiled) {
        geared_motor_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = geared_motor_abs(s->z[0]) > 220.0f || geared_motor_abs(s->z[1]) > 16.5f
            || geared_motor_abs(s->z[2]) > 330.0f;
        moves_range = (t1 || geared_motor_abs(s->z[3]) > 0.22f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = geared_motor_clamp(fault_count_range + moves_range, 0.0f, 163840.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 160.0f : fault_limit_range;
    }
    return status;
}

/* part of a step: project the estimate onto its declared ranges */
static unsigned geared_motor_project_onto_ranges(geared_motor_state *s, const geared_motor_params *p)
{
    unsigned status = 0u;
    (void)p;
    /* the estimate back onto its declared ranges */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float L41 = s->L[2];
        const float D1 = s->D[0];
        const float t1 = L41*D1;
        const float t2 = z1 - geared_motor_limit(z1, 200.0f);
        const float t3 = t2/D1;
        const float L21 = s->L[0];
        const float L42 = s->L[4];
        const float D2 = s->D[1];
        const float t4 = L42*D2;
        const float t5 = L21*D1;
        const float t6 = z2 - t5*t3;
        const float t7 = t6 - geared_motor_limit(t6, 15.0f);
        const float t8 = t7/(t5*L21 + D2);
        const float L31 = s->L[1];
        const float L32 = s->L[3];
        const float L43 = s->L[5];
        const float D3 = s->D[2];
        const float t9 = L43*D3;
        const float t10 = L31*D1;
        const float t11 = L32*D2;
        const float t12 = z3 - t10*t3 - (t10*L21 + t11)*t8;
        const float t13 = t12 - geared_motor_limit(t12, 300.0f);
        const float t14 = t13/(t10*L31 + t11*L32 + D3);
        const float t15 = z4 - t1*t3 - (t1*L21 + t4)*t8 - (t1*L31 + t4*L32 + t9)*t14;
        const float t16 = t15 - geared_motor_limit(t15, 0.2f);
        const float t17 = t15 - t16 - z4;
        const float t18 = (t17 > 0.0f) ? 3.2f - z4 : z4 + 3.2f;
        const float t19 = t16/(t1*L41 + t4*L42 + t9*L43 + s->D[3]);
        const float t20 = t12 - t13 - (t10*L41 + t11*L42 + D3*L43)*t19 - z3;
        const float t21 = (t20 > 0.0f) ? 1200.0f - z3 : z3 + 1200.0f;
        const float t22 = t6 - t7 - (t5*L31 + D2*L32)*t14 - (t5*L41 + D2*L42)*t19 - z2;
        const float t23 = (t22 > 0.0f) ? 45.0f - z2 : z2 + 45.0f;
        const float t24 = z1 - t2 - D1*L21*t8 - D1*L31*t14 - D1*L41*t19 - z1;
        const float t25 = (t24 > 0.0f) ? 3200.0f - z1 : z1 + 3200.0f;
        const float t26 = geared_motor_abs(t24);
        const float t27 = (t25 < t26) ? t25/t26 : 1.0f;
        const float t28 = geared_motor_abs(t22);
        const float t29 = (t23 < t27*t28) ? t23/t28 : t27;
        const float t30 = geared_motor_abs(t20);
        const float t31 = (t21 < t29*t30) ? t21/t30 : t29;
        const float t32 = geared_motor_abs(t17);
        const float t33 = (t18 < t31*t32) ? t18/t32 : t31;
        s->z[0] = geared_motor_keep(z1 + t33*t24, -3200.0f, 3200.0f, z1, 1e+30f);
        s->z[1] = geared_motor_keep(z2 + t33*t22, -45.0f, 45.0f, z2, 1e+30f);
        s->z[2] = geared_motor_keep(z3 + t33*t20, -1200.0f, 1200.0f, z3, 1e+30f);
        s->z[3] = geared_motor_keep(z4 + t33*t17, -3.2f, 3.2f, z4, 1e+30f);
        status |= GEARED_MOTOR_PROJECTED_ONTO_RANGES;
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned geared_motor_guard_input(const geared_motor_state *s, const geared_motor_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float v = in->v;
        const bool v_usable = geared_motor_within(v, 1e+15f);
        const float v_taken = v_usable ? v : s->u;
        *u = geared_motor_limit(v_taken, 12.0f);
        if (!v_usable) {
            status |= GEARED_MOTOR_REUSED_V;
        }
        if (geared_motor_abs(v_taken) > 12.0f) {
            status |= GEARED_MOTOR_CLAMPED_V;
        }
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool geared_motor_beyond_box(const geared_motor_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = geared_motor_within(s->z[0], 3200.0f) && geared_motor_within(s->z[1], 45.0f)
            && geared_motor_within(s->z[2], 1200.0f);
        const bool t2 = t1 && geared_motor_within(s->z[3], 3.2f)
            && geared_motor_within(s->L[0], 1.40625e+07f) && geared_motor_within(s->L[1], 3.75e+08f);
        const bool t3 = t2 && geared_motor_within(s->L[2], 1000000.0f)
            && geared_motor_within(s->L[3], 2.6666666e+10f);
        const bool t4 = t3 && geared_motor_within(s->L[4], 7.111111e+07f)
            && geared_motor_within(s->L[5], 2666666.8f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        const bool t5 = t4 && D1 >= 1e-18f && D1 <= 1.024e+07f && D2 >= 1e-15f && D2 <= 2025.0f
            && D3 >= 1e-14f && D3 <= 1440000.0f;
        const float D4 = s->D[3];
        beyond = !(t5 && D4 >= 1e-20f && D4 <= 10.24f);
    }
    return beyond;
}

/* advance the estimate from the last call to now */
static unsigned geared_motor_advance(geared_motor_state *s, const geared_motor_params *p, float u)
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
        const float D4 = s->D[3];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L32 = s->L[3];
        const float L42 = s->L[4];
        const float L43 = s->L[5];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float u_before = s->u;
        float k1_z[3];
        geared_motor_flow(z2, z3, z4, u_before, k1_z);
        const float t1 = u_before + 0.5f*(u - u_before);
        float k2_z[3];
        geared_motor_flow(z2 + 0.0005f*k1_z[1], z3 + 0.0005f*k1_z[2], z4, t1, k2_z);
        const float t2 = z3 + 0.0005f*k2_z[2];
        float k3_z[3];
        geared_motor_flow(z2 + 0.0005f*k2_z[1], t2, z4, t1, k3_z);
        float k4_z[3];
        geared_motor_flow(z2 + 0.001f*k3_z[1], z3 + 0.001f*k3_z[2], z4, u, k4_z);
        float F_1[1];
        geared_motor_jacobian(t2, F_1);
        const float Phi_13 = -0.001f - 5e-07f*F_1[0];
        const float Phi_23 = 0.0025f + 5e-07f*(2.5f*F_1[0] - 125.0f);
        const float Phi_32 = 5e-07f*(12500.0f - 250.0f*F_1[0]) - 0.25f;
        const float Phi_33 = 1.0f + 0.001f*F_1[0] + 5e-07f*(F_1[0]*F_1[0] - 625.0f);
        const float Phi_34 = 5.0f + 0.0025f*F_1[0];
        const float w1_1 = 1.0f + 0.000125f*L21 + Phi_13*L31 - 0.0025f*L41;
        const float w1_2 = 0.000125f + Phi_13*L32 - 0.0025f*L42;
        const float w1_3 = Phi_13 - 0.0025f*L43;
        const float theta = s->theta;
        const float w1_5 = theta*theta;
        const float t3 = w1_1*D1;
        const float t4 = w1_2*D2;
        const float t5 = w1_3*D3;
        const float t6 = 0.001f*theta;
        const float t7 = t6*p->gain.Q[0];
        const float d1 = w1_1*t3 + w1_2*t4 + w1_3*t5 + 6.25e-06f*D4 + w1_5*t7*w1_5;
        const float t8 = 0.9509375f*L21 + Phi_23*L31 + 0.00625f*L41;
        const float t9 = 0.9509375f + Phi_23*L32 + 0.00625f*L42;
        const float t10 = Phi_23 + 0.00625f*L43;
        const float l21 = (t8*t3 + t9*t4 + t10*t5 - 1.5625e-05f*D4)/d1;
        const float t11 = Phi_32*L21 + Phi_33*L31 + Phi_34*L41;
        const float t12 = Phi_32 + Phi_33*L32 + Phi_34*L42;
        const float t13 = Phi_33 + Phi_34*L43;
        const float t14 = -0.0025f*D4;
        const float l31 = (t11*t3 + t12*t4 + t13*t5 + Phi_34*t14)/d1;
        const float l41 = (L41*t3 + L42*t4 + L43*t5 + t14)/d1;
        const float w2_1 = t8 - l21*w1_1;
        const float w2_2 = t9 - l21*w1_2;
        const float w2_3 = t10 - l21*w1_3;
        const float w2_4 = 0.00625f + 0.0025f*l21;
        const float t15 = w2_1*D1;
        const float t16 = w2_2*D2;
        const float t17 = w2_3*D3;
        const float t18 = w2_4*D4;
        const float t19 = l21*w1_5;
        const float t20 = t19*t7;
        const float t21 = t6*p->gain.Q[1];
        const float d2 = w2_1*t15 + w2_2*t16 + w2_3*t17 + w2_4*t18 + t19*t20 + t21;
        const float t22 = t11 - l31*w1_1;
        const float t23 = t12 - l31*w1_2;
        const float t24 = t13 - l31*w1_3;
        const float t25 = Phi_34 + 0.0025f*l31;
        const float t26 = l31*w1_5;
        const float l32 = (t22*t15 + t23*t16 + t24*t17 + t25*t18 + t26*t20)/d2;
        const float t27 = L41 - l41*w1_1;
        const float t28 = L42 - l41*w1_2;
        const float t29 = L43 - l41*w1_3;
        const float t30 = 1.0f + 0.0025f*l41;
        const float t31 = l41*w1_5;
        const float l42 = (t27*t15 + t28*t16 + t29*t17 + t30*t18 + t31*t20)/d2;
        const float w3_1 = t22 - l32*w2_1;
        const float w3_2 = t23 - l32*w2_2;
        const float w3_3 = t24 - l32*w2_3;
        const float w3_4 = t25 - l32*w2_4;
        const float w3_5 = l32*t19 - t26;
        const float t32 = w3_1*D1;
        const float t33 = w3_2*D2;
        const float t34 = w3_3*D3;
        const float t35 = w3_4*D4;
        const float t36 = w3_5*t7;
        const float t37 = l32*t21;
        const float t38 = t6*p->gain.Q[2];
        const float d3 = w3_1*t32 + w3_2*t33 + w3_3*t34 + w3_4*t35 + w3_5*t36 + l32*t37 + theta*t38*theta;
        const float t39 = t27 - l42*w2_1;
        const float t40 = t28 - l42*w2_2;
        const float t41 = t29 - l42*w2_3;
        const float t42 = t30 - l42*w2_4;
        const float t43 = l42*t19 - t31;
        const float l43 = (t39*t32 + t40*t33 + t41*t34 + t42*t35 + t43*t36 + l42*t37)/d3;
        const float w4_1 = t39 - l43*w3_1;
        const float w4_2 = t40 - l43*w3_2;
        const float w4_3 = t41 - l43*w3_3;
        const float w4_4 = t42 - l43*w3_4;
        const float w4_5 = t43 - l43*w3_5;
        const float w4_6 = l43*l32 - l42;
        const float t44 = l43*theta;
        const float t45 = w4_1*D1*w4_1 + w4_2*D2*w4_2 + w4_3*D3*w4_3 + w4_4*D4*w4_4 + w4_5*t7*w4_5
            + w4_6*t21*w4_6 + t44*t38*t44;
        const float d4 = t45 + t6*p->gain.Q[3]*w1_5*w1_5;
        s->z[0] = z1 + 0.00016666666f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 0.00016666666f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
        s->z[2] = z3 + 0.00016666666f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
        s->L[0] = l21;
        s->L[1] = l31;
        s->L[2] = l41;
        s->L[3] = l32;
        s->L[4] = l42;
        s->L[5] = l43;
        s->D[0] = d1;
        s->D[1] = d2;
        s->D[2] = d3;
        s->D[3] = d4;
    }
    /* largest variances */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float D2 = s->D[1];
        const float L31 = s->L[1];
        const float L32 = s->L[3];
        const float D3 = s->D[2];
        const float L41 = s->L[2];
        const float L42 = s->L[4];
        const float L43 = s->L[5];
        capped = D1 > 1.024e+07f || L21*L21*D1 + D2 > 2025.0f || L31*L31*D1 + L32*L32*D2 + D3 > 1440000.0f
            || L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + s->D[3] > 10.24f;
    }
    if (capped) {
        /* cap */
        {
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float D3 = s->D[2];
            const float D4 = s->D[3];
            const float L21 = s->L[0];
            const float L31 = s->L[1];
            const float L41 = s->L[2];
            const float L32 = s->L[3];
            const float L42 = s->L[4];
            const float L43 = s->L[5];
            const float t1 = geared_motor_min(1.0f, 2025.0f/(L21*L21*D1 + D2));
            const float t2 = geared_motor_min(1.0f, 1.024e+07f/D1);
            const float t3 = geared_motor_min(1.0f, 1440000.0f/(L31*L31*D1 + L32*L32*D2 + D3));
            const float t4 = geared_motor_min(1.0f, 10.24f/(L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + D4));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t4*L41/t2;
            s->L[3] = t3*L32/t1;
            s->L[4] = t4*L42/t1;
            s->L[5] = t4*L43/t3;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            s->D[3] = t4*t4*D4;
            status |= GEARED_MOTOR_COVARIANCE_LIMITED;
        }
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        geared_motor_predictor *const predictor = &s->predictor[k];
        /* each predictor by Heun, without correction */
        {
            const float z1 = predictor->z[0];
            const float z2 = predictor->z[1];
            const float z3 = predictor->z[2];
            const float z4 = predictor->z[3];
            float dz_1[3];
            geared_motor_flow(z2, z3, z4, s->u, dz_1);
            float dz_2[3];
            geared_motor_flow(z2 + 0.001f*dz_1[1], z3 + 0.001f*dz_1[2], z4, u, dz_2);
            predictor->z[0] = z1 + 0.0005f*(dz_1[0] + dz_2[0]);
            predictor->z[1] = z2 + 0.0005f*(dz_1[1] + dz_2[1]);
            predictor->z[2] = z3 + 0.0005f*(dz_1[2] + dz_2[2]);
        }
        /* is it beyond its box, or lost? */
        {
            const bool t1 = geared_motor_within(predictor->z[0], 3200.0f)
                && geared_motor_within(predictor->z[1], 45.0f) && geared_motor_within(predictor->z[2],
                    1200.0f);
            beyond = !t1;
        }
        if (geared_motor_acts(beyond)) {
            /* keep it in its box */
            {
                const float z1 = predictor->z[0];
                const float z2 = predictor->z[1];
                const float z3 = predictor->z[2];
                predictor->z[0] = geared_motor_keep(z1, -3200.0f, 3200.0f, 0.0f, 1e+15f);
                predictor->z[1] = geared_motor_keep(z2, -45.0f, 45.0f, 0.0f, 1e+15f);
                predictor->z[2] = geared_motor_keep(z3, -1200.0f, 1200.0f, 0.0f, 1e+15f);
            }
        }
    }
    beyond = geared_motor_beyond_box(s);
    if (geared_motor_acts(beyond)) {
        status |= geared_motor_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned geared_motor_run_predict(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_input *in)
{
    unsigned status = 0u;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = geared_motor_limit(u_before, 12.0f);
    }
    status |= geared_motor_guard_input(s, in, &u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = (calls < 2u) ? calls + 1u : 2u;
    }
    if (running) {
        status |= geared_motor_advance(s, p, u);
    } else {
        status |= geared_motor_keep_in_box(s, p);
        for (unsigned k = 0u; k < 5u; ++k) {
            geared_motor_predictor *const predictor = &s->predictor[k];
            /* from the estimate */
            predictor->z[0] = s->z[0];
            predictor->z[1] = s->z[1];
            predictor->z[2] = s->z[2];
            predictor->z[3] = s->z[3];
        }
    }
    /* samples may come */
    s->used_y1 = 0u;
    s->used_y2 = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned geared_motor_guard_measurement_y1(const geared_motor_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y1 */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = geared_motor_within(reading, 600.0f) && geared_motor_within(t1, 1e+16f);
        const bool t3 = geared_motor_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= GEARED_MOTOR_MISSING_Y1;
        }
        if (t3 && !t2) {
            status |= GEARED_MOTOR_REJECTED_Y1;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned geared_motor_use_sample_y1(geared_motor_state *s, const geared_motor_params *p, float e,
    float reading)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float theta = s->theta;
        const float t1 = theta*theta*theta*p->gain.R[0]*1000.0f;
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        const float K4 = L41*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->D[0] = K1*t1;
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        geared_motor_predictor *const predictor = &s->predictor[k];
        /* its squared output error */
        {
            const float sum1 = predictor->sum[0];
            const float t1 = reading - predictor->z[0];
            predictor->sum[0] = geared_motor_min(sum1 + 0.001f*t1*t1, 1e+30f);
        }
        /* one more sample */
        {
            const unsigned samples1 = predictor->samples[0];
            predictor->samples[0] = (samples1 < 26u) ? samples1 + 1u : 26u;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = geared_motor_within(s->z[0], 3200.0f) && geared_motor_within(s->z[1], 45.0f)
            && geared_motor_within(s->z[2], 1200.0f);
        const float D1 = s->D[0];
        beyond = !(t1 && geared_motor_within(s->z[3], 3.2f) && D1 >= 1e-18f && D1 <= 1.024e+07f);
    }
    if (geared_motor_acts(beyond)) {
        status |= geared_motor_keep_in_box(s, p);
    }
    /* y1 is used */
    s->used_y1 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool geared_motor_suspect_y1(const geared_motor_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = geared_motor_abs(s->z[0]) > 200.0f || geared_motor_abs(s->z[1]) > 15.0f
            || geared_motor_abs(s->z[2]) > 300.0f;
        const bool t2 = geared_motor_abs(output_error) > 40.0f || t1 || geared_motor_abs(s->z[3]) > 0.2f
            || !(s->fault_checksum <= 0.0f);
        suspect = t2 || !valid;
    }
    return suspect;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void geared_motor_find_signs_y1(const geared_motor_state *s, float *moves_y_y1, float output_error,
    float *side_y_y1)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = geared_motor_within(output_error, 40.0f);
        const float fault_count_y_y1 = s->fault_count_y_y1;
        *moves_y_y1 = (t1 ? 0.0f : ((fault_count_y_y1*output_error < 0.0f) ? -40.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y1 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y1 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned geared_motor_recover_y1(geared_motor_state *s, const geared_motor_params *p, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y1 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y1 <= geared_motor_abs(s->fault_count_y_y1);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = geared_motor_abs(s->z[0]) > 400.0f || geared_motor_abs(s->z[1]) > 30.0f
            || geared_motor_abs(s->z[2]) > 600.0f;
        over_y_y1 = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 160.0f || t3 || geared_motor_abs(s->z[3]) > 0.4f));
    }
    if (over_y_y1) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y1 = s->fault_count_y_y1;
            const float fault_limit_y_y1 = s->fault_limit_y_y1;
            const float t1 = geared_motor_min(fault_limit_y_y1, 40960.0f);
            s->fault_count_y_y1 = (fault_count_y_y1 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y1 = geared_motor_min(2.0f*fault_limit_y_y1, 81920.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = geared_motor_min(fault_limit_range, 81920.0f);
            s->fault_limit_range = geared_motor_min(2.0f*fault_limit_range, 163840.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        /* from the sample of y1 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = geared_motor_keep(reading, -200.0f, 200.0f, z1, 1e+30f);
            s->z[1] = geared_motor_keep(z2, -15.0f, 15.0f, z2, 1e+30f);
            s->z[2] = geared_motor_keep(z3, -300.0f, 300.0f, z3, 1e+30f);
            s->z[3] = geared_motor_keep(z4, -0.2f, 0.2f, z4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= GEARED_MOTOR_RESTARTED_FROM_SAMPLE;
        geared_motor_clear_rest(s);
    } else {
        status |= geared_motor_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y1 */
static unsigned geared_motor_run_update_y1(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float e = 0.0f;
    bool fresh = false;
    float moves_y_y1 = 0.0f;
    float output_error = 0.0f;
    float reading = 0.0f;
    bool sampled = false;
    float side_y_y1 = 0.0f;
    bool suspect = false;
    bool valid = false;
    /* is a sample of y1 awaited? */
    fresh = s->used_y1 < 1u;
    if (fresh) {
        /* the measurement of y1 */
        reading = measurement->y1;
        status |= geared_motor_guard_measurement_y1(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= geared_motor_use_sample_y1(s, p, e, reading);
        }
        suspect = geared_motor_suspect_y1(s, output_error, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || geared_motor_within(reading, 600.0f);
            if (sampled) {
                status |= geared_motor_count_range(s, p);
                geared_motor_find_signs_y1(s, &moves_y_y1, output_error, &side_y_y1);
                /* count of y_y1 */
                {
                    const float fault_count_y_y1 = s->fault_count_y_y1;
                    const float fault_limit_y_y1 = s->fault_limit_y_y1;
                    const float t1 = geared_motor_clamp(geared_motor_abs(fault_count_y_y1) + moves_y_y1,
                        0.0f, 81920.0f);
                    s->fault_count_y_y1 = (side_y_y1 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y1 = (t1 <= 0.0f) ? 80.0f : fault_limit_y_y1;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y1 <= geared_motor_abs(s->fault_count_y_y1)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= geared_motor_recover_y1(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y2 - 80.0f + geared_motor_abs(s->fault_count_y_y2)
                        + (s->fault_limit_y_y1 - 80.0f + geared_motor_abs(s->fault_count_y_y1));
                    s->fault_checksum = s->fault_limit_range - 160.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= GEARED_MOTOR_OUT_OF_ORDER;
    }
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned geared_motor_guard_measurement_y2(const geared_motor_state *s, float *e, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y2 */
    {
        const float t1 = reading - s->z[1];
        const bool t2 = geared_motor_within(reading, 45.0f) && geared_motor_within(t1, 1e+16f);
        const bool t3 = geared_motor_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= GEARED_MOTOR_MISSING_Y2;
        }
        if (t3 && !t2) {
            status |= GEARED_MOTOR_REJECTED_Y2;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned geared_motor_use_sample_y2(geared_motor_state *s, const geared_motor_params *p, float e,
    float reading)
{
    unsigned status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L32 = s->L[3];
        const float L42 = s->L[4];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float t1 = D1*L21;
        const float t2 = p->gain.R[1]/(0.001f*s->theta);
        const float t3 = t2 + D2;
        const float t4 = t3 + t1*L21;
        const float K1 = t1/t4;
        const float K2 = (D2 + L21*t1)/t4;
        const float t5 = L32*D2;
        const float K3 = (t5 + L31*t1)/t4;
        const float t6 = L42*D2;
        const float K4 = (t6 + L41*t1)/t4;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->L[0] = L21 - L21*D2/t3;
        s->L[1] = L31 - L21*t5/t3;
        s->L[2] = L41 - L21*t6/t3;
        s->D[0] = D1*t3/t4;
        s->D[1] = D2*t2/t3;
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        geared_motor_predictor *const predictor = &s->predictor[k];
        /* its squared output error */
        {
            const float sum2 = predictor->sum[1];
            const float t1 = reading - predictor->z[1];
            predictor->sum[1] = geared_motor_min(sum2 + 0.001f*t1*t1, 1e+30f);
        }
        /* one more sample */
        {
            const unsigned samples2 = predictor->samples[1];
            predictor->samples[1] = (samples2 < 26u) ? samples2 + 1u : 26u;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = geared_motor_within(s->z[0], 3200.0f) && geared_motor_within(s->z[1], 45.0f)
            && geared_motor_within(s->z[2], 1200.0f);
        const bool t2 = t1 && geared_motor_within(s->z[3], 3.2f)
            && geared_motor_within(s->L[0], 1.40625e+07f) && geared_motor_within(s->L[1], 3.75e+08f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && geared_motor_within(s->L[2], 1000000.0f) && D1 >= 1e-18f && D1 <= 1.024e+07f
            && D2 >= 1e-15f && D2 <= 2025.0f;
        beyond = !t3;
    }
    if (geared_motor_acts(beyond)) {
        status |= geared_motor_keep_in_box(s, p);
    }
    /* y2 is used */
    s->used_y2 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned geared_motor_suspect_y2(const geared_motor_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = geared_motor_abs(s->z[0]) > 200.0f || geared_motor_abs(s->z[1]) > 15.0f
            || geared_motor_abs(s->z[2]) > 300.0f;
        const bool t2 = t1 || geared_motor_abs(s->z[3]) > 0.2f;
        if (t2) {
            status |= GEARED_MOTOR_OUTSIDE_BOX;
        }
        *suspect = geared_motor_abs(output_error) > 3.0f || t2 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void geared_motor_find_signs_y2(const geared_motor_state *s, const geared_motor_params *p,
    float *moves_y_y2, float output_error, float *side_y_y2)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = p->gain.R[1]/(0.001f*s->theta);
        const float L21 = s->L[0];
        const float t2 = geared_motor_sqrt(t1*t1/geared_motor_max(t1 - (L21*s->D[0]*L21 + s->D[1]),
            9.536743e-07f*t1));
        const bool t3 = geared_motor_within(output_error, geared_motor_max(3.0f,
            geared_motor_min(3.0f*t2, 400.0f)));
        const float fault_count_y_y2 = s->fault_count_y_y2;
        *moves_y_y2 = (t3 ? 0.0f : ((fault_count_y_y2*output_error < 0.0f) ? -40.0f : 1.0f))
            + (t3 ? -1.0f : 0.0f);
        *side_y_y2 = (t3 ? 0.0f : output_error) + (t3 ? fault_count_y_y2 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned geared_motor_recover_y2(geared_motor_state *s, const geared_motor_params *p, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y2 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y2 <= geared_motor_abs(s->fault_count_y_y2);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = geared_motor_abs(s->z[0]) > 400.0f || geared_motor_abs(s->z[1]) > 30.0f
            || geared_motor_abs(s->z[2]) > 600.0f;
        over_y_y2 = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 160.0f || t3 || geared_motor_abs(s->z[3]) > 0.4f));
    }
    if (over_y_y2) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y2 = s->fault_count_y_y2;
            const float fault_limit_y_y2 = s->fault_limit_y_y2;
            const float t1 = geared_motor_min(fault_limit_y_y2, 40960.0f);
            s->fault_count_y_y2 = (fault_count_y_y2 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y2 = geared_motor_min(2.0f*fault_limit_y_y2, 81920.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = geared_motor_min(fault_limit_range, 81920.0f);
            s->fault_limit_range = geared_motor_min(2.0f*fault_limit_range, 163840.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        /* from the sample of y2 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = geared_motor_keep(z1, -200.0f, 200.0f, z1, 1e+30f);
            s->z[1] = geared_motor_keep(reading, -15.0f, 15.0f, z2, 1e+30f);
            s->z[2] = geared_motor_keep(z3, -300.0f, 300.0f, z3, 1e+30f);
            s->z[3] = geared_motor_keep(z4, -0.2f, 0.2f, z4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= GEARED_MOTOR_RESTARTED_FROM_SAMPLE;
        geared_motor_clear_rest(s);
    } else {
        status |= geared_motor_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y2 */
static unsigned geared_motor_run_update_y2(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float e = 0.0f;
    bool fresh = false;
    float moves_y_y2 = 0.0f;
    float output_error = 0.0f;
    float reading = 0.0f;
    bool sampled = false;
    float side_y_y2 = 0.0f;
    bool suspect = false;
    bool valid = false;
    /* is a sample of y2 awaited? */
    fresh = s->used_y2 < 1u;
    if (fresh) {
        /* the measurement of y2 */
        reading = measurement->y2;
        status |= geared_motor_guard_measurement_y2(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= geared_motor_use_sample_y2(s, p, e, reading);
        }
        status |= geared_motor_suspect_y2(s, output_error, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || geared_motor_within(reading, 45.0f);
            if (sampled) {
                status |= geared_motor_count_range(s, p);
                geared_motor_find_signs_y2(s, p, &moves_y_y2, output_error, &side_y_y2);
                /* count of y_y2 */
                {
                    const float fault_count_y_y2 = s->fault_count_y_y2;
                    const float fault_limit_y_y2 = s->fault_limit_y_y2;
                    const float t1 = geared_motor_clamp(geared_motor_abs(fault_count_y_y2) + moves_y_y2,
                        0.0f, 81920.0f);
                    s->fault_count_y_y2 = (side_y_y2 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y2 = (t1 <= 0.0f) ? 80.0f : fault_limit_y_y2;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y2 <= geared_motor_abs(s->fault_count_y_y2)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= geared_motor_recover_y2(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y2 - 80.0f + geared_motor_abs(s->fault_count_y_y2)
                        + (s->fault_limit_y_y1 - 80.0f + geared_motor_abs(s->fault_count_y_y1));
                    s->fault_checksum = s->fault_limit_range - 160.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= GEARED_MOTOR_OUT_OF_ORDER;
    }
    return status;
}

/* part of a step: adapt the gain; once after the updates */
static unsigned geared_motor_run_adapt(geared_motor_state *s, const geared_motor_params *p)
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
            geared_motor_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
            /* innovation: the sum of the oldest predictor, scaled to the window, never scaled up */
            {
                const float t1 = 20.0f/geared_motor_max((float)predictor->samples[0],
                    20.0f)*predictor->sum[0]*1e+08f + 20.0f/geared_motor_max((float)predictor->samples[1],
                        20.0f)*predictor->sum[1]*1000.0f;
                s->innovation = geared_motor_min(t1, 1e+30f);
            }
        }
        /* one predictor restarts every 5 samples */
        {
            const unsigned tick = s->tick;
            const unsigned t1 = tick + 1u;
            const bool t2 = t1 >= 5u;
            restart = t2;
            s->tick = t2 ? 0u : t1;
        }
        if (restart) {
            {
                geared_motor_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
                /* the oldest predictor restarts from the estimate */
                predictor->z[0] = s->z[0];
                predictor->z[1] = s->z[1];
                predictor->z[2] = s->z[2];
                predictor->z[3] = s->z[3];
                predictor->sum[0] = 0.0f;
                predictor->sum[1] = 0.0f;
                /* no sample yet */
                predictor->samples[0] = 0u;
                predictor->samples[1] = 0u;
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
            const float t1 = geared_motor_clamp((s->innovation - gamma_0)/geared_motor_max(p->gain.gamma_1
                - gamma_0, 0.004f), 0.0f, 1.0f);
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
                const float t1 = 0.001f*mu/p->gain.rise_time;
                const float t2 = 1.0f/theta;
                const float theta_1 = p->gain.theta_1;
                const float t3 = 1.0f/theta_1;
                const float t4 = geared_motor_max(t2 - t3, 0.0f);
                const float t5 = 2.0f*theta_1;
                const float t6 = t5 - geared_motor_max(theta, theta_1);
                const float risen = (t1 <= t4 && theta <= theta_1) ? 1.0f/geared_motor_max(t2 - t1, t3)
                    : t5 - t6/(1.0f + t6*(t1 - t4));
                const float decay = geared_motor_exp(-(0.001f*p->gain.rate*(1.0f - mu)));
                s->theta = geared_motor_clamp(1.0f + (risen - 1.0f)*decay, 1.0f, t5);
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float innovation = s->innovation;
            const float theta = s->theta;
            beyond = !(innovation >= 0.0f && innovation <= 1e+30f && theta >= 1.0f && theta <= 4.0f);
        }
        if (geared_motor_acts(beyond)) {
            status |= geared_motor_keep_in_box(s, p);
        }
    }
    return status;
}

/* nominal parameters */
GEARED_MOTOR_RARELY
static void geared_motor_nominal(geared_motor_params *p)
{
    p->ready = GEARED_MOTOR_READY;
    p->gain.Q[0] = 0.001f;
    p->gain.Q[1] = 1.0f;
    p->gain.Q[2] = 10.0f;
    p->gain.Q[3] = 1e-05f;
    p->gain.R[0] = 1e-08f;
    p->gain.R[1] = 1e-06f;
    p->gain.theta_1 = 2.0f;
    p->gain.rise_time = 0.02f;
    p->gain.rate = 20.0f;
    p->gain.gamma_0 = 400.0f;
    p->gain.gamma_1 = 4000.0f;
}

unsigned geared_motor_predict(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_input *in)
{
    unsigned status = 0u;
    if ((s->ready != GEARED_MOTOR_READY) || (p->ready != GEARED_MOTOR_READY)) {
        status = geared_motor_ready(s, p);
    }
    if ((status & GEARED_MOTOR_NO_PARAMETERS) == 0u) {
        status |= geared_motor_run_predict(s, p, in);
    }
    return status;
}

unsigned geared_motor_update_y1(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != GEARED_MOTOR_READY) || (p->ready != GEARED_MOTOR_READY)) {
        status = geared_motor_ready(s, p);
    }
    if ((status & GEARED_MOTOR_NO_PARAMETERS) == 0u) {
        status |= geared_motor_run_update_y1(s, p, measurement);
    }
    return status;
}

unsigned geared_motor_update_y2(geared_motor_state *s, const geared_motor_params *p,
    const geared_motor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != GEARED_MOTOR_READY) || (p->ready != GEARED_MOTOR_READY)) {
        status = geared_motor_ready(s, p);
    }
    if ((status & GEARED_MOTOR_NO_PARAMETERS) == 0u) {
        status |= geared_motor_run_update_y2(s, p, measurement);
    }
    return status;
}

unsigned geared_motor_adapt(geared_motor_state *s, const geared_motor_params *p)
{
    unsigned status = 0u;
    if ((s->ready != GEARED_MOTOR_READY) || (p->ready != GEARED_MOTOR_READY)) {
        status = geared_motor_ready(s, p);
    }
    if ((status & GEARED_MOTOR_NO_PARAMETERS) == 0u) {
        status |= geared_motor_run_adapt(s, p);
    }
    return status;
}

unsigned geared_motor_step(geared_motor_state *s, const geared_motor_params *p, const geared_motor_input *in,
    const geared_motor_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != GEARED_MOTOR_READY) || (p->ready != GEARED_MOTOR_READY)) {
        status = geared_motor_ready(s, p);
    }
    if ((status & GEARED_MOTOR_NO_PARAMETERS) == 0u) {
        status |= geared_motor_run_predict(s, p, in);
        status |= geared_motor_run_update_y1(s, p, measurement);
        status |= geared_motor_run_update_y2(s, p, measurement);
        status |= geared_motor_run_adapt(s, p);
    }
    return status;
}

void geared_motor_estimate(const geared_motor_state *s, const geared_motor_params *p, geared_motor_plant *x)
{
    (void)p;
    /* the plant's state */
    x->phi = s->z[0];
    x->i = s->z[1];
    x->w = -s->z[2];
    x->T = s->z[3];
}

unsigned geared_motor_tune(geared_motor_params *p)
{
    unsigned status = 0u;
    if (p->ready != GEARED_MOTOR_READY) {
        geared_motor_nominal(p);
        status = GEARED_MOTOR_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[11] = {
            {1e-11f, 1e+07f, 0.001f}, /* p->gain.Q[0] */
            {1e-11f, 1e+07f, 1.0f}, /* p->gain.Q[1] */
            {1e-11f, 1e+07f, 10.0f}, /* p->gain.Q[2] */
            {1e-11f, 1e+07f, 1e-05f}, /* p->gain.Q[3] */
            {1e-14f, 1.0f, 1e-08f}, /* p->gain.R[0] */
            {1e-14f, 1.0f, 1e-06f}, /* p->gain.R[1] */
            {1.0f, 2.0f, 2.0f}, /* p->gain.theta_1 */
            {2e-05f, 20.0f, 0.02f}, /* p->gain.rise_time */
            {0.0f, 20000.0f, 20.0f}, /* p->gain.rate */
            {0.0f, 4e+09f, 400.0f}, /* p->gain.gamma_0 */
            {0.0f, 4e+09f, 4000.0f}, /* p->gain.gamma_1 */
        };
        float *const value[11] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.Q[2],
            &p->gain.Q[3],
            &p->gain.R[0],
            &p->gain.R[1],
            &p->gain.theta_1,
            &p->gain.rise_time,
            &p->gain.rate,
            &p->gain.gamma_0,
            &p->gain.gamma_1
        };
        for (unsigned k = 0u; k < 11u; ++k) {
            const float v = *value[k];
            *value[k] = geared_motor_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= GEARED_MOTOR_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

GEARED_MOTOR_RARELY
void geared_motor_reset(geared_motor_state *s)
{
    s->ready = GEARED_MOTOR_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->z[3] = 0.0f;
    s->calls = 0u;
    s->used_y1 = 1u;
    s->used_y2 = 1u;
    s->u = 0.0f;
    geared_motor_clear_fault_counts(s);
    geared_motor_clear_rest(s);
}

void geared_motor_init(geared_motor_state *s, geared_motor_params *p)
{
    geared_motor_nominal(p);
    (void)geared_motor_tune(p);
    geared_motor_reset(s);
}

static const unsigned char geared_motor_layout[8] = {0xE5u, 0x57u, 0xF4u, 0x71u, 0xC7u, 0x41u, 0x66u, 0xBFu};

/* CRC-32 of IEEE 802.3 */
static uint32_t geared_motor_checksum(const unsigned char *bytes, size_t size)
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

void geared_motor_save(const geared_motor_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = geared_motor_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = geared_motor_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned geared_motor_restore(geared_motor_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == GEARED_MOTOR_SAVED) {
        refused = 0u;
        uint32_t sum = geared_motor_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == geared_motor_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = GEARED_MOTOR_READY;
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
