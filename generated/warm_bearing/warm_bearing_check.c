/*
 * Self-check of warm_bearing.c: 64 recorded samples,
 * a missing, an absurd, a lost and an excessive one among them.
 * warm_bearing_check() returns 0, or the number of the first sample that differs: 21 at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   WARM_BEARING_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   WARM_BEARING_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *                            FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *                            rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef WARM_BEARING_CHECK_MAIN
#include <stdio.h>
#endif

#include "warm_bearing.h"

#if defined(WARM_BEARING_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define WARM_BEARING_EVERY_BIT
#endif

unsigned warm_bearing_check(void);

static const float given[64][3] = { /* in.u, in.T, measurement.y */
    {-3.0f, 15.0f, -1.1f},
    {-2.6756756f, 17.702703f, -0.90869564f},
    {-2.3513513f, 20.405405f, -0.7173913f},
    {-2.0270271f, 23.108109f, -0.526087f},
    {-1.7027028f, 25.81081f, -0.3347826f},
    {-1.3783784f, 28.513514f, -0.14347826f},
    {-1.054054f, 31.216217f, 0.047826085f},
    {-0.7297297f, 33.91892f, 0.23913044f},
    {-0.4054054f, 36.62162f, 0.4304348f},
    {-0.08108108f, 39.324326f, 0.62173915f},
    {0.24324325f, 42.027027f, 0.8130435f},
    {0.5675676f, 44.72973f, 1.0043478f},
    {0.8918919f, 47.432434f, 1.0043478f},
    {1.2162162f, 50.135136f, 0.8130435f},
    {1.5405406f, 52.837837f, 0.62173915f},
    {1.8648648f, 55.54054f, 0.4304348f},
    {2.1891892f, 58.243244f, 0.23913044f},
    {2.5135136f, 60.945946f, 0.047826085f},
    {2.837838f, 63.648647f, -0.14347826f},
    {2.837838f, 63.648647f, -0.3347826f},
    {2.5135136f, 60.945946f, 0.0f},
    {2.1891892f, 58.243244f, -0.7173913f},
    {1.8648648f, 55.54054f, -0.90869564f},
    {1.5405406f, 52.837837f, -1.1f},
    {1.2162162f, 50.135136f, -0.90869564f},
    {0.8918919f, 47.432434f, -0.7173913f},
    {0.5675676f, 44.72973f, -0.526087f},
    {0.24324325f, 42.027027f, -0.3347826f},
    {-0.08108108f, 39.324326f, -0.14347826f},
    {-0.4054054f, 36.62162f, 0.047826085f},
    {-0.7297297f, 33.91892f, 1e+30f},
    {-1.054054f, 31.216217f, 0.4304348f},
    {-1.3783784f, 28.513514f, 0.62173915f},
    {-1.7027028f, 25.81081f, 0.8130435f},
    {-2.0270271f, 23.108109f, 1.0043478f},
    {-2.3513513f, 20.405405f, 1.0043478f},
    {-2.6756756f, 17.702703f, 0.8130435f},
    {-3.0f, 15.0f, 0.62173915f},
    {-2.6756756f, 17.702703f, 0.4304348f},
    {-2.3513513f, 20.405405f, 0.23913044f},
    {0.0f, 0.0f, 0.047826085f},
    {-1.7027028f, 25.81081f, -0.14347826f},
    {-1.3783784f, 28.513514f, -0.3347826f},
    {-1.054054f, 31.216217f, -0.526087f},
    {-0.7297297f, 33.91892f, -0.7173913f},
    {-0.4054054f, 36.62162f, -0.90869564f},
    {-0.08108108f, 39.324326f, -1.1f},
    {0.24324325f, 42.027027f, -0.90869564f},
    {0.5675676f, 44.72973f, -0.7173913f},
    {0.8918919f, 47.432434f, -0.526087f},
    {18.0f, 190.0f, -0.3347826f},
    {1.5405406f, 52.837837f, -0.14347826f},
    {1.8648648f, 55.54054f, 0.047826085f},
    {2.1891892f, 58.243244f, 0.23913044f},
    {2.5135136f, 60.945946f, 0.4304348f},
    {2.837838f, 63.648647f, 0.62173915f},
    {2.837838f, 63.648647f, 0.8130435f},
    {2.5135136f, 60.945946f, 1.0043478f},
    {2.1891892f, 58.243244f, 1.0043478f},
    {1.8648648f, 55.54054f, 0.8130435f},
    {1.5405406f, 52.837837f, 0.62173915f},
    {1.2162162f, 50.135136f, 0.4304348f},
    {0.8918919f, 47.432434f, 0.23913044f},
    {0.5675676f, 44.72973f, 0.047826085f},
};

