/* pendulum: see pendulum.h, and its manual pendulum.md. */
#include "pendulum.h"

#include <stdbool.h>
#include <stdint.h>
#if defined(PENDULUM_USE_LIBM)
#include <math.h>
#elif defined(PENDULUM_USE_CMSIS)
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
#define PENDULUM_RARELY __attribute__((noinline))
#else
#define PENDULUM_RARELY
#endif

static float pendulum_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float pendulum_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool pendulum_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float pendulum_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool pendulum_within(float v, float limit)
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
static float pendulum_limit(float v, float most)
{
    return pendulum_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float pendulum_keep(float v, float low, float high, float otherwise, float limit)
{
    return pendulum_within(v, limit) ? pendulum_clamp(v, low, high) : otherwise;
}

/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.
 * Define PENDULUM_USE_LIBM for those of <math.h>, or PENDULUM_USE_CMSIS for CMSIS-DSP. */
#if defined(PENDULUM_USE_LIBM)
static float pendulum_small_sin(float x)
{
    return sinf(x);
}

#elif defined(PENDULUM_USE_CMSIS)
static float pendulum_small_sin(float x)
{
    return arm_sin_f32(x);
}

#else
static float pendulum_small_sin(float x)
{
    const float t1 = pendulum_within(x, 1.5707964f) ? x : ((x > 0.0f) ? 3.1415927f - x - 8.742278e-08f
        : -3.1415927f - x + 8.742278e-08f);
    const float t2 = t1*t1;
    return t1 + t1*(((2.606055e-06f*t2 - 0.00019809768f)*t2 + 0.008333069f)*t2 - 0.1666666f)*t2;
}
#endif

/* the right-hand side of the observer's differential equation */
static void pendulum_rate(const pendulum_params *p, float z1, float z2, float u, float y, float valid,
    float dz[2])
{
    const float t1 = valid*(y - z1);
    dz[0] = z2 + p->derived.K[0]*t1;
    dz[1] = u - 0.1f*pendulum_limit(z2, 20.0f) - 19.6f*pendulum_small_sin(pendulum_limit(z1, 4.0f))
        + p->derived.K[1]*t1;
}

/* memory without its mark is not used: the state begins anew, which the status says */
PENDULUM_RARELY
static unsigned pendulum_ready(pendulum_state *s, const pendulum_params *p)
{
    unsigned status = 0u;
    if (s->ready != PENDULUM_READY) {
        pendulum_reset(s);
        status |= PENDULUM_UNINITIALISED;
    }
    if (p->ready != PENDULUM_READY) {
        pendulum_reset(s);
        status |= PENDULUM_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
PENDULUM_RARELY
static void pendulum_clear_fault_counts(pendulum_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 761.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 761.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned pendulum_keep_in_box(pendulum_state *s, const pendulum_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    lost = !(pendulum_within(s->z[0], 1e+30f) && pendulum_within(s->z[1], 1e+30f));
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        status |= PENDULUM_RESTARTED;
        pendulum_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = pendulum_limit(z1, 12.0f);
        s->z[1] = pendulum_limit(z2, 400.0f);
        if (pendulum_abs(z1) > 12.0f || pendulum_abs(z2) > 400.0f) {
            status |= PENDULUM_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
PENDULUM_RARELY
static void pendulum_nominal(pendulum_params *p)
{
    p->ready = PENDULUM_READY;
    p->gain.theta = 20.0f;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned pendulum_guard_input(const pendulum_state *s, const pendulum_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float tau = in->tau;
        const bool tau_usable = pendulum_within(tau, 1e+15f);
        const float tau_taken = tau_usable ? tau : s->u;
        *u = pendulum_limit(tau_taken, 1.0f);
        if (!tau_usable) {
            status |= PENDULUM_REUSED_TAU;
        }
        if (pendulum_abs(tau_taken) > 1.0f) {
            status |= PENDULUM_CLAMPED_TAU;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned pendulum_guard_measurements(const pendulum_state *s, const pendulum_output *measurement,
    float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = pendulum_within(reading, 12.0f) && pendulum_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = pendulum_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && pendulum_within(y_before, 12.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= PENDULUM_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= PENDULUM_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned pendulum_advance(pendulum_state *s, const pendulum_params *p, float u, float valid, float y,
    float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[2];
    float z_sum[2];
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
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
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
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float u_before = s->u;
                float k_z[2];
                pendulum_rate(p, z_at1, z_at2, u_before + fraction*(u - u_before), y_last
                    + fraction*(y - y_last), valid, k_z);
                z_sum[0] = z_sum1 + share*k_z[0];
                z_sum[1] = z_sum2 + share*k_z[1];
                z_at[0] = s->z[0] + ahead*k_z[0];
                z_at[1] = s->z[1] + ahead*k_z[1];
            }
        }
    }
    /* the slopes of all stages */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = z1 + 0.00016666666f*z_sum[0];
        s->z[1] = z2 + 0.00016666666f*z_sum[1];
    }
    /* is a value beyond its box, or lost? */
    beyond = !(pendulum_within(s->z[0], 12.0f) && pendulum_within(s->z[1], 400.0f));
    if (pendulum_acts(beyond)) {
        status |= pendulum_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned pendulum_suspect(const pendulum_state *s, const pendulum_output *measurement, bool *suspect,
    float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = pendulum_abs(z1) > 4.0f || pendulum_abs(s->z[1]) > 20.0f;
        if (t1) {
            status |= PENDULUM_OUTSIDE_BOX;
        }
        *suspect = pendulum_abs(measurement->y - z1) > 0.8f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool pendulum_counts_spoiled(const pendulum_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 761.0f + pendulum_abs(fault_count_y)
            + (fault_limit_range - 761.0f + fault_count_range);
        const bool t2 = pendulum_abs(t1 - s->fault_checksum) < 0.5f
            && pendulum_within(fault_count_y, 779264.0f) && fault_limit_y >= 761.0f
                && fault_limit_y <= 779264.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 779264.0f
            && fault_limit_range >= 761.0f && fault_limit_range <= 779264.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void pendulum_find_signs(const pendulum_state *s, const pendulum_output *measurement, float *moves_y,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = pendulum_within(t1, 0.8f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -280.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned pendulum_recover(pendulum_state *s, const pendulum_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= pendulum_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = t2 && (fault_limit_range > 761.0f || pendulum_abs(s->z[0]) > 8.0f
            || pendulum_abs(s->z[1]) > 40.0f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = pendulum_min(fault_limit_y, 389632.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = pendulum_min(2.0f*fault_limit_y, 779264.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = pendulum_min(fault_limit_range, 389632.0f);
            s->fault_limit_range = pendulum_min(2.0f*fault_limit_range, 779264.0f);
        }
    }
    if (lost) {
        /* the estimate restarts */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        /* from the sample of y */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = pendulum_keep(measurement->y, -4.0f, 4.0f, z1, 1e+30f);
            s->z[1] = pendulum_keep(z2, -20.0f, 20.0f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= PENDULUM_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = pendulum_limit(z1, 4.0f);
            s->z[1] = pendulum_limit(z2, 20.0f);
            status |= PENDULUM_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned pendulum_count_faults(pendulum_state *s, const pendulum_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = pendulum_counts_spoiled(s);
    if (spoiled) {
        pendulum_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    moves_range = (pendulum_abs(s->z[0]) > 4.4f || pendulum_abs(s->z[1]) > 22.0f) ? 1.0f : -1.0f;
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = pendulum_clamp(fault_count_range + moves_range, 0.0f, 779264.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 761.0f : fault_limit_range;
    }
    pendulum_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = pendulum_clamp(pendulum_abs(fault_count_y) + moves_y, 0.0f, 779264.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 761.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= pendulum_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= pendulum_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 761.0f + pendulum_abs(s->fault_count_y)
        + (s->fault_limit_range - 761.0f + s->fault_count_range);
    return status;
}

unsigned pendulum_step(pendulum_state *s, const pendulum_params *p, const pendulum_input *in,
    const pendulum_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != PENDULUM_READY) || (p->ready != PENDULUM_READY)) {
        status = pendulum_ready(s, p);
    }
    if ((status & PENDULUM_NO_PARAMETERS) == 0u) {
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
            s->u = pendulum_limit(u_before, 1.0f);
        }
        status |= pendulum_guard_input(s, in, &u);
        status |= pendulum_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= pendulum_advance(s, p, u, valid, y, y_last);
        } else {
            status |= pendulum_keep_in_box(s, p);
        }
        /* remember the input */
        s->u = u;
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= pendulum_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || pendulum_within(measurement->y, 12.0f);
            if (sampled) {
                status |= pendulum_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void pendulum_estimate(const pendulum_state *s, const pendulum_params *p, pendulum_plant *x)
{
    (void)p;
    /* the plant's state */
    x->q = s->z[0];
    x->w = s->z[1];
}

unsigned pendulum_tune(pendulum_params *p)
{
    unsigned status = 0u;
    if (p->ready != PENDULUM_READY) {
        pendulum_nominal(p);
        status = PENDULUM_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = pendulum_keep(theta, 1.0f, 20.0f, 20.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 20.0f)) {
            status |= PENDULUM_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        p->derived.K[0] = 2.0f*theta;
        p->derived.K[1] = theta*theta;
    }
    return status;
}

PENDULUM_RARELY
void pendulum_reset(pendulum_state *s)
{
    s->ready = PENDULUM_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    pendulum_clear_fault_counts(s);
}

void pendulum_init(pendulum_state *s, pendulum_params *p)
{
    pendulum_nominal(p);
    (void)pendulum_tune(p);
    pendulum_reset(s);
}

static const unsigned char pendulum_layout[8] = {0x9Au, 0x62u, 0x81u, 0xFDu, 0x4Bu, 0xC3u, 0x41u, 0xC1u};

/* CRC-32 of IEEE 802.3 */
static uint32_t pendulum_checksum(const unsigned char *bytes, size_t size)
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

void pendulum_save(const pendulum_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = pendulum_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = pendulum_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned pendulum_restore(pendulum_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == PENDULUM_SAVED) {
        refused = 0u;
        uint32_t sum = pendulum_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == pendulum_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = PENDULUM_READY;
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
