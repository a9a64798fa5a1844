/*
 * Self-check of series_dc_motor.c: 64 recorded samples,
 * a missing, an infinite, an absurd, a lost and an excessive one among them.
 * series_dc_motor_check() returns 0, or the number of the first sample that differs: 21 at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   SERIES_DC_MOTOR_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   SERIES_DC_MOTOR_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *                               FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *                               rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef SERIES_DC_MOTOR_CHECK_MAIN
#include <stdio.h>
#endif

#include "series_dc_motor.h"

#if defined(SERIES_DC_MOTOR_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define SERIES_DC_MOTOR_EVERY_BIT
#endif

unsigned series_dc_motor_check(void);

static const float given[64][2] = { /* in.u, measurement.y */
    {1250.0f, 20.6f},
    {1385.1351f, 21.42187f},
    {1520.2703f, 22.357971f},
    {1655.4054f, 23.405613f},
    {1790.5405f, 24.562162f},
    {1925.6757f, 25.825033f},
    {2060.8108f, 27.191698f},
    {2195.946f, 28.659672f},
    {2331.081f, 30.226519f},
    {2466.2163f, 31.889847f},
    {2601.3513f, 33.6473f},
    {2736.4866f, 35.496567f},
    {2871.6216f, 37.435364f},
    {3006.7568f, 39.461433f},
    {3141.8918f, 41.572556f},
    {3277.027f, 43.76652f},
    {3412.162f, 46.04115f},
    {3547.2974f, 20.6f},
    {3682.4324f, 23.692259f},
    {3682.4324f, 26.778688f},
    {3547.2974f, 0.0f},
    {3412.162f, 32.470066f},
    {3277.027f, 35.016193f},
    {3141.8918f, 37.368603f},
    {3006.7568f, 39.531643f},
    {2871.6216f, 3.2e+38f},
    {2736.4866f, 43.30649f},
    {2601.3513f, 44.926506f},
    {2466.2163f, 46.373566f},
    {2331.081f, 20.6f},
    {2195.946f, 100.47f},
    {2060.8108f, 23.937729f},
    {1925.6757f, 25.348585f},
    {1790.5405f, 26.59271f},
    {1655.4054f, 27.67395f},
    {1520.2703f, 28.59606f},
    {1385.1351f, 29.36272f},
    {1250.0f, 29.977524f},
    {1385.1351f, 30.57807f},
    {1520.2703f, 31.297676f},
    {0.0f, 32.133514f},
    {1790.5405f, 33.082806f},
    {1925.6757f, 34.142838f},
    {2060.8108f, 35.310932f},
    {2195.946f, 36.584473f},
    {10000.0f, 37.960884f},
    {2466.2163f, 39.437626f},
    {2601.3513f, 41.012215f},
    {2736.4866f, 42.682186f},
    {2871.6216f, 44.445118f},
    {3006.7568f, 46.29862f},
    {3141.8918f, 47.55f},
    {3277.027f, 47.55f},
    {3412.162f, 47.55f},
    {3547.2974f, 47.55f},
    {3682.4324f, 47.55f},
    {3682.4324f, 47.55f},
    {3547.2974f, 47.55f},
    {3412.162f, 47.55f},
    {3277.027f, 47.55f},
    {3141.8918f, -46.53f},
    {3006.7568f, 47.55f},
    {2871.6216f, 47.55f},
    {2736.4866f, 47.55f},
};

static const float wanted[64][3] = { /* x.i, x.w, x.TL */
    {20.6f, 123.0f, -9.0f},
    {21.42187f, 120.83429f, -8.99988f},
    {22.357971f, 120.7861f, -8.999726f},
    {23.405613f, 120.93507f, -8.999568f},
    {24.562162f, 121.16013f, -8.999401f},
    {25.825033f, 121.43792f, -8.999231f},
    {27.191698f, 121.76091f, -8.999053f},
    {28.659672f, 122.13017f, -8.998877f},
    {30.226519f, 122.5473f, -8.998696f},
    {31.889847f, 123.01602f, -8.998509f},
    {33.6473f, 123.5418f, -8.998327f},
    {35.496567f, 124.129524f, -8.998136f},
    {37.435364f, 124.785515f, -8.997936f},
    {39.461433f, 125.51749f, -8.997774f},
    {41.572556f, 126.33135f, -8.997593f},
    {43.76652f, 127.23529f, -8.997417f},
    {46.04115f, 128.23752f, -8.9972515f},
    {20.601665f, 275.99072f, -23.381615f},
    {23.69221f, 271.9815f, -22.917843f},
    {26.778633f, 267.02158f, -22.261366f},
    {29.603188f, 267.4153f, -22.261366f},
    {32.470005f, 255.03592f, -20.348566f},
    {35.01613f, 248.40508f, -19.095102f},
    {37.368538f, 241.66982f, -17.673782f},
    {39.531578f, 235.03008f, -16.112196f},
    {41.375553f, 235.84166f, -16.112196f},
    {43.30643f, 222.65845f, -12.691919f},
    {44.926445f, 217.1003f, -10.881156f},
    {46.37351f, 212.04025f, -9.037905f},
    {20.601164f, 179.12398f, -27.404398f},
    {22.319693f, 179.36418f, -27.404398f},
    {23.93771f, 177.85199f, -26.74162f},
    {25.348564f, 177.10728f, -26.306984f},
    {26.59269f, 176.3211f, -25.810019f},
    {27.67393f, 175.50993f, -25.25503f},
    {28.596037f, 174.68965f, -24.64777f},
    {29.362698f, 173.87448f, -23.994883f},
    {29.9775f, 173.07733f, -23.303926f},
    {30.578047f, 172.30553f, -22.580011f},
    {31.297655f, 171.55867f, -21.821054f},
    {32.13346f, 169.00368f, -19.835133f},
    {33.082752f, 166.52417f, -17.78392f},
    {34.14282f, 165.93846f, -16.962221f},
    {35.310913f, 165.37798f, -16.092777f},
    {36.584454f, 164.84464f, -15.171501f},
    {37.961502f, 202.29126f, -45.19619f},
    {39.438217f, 238.41464f, -75.33456f},
    {41.01215f, 235.53854f, -72.00995f},
    {42.69114f, 581.9421f, -150.0f},
    {44.444843f, 566.8221f, -134.33769f},
    {46.29834f, 551.34216f, -117.586876f},
    {47.55005f, 555.5504f, -120.75879f},
    {47.55f, -0.0f, 0.0f},
    {47.55f, 1.1897024f, -6.008866e-06f},
    {47.550056f, 600.0f, -0.24800421f},
    {47.55f, -0.0f, 0.0f},
    {47.55f, 1.1967312f, -6.882241e-06f},
    {47.55006f, 600.0f, -0.260946f},
    {47.55f, -0.0f, 0.0f},
    {47.55f, 1.1907889f, -6.007652e-06f},
    {-46.5278f, 600.0f, -9.572745f},
    {47.55f, -0.0f, 0.0f},
    {47.550045f, 600.0f, -0.06577161f},
    {47.55025f, 600.0f, -0.80370724f},
};

