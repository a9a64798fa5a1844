/* roessler: see roessler.h, and its manual roessler.md. */
#include "roessler.h"

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
#define ROESSLER_RARELY __attribute__((noinline))
#else
#define ROESSLER_RARELY
#endif

static float roessler_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float roessler_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool roessler_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float roessler_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool roessler_within(float v, float limit)
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
static float roessler_limit(float v, float most)
{
    return roessler_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float roessler_keep(float v, float low, float high, float otherwise, float limit)
{
    return roessler_within(v, limit) ? roessler_clamp(v, low, high) : otherwise;
}

/* the right-hand side of the observer's differential equation */
static void roessler_rate(const roessler_params *p, float z1, float z2, float z3, float y, float valid,
    float dz[3])
{
    const float t1 = valid*(y - z1);
    const float t2 = roessler_limit(z1, 12.0f);
    dz[0] = z2 + p->derived.K[0]*t1 + 0.2f*t2;
    dz[1] = z3 + p->derived.K[1]*t1 - t2;
    dz[2] = (roessler_limit(z2, 12.0f) - 5.7f)*roessler_clamp(z3, -25.0f, 0.0f) - 0.2f + p->derived.K[2]*t1;
}

/* memory without its mark is not used: the state begins anew, which the status says */
ROESSLER_RARELY
static unsigned roessler_ready(roessler_state *s, const roessler_params *p)
{
    unsigned status = 0u;
    if (s->ready != ROESSLER_READY) {
        roessler_reset(s);
        status |= ROESSLER_UNINITIALISED;
    }
    if (p->ready != ROESSLER_READY) {
        roessler_reset(s);
        status |= ROESSLER_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
ROESSLER_RARELY
static void roessler_clear_fault_counts(roessler_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 3130.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 3130.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned roessler_keep_in_box(roessler_state *s, const roessler_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    {
        const bool t1 = roessler_within(s->z[0], 1e+30f) && roessler_within(s->z[1], 1e+30f)
            && roessler_within(s->z[2], 1e+30f);
        lost = !t1;
    }
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= ROESSLER_RESTARTED;
        roessler_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = roessler_limit(z1, 36.0f);
        s->z[1] = roessler_limit(z2, 60.0f);
        s->z[2] = roessler_clamp(z3, -325.0f, 300.0f);
        if (roessler_abs(z1) > 36.0f || roessler_abs(z2) > 60.0f || z3 < -325.0f || z3 > 300.0f) {
            status |= ROESSLER_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
ROESSLER_RARELY
static void roessler_nominal(roessler_params *p)
{
    p->ready = ROESSLER_READY;
    p->gain.theta = 5.0f;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned roessler_guard_measurements(const roessler_state *s, const roessler_output *measurement,
    float *valid, float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = roessler_within(reading, 36.0f) && roessler_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = roessler_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && roessler_within(y_before, 36.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= ROESSLER_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= ROESSLER_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned roessler_advance(roessler_state *s, const roessler_params *p, float valid, float y,
    float y_last)
{
    unsigned status = 0u;
    float ahead = 0.0f;
    bool beyond = false;
    float fraction = 0.0f;
    float share = 0.0f;
    float z_at[3];
    float z_sum[3];
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
    z_at[0] = s->z[0];
    z_at[1] = s->z[1];
    z_at[2] = s->z[2];
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
                const float z_sum1 = z_sum[0];
                const float z_sum2 = z_sum[1];
                const float z_sum3 = z_sum[2];
                float k_z[3];
                roessler_rate(p, z_at1, z_at2, z_at3, y_last + fraction*(y - y_last), valid, k_z);
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
        s->z[0] = z1 + 0.00016666666f*z_sum[0];
        s->z[1] = z2 + 0.00016666666f*z_sum[1];
        s->z[2] = z3 + 0.00016666666f*z_sum[2];
    }
    /* is a value beyond its box, or lost? */
    {
        const float z3 = s->z[2];
        const bool t1 = roessler_within(s->z[0], 36.0f) && roessler_within(s->z[1], 60.0f) && z3 >= -325.0f
            && z3 <= 300.0f;
        beyond = !t1;
    }
    if (roessler_acts(beyond)) {
        status |= roessler_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned roessler_suspect(const roessler_state *s, const roessler_output *measurement, bool *suspect,
    float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const float z3 = s->z[2];
        const bool t1 = roessler_abs(z1) > 12.0f || roessler_abs(s->z[1]) > 12.0f || z3 < -25.0f || z3 > 0.0f;
        if (t1) {
            status |= ROESSLER_OUTSIDE_BOX;
        }
        *suspect = roessler_abs(measurement->y - z1) > 2.4f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool roessler_counts_spoiled(const roessler_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 3130.0f + roessler_abs(fault_count_y)
            + (fault_limit_range - 3130.0f + fault_count_range);
        const bool t2 = roessler_abs(t1 - s->fault_checksum) < 0.5f
            && roessler_within(fault_count_y, 3205120.0f) && fault_limit_y >= 3130.0f
                && fault_limit_y <= 3205120.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 3205120.0f
            && fault_limit_range >= 3130.0f && fault_limit_range <= 3205120.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void roessler_find_signs(const roessler_state *s, const roessler_output *measurement, float *moves_y,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = roessler_within(t1, 2.4f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -542.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned roessler_recover(roessler_state *s, const roessler_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= roessler_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const float z3 = s->z[2];
        const bool t3 = fault_limit_range > 3130.0f || roessler_abs(s->z[0]) > 24.0f
            || roessler_abs(s->z[1]) > 24.0f || z3 < -37.5f || z3 > 12.5f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = roessler_min(fault_limit_y, 1602560.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = roessler_min(2.0f*fault_limit_y, 3205120.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = roessler_min(fault_limit_range, 1602560.0f);
            s->fault_limit_range = roessler_min(2.0f*fault_limit_range, 3205120.0f);
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
            s->z[0] = roessler_keep(measurement->y, -12.0f, 12.0f, z1, 1e+30f);
            s->z[1] = roessler_keep(z2, -12.0f, 12.0f, z2, 1e+30f);
            s->z[2] = roessler_keep(z3, -25.0f, 0.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= ROESSLER_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = roessler_limit(z1, 12.0f);
            s->z[1] = roessler_limit(z2, 12.0f);
            s->z[2] = roessler_clamp(z3, -25.0f, 0.0f);
            status |= ROESSLER_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned roessler_count_faults(roessler_state *s, const roessler_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = roessler_counts_spoiled(s);
    if (spoiled) {
        roessler_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    {
        const float z3 = s->z[2];
        moves_range = (roessler_abs(s->z[0]) > 13.2f || roessler_abs(s->z[1]) > 13.2f || z3 < -26.25f
            || z3 > 1.25f) ? 1.0f : -1.0f;
    }
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = roessler_clamp(fault_count_range + moves_range, 0.0f, 3205120.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 3130.0f : fault_limit_range;
    }
    roessler_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = roessler_clamp(roessler_abs(fault_count_y) + moves_y, 0.0f, 3205120.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 3130.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= roessler_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= roessler_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 3130.0f + roessler_abs(s->fault_count_y)
        + (s->fault_limit_range - 3130.0f + s->fault_count_range);
    return status;
}

unsigned roessler_step(roessler_state *s, const roessler_params *p, const roessler_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != ROESSLER_READY) || (p->ready != ROESSLER_READY)) {
        status = roessler_ready(s, p);
    }
    if ((status & ROESSLER_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        status |= roessler_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= roessler_advance(s, p, valid, y, y_last);
        } else {
            status |= roessler_keep_in_box(s, p);
        }
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= roessler_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || roessler_within(measurement->y, 36.0f);
            if (sampled) {
                status |= roessler_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void roessler_estimate(const roessler_state *s, const roessler_params *p, roessler_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x1 = s->z[1];
    x->x2 = s->z[0];
    x->x3 = -s->z[2];
}

unsigned roessler_tune(roessler_params *p)
{
    unsigned status = 0u;
    if (p->ready != ROESSLER_READY) {
        roessler_nominal(p);
        status = ROESSLER_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = roessler_keep(theta, 1.0f, 5.0f, 5.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 5.0f)) {
            status |= ROESSLER_PARAMETER_LIMITED;
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

ROESSLER_RARELY
void roessler_reset(roessler_state *s)
{
    s->ready = ROESSLER_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    roessler_clear_fault_counts(s);
}

void roessler_init(roessler_state *s, roessler_params *p)
{
    roessler_nominal(p);
    (void)roessler_tune(p);
    roessler_reset(s);
}

static const unsigned char roessler_layout[8] = {0xD0u, 0xAEu, 0xBAu, 0x8Bu, 0x9Cu, 0x1Bu, 0x24u, 0xDFu};

/* CRC-32 of IEEE 802.3 */
static uint32_t roessler_checksum(const unsigned char *bytes, size_t size)
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

void roessler_save(const roessler_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = roessler_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = roessler_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned roessler_restore(roessler_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == ROESSLER_SAVED) {
        refused = 0u;
        uint32_t sum = roessler_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == roessler_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = ROESSLER_READY;
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
