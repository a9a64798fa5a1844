/* stribeck: see stribeck.h, and its manual stribeck.md. */
#include "stribeck.h"

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
#define STRIBECK_RARELY __attribute__((noinline))
#else
#define STRIBECK_RARELY
#endif

static float stribeck_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float stribeck_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool stribeck_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float stribeck_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool stribeck_within(float v, float limit)
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
static float stribeck_limit(float v, float most)
{
    return stribeck_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float stribeck_keep(float v, float low, float high, float otherwise, float limit)
{
    return stribeck_within(v, limit) ? stribeck_clamp(v, low, high) : otherwise;
}

/* the table friction: linear, 11 points, held at its ends */
static float stribeck_table_friction(float x)
{
    static const float start[12] = {
        -0.9f, -0.9f, -0.5f, -0.3f, -0.2f, -0.1f, 0.0f, 0.1f, 0.2f, 0.3f, 0.5f, 0.9f
    };
    static const float c0[12] = {
        -1.8f, -1.8f, -1.45f, -1.4f, -1.6f, -2.0f, 0.0f, 2.0f, 1.6f, 1.4f, 1.45f, 1.8f
    };
    static const float c1[12] = {
        0.0f, 0.875f, 0.25f, -2.0f, -4.0f, 20.0f, 20.0f, -4.0f, -2.0f, 0.25f, 0.875f, 0.0f
    };
    unsigned k = 0u;
    unsigned probe = 8u;
    while (probe > 0u) {
        if (k + probe <= 11u && start[k + probe] <= x) {
            k = k + probe;
        }
        probe = probe/2u;
    }
    const float d = x - start[k];
    return c0[k] + d*c1[k];
}

/* the right-hand side of the observer's differential equation */
static void stribeck_rate(const stribeck_params *p, float z1, float z2, float u, float y, float valid,
    float dz[2])
{
    const float t1 = valid*(y - z1);
    dz[0] = z2 + p->derived.K[0]*t1;
    dz[1] = u - stribeck_table_friction(stribeck_limit(z2, 0.8f)) + p->derived.K[1]*t1;
}

/* memory without its mark is not used: the state begins anew, which the status says */
STRIBECK_RARELY
static unsigned stribeck_ready(stribeck_state *s, const stribeck_params *p)
{
    unsigned status = 0u;
    if (s->ready != STRIBECK_READY) {
        stribeck_reset(s);
        status |= STRIBECK_UNINITIALISED;
    }
    if (p->ready != STRIBECK_READY) {
        stribeck_reset(s);
        status |= STRIBECK_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
STRIBECK_RARELY
static void stribeck_clear_fault_counts(stribeck_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 2286.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 2286.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned stribeck_keep_in_box(stribeck_state *s, const stribeck_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    lost = !(stribeck_within(s->z[0], 1e+30f) && stribeck_within(s->z[1], 1e+30f));
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        status |= STRIBECK_RESTARTED;
        stribeck_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        s->z[0] = stribeck_limit(z1, 6.0f);
        s->z[1] = stribeck_limit(z2, 64.0f);
        if (stribeck_abs(z1) > 6.0f || stribeck_abs(z2) > 64.0f) {
            status |= STRIBECK_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
STRIBECK_RARELY
static void stribeck_nominal(stribeck_params *p)
{
    p->ready = STRIBECK_READY;
    p->gain.theta = 80.0f;
}

/* replace an input that is not finite or absurd by the last valid one, and clamp it to its range */
static unsigned stribeck_guard_input(const stribeck_state *s, const stribeck_input *in, float *u)
{
    unsigned status = 0u;
    /* guard the input */
    {
        const float u_given = in->u;
        const bool u_usable = stribeck_within(u_given, 1e+15f);
        const float u_taken = u_usable ? u_given : s->u;
        *u = stribeck_limit(u_taken, 6.0f);
        if (!u_usable) {
            status |= STRIBECK_REUSED_U;
        }
        if (stribeck_abs(u_taken) > 6.0f) {
            status |= STRIBECK_CLAMPED_U;
        }
    }
    return status;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned stribeck_guard_measurements(const stribeck_state *s, const stribeck_output *measurement,
    float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = stribeck_within(reading, 6.6f) && stribeck_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = stribeck_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && stribeck_within(y_before, 6.6f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= STRIBECK_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= STRIBECK_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned stribeck_advance(stribeck_state *s, const stribeck_params *p, float u, float valid, float y,
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
                stribeck_rate(p, z_at1, z_at2, u_before + fraction*(u - u_before), y_last
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
    beyond = !(stribeck_within(s->z[0], 6.0f) && stribeck_within(s->z[1], 64.0f));
    if (stribeck_acts(beyond)) {
        status |= stribeck_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned stribeck_suspect(const stribeck_state *s, const stribeck_output *measurement, bool *suspect,
    float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = stribeck_abs(z1) > 2.0f || stribeck_abs(s->z[1]) > 0.8f;
        if (t1) {
            status |= STRIBECK_OUTSIDE_BOX;
        }
        *suspect = stribeck_abs(measurement->y - z1) > 0.44f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool stribeck_counts_spoiled(const stribeck_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 2286.0f + stribeck_abs(fault_count_y)
            + (fault_limit_range - 2286.0f + fault_count_range);
        const bool t2 = stribeck_abs(t1 - s->fault_checksum) < 0.5f
            && stribeck_within(fault_count_y, 2340864.0f) && fault_limit_y >= 2286.0f
                && fault_limit_y <= 2340864.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 2340864.0f
            && fault_limit_range >= 2286.0f && fault_limit_range <= 2340864.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void stribeck_find_signs(const stribeck_state *s, const stribeck_output *measurement, float *moves_y,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = stribeck_within(t1, 0.44f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -1143.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned stribeck_recover(stribeck_state *s, const stribeck_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= stribeck_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = t2 && (fault_limit_range > 2286.0f || stribeck_abs(s->z[0]) > 4.0f
            || stribeck_abs(s->z[1]) > 1.6f);
        over_y = t1;
        over_range = t2;
        lost = t1 || t3;
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = stribeck_min(fault_limit_y, 1170432.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = stribeck_min(2.0f*fault_limit_y, 2340864.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = stribeck_min(fault_limit_range, 1170432.0f);
            s->fault_limit_range = stribeck_min(2.0f*fault_limit_range, 2340864.0f);
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
            s->z[0] = stribeck_keep(measurement->y, -2.0f, 2.0f, z1, 1e+30f);
            s->z[1] = stribeck_keep(z2, -0.8f, 0.8f, z2, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= STRIBECK_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            s->z[0] = stribeck_limit(z1, 2.0f);
            s->z[1] = stribeck_limit(z2, 0.8f);
            status |= STRIBECK_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned stribeck_count_faults(stribeck_state *s, const stribeck_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = stribeck_counts_spoiled(s);
    if (spoiled) {
        stribeck_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    moves_range = (stribeck_abs(s->z[0]) > 2.2f || stribeck_abs(s->z[1]) > 0.88f) ? 1.0f : -1.0f;
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = stribeck_clamp(fault_count_range + moves_range, 0.0f, 2340864.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 2286.0f : fault_limit_range;
    }
    stribeck_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = stribeck_clamp(stribeck_abs(fault_count_y) + moves_y, 0.0f, 2340864.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 2286.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= stribeck_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= stribeck_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 2286.0f + stribeck_abs(s->fault_count_y)
        + (s->fault_limit_range - 2286.0f + s->fault_count_range);
    return status;
}

unsigned stribeck_step(stribeck_state *s, const stribeck_params *p, const stribeck_input *in,
    const stribeck_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != STRIBECK_READY) || (p->ready != STRIBECK_READY)) {
        status = stribeck_ready(s, p);
    }
    if ((status & STRIBECK_NO_PARAMETERS) == 0u) {
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
            s->u = stribeck_limit(u_before, 6.0f);
        }
        status |= stribeck_guard_input(s, in, &u);
        status |= stribeck_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= stribeck_advance(s, p, u, valid, y, y_last);
        } else {
            status |= stribeck_keep_in_box(s, p);
        }
        /* remember the input */
        s->u = u;
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= stribeck_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || stribeck_within(measurement->y, 6.6f);
            if (sampled) {
                status |= stribeck_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void stribeck_estimate(const stribeck_state *s, const stribeck_params *p, stribeck_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->v = s->z[1];
}

unsigned stribeck_tune(stribeck_params *p)
{
    unsigned status = 0u;
    if (p->ready != STRIBECK_READY) {
        stribeck_nominal(p);
        status = STRIBECK_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = stribeck_keep(theta, 1.0f, 80.0f, 80.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 80.0f)) {
            status |= STRIBECK_PARAMETER_LIMITED;
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

STRIBECK_RARELY
void stribeck_reset(stribeck_state *s)
{
    s->ready = STRIBECK_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->calls = 0u;
    s->u = 0.0f;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    stribeck_clear_fault_counts(s);
}

void stribeck_init(stribeck_state *s, stribeck_params *p)
{
    stribeck_nominal(p);
    (void)stribeck_tune(p);
    stribeck_reset(s);
}

static const unsigned char stribeck_layout[8] = {0x76u, 0x13u, 0x3Fu, 0xABu, 0x12u, 0x2Du, 0x14u, 0x9Du};

/* CRC-32 of IEEE 802.3 */
static uint32_t stribeck_checksum(const unsigned char *bytes, size_t size)
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

void stribeck_save(const stribeck_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = stribeck_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = stribeck_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned stribeck_restore(stribeck_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == STRIBECK_SAVED) {
        refused = 0u;
        uint32_t sum = stribeck_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == stribeck_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = STRIBECK_READY;
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
