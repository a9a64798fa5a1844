/* radar_track: see radar_track.h, and its manual radar_track.md. */
#include "radar_track.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(RADAR_TRACK_USE_LIBM)
#include <math.h>
#elif defined(RADAR_TRACK_USE_CMSIS)
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
#define RADAR_TRACK_RARELY __attribute__((noinline))
#else
#define RADAR_TRACK_RARELY
#endif

static float radar_track_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float radar_track_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float radar_track_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool radar_track_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float radar_track_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool radar_track_within(float v, float limit)
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
static float radar_track_limit(float v, float most)
{
    return radar_track_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float radar_track_keep(float v, float low, float high, float otherwise, float limit)
{
    return radar_track_within(v, limit) ? radar_track_clamp(v, low, high) : otherwise;
}

/* largest whole number not above v, which an int32_t can hold */
static float radar_track_whole(float v)
{
    const float whole = (float)(int32_t)v;
    return whole - ((whole > v) ? 1.0f : 0.0f);
}

/* largest whole number not above v; numbers from 8388608.0f on are whole */
static float radar_track_floor(float v)
{
    return radar_track_within(v, 8388608.0f) ? radar_track_whole(v) : v;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define RADAR_TRACK_USE_LIBM for those of <math.h>, or RADAR_TRACK_USE_CMSIS for CMSIS-DSP. */
#if defined(RADAR_TRACK_USE_LIBM)
static float radar_track_sqrt(float x)
{
    return sqrtf(x);
}

static float radar_track_atan2(float x, float y)
{
    return atan2f(x, y);
}

#elif defined(RADAR_TRACK_USE_CMSIS)
static float radar_track_sqrt(float x)
{
    return sqrtf(x);
}

static float radar_track_atan2(float x, float y)
{
    return atan2f(x, y);
}

#else
#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether two numbers are one, and meant to be */
static bool radar_track_equal(float a, float b)
{
    return a == b;
}
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

static float radar_track_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float radar_track_nan(void)
{
    const float large = radar_track_inf();
    return large - large;
}

static float radar_track_sqrt(float x)
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
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? radar_track_nan() : 0.0f) : ((x > 3.4028235e+38f) ? x : t16);
}

