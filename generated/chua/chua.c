/* chua: see chua.h, and its manual chua.md. */
#include "chua.h"

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
#define CHUA_RARELY __attribute__((noinline))
#else
#define CHUA_RARELY
#endif

static float chua_abs(float v)
{
#if defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabsf(v);
#else
    return (v <= 0.0f) ? 0.0f - v : v;
#endif
}

static float chua_min(float a, float b)
{
    return (a < b) ? a : b;
}

/* whether statements run that are left out for their cost alone; to a static analyser they always do */
static bool chua_acts(bool flag)
{
#if defined(__FRAMAC__)
    (void)flag;
    return true;
#else
    return flag;
#endif
}

static float chua_clamp(float v, float low, float high)
{
    const float raised = (v > low) ? v : low;
    return (raised < high) ? raised : high;
}

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
/* whether v is a number with |v| <= limit; v == v fails for NaN only, and says so to static analysers */
static bool chua_within(float v, float limit)
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
static float chua_limit(float v, float most)
{
    return chua_within(v, most) ? v : ((v > 0.0f) ? most : -most);
}

/* v in [low, high]; `otherwise` where v is not a number or beyond limit */
static float chua_keep(float v, float low, float high, float otherwise, float limit)
{
    return chua_within(v, limit) ? chua_clamp(v, low, high) : otherwise;
}

/* the right-hand side of the observer's differential equation */
static void chua_rate(const chua_params *p, float z1, float z2, float z3, float y, float valid, float dz[3])
{
    const float t1 = valid*(y - z1);
    const float t2 = chua_limit(z1, 3.0f);
    const float t3 = chua_limit(z2, 1.0f);
    dz[0] = 10.0f*z2 + p->derived.K[0]*t1 + (1.6666666f*t2 - t2*t2*t2*0.625f);
    dz[1] = z3 + p->derived.K[1]*t1 + (t2 - t3);
    dz[2] = p->derived.K[2]*t1 - 16.0f*t3;
}

/* memory without its mark is not used: the state begins anew, which the status says */
CHUA_RARELY
static unsigned chua_ready(chua_state *s, const chua_params *p)
{
    unsigned status = 0u;
    if (s->ready != CHUA_READY) {
        chua_reset(s);
        status |= CHUA_UNINITIALISED;
    }
    if (p->ready != CHUA_READY) {
        chua_reset(s);
        status |= CHUA_NO_PARAMETERS;
    }
    return status;
}

/* set the fault counts and their limits as after a reset */
CHUA_RARELY
static void chua_clear_fault_counts(chua_state *s)
{
    /* as after a reset */
    s->fault_count_y = 0.0f;
    s->fault_limit_y = 3130.0f;
    s->fault_count_range = 0.0f;
    s->fault_limit_range = 3130.0f;
    s->fault_checksum = 0.0f;
}

/* part of a step: keep the state in its box, or make it anew */
static unsigned chua_keep_in_box(chua_state *s, const chua_params *p)
{
    unsigned status = 0u;
    (void)p;
    bool lost = false;
    /* is a value lost? */
    lost = !(chua_within(s->z[0], 1e+30f) && chua_within(s->z[1], 1e+30f) && chua_within(s->z[2], 1e+30f));
    if (lost) {
        /* a value is lost: restart all but the last signals and the calls */
        s->z[0] = 0.0f;
        s->z[1] = 0.0f;
        s->z[2] = 0.0f;
        status |= CHUA_RESTARTED;
        chua_clear_fault_counts(s);
    }
    /* keep z in its box */
    {
        const float z1 = s->z[0];
        const float z2 = s->z[1];
        const float z3 = s->z[2];
        s->z[0] = chua_limit(z1, 9.0f);
        s->z[1] = chua_limit(z2, 5.0f);
        s->z[2] = chua_limit(z3, 125.0f);
        if (chua_abs(z1) > 9.0f || chua_abs(z2) > 5.0f || chua_abs(z3) > 125.0f) {
            status |= CHUA_STATE_LIMITED;
        }
    }
    return status;
}

/* nominal parameters */
CHUA_RARELY
static void chua_nominal(chua_params *p)
{
    p->ready = CHUA_READY;
    p->gain.theta = 5.0f;
}

