/* not_iss: see not_iss.h, and its manual not_iss.md. */
#include "not_iss.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(NOT_ISS_USE_LIBM)
#include <math.h>
#elif defined(NOT_ISS_USE_CMSIS)
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
#define NOT_ISS_RARELY __attribute__((noinline))
#else
#define NOT_ISS_RARELY
#endif

static float not_iss_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float not_iss_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float not_iss_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool not_iss_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float not_iss_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool not_iss_within(float v, float limit)
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
static bool not_iss_inside(float v, float low, float high)
{
    return v >= low && v <= high;
}

/* v in [-most, most] */
static float not_iss_limit(float v, float most)
{
    return not_iss_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float not_iss_keep(float v, float low, float high, float otherwise, float limit)
{
    return not_iss_within(v, limit) ? not_iss_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define NOT_ISS_USE_LIBM for those of <math.h>, or NOT_ISS_USE_CMSIS for CMSIS-DSP. */
#if defined(NOT_ISS_USE_LIBM)
static float not_iss_sqrt(float x)
{
    return sqrtf(x);
}

#elif defined(NOT_ISS_USE_CMSIS)
static float not_iss_sqrt(float x)
{
    return sqrtf(x);
}

#else
static float not_iss_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

static float not_iss_nan(void)
{
    const float large = not_iss_inf();
    return large - large;
}

static float not_iss_sqrt(float x)
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
    return (x < 1.1754944e-38f) ? ((x < 0.0f) ? not_iss_nan() : 0.0f) : ((x > 3.4028235e+38f) ? x : t16);
}
#endif

/* the right-hand side of the observer's differential equation */
static void not_iss_rate(const not_iss_params *p, const float z[2], const float P[3], float u,
    const float y[2], const float valid[2], float dz[2], float dP[3])
{
    const float z1 = z[0];
    const float z2 = z[1];
    const float P1 = P[0];
    const float P2 = P[1];
    const float P3 = P[2];
    const float y1 = y[0];
    const float y2 = y[1];
    const float valid1 = valid[0];
    const float valid2 = valid[1];
    const float t1 = not_iss_clamp(z2, 0.0f, 4.0f);
    const float t2 = (t1 + 1.0f)*u;
    const float t3 = not_iss_clamp(z1, 0.0f, 2.0f);
    const float t4 = t3*u;
    const float R1 = p->gain.R[0];
    const float t5 = valid1*R1;
    const float t6 = (P1*t2 + P2*t4)*t5;
    const float t7 = u*t3;
    const float t8 = t7*t1;
    const float t9 = t1*u;
    const float t10 = y1 - (u*z1 + t8 + (t9*(z1 - t3) + t7*(z2 - t1)));
    const float t11 = valid2*p->gain.R[1];
    const float t12 = P2*t11;
    const float t13 = y2 - z2;
    const float t14 = 2.0f*u;
    const float t15 = (P2*t2 + P3*t4)*t5;
    const float t16 = P3*t11;
    const float curvature = p->gain.curvature;
    const float t17 = valid1*t10*R1*u;
    const float t18 = P2*t17;
    const float t19 = t18*t18;
    const float t20 = P1*t17;
    const float t21 = P3*t17;
    const float t22 = curvature/not_iss_sqrt(not_iss_max(curvature*curvature, t19 + t20*t21
        + (t21*t20 + t19)));
    const float t23 = 2.0f*t9 - 4.0f*t3 + t14;
    const float t24 = 2.0f*t7;
    const float t25 = t15*t2;
    const float t26 = t15*t4 + t16;
    dz[0] = u*z2 - z1 + u + (t6*t10 + t12*t13);
    dz[1] = 2.0f*t8 - t3*t3*2.0f + t14*z1 + (t15*t10 + t16*t13);
    dP[0] = 2.0f*(u*P2 - P1) + p->derived.Q_inverse[0] - (t6*t2*P1 + (t6*t4 + t12)*P2)
        + t22*(t18*P1 + t20*P2);
    dP[1] = t23*P1 + t24*P2 + (u*P3 - P2) - (t25*P1 + t26*P2) + t22*(t21*P1 + t18*P2);
    dP[2] = 2.0f*(t23*P2 + t24*P3) + p->derived.Q_inverse[1] - (t25*P2 + t26*P3) + t22*(t21*P2 + t18*P3);
}

/* memory without its mark is not used: the state begins anew, which the status says */
NOT_ISS_RARELY
static unsigned not_iss_ready(not_iss_state *s, const not_iss_params *p)
{
    unsigned status = 0u;
    if (s->ready != NOT_ISS_READY) {
        not_iss_reset(s);
        status |= NOT_ISS_UNINITIALISED;
    }
    if (p->ready != NOT_ISS_READY) {
        not_iss_reset(s);
        status |= NOT_ISS_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
NOT_ISS_RARELY
static void not_iss_clear_fault_counts(not_iss_state *s)
{
    /* as after a reset */
    s->fault_count_y_y2 = 0.0f;
    s->fault_limit_y_y2 = 276.0f;
    s->fault_count_y_y1 = 0.0f;
    s->fault_limit_y_y1 = 276.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 551.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned not_iss_keep_in_box(not_iss_state *s, const not_iss_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = not_iss_within(s->z[0], 1e+30f) && not_iss_within(s->z[1], 1e+30f)
            && not_iss_within(s->P[0], 1e+30f);
        lost = !(t1 && not_iss_within(s->P[1], 1e+30f) && not_iss_within(s->P[2], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        status |= NOT_ISS_RESTARTED;
        not_iss_clear_fault_counts(s);
        /* as after a reset */
        s->P[0] = 0.01f;
        s->P[1] = 0.0f;
        s->P[2] = 0.01f;
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = not_iss_clamp(z1, -2.0f, 4.0f);
        s->z[1] = not_iss_clamp(z2, -4.0f, 8.0f);
        if (z1 < -2.0f || z1 > 4.0f || z2 < -4.0f || z2 > 8.0f) {
            status |= NOT_ISS_STATE_LIMITED;
        }
    }
    /* keep P in its box */
    {
        const float P11 = s->P[0];
        const float P21 = s->P[1];
        const float P22 = s->P[2];
        s->P[0] = not_iss_limit(P11, 1e+30f);
        s->P[1] = not_iss_limit(P21, 1e+30f);
        s->P[2] = not_iss_limit(P22, 1e+30f);
    }
    return status;
}

/* nominal parameters */
NOT_ISS_RARELY
static void not_iss_nominal(not_iss_params *p)
{
    p->ready = NOT_ISS_READY;
    p->gain.Q[0] = 10.0f;
    p->gain.Q[1] = 10.0f;
    p->gain.R[0] = 100.0f;
    p->gain.R[1] = 100.0f;
    p->gain.curvature = 5.0f;
}

/* move the estimate to the nearest one that fits the sample of y2 */
static void not_iss_fit_y2(not_iss_state *s, const not_iss_output *measurement, const float *valid)
{
    /* from the sample of y2 */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float reading_y2 = measurement->y2;
        const bool t1 = valid[1] > 0.0f || (reading_y2 >= -4.0f && reading_y2 <= 8.0f);
        s->z[0] = t1 ? not_iss_keep(z1, 0.0f, 2.0f, z1, 1e+30f) : z1;
        s->z[1] = t1 ? not_iss_keep(reading_y2, 0.0f, 4.0f, z2, 1e+30f) : z2;
    }
}

/* move the estimate to the nearest one that fits the sample of y1 */
static void not_iss_fit_y1(not_iss_state *s, const not_iss_output *measurement, const float *valid)
{
    /* from the sample of y1 */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float reading_y1 = measurement->y1;
        const bool t1 = valid[0] > 0.0f || (reading_y1 >= -10.0f && reading_y1 <= 20.0f);
        const float t2 = not_iss_clamp(z2, 0.0f, 4.0f);
        const float u_before = s->u;
        const float t3 = (t2 + 1.0f)*u_before;
        const float t4 = 36.0f*t3;
        const float t5 = not_iss_clamp(z1, 0.0f, 2.0f);
        const float t6 = u_before*t5;
        const float t7 = t5*u_before;
        const float t8 = 144.0f*t7;
        const float t9 = (reading_y1 - (u_before*z1 + t6*t2
            + (t2*u_before*(z1 - t5) + t6*(z2 - t2))))/not_iss_max(t3*t4 + t7*t8, 1e-10f);
        s->z[0] = t1 ? not_iss_keep(z1 + t4*t9, 0.0f, 2.0f, z1, 1e+30f) : z1;
        s->z[1] = t1 ? not_iss_keep(z2 + t8*t9, 0.0f, 4.0f, z2, 1e+30f) : z2;
    }
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned not_iss_guard_input(const not_iss_state *s, const not_iss_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float w = in->w;
        const bool w_usable = not_iss_within(w, 1e+15f);
        const float w_taken = w_usable ? w : s->u;
        *u = not_iss_clamp(w_taken, 0.0f, 1.0f);
        if (!w_usable) {
            status |= NOT_ISS_REUSED_W;
        }
        if (w_taken < 0.0f || w_taken > 1.0f) {
            status |= NOT_ISS_CLAMPED_W;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned not_iss_guard_measurements(const not_iss_state *s, const not_iss_output *measurement,
    float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading_y1 = measurement->y1;
        const float u_before = s->u;
        const float z1 = s->z[0];
        const float t1 = not_iss_clamp(z1, 0.0f, 2.0f);
        const float t2 = u_before*t1;
        const float z2 = s->z[1];
        const float t3 = not_iss_clamp(z2, 0.0f, 4.0f);
        const float t4 = u_before*z1 + t2*t3 + (t3*u_before*(z1 - t1) + t2*(z2 - t3));
        const bool t5 = not_iss_inside(reading_y1, -10.0f, 20.0f) && not_iss_within(reading_y1 - t4, 1e+16f);
        const float t6 = t5 ? reading_y1 : t4;
        const float reading_y2 = measurement->y2;
        const bool t7 = not_iss_inside(reading_y2, -4.0f, 8.0f) && not_iss_within(reading_y2 - z2, 1e+16f);
        const float t8 = t7 ? reading_y2 : z2;
        const float y_before1 = s->y[0];
        const float y_before2 = s->y[1];
        const bool t9 = not_iss_within(reading_y1, 3e+38f);
        const bool t10 = not_iss_within(reading_y2, 3e+38f);
        y[0] = t6;
        y[1] = t8;
        y_last[0] = (t5 && s->y_valid[0] > 0.0f && not_iss_inside(y_before1, -10.0f, 20.0f)) ? y_before1 : t6;
        y_last[1] = (t7 && s->y_valid[1] > 0.0f && not_iss_inside(y_before2, -4.0f, 8.0f)) ? y_before2 : t8;
        valid[0] = t5 ? 1.0f : 0.0f;
        valid[1] = t7 ? 1.0f : 0.0f;
        if (!t9) {
            status |= NOT_ISS_MISSING_Y1;
        }
        if (t9 && !t5) {
            status |= NOT_ISS_REJECTED_Y1;
        }
        if (!t10) {
            status |= NOT_ISS_MISSING_Y2;
        }
        if (t10 && !t7) {
            status |= NOT_ISS_REJECTED_Y2;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned not_iss_advance(not_iss_state *s, const not_iss_params *p, float u, const float *valid,
    const float *y, const float *y_last)
{
    unsigned status = 0u;
    float P_at[3];
    float P_sum[3];
    float ahead = 0.0f;
    bool beyond = false;
    bool broken = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[2];
    float z_sum[2];
    /* z, P: one step of classical Runge-Kutta */
    /* its tableau: */
    /*     0 |  */
    /*   1/2 | 1/2 */
    /*   1/2 |   0 1/2 */
    /*     1 |   0   0   1 */
    /*   --------------------- */
    /*       | 1/6 1/3 1/3 1/6 */
    /* fraction is c of a stage; share is its b over that of the first; ahead is the next stage's a times
     * dt */
    z_sum[0] = 0.0f;
    z_sum[1] = 0.0f;
    P_sum[0] = 0.0f;
    P_sum[1] = 0.0f;
    P_sum[2] = 0.0f;
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
    P_at[0] = s->P[0];
    P_at[1] = s->P[1];
    P_at[2] = s->P[2];
    {
        static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
        static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
        static const float each_ahead[4] = {0.005f, 0.005f, 0.01f, 0.0f};
        for (unsigned r = 0u; r < 4u; ++r) {
            fraction = each_fraction[r];
            share = each_share[r];
            ahead = each_ahead[r];
            /* a stage */
            {
                const float P_sum1 = P_sum[0];
                const float P_sum2 = P_sum[1];
                const float P_sum3 = P_sum[2];
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float u_before = s->u;
                const float y_last1 = y_last[0];
                const float y_last2 = y_last[1];
                const float y_1[2] = {
                    y_last1 + fraction*(y[0] - y_last1),
                    y_last2 + fraction*(y[1] - y_last2)
                };
                float k_z[2];
                float k_P[3];
                not_iss_rate(p, z_at, P_at, u_before + fraction*(u - u_before), y_1, valid, k_z, k_P);
                z_sum[0] = z_sum1 + share*k_z[0];
                z_sum[1] = z_sum2 + share*k_z[1];
                P_sum[0] = P_sum1 + share*k_P[0];
                P_sum[1] = P_sum2 + share*k_P[1];
                P_sum[2] = P_sum3 + share*k_P[2];
                z_at[0] = s->z[0] + ahead*k_z[0];
                z_at[1] = s->z[1] + ahead*k_z[1];
                P_at[0] = s->P[0] + ahead*k_P[0];
                P_at[1] = s->P[1] + ahead*k_P[1];
                P_at[2] = s->P[2] + ahead*k_P[2];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float P11 = s->P[0];
        const float P21 = s->P[1];
        const float P22 = s->P[2];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = z1 + 0.0016666667f*z_sum[0];
        s->z[1] = z2 + 0.0016666667f*z_sum[1];
        s->P[0] = P11 + 0.0016666667f*P_sum[0];
        s->P[1] = P21 + 0.0016666667f*P_sum[1];
        s->P[2] = P22 + 0.0016666667f*P_sum[2];
    }
    /* is it positive definite? */
    {
        const float P11 = s->P[0];
        const float t1 = s->P[1]/P11;
        broken = !(P11 > 0.0f && s->P[2] - t1*t1*P11 > 0.0f);
    }
    if (broken) {
        /* a covariance that is none restarts */
        s->P[0] = 0.01f;
        s->P[1] = 0.0f;
        s->P[2] = 0.01f;
        status |= NOT_ISS_COVARIANCE_RESTARTED;
    }
    /* is a value beyond its box, or lost? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 >= -2.0f && z1 <= 4.0f && z2 >= -4.0f && z2 <= 8.0f
            && not_iss_within(s->P[0], 1e+30f) && not_iss_within(s->P[1], 1e+30f);
        beyond = !(t1 && not_iss_within(s->P[2], 1e+30f));
    }
    if (not_iss_acts(beyond)) {
        status |= not_iss_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned not_iss_suspect(const not_iss_state *s, const not_iss_output *measurement, bool *suspect,
    const float *valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const bool t1 = z1 < 0.0f || z1 > 2.0f || z2 < 0.0f || z2 > 4.0f;
        const float u_before = s->u;
        const float t2 = not_iss_clamp(z1, 0.0f, 2.0f);
        const float t3 = u_before*t2;
        const float t4 = not_iss_clamp(z2, 0.0f, 4.0f);
        const float t5 = not_iss_abs(measurement->y1 - (u_before*z1 + t3*t4
            + (t4*u_before*(z1 - t2) + t3*(z2 - t4))));
        if (t1) {
            status |= NOT_ISS_OUTSIDE_BOX;
        }
        *suspect = not_iss_abs(measurement->y2 - z2) > 0.4f || t5 > 1.0f || t1
            || !(s->fault_checksum <= 0.0f) || !(valid[1] > 0.0f) || !(valid[0] > 0.0f);
    }
    return status;
}

/* is there a sample in the plausible range of its sensor? It judges the estimate, even where it is too far
 * off to correct it */
static bool not_iss_sample_in_plausible_range(const not_iss_output *measurement, const float *valid)
{
    bool sampled = false;
    /* is there a sample to judge by? */
    {
        const float reading_y2 = measurement->y2;
        const float reading_y1 = measurement->y1;
        sampled = valid[1] > 0.0f || (reading_y2 >= -4.0f && reading_y2 <= 8.0f) || valid[0] > 0.0f
            || (reading_y1 >= -10.0f && reading_y1 <= 20.0f);
    }
    return sampled;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool not_iss_counts_spoiled(const not_iss_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float fault_limit_y_y2 = s->fault_limit_y_y2;
        const float fault_count_y_y1 = s->fault_count_y_y1;
        const float fault_limit_y_y1 = s->fault_limit_y_y1;
        const float t1 = fault_limit_y_y2 - 276.0f + not_iss_abs(fault_count_y_y2)
            + (fault_limit_y_y1 - 276.0f + not_iss_abs(fault_count_y_y1));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = not_iss_abs(fault_limit_range - 551.0f + fault_count_range + t1
            - s->fault_checksum) < 0.5f && not_iss_within(fault_count_y_y2, 282624.0f);
        const bool t3 = t2 && fault_limit_y_y2 >= 276.0f && fault_limit_y_y2 <= 282624.0f
            && not_iss_within(fault_count_y_y1, 282624.0f);
        const bool t4 = t3 && fault_limit_y_y1 >= 276.0f && fault_limit_y_y1 <= 282624.0f
            && fault_count_range >= 0.0f && fault_count_range <= 564224.0f;
        spoiled = !(t4 && fault_limit_range >= 551.0f && fault_limit_range <= 564224.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void not_iss_find_signs(const not_iss_state *s, const not_iss_params *p,
    const not_iss_output *measurement, float *moves_y_y1, float *moves_y_y2, float *side_y_y1,
        float *side_y_y2, const float *valid)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float reading_y2 = measurement->y2;
        const bool t1 = valid[1] > 0.0f || (reading_y2 >= -4.0f && reading_y2 <= 8.0f);
        const float z2 = s->z[1];
        const float t2 = reading_y2 - z2;
        const bool t3 = not_iss_within(t2, not_iss_max(0.4f,
            not_iss_min(3.0f*not_iss_sqrt(1.0f/p->gain.R[1]/0.01f + s->P[2]), 1.0f)));
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float reading_y1 = measurement->y1;
        const bool t4 = valid[0] > 0.0f || (reading_y1 >= -10.0f && reading_y1 <= 20.0f);
        const float u_before = s->u;
        const float z1 = s->z[0];
        const float t5 = not_iss_clamp(z1, 0.0f, 2.0f);
        const float t6 = u_before*t5;
        const float t7 = not_iss_clamp(z2, 0.0f, 4.0f);
        const float t8 = reading_y1 - (u_before*z1 + t6*t7 + (t7*u_before*(z1 - t5) + t6*(z2 - t7)));
        const bool t9 = not_iss_within(t8, 1.0f);
        const float fault_count_y_y1 = s->fault_count_y_y1;
        *moves_y_y2 = t1 ? (t3 ? 0.0f : ((fault_count_y_y2*t2 < 0.0f) ? -100.0f : 1.0f))
            + (t3 ? -1.0f : 0.0f) : 0.0f;
        *side_y_y2 = (!t3 && t1) ? t2 : fault_count_y_y2;
        *moves_y_y1 = t4 ? (t9 ? 0.0f : ((fault_count_y_y1*t8 < 0.0f) ? -100.0f : 1.0f))
            + (t9 ? -1.0f : 0.0f) : 0.0f;
        *side_y_y1 = (!t9 && t4) ? t8 : fault_count_y_y1;
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned not_iss_recover(not_iss_state *s, const not_iss_output *measurement, const float *valid)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y1 = false;
    bool over_y_y2 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y2 <= not_iss_abs(s->fault_count_y_y2);
        const bool t2 = s->fault_limit_y_y1 <= not_iss_abs(s->fault_count_y_y1);
        const float fault_limit_range = s->fault_limit_range;
        const bool t3 = fault_limit_range <= s->fault_count_range;
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        over_y_y2 = t1;
        over_y_y1 = t2;
        over_range = t3;
        lost = t1 || t2 || (t3 && (fault_limit_range > 551.0f || z1 < -1.0f || z1 > 3.0f || z2 < -2.0f
            || z2 > 6.0f));
    }
    if (over_y_y2) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y2 = s->fault_count_y_y2;
            const float fault_limit_y_y2 = s->fault_limit_y_y2;
            const float t1 = not_iss_min(fault_limit_y_y2, 141312.0f);
            s->fault_count_y_y2 = (fault_count_y_y2 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y2 = not_iss_min(2.0f*fault_limit_y_y2, 282624.0f);
        }
    }
    if (over_y_y1) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y1 = s->fault_count_y_y1;
            const float fault_limit_y_y1 = s->fault_limit_y_y1;
            const float t1 = not_iss_min(fault_limit_y_y1, 141312.0f);
            s->fault_count_y_y1 = (fault_count_y_y1 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y1 = not_iss_min(2.0f*fault_limit_y_y1, 282624.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = not_iss_min(fault_limit_range, 282112.0f);
            s->fault_limit_range = not_iss_min(2.0f*fault_limit_range, 564224.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        not_iss_fit_y2(s, measurement, valid);
        not_iss_fit_y1(s, measurement, valid);
        not_iss_fit_y2(s, measurement, valid);
        not_iss_fit_y1(s, measurement, valid);
        not_iss_fit_y2(s, measurement, valid);
        not_iss_fit_y1(s, measurement, valid);
        /* the estimate has restarted from the sample */
        status |= NOT_ISS_RESTARTED_FROM_SAMPLE;
        /* as after a reset */
        s->P[0] = 0.01f;
        s->P[1] = 0.0f;
        s->P[2] = 0.01f;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float P21 = s->P[1];
            const float t1 = z1 - not_iss_clamp(z1, 0.0f, 2.0f);
            const float t2 = z2 - t1/s->P[0]*P21;
            const float t3 = t2 - not_iss_clamp(t2, 0.0f, 4.0f);
            const float t4 = t2 - t3 - z2;
            const float t5 = (t4 > 0.0f) ? 8.0f - z2 : z2 + 4.0f;
            const float t6 = z1 - t1 - t3/s->P[2]*P21 - z1;
            const float t7 = (t6 > 0.0f) ? 4.0f - z1 : z1 + 2.0f;
            const float t8 = not_iss_abs(t6);
            const float t9 = (t7 < t8) ? t7/t8 : 1.0f;
            const float t10 = not_iss_abs(t4);
            const float t11 = (t5 < t9*t10) ? t5/t10 : t9;
            s->z[0] = not_iss_keep(z1 + t11*t6, -2.0f, 4.0f, z1, 1e+30f);
            s->z[1] = not_iss_keep(z2 + t11*t4, -4.0f, 8.0f, z2, 1e+30f);
            status |= NOT_ISS_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned not_iss_count_faults(not_iss_state *s, const not_iss_params *p,
    const not_iss_output *measurement, const float *valid)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y_y1 = 0.0f;
    float moves_y_y2 = 0.0f;
    float side_y_y1 = 0.0f;
    float side_y_y2 = 0.0f;
    bool spoiled = false;
    spoiled = not_iss_counts_spoiled(s);
    if (spoiled) {
        not_iss_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        moves_range = (z1 < -0.1f || z1 > 2.1f || z2 < -0.2f || z2 > 4.2f) ? 2.0f : -2.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = not_iss_clamp(fault_count_range + moves_range, 0.0f, 564224.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 551.0f : fault_limit_range;
    }
    not_iss_find_signs(s, p, measurement, &moves_y_y1, &moves_y_y2, &side_y_y1, &side_y_y2, valid);
    /* count of y_y2 */
    {
        const float fault_count_y_y2 = s->fault_count_y_y2;
        const float fault_limit_y_y2 = s->fault_limit_y_y2;
        const float t1 = not_iss_clamp(not_iss_abs(fault_count_y_y2) + moves_y_y2, 0.0f, 282624.0f);
        s->fault_count_y_y2 = (side_y_y2 < 0.0f) ? -t1 : t1;
        s->fault_limit_y_y2 = (t1 <= 0.0f) ? 276.0f : fault_limit_y_y2;
    }
    /* count of y_y1 */
    {
        const float fault_count_y_y1 = s->fault_count_y_y1;
        const float fault_limit_y_y1 = s->fault_limit_y_y1;
        const float t1 = not_iss_clamp(not_iss_abs(fault_count_y_y1) + moves_y_y1, 0.0f, 282624.0f);
        s->fault_count_y_y1 = (side_y_y1 < 0.0f) ? -t1 : t1;
        s->fault_limit_y_y1 = (t1 <= 0.0f) ? 276.0f : fault_limit_y_y1;
    }
    /* is a fault count at its limit? */
    {
        const bool t1 = s->fault_limit_y_y2 <= not_iss_abs(s->fault_count_y_y2)
            || s->fault_limit_y_y1 <= not_iss_abs(s->fault_count_y_y1);
        acts = t1 || s->fault_limit_range <= s->fault_count_range;
    }
    if (acts) {
        status |= not_iss_recover(s, measurement, valid);
    }
    /* the checksum of fault counts and limits */
    {
        const float t1 = s->fault_limit_y_y2 - 276.0f + not_iss_abs(s->fault_count_y_y2)
            + (s->fault_limit_y_y1 - 276.0f + not_iss_abs(s->fault_count_y_y1));
        s->fault_checksum = s->fault_limit_range - 551.0f + s->fault_count_range + t1;
    }
    return status;
}

unsigned not_iss_step(not_iss_state *s, const not_iss_params *p, const not_iss_input *in,
    const not_iss_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != NOT_ISS_READY) || (p->ready != NOT_ISS_READY)) {
        status = not_iss_ready(s, p);
    }
    if ((status & NOT_ISS_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float u = 0.0f;
        float valid[2];
        float y[2];
        float y_last[2];
        /* keep u in its box */
        {
            const float u_before = s->u;
            s->u = not_iss_clamp(u_before, 0.0f, 1.0f);
        }
        status |= not_iss_guard_input(s, in, &u);
        status |= not_iss_guard_measurements(s, measurement, valid, y, y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= not_iss_advance(s, p, u, valid, y, y_last);
        } else {
            status |= not_iss_keep_in_box(s, p);
        }
        /* remember the input */
        s->u = u;
        /* remember the sample */
        s->y[0] = y[0];
        s->y[1] = y[1];
        s->y_valid[0] = valid[0];
        s->y_valid[1] = valid[1];
        status |= not_iss_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            sampled = not_iss_sample_in_plausible_range(measurement, valid);
            if (sampled) {
                status |= not_iss_count_faults(s, p, measurement, valid);
            }
        }
    }
    return status;
}

void not_iss_estimate(const not_iss_state *s, const not_iss_params *p, not_iss_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x1 = s->z[0];
    x->x2 = s->z[1];
}

unsigned not_iss_tune(not_iss_params *p)
{
    unsigned status = 0u;
    if (p->ready != NOT_ISS_READY) {
        not_iss_nominal(p);
        status = NOT_ISS_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[5] = {
            {1e-05f, 1e+07f, 10.0f}, /* p->gain.Q[0] */
            {1e-05f, 1e+07f, 10.0f}, /* p->gain.Q[1] */
            {0.0001f, 1e+08f, 100.0f}, /* p->gain.R[0] */
            {0.0001f, 1e+08f, 100.0f}, /* p->gain.R[1] */
            {5e-06f, 5.0f, 5.0f}, /* p->gain.curvature */
        };
        float *const value[5] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.R[0],
            &p->gain.R[1],
            &p->gain.curvature
        };
        for (unsigned k = 0u; k < 5u; ++k) {
            const float v = *value[k];
            *value[k] = not_iss_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= NOT_ISS_PARAMETER_LIMITED;
            }
        }
    }
    /* inverse weights */
    p->derived.Q_inverse[0] = 1.0f/p->gain.Q[0];
    p->derived.Q_inverse[1] = 1.0f/p->gain.Q[1];
    return status;
}

NOT_ISS_RARELY
void not_iss_reset(not_iss_state *s)
{
    s->ready = NOT_ISS_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->P[0] = 0.01f;
    s->P[1] = 0.0f;
    s->P[2] = 0.01f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y[0] = 0.0f;
    s->y[1] = 0.0f;
    s->y_valid[0] = 0.0f;
    s->y_valid[1] = 0.0f;
    not_iss_clear_fault_counts(s);
}

void not_iss_init(not_iss_state *s, not_iss_params *p)
{
    not_iss_nominal(p);
    (void)not_iss_tune(p);
    not_iss_reset(s);
}

static const unsigned char not_iss_layout[8] = {0x45u, 0x82u, 0x6Bu, 0xDBu, 0x56u, 0x8Du, 0xC1u, 0xB4u};

/* CRC-32 of IEEE 802.3 */
static uint32_t not_iss_checksum(const unsigned char *bytes, size_t size)
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

void not_iss_save(const not_iss_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = not_iss_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = not_iss_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned not_iss_restore(not_iss_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == NOT_ISS_SAVED) {
        refused = 0u;
        uint32_t sum = not_iss_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == not_iss_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = NOT_ISS_READY;
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