static float radar_track_atan2(float x, float y)
{
    const float t1 = 1.0f - ((x < 0.0f) ? 2.0f : 0.0f);
    const float t2 = (1.0f - ((y < 0.0f) ? 2.0f : 0.0f))*y;
    const float t3 = t1*x;
    const float t4 = t2 + (radar_track_equal(t2 + t3, 0.0f) ? 1.0f : 0.0f);
    const bool t5 = 0.41421357f*t4 < t3;
    const bool t6 = 2.4142137f*t4 < t3;
    const float t7 = (t5 ? 1.0f : 0.0f) + (t6 ? 1.0f : 0.0f);
    const float t8 = (t6 ? -t4 : (t5 ? t3 - t4 : t3))/(t6 ? t3 : (t5 ? t3 + t4 : t4));
    const float t9 = t8*t8;
    const float t10 = t9*((((0.10598268f - 0.0608735f*t9)*t9 - 0.14244297f)*t9 + 0.19998525f)*t9
        - 0.33333316f)*t8 - 2.1855694e-08f*t7;
    const float t11 = t8 + t10 + 0.7853982f*t7;
    return t1*((y < 0.0f) ? 3.1415927f - (t11 + 8.742278e-08f) : t11);
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void radar_track_flow(float z1, float z2, float z3, float z4, float dz[4])
{
    dz[0] = z1 + 0.5f*z3;
    dz[1] = z2 + 0.5f*z4;
    dz[2] = z3;
    dz[3] = z4;
}

/* memory without its mark is not used: the state begins anew, which the status says */
RADAR_TRACK_RARELY
static unsigned radar_track_ready(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    if (s->ready != RADAR_TRACK_READY) {
        radar_track_reset(s);
        status |= RADAR_TRACK_UNINITIALISED;
    }
    if (p->ready != RADAR_TRACK_READY) {
        radar_track_reset(s);
        status |= RADAR_TRACK_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
RADAR_TRACK_RARELY
static void radar_track_clear_fault_counts(radar_track_state *s)
{
    /* as after a reset */
    s->fault_count_y_r = 0.0f;
    s->fault_limit_y_r = 179.0f;
    s->fault_count_y_b = 0.0f;
    s->fault_limit_y_b = 179.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 358.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
RADAR_TRACK_RARELY
static void radar_track_clear_rest(radar_track_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->L[3] = 0.0f;
    s->L[4] = 0.0f;
    s->L[5] = 0.0f;
    s->D[0] = 10000.0f;
    s->D[1] = 10000.0f;
    s->D[2] = 900.0f;
    s->D[3] = 900.0f;
    s->sample_r = 0.0f;
    s->sample_b = 0.0f;
    /* counters as after a reset */
    s->waits_r = 0u;
    s->waits_b = 0u;
}

/* is a number of the state not finite, or beyond 1e30? */
static bool radar_track_value_lost(const radar_track_state *s)
{
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = radar_track_within(s->z[0], 1e+30f) && radar_track_within(s->z[1], 1e+30f)
            && radar_track_within(s->z[2], 1e+30f);
        const bool t2 = t1 && radar_track_within(s->z[3], 1e+30f) && radar_track_within(s->L[0], 1e+30f)
            && radar_track_within(s->L[1], 1e+30f);
        const bool t3 = t2 && radar_track_within(s->L[2], 1e+30f) && radar_track_within(s->L[3], 1e+30f)
            && radar_track_within(s->L[4], 1e+30f);
        const bool t4 = t3 && radar_track_within(s->L[5], 1e+30f) && radar_track_within(s->D[0], 1e+30f)
            && radar_track_within(s->D[1], 1e+30f);
        const bool t5 = t4 && radar_track_within(s->D[2], 1e+30f) && radar_track_within(s->D[3], 1e+30f)
            && radar_track_within(s->sample_r, 1e+30f);
        lost = !(t5 && radar_track_within(s->sample_b, 1e+30f));
    }
    return lost;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned radar_track_keep_in_box(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    lost = radar_track_value_lost(s);
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = -200.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        status |= RADAR_TRACK_RESTARTED;
        radar_track_clear_fault_counts(s);
        radar_track_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 < -5800.0f || z1 > 2600.0f || radar_track_abs(z2) > 6000.0f
            || radar_track_abs(z3) > 180.0f;
        s->z[0] = radar_track_clamp(z1, -5800.0f, 2600.0f);
        s->z[1] = radar_track_limit(z2, 6000.0f);
        s->z[2] = radar_track_limit(z3, 180.0f);
        s->z[3] = radar_track_limit(z4, 180.0f);
        if (t1 || radar_track_abs(z4) > 180.0f) {
            status |= RADAR_TRACK_STATE_LIMITED;
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
        s->L[0] = radar_track_limit(L21, 1.4285714e+09f);
        s->L[1] = radar_track_limit(L31, 4.2857144e+07f);
        s->L[2] = radar_track_limit(L41, 4.2857144e+07f);
        s->L[3] = radar_track_limit(L32, 3e+07f);
        s->L[4] = radar_track_limit(L42, 3e+07f);
        s->L[5] = radar_track_limit(L43, 1e+09f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        const float D4 = s->D[3];
        s->D[0] = radar_track_clamp(D1, 1e-16f, 1.764e+07f);
        s->D[1] = radar_track_clamp(D2, 4e-15f, 3.6e+07f);
        s->D[2] = radar_track_clamp(D3, 6.25e-14f, 32400.0f);
        s->D[3] = radar_track_clamp(D4, 6.25e-14f, 32400.0f);
    }
    /* keep sample_r in its box */
    {
        const float sample_r = s->sample_r;
        s->sample_r = radar_track_limit(sample_r, 1e+30f);
    }
    /* keep sample_b in its box */
    {
        const float sample_b = s->sample_b;
        s->sample_b = radar_track_limit(sample_b, 1e+30f);
    }
    return status;
}

/* part of a step: check the fault counts, and count the range */
static unsigned radar_track_count_range(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    (void)p;
    float moves_range = 0.0f;
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y_r = s->fault_count_y_r;
        const float fault_limit_y_r = s->fault_limit_y_r;
        const float fault_count_y_b = s->fault_count_y_b;
        const float fault_limit_y_b = s->fault_limit_y_b;
        const float t1 = fault_limit_y_r - 179.0f + radar_track_abs(fault_count_y_r)
            + (fault_limit_y_b - 179.0f + radar_track_abs(fault_count_y_b));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = radar_track_abs(fault_limit_range - 358.0f + fault_count_range + t1
            - s->fault_checksum) < 0.5f;
        const bool t3 = t2 && radar_track_within(fault_count_y_r, 183296.0f) && fault_limit_y_r >= 179.0f
            && fault_limit_y_r <= 183296.0f;
        const bool t4 = t3 && radar_track_within(fault_count_y_b, 183296.0f) && fault_limit_y_b >= 179.0f
            && fault_limit_y_b <= 183296.0f;
        const bool t5 = t4 && fault_count_range >= 0.0f && fault_count_range <= 366592.0f
            && fault_limit_range >= 358.0f && fault_limit_range <= 366592.0f;
        spoiled = !t5;
    }
    if (spoiled) {
        radar_track_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < -3140.0f || z1 > -60.0f || radar_track_abs(s->z[1]) > 2200.0f
            || radar_track_abs(s->z[2]) > 66.0f;
        moves_range = (t1 || radar_track_abs(s->z[3]) > 66.0f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = radar_track_clamp(fault_count_range + moves_range, 0.0f, 366592.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 358.0f : fault_limit_range;
    }
    return status;
}

/* part of a step: project the estimate onto its declared ranges */
static unsigned radar_track_project_onto_ranges(radar_track_state *s, const radar_track_params *p)
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
        const float t2 = z1 - radar_track_clamp(z1, -3000.0f, -200.0f);
        const float t3 = t2/D1;
        const float L21 = s->L[0];
        const float L42 = s->L[4];
        const float D2 = s->D[1];
        const float t4 = L42*D2;
        const float t5 = L21*D1;
        const float t6 = z2 - t5*t3;
        const float t7 = t6 - radar_track_limit(t6, 2000.0f);
        const float t8 = t7/(t5*L21 + D2);
        const float L31 = s->L[1];
        const float L32 = s->L[3];
        const float L43 = s->L[5];
        const float D3 = s->D[2];
        const float t9 = L43*D3;
        const float t10 = L31*D1;
        const float t11 = L32*D2;
        const float t12 = z3 - t10*t3 - (t10*L21 + t11)*t8;
        const float t13 = t12 - radar_track_limit(t12, 60.0f);
        const float t14 = t13/(t10*L31 + t11*L32 + D3);
        const float t15 = z4 - t1*t3 - (t1*L21 + t4)*t8 - (t1*L31 + t4*L32 + t9)*t14;
        const float t16 = t15 - radar_track_limit(t15, 60.0f);
        const float t17 = t15 - t16 - z4;
        const float t18 = (t17 > 0.0f) ? 180.0f - z4 : z4 + 180.0f;
        const float t19 = t16/(t1*L41 + t4*L42 + t9*L43 + s->D[3]);
        const float t20 = t12 - t13 - (t10*L41 + t11*L42 + D3*L43)*t19 - z3;
        const float t21 = (t20 > 0.0f) ? 180.0f - z3 : z3 + 180.0f;
        const float t22 = t6 - t7 - (t5*L31 + D2*L32)*t14 - (t5*L41 + D2*L42)*t19 - z2;
        const float t23 = (t22 > 0.0f) ? 6000.0f - z2 : z2 + 6000.0f;
        const float t24 = z1 - t2 - D1*L21*t8 - D1*L31*t14 - D1*L41*t19 - z1;
        const float t25 = (t24 > 0.0f) ? 2600.0f - z1 : z1 + 5800.0f;
        const float t26 = radar_track_abs(t24);
        const float t27 = (t25 < t26) ? t25/t26 : 1.0f;
        const float t28 = radar_track_abs(t22);
        const float t29 = (t23 < t27*t28) ? t23/t28 : t27;
        const float t30 = radar_track_abs(t20);
        const float t31 = (t21 < t29*t30) ? t21/t30 : t29;
        const float t32 = radar_track_abs(t17);
        const float t33 = (t18 < t31*t32) ? t18/t32 : t31;
        s->z[0] = radar_track_keep(z1 + t33*t24, -5800.0f, 2600.0f, z1, 1e+30f);
        s->z[1] = radar_track_keep(z2 + t33*t22, -6000.0f, 6000.0f, z2, 1e+30f);
        s->z[2] = radar_track_keep(z3 + t33*t20, -180.0f, 180.0f, z3, 1e+30f);
        s->z[3] = radar_track_keep(z4 + t33*t17, -180.0f, 180.0f, z4, 1e+30f);
        status |= RADAR_TRACK_PROJECTED_ONTO_RANGES;
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool radar_track_beyond_box(const radar_track_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 >= -5800.0f && z1 <= 2600.0f && radar_track_within(s->z[1], 6000.0f)
            && radar_track_within(s->z[2], 180.0f);
        const bool t2 = t1 && radar_track_within(s->z[3], 180.0f)
            && radar_track_within(s->L[0], 1.4285714e+09f) && radar_track_within(s->L[1], 4.2857144e+07f);
        const bool t3 = t2 && radar_track_within(s->L[2], 4.2857144e+07f)
            && radar_track_within(s->L[3], 3e+07f) && radar_track_within(s->L[4], 3e+07f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t4 = t3 && radar_track_within(s->L[5], 1e+09f) && D1 >= 1e-16f && D1 <= 1.764e+07f
            && D2 >= 4e-15f && D2 <= 3.6e+07f;
        const float D3 = s->D[2];
        const float D4 = s->D[3];
        beyond = !(t4 && D3 >= 6.25e-14f && D3 <= 32400.0f && D4 >= 6.25e-14f && D4 <= 32400.0f);
    }
    return beyond;
}

/* advance the estimate from the last call to now */
static unsigned radar_track_advance(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    bool beyond = false;
    bool capped = false;
    /* z by the map z+ = f(z, u); P = L D L' by P <- F P F' + Q */
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
        const float w1_1 = 1.0f + 0.5f*L31;
        const float w1_2 = 0.5f*L32;
        const float t1 = w1_1*D1;
        const float t2 = w1_2*D2;
        const float Q1 = p->gain.Q[0];
        const float d1 = w1_1*t1 + w1_2*t2 + 0.25f*D3 + Q1;
        const float t3 = L21 + 0.5f*L41;
        const float t4 = 1.0f + 0.5f*L42;
        const float t5 = 0.5f*L43;
        const float t6 = 0.5f*D3;
        const float t7 = radar_track_max(d1, 1e-16f);
        const float l21 = (t3*t1 + t4*t2 + t5*t6)/t7;
        const float l31 = (L31*t1 + L32*t2 + t6)/t7;
        const float l41 = (L41*t1 + L42*t2 + L43*t6)/t7;
        const float w2_1 = t3 - l21*w1_1;
        const float w2_2 = t4 - l21*w1_2;
        const float w2_3 = t5 - 0.5f*l21;
        const float t8 = w2_1*D1;
        const float t9 = w2_2*D2;
        const float t10 = w2_3*D3;
        const float t11 = l21*Q1;
        const float Q2 = p->gain.Q[1];
        const float d2 = w2_1*t8 + w2_2*t9 + w2_3*t10 + 0.25f*D4 + l21*t11 + Q2;
        const float t12 = L31 - l31*w1_1;
        const float t13 = L32 - l31*w1_2;
        const float t14 = 1.0f - 0.5f*l31;
        const float t15 = radar_track_max(d2, 4e-15f);
        const float l32 = (t12*t8 + t13*t9 + t14*t10 + l31*t11)/t15;
        const float t16 = L41 - l41*w1_1;
        const float t17 = L42 - l41*w1_2;
        const float t18 = L43 - 0.5f*l41;
        const float l42 = (t16*t8 + t17*t9 + t18*t10 + 0.5f*D4 + l41*t11)/t15;
        const float w3_1 = t12 - l32*w2_1;
        const float w3_2 = t13 - l32*w2_2;
        const float w3_3 = t14 - l32*w2_3;
        const float w3_5 = l32*l21 - l31;
        const float t19 = w3_1*D1;
        const float t20 = w3_2*D2;
        const float t21 = w3_3*D3;
        const float t22 = 0.5f*l32;
        const float t23 = t22*D4;
        const float t24 = w3_5*Q1;
        const float t25 = l32*Q2;
        const float Q3 = p->gain.Q[2];
        const float d3 = w3_1*t19 + w3_2*t20 + w3_3*t21 + t22*t23 + w3_5*t24 + l32*t25 + Q3;
        const float t26 = t16 - l42*w2_1;
        const float t27 = t17 - l42*w2_2;
        const float t28 = t18 - l42*w2_3;
        const float t29 = 1.0f - 0.5f*l42;
        const float t30 = l42*l21 - l41;
        const float l43 = (t26*t19 + t27*t20 + t28*t21 - t29*t23 + t30*t24 + l42*t25)/radar_track_max(d3,
            6.25e-14f);
        const float w4_1 = t26 - l43*w3_1;
        const float w4_2 = t27 - l43*w3_2;
        const float w4_3 = t28 - l43*w3_3;
        const float w4_4 = t29 + l43*t22;
        const float w4_5 = t30 - l43*w3_5;
        const float w4_6 = l43*l32 - l42;
        const float t31 = w4_1*D1*w4_1 + w4_2*D2*w4_2 + w4_3*D3*w4_3 + w4_4*D4*w4_4 + w4_5*Q1*w4_5
            + w4_6*Q2*w4_6 + l43*Q3*l43;
        const float d4 = t31 + p->gain.Q[3];
        float dz_1[4];
        radar_track_flow(z1, z2, z3, z4, dz_1);
        s->z[0] = dz_1[0];
        s->z[1] = dz_1[1];
        s->z[2] = dz_1[2];
        s->z[3] = dz_1[3];
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
        capped = D1 > 1.764e+07f || L21*L21*D1 + D2 > 3.6e+07f || L31*L31*D1 + L32*L32*D2 + D3 > 32400.0f
            || L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + s->D[3] > 32400.0f;
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
            const float t1 = radar_track_min(1.0f, 3.6e+07f/(L21*L21*D1 + D2));
            const float t2 = radar_track_min(1.0f, 1.764e+07f/D1);
            const float t3 = radar_track_min(1.0f, 32400.0f/(L31*L31*D1 + L32*L32*D2 + D3));
            const float t4 = radar_track_min(1.0f, 32400.0f/(L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + D4));
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
            status |= RADAR_TRACK_COVARIANCE_LIMITED;
        }
    }
    /* no sample waits */
    s->waits_r = 0u;
    s->waits_b = 0u;
    beyond = radar_track_beyond_box(s);
    if (radar_track_acts(beyond)) {
        status |= radar_track_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned radar_track_run_predict(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    bool running = false;
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= radar_track_advance(s, p);
    } else {
        status |= radar_track_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_r = 0u;
    s->used_b = 0u;
    return status;
}

/* move the estimate to the nearest one that fits the sample of r */
static void radar_track_fit_r(radar_track_state *s, float reading)
{
    /* from the sample of r */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float t1 = radar_track_clamp(z1, -3000.0f, -200.0f);
        const float t2 = radar_track_limit(z2, 2000.0f);
        const float t3 = t1*t1 + t2*t2;
        const bool t4 = t3 >= 7.523164e-37f;
        const float t5 = (t4 ? 1.0f : 0.0f)/((t3 <= 7.523164e-37f ? 1.0f : 0.0f) + (t4 ? 1.0f : 0.0f));
        const float t6 = radar_track_sqrt(radar_track_max(7.523164e-37f, t3));
        const float t7 = 2.0f*t6;
        const float t8 = 2.0f*t1*t5/t7;
        const float t9 = 7.056e+07f*t8;
        const float t10 = 2.0f*t2*t5/t7;
        const float t11 = 1.44e+08f*t10;
        const float t12 = (reading - (t8*(z1 - t1) + t10*(z2 - t2) + t6))/radar_track_max(t8*t9 + t10*t11,
            1.521e-05f);
        s->z[0] = radar_track_keep(z1 + t9*t12, -3000.0f, -200.0f, z1, 1e+30f);
        s->z[1] = radar_track_keep(z2 + t11*t12, -2000.0f, 2000.0f, z2, 1e+30f);
        s->z[2] = radar_track_keep(z3, -60.0f, 60.0f, z3, 1e+30f);
        s->z[3] = radar_track_keep(z4, -60.0f, 60.0f, z4, 1e+30f);
    }
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned radar_track_guard_measurement_r(const radar_track_state *s, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of r */
    {
        const float z1 = s->z[0];
        const float t1 = radar_track_clamp(z1, -3000.0f, -200.0f);
        const float z2 = s->z[1];
        const float t2 = radar_track_limit(z2, 2000.0f);
        const float t3 = t1*t1 + t2*t2;
        const float t4 = radar_track_sqrt(radar_track_max(7.523164e-37f, t3));
        const bool t5 = t3 >= 7.523164e-37f;
        const float t6 = (t5 ? 1.0f : 0.0f)/((t3 <= 7.523164e-37f ? 1.0f : 0.0f) + (t5 ? 1.0f : 0.0f));
        const float t7 = 2.0f*t4;
        const float t8 = reading - (2.0f*t1*t6/t7*(z1 - t1) + 2.0f*t2*t6/t7*(z2 - t2) + t4);
        const bool t9 = reading >= -3800.0f && reading <= 7900.0f && radar_track_within(t8, 1e+16f);
        const bool t10 = radar_track_within(reading, 3e+38f);
        *output_error = t8;
        *valid = t9;
        if (!t10) {
            status |= RADAR_TRACK_MISSING_R;
        }
        if (t10 && !t9) {
            status |= RADAR_TRACK_REJECTED_R;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned radar_track_use_sample_r(radar_track_state *s, const radar_track_params *p, float reading)
{
    unsigned status = 0u;
    bool beyond = false;
    /* the sample of r waits for those of other outputs */
    s->sample_r = reading;
    s->waits_r = (unsigned)(1.0f);
    /* is a value beyond its box, or lost? */
    beyond = !radar_track_within(s->sample_r, 1e+30f);
    if (radar_track_acts(beyond)) {
        status |= radar_track_keep_in_box(s, p);
    }
    /* r is used */
    s->used_r = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool radar_track_suspect_r(const radar_track_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < -3000.0f || z1 > -200.0f || radar_track_abs(s->z[1]) > 2000.0f
            || radar_track_abs(s->z[2]) > 60.0f;
        const bool t2 = radar_track_abs(output_error) > 390.0f || t1 || radar_track_abs(s->z[3]) > 60.0f
            || !(s->fault_checksum <= 0.0f);
        suspect = t2 || !valid;
    }
    return suspect;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool radar_track_sample_in_plausible_range_r(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -3800.0f && reading <= 7900.0f);
    return sampled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void radar_track_find_signs_r(const radar_track_state *s, const radar_track_params *p,
    float *moves_y_r, float output_error, float *side_y_r)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float R1 = p->gain.R[0];
        const float t1 = radar_track_clamp(s->z[0], -3000.0f, -200.0f);
        const float t2 = radar_track_limit(s->z[1], 2000.0f);
        const float t3 = t1*t1 + t2*t2;
        const bool t4 = t3 >= 7.523164e-37f;
        const float t5 = (t4 ? 1.0f : 0.0f)/((t3 <= 7.523164e-37f ? 1.0f : 0.0f) + (t4 ? 1.0f : 0.0f));
        const float t6 = 2.0f*radar_track_sqrt(radar_track_max(7.523164e-37f, t3));
        const float t7 = 2.0f*t1*t5/t6;
        const float D1 = s->D[0];
        const float t8 = 2.0f*t2*t5/t6;
        const float L21 = s->L[0];
        const float t9 = L21*D1;
        const float t10 = radar_track_max(R1 - (t7*(t7*D1 + t8*t9) + t8*(D1*L21*t7 + t8*(t9*L21 + s->D[1]))),
            9.536743e-07f*R1);
        const bool t11 = radar_track_within(output_error, radar_track_max(390.0f,
            radar_track_min(3.0f*radar_track_sqrt(R1*R1/t10), 628.31854f)));
        const float fault_count_y_r = s->fault_count_y_r;
        *moves_y_r = (t11 ? 0.0f : ((fault_count_y_r*output_error < 0.0f) ? -89.0f : 1.0f))
            + (t11 ? -1.0f : 0.0f);
        *side_y_r = (t11 ? 0.0f : output_error) + (t11 ? fault_count_y_r : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned radar_track_recover_r(radar_track_state *s, const radar_track_params *p, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_r = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_r <= radar_track_abs(s->fault_count_y_r);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const bool t3 = z1 < -4400.0f || z1 > 1200.0f || radar_track_abs(s->z[1]) > 4000.0f
            || radar_track_abs(s->z[2]) > 120.0f;
        over_y_r = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 358.0f || t3 || radar_track_abs(s->z[3]) > 120.0f));
    }
    if (over_y_r) {
        /* the fault limit doubles */
        {
            const float fault_count_y_r = s->fault_count_y_r;
            const float fault_limit_y_r = s->fault_limit_y_r;
            const float t1 = radar_track_min(fault_limit_y_r, 91648.0f);
            s->fault_count_y_r = (fault_count_y_r < 0.0f) ? -t1 : t1;
            s->fault_limit_y_r = radar_track_min(2.0f*fault_limit_y_r, 183296.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = radar_track_min(fault_limit_range, 183296.0f);
            s->fault_limit_range = radar_track_min(2.0f*fault_limit_range, 366592.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = -200.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        radar_track_fit_r(s, reading);
        radar_track_fit_r(s, reading);
        radar_track_fit_r(s, reading);
        /* the estimate has restarted from the sample */
        status |= RADAR_TRACK_RESTARTED_FROM_SAMPLE;
        radar_track_clear_rest(s);
    } else {
        status |= radar_track_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with r */
static unsigned radar_track_run_update_r(radar_track_state *s, const radar_track_params *p,
    const radar_track_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    bool fresh = false;
    float moves_y_r = 0.0f;
    float output_error = 0.0f;
    float reading = 0.0f;
    bool sampled = false;
    float side_y_r = 0.0f;
    bool suspect = false;
    bool valid = false;
    /* is a sample of r awaited? */
    fresh = s->used_r < 1u;
    if (fresh) {
        /* the measurement of r */
        reading = measurement->r;
        status |= radar_track_guard_measurement_r(s, &output_error, reading, &valid);
        if (valid) {
            status |= radar_track_use_sample_r(s, p, reading);
        }
        suspect = radar_track_suspect_r(s, output_error, valid);
        if (suspect) {
            sampled = radar_track_sample_in_plausible_range_r(reading, valid);
            if (sampled) {
                status |= radar_track_count_range(s, p);
                radar_track_find_signs_r(s, p, &moves_y_r, output_error, &side_y_r);
                /* count of y_r */
                {
                    const float fault_count_y_r = s->fault_count_y_r;
                    const float fault_limit_y_r = s->fault_limit_y_r;
                    const float t1 = radar_track_clamp(radar_track_abs(fault_count_y_r) + moves_y_r, 0.0f,
                        183296.0f);
                    s->fault_count_y_r = (side_y_r < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_r = (t1 <= 0.0f) ? 179.0f : fault_limit_y_r;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_r <= radar_track_abs(s->fault_count_y_r)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= radar_track_recover_r(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_r - 179.0f + radar_track_abs(s->fault_count_y_r)
                        + (s->fault_limit_y_b - 179.0f + radar_track_abs(s->fault_count_y_b));
                    s->fault_checksum = s->fault_limit_range - 358.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= RADAR_TRACK_OUT_OF_ORDER;
    }
    return status;
}

/* move the estimate to the nearest one that fits the sample of b */
static void radar_track_fit_b(radar_track_state *s, float reading)
{
    /* from the sample of b */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float t1 = radar_track_limit(z2, 2000.0f);
        const float t2 = radar_track_clamp(z1, -3000.0f, -200.0f);
        const float t3 = t1*t1 + t2*t2;
        const float t4 = t1/t3;
        const float t5 = 7.056e+07f*t4;
        const float t6 = t2/t3;
        const float t7 = reading - (t6*(z2 - t1) - t4*(z1 - t2) + radar_track_atan2(t1, t2));
        const float t8 = radar_track_floor(0.15915494f*t7 + 0.5f);
        const float t9 = 1.44e+08f*t6;
        const float t10 = (t7 - 6.28125f*t8 - 0.0019353072f*t8)/radar_track_max(t4*t5 + t6*t9,
            3.9478417e-11f);
        s->z[0] = radar_track_keep(z1 - t5*t10, -3000.0f, -200.0f, z1, 1e+30f);
        s->z[1] = radar_track_keep(z2 + t9*t10, -2000.0f, 2000.0f, z2, 1e+30f);
        s->z[2] = radar_track_keep(z3, -60.0f, 60.0f, z3, 1e+30f);
        s->z[3] = radar_track_keep(z4, -60.0f, 60.0f, z4, 1e+30f);
    }
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned radar_track_guard_measurement_b(const radar_track_state *s, float *output_error,
    float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of b */
    {
        const float z2 = s->z[1];
        const float t1 = radar_track_limit(z2, 2000.0f);
        const float z1 = s->z[0];
        const float t2 = radar_track_clamp(z1, -3000.0f, -200.0f);
        const float t3 = t1*t1 + t2*t2;
        const float t4 = reading - (t2/t3*(z2 - t1) - t1/t3*(z1 - t2) + radar_track_atan2(t1, t2));
        const float t5 = radar_track_floor(0.15915494f*t4 + 0.5f);
        const float t6 = t4 - 6.28125f*t5 - 0.0019353072f*t5;
        const bool t7 = radar_track_within(reading, 6437.12f) && radar_track_within(t6, 1e+16f);
        const bool t8 = radar_track_within(reading, 3e+38f);
        *output_error = t6;
        *valid = t7;
        if (!t8) {
            status |= RADAR_TRACK_MISSING_B;
        }
        if (t8 && !t7) {
            status |= RADAR_TRACK_REJECTED_B;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned radar_track_use_sample_b(radar_track_state *s, const radar_track_params *p, float reading)
{
    unsigned status = 0u;
    bool beyond = false;
    /* the sample of b waits for those of other outputs */
    s->sample_b = reading;
    s->waits_b = (unsigned)(1.0f);
    /* is a value beyond its box, or lost? */
    beyond = !radar_track_within(s->sample_b, 1e+30f);
    if (radar_track_acts(beyond)) {
        status |= radar_track_keep_in_box(s, p);
    }
    /* b is used */
    s->used_b = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool radar_track_suspect_b(const radar_track_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < -3000.0f || z1 > -200.0f || radar_track_abs(s->z[1]) > 2000.0f
            || radar_track_abs(s->z[2]) > 60.0f;
        const bool t2 = radar_track_abs(output_error) > 0.62831855f || t1 || radar_track_abs(s->z[3]) > 60.0f
            || !(s->fault_checksum <= 0.0f);
        suspect = t2 || !valid;
    }
    return suspect;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void radar_track_find_signs_b(const radar_track_state *s, float *moves_y_b, float output_error,
    float *side_y_b)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = radar_track_within(output_error, 0.62831855f);
        const float fault_count_y_b = s->fault_count_y_b;
        *moves_y_b = (t1 ? 0.0f : ((fault_count_y_b*output_error < 0.0f) ? -89.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_b = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_b : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned radar_track_recover_b(radar_track_state *s, const radar_track_params *p, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_b = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_b <= radar_track_abs(s->fault_count_y_b);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const bool t3 = z1 < -4400.0f || z1 > 1200.0f || radar_track_abs(s->z[1]) > 4000.0f
            || radar_track_abs(s->z[2]) > 120.0f;
        over_y_b = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 358.0f || t3 || radar_track_abs(s->z[3]) > 120.0f));
    }
    if (over_y_b) {
        /* the fault limit doubles */
        {
            const float fault_count_y_b = s->fault_count_y_b;
            const float fault_limit_y_b = s->fault_limit_y_b;
            const float t1 = radar_track_min(fault_limit_y_b, 91648.0f);
            s->fault_count_y_b = (fault_count_y_b < 0.0f) ? -t1 : t1;
            s->fault_limit_y_b = radar_track_min(2.0f*fault_limit_y_b, 183296.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = radar_track_min(fault_limit_range, 183296.0f);
            s->fault_limit_range = radar_track_min(2.0f*fault_limit_range, 366592.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = -200.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        radar_track_fit_b(s, reading);
        radar_track_fit_b(s, reading);
        radar_track_fit_b(s, reading);
        /* the estimate has restarted from the sample */
        status |= RADAR_TRACK_RESTARTED_FROM_SAMPLE;
        radar_track_clear_rest(s);
    } else {
        status |= radar_track_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with b */
static unsigned radar_track_run_update_b(radar_track_state *s, const radar_track_params *p,
    const radar_track_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    bool fresh = false;
    float moves_y_b = 0.0f;
    float output_error = 0.0f;
    float reading = 0.0f;
    bool sampled = false;
    float side_y_b = 0.0f;
    bool suspect = false;
    bool valid = false;
    /* is a sample of b awaited? */
    fresh = s->used_b < 1u;
    if (fresh) {
        /* the measurement of b */
        reading = measurement->b;
        status |= radar_track_guard_measurement_b(s, &output_error, reading, &valid);
        if (valid) {
            status |= radar_track_use_sample_b(s, p, reading);
        }
        suspect = radar_track_suspect_b(s, output_error, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || radar_track_within(reading, 6437.12f);
            if (sampled) {
                status |= radar_track_count_range(s, p);
                radar_track_find_signs_b(s, &moves_y_b, output_error, &side_y_b);
                /* count of y_b */
                {
                    const float fault_count_y_b = s->fault_count_y_b;
                    const float fault_limit_y_b = s->fault_limit_y_b;
                    const float t1 = radar_track_clamp(radar_track_abs(fault_count_y_b) + moves_y_b, 0.0f,
                        183296.0f);
                    s->fault_count_y_b = (side_y_b < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_b = (t1 <= 0.0f) ? 179.0f : fault_limit_y_b;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_b <= radar_track_abs(s->fault_count_y_b)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= radar_track_recover_b(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_r - 179.0f + radar_track_abs(s->fault_count_y_r)
                        + (s->fault_limit_y_b - 179.0f + radar_track_abs(s->fault_count_y_b));
                    s->fault_checksum = s->fault_limit_range - 358.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= RADAR_TRACK_OUT_OF_ORDER;
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool radar_track_beyond_box_adapt(const radar_track_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 >= -5800.0f && z1 <= 2600.0f && radar_track_within(s->z[1], 6000.0f)
            && radar_track_within(s->z[2], 180.0f);
        const bool t2 = t1 && radar_track_within(s->z[3], 180.0f)
            && radar_track_within(s->L[0], 1.4285714e+09f) && radar_track_within(s->L[1], 4.2857144e+07f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && radar_track_within(s->L[2], 4.2857144e+07f) && D1 >= 1e-16f && D1 <= 1.764e+07f
            && D2 >= 4e-15f && D2 <= 3.6e+07f;
        beyond = !t3;
    }
    return beyond;
}

/* part of a step: correct by all samples; once after the updates */
static unsigned radar_track_run_adapt(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    bool beyond = false;
    float errors[2];
    float predicted_z[4];
    float rows[4];
    float variances[2];
    bool waits_b_now = false;
    bool waits_r_now = false;
    /* the innovations and rows at the prediction, with independent noises */
    {
        const float z1 = s->z[0];
        const float t1 = radar_track_clamp(z1, -3000.0f, -200.0f);
        const float t2 = t1*t1;
        const float z2 = s->z[1];
        const float t3 = radar_track_limit(z2, 2000.0f);
        const float t4 = t3*t3;
        const float t5 = t2 + t4;
        const float t6 = radar_track_sqrt(radar_track_max(7.523164e-37f, t5));
        const bool t7 = t5 >= 7.523164e-37f;
        const float t8 = (t7 ? 1.0f : 0.0f)/((t5 <= 7.523164e-37f ? 1.0f : 0.0f) + (t7 ? 1.0f : 0.0f));
        const float t9 = 2.0f*t6;
        const float t10 = 2.0f*t1*t8/t9;
        const float t11 = z1 - t1;
        const float t12 = 2.0f*t3*t8/t9;
        const float t13 = z2 - t3;
        const float t14 = t4 + t2;
        const float t15 = t1/t14;
        const float t16 = t3/t14;
        const float t17 = s->sample_b - (t15*t13 - t16*t11 + radar_track_atan2(t3, t1));
        const float t18 = radar_track_floor(0.15915494f*t17 + 0.5f);
        const float t19 = t17 - 6.28125f*t18 - 0.0019353072f*t18;
        const float t20 = radar_track_floor(0.15915494f*t19 + 0.5f);
        errors[0] = ((float)s->waits_r > 0.0f) ? s->sample_r - (t10*t11 + t12*t13 + t6) : 0.0f;
        errors[1] = ((float)s->waits_b > 0.0f) ? t19 - 6.28125f*t20 - 0.0019353072f*t20 : 0.0f;
        predicted_z[0] = z1;
        predicted_z[1] = z2;
        predicted_z[2] = s->z[2];
        predicted_z[3] = s->z[3];
        rows[0] = t10;
        rows[1] = -t16;
        rows[2] = t12;
        rows[3] = t15;
        variances[0] = p->gain.R[0];
        variances[1] = p->gain.R[1];
    }
    /* which samples wait? */
    waits_r_now = s->waits_r > 0u;
    waits_b_now = s->waits_b > 0u;
    if (waits_r_now) {
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
            const float rows1 = rows[0];
            const float rows3 = rows[2];
            const float t1 = rows1 + L21*rows3;
            const float t2 = D1*t1;
            const float variances1 = variances[0];
            const float t3 = D2*rows3;
            const float t4 = variances1 + t3*rows3;
            const float t5 = t4 + t2*t1;
            const float K1 = t2/t5;
            const float K2 = (t3 + L21*t2)/t5;
            const float t6 = L32*t3;
            const float K3 = (t6 + L31*t2)/t5;
            const float t7 = L42*t3;
            const float K4 = (t7 + L41*t2)/t5;
            const float t8 = errors[0] - (rows1*(z1 - predicted_z[0]) + rows3*(z2 - predicted_z[1]));
            s->z[0] = z1 + K1*t8;
            s->z[1] = z2 + K2*t8;
            s->z[2] = z3 + K3*t8;
            s->z[3] = z4 + K4*t8;
            s->L[0] = L21 - t1*t3/t4;
            s->L[1] = L31 - t1*t6/t4;
            s->L[2] = L41 - t1*t7/t4;
            s->D[0] = D1*t4/t5;
            s->D[1] = D2*variances1/t4;
        }
    }
    if (waits_b_now) {
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
            const float rows2 = rows[1];
            const float rows4 = rows[3];
            const float t1 = rows2 + L21*rows4;
            const float t2 = D1*t1;
            const float variances2 = variances[1];
            const float t3 = D2*rows4;
            const float t4 = variances2 + t3*rows4;
            const float t5 = t4 + t2*t1;
            const float K1 = t2/t5;
            const float K2 = (t3 + L21*t2)/t5;
            const float t6 = L32*t3;
            const float K3 = (t6 + L31*t2)/t5;
            const float t7 = L42*t3;
            const float K4 = (t7 + L41*t2)/t5;
            const float t8 = errors[1] - (rows2*(z1 - predicted_z[0]) + rows4*(z2 - predicted_z[1]));
            s->z[0] = z1 + K1*t8;
            s->z[1] = z2 + K2*t8;
            s->z[2] = z3 + K3*t8;
            s->z[3] = z4 + K4*t8;
            s->L[0] = L21 - t1*t3/t4;
            s->L[1] = L31 - t1*t6/t4;
            s->L[2] = L41 - t1*t7/t4;
            s->D[0] = D1*t4/t5;
            s->D[1] = D2*variances2/t4;
        }
    }
    /* no sample waits */
    s->waits_r = 0u;
    s->waits_b = 0u;
    beyond = radar_track_beyond_box_adapt(s);
    if (radar_track_acts(beyond)) {
        status |= radar_track_keep_in_box(s, p);
    }
    /* outside the declared box the model is evaluated at its edge */
    {
        const float z1 = s->z[0];
        const bool t1 = z1 < -3000.0f || z1 > -200.0f || radar_track_abs(s->z[1]) > 2000.0f
            || radar_track_abs(s->z[2]) > 60.0f;
        if (t1 || radar_track_abs(s->z[3]) > 60.0f) {
            status |= RADAR_TRACK_OUTSIDE_BOX;
        }
    }
    return status;
}

/* nominal parameters */
RADAR_TRACK_RARELY
static void radar_track_nominal(radar_track_params *p)
{
    p->ready = RADAR_TRACK_READY;
    p->gain.Q[0] = 0.004f;
    p->gain.Q[1] = 0.004f;
    p->gain.Q[2] = 0.0625f;
    p->gain.Q[3] = 0.0625f;
    p->gain.R[0] = 100.0f;
    p->gain.R[1] = 0.0001f;
}

unsigned radar_track_predict(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    if ((s->ready != RADAR_TRACK_READY) || (p->ready != RADAR_TRACK_READY)) {
        status = radar_track_ready(s, p);
    }
    if ((status & RADAR_TRACK_NO_PARAMETERS) == 0u) {
        status |= radar_track_run_predict(s, p);
    }
    return status;
}

unsigned radar_track_update_r(radar_track_state *s, const radar_track_params *p,
    const radar_track_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != RADAR_TRACK_READY) || (p->ready != RADAR_TRACK_READY)) {
        status = radar_track_ready(s, p);
    }
    if ((status & RADAR_TRACK_NO_PARAMETERS) == 0u) {
        status |= radar_track_run_update_r(s, p, measurement);
    }
    return status;
}

unsigned radar_track_update_b(radar_track_state *s, const radar_track_params *p,
    const radar_track_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != RADAR_TRACK_READY) || (p->ready != RADAR_TRACK_READY)) {
        status = radar_track_ready(s, p);
    }
    if ((status & RADAR_TRACK_NO_PARAMETERS) == 0u) {
        status |= radar_track_run_update_b(s, p, measurement);
    }
    return status;
}

unsigned radar_track_adapt(radar_track_state *s, const radar_track_params *p)
{
    unsigned status = 0u;
    if ((s->ready != RADAR_TRACK_READY) || (p->ready != RADAR_TRACK_READY)) {
        status = radar_track_ready(s, p);
    }
    if ((status & RADAR_TRACK_NO_PARAMETERS) == 0u) {
        status |= radar_track_run_adapt(s, p);
    }
    return status;
}

unsigned radar_track_step(radar_track_state *s, const radar_track_params *p,
    const radar_track_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != RADAR_TRACK_READY) || (p->ready != RADAR_TRACK_READY)) {
        status = radar_track_ready(s, p);
    }
    if ((status & RADAR_TRACK_NO_PARAMETERS) == 0u) {
        status |= radar_track_run_predict(s, p);
        status |= radar_track_run_update_r(s, p, measurement);
        status |= radar_track_run_update_b(s, p, measurement);
        status |= radar_track_run_adapt(s, p);
    }
    return status;
}

void radar_track_estimate(const radar_track_state *s, const radar_track_params *p, radar_track_plant *x)
{
    (void)p;
    /* the plant's state */
    x->px = s->z[0];
    x->py = s->z[1];
    x->vx = s->z[2];
    x->vy = s->z[3];
}

unsigned radar_track_tune(radar_track_params *p)
{
    unsigned status = 0u;
    if (p->ready != RADAR_TRACK_READY) {
        radar_track_nominal(p);
        status = RADAR_TRACK_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[6] = {
            {4e-09f, 62500.0f, 0.004f}, /* p->gain.Q[0] */
            {4e-09f, 62500.0f, 0.004f}, /* p->gain.Q[1] */
            {4e-09f, 62500.0f, 0.0625f}, /* p->gain.Q[2] */
            {4e-09f, 62500.0f, 0.0625f}, /* p->gain.Q[3] */
            {1e-10f, 1e+08f, 100.0f}, /* p->gain.R[0] */
            {1e-10f, 1e+08f, 0.0001f}, /* p->gain.R[1] */
        };
        float *const value[6] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.Q[2],
            &p->gain.Q[3],
            &p->gain.R[0],
            &p->gain.R[1]
        };
        for (unsigned k = 0u; k < 6u; ++k) {
            const float v = *value[k];
            *value[k] = radar_track_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= RADAR_TRACK_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

RADAR_TRACK_RARELY
void radar_track_reset(radar_track_state *s)
{
    s->ready = RADAR_TRACK_READY;
    s->z[0] = -200.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->z[3] = 0.0f;
    s->calls = 0u;
    s->used_r = 1u;
    s->used_b = 1u;
    radar_track_clear_fault_counts(s);
    radar_track_clear_rest(s);
}

void radar_track_init(radar_track_state *s, radar_track_params *p)
{
    radar_track_nominal(p);
    (void)radar_track_tune(p);
    radar_track_reset(s);
}

static const unsigned char radar_track_layout[8] = {0x4Bu, 0xADu, 0x42u, 0xA8u, 0x8Eu, 0xE5u, 0xACu, 0x47u};

/* CRC-32 of IEEE 802.3 */
static uint32_t radar_track_checksum(const unsigned char *bytes, size_t size)
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

void radar_track_save(const radar_track_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = radar_track_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = radar_track_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned radar_track_restore(radar_track_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == RADAR_TRACK_SAVED) {
        refused = 0u;
        uint32_t sum = radar_track_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == radar_track_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = RADAR_TRACK_READY;
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