/* is each sample a number, plausible, and not absurdly far from its estimate? */
static unsigned chua_guard_measurements(const chua_state *s, const chua_output *measurement, float *valid,
    float *y, float *y_last)
{
    unsigned status = 0u;
    /* guard the measurements */
    {
        const float reading = measurement->y;
        const float z1 = s->z[0];
        const bool t1 = chua_within(reading, 9.0f) && chua_within(reading - z1, 1e+16f);
        const float t2 = t1 ? reading : z1;
        const float y_before = s->y;
        const bool t3 = chua_within(reading, 3e+38f);
        *y = t2;
        *y_last = (t1 && s->y_valid > 0.0f && chua_within(y_before, 9.0f)) ? y_before : t2;
        *valid = t1 ? 1.0f : 0.0f;
        if (!t3) {
            status |= CHUA_MISSING_Y;
        }
        if (t3 && !t1) {
            status |= CHUA_REJECTED_Y;
        }
    }
    return status;
}

/* advance the estimate from the last call to now */
static unsigned chua_advance(chua_state *s, const chua_params *p, float valid, float y, float y_last)
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
                chua_rate(p, z_at1, z_at2, z_at3, y_last + fraction*(y - y_last), valid, k_z);
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
    beyond = !(chua_within(s->z[0], 9.0f) && chua_within(s->z[1], 5.0f) && chua_within(s->z[2], 125.0f));
    if (chua_acts(beyond)) {
        status |= chua_keep_in_box(s, p);
    }
    return status;
}

/* is the estimate out of a range or far from a sample, or does a fault count run? */
static unsigned chua_suspect(const chua_state *s, const chua_output *measurement, bool *suspect, float valid)
{
    unsigned status = 0u;
    /* is the estimate out of a range or far from a sample, or does a fault count run? */
    {
        const float z1 = s->z[0];
        const bool t1 = chua_abs(z1) > 3.0f || chua_abs(s->z[1]) > 1.0f || chua_abs(s->z[2]) > 5.0f;
        if (t1) {
            status |= CHUA_OUTSIDE_BOX;
        }
        *suspect = chua_abs(measurement->y - z1) > 0.6f || t1 || !(s->fault_checksum <= 0.0f)
            || !(valid > 0.0f);
    }
    return status;
}

/* is a fault count or limit out of its range, or does the checksum differ? */
static bool chua_counts_spoiled(const chua_state *s)
{
    bool spoiled = false;
    /* was a fault count or limit spoiled? */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = fault_limit_y - 3130.0f + chua_abs(fault_count_y)
            + (fault_limit_range - 3130.0f + fault_count_range);
        const bool t2 = chua_abs(t1 - s->fault_checksum) < 0.5f && chua_within(fault_count_y, 3205120.0f)
            && fault_limit_y >= 3130.0f && fault_limit_y <= 3205120.0f;
        const bool t3 = t2 && fault_count_range >= 0.0f && fault_count_range <= 3205120.0f
            && fault_limit_range >= 3130.0f && fault_limit_range <= 3205120.0f;
        spoiled = !t3;
    }
    return spoiled;
}

/* the change of the fault count of an output at this sample, and the sign of its error */
static void chua_find_signs(const chua_state *s, const chua_output *measurement, float *moves_y,
    float *side_y)
{
    /* a count goes up by 1 at a large error, far down at one of the other sign, else down by 1 */
    {
        const float t1 = measurement->y - s->z[0];
        const bool t2 = chua_within(t1, 0.6f);
        const float fault_count_y = s->fault_count_y;
        *moves_y = (t2 ? 0.0f : ((fault_count_y*t1 < 0.0f) ? -168.0f : 1.0f)) + (t2 ? -1.0f : 0.0f);
        *side_y = (t2 ? 0.0f : t1) + (t2 ? fault_count_y : 0.0f);
    }
}

