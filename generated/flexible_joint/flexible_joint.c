/* flexible_joint: see flexible_joint.h, which is the manual. */
#include "flexible_joint.h"

#include <stdbool.h>
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

/* of what runs rarely, which is no part of what calls it */
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

static float flexible_joint_max(float a, float b)
{
    return (a > b) ? a : b;
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

/* memory that neither init nor reset has made a state becomes one, which the status says */
static unsigned flexible_joint_ready(flexible_joint_state *s)
{
    unsigned status = 0u;
    if (s->ready != FLEXIBLE_JOINT_READY) {
        flexible_joint_reset(s);
        status = FLEXIBLE_JOINT_UNINITIALISED;
    }
    return status;
}

FLEXIBLE_JOINT_RARELY
static void flexible_joint_clear_doubt(flexible_joint_state *s)
{
    /* as after a reset */
    s->doubt_y = 0.0f;
    s->patience_y = 2303.0f;
    s->doubt_range = 0.0f;
    s->patience_range = 2303.0f;
    s->doubt_sum = 0.0f;
}

unsigned flexible_joint_step(flexible_joint_state *s, const flexible_joint_params *p,
    const flexible_joint_input *in, const flexible_joint_output *out)
{
    unsigned status = flexible_joint_ready(s);
    float ahead = 0.0f;
    bool beyond = false;
    bool doubtful = false;
    float fraction = 0.0f;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    bool running = false;
    bool sampled = false;
    float share = 0.0f;
    bool shows_range = false;
    bool shows_y = false;
    bool spoiled = false;
    float u = 0.0f;
    float valid = 0.0f;
    float y = 0.0f;
    float y_last = 0.0f;
    float z_at[4];
    float z_sum[4];
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = flexible_joint_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        u = flexible_joint_limit(u_taken, 50.0f);
        if (!u_usable) {
            status |= FLEXIBLE_JOINT_REUSED_U;
        }
        if (flexible_joint_abs(u_taken) > 50.0f) {
            status |= FLEXIBLE_JOINT_CLAMPED_U;
        }
    }
    /* guard the measurements */
    {
        const float measurement = out->y;
        const bool t1 = flexible_joint_within(measurement, 3e+38f);
        const float z1 = s->z[0];
        const bool t2 = t1 && flexible_joint_within(measurement, 9.0f)
            && flexible_joint_within(measurement - z1, 1e+16f);
        const float t3 = t2 ? measurement : z1;
        y = t3;
        y_last = (t2 && s->y_valid > 0.0f) ? s->y : t3;
        valid = t2 ? 1.0f : 0.0f;
        if (!t1) {
            status |= FLEXIBLE_JOINT_MISSING_Y;
        }
        if (t1 && !t2) {
            status |= FLEXIBLE_JOINT_REJECTED_Y;
        }
    }
    /* the first call advances no time */
    {
        const unsigned calls = s->calls;
        running = calls >= 1u;
        s->calls = 1u;
    }
    if (running) {
        /* z: one step of classical Runge-Kutta */
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
                    flexible_joint_rate(p, z_at1, z_at2, z_at3, z_at4, u_before + fraction*(u - u_before),
                        y_last + fraction*(y - y_last), valid, k_z);
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
            /* is a value lost? */
            {
                const bool t1 = flexible_joint_within(s->z[0], 1e+30f)
                    && flexible_joint_within(s->z[1], 1e+30f) && flexible_joint_within(s->z[2], 1e+30f);
                lost = !(t1 && flexible_joint_within(s->z[3], 1e+30f));
            }
            if (lost) {
                /* a value is lost: all restart */
                s->z[0] = 0.0f;
                s->z[1] = 0.0f;
                s->z[2] = 0.0f;
                s->z[3] = 0.0f;
                status |= FLEXIBLE_JOINT_RESTARTED;
                flexible_joint_clear_doubt(s);
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
        }
    }
    /* remember the input */
    s->u = u;
    /* remember the sample */
    s->y = y;
    s->y_valid = valid;
    /* is the estimate where it cannot be for long? */
    {
        const float z1 = s->z[0];
        const bool t1 = flexible_joint_abs(z1) > 3.0f || flexible_joint_abs(s->z[1]) > 10.0f
            || flexible_joint_abs(s->z[2]) > 4.0f;
        const bool t2 = t1 || flexible_joint_abs(s->z[3]) > 20.0f;
        if (t2) {
            status |= FLEXIBLE_JOINT_OUTSIDE_BOX;
        }
        doubtful = flexible_joint_abs(out->y - z1) > 0.6f || t2 || !(s->doubt_sum <= 0.0f) || !(valid > 0.0f);
    }
    if (doubtful) {
        /* is there a sample to judge by? */
        {
            const float measurement = out->y;
            sampled = valid > 0.0f || (flexible_joint_within(measurement, 3e+38f)
                && flexible_joint_within(measurement, 9.0f));
        }
        if (sampled) {
            /* was doubt or patience spoiled? */
            {
                const float doubt_y = s->doubt_y;
                const float patience_y = s->patience_y;
                const float doubt_range = s->doubt_range;
                const float patience_range = s->patience_range;
                const float t1 = flexible_joint_abs(patience_y - 2303.0f + doubt_y
                    + (patience_range - 2303.0f + doubt_range) - s->doubt_sum);
                const bool t2 = t1 < 0.5f && doubt_y >= 0.0f && doubt_y <= 2358272.0f
                    && patience_y >= 2303.0f && patience_y <= 2358272.0f;
                const bool t3 = t2 && doubt_range >= 0.0f && doubt_range <= 2358272.0f
                    && patience_range >= 2303.0f && patience_range <= 2358272.0f;
                spoiled = !t3;
            }
            if (spoiled) {
                flexible_joint_clear_doubt(s);
            }
            /* which signs show? */
            {
                const float z1 = s->z[0];
                const bool t1 = flexible_joint_abs(z1) > 3.3f || flexible_joint_abs(s->z[1]) > 11.0f
                    || flexible_joint_abs(s->z[2]) > 4.4f;
                shows_y = !flexible_joint_within(out->y - z1, 0.6f);
                shows_range = t1 || flexible_joint_abs(s->z[3]) > 22.0f;
            }
            if (shows_y) {
                /* more doubt */
                {
                    const float doubt_y = s->doubt_y;
                    s->doubt_y = flexible_joint_min(doubt_y + 1.0f, 2358272.0f);
                }
                /* is patience at its end? */
                over_y = s->patience_y <= s->doubt_y;
            } else {
                /* less doubt */
                {
                    const float doubt_y = s->doubt_y;
                    const float patience_y = s->patience_y;
                    s->doubt_y = flexible_joint_max(doubt_y - 1.0f, 0.0f);
                    s->patience_y = (doubt_y <= 1.0f) ? 2303.0f : patience_y;
                    over_y = false;
                }
            }
            if (shows_range) {
                /* more doubt */
                {
                    const float doubt_range = s->doubt_range;
                    s->doubt_range = flexible_joint_min(doubt_range + 1.0f, 2358272.0f);
                }
                /* is patience at its end? */
                over_range = s->patience_range <= s->doubt_range;
            } else {
                /* less doubt */
                {
                    const float doubt_range = s->doubt_range;
                    const float patience_range = s->patience_range;
                    s->doubt_range = flexible_joint_max(doubt_range - 1.0f, 0.0f);
                    s->patience_range = (doubt_range <= 1.0f) ? 2303.0f : patience_range;
                    over_range = false;
                }
            }
            /* is it lost? */
            lost = over_y || over_range;
            if (lost) {
                if (over_y) {
                    /* patience doubles */
                    {
                        const float patience_y = s->patience_y;
                        s->doubt_y = flexible_joint_min(patience_y, 1179136.0f);
                        s->patience_y = flexible_joint_min(2.0f*patience_y, 2358272.0f);
                    }
                }
                if (over_range) {
                    /* patience doubles */
                    {
                        const float patience_range = s->patience_range;
                        s->doubt_range = flexible_joint_min(patience_range, 1179136.0f);
                        s->patience_range = flexible_joint_min(2.0f*patience_range, 2358272.0f);
                    }
                }
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
                    s->z[0] = flexible_joint_keep(out->y, -3.0f, 3.0f, z1, 1e+30f);
                    s->z[1] = flexible_joint_keep(z2, -10.0f, 10.0f, z2, 1e+30f);
                    s->z[2] = flexible_joint_keep(z3, -4.0f, 4.0f, z3, 1e+30f);
                    s->z[3] = flexible_joint_keep(z4, -20.0f, 20.0f, z4, 1e+30f);
                }
                /* the estimate has restarted from the sample */
                status |= FLEXIBLE_JOINT_RESTARTED_FROM_SAMPLE;
            }
            /* remember what doubt and patience add up to */
            s->doubt_sum = s->patience_y - 2303.0f + s->doubt_y
                + (s->patience_range - 2303.0f + s->doubt_range);
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
    flexible_joint_clear_doubt(s);
}

void flexible_joint_init(flexible_joint_state *s, flexible_joint_params *p)
{
    p->gain.theta = 10.0f;
    (void)flexible_joint_tune(p);
    flexible_joint_reset(s);
}
