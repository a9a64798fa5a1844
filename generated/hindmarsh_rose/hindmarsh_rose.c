/* hindmarsh_rose: see hindmarsh_rose.h, which is the manual. */
#include "hindmarsh_rose.h"

#include <stdbool.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "needs IEEE 754 comparisons: -ffast-math drops the guards against what is not a number"
#endif
#if defined(__ASSOCIATIVE_MATH__)
#error "needs sums in their order: -funsafe-math-optimizations spoils the bundled functions"
#endif

/* of what runs rarely, which is no part of what calls it */
#if defined(__GNUC__)
#define HINDMARSH_ROSE_RARELY __attribute__((noinline))
#else
#define HINDMARSH_ROSE_RARELY
#endif

static float hindmarsh_rose_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float hindmarsh_rose_min(float a, float b)
{
    return (a < b) ? a : b;
}

static float hindmarsh_rose_max(float a, float b)
{
    return (a > b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool hindmarsh_rose_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float hindmarsh_rose_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool hindmarsh_rose_within(float v, float limit)
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

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float hindmarsh_rose_keep(float v, float low, float high, float otherwise, float limit)
{
    return hindmarsh_rose_within(v, limit) ? hindmarsh_rose_clamp(v, low, high) : otherwise;
}

/* the right-hand side of the observer's differential equation */
static void hindmarsh_rose_rate(const hindmarsh_rose_params *p, float z1, float z2, float z3, float u,
    float y, float valid, float dz[3])
{
    const float t1 = hindmarsh_rose_clamp(z1, -2.0f, 3.0f);
    const float t2 = t1*t1;
    const float t3 = t2*t1;
    const float t4 = 3.0f*t2;
    const float K1 = p->derived.K[0];
    const float t5 = valid*(y - z1);
    const float t6 = 6.0f*t1;
    const float t7 = t4 - t6 + 0.006f;
    const float t8 = t6 - t4;
    const float t9 = t8 - 1.0f;
    const float t10 = t7 + t9;
    const float K2 = p->derived.K[1];
    const float t11 = hindmarsh_rose_clamp(z2, -20.0f, 2.0f);
    const float t12 = hindmarsh_rose_clamp(z3, 0.0f, 5.0f);
    const float t13 = 6.0f*u - u*t1*6.0f + t2*t2*15.0f - 60.0f*t3 + 54.0f*t2 - t1*t11*6.0f + t1*t12*6.0f
        - 10.0f*t1;
    const float t14 = t13 + 6.0f*t11 - 6.0f*t12 - 0.024f;
    const float t15 = p->derived.K[2]/t10;
    dz[0] = z2 - z3 + (u - t3 + t4) + K1*t5;
    dz[1] = 1.0f - 5.0f*t2 - z2 + (t7/t10*K2 - (t8*t7 + t14)/t10*K1 + t15)*t5;
    dz[2] = 0.024f*z1 - 0.006f*z3 + 0.0384f + ((t8*t9 - t14)/t10*K1 - t9/t10*K2 + t15)*t5;
}

/* memory that neither init nor reset has made a state becomes one, which the status says */
static unsigned hindmarsh_rose_ready(hindmarsh_rose_state *s)
{
    unsigned status = 0u;
    if (s->ready != HINDMARSH_ROSE_READY) {
        hindmarsh_rose_reset(s);
        status = HINDMARSH_ROSE_UNINITIALISED;
    }
    return status;
}

HINDMARSH_ROSE_RARELY
static void hindmarsh_rose_clear_doubt(hindmarsh_rose_state *s)
{
    /* as after a reset */
    s->doubt_y = 0.0f;
    s->patience_y = 1101.0f;
    s->doubt_range = 0.0f;
    s->patience_range = 1101.0f;
    s->doubt_sum = 0.0f;
}

unsigned hindmarsh_rose_step(hindmarsh_rose_state *s, const hindmarsh_rose_params *p,
    const hindmarsh_rose_input *in, const hindmarsh_rose_output *out)
{
    unsigned status = hindmarsh_rose_ready(s);
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
    float z_at[3];
    float z_sum[3];
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = hindmarsh_rose_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        u = hindmarsh_rose_clamp(u_taken, 0.0f, 4.0f);
        if (!u_usable) {
            status |= HINDMARSH_ROSE_REUSED_U;
        }
        if (u_taken < 0.0f || u_taken > 4.0f) {
            status |= HINDMARSH_ROSE_CLAMPED_U;
        }
    }
    /* guard the measurements */
    {
        const float measurement = out->y;
        const bool t1 = hindmarsh_rose_within(measurement, 3e+38f);
        const float z1 = s->z[0];
        const bool t2 = t1 && measurement >= -7.0f && measurement <= 8.0f
            && hindmarsh_rose_within(measurement - z1, 1e+16f);
        const float t3 = t2 ? measurement : z1;
        y = t3;
        y_last = (t2 && s->y_valid > 0.0f) ? s->y : t3;
        valid = t2 ? 1.0f : 0.0f;
        if (!t1) {
            status |= HINDMARSH_ROSE_MISSING_Y;
        }
        if (t1 && !t2) {
            status |= HINDMARSH_ROSE_REJECTED_Y;
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
        z_at[0] = s->z[0];
        z_at[1] = s->z[1];
        z_at[2] = s->z[2];
        {
            static const float each_fraction[4] = {0.0f, 0.5f, 0.5f, 1.0f};
            static const float each_share[4] = {1.0f, 2.0f, 2.0f, 1.0f};
            static const float each_ahead[4] = {0.0025f, 0.0025f, 0.005f, 0.0f};
            for (unsigned r = 0u; r < 4u; ++r) {
                fraction = each_fraction[r];
                share = each_share[r];
                ahead = each_ahead[r];
                /* a stage */
                {
                    const float z_at1 = z_at[0];
                    const float z_at2 = z_at[1];
                    const float z_at3 = z_at[2];
                    const float z_sum1 = z_sum[0];
                    const float z_sum2 = z_sum[1];
                    const float z_sum3 = z_sum[2];
                    const float u_before = s->u;
                    float k_z[3];
                    hindmarsh_rose_rate(p, z_at1, z_at2, z_at3, u_before + fraction*(u - u_before), y_last
                        + fraction*(y - y_last), valid, k_z);
                    z_sum[0] = z_sum1 + share*k_z[0];
                    z_sum[1] = z_sum2 + share*k_z[1];
                    z_sum[2] = z_sum3 + share*k_z[2];
                    z_at[0] = s->z[0] + ahead*k_z[0];
                    z_at[1] = s->z[1] + ahead*k_z[1];
                    z_at[2] = s->z[2] + ahead*k_z[2];
                }
            }
        }
        /* the slopes of all stages */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = z1 + 0.00083333335f*z_sum[0];
            s->z[1] = z2 + 0.00083333335f*z_sum[1];
            s->z[2] = z3 + 0.00083333335f*z_sum[2];
        }
        /* is a value beyond its box, or lost? */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            const bool t1 = z1 >= -249.5f && z1 <= 250.5f && z2 >= -1109.0f && z2 <= 1091.0f && z3 >= -247.5f
                && z3 <= 252.5f;
            beyond = !t1;
        }
        if (hindmarsh_rose_acts(beyond)) {
            /* is a value lost? */
            {
                const bool t1 = hindmarsh_rose_within(s->z[0], 1e+30f)
                    && hindmarsh_rose_within(s->z[1], 1e+30f) && hindmarsh_rose_within(s->z[2], 1e+30f);
                lost = !t1;
            }
            if (lost) {
                /* a value is lost: all restart */
                s->z[0] = 0.0f;
                s->z[1] = 0.0f;
                s->z[2] = 0.0f;
                status |= HINDMARSH_ROSE_RESTARTED;
                hindmarsh_rose_clear_doubt(s);
            }
            /* keep z in its box */
            {
                const float z1 = s->z[0];
                const float z2 = s->z[1];
                const float z3 = s->z[2];
                s->z[0] = hindmarsh_rose_clamp(z1, -249.5f, 250.5f);
                s->z[1] = hindmarsh_rose_clamp(z2, -1109.0f, 1091.0f);
                s->z[2] = hindmarsh_rose_clamp(z3, -247.5f, 252.5f);
                if (z1 < -249.5f || z1 > 250.5f || z2 < -1109.0f || z2 > 1091.0f || z3 < -247.5f
                    || z3 > 252.5f) {
                    status |= HINDMARSH_ROSE_STATE_LIMITED;
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
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        const bool t1 = z1 < -2.0f || z1 > 3.0f || z2 < -20.0f || z2 > 2.0f || z3 < 0.0f || z3 > 5.0f;
        if (t1) {
            status |= HINDMARSH_ROSE_OUTSIDE_BOX;
        }
        doubtful = hindmarsh_rose_abs(out->y - z1) > 0.5f || t1 || !(s->doubt_sum <= 0.0f) || !(valid > 0.0f);
    }
    if (doubtful) {
        /* is there a sample to judge by? */
        {
            const float measurement = out->y;
            sampled = valid > 0.0f || (hindmarsh_rose_within(measurement, 3e+38f) && measurement >= -7.0f
                && measurement <= 8.0f);
        }
        if (sampled) {
            /* was doubt or patience spoiled? */
            {
                const float doubt_y = s->doubt_y;
                const float patience_y = s->patience_y;
                const float doubt_range = s->doubt_range;
                const float patience_range = s->patience_range;
                const float t1 = hindmarsh_rose_abs(patience_y - 1101.0f + doubt_y
                    + (patience_range - 1101.0f + doubt_range) - s->doubt_sum);
                const bool t2 = t1 < 0.5f && doubt_y >= 0.0f && doubt_y <= 1127424.0f
                    && patience_y >= 1101.0f && patience_y <= 1127424.0f;
                const bool t3 = t2 && doubt_range >= 0.0f && doubt_range <= 1127424.0f
                    && patience_range >= 1101.0f && patience_range <= 1127424.0f;
                spoiled = !t3;
            }
            if (spoiled) {
                hindmarsh_rose_clear_doubt(s);
            }
            /* which signs show? */
            {
                const float z1 = s->z[0];
                const float z2 = s->z[1];
                const float z3 = s->z[2];
                shows_y = !hindmarsh_rose_within(out->y - z1, 0.5f);
                shows_range = z1 < -2.25f || z1 > 3.25f || z2 < -21.1f || z2 > 3.1f || z3 < -0.25f
                    || z3 > 5.25f;
            }
            if (shows_y) {
                /* more doubt */
                {
                    const float doubt_y = s->doubt_y;
                    s->doubt_y = hindmarsh_rose_min(doubt_y + 1.0f, 1127424.0f);
                }
                /* is patience at its end? */
                over_y = s->patience_y <= s->doubt_y;
            } else {
                /* less doubt */
                {
                    const float doubt_y = s->doubt_y;
                    const float patience_y = s->patience_y;
                    s->doubt_y = hindmarsh_rose_max(doubt_y - 1.0f, 0.0f);
                    s->patience_y = (doubt_y <= 1.0f) ? 1101.0f : patience_y;
                    over_y = false;
                }
            }
            if (shows_range) {
                /* more doubt */
                {
                    const float doubt_range = s->doubt_range;
                    s->doubt_range = hindmarsh_rose_min(doubt_range + 1.0f, 1127424.0f);
                }
                /* is patience at its end? */
                over_range = s->patience_range <= s->doubt_range;
            } else {
                /* less doubt */
                {
                    const float doubt_range = s->doubt_range;
                    const float patience_range = s->patience_range;
                    s->doubt_range = hindmarsh_rose_max(doubt_range - 1.0f, 0.0f);
                    s->patience_range = (doubt_range <= 1.0f) ? 1101.0f : patience_range;
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
                        s->doubt_y = hindmarsh_rose_min(patience_y, 563712.0f);
                        s->patience_y = hindmarsh_rose_min(2.0f*patience_y, 1127424.0f);
                    }
                }
                if (over_range) {
                    /* patience doubles */
                    {
                        const float patience_range = s->patience_range;
                        s->doubt_range = hindmarsh_rose_min(patience_range, 563712.0f);
                        s->patience_range = hindmarsh_rose_min(2.0f*patience_range, 1127424.0f);
                    }
                }
                /* the estimate restarts */
                s->z[0] = 0.0f;
                s->z[1] = 0.0f;
                s->z[2] = 0.0f;
                /* from the sample of y */
                {
                    const float z1 = s->z[0];
                    const float z2 = s->z[1];
                    const float z3 = s->z[2];
                    s->z[0] = hindmarsh_rose_keep(out->y, -2.0f, 3.0f, z1, 1e+30f);
                    s->z[1] = hindmarsh_rose_keep(z2, -20.0f, 2.0f, z2, 1e+30f);
                    s->z[2] = hindmarsh_rose_keep(z3, 0.0f, 5.0f, z3, 1e+30f);
                }
                /* the estimate has restarted from the sample */
                status |= HINDMARSH_ROSE_RESTARTED_FROM_SAMPLE;
            }
            /* remember what doubt and patience add up to */
            s->doubt_sum = s->patience_y - 1101.0f + s->doubt_y
                + (s->patience_range - 1101.0f + s->doubt_range);
        }
    }
    return status;
}

void hindmarsh_rose_estimate(const hindmarsh_rose_state *s, const hindmarsh_rose_params *p,
    hindmarsh_rose_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->w = s->z[1];
    x->z = s->z[2];
}

unsigned hindmarsh_rose_tune(hindmarsh_rose_params *p)
{
    unsigned status = 0u;
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = hindmarsh_rose_keep(theta, 1.0f, 10.0f, 10.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 10.0f)) {
            status |= HINDMARSH_ROSE_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        const float t1 = theta*theta;
        p->derived.K[0] = 3.0f*theta;
        p->derived.K[1] = 3.0f*t1;
        p->derived.K[2] = t1*theta;
    }
    return status;
}

HINDMARSH_ROSE_RARELY
void hindmarsh_rose_reset(hindmarsh_rose_state *s)
{
    s->ready = HINDMARSH_ROSE_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    hindmarsh_rose_clear_doubt(s);
}

void hindmarsh_rose_init(hindmarsh_rose_state *s, hindmarsh_rose_params *p)
{
    p->gain.theta = 10.0f;
    (void)hindmarsh_rose_tune(p);
    hindmarsh_rose_reset(s);
}