static const unsigned expected[64] = { /* status */
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
    0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 2u, 0u,
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 4u, 0u, 0u, 0u, 0u, 8u, 16u, 16u,
    48u, 16u, 16u, 16u, 176u, 0u, 48u, 176u, 0u, 48u, 176u, 0u, 48u, 64u, 48u, 48u,
};

#ifndef SERIES_DC_MOTOR_EVERY_BIT
static const float tolerance[3] = {0.00014123153f, 0.021570591f, 0.002339799f};
#endif

static bool series_dc_motor_near(float have, unsigned k, unsigned i)
{
#if defined(SERIES_DC_MOTOR_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(SERIES_DC_MOTOR_USE_CMSIS)
    const float room = 160.0f*tolerance[i];
#else
    const float room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned series_dc_motor_check(void)
{
    volatile const float nan_given = (float)NAN;
    const float none = nan_given;
    unsigned bad = (none >= none) ? 21u : 0u; /* compiled to take it for a number: sample 21 is lost */
    series_dc_motor_state s;
    series_dc_motor_params p;
    series_dc_motor_input in;
    series_dc_motor_output measurement;
    series_dc_motor_plant x;
    unsigned char saved[SERIES_DC_MOTOR_SAVED];
    series_dc_motor_init(&s, &p);
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        if (k == 0u) {
            s.z[0] = 21.09f;
            s.z[1] = -123.0f;
            s.z[2] = -9.0f;
        }
        if (k == 17u) {
            s.z[0] = 21.09f;
            s.z[1] = -123.0f;
            s.z[2] = -9.0f;
        }
        if (k == 29u) {
            s.z[0] = 21.09f;
            s.z[1] = -123.0f;
            s.z[2] = -9.0f;
        }
        if (k == 48u) {
            s.z[0] = 59.8f;
            s.z[1] = 60.0f;
            s.z[2] = 70.0f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 603.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 603.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 52u) {
            s.z[0] = 59.8f;
            s.z[1] = 60.0f;
            s.z[2] = 70.0f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 603.0f;
            s.fault_count_range = 603.0f;
            s.fault_limit_range = 603.0f;
            s.fault_checksum = 603.0f;
        }
        if (k == 55u) {
            s.z[0] = 84.3f;
            s.z[1] = 210.0f;
            s.z[2] = 120.0f;
            s.fault_count_y = 603.0f;
            s.fault_limit_y = 603.0f;
            s.fault_count_range = 603.0f;
            s.fault_limit_range = 603.0f;
            s.fault_checksum = 1206.0f;
        }
        if (k == 58u) {
            s.z[0] = 84.3f;
            s.z[1] = 210.0f;
            s.z[2] = 120.0f;
            s.fault_count_y = -603.0f;
            s.fault_limit_y = 603.0f;
            s.fault_count_range = 603.0f;
            s.fault_limit_range = 603.0f;
            s.fault_checksum = 1206.0f;
        }
        if (k == 61u) {
            s.z[0] = 1e+37f;
            s.z[1] = 1e+37f;
            s.z[2] = 1e+37f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 603.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 603.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 32u) {
            series_dc_motor_save(&s, saved);
            series_dc_motor_reset(&s);
            /* refused, it leaves the reset state, which differs */
            (void)series_dc_motor_restore(&s, saved, sizeof(saved));
        }
        in.u = (k == 40u) ? none : given[k][0];
        measurement.y = (k == 20u) ? none : given[k][1];
        const unsigned status = series_dc_motor_step(&s, &p, &in, &measurement);
        series_dc_motor_estimate(&s, &p, &x);
        if (status != expected[k] || !series_dc_motor_near(x.i, k, 0u) || !series_dc_motor_near(x.w, k, 1u)
            || !series_dc_motor_near(x.TL, k, 2u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef SERIES_DC_MOTOR_CHECK_MAIN
int main(void)
{
    const unsigned bad = series_dc_motor_check();
    if (bad != 0u) {
        (void)printf("series_dc_motor: sample %u differs\n", bad);
    } else {
#if defined(SERIES_DC_MOTOR_EXACT) && !defined(SERIES_DC_MOTOR_EVERY_BIT)
        (void)printf("series_dc_motor: 64 samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\n");
#else
        (void)printf("series_dc_motor: 64 samples as recorded\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
