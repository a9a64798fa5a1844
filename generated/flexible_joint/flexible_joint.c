/* flexible_joint: see flexible_joint.h, and its manual flexible_joint.md. */
#include "flexible_joint.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(FLEXIBLE_JOINT_USE_LIBM)
#include <math.h>
#elif defined(FLEXIBLE_JOINT_USE_CMSIS)
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
#define FLEXIBLE_JOINT_RARELY __attribute__((noinline))
#else
#define FLEXIBLE_JOINT_RARELY
#endif

static float flexible_joint_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float flexible_joint_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool flexible_joint_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float flexible_joint_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool flexible_joint_within(float v, float limit)
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
static float flexible_joint_limit(float v, float most)
{
    return flexible_joint_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float flexible_joint_keep(float v, float low, float high, float otherwise, float limit)
{
    return flexible_joint_within(v, limit) ? flexible_joint_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define FLEXIBLE_JOINT_USE_LIBM for those of <math.h>, or FLEXIBLE_JOINT_USE_CMSIS for CMSIS-DSP. */
#if defined(FLEXIBLE_JOINT_USE_LIBM)
static float flexible_joint_small_sin(float x)
{
    return sinf(x);
}

#elif defined(FLEXIBLE_JOINT_USE_CMSIS)
static float flexible_joint_small_sin(float x)
{
    return arm_sin_f32(x);
}

#else
static float flexible_joint_small_sin(float x)
{
    const float t1 = flexible_joint_within(x, 1.5707964f) ? x
        : ((x > 0.0f) ? 3.1415927f - x - 8.742278e-08f : -3.1415927f - x + 8.742278e-08f);
    const float t2 = t1*t1;
    return t1 + t1*(((2.606055e-06f*t2 - 0.00019809768f)*t2 + 0.008333069f)*t2 - 0.1666666f)*t2;
}
#endif

/* the right-hand side of the observer's differential equation */
static void flexible_joint_rate(const flexible_joint_params *p, float z1, float z2, float z3, float z4,
    float u, float y, float valid, float dz[4])
{
    const float t1 = valid*(y - z1);
    const float t2 = flexible_joint_limit(z1, 3.0f);
    dz[0] = z2 + p->derived.K[0]*t1;
    dz[1] = 35.0f*z3 + p->derived.K[1]*t1 - (35.0f*t2 + 20.0f*flexible_joint_small_sin(t2));
    dz[2] = z4 + p->derived.K[2]*t1;
    dz[3] = u + 50.0f*t2 - 50.0f*flexible_joint_limit(z3, 4.0f) - flexible_joint_limit(z4, 20.0f)
        + p->derived.K[3]*t1;
}

/* memory without its mark is not used: the state begins anew, which the status says */
FLEXIBLE_JOINT_RARELY
static unsigned flexible_joint_ready(flexible_joint_state *s, const flexible_joint_params *p)
{
    unsigned status = 0u;
    if (s->ready != FLEXIBLE_JOINT_READY) {
        flexible_joint_reset(s);
        status |= FLEXIBLE_JOINT_UNINITIALISED;
    }
    if (p->ready != FLEXIBLE_JOINT_READY) {
        flexible_joint_reset(s);
        status |= FLEXIBLE_JOINT_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
FLEXIBLE_JOINT_RARELY
static void flexible_joint_clear_fault_counts(flexible_joint_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 2303.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 2303.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned flexible_joint_keep_in_box(flexible_joint_state *s, const flexible_joint_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = flexible_joint_within(s->z[0], 1e+30f) && flexible_joint_within(s->z[1], 1e+30f)
            && flexible_joint_within(s->z[2], 1e+30f);
        lost = !(t1 && flexible_joint_within(s->z[3], 1e+30f));
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        status |= FLEXIBLE_JOINT_RESTARTED;
        flexible_joint_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        const bool t1 = flexible_joint_abs(z1) > 9.0f || flexible_joint_abs(z2) > 100.0f
            || flexible_joint_abs(z3) > 400.0f;
        s->z[0] = flexible_joint_limit(z1, 9.0f);
        s->z[1] = flexible_joint_limit(z2, 100.0f);
        s->z[2] = flexible_joint_limit(z3, 400.0f);
        s->z[3] = flexible_joint_limit(z4, 20000.0f);
        if (t1 || flexible_joint_abs(z4) > 20000.0f) {
            status |= FLEXIBLE_JOINT_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
FLEXIBLE_JOINT_RARELY
static void flexible_joint_nominal(flexible_joint_params *p)
{
    p->ready = FLEXIBLE_JOINT_READY;
    p->gain.theta = 10.0f;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned flexible_joint_guard_input(const flexible_joint_state *s, const flexible_joint_input *in,
    float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = flexible_joint_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = flexible_joint_limit(u_taken, 50.0f);
        if (!u_usable) {
            status |= FLEXIBLE_JOINT_REUSED_U;
        }
        if (flexible_joint_abs(u_taken) > 50.0f) {
            status |= FLEXIBLE_JOINT_CLAMPED_U;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned flexible_joint_guard_measurements(const flexible_joint_state *s,
    const flexible_joint_output *measurement, float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = flexible_joint_within(reading, 9.0f) && flexible_joint_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = flexible_joint_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && flexible_joint_within(y_before, 9.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= FLEXIBLE_JOINT_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= FLEXIBLE_JOINT_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned flexible_joint_advance(flexible_joint_state *s, const flexible_joint_params *p, float u,
    float valid, float y, float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[4];
    float z_sum[4];
    /* z: one step of classical Runge-Kutta */
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
    z_sum[2] = 0.0f;
    z_sum[3] = 0.0f;
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
    z_at[2] = s->z[2];
    z_at[3] = s->z[3];
    {
        static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
        static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
        static const float each_ahead[4] = {0.0005f, 0.0005f, 0.001f, 0.0f};
        for (unsigned r = 0u; r < 4u; ++r) {
            fraction = each_fraction[r];
            share = each_share[r];
            ahead = each_ahead[r];
            /* a stage */
            {
                const float z_at1 = z_at[0];
                const float z_at2 = z_at[1];
                const float z_at3 = z_at[2];
                const float z_at4 = z_at[3];
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float z_sum3 = z_sum[2];
                const float z_sum4 = z_sum[3];
                const float u_before = s->u;
                float k_z[4];
                flexible_joint_rate(p, z_at1, z_at2, z_at3, z_at4, u_before + fraction*(u - u_before), y_last
                    + fraction*(y - y_last), valid, k_z);
                z_sum[0] = z_sum1 + share*k_z[0];
                z_sum[1] = z_sum2 + share*k_z[1];
                z_sum[2] = z_sum3 + share*k_z[2];
                z_sum[3] = z_sum4 + share*k_z[3];
                z_at[0] = s->z[0] + ahead*k_z[0];
                z_at[1] = s->z[1] + ahead*k_z[1];
                z_at[2] = s->z[2] + ahead*k_z[2];
                z_at[3] = s->z[3] + ahead*k_z[3];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const float z4 = s->z[3];
        s->z[0] = z1 + 0.00016666666f*z_sum[0];
        s->z[1] = z2 + 0.00016666666f*z_sum[1];
        s->z[2] = z3 + 0.00016666666f*z_sum[2];
        s->z[3] = z4 + 0.00016666666f*z_sum[3];
    }
    /* is a value beyond its box, or lost? */
    {
        const bool t1 = flexible_joint_within(s->z[0], 9.0f) && flexible_joint_within(s->z[1], 100.0f)
            && flexible_joint_within(s->z[2], 400.0f);
        beyond = !(t1 && flexible_joint_within(s->z[3], 20000.0f));
    }
    if (flexible_joint_acts(beyond)) {
        status |= flexible_joint_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned flexible_joint_suspect(const flexible_joint_state *s,
    const flexible_joint_output *measurement, bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = flexible_joint_abs(z1) > 3.0f || flexible_joint_abs(s->z[1]) > 10.0f
            || flexible_joint_abs(s->z[2]) > 4.0f;
        const bool t2 = t1 || flexible_joint_abs(s->z[3]) > 20.0f;
        if (t2) {
            status |= FLEXIBLE_JOINT_OUTSIDE_BOX;
        }
        *suspect = flexible_joint_abs(measurement->y - z1) > 0.6f || t2 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool flexible_joint_counts_spoiled(const flexible_joint_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 2303.0f + flexible_joint_abs(fault_count_y)
            + (fault_limit_range - 2303.0f + fault_count_range);
        const bool t2 = flexible_joint_abs(t1 - s->fault_checksum) < 0.5f
            && flexible_joint_within(fault_count_y, 2358272.0f);
        const bool t3 = t2 && fault_limit_y >= 2303.0f && fault_limit_y <= 2358272.0f
            && fault_count_range >= 0.0f && fault_count_range <= 2358272.0f;
        spoiled = !(t3 && fault_limit_range >= 2303.0f && fault_limit_range <= 2358272.0f);
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void flexible_joint_find_signs(const flexible_joint_state *s,
    const flexible_joint_output *measurement, float *moves_y, float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = flexible_joint_within(t1, 0.6f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -179.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned flexible_joint_recover(flexible_joint_state *s, const flexible_joint_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= flexible_joint_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = flexible_joint_abs(s->z[0]) > 6.0f || flexible_joint_abs(s->z[1]) > 20.0f
            || flexible_joint_abs(s->z[2]) > 8.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && (fault_limit_range > 2303.0f || t3 || flexible_joint_abs(s->z[3]) > 40.0f));
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = flexible_joint_min(fault_limit_y, 1179136.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = flexible_joint_min(2.0f*fault_limit_y, 2358272.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = flexible_joint_min(fault_limit_range, 1179136.0f);
            s->fault_limit_range = flexible_joint_min(2.0f*fault_limit_range, 2358272.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        s->z[3] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = flexible_joint_keep(measurement->y, -3.0f, 3.0f, z1, 1e+30f);
            s->z[1] = flexible_joint_keep(z2, -10.0f, 10.0f, z2, 1e+30f);
            s->z[2] = flexible_joint_keep(z3, -4.0f, 4.0f, z3, 1e+30f);
            s->z[3] = flexible_joint_keep(z4, -20.0f, 20.0f, z4, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= FLEXIBLE_JOINT_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const float z4 = s->z[3];
            s->z[0] = flexible_joint_limit(z1, 3.0f);
            s->z[1] = flexible_joint_limit(z2, 10.0f);
            s->z[2] = flexible_joint_limit(z3, 4.0f);
            s->z[3] = flexible_joint_limit(z4, 20.0f);
            status |= FLEXIBLE_JOINT_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned flexible_joint_count_faults(flexible_joint_state *s, const flexible_joint_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = flexible_joint_counts_spoiled(s);
    if (spoiled) {
        flexible_joint_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const bool t1 = flexible_joint_abs(s->z[0]) > 3.3f || flexible_joint_abs(s->z[1]) > 11.0f
            || flexible_joint_abs(s->z[2]) > 4.4f;
        moves_range = (t1 || flexible_joint_abs(s->z[3]) > 22.0f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = flexible_joint_clamp(fault_count_range + moves_range, 0.0f, 2358272.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 2303.0f : fault_limit_range;
    }
    flexible_joint_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = flexible_joint_clamp(flexible_joint_abs(fault_count_y) + moves_y, 0.0f, 2358272.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 2303.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= flexible_joint_abs(s->fault_count_y)
        || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= flexible_joint_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 2303.0f + flexible_joint_abs(s->fault_count_y)
        + (s->fault_limit_range - 2303.0f + s->fault_count_range);
    return status;
}

unsigned flexible_joint_step(flexible_joint_state *s, const flexible_joint_params *p,
    const flexible_joint_input *in, const flexible_joint_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != FLEXIBLE_JOINT_READY) || (p->ready != FLEXIBLE_JOINT_READY)) {
        status = flexible_joint_ready(s, p);
    }
    if ((status & FLEXIBLE_JOINT_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float u = 0.0f;
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        /* keep u in its box */
        {
            const float u_before = s->u;
            s->u = flexible_joint_limit(u_before, 50.0f);
        }
        status |= flexible_joint_guard_input(s, in, &u);
        status |= flexible_joint_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= flexible_joint_advance(s, p, u, valid, y, y_last);
        } else {
            status |= flexible_joint_keep_in_box(s, p);
        }
        /* remember the input */
        s->u = u;
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= flexible_joint_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || flexible_joint_within(measurement->y, 9.0f);
            if (sampled) {
                status |= flexible_joint_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void flexible_joint_estimate(const flexible_joint_state *s, const flexible_joint_params *p,
    flexible_joint_plant *x)
{
    (void)p;
    /* the plant's state */
    x->q = s->z[0];
    x->p = s->z[1];
    x->r = s->z[2];
    x->s = s->z[3];
}

unsigned flexible_joint_tune(flexible_joint_params *p)
{
    unsigned status = 0u;
    if (p->ready != FLEXIBLE_JOINT_READY) {
        flexible_joint_nominal(p);
        status = FLEXIBLE_JOINT_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = flexible_joint_keep(theta, 1.0f, 10.0f, 10.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 10.0f)) {
            status |= FLEXIBLE_JOINT_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        const float t1 = theta*theta;
        const float t2 = t1*theta;
        p->derived.K[0] = 4.0f*theta;
        p->derived.K[1] = 6.0f*t1;
        p->derived.K[2] = 0.114285715f*t2;
        p->derived.K[3] = t2*theta*0.028571429f;
    }
    return status;
}

FLEXIBLE_JOINT_RARELY
void flexible_joint_reset(flexible_joint_state *s)
{
    s->ready = FLEXIBLE_JOINT_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->z[3] = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    flexible_joint_clear_fault_counts(s);
}

void flexible_joint_init(flexible_joint_state *s, flexible_joint_params *p)
{
    flexible_joint_nominal(p);
    (void)flexible_joint_tune(p);
    flexible_joint_reset(s);
}

static const unsigned char flexible_joint_layout[8] = {
    0x87u, 0x9Cu, 0xB9u, 0x87u, 0x23u, 0x49u, 0x86u, 0x45u
};

/* CRC-32 of IEEE 802.3 */
static uint32_t flexible_joint_checksum(const unsigned char *bytes, size_t size)
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

void flexible_joint_save(const flexible_joint_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = flexible_joint_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = flexible_joint_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned flexible_joint_restore(flexible_joint_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == FLEXIBLE_JOINT_SAVED) {
        refused = 0u;
        uint32_t sum = flexible_joint_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == flexible_joint_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = FLEXIBLE_JOINT_READY;
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