static const float wanted[64][2] = { /* x.x, x.v */
    {0.8f, 0.32f},
    {0.46576738f, -15.97953f},
    {0.21435079f, -27.446716f},
    {0.034747705f, -34.85411f},
    {-0.08270029f, -38.870487f},
    {-0.14646372f, -40.074112f},
    {-0.16396385f, -38.963905f},
    {-0.14169562f, -35.969296f},
    {-0.08533679f, -31.45894f},
    {0.0001553595f, -25.748396f},
    {0.110458314f, -19.106873f},
    {0.24180844f, -11.763199f},
    {0.372728f, -4.8062425f},
    {0.46743208f, 0.038214684f},
    {0.51342225f, 2.2701705f},
    {0.5173793f, 2.3447788f},
    {0.4851545f, 0.6526036f},
    {0.42186716f, -2.4684718f},
    {0.3319905f, -6.7324944f},
    {0.2194261f, -11.894165f},
    {0.20753397f, -11.890139f},
    {0.025068626f, -20.199818f},
    {-0.1492476f, -27.715054f},
    {-0.3335178f, -35.349144f},
    {-0.48958996f, -41.221172f},
    {-0.58648646f, -43.922848f},
    {-0.6323244f, -44.004448f},
    {-0.63421184f, -41.940228f},
    {-0.5983664f, -38.1379f},
    {-0.5302203f, -32.947f},
    {-0.5631668f, -32.945934f},
    {-0.40851897f, -23.800537f},
    {-0.25610015f, -15.202356f},
    {-0.08868259f, -6.292822f},
    {0.09123096f, 2.7902603f},
    {0.26327008f, 11.035271f},
    {0.39262527f, 16.789494f},
    {0.46765777f, 19.614939f},
    {0.49580246f, 20.01726f},
    {0.48357156f, 18.432467f},
    {0.43666258f, 15.234978f},
    {0.36005414f, 10.746298f},
    {0.25809166f, 5.2413917f},
    {0.13456237f, -1.0451927f},
    {-0.0072355717f, -7.912423f},
    {-0.16443777f, -15.195208f},
    {-0.33456045f, -22.75222f},
    {-0.47904158f, -28.674967f},
    {-0.5665445f, -31.531399f},
    {-0.6048724f, -31.851421f},
    {-0.6008588f, -30.089607f},
    {-0.5604805f, -26.64107f},
    {-0.48896426f, -21.84498f},
    {-0.39087006f, -15.987146f},
    {-0.27017128f, -9.313023f},
    {-0.13032576f, -2.030963f},
    {0.025661185f, 5.6805587f},
    {0.19518183f, 13.674944f},
    {0.35777414f, 20.933537f},
    {0.47854373f, 25.791487f},
    {0.54577357f, 27.802612f},
    {0.5668272f, 27.46468f},
    {0.5481515f, 25.206497f},
    {0.49538457f, 21.396534f},
};

static const unsigned expected[64] = { /* status */
    0u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 0u, 64u, 64u,
    0u, 64u, 64u, 64u, 65u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 66u, 64u,
    64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 84u, 64u, 64u, 64u, 64u, 64u, 64u, 64u,
    64u, 64u, 104u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u, 64u,
};

#ifndef WARM_BEARING_EVERY_BIT
static const float tolerance[2] = {2.3622865e-06f, 0.00017333112f};
#endif

static bool warm_bearing_near(float have, unsigned k, unsigned i)
{
#if defined(WARM_BEARING_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(WARM_BEARING_USE_CMSIS)
    const float room = 160.0f*tolerance[i];
#else
    const float room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned warm_bearing_check(void)
{
    volatile const float nan_given = (float)NAN;
    const float none = nan_given;
    unsigned bad = (none >= none) ? 21u : 0u; /* compiled to take it for a number: sample 21 is lost */
    warm_bearing_state s;
    warm_bearing_params p;
    warm_bearing_input in;
    warm_bearing_output measurement;
    warm_bearing_plant x;
    warm_bearing_init(&s, &p);
    s.z[0] = 0.8f;
    s.z[1] = 0.32f;
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        in.u = (k == 40u) ? none : given[k][0];
        in.T = (k == 40u) ? none : given[k][1];
        measurement.y = (k == 20u) ? none : given[k][2];
        const unsigned status = warm_bearing_step(&s, &p, &in, &measurement);
        warm_bearing_estimate(&s, &p, &x);
        if (status != expected[k] || !warm_bearing_near(x.x, k, 0u) || !warm_bearing_near(x.v, k, 1u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef WARM_BEARING_CHECK_MAIN
int main(void)
{
    const unsigned bad = warm_bearing_check();
    if (bad != 0u) {
        (void)printf("warm_bearing: sample %u differs\n", bad);
    } else {
#if defined(WARM_BEARING_EXACT) && !defined(WARM_BEARING_EVERY_BIT)
        (void)printf("warm_bearing: 64 samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\n");
#else
        (void)printf("warm_bearing: 64 samples as recorded\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
