/* fitzhugh_nagumo: see fitzhugh_nagumo.h, and its manual fitzhugh_nagumo.md. */
#include "fitzhugh_nagumo.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(FITZHUGH_NAGUMO_USE_LIBM)
#include <math.h>
#elif defined(FITZHUGH_NAGUMO_USE_CMSIS)
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
#define FITZHUGH_NAGUMO_RARELY __attribute__((noinline))
#else
#define FITZHUGH_NAGUMO_RARELY
#endif

static float fitzhugh_nagumo_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float fitzhugh_nagumo_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float fitzhugh_nagumo_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool fitzhugh_nagumo_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float fitzhugh_nagumo_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool fitzhugh_nagumo_within(float v, float limit)
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
static float fitzhugh_nagumo_limit(float v, float most)
{
    return fitzhugh_nagumo_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float fitzhugh_nagumo_keep(float v, float low, float high, float otherwise, float limit)
{
    return fitzhugh_nagumo_within(v, limit) ? fitzhugh_nagumo_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define FITZHUGH_NAGUMO_USE_LIBM for those of <math.h>, or FITZHUGH_NAGUMO_USE_CMSIS for CMSIS-DSP. */
#if defined(FITZHUGH_NAGUMO_USE_LIBM)
static float fitzhugh_nagumo_exp(float x)
{
    return expf(x);
}

static float fitzhugh_nagumo_small_sin(float x)
{
    return sinf(x);
}

static float fitzhugh_nagumo_small_cos(float x)
{
    return cosf(x);
}

#elif defined(FITZHUGH_NAGUMO_USE_CMSIS)
static float fitzhugh_nagumo_exp(float x)
{
    return expf(x);
}

static float fitzhugh_nagumo_small_sin(float x)
{
    return arm_sin_f32(x);
}

static float fitzhugh_nagumo_small_cos(float x)
{
    return arm_cos_f32(x);
}

#else
/* whole number nearest to v, where |v| is below a third of 1.2582912e+07f: sums near that are rounded to
 * whole numbers */
static float fitzhugh_nagumo_nearest(float v)
{
#if !defined(__FLT_EVAL_METHOD__) || (__FLT_EVAL_METHOD__ != 0)
    const volatile float sum = v + 1.2582912e+07f;
    return sum - 1.2582912e+07f;
#else
    return v + 1.2582912e+07f - 1.2582912e+07f;
#endif
}

static float fitzhugh_nagumo_inf(void)
{
    const float large = 3e38f;
    return large*large;
}

/* 2^x for whole x, where that is a normal number */
static float fitzhugh_nagumo_power_of_two(float x)
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

static float fitzhugh_nagumo_exp(float x)
{
    const float t1 = fitzhugh_nagumo_nearest((x*x < 16384.0f) ? 1.442695f*x : 0.0f);
    const float t2 = x - 0.69314575f*t1 - 1.4286068e-06f*t1;
    const float t3 = t2 + t2*t2*(0.5f + t2*(((0.0013940646f*t2 + 0.008366435f)*t2 + 0.041666403f)*t2
        + 0.16666545f));
    const float t4 = fitzhugh_nagumo_nearest(0.5f*t1);
    const float t5 = (x < -87.33655f) ? 0.0f
        : (1.0f + t3)*fitzhugh_nagumo_power_of_two(t4)*fitzhugh_nagumo_power_of_two(t1 - t4);
    return (x > 88.896126f) ? fitzhugh_nagumo_inf() : t5;
}

static float fitzhugh_nagumo_small_sin(float x)
{
    const float t1 = fitzhugh_nagumo_within(x, 1.5707964f) ? x
        : ((x > 0.0f) ? 3.1415927f - x - 8.742278e-08f : -3.1415927f - x + 8.742278e-08f);
    const float t2 = t1*t1;
    return t1 + t1*(((2.606055e-06f*t2 - 0.00019809768f)*t2 + 0.008333069f)*t2 - 0.1666666f)*t2;
}

static float fitzhugh_nagumo_small_cos(float x)
{
    const float t1 = fitzhugh_nagumo_abs(x);
    const float t2 = fitzhugh_nagumo_within(x, 3.1415927f) ? 1.5707964f - t1 - 4.371139e-08f
        : -(4.712389f - t1 - 1.1924881e-08f);
    const float t3 = t2*t2;
    return t2 + t2*(((2.606055e-06f*t3 - 0.00019809768f)*t3 + 0.008333069f)*t3 - 0.1666666f)*t3;
}
#endif

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void fitzhugh_nagumo_flow(float z1, float z2, float z3, float u, float dz[2])
{
    const float t1 = fitzhugh_nagumo_limit(z1, 3.5f);
    dz[0] = t1 - t1*t1*t1*0.33333334f - u*z2;
    dz[1] = 2.4f*fitzhugh_nagumo_small_sin(t1) - 0.8f*fitzhugh_nagumo_limit(z2, 10.0f) + 0.8f*z3;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void fitzhugh_nagumo_jacobian(float z1, float u, float F[3])
{
    const float t1 = fitzhugh_nagumo_limit(z1, 3.5f);
    F[0] = 1.0f - 0.33333334f*(2.0f*t1*t1 + t1*t1); /* F_11 */
    F[1] = 2.4f*fitzhugh_nagumo_small_cos(t1); /* F_21 */
    F[2] = -u; /* F_12 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
FITZHUGH_NAGUMO_RARELY
static unsigned fitzhugh_nagumo_ready(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p)
{
    unsigned status = 0u;
    if (s->ready != FITZHUGH_NAGUMO_READY) {
        fitzhugh_nagumo_reset(s);
        status |= FITZHUGH_NAGUMO_UNINITIALISED;
    }
    if (p->ready != FITZHUGH_NAGUMO_READY) {
        fitzhugh_nagumo_reset(s);
        status |= FITZHUGH_NAGUMO_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
FITZHUGH_NAGUMO_RARELY
static void fitzhugh_nagumo_clear_fault_counts(fitzhugh_nagumo_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 1023.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 1023.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
FITZHUGH_NAGUMO_RARELY
static void fitzhugh_nagumo_clear_rest(fitzhugh_nagumo_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->D[0] = 1.0f;
    s->D[1] = 1.0f;
    s->D[2] = 1.0f;
    s->innovation = 0.0f;
    s->theta = 1.0f;
    /* counters as after a reset */
    s->oldest = 0u;
    s->tick = 0u;
    for (unsigned k = 0u; k < 5u; ++k) {
        fitzhugh_nagumo_predictor *const predictor = &s->predictor[k];
        /* from the estimate */
        predictor->z[0] = s->z[0];
        predictor->z[1] = s->z[1];
        predictor->z[2] = s->z[2];
        /* as after a reset */
        predictor->sum = 0.0f;
        /* counters as after a reset */
        predictor->samples = 0u;
    }
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned fitzhugh_nagumo_keep_in_box(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = fitzhugh_nagumo_within(s->z[0], 1e+30f) && fitzhugh_nagumo_within(s->z[1], 1e+30f)
            && fitzhugh_nagumo_within(s->z[2], 1e+30f);
        const bool t2 = t1 && fitzhugh_nagumo_within(s->L[0], 1e+30f)
            && fitzhugh_nagumo_within(s->L[1], 1e+30f) && fitzhugh_nagumo_within(s->L[2], 1e+30f);
        const bool t3 = t2 && fitzhugh_nagumo_within(s->D[0], 1e+30f)
            && fitzhugh_nagumo_within(s->D[1], 1e+30f) && fitzhugh_nagumo_within(s->D[2], 1e+30f);
        const bool t4 = t3 && fitzhugh_nagumo_within(s->innovation, 1e+30f)
            && fitzhugh_nagumo_within(s->theta, 1e+30f);
        lost = !t4;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= FITZHUGH_NAGUMO_RESTARTED;
        fitzhugh_nagumo_clear_fault_counts(s);
        fitzhugh_nagumo_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = fitzhugh_nagumo_limit(z1, 10.5f);
        s->z[1] = fitzhugh_nagumo_limit(z2, 80.0f);
        s->z[2] = fitzhugh_nagumo_limit(z3, 512.0f);
        if (fitzhugh_nagumo_abs(z1) > 10.5f || fitzhugh_nagumo_abs(z2) > 80.0f
            || fitzhugh_nagumo_abs(z3) > 512.0f) {
            status |= FITZHUGH_NAGUMO_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        s->L[0] = fitzhugh_nagumo_limit(L21, 1.0354689e+10f);
        s->L[1] = fitzhugh_nagumo_limit(L31, 4.8761905e+10f);
        s->L[2] = fitzhugh_nagumo_limit(L32, 4.709162e+09f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        s->D[0] = fitzhugh_nagumo_clamp(D1, 1e-15f, 110.25f);
        s->D[1] = fitzhugh_nagumo_clamp(D2, 1e-16f, 11820.959f);
        s->D[2] = fitzhugh_nagumo_clamp(D3, 2.3e-18f, 262144.0f);
    }
    /* keep innovation in its box */
    {
        const float innovation = s->innovation;
        s->innovation = fitzhugh_nagumo_clamp(innovation, 0.0f, 1e+30f);
    }
    /* keep theta in its box */
    {
        const float theta = s->theta;
        s->theta = fitzhugh_nagumo_clamp(theta, 1.0f, 8.0f);
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned fitzhugh_nagumo_guard_input(const fitzhugh_nagumo_state *s, const fitzhugh_nagumo_input *in,
    float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = fitzhugh_nagumo_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = fitzhugh_nagumo_limit(u_taken, 1.0f);
        if (!u_usable) {
            status |= FITZHUGH_NAGUMO_REUSED_U;
        }
        if (fitzhugh_nagumo_abs(u_taken) > 1.0f) {
            status |= FITZHUGH_NAGUMO_CLAMPED_U;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned fitzhugh_nagumo_advance(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p, float u)
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
        fitzhugh_nagumo_flow(z1, z2, z3, u_before, k1_z);
        const float t1 = u_before + 0.5f*(u - u_before);
        float k2_z[2];
        fitzhugh_nagumo_flow(z1 + 0.005f*k1_z[0], z2 + 0.005f*k1_z[1], z3, t1, k2_z);
        const float t2 = z1 + 0.005f*k2_z[0];
        float k3_z[2];
        fitzhugh_nagumo_flow(t2, z2 + 0.005f*k2_z[1], z3, t1, k3_z);
        float k4_z[2];
        fitzhugh_nagumo_flow(z1 + 0.01f*k3_z[0], z2 + 0.01f*k3_z[1], z3, u, k4_z);
        float F_1[3];
        fitzhugh_nagumo_jacobian(t2, t1, F_1);
        const float Phi_11 = 1.0f + 0.01f*F_1[0] + 5e-05f*(F_1[0]*F_1[0] + F_1[2]*F_1[1]);
        const float Phi_12 = 0.01f*F_1[2] + 5e-05f*(F_1[0]*F_1[2] - 0.8f*F_1[2]);
        const float Phi_13 = 4e-05f*F_1[2];
        const float Phi_21 = 0.01f*F_1[1] + 5e-05f*(F_1[1]*F_1[0] - 0.8f*F_1[1]);
        const float Phi_22 = 0.992f + 5e-05f*(F_1[1]*F_1[2] + 0.64f);
        const float w1_1 = Phi_11 + Phi_12*L21 + Phi_13*L31;
        const float w1_2 = Phi_12 + Phi_13*L32;
        const float t3 = w1_1*D1;
        const float t4 = w1_2*D2;
        const float t5 = Phi_13*D3;
        const float theta = s->theta;
        const float t6 = 0.01f*theta;
        const float t7 = t6*p->gain.Q[0];
        const float d1 = w1_1*t3 + w1_2*t4 + Phi_13*t5 + t7;
        const float t8 = Phi_21 + Phi_22*L21 + 0.007968f*L31;
        const float t9 = Phi_22 + 0.007968f*L32;
        const float l21 = (t8*t3 + t9*t4 + 0.007968f*t5)/d1;
        const float l31 = (L31*t3 + L32*t4 + t5)/d1;
        const float w2_1 = t8 - l21*w1_1;
        const float w2_2 = t9 - l21*w1_2;
        const float w2_3 = 0.007968f - l21*Phi_13;
        const float t10 = w2_1*D1;
        const float t11 = w2_2*D2;
        const float t12 = w2_3*D3;
        const float t13 = l21*t7;
        const float t14 = t6*p->gain.Q[1];
        const float d2 = w2_1*t10 + w2_2*t11 + w2_3*t12 + l21*t13 + theta*t14*theta;
        const float t15 = L31 - l31*w1_1;
        const float t16 = L32 - l31*w1_2;
        const float t17 = 1.0f - l31*Phi_13;
        const float l32 = (t15*t10 + t16*t11 + t17*t12 + l31*t13)/d2;
        const float w3_1 = t15 - l32*w2_1;
        const float w3_2 = t16 - l32*w2_2;
        const float w3_3 = t17 - l32*w2_3;
        const float w3_4 = l32*l21 - l31;
        const float w3_6 = theta*theta;
        const float t18 = l32*theta;
        const float d3 = w3_1*D1*w3_1 + w3_2*D2*w3_2 + w3_3*D3*w3_3 + w3_4*t7*w3_4 + t18*t14*t18
            + t6*p->gain.Q[2]*w3_6*w3_6;
        s->z[0] = z1 + 0.0016666667f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 0.0016666667f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
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
        capped = D1 > 110.25f || L21*L21*D1 + D2 > 11820.959f
            || L31*L31*D1 + L32*L32*D2 + s->D[2] > 262144.0f;
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
            const float t1 = fitzhugh_nagumo_min(1.0f, 11820.959f/(L21*L21*D1 + D2));
            const float t2 = fitzhugh_nagumo_min(1.0f, 110.25f/D1);
            const float t3 = fitzhugh_nagumo_min(1.0f, 262144.0f/(L31*L31*D1 + L32*L32*D2 + D3));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t3*L32/t1;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            status |= FITZHUGH_NAGUMO_COVARIANCE_LIMITED;
        }
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        fitzhugh_nagumo_predictor *const predictor = &s->predictor[k];
        /* each predictor by Heun, without correction */
        {
            const float z1 = predictor->z[0];
            const float z2 = predictor->z[1];
            const float z3 = predictor->z[2];
            float dz_1[2];
            fitzhugh_nagumo_flow(z1, z2, z3, s->u, dz_1);
            float dz_2[2];
            fitzhugh_nagumo_flow(z1 + 0.01f*dz_1[0], z2 + 0.01f*dz_1[1], z3, u, dz_2);
            predictor->z[0] = z1 + 0.005f*(dz_1[0] + dz_2[0]);
            predictor->z[1] = z2 + 0.005f*(dz_1[1] + dz_2[1]);
        }
        /* is it beyond its box, or lost? */
        {
            const bool t1 = fitzhugh_nagumo_within(predictor->z[0], 10.5f)
                && fitzhugh_nagumo_within(predictor->z[1], 80.0f);
            beyond = !t1;
        }
        if (fitzhugh_nagumo_acts(beyond)) {
            /* keep it in its box */
            {
                const float z1 = predictor->z[0];
                const float z2 = predictor->z[1];
                predictor->z[0] = fitzhugh_nagumo_keep(z1, -10.5f, 10.5f, 0.0f, 1e+15f);
                predictor->z[1] = fitzhugh_nagumo_keep(z2, -80.0f, 80.0f, 0.0f, 1e+15f);
            }
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = fitzhugh_nagumo_within(s->z[0], 10.5f) && fitzhugh_nagumo_within(s->z[1], 80.0f)
            && fitzhugh_nagumo_within(s->z[2], 512.0f);
        const bool t2 = t1 && fitzhugh_nagumo_within(s->L[0], 1.0354689e+10f)
            && fitzhugh_nagumo_within(s->L[1], 4.8761905e+10f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t3 = t2 && fitzhugh_nagumo_within(s->L[2], 4.709162e+09f) && D1 >= 1e-15f && D1 <= 110.25f
            && D2 >= 1e-16f && D2 <= 11820.959f;
        const float D3 = s->D[2];
        beyond = !(t3 && D3 >= 2.3e-18f && D3 <= 262144.0f);
    }
    if (fitzhugh_nagumo_acts(beyond)) {
        status |= fitzhugh_nagumo_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static unsigned fitzhugh_nagumo_run_predict(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    const fitzhugh_nagumo_input *in)
{
    unsigned status = 0u;
    bool running = false;
    float u = 0.0f;
    /* keep u in its box */
    {
        const float u_before = s->u;
        s->u = fitzhugh_nagumo_limit(u_before, 1.0f);
    }
    status |= fitzhugh_nagumo_guard_input(s, in, &u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = (calls < 2u) ? calls + 1u : 2u;
    }
    if (running) {
        status |= fitzhugh_nagumo_advance(s, p, u);
    } else {
        status |= fitzhugh_nagumo_keep_in_box(s, p);
        for (unsigned k = 0u; k < 5u; ++k) {
            fitzhugh_nagumo_predictor *const predictor = &s->predictor[k];
            /* from the estimate */
            predictor->z[0] = s->z[0];
            predictor->z[1] = s->z[1];
            predictor->z[2] = s->z[2];
        }
    }
    /* samples may come */
    s->used_y = 0u;
    /* remember the input */
    s->u = u;
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static unsigned fitzhugh_nagumo_guard_measurement_y(const fitzhugh_nagumo_state *s, float *e,
    float *output_error, float reading, bool *valid)
{
    unsigned status = 0u;
    /* guard the measurement of y */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = fitzhugh_nagumo_within(reading, 15.0f) && fitzhugh_nagumo_within(t1, 1e+16f);
        const bool t3 = fitzhugh_nagumo_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= FITZHUGH_NAGUMO_MISSING_Y;
        }
        if (t3 && !t2) {
            status |= FITZHUGH_NAGUMO_REJECTED_Y;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static unsigned fitzhugh_nagumo_use_sample_y(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    float e, float reading)
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
        const float t1 = p->gain.R/(0.01f*s->theta);
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->D[0] = K1*t1;
    }
    for (unsigned k = 0u; k < 5u; ++k) {
        fitzhugh_nagumo_predictor *const predictor = &s->predictor[k];
        /* its squared output error */
        {
            const float sum = predictor->sum;
            const float t1 = reading - predictor->z[0];
            predictor->sum = fitzhugh_nagumo_min(sum + 0.01f*t1*t1, 1e+30f);
        }
        /* one more sample */
        {
            const unsigned samples = predictor->samples;
            predictor->samples = (samples < 126u) ? samples + 1u : 126u;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = fitzhugh_nagumo_within(s->z[0], 10.5f) && fitzhugh_nagumo_within(s->z[1], 80.0f)
            && fitzhugh_nagumo_within(s->z[2], 512.0f);
        const float D1 = s->D[0];
        beyond = !(t1 && D1 >= 1e-15f && D1 <= 110.25f);
    }
    if (fitzhugh_nagumo_acts(beyond)) {
        status |= fitzhugh_nagumo_keep_in_box(s, p);
    }
    /* y is used */
    s->used_y = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned fitzhugh_nagumo_suspect_y(const fitzhugh_nagumo_state *s, float output_error, bool *suspect,
    bool valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = fitzhugh_nagumo_abs(s->z[0]) > 3.5f || fitzhugh_nagumo_abs(s->z[1]) > 10.0f
            || fitzhugh_nagumo_abs(s->z[2]) > 8.0f;
        if (t1) {
            status |= FITZHUGH_NAGUMO_OUTSIDE_BOX;
        }
        *suspect = fitzhugh_nagumo_abs(output_error) > 1.0f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool fitzhugh_nagumo_counts_spoiled_y(const fitzhugh_nagumo_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 1023.0f + fitzhugh_nagumo_abs(fault_count_y)
            + (fault_limit_range - 1023.0f + fault_count_range);
        const bool t2 = fitzhugh_nagumo_abs(t1 - s->fault_checksum) < 0.5f
            && fitzhugh_nagumo_within(fault_count_y, 1047552.0f);
        const bool t3 = t2 && fault_limit_y >= 1023.0f && fault_limit_y <= 1047552.0f
            && fault_count_range >= 0.0f && fault_count_range <= 1047552.0f;
        spoiled = !(t3 && fault_limit_range >= 1023.0f && fault_limit_range <= 1047552.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void fitzhugh_nagumo_find_signs_y(const fitzhugh_nagumo_state *s, float *moves_y, float output_error,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = fitzhugh_nagumo_within(output_error, 1.0f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t1 ? 0.0f : ((fault_count_y*output_error < 0.0f) ? -39.0f : 1.0f)) + (t1 ? -1.0f : 0.0f);
        *side_y = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned fitzhugh_nagumo_recover_y(fitzhugh_nagumo_state *s, float reading)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= fitzhugh_nagumo_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = fitzhugh_nagumo_abs(s->z[0]) > 7.0f || fitzhugh_nagumo_abs(s->z[1]) > 20.0f
            || fitzhugh_nagumo_abs(s->z[2]) > 16.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 1023.0f || t3));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = fitzhugh_nagumo_min(fault_limit_y, 523776.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = fitzhugh_nagumo_min(2.0f*fault_limit_y, 1047552.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = fitzhugh_nagumo_min(fault_limit_range, 523776.0f);
            s->fault_limit_range = fitzhugh_nagumo_min(2.0f*fault_limit_range, 1047552.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = fitzhugh_nagumo_keep(reading, -3.5f, 3.5f, z1, 1e+30f);
            s->z[1] = fitzhugh_nagumo_keep(z2, -10.0f, 10.0f, z2, 1e+30f);
            s->z[2] = fitzhugh_nagumo_keep(z3, -8.0f, 8.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= FITZHUGH_NAGUMO_RESTARTED_FROM_SAMPLE;
        fitzhugh_nagumo_clear_rest(s);
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float L31 = s->L[1];
            const float D1 = s->D[0];
            const float t1 = L31*D1;
            const float t2 = z1 - fitzhugh_nagumo_limit(z1, 3.5f);
            const float t3 = t2/D1;
            const float L21 = s->L[0];
            const float L32 = s->L[2];
            const float D2 = s->D[1];
            const float t4 = L32*D2;
            const float t5 = L21*D1;
            const float t6 = z2 - t5*t3;
            const float t7 = t6 - fitzhugh_nagumo_limit(t6, 10.0f);
            const float t8 = t7/(t5*L21 + D2);
            const float t9 = z3 - t1*t3 - (t1*L21 + t4)*t8;
            const float t10 = t9 - fitzhugh_nagumo_limit(t9, 8.0f);
            const float t11 = t9 - t10 - z3;
            const float t12 = (t11 > 0.0f) ? 512.0f - z3 : z3 + 512.0f;
            const float t13 = t10/(t1*L31 + t4*L32 + s->D[2]);
            const float t14 = t6 - t7 - (t5*L31 + D2*L32)*t13 - z2;
            const float t15 = (t14 > 0.0f) ? 80.0f - z2 : z2 + 80.0f;
            const float t16 = z1 - t2 - D1*L21*t8 - D1*L31*t13 - z1;
            const float t17 = (t16 > 0.0f) ? 10.5f - z1 : z1 + 10.5f;
            const float t18 = fitzhugh_nagumo_abs(t16);
            const float t19 = (t17 < t18) ? t17/t18 : 1.0f;
            const float t20 = fitzhugh_nagumo_abs(t14);
            const float t21 = (t15 < t19*t20) ? t15/t20 : t19;
            const float t22 = fitzhugh_nagumo_abs(t11);
            const float t23 = (t12 < t21*t22) ? t12/t22 : t21;
            s->z[0] = fitzhugh_nagumo_keep(z1 + t23*t16, -10.5f, 10.5f, z1, 1e+30f);
            s->z[1] = fitzhugh_nagumo_keep(z2 + t23*t14, -80.0f, 80.0f, z2, 1e+30f);
            s->z[2] = fitzhugh_nagumo_keep(z3 + t23*t11, -512.0f, 512.0f, z3, 1e+30f);
            status |= FITZHUGH_NAGUMO_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned fitzhugh_nagumo_count_faults_y(fitzhugh_nagumo_state *s, float output_error, float reading)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = fitzhugh_nagumo_counts_spoiled_y(s);
    if (spoiled) {
        fitzhugh_nagumo_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = fitzhugh_nagumo_abs(s->z[0]) > 3.85f || fitzhugh_nagumo_abs(s->z[1]) > 11.0f
            || fitzhugh_nagumo_abs(s->z[2]) > 8.8f;
        moves_range = t1 ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fitzhugh_nagumo_clamp(fault_count_range + moves_range, 0.0f, 1047552.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 1023.0f : fault_limit_range;
    }
    fitzhugh_nagumo_find_signs_y(s, &moves_y, output_error, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = fitzhugh_nagumo_clamp(fitzhugh_nagumo_abs(fault_count_y) + moves_y, 0.0f,
            1047552.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 1023.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= fitzhugh_nagumo_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= fitzhugh_nagumo_recover_y(s, reading);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 1023.0f + fitzhugh_nagumo_abs(s->fault_count_y)
        + (s->fault_limit_range - 1023.0f + s->fault_count_range);
    return status;
}

/* part of a step: correct with y */
static unsigned fitzhugh_nagumo_run_update_y(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    const fitzhugh_nagumo_output *measurement)
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
        status |= fitzhugh_nagumo_guard_measurement_y(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= fitzhugh_nagumo_use_sample_y(s, p, e, reading);
        }
        status |= fitzhugh_nagumo_suspect_y(s, output_error, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || fitzhugh_nagumo_within(reading, 15.0f);
            if (sampled) {
                status |= fitzhugh_nagumo_count_faults_y(s, output_error, reading);
            }
        }
    } else {
        /* there was no predict since the last */
        status |= FITZHUGH_NAGUMO_OUT_OF_ORDER;
    }
    return status;
}

/* part of a step: adapt the gain; once after the updates */
static unsigned fitzhugh_nagumo_run_adapt(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p)
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
            fitzhugh_nagumo_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
            /* innovation: the sum of the oldest predictor, scaled to the window, never scaled up */
            s->innovation = 100.0f/fitzhugh_nagumo_max((float)predictor->samples, 100.0f)*predictor->sum;
        }
        /* one predictor restarts every 25 samples */
        {
            const unsigned tick = s->tick;
            const unsigned t1 = tick + 1u;
            const bool t2 = t1 >= 25u;
            restart = t2;
            s->tick = t2 ? 0u : t1;
        }
        if (restart) {
            {
                fitzhugh_nagumo_predictor *const predictor = &s->predictor[(s->oldest < 5u) ? s->oldest : 0u];
                /* the oldest predictor restarts from the estimate */
                predictor->z[0] = s->z[0];
                predictor->z[1] = s->z[1];
                predictor->z[2] = s->z[2];
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
            const float t1 = fitzhugh_nagumo_clamp((s->innovation
                - gamma_0)/fitzhugh_nagumo_max(p->gain.gamma_1 - gamma_0, 3.2e-07f), 0.0f, 1.0f);
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
                const float t1 = 0.01f*mu/p->gain.rise_time;
                const float t2 = 1.0f/theta;
                const float theta_1 = p->gain.theta_1;
                const float t3 = 1.0f/theta_1;
                const float t4 = fitzhugh_nagumo_max(t2 - t3, 0.0f);
                const float t5 = 2.0f*theta_1;
                const float t6 = t5 - fitzhugh_nagumo_max(theta, theta_1);
                const float risen = (t1 <= t4 && theta <= theta_1) ? 1.0f/fitzhugh_nagumo_max(t2 - t1, t3)
                    : t5 - t6/(1.0f + t6*(t1 - t4));
                const float decay = fitzhugh_nagumo_exp(-(0.01f*p->gain.rate*(1.0f - mu)));
                s->theta = fitzhugh_nagumo_clamp(1.0f + (risen - 1.0f)*decay, 1.0f, t5);
            }
        }
        /* is a value beyond its box, or lost? */
        {
            const float innovation = s->innovation;
            const float theta = s->theta;
            beyond = !(innovation >= 0.0f && innovation <= 1e+30f && theta >= 1.0f && theta <= 8.0f);
        }
        if (fitzhugh_nagumo_acts(beyond)) {
            status |= fitzhugh_nagumo_keep_in_box(s, p);
        }
    }
    return status;
}

/* nominal parameters */
FITZHUGH_NAGUMO_RARELY
static void fitzhugh_nagumo_nominal(fitzhugh_nagumo_params *p)
{
    p->ready = FITZHUGH_NAGUMO_READY;
    p->gain.Q[0] = 0.1f;
    p->gain.Q[1] = 0.01f;
    p->gain.Q[2] = 0.00023f;
    p->gain.R = 1.0f;
    p->gain.theta_1 = 4.0f;
    p->gain.rise_time = 0.1f;
    p->gain.rate = 1.0f;
    p->gain.gamma_0 = 0.16f;
    p->gain.gamma_1 = 0.32f;
}

unsigned fitzhugh_nagumo_predict(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    const fitzhugh_nagumo_input *in)
{
    unsigned status = 0u;
    if ((s->ready != FITZHUGH_NAGUMO_READY) || (p->ready != FITZHUGH_NAGUMO_READY)) {
        status = fitzhugh_nagumo_ready(s, p);
    }
    if ((status & FITZHUGH_NAGUMO_NO_PARAMETERS) == 0u) {
        status |= fitzhugh_nagumo_run_predict(s, p, in);
    }
    return status;
}

unsigned fitzhugh_nagumo_update_y(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    const fitzhugh_nagumo_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != FITZHUGH_NAGUMO_READY) || (p->ready != FITZHUGH_NAGUMO_READY)) {
        status = fitzhugh_nagumo_ready(s, p);
    }
    if ((status & FITZHUGH_NAGUMO_NO_PARAMETERS) == 0u) {
        status |= fitzhugh_nagumo_run_update_y(s, p, measurement);
    }
    return status;
}

unsigned fitzhugh_nagumo_adapt(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p)
{
    unsigned status = 0u;
    if ((s->ready != FITZHUGH_NAGUMO_READY) || (p->ready != FITZHUGH_NAGUMO_READY)) {
        status = fitzhugh_nagumo_ready(s, p);
    }
    if ((status & FITZHUGH_NAGUMO_NO_PARAMETERS) == 0u) {
        status |= fitzhugh_nagumo_run_adapt(s, p);
    }
    return status;
}

unsigned fitzhugh_nagumo_step(fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    const fitzhugh_nagumo_input *in, const fitzhugh_nagumo_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != FITZHUGH_NAGUMO_READY) || (p->ready != FITZHUGH_NAGUMO_READY)) {
        status = fitzhugh_nagumo_ready(s, p);
    }
    if ((status & FITZHUGH_NAGUMO_NO_PARAMETERS) == 0u) {
        status |= fitzhugh_nagumo_run_predict(s, p, in);
        status |= fitzhugh_nagumo_run_update_y(s, p, measurement);
        status |= fitzhugh_nagumo_run_adapt(s, p);
    }
    return status;
}

void fitzhugh_nagumo_estimate(const fitzhugh_nagumo_state *s, const fitzhugh_nagumo_params *p,
    fitzhugh_nagumo_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x1 = s->z[0];
    x->x2 = s->z[1];
    x->eta = -s->z[2];
}

unsigned fitzhugh_nagumo_tune(fitzhugh_nagumo_params *p)
{
    unsigned status = 0u;
    if (p->ready != FITZHUGH_NAGUMO_READY) {
        fitzhugh_nagumo_nominal(p);
        status = FITZHUGH_NAGUMO_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        static const struct {
            float low;
            float high;
            float nominal;
        } range[9] = {
            {2.3e-10f, 100000.0f, 0.1f}, /* p->gain.Q[0] */
            {2.3e-10f, 100000.0f, 0.01f}, /* p->gain.Q[1] */
            {2.3e-10f, 100000.0f, 0.00023f}, /* p->gain.Q[2] */
            {1e-06f, 1000000.0f, 1.0f}, /* p->gain.R */
            {1.0f, 4.0f, 4.0f}, /* p->gain.theta_1 */
            {0.0001f, 100.0f, 0.1f}, /* p->gain.rise_time */
            {0.0f, 1000.0f, 1.0f}, /* p->gain.rate */
            {0.0f, 320000.0f, 0.16f}, /* p->gain.gamma_0 */
            {0.0f, 320000.0f, 0.32f}, /* p->gain.gamma_1 */
        };
        float *const value[9] = {
            &p->gain.Q[0],
            &p->gain.Q[1],
            &p->gain.Q[2],
            &p->gain.R,
            &p->gain.theta_1,
            &p->gain.rise_time,
            &p->gain.rate,
            &p->gain.gamma_0,
            &p->gain.gamma_1
        };
        for (unsigned k = 0u; k < 9u; ++k) {
            const float v = *value[k];
            *value[k] = fitzhugh_nagumo_keep(v, range[k].low, range[k].high, range[k].nominal, 3e+38f);
            if (!(v >= range[k].low && v <= range[k].high)) {
                status |= FITZHUGH_NAGUMO_PARAMETER_LIMITED;
            }
        }
    }
    return status;
}

FITZHUGH_NAGUMO_RARELY
void fitzhugh_nagumo_reset(fitzhugh_nagumo_state *s)
{
    s->ready = FITZHUGH_NAGUMO_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->used_y = 1u;
    s->u = 0.0f;
    fitzhugh_nagumo_clear_fault_counts(s);
    fitzhugh_nagumo_clear_rest(s);
}

void fitzhugh_nagumo_init(fitzhugh_nagumo_state *s, fitzhugh_nagumo_params *p)
{
    fitzhugh_nagumo_nominal(p);
    (void)fitzhugh_nagumo_tune(p);
    fitzhugh_nagumo_reset(s);
}

static const unsigned char fitzhugh_nagumo_layout[8] = {
    0xEFu, 0xDCu, 0x3Cu, 0xE0u, 0xF0u, 0x93u, 0x83u, 0xC7u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t fitzhugh_nagumo_checksum(const unsigned char *bytes, size_t size)
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

void fitzhugh_nagumo_save(const fitzhugh_nagumo_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = fitzhugh_nagumo_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = fitzhugh_nagumo_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned fitzhugh_nagumo_restore(fitzhugh_nagumo_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == FITZHUGH_NAGUMO_SAVED) {
        refused = 0u;
        uint32_t sum = fitzhugh_nagumo_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == fitzhugh_nagumo_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = FITZHUGH_NAGUMO_READY;
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