/* a fault count is at its limit: restart from the sample, or project onto the ranges */
static unsigned chua_recover(chua_state *s, const chua_output *measurement)
{
    unsigned status = 0u;
    bool lost = false;
    bool over_range = false;
    bool over_y = false;
    /* which fault counts are at their limits, and must the estimate restart? */
    {
        const bool t1 = s->fault_limit_y <= chua_abs(s->fault_count_y);
        const float fault_limit_range = s->fault_limit_range;
        const bool t2 = fault_limit_range <= s->fault_count_range;
        const bool t3 = fault_limit_range > 3130.0f || chua_abs(s->z[0]) > 6.0f || chua_abs(s->z[1]) > 2.0f
            || chua_abs(s->z[2]) > 10.0f;
        over_y = t1;
        over_range = t2;
        lost = t1 || (t2 && t3);
    }
    if (over_y) {
        /* the fault limit doubles */
        {
            const float fault_count_y = s->fault_count_y;
            const float fault_limit_y = s->fault_limit_y;
            const float t1 = chua_min(fault_limit_y, 1602560.0f);
            s->fault_count_y = (fault_count_y < 0.0f) ? -t1 : t1;
            s->fault_limit_y = chua_min(2.0f*fault_limit_y, 3205120.0f);
        }
    }
    if (over_range) {
        /* the fault limit doubles */
        {
            const float fault_limit_range = s->fault_limit_range;
            s->fault_count_range = chua_min(fault_limit_range, 1602560.0f);
            s->fault_limit_range = chua_min(2.0f*fault_limit_range, 3205120.0f);
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
            s->z[0] = chua_keep(measurement->y, -3.0f, 3.0f, z1, 1e+30f);
            s->z[1] = chua_keep(z2, -1.0f, 1.0f, z2, 1e+30f);
            s->z[2] = chua_keep(z3, -5.0f, 5.0f, z3, 1e+30f);
        }
        /* the estimate has restarted from the sample */
        status |= CHUA_RESTARTED_FROM_SAMPLE;
    } else {
        /* the estimate back onto its declared ranges */
        {
            const float z1 = s->z[0];
            const float z2 = s->z[1];
            const float z3 = s->z[2];
            s->z[0] = chua_limit(z1, 3.0f);
            s->z[1] = chua_limit(z2, 1.0f);
            s->z[2] = chua_limit(z3, 5.0f);
            status |= CHUA_PROJECTED_ONTO_RANGES;
        }
    }
    return status;
}

/* count the signs of a fault at a sample, and act where a count is at its limit */
static unsigned chua_count_faults(chua_state *s, const chua_output *measurement)
{
    unsigned status = 0u;
    bool acts = false;
    float moves_range = 0.0f;
    float moves_y = 0.0f;
    float side_y = 0.0f;
    bool spoiled = false;
    spoiled = chua_counts_spoiled(s);
    if (spoiled) {
        chua_clear_fault_counts(s);
    }
    /* is the estimate out of a range? */
    moves_range = (chua_abs(s->z[0]) > 3.3f || chua_abs(s->z[1]) > 1.1f || chua_abs(s->z[2]) > 5.5f) ? 1.0f
        : -1.0f;
    /* count of range */
    {
        const float fault_count_range = s->fault_count_range;
        const float fault_limit_range = s->fault_limit_range;
        const float t1 = chua_clamp(fault_count_range + moves_range, 0.0f, 3205120.0f);
        s->fault_count_range = t1;
        s->fault_limit_range = (t1 <= 0.0f) ? 3130.0f : fault_limit_range;
    }
    chua_find_signs(s, measurement, &moves_y, &side_y);
    /* count of y */
    {
        const float fault_count_y = s->fault_count_y;
        const float fault_limit_y = s->fault_limit_y;
        const float t1 = chua_clamp(chua_abs(fault_count_y) + moves_y, 0.0f, 3205120.0f);
        s->fault_count_y = (side_y < 0.0f) ? -t1 : t1;
        s->fault_limit_y = (t1 <= 0.0f) ? 3130.0f : fault_limit_y;
    }
    /* is a fault count at its limit? */
    acts = s->fault_limit_y <= chua_abs(s->fault_count_y) || s->fault_limit_range <= s->fault_count_range;
    if (acts) {
        status |= chua_recover(s, measurement);
    }
    /* the checksum of fault counts and limits */
    s->fault_checksum = s->fault_limit_y - 3130.0f + chua_abs(s->fault_count_y)
        + (s->fault_limit_range - 3130.0f + s->fault_count_range);
    return status;
}

