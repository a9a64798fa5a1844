/*
 * Self-check of roessler.c: 64 recorded samples,
 * a missing, an infinite, an absurd, a lost and an excessive one among them.
 * roessler_check() returns 0, or the number of the first sample that differs: 21 at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   ROESSLER_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   ROESSLER_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *                        FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *                        rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef ROESSLER_CHECK_MAIN
#include <stdio.h>
#endif

#include "roessler.h"

#if defined(ROESSLER_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define ROESSLER_EVERY_BIT
#endif

unsigned roessler_check(void);

static const float given[64][1] = { /* measurement.y */
    {-2.4f},
    {-2.402884f},
    {-2.4057763f},
    {-2.4086764f},
    {-2.4115846f},
    {-2.4145005f},
    {-2.4174242f},
    {-2.4203556f},
    {-2.4232948f},
    {-2.4262414f},
    {-2.4291954f},
    {-2.4321568f},
    {-2.4351256f},
    {-2.4381015f},
    {-2.4410846f},
    {-2.4440749f},
    {-2.447072f},
    {-2.450076f},
    {-2.453087f},
    {-2.456105f},
    {0.0f},
    {-2.4621606f},
    {-2.4651983f},
    {-2.4682424f},
    {-2.4712932f},
    {3.2e+38f},
    {-2.4774134f},
    {-2.480483f},
    {-2.4835587f},
    {-2.4866405f},
    {36.72f},
    {-2.492822f},
    {-2.4959216f},
    {-2.499027f},
    {-2.5021381f},
    {-2.505255f},
    {-2.5083776f},
    {-2.5115056f},
    {-2.5146391f},
    {-2.5177782f},
    {-2.5209227f},
    {-2.5240722f},
    {-2.5272272f},
    {-2.5303874f},
    {-2.5335526f},
    {-2.536723f},
    {-2.5398982f},
    {-2.5430784f},
    {-2.5462637f},
    {-2.5494535f},
    {-2.5526483f},
    {-2.555848f},
    {-2.559052f},
    {-2.5622606f},
    {-2.5654738f},
    {-2.5686917f},
    {-2.5719137f},
    {-2.5751402f},
    {-2.5783713f},
    {-2.5816064f},
    {-35.28f},
    {-2.5880892f},
    {-2.5913367f},
    {-2.5945885f},
};

static const float wanted[64][3] = { /* x.x1, x.x2, x.x3 */
    {-1.2f, -1.2f, 11.25f},
    {-1.299457f, -1.219368f, 11.320734f},
    {-1.3977329f, -1.2385925f, 11.387815f},
    {-1.4948356f, -1.2576747f, 11.451289f},
    {-1.590773f, -1.2766156f, 11.511201f},
    {-1.6855527f, -1.2954164f, 11.567596f},
    {-1.7791826f, -1.3140779f, 11.620522f},
    {-1.8716701f, -1.3326011f, 11.670025f},
    {-1.9630232f, -1.3509872f, 11.716153f},
    {-2.0532491f, -1.3692371f, 11.758956f},
    {-2.1423557f, -1.3873519f, 11.798481f},
    {-2.2303505f, -1.4053324f, 11.834778f},
    {-2.317241f, -1.4231797f, 11.867896f},
    {-2.4030344f, -1.4408948f, 11.897885f},
    {-2.4877386f, -1.4584787f, 11.924796f},
    {-2.5713606f, -1.4759322f, 11.948679f},
    {-2.653908f, -1.4932564f, 11.969584f},
    {-2.735388f, -1.5104522f, 11.987564f},
    {-2.8158083f, -1.5275204f, 12.002668f},
    {-2.895176f, -1.5444621f, 12.014948f},
    {-2.9055934f, -1.5476717f, 11.912257f},
    {-2.983909f, -1.5645186f, 11.922687f},
    {-3.0610728f, -1.5812178f, 11.930205f},
    {-3.1372066f, -1.597793f, 11.935056f},
    {-3.2123172f, -1.614245f, 11.937289f},
    {-3.2225854f, -1.6177857f, 11.8315115f},
    {-3.2966492f, -1.6341422f, 11.832129f},
    {-3.36959f, -1.6503541f, 11.83004f},
    {-3.4415305f, -1.6664456f, 11.82549f},
    {-3.5124776f, -1.6824175f, 11.818529f},
    {-3.5225577f, -1.6862719f, 11.710291f},
    {-3.5924647f, -1.7021474f, 11.701943f},
    {-3.6612775f, -1.7178816f, 11.6910925f},
    {-3.7291195f, -1.7334986f, 11.677983f},
    {-3.795998f, -1.7489994f, 11.662665f},
    {-3.86192f, -1.7643846f, 11.645187f},
    {-3.9268928f, -1.7796553f, 11.625599f},
    {-3.990923f, -1.7948122f, 11.603948f},
    {-4.0540175f, -1.8098562f, 11.580282f},
    {-4.1161838f, -1.824788f, 11.55465f},
    {-4.1774282f, -1.8396084f, 11.527101f},
    {-4.237758f, -1.8543184f, 11.497679f},
    {-4.29718f, -1.8689185f, 11.466433f},
    {-4.3557014f, -1.8834097f, 11.433408f},
    {-4.413329f, -1.8977928f, 11.39865f},
    {-4.4700694f, -1.9120686f, 11.3622055f},
    {-4.5259295f, -1.9262377f, 11.32412f},
    {-4.5809164f, -1.9403011f, 11.284436f},
    {15.351074f, 16.530329f, -2.5985973f},
    {13.919655f, 16.263197f, -0.23034596f},
    {12.505583f, 15.998582f, 2.1112473f},
    {11.108691f, 15.7364645f, 4.4336863f},
    {12.0f, 12.0f, -0.0f},
    {10.902771f, 11.796946f, 1.8126249f},
    {9.818859f, 11.595743f, 3.6078062f},
    {0.0f, -2.5686917f, -0.0f},
    {0.0024677096f, -2.5692246f, 0.00036759375f},
    {0.0047350167f, -2.5697951f, 0.0010661827f},
    {0.0f, -2.5783713f, -0.0f},
    {0.0024769728f, -2.578906f, 0.00036828785f},
    {-1.2157961f, -2.823893f, 2.0298452f},
    {0.0f, 0.0f, -0.0f},
    {-0.19303894f, -0.038680088f, 0.32075754f},
    {-0.38359135f, -0.077006556f, 0.6349742f},
};

