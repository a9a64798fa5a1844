/* induction_motor: see induction_motor.h, and its manual induction_motor.md. */
#include "induction_motor.h"

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
#define INDUCTION_MOTOR_RARELY __attribute__((noinline))
#else
#define INDUCTION_MOTOR_RARELY
#endif

static float induction_motor_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float induction_motor_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool induction_motor_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float induction_motor_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool induction_motor_within(float v, float limit)
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
static bool induction_motor_inside(float v, float low, float high)
{
    return v >= low && v <= high;
}

/* v in [-most, most] */
static float induction_motor_limit(float v, float most)
{
    return induction_motor_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float induction_motor_keep(float v, float low, float high, float otherwise, float limit)
{
    return induction_motor_within(v, limit) ? induction_motor_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void induction_motor_flow(float z1, float z2, float z3, float z4, float z5, float u1, float u2,
    float dz[5])
{
    const float t1 = induction_motor_limit(z4, 1.5f);
    const float t2 = induction_motor_limit(z5, 200.0f);
    const float t3 = t1*t2;
    const float t4 = induction_motor_limit(z3, 1.5f);
    const float t5 = t4*t2;
    dz[0] = 240.0f*z3 - 180.0f*z1 + (33.333332f*u1 + 60.0f*t3);
    dz[1] = 240.0f*z4 - 180.0f*z2 + (33.333332f*u2 - 60.0f*t5);
    dz[2] = 1.84f*z1 - 8.0f*z3 - 2.0f*t3;
    dz[3] = 1.84f*z2 - 8.0f*z4 + 2.0f*t5;
    dz[4] = induction_motor_limit(z2, 20.0f)*t4*13.0f - induction_motor_limit(z1, 20.0f)*t1*13.0f - 5.0f;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void induction_motor_jacobian(float z1, float z2, float z3, float z4, float z5, float F[12])
{
    const float t1 = induction_motor_limit(z4, 1.5f);
    const float t2 = induction_motor_limit(z3, 1.5f);
    const float t3 = induction_motor_limit(z5, 200.0f);
    const float t4 = 60.0f*t3;
    F[0] = -(13.0f*t1); /* F_51 */
    F[1] = 13.0f*t2; /* F_52 */
    F[2] = -t4; /* F_23 */
    F[3] = 2.0f*t3; /* F_43 */
    F[4] = 13.0f*induction_motor_limit(z2, 20.0f); /* F_53 */
    F[5] = t4; /* F_14 */
    F[6] = -2.0f*t3; /* F_34 */
    F[7] = -(13.0f*induction_motor_limit(z1, 20.0f)); /* F_54 */
    F[8] = 60.0f*t1; /* F_15 */
    F[9] = -(60.0f*t2); /* F_25 */
    F[10] = -2.0f*t1; /* F_35 */
    F[11] = 2.0f*t2; /* F_45 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
INDUCTION_MOTOR_RARELY
static uint32_t induction_motor_ready(induction_motor_state *s, const induction_motor_params *p)
{
    uint32_t status = 0u;
    if (s->ready != INDUCTION_MOTOR_READY) {
        induction_motor_reset(s);
        status |= INDUCTION_MOTOR_UNINITIALISED;
    }
    if (p->ready != INDUCTION_MOTOR_READY) {
        induction_motor_reset(s);
        status |= INDUCTION_MOTOR_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
INDUCTION_MOTOR_RARELY
static void induction_motor_clear_fault_counts(induction_motor_state *s)
{
    /* as after a reset */
    s->fault_count_y_y1 = 0.0f;
    s->fault_limit_y_y1 = 522.0f;
    s->fault_count_y_y2 = 0.0f;
    s->fault_limit_y_y2 = 522.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 1043.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
INDUCTION_MOTOR_RARELY
static void induction_motor_clear_rest(induction_motor_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->L[3] = 0.0f;
    s->L[4] = 0.0f;
    s->L[5] = 0.0f;
    s->L[6] = 0.0f;
    s->L[7] = 0.0f;
    s->L[8] = 0.0f;
    s->L[9] = 0.0f;
    s->D[0] = 1.0f;
    s->D[1] = 1.0f;
    s->D[2] = 0.1f;
    s->D[3] = 0.1f;
    s->D[4] = 400.0f;
}

/* is a number of the state not finite, or beyond 1e30? */
static bool induction_motor_value_lost(const induction_motor_state *s)
{
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = induction_motor_within(s->z[0], 1e+30f) && induction_motor_within(s->z[1], 1e+30f)
            && induction_motor_within(s->z[2], 1e+30f);
        const bool t2 = t1 && induction_motor_within(s->z[3], 1e+30f)
            && induction_motor_within(s->z[4], 1e+30f) && induction_motor_within(s->L[0], 1e+30f);
        const bool t3 = t2 && induction_motor_within(s->L[1], 1e+30f)
            && induction_motor_within(s->L[2], 1e+30f) && induction_motor_within(s->L[3], 1e+30f);
        const bool t4 = t3 && induction_motor_within(s->L[4], 1e+30f)
            && induction_motor_within(s->L[5], 1e+30f) && induction_motor_within(s->L[6], 1e+30f);
        const bool t5 = t4 && induction_motor_within(s->L[7], 1e+30f)
            && induction_motor_within(s->L[8], 1e+30f) && induction_motor_within(s->L[9], 1e+30f);
        const bool t6 = t5 && induction_motor_within(s->D[0], 1e+30f)
            && induction_motor_within(s->D[1], 1e+30f) && induction_motor_within(s->D[2], 1e+30f);
        lost = !(t6 && induction_motor_within(s->D[3], 1e+30f) && induction_motor_within(s->D[4], 1e+30f));
    }
    return lost;
}

/* part of a step: keep the state in its box, or make it anew */
static uint32_t induction_motor_keep_in_box(induction_motor_state *s, const induction_motor_params *p)
{
    uint32_t status = 0u;
    (void)p;
    bool lost = false;
    lost = induction_motor_value_lost(s);
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        s->z[4] = 0.0f;
        status |= INDUCTION_MOTOR_RESTARTED;
        induction_motor_clear_fault_counts(s);
        induction_motor_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float z5 = s->z[4];
        const bool t1 = induction_motor_abs(z1) > 60.0f || induction_motor_abs(z2) > 60.0f
            || induction_motor_abs(z3) > 4.5f;
        s->z[0] = induction_motor_limit(z1, 60.0f);
        s->z[1] = induction_motor_limit(z2, 60.0f);
        s->z[2] = induction_motor_limit(z3, 4.5f);
        s->z[3] = induction_motor_limit(z4, 4.5f);
        s->z[4] = induction_motor_limit(z5, 600.0f);
        if (t1 || induction_motor_abs(z4) > 4.5f || induction_motor_abs(z5) > 600.0f) {
            status |= INDUCTION_MOTOR_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L51 = s->L[3];
        const float L32 = s->L[4];
        const float L42 = s->L[5];
        const float L52 = s->L[6];
        const float L43 = s->L[7];
        const float L53 = s->L[8];
        const float L54 = s->L[9];
        s->L[0] = induction_motor_limit(L21, 1e+09f);
        s->L[1] = induction_motor_limit(L31, 7.5e+07f);
        s->L[2] = induction_motor_limit(L41, 7.5e+07f);
        s->L[3] = induction_motor_limit(L51, 1e+10f);
        s->L[4] = induction_motor_limit(L32, 7.5e+07f);
        s->L[5] = induction_motor_limit(L42, 7.5e+07f);
        s->L[6] = induction_motor_limit(L52, 1e+10f);
        s->L[7] = induction_motor_limit(L43, 1e+09f);
        s->L[8] = induction_motor_limit(L53, 1.3333334e+11f);
        s->L[9] = induction_motor_limit(L54, 1.3333334e+11f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        const float D4 = s->D[3];
        const float D5 = s->D[4];
        s->D[0] = induction_motor_clamp(D1, 1e-16f, 3600.0f);
        s->D[1] = induction_motor_clamp(D2, 1e-16f, 3600.0f);
        s->D[2] = induction_motor_clamp(D3, 1e-20f, 20.25f);
        s->D[3] = induction_motor_clamp(D4, 1e-20f, 20.25f);
        s->D[4] = induction_motor_clamp(D5, 1e-15f, 360000.0f);
    }
    return status;
}

/* part of a step: check the fault counts, and count the range */
static uint32_t induction_motor_count_range(induction_motor_state *s, const induction_motor_params *p)
{
    uint32_t status = 0u;
    (void)p;
    float moves_range = 0.0f;
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y_y1 = s->fault_count_y_y1;
        const float fault_limit_y_y1 = s->fault_limit_y_y1;
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float fault_limit_y_y2 = s->fault_limit_y_y2;
        const float t1 = fault_limit_y_y1 - 522.0f + induction_motor_abs(fault_count_y_y1)
            + (fault_limit_y_y2 - 522.0f + induction_motor_abs(fault_count_y_y2));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t2 = induction_motor_abs(fault_limit_range - 1043.0f + fault_count_range + t1
            - s->fault_checksum);
        const bool t3 = t2 < 0.5f && induction_motor_within(fault_count_y_y1, 534528.0f)
            && fault_limit_y_y1 >= 522.0f && fault_limit_y_y1 <= 534528.0f;
        const bool t4 = t3 && induction_motor_within(fault_count_y_y2, 534528.0f)
            && fault_limit_y_y2 >= 522.0f && fault_limit_y_y2 <= 534528.0f;
        const bool t5 = t4 && fault_count_range >= 0.0f && fault_count_range <= 1068032.0f
            && fault_limit_range >= 1043.0f && fault_limit_range <= 1068032.0f;
        spoiled = !t5;
    }
    if (spoiled) {
        induction_motor_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = induction_motor_abs(s->z[0]) > 22.0f || induction_motor_abs(s->z[1]) > 22.0f
            || induction_motor_abs(s->z[2]) > 1.65f;
        moves_range = (t1 || induction_motor_abs(s->z[3]) > 1.65f || induction_motor_abs(s->z[4]) > 220.0f)
            ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = induction_motor_clamp(fault_count_range + moves_range, 0.0f, 1068032.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 1043.0f : fault_limit_range;
    }
    return status;
}

/* part of a step: project the estimate onto its declared ranges */
static uint32_t induction_motor_project_onto_ranges(induction_motor_state *s, const induction_motor_params *p)
{
    uint32_t status = 0u;
    (void)p;
    /* the estimate back onto its declared ranges */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float z5 = s->z[4];
        const float L51 = s->L[3];
        const float D1 = s->D[0];
        const float t1 = L51*D1;
        const float t2 = z1 - induction_motor_limit(z1, 20.0f);
        const float t3 = t2/D1;
        const float L21 = s->L[0];
        const float L52 = s->L[6];
        const float D2 = s->D[1];
        const float t4 = L52*D2;
        const float t5 = L21*D1;
        const float t6 = z2 - t5*t3;
        const float t7 = t6 - induction_motor_limit(t6, 20.0f);
        const float t8 = t7/(t5*L21 + D2);
        const float L31 = s->L[1];
        const float L32 = s->L[4];
        const float L53 = s->L[8];
        const float D3 = s->D[2];
        const float t9 = L53*D3;
        const float t10 = L31*D1;
        const float t11 = L32*D2;
        const float t12 = z3 - t10*t3 - (t10*L21 + t11)*t8;
        const float t13 = t12 - induction_motor_limit(t12, 1.5f);
        const float t14 = t13/(t10*L31 + t11*L32 + D3);
        const float L41 = s->L[2];
        const float L42 = s->L[5];
        const float L43 = s->L[7];
        const float L54 = s->L[9];
        const float D4 = s->D[3];
        const float t15 = L54*D4;
        const float t16 = L41*D1;
        const float t17 = L42*D2;
        const float t18 = L43*D3;
        const float t19 = z4 - t16*t3 - (t16*L21 + t17)*t8 - (t16*L31 + t17*L32 + t18)*t14;
        const float t20 = t19 - induction_motor_limit(t19, 1.5f);
        const float t21 = t20/(t16*L41 + t17*L42 + t18*L43 + D4);
        const float t22 = z5 - t1*t3 - (t1*L21 + t4)*t8 - (t1*L31 + t4*L32 + t9)*t14
            - (t1*L41 + t4*L42 + t9*L43 + t15)*t21;
        const float t23 = t22 - induction_motor_limit(t22, 200.0f);
        const float t24 = t22 - t23 - z5;
        const float t25 = (t24 > 0.0f) ? 600.0f - z5 : z5 + 600.0f;
        const float t26 = t23/(t1*L51 + t4*L52 + t9*L53 + t15*L54 + s->D[4]);
        const float t27 = t19 - t20 - (t16*L51 + t17*L52 + t18*L53 + D4*L54)*t26 - z4;
        const float t28 = (t27 > 0.0f) ? 4.5f - z4 : z4 + 4.5f;
        const float t29 = t12 - t13 - (t10*L41 + t11*L42 + D3*L43)*t21 - (t10*L51 + t11*L52 + D3*L53)*t26
            - z3;
        const float t30 = (t29 > 0.0f) ? 4.5f - z3 : z3 + 4.5f;
        const float t31 = t6 - t7 - (t5*L31 + D2*L32)*t14 - (t5*L41 + D2*L42)*t21 - (t5*L51 + D2*L52)*t26
            - z2;
        const float t32 = (t31 > 0.0f) ? 60.0f - z2 : z2 + 60.0f;
        const float t33 = z1 - t2 - D1*L21*t8 - D1*L31*t14 - D1*L41*t21 - D1*L51*t26 - z1;
        const float t34 = (t33 > 0.0f) ? 60.0f - z1 : z1 + 60.0f;
        const float t35 = induction_motor_abs(t33);
        const float t36 = (t34 < t35) ? t34/t35 : 1.0f;
        const float t37 = induction_motor_abs(t31);
        const float t38 = (t32 < t36*t37) ? t32/t37 : t36;
        const float t39 = induction_motor_abs(t29);
        const float t40 = (t30 < t38*t39) ? t30/t39 : t38;
        const float t41 = induction_motor_abs(t27);
        const float t42 = (t28 < t40*t41) ? t28/t41 : t40;
        const float t43 = induction_motor_abs(t24);
        const float t44 = (t25 < t42*t43) ? t25/t43 : t42;
        s->z[0] = induction_motor_keep(z1 + t44*t33, -60.0f, 60.0f, z1, 1e+30f);
        s->z[1] = induction_motor_keep(z2 + t44*t31, -60.0f, 60.0f, z2, 1e+30f);
        s->z[2] = induction_motor_keep(z3 + t44*t29, -4.5f, 4.5f, z3, 1e+30f);
        s->z[3] = induction_motor_keep(z4 + t44*t27, -4.5f, 4.5f, z4, 1e+30f);
        s->z[4] = induction_motor_keep(z5 + t44*t24, -600.0f, 600.0f, z5, 1e+30f);
        status |= INDUCTION_MOTOR_PROJECTED_ONTO_RANGES;
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static uint32_t induction_motor_guard_input(const induction_motor_state *s, const induction_motor_input *in,
    float *u)
{
    uint32_t status = 0u;
    /* guard the input */
    {
        const float ua = in->ua;
        const bool ua_usable = induction_motor_within(ua, 1e+15f);
        const float ua_taken = ua_usable ? ua : s->u[0];
        const float ub = in->ub;
        const bool ub_usable = induction_motor_within(ub, 1e+15f);
        const float ub_taken = ub_usable ? ub : s->u[1];
        u[0] = induction_motor_limit(ua_taken, 400.0f);
        u[1] = induction_motor_limit(ub_taken, 400.0f);
        if (!ua_usable) {
            status |= INDUCTION_MOTOR_REUSED_UA;
        }
        if (induction_motor_abs(ua_taken) > 400.0f) {
            status |= INDUCTION_MOTOR_CLAMPED_UA;
        }
        if (!ub_usable) {
            status |= INDUCTION_MOTOR_REUSED_UB;
        }
        if (induction_motor_abs(ub_taken) > 400.0f) {
            status |= INDUCTION_MOTOR_CLAMPED_UB;
        }
    }
    return status;
}

/* is a number of the state beyond its limits, or not a number? */
static bool induction_motor_beyond_box(const induction_motor_state *s)
{
    bool beyond = false;
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = induction_motor_within(s->z[0], 60.0f) && induction_motor_within(s->z[1], 60.0f)
            && induction_motor_within(s->z[2], 4.5f);
        const bool t2 = t1 && induction_motor_within(s->z[3], 4.5f)
            && induction_motor_within(s->z[4], 600.0f) && induction_motor_within(s->L[0], 1e+09f);
        const bool t3 = t2 && induction_motor_within(s->L[1], 7.5e+07f)
            && induction_motor_within(s->L[2], 7.5e+07f) && induction_motor_within(s->L[3], 1e+10f);
        const bool t4 = t3 && induction_motor_within(s->L[4], 7.5e+07f)
            && induction_motor_within(s->L[5], 7.5e+07f) && induction_motor_within(s->L[6], 1e+10f);
        const bool t5 = t4 && induction_motor_within(s->L[7], 1e+09f)
            && induction_motor_within(s->L[8], 1.3333334e+11f);
        const bool t6 = t5 && induction_motor_within(s->L[9], 1.3333334e+11f)
            && induction_motor_inside(s->D[0], 1e-16f, 3600.0f);
        const bool t7 = t6 && induction_motor_inside(s->D[1], 1e-16f, 3600.0f)
            && induction_motor_inside(s->D[2], 1e-20f, 20.25f);
        const bool t8 = t7 && induction_motor_inside(s->D[3], 1e-20f, 20.25f)
            && induction_motor_inside(s->D[4], 1e-15f, 360000.0f);
        beyond = !t8;
    }
    return beyond;
}

/* advance the estimate from the last call to now */
static uint32_t induction_motor_advance(induction_motor_state *s, const induction_motor_params *p,
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
        const float D5 = s->D[4];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L51 = s->L[3];
        const float L32 = s->L[4];
        const float L42 = s->L[5];
        const float L52 = s->L[6];
        const float L43 = s->L[7];
        const float L53 = s->L[8];
        const float L54 = s->L[9];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float z5 = s->z[4];
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        float k1_z[5];
        induction_motor_flow(z1, z2, z3, z4, z5, u_before1, u_before2, k1_z);
        const float u1 = u[0];
        const float t1 = u_before1 + 0.5f*(u1 - u_before1);
        const float u2 = u[1];
        const float t2 = u_before2 + 0.5f*(u2 - u_before2);
        float k2_z[5];
        induction_motor_flow(z1 + 5e-05f*k1_z[0], z2 + 5e-05f*k1_z[1], z3 + 5e-05f*k1_z[2], z4
            + 5e-05f*k1_z[3], z5 + 5e-05f*k1_z[4], t1, t2, k2_z);
        const float t3 = z1 + 5e-05f*k2_z[0];
        const float t4 = z2 + 5e-05f*k2_z[1];
        const float t5 = z3 + 5e-05f*k2_z[2];
        const float t6 = z4 + 5e-05f*k2_z[3];
        const float t7 = z5 + 5e-05f*k2_z[4];
        float k3_z[5];
        induction_motor_flow(t3, t4, t5, t6, t7, t1, t2, k3_z);
        float k4_z[5];
        induction_motor_flow(z1 + 0.0001f*k3_z[0], z2 + 0.0001f*k3_z[1], z3 + 0.0001f*k3_z[2], z4
            + 0.0001f*k3_z[3], z5 + 0.0001f*k3_z[4], u1, u2, k4_z);
        float F_1[12];
        induction_motor_jacobian(t3, t4, t5, t6, t7, F_1);
        const float Phi_11 = 0.982f + 5e-09f*(32841.6f + F_1[8]*F_1[0]);
        const float t8 = 1.84f*F_1[5];
        const float Phi_12 = 5e-09f*(t8 + F_1[8]*F_1[1]);
        const float Phi_13 = 0.024f + 5e-09f*(F_1[5]*F_1[3] - 45120.0f + F_1[8]*F_1[4]);
        const float Phi_14 = 0.0001f*F_1[5] + 5e-09f*(240.0f*F_1[6] - 180.0f*F_1[5] - 8.0f*F_1[5]
            + F_1[8]*F_1[7]);
        const float Phi_15 = 0.0001f*F_1[8] + 5e-09f*(240.0f*F_1[10] - 180.0f*F_1[8] + F_1[5]*F_1[11]);
        const float t9 = 1.84f*F_1[2];
        const float Phi_21 = 5e-09f*(t9 + F_1[9]*F_1[0]);
        const float Phi_22 = 0.982f + 5e-09f*(32841.6f + F_1[9]*F_1[1]);
        const float Phi_23 = 0.0001f*F_1[2] + 5e-09f*(-180.0f*F_1[2] - 8.0f*F_1[2] + 240.0f*F_1[3]
            + F_1[9]*F_1[4]);
        const float Phi_24 = 0.024f + 5e-09f*(F_1[2]*F_1[6] - 43200.0f - 1920.0f + F_1[9]*F_1[7]);
        const float Phi_25 = 0.0001f*F_1[9] + 5e-09f*(F_1[2]*F_1[10] - 180.0f*F_1[9] + 240.0f*F_1[11]);
        const float Phi_31 = 0.000184f + 5e-09f*(F_1[10]*F_1[0] - 345.92f);
        const float Phi_32 = 5e-09f*(1.84f*F_1[6] + F_1[10]*F_1[1]);
        const float Phi_33 = 0.9992f + 5e-09f*(505.6f + F_1[6]*F_1[3] + F_1[10]*F_1[4]);
        const float t10 = -8.0f*F_1[6];
        const float Phi_34 = 0.0001f*F_1[6] + 5e-09f*(t8 + t10 + t10 + F_1[10]*F_1[7]);
        const float Phi_35 = 0.0001f*F_1[10] + 5e-09f*(1.84f*F_1[8] - 8.0f*F_1[10] + F_1[6]*F_1[11]);
        const float Phi_41 = 5e-09f*(1.84f*F_1[3] + F_1[11]*F_1[0]);
        const float Phi_42 = 0.000184f + 5e-09f*(F_1[11]*F_1[1] - 345.92f);
        const float t11 = -8.0f*F_1[3];
        const float Phi_43 = 0.0001f*F_1[3] + 5e-09f*(t9 + t11 + t11 + F_1[11]*F_1[4]);
        const float Phi_44 = 0.9992f + 5e-09f*(441.6f + F_1[3]*F_1[6] + 64.0f + F_1[11]*F_1[7]);
        const float Phi_45 = 0.0001f*F_1[11] + 5e-09f*(1.84f*F_1[9] + F_1[3]*F_1[10] - 8.0f*F_1[11]);
        const float Phi_51 = 0.0001f*F_1[0] + 5e-09f*(1.84f*F_1[4] - 180.0f*F_1[0]);
        const float Phi_52 = 0.0001f*F_1[1] + 5e-09f*(1.84f*F_1[7] - 180.0f*F_1[1]);
        const float Phi_53 = 0.0001f*F_1[4] + 5e-09f*(240.0f*F_1[0] + F_1[1]*F_1[2] - 8.0f*F_1[4]
            + F_1[7]*F_1[3]);
        const float Phi_54 = 0.0001f*F_1[7] + 5e-09f*(F_1[0]*F_1[5] + 240.0f*F_1[1] + F_1[4]*F_1[6]
            - 8.0f*F_1[7]);
        const float Phi_55 = 1.0f + 5e-09f*(F_1[0]*F_1[8] + F_1[1]*F_1[9] + F_1[4]*F_1[10] + F_1[7]*F_1[11]);
        const float w1_1 = Phi_11 + Phi_12*L21 + Phi_13*L31 + Phi_14*L41 + Phi_15*L51;
        const float w1_2 = Phi_12 + Phi_13*L32 + Phi_14*L42 + Phi_15*L52;
        const float w1_3 = Phi_13 + Phi_14*L43 + Phi_15*L53;
        const float w1_4 = Phi_14 + Phi_15*L54;
        const float t12 = w1_1*D1;
        const float t13 = w1_2*D2;
        const float t14 = w1_3*D3;
        const float t15 = w1_4*D4;
        const float t16 = Phi_15*D5;
        const float t17 = 0.0001f*p->gain.Q[0];
        const float d1 = w1_1*t12 + w1_2*t13 + w1_3*t14 + w1_4*t15 + Phi_15*t16 + t17;
        const float t18 = Phi_21 + Phi_22*L21 + Phi_23*L31 + Phi_24*L41 + Phi_25*L51;
        const float t19 = Phi_22 + Phi_23*L32 + Phi_24*L42 + Phi_25*L52;
        const float t20 = Phi_23 + Phi_24*L43 + Phi_25*L53;
        const float t21 = Phi_24 + Phi_25*L54;
        const float l21 = (t18*t12 + t19*t13 + t20*t14 + t21*t15 + Phi_25*t16)/d1;
        const float t22 = Phi_31 + Phi_32*L21 + Phi_33*L31 + Phi_34*L41 + Phi_35*L51;
        const float t23 = Phi_32 + Phi_33*L32 + Phi_34*L42 + Phi_35*L52;
        const float t24 = Phi_33 + Phi_34*L43 + Phi_35*L53;
        const float t25 = Phi_34 + Phi_35*L54;
        const float l31 = (t22*t12 + t23*t13 + t24*t14 + t25*t15 + Phi_35*t16)/d1;
        const float t26 = Phi_41 + Phi_42*L21 + Phi_43*L31 + Phi_44*L41 + Phi_45*L51;
        const float t27 = Phi_42 + Phi_43*L32 + Phi_44*L42 + Phi_45*L52;
        const float t28 = Phi_43 + Phi_44*L43 + Phi_45*L53;
        const float t29 = Phi_44 + Phi_45*L54;
        const float l41 = (t26*t12 + t27*t13 + t28*t14 + t29*t15 + Phi_45*t16)/d1;
        const float t30 = Phi_51 + Phi_52*L21 + Phi_53*L31 + Phi_54*L41 + Phi_55*L51;
        const float t31 = Phi_52 + Phi_53*L32 + Phi_54*L42 + Phi_55*L52;
        const float t32 = Phi_53 + Phi_54*L43 + Phi_55*L53;
        const float t33 = Phi_54 + Phi_55*L54;
        const float l51 = (t30*t12 + t31*t13 + t32*t14 + t33*t15 + Phi_55*t16)/d1;
        const float w2_1 = t18 - l21*w1_1;
        const float w2_2 = t19 - l21*w1_2;
        const float w2_3 = t20 - l21*w1_3;
        const float w2_4 = t21 - l21*w1_4;
        const float w2_5 = Phi_25 - l21*Phi_15;
        const float t34 = w2_1*D1;
        const float t35 = w2_2*D2;
        const float t36 = w2_3*D3;
        const float t37 = w2_4*D4;
        const float t38 = w2_5*D5;
        const float t39 = l21*t17;
        const float t40 = 0.0001f*p->gain.Q[1];
        const float d2 = w2_1*t34 + w2_2*t35 + w2_3*t36 + w2_4*t37 + w2_5*t38 + l21*t39 + t40;
        const float t41 = t22 - l31*w1_1;
        const float t42 = t23 - l31*w1_2;
        const float t43 = t24 - l31*w1_3;
        const float t44 = t25 - l31*w1_4;
        const float t45 = Phi_35 - l31*Phi_15;
        const float l32 = (t41*t34 + t42*t35 + t43*t36 + t44*t37 + t45*t38 + l31*t39)/d2;
        const float t46 = t26 - l41*w1_1;
        const float t47 = t27 - l41*w1_2;
        const float t48 = t28 - l41*w1_3;
        const float t49 = t29 - l41*w1_4;
        const float t50 = Phi_45 - l41*Phi_15;
        const float l42 = (t46*t34 + t47*t35 + t48*t36 + t49*t37 + t50*t38 + l41*t39)/d2;
        const float t51 = t30 - l51*w1_1;
        const float t52 = t31 - l51*w1_2;
        const float t53 = t32 - l51*w1_3;
        const float t54 = t33 - l51*w1_4;
        const float t55 = Phi_55 - l51*Phi_15;
        const float l52 = (t51*t34 + t52*t35 + t53*t36 + t54*t37 + t55*t38 + l51*t39)/d2;
        const float w3_1 = t41 - l32*w2_1;
        const float w3_2 = t42 - l32*w2_2;
        const float w3_3 = t43 - l32*w2_3;
        const float w3_4 = t44 - l32*w2_4;
        const float w3_5 = t45 - l32*w2_5;
        const float w3_6 = l32*l21 - l31;
        const float t56 = w3_1*D1;
        const float t57 = w3_2*D2;
        const float t58 = w3_3*D3;
        const float t59 = w3_4*D4;
        const float t60 = w3_5*D5;
        const float t61 = w3_6*t17;
        const float t62 = l32*t40;
        const float t63 = 0.0001f*p->gain.Q[2];
        const float d3 = w3_1*t56 + w3_2*t57 + w3_3*t58 + w3_4*t59 + w3_5*t60 + w3_6*t61 + l32*t62 + t63;
        const float t64 = t46 - l42*w2_1;
        const float t65 = t47 - l42*w2_2;
        const float t66 = t48 - l42*w2_3;
        const float t67 = t49 - l42*w2_4;
        const float t68 = t50 - l42*w2_5;
        const float t69 = l42*l21 - l41;
        const float l43 = (t64*t56 + t65*t57 + t66*t58 + t67*t59 + t68*t60 + t69*t61 + l42*t62)/d3;
        const float t70 = t51 - l52*w2_1;
        const float t71 = t52 - l52*w2_2;
        const float t72 = t53 - l52*w2_3;
        const float t73 = t54 - l52*w2_4;
        const float t74 = t55 - l52*w2_5;
        const float t75 = l52*l21 - l51;
        const float l53 = (t70*t56 + t71*t57 + t72*t58 + t73*t59 + t74*t60 + t75*t61 + l52*t62)/d3;
        const float w4_1 = t64 - l43*w3_1;
        const float w4_2 = t65 - l43*w3_2;
        const float w4_3 = t66 - l43*w3_3;
        const float w4_4 = t67 - l43*w3_4;
        const float w4_5 = t68 - l43*w3_5;
        const float w4_6 = t69 - l43*w3_6;
        const float w4_7 = l43*l32 - l42;
        const float t76 = w4_1*D1;
        const float t77 = w4_2*D2;
        const float t78 = w4_3*D3;
        const float t79 = w4_4*D4;
        const float t80 = w4_5*D5;
        const float t81 = w4_6*t17;
        const float t82 = w4_7*t40;
        const float t83 = l43*t63;
        const float t84 = 0.0001f*p->gain.Q[3];
        const float d4 = w4_1*t76 + w4_2*t77 + w4_3*t78 + w4_4*t79 + w4_5*t80 + w4_6*t81 + w4_7*t82 + l43*t83
            + t84;
        const float t85 = t70 - l53*w3_1;
        const float t86 = t71 - l53*w3_2;
        const float t87 = t72 - l53*w3_3;
        const float t88 = t73 - l53*w3_4;
        const float t89 = t74 - l53*w3_5;
        const float t90 = t75 - l53*w3_6;
        const float t91 = l53*l32 - l52;
        const float l54 = (t85*t76 + t86*t77 + t87*t78 + t88*t79 + t89*t80 + t90*t81 + t91*t82 + l53*t83)/d4;
        const float w5_1 = t85 - l54*w4_1;
        const float w5_2 = t86 - l54*w4_2;
        const float w5_3 = t87 - l54*w4_3;
        const float w5_4 = t88 - l54*w4_4;
        const float w5_5 = t89 - l54*w4_5;
        const float w5_6 = t90 - l54*w4_6;
        const float w5_7 = t91 - l54*w4_7;
        const float w5_8 = l54*l43 - l53;
        const float t92 = w5_1*D1*w5_1 + w5_2*D2*w5_2 + w5_3*D3*w5_3 + w5_4*D4*w5_4 + w5_5*D5*w5_5
            + w5_6*t17*w5_6 + w5_7*t40*w5_7;
        const float d5 = t92 + w5_8*t63*w5_8 + l54*t84*l54 + 0.0001f*p->gain.Q[4];
        s->z[0] = z1 + 1.6666667e-05f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 1.6666667e-05f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
        s->z[2] = z3 + 1.6666667e-05f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
        s->z[3] = z4 + 1.6666667e-05f*(k1_z[3] + 2.0f*k2_z[3] + 2.0f*k3_z[3] + k4_z[3]);
        s->z[4] = z5 + 1.6666667e-05f*(k1_z[4] + 2.0f*k2_z[4] + 2.0f*k3_z[4] + k4_z[4]);
        s->L[0] = l21;
        s->L[1] = l31;
        s->L[2] = l41;
        s->L[3] = l51;
        s->L[4] = l32;
        s->L[5] = l42;
        s->L[6] = l52;
        s->L[7] = l43;
        s->L[8] = l53;
        s->L[9] = l54;
        s->D[0] = d1;
        s->D[1] = d2;
        s->D[2] = d3;
        s->D[3] = d4;
        s->D[4] = d5;
    }
    /* largest variances */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float D2 = s->D[1];
        const float L31 = s->L[1];
        const float L32 = s->L[4];
        const float D3 = s->D[2];
        const float L41 = s->L[2];
        const float L42 = s->L[5];
        const float L43 = s->L[7];
        const float D4 = s->D[3];
        const bool t1 = D1 > 3600.0f || L21*L21*D1 + D2 > 3600.0f || L31*L31*D1 + L32*L32*D2 + D3 > 20.25f
            || L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + D4 > 20.25f;
        const float L51 = s->L[3];
        const float L52 = s->L[6];
        const float L53 = s->L[8];
        const float L54 = s->L[9];
        capped = t1 || L51*L51*D1 + L52*L52*D2 + L53*L53*D3 + L54*L54*D4 + s->D[4] > 360000.0f;
    }
    if (capped) {
        /* cap */
        {
            const float D1 = s->D[0];
            const float D2 = s->D[1];
            const float D3 = s->D[2];
            const float D4 = s->D[3];
            const float D5 = s->D[4];
            const float L21 = s->L[0];
            const float L31 = s->L[1];
            const float L41 = s->L[2];
            const float L51 = s->L[3];
            const float L32 = s->L[4];
            const float L42 = s->L[5];
            const float L52 = s->L[6];
            const float L43 = s->L[7];
            const float L53 = s->L[8];
            const float L54 = s->L[9];
            const float t1 = induction_motor_min(1.0f, 3600.0f/(L21*L21*D1 + D2));
            const float t2 = induction_motor_min(1.0f, 3600.0f/D1);
            const float t3 = induction_motor_min(1.0f, 20.25f/(L31*L31*D1 + L32*L32*D2 + D3));
            const float t4 = induction_motor_min(1.0f, 20.25f/(L41*L41*D1 + L42*L42*D2 + L43*L43*D3 + D4));
            const float t5 = induction_motor_min(1.0f, 360000.0f/(L51*L51*D1 + L52*L52*D2 + L53*L53*D3
                + L54*L54*D4 + D5));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t4*L41/t2;
            s->L[3] = t5*L51/t2;
            s->L[4] = t3*L32/t1;
            s->L[5] = t4*L42/t1;
            s->L[6] = t5*L52/t1;
            s->L[7] = t4*L43/t3;
            s->L[8] = t5*L53/t3;
            s->L[9] = t5*L54/t4;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            s->D[3] = t4*t4*D4;
            s->D[4] = t5*t5*D5;
            status |= INDUCTION_MOTOR_COVARIANCE_LIMITED;
        }
    }
    beyond = induction_motor_beyond_box(s);
    if (induction_motor_acts(beyond)) {
        status |= induction_motor_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static uint32_t induction_motor_run_predict(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_input *in)
{
    uint32_t status = 0u;
    bool running = false;
    float u[2];
    /* keep u in its box */
    {
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        s->u[0] = induction_motor_limit(u_before1, 400.0f);
        s->u[1] = induction_motor_limit(u_before2, 400.0f);
    }
    status |= induction_motor_guard_input(s, in, u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= induction_motor_advance(s, p, u);
    } else {
        status |= induction_motor_keep_in_box(s, p);
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
static uint32_t induction_motor_guard_measurement_y1(const induction_motor_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y1 */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = induction_motor_within(reading, 60.0f) && induction_motor_within(t1, 1e+16f);
        const bool t3 = induction_motor_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= INDUCTION_MOTOR_MISSING_Y1;
        }
        if (t3 && !t2) {
            status |= INDUCTION_MOTOR_REJECTED_Y1;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t induction_motor_use_sample_y1(induction_motor_state *s, const induction_motor_params *p,
    float e)
{
    uint32_t status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L41 = s->L[2];
        const float L51 = s->L[3];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float z5 = s->z[4];
        const float t1 = p->gain.R[0]/0.0001f;
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        const float K4 = L41*K1;
        const float K5 = L51*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->z[4] = z5 + K5*e;
        s->D[0] = K1*t1;
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = induction_motor_within(s->z[0], 60.0f) && induction_motor_within(s->z[1], 60.0f)
            && induction_motor_within(s->z[2], 4.5f);
        const float D1 = s->D[0];
        const bool t2 = t1 && induction_motor_within(s->z[3], 4.5f)
            && induction_motor_within(s->z[4], 600.0f) && D1 >= 1e-16f && D1 <= 3600.0f;
        beyond = !t2;
    }
    if (induction_motor_acts(beyond)) {
        status |= induction_motor_keep_in_box(s, p);
    }
    /* y1 is used */
    s->used_y1 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool induction_motor_suspect_y1(const induction_motor_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = induction_motor_abs(s->z[0]) > 20.0f || induction_motor_abs(s->z[1]) > 20.0f
            || induction_motor_abs(s->z[2]) > 1.5f;
        const bool t2 = induction_motor_abs(output_error) > 4.0f || t1 || induction_motor_abs(s->z[3]) > 1.5f
            || induction_motor_abs(s->z[4]) > 200.0f;
        suspect = t2 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return suspect;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void induction_motor_find_signs_y1(const induction_motor_state *s, float *moves_y_y1,
    float output_error, float *side_y_y1)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = induction_motor_within(output_error, 4.0f);
        const float fault_count_y_y1 = s->fault_count_y_y1;
        *moves_y_y1 = (t1 ? 0.0f : ((fault_count_y_y1*output_error < 0.0f) ? -220.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y1 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y1 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t induction_motor_recover_y1(induction_motor_state *s, const induction_motor_params *p,
    float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y1 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y1 <= induction_motor_abs(s->fault_count_y_y1);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = induction_motor_abs(s->z[0]) > 40.0f || induction_motor_abs(s->z[1]) > 40.0f
            || induction_motor_abs(s->z[2]) > 3.0f;
        const bool t4 = fault_limit_range > 1043.0f || t3 || induction_motor_abs(s->z[3]) > 3.0f
            || induction_motor_abs(s->z[4]) > 400.0f;
        over_y_y1 = t1;
        over_range = t2;
        lost = t1 || (t2 && t4);
    }
    if (over_y_y1) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y1 = s->fault_count_y_y1;
            const float fault_limit_y_y1 = s->fault_limit_y_y1;
            const float t1 = induction_motor_min(fault_limit_y_y1, 267264.0f);
            s->fault_count_y_y1 = (fault_count_y_y1 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y1 = induction_motor_min(2.0f*fault_limit_y_y1, 534528.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = induction_motor_min(fault_limit_range, 534016.0f);
            s->fault_limit_range = induction_motor_min(2.0f*fault_limit_range, 1068032.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        s->z[4] = 0.0f;
        /* from the sample of y1 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            const float z5 = s->z[4];
            s->z[0] = induction_motor_keep(reading, -20.0f, 20.0f, z1, 1e+30f);
            s->z[1] = induction_motor_keep(z2, -20.0f, 20.0f, z2, 1e+30f);
            s->z[2] = induction_motor_keep(z3, -1.5f, 1.5f, z3, 1e+30f);
            s->z[3] = induction_motor_keep(z4, -1.5f, 1.5f, z4, 1e+30f);
            s->z[4] = induction_motor_keep(z5, -200.0f, 200.0f, z5, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= INDUCTION_MOTOR_RESTARTED_FROM_SAMPLE;
        induction_motor_clear_rest(s);
    } else {
        status |= induction_motor_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y1 */
static uint32_t induction_motor_run_update_y1(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_output *measurement)
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
        status |= induction_motor_guard_measurement_y1(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= induction_motor_use_sample_y1(s, p, e);
        }
        suspect = induction_motor_suspect_y1(s, output_error, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || induction_motor_within(reading, 60.0f);
            if (sampled) {
                status |= induction_motor_count_range(s, p);
                induction_motor_find_signs_y1(s, &moves_y_y1, output_error, &side_y_y1);
                /* count of y_y1 */
                {
                    const float fault_count_y_y1 = s->fault_count_y_y1;
                    const float fault_limit_y_y1 = s->fault_limit_y_y1;
                    const float t1 = induction_motor_clamp(induction_motor_abs(fault_count_y_y1)
                        + moves_y_y1, 0.0f, 534528.0f);
                    s->fault_count_y_y1 = (side_y_y1 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y1 = (t1 <= 0.0f) ? 522.0f : fault_limit_y_y1;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y1 <= induction_motor_abs(s->fault_count_y_y1)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= induction_motor_recover_y1(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 522.0f + induction_motor_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 522.0f + induction_motor_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 1043.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= INDUCTION_MOTOR_OUT_OF_ORDER;
    }
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static uint32_t induction_motor_guard_measurement_y2(const induction_motor_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y2 */
    {
        const float t1 = reading - s->z[1];
        const bool t2 = induction_motor_within(reading, 60.0f) && induction_motor_within(t1, 1e+16f);
        const bool t3 = induction_motor_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= INDUCTION_MOTOR_MISSING_Y2;
        }
        if (t3 && !t2) {
            status |= INDUCTION_MOTOR_REJECTED_Y2;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t induction_motor_use_sample_y2(induction_motor_state *s, const induction_motor_params *p,
    float e)
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
        const float L51 = s->L[3];
        const float L32 = s->L[4];
        const float L42 = s->L[5];
        const float L52 = s->L[6];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const float z5 = s->z[4];
        const float t1 = D1*L21;
        const float t2 = p->gain.R[1]/0.0001f;
        const float t3 = t2 + D2;
        const float t4 = t3 + t1*L21;
        const float K1 = t1/t4;
        const float K2 = (D2 + L21*t1)/t4;
        const float t5 = L32*D2;
        const float K3 = (t5 + L31*t1)/t4;
        const float t6 = L42*D2;
        const float K4 = (t6 + L41*t1)/t4;
        const float t7 = L52*D2;
        const float K5 = (t7 + L51*t1)/t4;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->z[3] = z4 + K4*e;
        s->z[4] = z5 + K5*e;
        s->L[0] = L21 - L21*D2/t3;
        s->L[1] = L31 - L21*t5/t3;
        s->L[2] = L41 - L21*t6/t3;
        s->L[3] = L51 - L21*t7/t3;
        s->D[0] = D1*t3/t4;
        s->D[1] = D2*t2/t3;
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = induction_motor_within(s->z[0], 60.0f) && induction_motor_within(s->z[1], 60.0f)
            && induction_motor_within(s->z[2], 4.5f);
        const bool t2 = t1 && induction_motor_within(s->z[3], 4.5f)
            && induction_motor_within(s->z[4], 600.0f) && induction_motor_within(s->L[0], 1e+09f);
        const bool t3 = t2 && induction_motor_within(s->L[1], 7.5e+07f)
            && induction_motor_within(s->L[2], 7.5e+07f) && induction_motor_within(s->L[3], 1e+10f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        beyond = !(t3 && D1 >= 1e-16f && D1 <= 3600.0f && D2 >= 1e-16f && D2 <= 3600.0f);
    }
    if (induction_motor_acts(beyond)) {
        status |= induction_motor_keep_in_box(s, p);
    }
    /* y2 is used */
    s->used_y2 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static uint32_t induction_motor_suspect_y2(const induction_motor_state *s, float output_error, bool *suspect,
    bool valid)
{
    uint32_t status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = induction_motor_abs(s->z[0]) > 20.0f || induction_motor_abs(s->z[1]) > 20.0f
            || induction_motor_abs(s->z[2]) > 1.5f;
        const bool t2 = t1 || induction_motor_abs(s->z[3]) > 1.5f || induction_motor_abs(s->z[4]) > 200.0f;
        if (t2) {
            status |= INDUCTION_MOTOR_OUTSIDE_BOX;
        }
        *suspect = induction_motor_abs(output_error) > 4.0f || t2 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void induction_motor_find_signs_y2(const induction_motor_state *s, float *moves_y_y2,
    float output_error, float *side_y_y2)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = induction_motor_within(output_error, 4.0f);
        const float fault_count_y_y2 = s->fault_count_y_y2;
        *moves_y_y2 = (t1 ? 0.0f : ((fault_count_y_y2*output_error < 0.0f) ? -220.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y2 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y2 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t induction_motor_recover_y2(induction_motor_state *s, const induction_motor_params *p,
    float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y2 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y2 <= induction_motor_abs(s->fault_count_y_y2);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = induction_motor_abs(s->z[0]) > 40.0f || induction_motor_abs(s->z[1]) > 40.0f
            || induction_motor_abs(s->z[2]) > 3.0f;
        const bool t4 = fault_limit_range > 1043.0f || t3 || induction_motor_abs(s->z[3]) > 3.0f
            || induction_motor_abs(s->z[4]) > 400.0f;
        over_y_y2 = t1;
        over_range = t2;
        lost = t1 || (t2 && t4);
    }
    if (over_y_y2) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y2 = s->fault_count_y_y2;
            const float fault_limit_y_y2 = s->fault_limit_y_y2;
            const float t1 = induction_motor_min(fault_limit_y_y2, 267264.0f);
            s->fault_count_y_y2 = (fault_count_y_y2 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y2 = induction_motor_min(2.0f*fault_limit_y_y2, 534528.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = induction_motor_min(fault_limit_range, 534016.0f);
            s->fault_limit_range = induction_motor_min(2.0f*fault_limit_range, 1068032.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        s->z[4] = 0.0f;
        /* from the sample of y2 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            const float z5 = s->z[4];
            s->z[0] = induction_motor_keep(z1, -20.0f, 20.0f, z1, 1e+30f);
            s->z[1] = induction_motor_keep(reading, -20.0f, 20.0f, z2, 1e+30f);
            s->z[2] = induction_motor_keep(z3, -1.5f, 1.5f, z3, 1e+30f);
            s->z[3] = induction_motor_keep(z4, -1.5f, 1.5f, z4, 1e+30f);
            s->z[4] = induction_motor_keep(z5, -200.0f, 200.0f, z5, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= INDUCTION_MOTOR_RESTARTED_FROM_SAMPLE;
        induction_motor_clear_rest(s);
    } else {
        status |= induction_motor_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y2 */
static uint32_t induction_motor_run_update_y2(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_output *measurement)
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
        status |= induction_motor_guard_measurement_y2(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= induction_motor_use_sample_y2(s, p, e);
        }
        status |= induction_motor_suspect_y2(s, output_error, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || induction_motor_within(reading, 60.0f);
            if (sampled) {
                status |= induction_motor_count_range(s, p);
                induction_motor_find_signs_y2(s, &moves_y_y2, output_error, &side_y_y2);
                /* count of y_y2 */
                {
                    const float fault_count_y_y2 = s->fault_count_y_y2;
                    const float fault_limit_y_y2 = s->fault_limit_y_y2;
                    const float t1 = induction_motor_clamp(induction_motor_abs(fault_count_y_y2)
                        + moves_y_y2, 0.0f, 534528.0f);
                    s->fault_count_y_y2 = (side_y_y2 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y2 = (t1 <= 0.0f) ? 522.0f : fault_limit_y_y2;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y2 <= induction_motor_abs(s->fault_count_y_y2)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= induction_motor_recover_y2(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 522.0f + induction_motor_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 522.0f + induction_motor_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 1043.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= INDUCTION_MOTOR_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
INDUCTION_MOTOR_RARELY
static void induction_motor_nominal(induction_motor_params *p)
{
    p->ready = INDUCTION_MOTOR_READY;
    p->gain.Q[0] = 1.0f;
    p->gain.Q[1] = 1.0f;
    p->gain.Q[2] = 0.0001f;
    p->gain.Q[3] = 0.0001f;
    p->gain.Q[4] = 10.0f;
    p->gain.R[0] = 1e-08f;
    p->gain.R[1] = 1e-08f;
}

uint32_t induction_motor_predict(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_input *in)
{
    uint32_t status = 0u;
    if ((s->ready != INDUCTION_MOTOR_READY) || (p->ready != INDUCTION_MOTOR_READY)) {
        status = induction_motor_ready(s, p);
    }
    if ((status & INDUCTION_MOTOR_NO_PARAMETERS) == 0u) {
        status |= induction_motor_run_predict(s, p, in);
    }
    return status;
}

uint32_t induction_motor_update_y1(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != INDUCTION_MOTOR_READY) || (p->ready != INDUCTION_MOTOR_READY)) {
        status = induction_motor_ready(s, p);
    }
    if ((status & INDUCTION_MOTOR_NO_PARAMETERS) == 0u) {
        status |= induction_motor_run_update_y1(s, p, measurement);
    }
    return status;
}

uint32_t induction_motor_update_y2(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != INDUCTION_MOTOR_READY) || (p->ready != INDUCTION_MOTOR_READY)) {
        status = induction_motor_ready(s, p);
    }
    if ((status & INDUCTION_MOTOR_NO_PARAMETERS) == 0u) {
        status |= induction_motor_run_update_y2(s, p, measurement);
    }
    return status;
}

uint32_t induction_motor_step(induction_motor_state *s, const induction_motor_params *p,
    const induction_motor_input *in, const induction_motor_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != INDUCTION_MOTOR_READY) || (p->ready != INDUCTION_MOTOR_READY)) {
        status = induction_motor_ready(s, p);
    }
    if ((status & INDUCTION_MOTOR_NO_PARAMETERS) == 0u) {
        status |= induction_motor_run_predict(s, p, in);
        status |= induction_motor_run_update_y1(s, p, measurement);
        status |= induction_motor_run_update_y2(s, p, measurement);
    }
    return status;
}

void induction_motor_estimate(const induction_motor_state *s, const induction_motor_params *p,
    induction_motor_plant *x)
{
    (void)p;
    /* the plant's state */
    x->ia = s->z[0];
    x->ib = s->z[1];
    x->fa = s->z[2];
    x->fb = s->z[3];
    x->w = s->z[4];
}

uint32_t induction_motor_tune(induction_motor_params *p)
{
    uint32_t status = 0u;
    if (p->ready != INDUCTION_MOTOR_READY) {
        induction_motor_nominal(p);
        status = INDUCTION_MOTOR_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[7] = {
            {1e-10f, 1e+07f, 1.0f}, /* p->gain.Q[0] */
            {1e-10f, 1e+07f, 1.0f}, /* p->gain.Q[1] */
            {1e-10f, 1e+07f, 0.0001f}, /* p->gain.Q[2] */
            {1e-10f, 1e+07f, 0.0001f}, /* p->gain.Q[3] */
            {1e-10f, 1e+07f, 10.0f}, /* p->gain.Q[4] */
            {1e-14f, 0.01f, 1e-08f}, /* p->gain.R[0] */
            {1e-14f, 0.01f, 1e-08f}, /* p->gain.R[1] */
        };
        float *const value[7] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.Q[2],
            &p->gain.Q[3],
            &p->gain.Q[4],
            &p->gain.R[0],
            &p->gain.R[1]
        };
        for (unsigned k = 0u; k < 7u; ++k) {
            const float v = *value[k];
            *value[k] = induction_motor_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= INDUCTION_MOTOR_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

INDUCTION_MOTOR_RARELY
void induction_motor_reset(induction_motor_state *s)
{
    s->ready = INDUCTION_MOTOR_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->z[3] = 0.0f;
    s->z[4] = 0.0f;
    s->calls = 0u;
    s->used_y1 = 1u;
    s->used_y2 = 1u;
    s->u[0] = 0.0f;
    s->u[1] = 0.0f;
    induction_motor_clear_fault_counts(s);
    induction_motor_clear_rest(s);
}

void induction_motor_init(induction_motor_state *s, induction_motor_params *p)
{
    induction_motor_nominal(p);
    (void)induction_motor_tune(p);
    induction_motor_reset(s);
}

static const unsigned char induction_motor_layout[8] = {
    0x8Fu, 0x6Cu, 0x81u, 0x49u, 0xB1u, 0xEFu, 0x31u, 0x4Fu
};

/* CRC-32 of IEEE 802.3 */
static uint32_t induction_motor_checksum(const unsigned char *bytes, size_t size)
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

void induction_motor_save(const induction_motor_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = induction_motor_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = induction_motor_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned induction_motor_restore(induction_motor_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == INDUCTION_MOTOR_SAVED) {
        refused = 0u;
        uint32_t sum = induction_motor_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == induction_motor_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = INDUCTION_MOTOR_READY;
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
