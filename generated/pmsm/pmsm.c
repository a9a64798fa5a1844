/* pmsm: see pmsm.h, and its manual pmsm.md. */
#include "pmsm.h"

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
#define PMSM_RARELY __attribute__((noinline))
#else
#define PMSM_RARELY
#endif

static float pmsm_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float pmsm_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool pmsm_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float pmsm_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool pmsm_within(float v, float limit)
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
static float pmsm_limit(float v, float most)
{
    return pmsm_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float pmsm_keep(float v, float low, float high, float otherwise, float limit)
{
    return pmsm_within(v, limit) ? pmsm_clamp(v, low, high) : otherwise;
}

/* the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant */
static void pmsm_flow(float z1, float z2, float z3, float u1, float u2, float dz[3])
{
    const float t1 = pmsm_limit(z3, 300.0f);
    dz[0] = u1 + pmsm_limit(z2, 20.0f)*t1 - 200.0f*z1;
    dz[1] = -200.0f*z2 - 30.0f*z3 + (u2 - pmsm_limit(z1, 20.0f)*t1);
    dz[2] = 500.0f*z2 - 0.5f*z3;
}

/* the entries of the flow's Jacobian that are not constant, by columns */
static void pmsm_jacobian(float z1, float z2, float z3, float F[4])
{
    const float t1 = pmsm_limit(z3, 300.0f);
    F[0] = -t1; /* F_21 */
    F[1] = t1; /* F_12 */
    F[2] = pmsm_limit(z2, 20.0f); /* F_13 */
    F[3] = -30.0f - pmsm_limit(z1, 20.0f); /* F_23 */
}

/* memory without its mark is not used: the state begins anew, which the status says */
PMSM_RARELY
static uint32_t pmsm_ready(pmsm_state *s, const pmsm_params *p)
{
    uint32_t status = 0u;
    if (s->ready != PMSM_READY) {
        pmsm_reset(s);
        status |= PMSM_UNINITIALISED;
    }
    if (p->ready != PMSM_READY) {
        pmsm_reset(s);
        status |= PMSM_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
PMSM_RARELY
static void pmsm_clear_fault_counts(pmsm_state *s)
{
    /* as after a reset */
    s->fault_count_y_y1 = 0.0f;
    s->fault_limit_y_y1 = 126.0f;
    s->fault_count_y_y2 = 0.0f;
    s->fault_limit_y_y2 = 126.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 251.0f;
    s->fault_checksum = 0.0f;
}

/* set what the observer remembers besides the estimate as after a reset */
PMSM_RARELY
static void pmsm_clear_rest(pmsm_state *s)
{
    /* as after a reset */
    s->L[0] = 0.0f;
    s->L[1] = 0.0f;
    s->L[2] = 0.0f;
    s->D[0] = 400.0f;
    s->D[1] = 400.0f;
    s->D[2] = 90000.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static uint32_t pmsm_keep_in_box(pmsm_state *s, const pmsm_params *p)
{
    uint32_t status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = pmsm_within(s->z[0], 1e+30f) && pmsm_within(s->z[1], 1e+30f)
            && pmsm_within(s->z[2], 1e+30f) && pmsm_within(s->L[0], 1e+30f);
        const bool t2 = t1 && pmsm_within(s->L[1], 1e+30f) && pmsm_within(s->L[2], 1e+30f)
            && pmsm_within(s->D[0], 1e+30f);
        lost = !(t2 && pmsm_within(s->D[1], 1e+30f) && pmsm_within(s->D[2], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= PMSM_RESTARTED;
        pmsm_clear_fault_counts(s);
        pmsm_clear_rest(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = pmsm_limit(z1, 60.0f);
        s->z[1] = pmsm_limit(z2, 60.0f);
        s->z[2] = pmsm_limit(z3, 900.0f);
        if (pmsm_abs(z1) > 60.0f || pmsm_abs(z2) > 60.0f || pmsm_abs(z3) > 900.0f) {
            status |= PMSM_STATE_LIMITED;
        }
    }
    /* keep L in its box */
    {
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        s->L[0] = pmsm_limit(L21, 1e+09f);
        s->L[1] = pmsm_limit(L31, 1.5e+10f);
        s->L[2] = pmsm_limit(L32, 1.5e+10f);
    }
    /* keep D in its box */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        s->D[0] = pmsm_clamp(D1, 1e-16f, 3600.0f);
        s->D[1] = pmsm_clamp(D2, 8e-16f, 3600.0f);
        s->D[2] = pmsm_clamp(D3, 2e-13f, 810000.0f);
    }
    return status;
}

/* part of a step: check the fault counts, and count the range */
static uint32_t pmsm_count_range(pmsm_state *s, const pmsm_params *p)
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
        const float t1 = fault_limit_y_y1 - 126.0f + pmsm_abs(fault_count_y_y1)
            + (fault_limit_y_y2 - 126.0f + pmsm_abs(fault_count_y_y2));
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = pmsm_abs(fault_limit_range - 251.0f + fault_count_range + t1
            - s->fault_checksum) < 0.5f && pmsm_within(fault_count_y_y1, 129024.0f);
        const bool t3 = t2 && fault_limit_y_y1 >= 126.0f && fault_limit_y_y1 <= 129024.0f
            && pmsm_within(fault_count_y_y2, 129024.0f);
        const bool t4 = t3 && fault_limit_y_y2 >= 126.0f && fault_limit_y_y2 <= 129024.0f
            && fault_count_range >= 0.0f && fault_count_range <= 257024.0f;
        spoiled = !(t4 && fault_limit_range >= 251.0f && fault_limit_range <= 257024.0f);
    }
    if (spoiled) {
        pmsm_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    moves_range = (pmsm_abs(s->z[0]) > 22.0f || pmsm_abs(s->z[1]) > 22.0f || pmsm_abs(s->z[2]) > 330.0f)
        ? 1.0f : -1.0f;
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = pmsm_clamp(fault_count_range + moves_range, 0.0f, 257024.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 251.0f : fault_limit_range;
    }
    return status;
}

/* part of a step: project the estimate onto its declared ranges */
static uint32_t pmsm_project_onto_ranges(pmsm_state *s, const pmsm_params *p)
{
    uint32_t status = 0u;
    (void)p;
    /* the estimate back onto its declared ranges */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float L31 = s->L[1];
        const float D1 = s->D[0];
        const float t1 = L31*D1;
        const float t2 = z1 - pmsm_limit(z1, 20.0f);
        const float t3 = t2/D1;
        const float L21 = s->L[0];
        const float L32 = s->L[2];
        const float D2 = s->D[1];
        const float t4 = L32*D2;
        const float t5 = L21*D1;
        const float t6 = z2 - t5*t3;
        const float t7 = t6 - pmsm_limit(t6, 20.0f);
        const float t8 = t7/(t5*L21 + D2);
        const float t9 = z3 - t1*t3 - (t1*L21 + t4)*t8;
        const float t10 = t9 - pmsm_limit(t9, 300.0f);
        const float t11 = t9 - t10 - z3;
        const float t12 = (t11 > 0.0f) ? 900.0f - z3 : z3 + 900.0f;
        const float t13 = t10/(t1*L31 + t4*L32 + s->D[2]);
        const float t14 = t6 - t7 - (t5*L31 + D2*L32)*t13 - z2;
        const float t15 = (t14 > 0.0f) ? 60.0f - z2 : z2 + 60.0f;
        const float t16 = z1 - t2 - D1*L21*t8 - D1*L31*t13 - z1;
        const float t17 = (t16 > 0.0f) ? 60.0f - z1 : z1 + 60.0f;
        const float t18 = pmsm_abs(t16);
        const float t19 = (t17 < t18) ? t17/t18 : 1.0f;
        const float t20 = pmsm_abs(t14);
        const float t21 = (t15 < t19*t20) ? t15/t20 : t19;
        const float t22 = pmsm_abs(t11);
        const float t23 = (t12 < t21*t22) ? t12/t22 : t21;
        s->z[0] = pmsm_keep(z1 + t23*t16, -60.0f, 60.0f, z1, 1e+30f);
        s->z[1] = pmsm_keep(z2 + t23*t14, -60.0f, 60.0f, z2, 1e+30f);
        s->z[2] = pmsm_keep(z3 + t23*t11, -900.0f, 900.0f, z3, 1e+30f);
        status |= PMSM_PROJECTED_ONTO_RANGES;
    }
    return status;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static uint32_t pmsm_guard_input(const pmsm_state *s, const pmsm_input *in, float *u)
{
    uint32_t status = 0u;
    /* guard the input */
    {
        const float vd = in->vd;
        const bool vd_usable = pmsm_within(vd, 1e+15f);
        const float vd_taken = vd_usable ? vd : s->u[0];
        const float vq = in->vq;
        const bool vq_usable = pmsm_within(vq, 1e+15f);
        const float vq_taken = vq_usable ? vq : s->u[1];
        u[0] = pmsm_limit(vd_taken, 5000.0f);
        u[1] = pmsm_limit(vq_taken, 5000.0f);
        if (!vd_usable) {
            status |= PMSM_REUSED_VD;
        }
        if (pmsm_abs(vd_taken) > 5000.0f) {
            status |= PMSM_CLAMPED_VD;
        }
        if (!vq_usable) {
            status |= PMSM_REUSED_VQ;
        }
        if (pmsm_abs(vq_taken) > 5000.0f) {
            status |= PMSM_CLAMPED_VQ;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static uint32_t pmsm_advance(pmsm_state *s, const pmsm_params *p, const float *u)
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
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        float k1_z[3];
        pmsm_flow(z1, z2, z3, u_before1, u_before2, k1_z);
        const float u1 = u[0];
        const float t1 = u_before1 + 0.5f*(u1 - u_before1);
        const float u2 = u[1];
        const float t2 = u_before2 + 0.5f*(u2 - u_before2);
        float k2_z[3];
        pmsm_flow(z1 + 5e-05f*k1_z[0], z2 + 5e-05f*k1_z[1], z3 + 5e-05f*k1_z[2], t1, t2, k2_z);
        const float t3 = z1 + 5e-05f*k2_z[0];
        const float t4 = z2 + 5e-05f*k2_z[1];
        const float t5 = z3 + 5e-05f*k2_z[2];
        float k3_z[3];
        pmsm_flow(t3, t4, t5, t1, t2, k3_z);
        float k4_z[3];
        pmsm_flow(z1 + 0.0001f*k3_z[0], z2 + 0.0001f*k3_z[1], z3 + 0.0001f*k3_z[2], u1, u2, k4_z);
        float F_1[4];
        pmsm_jacobian(t3, t4, t5, F_1);
        const float Phi_11 = 0.98f + 5e-09f*(40000.0f + F_1[1]*F_1[0]);
        const float Phi_12 = 0.0001f*F_1[1] + 5e-09f*(500.0f*F_1[2] - 400.0f*F_1[1]);
        const float Phi_13 = 0.0001f*F_1[2] + 5e-09f*(F_1[1]*F_1[3] - 200.0f*F_1[2] - 0.5f*F_1[2]);
        const float Phi_21 = 0.0001f*F_1[0] - 2e-06f*F_1[0];
        const float t6 = 500.0f*F_1[3];
        const float Phi_22 = 0.98f + 5e-09f*(F_1[0]*F_1[1] + 40000.0f + t6);
        const float Phi_23 = 0.0001f*F_1[3] + 5e-09f*(F_1[0]*F_1[2] - 200.0f*F_1[3] - 0.5f*F_1[3]);
        const float Phi_31 = 2.5e-06f*F_1[0];
        const float Phi_33 = 0.99995f + 5e-09f*(t6 + 0.25f);
        const float w1_1 = Phi_11 + Phi_12*L21 + Phi_13*L31;
        const float w1_2 = Phi_12 + Phi_13*L32;
        const float t7 = w1_1*D1;
        const float t8 = w1_2*D2;
        const float t9 = Phi_13*D3;
        const float t10 = 0.0001f*p->gain.Q[0];
        const float d1 = w1_1*t7 + w1_2*t8 + Phi_13*t9 + t10;
        const float t11 = Phi_21 + Phi_22*L21 + Phi_23*L31;
        const float t12 = Phi_22 + Phi_23*L32;
        const float l21 = (t11*t7 + t12*t8 + Phi_23*t9)/d1;
        const float t13 = Phi_31 + 0.04949875f*L21 + Phi_33*L31;
        const float t14 = 0.04949875f + Phi_33*L32;
        const float l31 = (t13*t7 + t14*t8 + Phi_33*t9)/d1;
        const float w2_1 = t11 - l21*w1_1;
        const float w2_2 = t12 - l21*w1_2;
        const float w2_3 = Phi_23 - l21*Phi_13;
        const float t15 = w2_1*D1;
        const float t16 = w2_2*D2;
        const float t17 = w2_3*D3;
        const float t18 = l21*t10;
        const float t19 = 0.0001f*p->gain.Q[1];
        const float d2 = w2_1*t15 + w2_2*t16 + w2_3*t17 + l21*t18 + t19;
        const float t20 = t13 - l31*w1_1;
        const float t21 = t14 - l31*w1_2;
        const float t22 = Phi_33 - l31*Phi_13;
        const float l32 = (t20*t15 + t21*t16 + t22*t17 + l31*t18)/d2;
        const float w3_1 = t20 - l32*w2_1;
        const float w3_2 = t21 - l32*w2_2;
        const float w3_3 = t22 - l32*w2_3;
        const float w3_4 = l32*l21 - l31;
        const float d3 = w3_1*D1*w3_1 + w3_2*D2*w3_2 + w3_3*D3*w3_3 + w3_4*t10*w3_4 + l32*t19*l32
            + 0.0001f*p->gain.Q[2];
        s->z[0] = z1 + 1.6666667e-05f*(k1_z[0] + 2.0f*k2_z[0] + 2.0f*k3_z[0] + k4_z[0]);
        s->z[1] = z2 + 1.6666667e-05f*(k1_z[1] + 2.0f*k2_z[1] + 2.0f*k3_z[1] + k4_z[1]);
        s->z[2] = z3 + 1.6666667e-05f*(k1_z[2] + 2.0f*k2_z[2] + 2.0f*k3_z[2] + k4_z[2]);
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
        capped = D1 > 3600.0f || L21*L21*D1 + D2 > 3600.0f || L31*L31*D1 + L32*L32*D2 + s->D[2] > 810000.0f;
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
            const float t1 = pmsm_min(1.0f, 3600.0f/(L21*L21*D1 + D2));
            const float t2 = pmsm_min(1.0f, 3600.0f/D1);
            const float t3 = pmsm_min(1.0f, 810000.0f/(L31*L31*D1 + L32*L32*D2 + D3));
            s->L[0] = t1*L21/t2;
            s->L[1] = t3*L31/t2;
            s->L[2] = t3*L32/t1;
            s->D[0] = t2*t2*D1;
            s->D[1] = t1*t1*D2;
            s->D[2] = t3*t3*D3;
            status |= PMSM_COVARIANCE_LIMITED;
        }
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = pmsm_within(s->z[0], 60.0f) && pmsm_within(s->z[1], 60.0f)
            && pmsm_within(s->z[2], 900.0f) && pmsm_within(s->L[0], 1e+09f);
        const float D1 = s->D[0];
        const bool t2 = t1 && pmsm_within(s->L[1], 1.5e+10f) && pmsm_within(s->L[2], 1.5e+10f)
            && D1 >= 1e-16f && D1 <= 3600.0f;
        const float D2 = s->D[1];
        const float D3 = s->D[2];
        beyond = !(t2 && D2 >= 8e-16f && D2 <= 3600.0f && D3 >= 2e-13f && D3 <= 810000.0f);
    }
    if (pmsm_acts(beyond)) {
        status |= pmsm_keep_in_box(s, p);
    }
    return status;
}

/* part of a step: advance the estimate to now */
static uint32_t pmsm_run_predict(pmsm_state *s, const pmsm_params *p, const pmsm_input *in)
{
    uint32_t status = 0u;
    bool running = false;
    float u[2];
    /* keep u in its box */
    {
        const float u_before1 = s->u[0];
        const float u_before2 = s->u[1];
        s->u[0] = pmsm_limit(u_before1, 5000.0f);
        s->u[1] = pmsm_limit(u_before2, 5000.0f);
    }
    status |= pmsm_guard_input(s, in, u);
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        status |= pmsm_advance(s, p, u);
    } else {
        status |= pmsm_keep_in_box(s, p);
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
static uint32_t pmsm_guard_measurement_y1(const pmsm_state *s, float *e, float *output_error, float reading,
    bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y1 */
    {
        const float t1 = reading - s->z[0];
        const bool t2 = pmsm_within(reading, 60.0f) && pmsm_within(t1, 1e+16f);
        const bool t3 = pmsm_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= PMSM_MISSING_Y1;
        }
        if (t3 && !t2) {
            status |= PMSM_REJECTED_Y1;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t pmsm_use_sample_y1(pmsm_state *s, const pmsm_params *p, float e)
{
    uint32_t status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float t1 = p->gain.R[0]/0.0001f;
        const float K1 = D1/(t1 + D1);
        const float K2 = L21*K1;
        const float K3 = L31*K1;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->D[0] = K1*t1;
    }
    /* is a value beyond its box, or lost? */
    {
        const float D1 = s->D[0];
        const bool t1 = pmsm_within(s->z[0], 60.0f) && pmsm_within(s->z[1], 60.0f)
            && pmsm_within(s->z[2], 900.0f) && D1 >= 1e-16f && D1 <= 3600.0f;
        beyond = !t1;
    }
    if (pmsm_acts(beyond)) {
        status |= pmsm_keep_in_box(s, p);
    }
    /* y1 is used */
    s->used_y1 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static bool pmsm_suspect_y1(const pmsm_state *s, float output_error, bool valid)
{
    bool suspect = false;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = pmsm_abs(output_error) > 4.0f || pmsm_abs(s->z[0]) > 20.0f
            || pmsm_abs(s->z[1]) > 20.0f || pmsm_abs(s->z[2]) > 300.0f;
        suspect = t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return suspect;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void pmsm_find_signs_y1(const pmsm_state *s, float *moves_y_y1, float output_error, float *side_y_y1)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = pmsm_within(output_error, 4.0f);
        const float fault_count_y_y1 = s->fault_count_y_y1;
        *moves_y_y1 = (t1 ? 0.0f : ((fault_count_y_y1*output_error < 0.0f) ? -63.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y1 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y1 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t pmsm_recover_y1(pmsm_state *s, const pmsm_params *p, float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y1 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y1 <= pmsm_abs(s->fault_count_y_y1);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = fault_limit_range > 251.0f || pmsm_abs(s->z[0]) > 40.0f || pmsm_abs(s->z[1]) > 40.0f
            || pmsm_abs(s->z[2]) > 600.0f;
        over_y_y1 = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y_y1) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y1 = s->fault_count_y_y1;
            const float fault_limit_y_y1 = s->fault_limit_y_y1;
            const float t1 = pmsm_min(fault_limit_y_y1, 64512.0f);
            s->fault_count_y_y1 = (fault_count_y_y1 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y1 = pmsm_min(2.0f*fault_limit_y_y1, 129024.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = pmsm_min(fault_limit_range, 128512.0f);
            s->fault_limit_range = pmsm_min(2.0f*fault_limit_range, 257024.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        /* from the sample of y1 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = pmsm_keep(reading, -20.0f, 20.0f, z1, 1e+30f);
            s->z[1] = pmsm_keep(z2, -20.0f, 20.0f, z2, 1e+30f);
            s->z[2] = pmsm_keep(z3, -300.0f, 300.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= PMSM_RESTARTED_FROM_SAMPLE;
        pmsm_clear_rest(s);
    } else {
        status |= pmsm_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y1 */
static uint32_t pmsm_run_update_y1(pmsm_state *s, const pmsm_params *p, const pmsm_output *measurement)
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
        status |= pmsm_guard_measurement_y1(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= pmsm_use_sample_y1(s, p, e);
        }
        suspect = pmsm_suspect_y1(s, output_error, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || pmsm_within(reading, 60.0f);
            if (sampled) {
                status |= pmsm_count_range(s, p);
                pmsm_find_signs_y1(s, &moves_y_y1, output_error, &side_y_y1);
                /* count of y_y1 */
                {
                    const float fault_count_y_y1 = s->fault_count_y_y1;
                    const float fault_limit_y_y1 = s->fault_limit_y_y1;
                    const float t1 = pmsm_clamp(pmsm_abs(fault_count_y_y1) + moves_y_y1, 0.0f, 129024.0f);
                    s->fault_count_y_y1 = (side_y_y1 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y1 = (t1 <= 0.0f) ? 126.0f : fault_limit_y_y1;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y1 <= pmsm_abs(s->fault_count_y_y1)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= pmsm_recover_y1(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 126.0f + pmsm_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 126.0f + pmsm_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 251.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= PMSM_OUT_OF_ORDER;
    }
    return status;
}

/* is the sample a number, plausible, and not absurdly far from its estimate? */
static uint32_t pmsm_guard_measurement_y2(const pmsm_state *s, float *e, float *output_error, float reading,
    bool *valid)
{
    uint32_t status = 0u;
    /* guard the measurement of y2 */
    {
        const float t1 = reading - s->z[1];
        const bool t2 = pmsm_within(reading, 60.0f) && pmsm_within(t1, 1e+16f);
        const bool t3 = pmsm_within(reading, 3e+38f);
        *e = t1;
        *output_error = t1;
        *valid = t2;
        if (!t3) {
            status |= PMSM_MISSING_Y2;
        }
        if (t3 && !t2) {
            status |= PMSM_REJECTED_Y2;
        }
    }
    return status;
}

/* correct the estimate with a sample that can be used */
static uint32_t pmsm_use_sample_y2(pmsm_state *s, const pmsm_params *p, float e)
{
    uint32_t status = 0u;
    bool beyond = false;
    /* correct by the scalar update */
    {
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const float L21 = s->L[0];
        const float L31 = s->L[1];
        const float L32 = s->L[2];
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float t1 = D1*L21;
        const float t2 = p->gain.R[1]/0.0001f;
        const float t3 = t2 + D2;
        const float t4 = t3 + t1*L21;
        const float K1 = t1/t4;
        const float K2 = (D2 + L21*t1)/t4;
        const float t5 = L32*D2;
        const float K3 = (t5 + L31*t1)/t4;
        s->z[0] = z1 + K1*e;
        s->z[1] = z2 + K2*e;
        s->z[2] = z3 + K3*e;
        s->L[0] = L21 - L21*D2/t3;
        s->L[1] = L31 - L21*t5/t3;
        s->D[0] = D1*t3/t4;
        s->D[1] = D2*t2/t3;
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = pmsm_within(s->z[0], 60.0f) && pmsm_within(s->z[1], 60.0f)
            && pmsm_within(s->z[2], 900.0f) && pmsm_within(s->L[0], 1e+09f);
        const float D1 = s->D[0];
        const float D2 = s->D[1];
        const bool t2 = t1 && pmsm_within(s->L[1], 1.5e+10f) && D1 >= 1e-16f && D1 <= 3600.0f && D2 >= 8e-16f
            && D2 <= 3600.0f;
        beyond = !t2;
    }
    if (pmsm_acts(beyond)) {
        status |= pmsm_keep_in_box(s, p);
    }
    /* y2 is used */
    s->used_y2 = 1u;
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static uint32_t pmsm_suspect_y2(const pmsm_state *s, float output_error, bool *suspect, bool valid)
{
    uint32_t status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const bool t1 = pmsm_abs(s->z[0]) > 20.0f || pmsm_abs(s->z[1]) > 20.0f || pmsm_abs(s->z[2]) > 300.0f;
        if (t1) {
            status |= PMSM_OUTSIDE_BOX;
        }
        *suspect = pmsm_abs(output_error) > 4.0f || t1 || !(s->fault_checksum <= 0.0f) || !valid;
    }
    return status;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void pmsm_find_signs_y2(const pmsm_state *s, float *moves_y_y2, float output_error, float *side_y_y2)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const bool t1 = pmsm_within(output_error, 4.0f);
        const float fault_count_y_y2 = s->fault_count_y_y2;
        *moves_y_y2 = (t1 ? 0.0f : ((fault_count_y_y2*output_error < 0.0f) ? -63.0f : 1.0f))
            + (t1 ? -1.0f : 0.0f);
        *side_y_y2 = (t1 ? 0.0f : output_error) + (t1 ? fault_count_y_y2 : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static uint32_t pmsm_recover_y2(pmsm_state *s, const pmsm_params *p, float reading)
{
    uint32_t status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y_y2 = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y_y2 <= pmsm_abs(s->fault_count_y_y2);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = fault_limit_range > 251.0f || pmsm_abs(s->z[0]) > 40.0f || pmsm_abs(s->z[1]) > 40.0f
            || pmsm_abs(s->z[2]) > 600.0f;
        over_y_y2 = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y_y2) {
        /* the fault limit doubles */
        {
            const float fault_count_y_y2 = s->fault_count_y_y2;
            const float fault_limit_y_y2 = s->fault_limit_y_y2;
            const float t1 = pmsm_min(fault_limit_y_y2, 64512.0f);
            s->fault_count_y_y2 = (fault_count_y_y2 < 0.0f) ? -t1 : t1;
            s->fault_limit_y_y2 = pmsm_min(2.0f*fault_limit_y_y2, 129024.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = pmsm_min(fault_limit_range, 128512.0f);
            s->fault_limit_range = pmsm_min(2.0f*fault_limit_range, 257024.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        /* from the sample of y2 */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = pmsm_keep(z1, -20.0f, 20.0f, z1, 1e+30f);
            s->z[1] = pmsm_keep(reading, -20.0f, 20.0f, z2, 1e+30f);
            s->z[2] = pmsm_keep(z3, -300.0f, 300.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= PMSM_RESTARTED_FROM_SAMPLE;
        pmsm_clear_rest(s);
    } else {
        status |= pmsm_project_onto_ranges(s, p);
    }
    return status;
}

/* part of a step: correct with y2 */
static uint32_t pmsm_run_update_y2(pmsm_state *s, const pmsm_params *p, const pmsm_output *measurement)
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
        status |= pmsm_guard_measurement_y2(s, &e, &output_error, reading, &valid);
        if (valid) {
            status |= pmsm_use_sample_y2(s, p, e);
        }
        status |= pmsm_suspect_y2(s, output_error, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid || pmsm_within(reading, 60.0f);
            if (sampled) {
                status |= pmsm_count_range(s, p);
                pmsm_find_signs_y2(s, &moves_y_y2, output_error, &side_y_y2);
                /* count of y_y2 */
                {
                    const float fault_count_y_y2 = s->fault_count_y_y2;
                    const float fault_limit_y_y2 = s->fault_limit_y_y2;
                    const float t1 = pmsm_clamp(pmsm_abs(fault_count_y_y2) + moves_y_y2, 0.0f, 129024.0f);
                    s->fault_count_y_y2 = (side_y_y2 < 0.0f) ? -t1 : t1;
                    s->fault_limit_y_y2 = (t1 <= 0.0f) ? 126.0f : fault_limit_y_y2;
                }
                /* is a fault count at its limit? */
                acts = s->fault_limit_y_y2 <= pmsm_abs(s->fault_count_y_y2)
                    || s->fault_limit_range <= s->fault_count_range;
                if (acts) {
                    status |= pmsm_recover_y2(s, p, reading);
                }
                /* the checksum of fault counts and limits */
                {
                    const float t1 = s->fault_limit_y_y1 - 126.0f + pmsm_abs(s->fault_count_y_y1)
                        + (s->fault_limit_y_y2 - 126.0f + pmsm_abs(s->fault_count_y_y2));
                    s->fault_checksum = s->fault_limit_range - 251.0f + s->fault_count_range + t1;
                }
            }
        }
    } else {
        /* there was no predict since the last */
        status |= PMSM_OUT_OF_ORDER;
    }
    return status;
}

/* nominal parameters */
PMSM_RARELY
static void pmsm_nominal(pmsm_params *p)
{
    p->ready = PMSM_READY;
    p->gain.Q[0] = 8.0f;
    p->gain.Q[1] = 8.0f;
    p->gain.Q[2] = 2000.0f;
    p->gain.R[0] = 1e-08f;
    p->gain.R[1] = 1e-08f;
}

uint32_t pmsm_predict(pmsm_state *s, const pmsm_params *p, const pmsm_input *in)
{
    uint32_t status = 0u;
    if ((s->ready != PMSM_READY) || (p->ready != PMSM_READY)) {
        status = pmsm_ready(s, p);
    }
    if ((status & PMSM_NO_PARAMETERS) == 0u) {
        status |= pmsm_run_predict(s, p, in);
    }
    return status;
}

uint32_t pmsm_update_y1(pmsm_state *s, const pmsm_params *p, const pmsm_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != PMSM_READY) || (p->ready != PMSM_READY)) {
        status = pmsm_ready(s, p);
    }
    if ((status & PMSM_NO_PARAMETERS) == 0u) {
        status |= pmsm_run_update_y1(s, p, measurement);
    }
    return status;
}

uint32_t pmsm_update_y2(pmsm_state *s, const pmsm_params *p, const pmsm_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != PMSM_READY) || (p->ready != PMSM_READY)) {
        status = pmsm_ready(s, p);
    }
    if ((status & PMSM_NO_PARAMETERS) == 0u) {
        status |= pmsm_run_update_y2(s, p, measurement);
    }
    return status;
}

uint32_t pmsm_step(pmsm_state *s, const pmsm_params *p, const pmsm_input *in, const pmsm_output *measurement)
{
    uint32_t status = 0u;
    if ((s->ready != PMSM_READY) || (p->ready != PMSM_READY)) {
        status = pmsm_ready(s, p);
    }
    if ((status & PMSM_NO_PARAMETERS) == 0u) {
        status |= pmsm_run_predict(s, p, in);
        status |= pmsm_run_update_y1(s, p, measurement);
        status |= pmsm_run_update_y2(s, p, measurement);
    }
    return status;
}

void pmsm_estimate(const pmsm_state *s, const pmsm_params *p, pmsm_plant *x)
{
    (void)p;
    /* the plant's state */
    x->i_d = s->z[0];
    x->i_q = s->z[1];
    x->w = s->z[2];
}

uint32_t pmsm_tune(pmsm_params *p)
{
    uint32_t status = 0u;
    if (p->ready != PMSM_READY) {
        pmsm_nominal(p);
        status = PMSM_NO_PARAMETERS;
    }
    /* each parameter in its range */
    {
        const float Q1 = p->gain.Q[0];
        const float Q2 = p->gain.Q[1];
        const float Q3 = p->gain.Q[2];
        const float R1 = p->gain.R[0];
        const float R2 = p->gain.R[1];
        const bool t1 = !(Q1 >= 8e-06f && Q1 <= 2e+09f) || !(Q2 >= 8e-06f && Q2 <= 2e+09f)
            || !(Q3 >= 8e-06f && Q3 <= 2e+09f);
        p->gain.Q[0] = pmsm_keep(Q1, 8e-06f, 2e+09f, 8.0f, 3e+38f);
        p->gain.Q[1] = pmsm_keep(Q2, 8e-06f, 2e+09f, 8.0f, 3e+38f);
        p->gain.Q[2] = pmsm_keep(Q3, 8e-06f, 2e+09f, 2000.0f, 3e+38f);
        p->gain.R[0] = pmsm_keep(R1, 1e-14f, 0.01f, 1e-08f, 3e+38f);
        p->gain.R[1] = pmsm_keep(R2, 1e-14f, 0.01f, 1e-08f, 3e+38f);
        if (t1 || !(R1 >= 1e-14f && R1 <= 0.01f) || !(R2 >= 1e-14f && R2 <= 0.01f)) {
            status |= PMSM_PARAMETER_LIMITED;
        }
    }
    return status;
}

PMSM_RARELY
void pmsm_reset(pmsm_state *s)
{
    s->ready = PMSM_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->used_y1 = 1u;
    s->used_y2 = 1u;
    s->u[0] = 0.0f;
    s->u[1] = 0.0f;
    pmsm_clear_fault_counts(s);
    pmsm_clear_rest(s);
}

void pmsm_init(pmsm_state *s, pmsm_params *p)
{
    pmsm_nominal(p);
    (void)pmsm_tune(p);
    pmsm_reset(s);
}

static const unsigned char pmsm_layout[8] = {0xA3u, 0xDFu, 0xD7u, 0xA6u, 0x12u, 0x67u, 0x5Au, 0x5Bu};

/* CRC-32 of IEEE 802.3 */
static uint32_t pmsm_checksum(const unsigned char *bytes, size_t size)
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

void pmsm_save(const pmsm_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = pmsm_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = pmsm_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned pmsm_restore(pmsm_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == PMSM_SAVED) {
        refused = 0u;
        uint32_t sum = pmsm_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == pmsm_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = PMSM_READY;
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