static const unsigned expected[64] = { /* status */
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
    0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 2u, 0u,
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
    4u, 4u, 4u, 4u, 68u, 0u, 0u, 36u, 0u, 0u, 36u, 0u, 0u, 18u, 0u, 0u,
};

#ifndef ROESSLER_EVERY_BIT
static const float tolerance[3] = {4.264469e-05f, 4.7017555e-05f, 5.261965e-05f};
#endif

static bool roessler_near(float have, unsigned k, unsigned i)
{
#if defined(ROESSLER_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(ROESSLER_USE_CMSIS)
    const float room = 160.0f*tolerance[i];
#else
    const float room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned roessler_check(void)
{
    volatile const float nan_given = (float)NAN;
    const float none = nan_given;
    unsigned bad = (none >= none) ? 21u : 0u; /* compiled to take it for a number: sample 21 is lost */
    roessler_state s;
    roessler_params p;
    roessler_output measurement;
    roessler_plant x;
    unsigned char saved[ROESSLER_SAVED];
    roessler_init(&s, &p);
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        if (k == 0u) {
            s.z[0] = -1.2f;
            s.z[1] = -1.2f;
            s.z[2] = -11.25f;
        }
        if (k == 48u) {
            s.z[0] = 16.8f;
            s.z[1] = 16.8f;
            s.z[2] = 5.0f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 3130.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 3130.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 52u) {
            s.z[0] = 16.8f;
            s.z[1] = 16.8f;
            s.z[2] = 5.0f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 3130.0f;
            s.fault_count_range = 3130.0f;
            s.fault_limit_range = 3130.0f;
            s.fault_checksum = 3130.0f;
        }
        if (k == 55u) {
            s.z[0] = 28.8f;
            s.z[1] = 28.8f;
            s.z[2] = 17.5f;
            s.fault_count_y = 3130.0f;
            s.fault_limit_y = 3130.0f;
            s.fault_count_range = 3130.0f;
            s.fault_limit_range = 3130.0f;
            s.fault_checksum = 6260.0f;
        }
        if (k == 58u) {
            s.z[0] = 28.8f;
            s.z[1] = 28.8f;
            s.z[2] = 17.5f;
            s.fault_count_y = -3130.0f;
            s.fault_limit_y = 3130.0f;
            s.fault_count_range = 3130.0f;
            s.fault_limit_range = 3130.0f;
            s.fault_checksum = 6260.0f;
        }
        if (k == 61u) {
            s.z[0] = 1e+37f;
            s.z[1] = 1e+37f;
            s.z[2] = 1e+37f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 3130.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 3130.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 32u) {
            roessler_save(&s, saved);
            roessler_reset(&s);
            /* refused, it leaves the reset state, which differs */
            (void)roessler_restore(&s, saved, sizeof(saved));
        }
        measurement.y = (k == 20u) ? none : given[k][0];
        const unsigned status = roessler_step(&s, &p, &measurement);
        roessler_estimate(&s, &p, &x);
        if (status != expected[k] || !roessler_near(x.x1, k, 0u) || !roessler_near(x.x2, k, 1u)
            || !roessler_near(x.x3, k, 2u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef ROESSLER_CHECK_MAIN
int main(void)
{
    const unsigned bad = roessler_check();
    if (bad != 0u) {
        (void)printf("roessler: sample %u differs\n", bad);
    } else {
#if defined(ROESSLER_EXACT) && !defined(ROESSLER_EVERY_BIT)
        (void)printf("roessler: 64 samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\n");
#else
        (void)printf("roessler: 64 samples as recorded\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