unsigned chua_step(chua_state *s, const chua_params *p, const chua_output *measurement)
{
    unsigned status = 0u;
    if ((s->ready != CHUA_READY) || (p->ready != CHUA_READY)) {
        status = chua_ready(s, p);
    }
    if ((status & CHUA_NO_PARAMETERS) == 0u) {
        bool running = false;
        bool sampled = false;
        bool suspect = false;
        float valid = 0.0f;
        float y = 0.0f;
        float y_last = 0.0f;
        status |= chua_guard_measurements(s, measurement, &valid, &y, &y_last);
        /* the first call advances no time */
        {
            const unsigned calls = s->calls;
            running = calls >= 1u;
            s->calls = 1u;
        }
        if (running) {
            status |= chua_advance(s, p, valid, y, y_last);
        } else {
            status |= chua_keep_in_box(s, p);
        }
        /* remember the sample */
        s->y = y;
        s->y_valid = valid;
        status |= chua_suspect(s, measurement, &suspect, valid);
        if (suspect) {
            /* is there a sample to judge by? */
            sampled = valid > 0.0f || chua_within(measurement->y, 9.0f);
            if (sampled) {
                status |= chua_count_faults(s, measurement);
            }
        }
    }
    return status;
}

void chua_estimate(const chua_state *s, const chua_params *p, chua_plant *x)
{
    (void)p;
    /* the plant's state */
    x->x = s->z[0];
    x->w = s->z[1];
    x->z = s->z[2];
}

unsigned chua_tune(chua_params *p)
{
    unsigned status = 0u;
    if (p->ready != CHUA_READY) {
        chua_nominal(p);
        status = CHUA_NO_PARAMETERS;
    }
    /* theta in its range */
    {
        const float theta = p->gain.theta;
        p->gain.theta = chua_keep(theta, 1.0f, 5.0f, 5.0f, 3e+38f);
        if (!(theta >= 1.0f && theta <= 5.0f)) {
            status |= CHUA_PARAMETER_LIMITED;
        }
    }
    /* observer gain */
    {
        const float theta = p->gain.theta;
        const float t1 = theta*theta;
        p->derived.K[0] = 3.0f*theta;
        p->derived.K[1] = 0.3f*t1;
        p->derived.K[2] = t1*theta*0.1f;
    }
    return status;
}

CHUA_RARELY
void chua_reset(chua_state *s)
{
    s->ready = CHUA_READY;
    s->z[0] = 0.0f;
    s->z[1] = 0.0f;
    s->z[2] = 0.0f;
    s->calls = 0u;
    s->y = 0.0f;
    s->y_valid = 0.0f;
    chua_clear_fault_counts(s);
}

void chua_init(chua_state *s, chua_params *p)
{
    chua_nominal(p);
    (void)chua_tune(p);
    chua_reset(s);
}

static const unsigned char chua_layout[8] = {0xF7u, 0x45u, 0x17u, 0x00u, 0x23u, 0x2Eu, 0x8Eu, 0x69u};

/* CRC-32 of IEEE 802.3 */
static uint32_t chua_checksum(const unsigned char *bytes, size_t size)
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

void chua_save(const chua_state *s, unsigned char *saved)
{
    const unsigned char *const bytes = (const unsigned char *)s;
    for (size_t k = 0u; k < 8u; ++k) {
        saved[k] = chua_layout[k];
    }
    for (size_t k = 0u; k < sizeof(*s); ++k) {
        saved[k + 8u] = bytes[k];
    }
    uint32_t sum = chua_checksum(saved, sizeof(*s) + 8u);
    for (size_t k = 0u; k < 4u; ++k) {
        saved[k + sizeof(*s) + 8u] = (unsigned char)(sum & 0xFFu);
        sum >>= 8u;
    }
}

unsigned chua_restore(chua_state *s, const unsigned char *saved, size_t size)
{
    unsigned refused = 1u;
    if (size == CHUA_SAVED) {
        refused = 0u;
        uint32_t sum = chua_checksum(saved, sizeof(*s) + 8u);
        for (size_t k = 0u; k < 4u; ++k) {
            refused |= (saved[k + sizeof(*s) + 8u] == (unsigned char)(sum & 0xFFu)) ? 0u : 1u;
            sum >>= 8u;
        }
        for (size_t k = 0u; k < 8u; ++k) {
            refused |= (saved[k] == chua_layout[k]) ? 0u : 1u;
        }
        const unsigned ready = CHUA_READY;
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
