/* quadruple_tank: see quadruple_tank.h, and its manual quadruple_tank.md. */
#include "quadruple_tank.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(QUADRUPLE_TANK_USE_LIBM)
#include <math.h>
#elif defined(QUADRUPLE_TANK_USE_CMSIS)
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
#define QUADRUPLE_TANK_RARELY __attribute__((noinline))
#else
#define QUADRUPLE_TANK_RARELY
#endif

static float quadruple_tank_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float quadruple_tank_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool quadruple_tank_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float quadruple_tank_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool quadruple_tank_within(float v, float limit)
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

/* whether v is a number in [low, high] */
static bool quadruple_tank_inside(float v, float low, float high)
{
    return v >= low && v <= high;
}

/* v in [-most, most] */
static float quadruple_tank_limit(float v, float most)
{
    return quadruple_tank_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float quadruple_tank_keep(float v, float low, float high, float otherwise, float limit)
{
    return quadruple_tank_within(v, limit) ? quadruple_tank_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define QUADRUPLE_TANK_USE_LIBM for those of <math.h>, or QUADRUPLE_TANK_USE_CMSIS for CMSIS-DSP. */
#if defined(QUADRUPLE_TANK_USE_LIBM)
static float quadruple_tank_sqrt(float x)
{
    return sqrtf(x);
}

#elif defined(QUADRUPLE_TANK_USE_CMSIS)
static float quadruple_tank_sqrt(float x)
{
    return sqrtf(x);
}

#else
static float quadruple_tank_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float quadruple_tank_nan(void)
{
    const float large = quadruple_tank_inf();
    return large - large;
}

static float quadruple_tank_sqrt(float x)
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
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? quadruple_tank_nan() : 0.0f)
        : ((x > 3.4028235e+38f) ? x : t16);
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void quadruple_tank_flow(float z1, float z2, float z3, float z4, float u1, float u2, float dz[4])
{
    const float t1 = 0.11f*quadruple_tank_sqrt(quadruple_tank_clamp(z3, 0.5f, 20.0f));
    const float t2 = 0.08f*quadruple_tank_sqrt(quadruple_tank_clamp(z4, 0.5f, 20.0f));
    dz[0] = 0.08f*u1 - 0.11f*quadruple_tank_sqrt(quadruple_tank_clamp(z1, 1.0f, 20.0f)) + t1;
    dz[1] = 0.06f*u2 - 0.08f*quadruple_tank_sqrt(quadruple_tank_clamp(z2, 1.0f, 20.0f)) + t2;
    dz[2] = 0.05f*u2 - t1;
    dz[3] = 0.03f*u1 - t2;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void quadruple_tank_jacobian(float z1, float z2, float z3, float z4, float F[6])
{
    const float t1 = 0.11f/(2.0f*quadruple_tank_sqrt(quadruple_tank_clamp(z3, 0.5f, 20.0f)));
    const float t2 = 0.08f/(2.0f*quadruple_tank_sqrt(quadruple_tank_clamp(z4, 0.5f, 20.0f)));
    F[0] = -(0.11f/(2.0f*quadruple_tank_sqrt(quadruple_tank_clamp(z1, 1.0f, 20.0f)))); /* F_11 */
    F[1] = -(0.08f/(2.0f*quadruple_tank_sqrt(quadruple_tank_clamp(z2, 1.0f, 20.0f)))); /* F_22 */
    F[2] = t1; /* F_13 */
    F[3] = -t1; /* F_33 */
    F[4] = t2; /* F_24 */
    F[5] = -t2; /* F_44 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
QUADRUPLE_TANK_RARELY
static uint32_t quadruple_tank_ready(quadruple_tank_state *s, const quadruple_tank_params *p)
{
    uint32_t status = 0u;
    if (s->ready != QUADRUPLE_TANK_READY) {
        quadruple_tank_reset(s);
        status |= QUADRUPLE_TANK_UNINITIALISED;
    }
    if (p->ready != QUADRUPLE_TANK_READY) {
        quadruple_tank_reset(s);
        status |= QUADRUPLE_TANK_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
QUADRUPLE_TANK_RARELY
static void quadruple_tank_clear_fault_counts(quadruple_tank_state *s)
{
    /* as after a reset */
    s->fault_count_y_y1 = 0.0f;
    s->fault_limit_y_y1 = 115.0f;
    s->fault_count_y_y2 = 0.0f;
    s->fault_limit_y_y2 = 115.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 229.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
QUADRUPLE_TANK_RARELY
static void quadruple_tank_clear_rest(quadruple_tank_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->L[3] = 0.0f;
    s->L[4] = 0.0f;
    s->L[5] = 0.0f;
    s->D[0] = 90.0f;
    s->D[1] = 90.0f;
    s->D[2] = 100.0f;
    s->D[3] = 100.0f;
}

/* is a number of the state not finite, or beyond 1e30? */
static bool quadruple_tank_value_lost(const quadruple_tank_state *s)
{
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = quadruple_tank_within(s->z[0], 1e+30f) && quadruple_tank_within(s->z[1], 1e+30f)
            && quadruple_tank_within(s->z[2], 1e+30f);
        const bool t2 = t1 && quadruple_tank_within(s->z[3], 1e+30f)
            && quadruple_tank_within(s->L[0], 1e+30f) && quadruple_tank_within(s->L[1], 1e+30f);
        const bool t3 = t2 && quadruple_tank_within(s->L[2], 1e+30f)
            && quadruple_tank_within(s->L[3], 1e+30f) && quadruple_tank_within(s->L[4], 1e+30f);
        const bool t4 = t3 && quadruple_tank_within(s->L[5], 1e+30f)
            && quadruple_tank_within(s->D[0], 1e+30f) && quadruple_tank_within(s->D[1], 1e+30f);
        lost = !(t4 && quadruple_tank_within(s->D[2], 1e+30f) && quadruple_tank_within(s->D[3], 1e+30f));
    }
    return lost;
}

/* part of a step: keep the state in its box, or make it anew */
static uint32_t quadruple_tank_keep_in_box(quadruple_tank_state *s, const quadruple_tank_params *p)
{
    uint32_t status = 0u;
    (void)p;
    bool lost = false;
    lost = quadruple_tank_value_lost(s);
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 1.0f;
        s->z[1] = 1.0f;
        s->z[2] = 0.5f;
        s->z[3] = 0.5f;
        status |= QUADRUPLE_TANK_RESTARTED;
        quadruple_tank_clear_fault_counts(s);
        quadruple_tank_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        s->z[0] = quadruple_tank_clamp(z1, -18.0f, 39.0f);
        s->z[1] = quadruple_tank_clamp(z2, -18.0f, 39.0f);
        s->z[2] = quadruple_tank_clamp(z3, -19.0f, 39.5f);
        s->z[3] = quadruple_tank_clamp(z4, -19.0f, 39.5f);
        if (z1 < -18.0f || z1 > 39.0f || z2 < -18.0f || z2 > 39.0f || z3 < -19.0f || z3 > 39.5f
            || z4 < -19.0f || z4 > 39.5f) {
            status |= QUADRUPLE_TANK_STATE_LIMITED;
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
        s->L[0] = quadruple_tank_limit(L21, 1e+09f);
        s->L[1] = quadruple_tank_limit(L31, 1.0263158e+09f);
        s->L[2] = quadruple_tank_limit(L41, 1.0263158e+09f);
        s->L[3] = quadruple_tank_limit(L32, 1.0263158e+09f);
        s->L[4] = quadruple_tank_limit(L42, 1.0263158e+09f);
        s->L[5] = quadruple_tank_limit(L43, 1e+09f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        const float D4 = s->D[3];
        s->D[0] = quadruple_tank_clamp(D1, 4e-16f, 812.25f);
        s->D[1] = quadruple_tank_clamp(D2, 6e-15f, 812.25f);
        s->D[2] = quadruple_tank_clamp(D3, 6e-15f, 855.5625f);
        s->D[3] = quadruple_tank_clamp(D4, 6e-15f, 855.5625f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool quadruple_tank_counts_spoiled(const quadruple_tank_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y_y1 = s->fault_count_y_y1;
        const float fault_limit_y_y1 = s->fault_limit_y_y1;
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float fault_limit_y_y2 = s->fault_limit_y_y2;
        const float t1 = fault_limit_y_y1 - 115.0f + quadruple_tank_abs(fault_count_y_y1)
            + (fault_limit_y_y2 - 115.0f + quadruple_tank_abs(fault_count_y_y2));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = quadruple_tank_abs(fault_limit_range - 229.0f + fault_count_range + t1
            - s->fault_checksum) < 0.5f;
        const bool t3 = t2 && quadruple_tank_within(fault_count_y_y1, 117760.0f)
            && fault_limit_y_y1 >= 115.0f && fault_limit_y_y1 <= 117760.0f;
        const bool t4 = t3 && quadruple_tank_within(fault_count_y_y2, 117760.0f)
            && fault_limit_y_y2 >= 115.0f && fault_limit_y_y2 <= 117760.0f;
        const bool t5 = t4 && fault_count_range >= 0.0f && fault_count_range <= 234496.0f
            && fault_limit_range >= 229.0f && fault_limit_range <= 234496.0f;
        spoiled = !t5;
    }
    return spoiled;
}

/* part of a step: check the fault counts, and count the range */
static uint32_t quadruple_tank_count_range(quadruple_tank_state *s, const quadruple_tank_params *p)
{
    uint32_t status = 0u;
    (void)p;
    float moves_range = 0.0f;
    bool spoiled = false;
    spoiled = quadruple_tank_counts_spoiled(s);
    if (spoiled) {
        quadruple_tank_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 < 0.05f || z1 > 20.95f || z2 < 0.05f || z2 > 20.95f || z3 < -0.475f
            || z3 > 20.975f || z4 < -0.475f || z4 > 20.975f;
        moves_range = t1 ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = quadruple_tank_clamp(fault_count_range + moves_range, 0.0f, 234496.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 229.0f : fault_limit_range;
    }
    return status;
}

/* part of a step: project the estimate onto its declared ranges */
static uint32_t quadruple_tank_project_onto_ranges(quadruple_tank_state *s, const quadruple_tank_params *p)
{
    uint32_t status = 0u;
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
        const float t2 = z1 - quadruple_tank_clamp(z1, 1.0f, 20.0f);
        const float t3 = t2/D1;
        const float L21 = s->L[0];
        const float L42 = s->L[4];
        const float D2 = s->D[1];
        const float t4 = L42*D2;
        const float t5 = L21*D1;
        const float t6 = z2 - t5*t3;
        const float t7 = t6 - quadruple_tank_clamp(t6, 1.0f, 20.0f);
        const float t8 = t7/(t5*L21 + D2);
        const float L31 = s->L[1];
        const float L32 = s->L[3];
        const float L43 = s->L[5];
        const float D3 = s->D[2];
        const float t9 = L43*D3;
        const float t10 = L31*D1;
        const float t11 = L32*D2;
        const float t12 = z3 - t10*t3 - (t10*L21 + t11)*t8;
        const float t13 = t12 - quadruple_tank_clamp(t12, 0.5f, 20.0f);
        const float t14 = t13/(t10*L31 + t11*L32 + D3);
        const float t15 = z4 - t1*t3 - (t1*L21 + t4)*t8 - (t1*L31 + t4*L32 + t9)*t14;
        const float t16 = t15 - quadruple_tank_clamp(t15, 0.5f, 20.0f);
        const float t17 = t15 - t16 - z4;
        const float t18 = (t17 > 0.0f) ? 39.5f - z4 : z4 + 19.0f;
        const float t19 = t16/(t1*L41 + t4*L42 + t9*L43 + s->D[3]);
        const float t20 = t12 - t13 - (t10*L41 + t11*L42 + D3*L43)*t19 - z3;
        const float t21 = (t20 > 0.0f) ? 39.5f - z3 : z3 + 19.0f;
        const float t22 = t6 - t7 - (t5*L31 + D2*L32)*t14 - (t5*L41 + D2*L42)*t19 - z2;
        const float t23 = (t22 > 0.0f) ? 39.0f - z2 : z2 + 18.0f;
        const float t24 = z1 - t2 - D1*L21*t8 - D1*L31*t14 - D1*L41*t19 - z1;
        const float t25 = (t24 > 0.0f) ? 39.0f - z1 : z1 + 18.0f;
        const float t26 = quadruple_tank_abs(t24);
        const float t27 = (t25 < t26) ? t25/t26 : 1.0f;
        const float t28 = quadruple_tank_abs(t22);
        const float t29 = (t23 < t27*t28) ? t23/t28 : t27;
        const float t30 = quadruple_tank_abs(t20);
        const float t31 = (t21 < t29*t30) ? t21/t30 : t29;
        const float t32 = quadruple_tank_abs(t17);
        const float t33 = (t18 < t31*t32) ? t18/t32 : t31;
        s->z[0] = quadruple_tank_keep(z1 + t33*t24, -18.0f, 39.0f, z1, 1e+30f);
        s->z[1] = quadruple_tank_keep(z2 + t33*t22, -18.0f, 39.0f, z2, 1e+30f);
        s->z[2] = quadruple_tank_keep(z3 + t33*t20, -19.0f, 39.5f, z3, 1e+30f);
        s->z[3] = quadruple_tank_keep(z4 + t33*t17, -19.0f, 39.5f, z4, 1e+30f);
        status |= QUADRUPLE_TANK_PROJECTED_ONTO_RANGES;
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static uint32_t quadruple_tank_guard_input(const quadruple_tank_state *s, const quadruple_tank_input *in,
    float *u)
{
    uint32_t status = 0u;
    /* guard the input */
    {
        const float v1 = in->v1;
        const bool v1_usable = quadruple_tank_within(v1, 1e+15f);
        const float v1_taken = v1_usable ? v1 : s->u[0];
        const float v2 = in->v2;
        const bool v2_usable = quadruple_tank_within(v2, 1e+15f);
        const float v2_taken = v2_usable ? v2 : s->u[1];
        u[0] = quadruple_tank_clamp(v1_taken, 0.0f, 6.0f);
        u[1] = quadruple_tank_clamp(v2_taken, 0.0f, 6.0f);
        if (!v1_usable) {
            status |= QUADRUPLE_TANK_REUSED_V1;
        }
        if (v1_taken < 0.0f || v1_taken > 6.0f) {
            status |= QUADRUPLE_TANK_CLAMPED_V1;
        }
        if (!v2_usable) {
            status |= QUADRUPLE_TANK_REUSED_V2;
        }
        if (v2_taken < 0.0f || v2_taken > 6.0f) {
            status |= QUADRUPLE_TANK_CLAMPED_V2;
        }
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool quadruple_tank_beyond_box(const quadruple_tank_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = quadruple_tank_inside(s->z[0], -18.0f, 39.0f)
            && quadruple_tank_inside(s->z[1], -18.0f, 39.0f);
        const bool t2 = t1 && quadruple_tank_inside(s->z[2], -19.0f, 39.5f)
            && quadruple_tank_inside(s->z[3], -19.0f, 39.5f);
        const bool t3 = t2 && quadruple_tank_within(s->L[0], 1e+09f)
            && quadruple_tank_within(s->L[1], 1.0263158e+09f);
        const bool t4 = t3 && quadruple_tank_within(s->L[2], 1.0263158e+09f)
            && quadruple_tank_within(s->L[3], 1.0263158e+09f);
        const bool t5 = t4 && quadruple_tank_within(s->L[4], 1.0263158e+09f)
            && quadruple_tank_within(s->L[5], 1e+09f);
        const bool t6 = t5 && quadruple_tank_inside(s->D[0], 4e-16f, 812.25f)
            && quadruple_tank_inside(s->D[1], 6e-15f, 812.25f);
        const bool t7 = t6 && quadruple_tank_inside(s->D[2], 6e-15f, 855.5625f)
            && quadruple_tank_inside(s->D[3], 6e-15f, 855.5625f);
        beyond = !t7;
    }
    return beyond;
}

/* advance the estimate from the last call to now */
static uint32_t quadruple_tank_advance(quadruple_tank_state *s, const quadruple_tank_params *p,
    const float *u)
{
    uint32_t status = 0u;
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
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        float k1_z[4];
        quadruple_tank_flow(z1, z2, z3, z4, u_before1, u_before2, k1_z);
        const float u1 = u[0];
        const float t1 = u_before1 + 0.5f*(u1 - u_before1);
        const float u2 = u[1];
        const float t2 = u_before2 + 0.5f*(u2 - u_before2);
        float k2_z[4];
        quadruple_tank_flow(z1 + 0.5f*k1_z[0], z2 + 0.5f*k1_z[1], z3 + 0.5f*k1_z[2], z4 + 0.5f*k1_z[3], t1,
            t2, k2_z);
        const float t3 = z1 + 0.5f*k2_z[0];
        const float t4 = z2 + 0.5f*k2_z[1];
        const float t5 = z3 + 0.5f*k2_z[2];
        const float t6 = z4 + 0.5f*k2_z[3];
        float k3_z[4];
        quadruple_tank_flow(t3, t4, t5, t6, t1, t2, k3_z);
        float k4_z[4];
        quadruple_tank_flow(z1 + k3_z[0], z2 + k3_z[1], z3 + k3_z[2], z4 + k3_z[3], u1, u2, k4_z);
        float F_1[6];
        quadruple_tank_jacobian(t3, t4, t5, t6, F_1);
        const float Phi_11 = 1.0f + F_1[0] + F_1[0]*F_1[0]*0.5f;
        const float Phi_13 = F_1[2] + 0.5f*(F_1[0]*F_1[2] + F_1[2]*F_1[3]);
        const float Phi_22 = 1.0f + F_1[1] + F_1[1]*F_1[1]*0.5f;
        const float Phi_24 = F_1[4] + 0.5f*(F_1[1]*F_1[4] + F_1[4]*F_1[5]);
        const float Phi_33 = 1.0f + F_1[3] + F_1[3]*F_1[3]*0.5f;
        const float Phi_44 = 1.0f + F_1[5] + F_1[5]*F_1[5]*0.5f;
        const float w1_1 = Phi_11 + Phi_13*L31;
        const float w1_2 = Phi_13*L32;
        const float t7 = w1_1*D1;
        const float t8 = w1_2*D2;
        const float t9 = Phi_13*D3;
        const float Q1 = p->gain.Q[0];
        const float d1 = w1_1*t7 + w1_2*t8 + Phi_13*t9 + Q1;
        const float t10 = Phi_22*L21 + Phi_24*L41;
        const float t11 = Phi_22 + Phi_24*L42;
        const float t12 = Phi_24*L43;
        const float l21 = (t10*t7 + t11*t8 + t12*t9)/d1;
        const float t13 = Phi_33*L31;
        const float t14 = Phi_33*L32;
        const float l31 = (t13*t7 + t14*t8 + Phi_33*t9)/d1;
        const float t15 = Phi_44*L41;
        const float t16 = Phi_44*L42;
        const float t17 = Phi_44*L43;
        const float l41 = (t15*t7 + t16*t8 + t17*t9)/d1;
        const float w2_1 = t10 - l21*w1_1;
        const float w2_2 = t11 - l21*w1_2;
        const float w2_3 = t12 - l21*Phi_13;
        const float t18 = w2_1*D1;
        const float t19 = w2_2*D2;
        const float t20 = w2_3*D3;
        const float t21 = Phi_24*D4;
        const float t22 = l21*Q1;
        const float Q2 = p->gain.Q[1];
        const float d2 = w2_1*t18 + w2_2*t19 + w2_3*t20 + Phi_24*t21 + l21*t22 + Q2;
        const float t23 = t13 - l31*w1_1;
        const float t24 = t14 - l31*w1_2;
        const float t25 = Phi_33 - l31*Phi_13;
        const float l32 = (t23*t18 + t24*t19 + t25*t20 + l31*t22)/d2;
        const float t26 = t15 - l41*w1_1;
        const float t27 = t16 - l41*w1_2;
        const float t28 = t17 - l41*Phi_13;
        const float l42 = (t26*t18 + t27*t19 + t28*t20 + Phi_44*t21 + l41*t22)/d2;
        const float w3_1 = t23 - l32*w2_1;
        const float w3_2 = t24 - l32*w2_2;
        const float w3_3 = t25 - l32*w2_3;
        const float w3_5 = l32*l21 - l31;
        const float t29 = w3_1*D1;
        const float t30 = w3_2*D2;
        const float t31 = w3_3*D3;
        const float t32 = l32*Phi_24;
        const float t33 = t32*D4;
        const float t34 = w3_5*Q1;
        const float t35 = l32*Q2;
        const float Q3 = p->gain.Q[2];
        const float d3 = w3_1*t29 + w3_2*t30 + w3_3*t31 + t32*t33 + w3_5*t34 + l32*t35 + Q3;
        const float t36 = t26 - l42*w2_1;
        const float t37 = t27 - l42*w2_2;
        const float t38 = t28 - l42*w2_3;
        const float t39 = Phi_44 - l42*Phi_24;
        const float t40 = l42*l21 - l41;
        const float l43 = (t36*t29 + t37*t30 + t38*t31 - t39*t33 + t40*t34 + l42*t35)/d3;
        const float w4_1 = t36 - l43*w3_1;
        const float w4_2 = t37 - l43*w3_2;
        const float w4_3 = t38 - l43*w3_3;
        const float w4_4 = t39 + l43*t32;
        const float w4_5 = t40 - l43*w3_5;
        const float w4_6 = l43*l32 - l42;
        const float t41 = w4_1*D1*w4_1 + w4_2*D2*w4_2 + w4_3*D3*w4_3 + w4_4*D4*w4_4 + w4_5*Q1*w4_5
            + w4_6*Q2*w4_6 + l43*Q3*l43;
        const float d4 = t41 + p->gain.Q[3];
        s->z[0] = z1 + 0.16666667f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 0.16666667f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
        s->z[2] = z3 + 0.16666667f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
        s->z[3] = z4 + 0.16666667f*(k1_z[3] + 2.0f*k2_z[3] + 2.0f*k3_z[3] + k4_z[3]);
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
        capped = D1 > 812.25f || L21*L21*D1 + D2 > 812.25f || L31*L31*D1 + L32*L32*D2 + D3 > 855.5625f
            || L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + s->D[3] > 855.5625f;
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
            const float t1 = quadruple_tank_min(1.0f, 812.25f/(L21*L21*D1 + D2));
            const float t2 = quadruple_tank_min(1.0f, 812.25f/D1);
            const float t3 = quadruple_tank_min(1.0f, 855.5625f/(L31*L31*D1 + L32*L32*D2 + D3));
            const float t4 = quadruple_tank_min(1.0f, 855.5625f/(L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + D4));
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
            status |= QUADRUPLE_TANK_COVARIANCE_LIMITED;
        }
    }
    beyond = quadruple_tank_beyond_box(s);
    if (quadruple_tank_acts(beyond)) {
        status |= quadruple_tank_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static uint32_t quadruple_tank_run_predict(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_input *in)
{
    uint32_t status = 0u;
    bool running = false;
    float u[2];
    /* keep u in its box */
    {
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        s->u[0] = quadruple_tank_clamp(u_before1, 0.0f, 6.0f);
        s->u[1] = quadruple_tank_clamp(u_before2, 0.0f, 6.0f);
    }
    status |= quadruple_tank_guard_input(s, in, u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= quadruple_tank_advance(s, p, u);
    } else {
        status |= quadruple_tank_keep_in_box(s, p);
    }
    /* samples may come */
    s->used_y1 = 0u;
    s->used_y2 = 0u;
    /* remember the input */
    s->u[0] = u[0];
    s->u[1] = u[1];
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static uint32_t quadruple_tank_guard_measurement_y1(const quadruple_tank_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y1 */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = reading >= -18.0f && reading <= 39.0f && quadruple_tank_within(t1, 1e+16f);
        const bool t3 = quadruple_tank_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= QUADRUPLE_TANK_MISSING_Y1;
        }
        if (t3 && !t2) {
            status |= QUADRUPLE_TANK_REJECTED_Y1;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t quadruple_tank_use_sample_y1(quadruple_tank_state *s, const quadruple_tank_params *p, float e)
{
    uint32_t status = 0u;
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
        const float R1 = p->gain.R[0];
        const float K1 = D1/(R1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        const float K4 = L41*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->D[0] = K1*R1;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 >= -18.0f && z1 <= 39.0f && z2 >= -18.0f && z2 <= 39.0f && z3 >= -19.0f
            && z3 <= 39.5f && z4 >= -19.0f && z4 <= 39.5f;
        const float D1 = s->D[0];
        beyond = !(t1 && D1 >= 4e-16f && D1 <= 812.25f);
    }
    if (quadruple_tank_acts(beyond)) {
        status |= quadruple_tank_keep_in_box(s, p);
    }
    /* y1 is used */
    s->used_y1 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool quadruple_tank_suspect_y1(const quadruple_tank_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 < 1.0f || z1 > 20.0f || z2 < 1.0f || z2 > 20.0f || z3 < 0.5f || z3 > 20.0f
            || z4 < 0.5f || z4 > 20.0f;
        suspect = quadruple_tank_abs(output_error) > 1.9f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return suspect;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool quadruple_tank_sample_in_plausible_range_y1(float reading, bool valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    sampled = valid || (reading >= -18.0f && reading <= 39.0f);
    return sampled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void quadruple_tank_find_signs_y1(const quadruple_tank_state *s, float *moves_y_y1,
    float output_error, float *side_y_y1)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = quadruple_tank_within(output_error, 1.9f);
        const float fault_count_y_y1 = s->fault_count_y_y1;
        *moves_y_y1 = (t1 ? 0.0f : ((fault_count_y_y1*output_error < 0.0f) ? -57.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y1 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y1 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t quadruple_tank_recover_y1(quadruple_tank_state *s, const quadruple_tank_params *p,
    float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y1 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y1 <= quadruple_tank_abs(s->fault_count_y_y1);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t3 = z1 < -8.5f || z1 > 29.5f || z2 < -8.5f || z2 > 29.5f || z3 < -9.25f || z3 > 29.75f
            || z4 < -9.25f || z4 > 29.75f;
        over_y_y1 = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 229.0f || t3));
    }
    if (over_y_y1) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y1 = s->fault_count_y_y1;
            const float fault_limit_y_y1 = s->fault_limit_y_y1;
            const float t1 = quadruple_tank_min(fault_limit_y_y1, 58880.0f);
            s->fault_count_y_y1 = (fault_count_y_y1 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y1 = quadruple_tank_min(2.0f*fault_limit_y_y1, 117760.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = quadruple_tank_min(fault_limit_range, 117248.0f);
            s->fault_limit_range = quadruple_tank_min(2.0f*fault_limit_range, 234496.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 1.0f;
        s->z[1] = 1.0f;
        s->z[2] = 0.5f;
        s->z[3] = 0.5f;
        /* from the sample of y1 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = quadruple_tank_keep(reading, 1.0f, 20.0f, z1, 1e+30f);
            s->z[1] = quadruple_tank_keep(z2, 1.0f, 20.0f, z2, 1e+30f);
            s->z[2] = quadruple_tank_keep(z3, 0.5f, 20.0f, z3, 1e+30f);
            s->z[3] = quadruple_tank_keep(z4, 0.5f, 20.0f, z4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= QUADRUPLE_TANK_RESTARTED_FROM_SAMPLE;
        quadruple_tank_clear_rest(s);
    } else {
        status |= quadruple_tank_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y1 */
static uint32_t quadruple_tank_run_update_y1(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_output *measurement)
{
    uint32_t status = 0u;
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
        status |= quadruple_tank_guard_measurement_y1(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= quadruple_tank_use_sample_y1(s, p, e);
        }
        suspect = quadruple_tank_suspect_y1(s, output_error, valid);
        if (suspect) {
            sampled = quadruple_tank_sample_in_plausible_range_y1(reading, valid);
            if (sampled) {
                status |= quadruple_tank_count_range(s, p);
                quadruple_tank_find_signs_y1(s, &moves_y_y1, output_error, &side_y_y1);
                /* count of y_y1 */
                {
                    const float fault_count_y_y1 = s->fault_count_y_y1;
                    const float fault_limit_y_y1 = s->fault_limit_y_y1;
                    const float t1 = quadruple_tank_clamp(quadruple_tank_abs(fault_count_y_y1) + moves_y_y1,
                        0.0f, 117760.0f);
                    s->fault_count_y_y1 = (side_y_y1 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y1 = (t1 <= 0.0f) ? 115.0f : fault_limit_y_y1;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y1 <= quadruple_tank_abs(s->fault_count_y_y1)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= quadruple_tank_recover_y1(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 115.0f + quadruple_tank_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 115.0f + quadruple_tank_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 229.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= QUADRUPLE_TANK_OUT_OF_ORDER;
    }
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static uint32_t quadruple_tank_guard_measurement_y2(const quadruple_tank_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y2 */
    {
        const float t1 = reading - s->z[1];
        const bool t2 = reading >= -18.0f && reading <= 39.0f && quadruple_tank_within(t1, 1e+16f);
        const bool t3 = quadruple_tank_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= QUADRUPLE_TANK_MISSING_Y2;
        }
        if (t3 && !t2) {
            status |= QUADRUPLE_TANK_REJECTED_Y2;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t quadruple_tank_use_sample_y2(quadruple_tank_state *s, const quadruple_tank_params *p, float e)
{
    uint32_t status = 0u;
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
        const float R2 = p->gain.R[1];
        const float t2 = R2 + D2;
        const float t3 = t2 + t1*L21;
        const float K1 = t1/t3;
        const float K2 = (D2 + L21*t1)/t3;
        const float t4 = L32*D2;
        const float K3 = (t4 + L31*t1)/t3;
        const float t5 = L42*D2;
        const float K4 = (t5 + L41*t1)/t3;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->L[0] = L21 - L21*D2/t2;
        s->L[1] = L31 - L21*t4/t2;
        s->L[2] = L41 - L21*t5/t2;
        s->D[0] = D1*t2/t3;
        s->D[1] = D2*R2/t2;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 >= -18.0f && z1 <= 39.0f && z2 >= -18.0f && z2 <= 39.0f && z3 >= -19.0f
            && z3 <= 39.5f && z4 >= -19.0f && z4 <= 39.5f;
        const bool t2 = t1 && quadruple_tank_within(s->L[0], 1e+09f)
            && quadruple_tank_within(s->L[1], 1.0263158e+09f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && quadruple_tank_within(s->L[2], 1.0263158e+09f) && D1 >= 4e-16f && D1 <= 812.25f
            && D2 >= 6e-15f && D2 <= 812.25f;
        beyond = !t3;
    }
    if (quadruple_tank_acts(beyond)) {
        status |= quadruple_tank_keep_in_box(s, p);
    }
    /* y2 is used */
    s->used_y2 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static uint32_t quadruple_tank_suspect_y2(const quadruple_tank_state *s, float output_error, bool *suspect,
    bool valid)
{
    uint32_t status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = z1 < 1.0f || z1 > 20.0f || z2 < 1.0f || z2 > 20.0f || z3 < 0.5f || z3 > 20.0f
            || z4 < 0.5f || z4 > 20.0f;
        if (t1) {
            status |= QUADRUPLE_TANK_OUTSIDE_BOX;
        }
        *suspect = quadruple_tank_abs(output_error) > 1.9f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void quadruple_tank_find_signs_y2(const quadruple_tank_state *s, float *moves_y_y2,
    float output_error, float *side_y_y2)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = quadruple_tank_within(output_error, 1.9f);
        const float fault_count_y_y2 = s->fault_count_y_y2;
        *moves_y_y2 = (t1 ? 0.0f : ((fault_count_y_y2*output_error < 0.0f) ? -57.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y2 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y2 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t quadruple_tank_recover_y2(quadruple_tank_state *s, const quadruple_tank_params *p,
    float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y2 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y2 <= quadruple_tank_abs(s->fault_count_y_y2);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t3 = z1 < -8.5f || z1 > 29.5f || z2 < -8.5f || z2 > 29.5f || z3 < -9.25f || z3 > 29.75f
            || z4 < -9.25f || z4 > 29.75f;
        over_y_y2 = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 229.0f || t3));
    }
    if (over_y_y2) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y2 = s->fault_count_y_y2;
            const float fault_limit_y_y2 = s->fault_limit_y_y2;
            const float t1 = quadruple_tank_min(fault_limit_y_y2, 58880.0f);
            s->fault_count_y_y2 = (fault_count_y_y2 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y2 = quadruple_tank_min(2.0f*fault_limit_y_y2, 117760.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = quadruple_tank_min(fault_limit_range, 117248.0f);
            s->fault_limit_range = quadruple_tank_min(2.0f*fault_limit_range, 234496.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 1.0f;
        s->z[1] = 1.0f;
        s->z[2] = 0.5f;
        s->z[3] = 0.5f;
        /* from the sample of y2 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = quadruple_tank_keep(z1, 1.0f, 20.0f, z1, 1e+30f);
            s->z[1] = quadruple_tank_keep(reading, 1.0f, 20.0f, z2, 1e+30f);
            s->z[2] = quadruple_tank_keep(z3, 0.5f, 20.0f, z3, 1e+30f);
            s->z[3] = quadruple_tank_keep(z4, 0.5f, 20.0f, z4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= QUADRUPLE_TANK_RESTARTED_FROM_SAMPLE;
        quadruple_tank_clear_rest(s);
    } else {
        status |= quadruple_tank_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y2 */
static uint32_t quadruple_tank_run_update_y2(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_output *measurement)
{
    uint32_t status = 0u;
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
        status |= quadruple_tank_guard_measurement_y2(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= quadruple_tank_use_sample_y2(s, p, e);
        }
        status |= quadruple_tank_suspect_y2(s, output_error, &suspect, valid);
        if (suspect) {
            sampled = quadruple_tank_sample_in_plausible_range_y1(reading, valid);
            if (sampled) {
                status |= quadruple_tank_count_range(s, p);
                quadruple_tank_find_signs_y2(s, &moves_y_y2, output_error, &side_y_y2);
                /* count of y_y2 */
                {
                    const float fault_count_y_y2 = s->fault_count_y_y2;
                    const float fault_limit_y_y2 = s->fault_limit_y_y2;
                    const float t1 = quadruple_tank_clamp(quadruple_tank_abs(fault_count_y_y2) + moves_y_y2,
                        0.0f, 117760.0f);
                    s->fault_count_y_y2 = (side_y_y2 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y2 = (t1 <= 0.0f) ? 115.0f : fault_limit_y_y2;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y2 <= quadruple_tank_abs(s->fault_count_y_y2)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= quadruple_tank_recover_y2(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 115.0f + quadruple_tank_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 115.0f + quadruple_tank_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 229.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= QUADRUPLE_TANK_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
QUADRUPLE_TANK_RARELY
static void quadruple_tank_nominal(quadruple_tank_params *p)
{
    p->ready = QUADRUPLE_TANK_READY;
    p->gain.Q[0] = 0.006f;
    p->gain.Q[1] = 0.006f;
    p->gain.Q[2] = 0.006f;
    p->gain.Q[3] = 0.006f;
    p->gain.R[0] = 0.0004f;
    p->gain.R[1] = 0.0004f;
}

uint32_t quadruple_tank_predict(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_input *in)
{
    uint32_t status = 0u;
    if ((s->ready != QUADRUPLE_TANK_READY) || (p->ready != QUADRUPLE_TANK_READY)) {
        status = quadruple_tank_ready(s, p);
    }
    if ((status & QUADRUPLE_TANK_NO_PARAMETERS) == 0u) {
        status |= quadruple_tank_run_predict(s, p, in);
    }
    return status;
}

uint32_t quadruple_tank_update_y1(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != QUADRUPLE_TANK_READY) || (p->ready != QUADRUPLE_TANK_READY)) {
        status = quadruple_tank_ready(s, p);
    }
    if ((status & QUADRUPLE_TANK_NO_PARAMETERS) == 0u) {
        status |= quadruple_tank_run_update_y1(s, p, measurement);
    }
    return status;
}

uint32_t quadruple_tank_update_y2(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != QUADRUPLE_TANK_READY) || (p->ready != QUADRUPLE_TANK_READY)) {
        status = quadruple_tank_ready(s, p);
    }
    if ((status & QUADRUPLE_TANK_NO_PARAMETERS) == 0u) {
        status |= quadruple_tank_run_update_y2(s, p, measurement);
    }
    return status;
}

uint32_t quadruple_tank_step(quadruple_tank_state *s, const quadruple_tank_params *p,
    const quadruple_tank_input *in, const quadruple_tank_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != QUADRUPLE_TANK_READY) || (p->ready != QUADRUPLE_TANK_READY)) {
        status = quadruple_tank_ready(s, p);
    }
    if ((status & QUADRUPLE_TANK_NO_PARAMETERS) == 0u) {
        status |= quadruple_tank_run_predict(s, p, in);
        status |= quadruple_tank_run_update_y1(s, p, measurement);
        status |= quadruple_tank_run_update_y2(s, p, measurement);
    }
    return status;
}

void quadruple_tank_estimate(const quadruple_tank_state *s, const quadruple_tank_params *p,
    quadruple_tank_plant *x)
{
    (void)p;
    /* the plant's state */
    x->h1 = s->z[0];
    x->h2 = s->z[1];
    x->h3 = s->z[2];
    x->h4 = s->z[3];
}

uint32_t quadruple_tank_tune(quadruple_tank_params *p)
{
    uint32_t status = 0u;
    if (p->ready != QUADRUPLE_TANK_READY) {
        quadruple_tank_nominal(p);
        status = QUADRUPLE_TANK_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[6] = {
            {6e-09f, 6000.0f, 0.006f}, /* p->gain.Q[0] */
            {6e-09f, 6000.0f, 0.006f}, /* p->gain.Q[1] */
            {6e-09f, 6000.0f, 0.006f}, /* p->gain.Q[2] */
            {6e-09f, 6000.0f, 0.006f}, /* p->gain.Q[3] */
            {4e-10f, 400.0f, 0.0004f}, /* p->gain.R[0] */
            {4e-10f, 400.0f, 0.0004f}, /* p->gain.R[1] */
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
            *value[k] = quadruple_tank_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= QUADRUPLE_TANK_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

QUADRUPLE_TANK_RARELY
void quadruple_tank_reset(quadruple_tank_state *s)
{
    s->ready = QUADRUPLE_TANK_READY;
    s->z[0] = 1.0f;
    s->z[1] = 1.0f;
    s->z[2] = 0.5f;
    s->z[3] = 0.5f;
    s->calls = 0u;
    s->used_y1 = 1u;
    s->used_y2 = 1u;
    s->u[0] = 0.0f;
    s->u[1] = 0.0f;
    quadruple_tank_clear_fault_counts(s);
    quadruple_tank_clear_rest(s);
}

void quadruple_tank_init(quadruple_tank_state *s, quadruple_tank_params *p)
{
    quadruple_tank_nominal(p);
    (void)quadruple_tank_tune(p);
    quadruple_tank_reset(s);
}

static const unsigned char quadruple_tank_layout[8] = {
    0x66u, 0x21u, 0xEDu, 0x1Eu, 0xD6u, 0xA4u, 0xC3u, 0x35u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t quadruple_tank_checksum(const unsigned char *bytes, size_t size)
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

void quadruple_tank_save(const quadruple_tank_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = quadruple_tank_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = quadruple_tank_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned quadruple_tank_restore(quadruple_tank_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == QUADRUPLE_TANK_SAVED) {
        refused = 0u;
        uint32_t sum = quadruple_tank_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == quadruple_tank_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = QUADRUPLE_TANK_READY;
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
