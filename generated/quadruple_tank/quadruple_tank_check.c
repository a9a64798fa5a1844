/*
 * Self-check of quadruple_tank.c: 64 recorded samples,
 * a missing, an infinite, an absurd, a lost and an excessive one among them.
 * quadruple_tank_check() returns 0, or the number of the first sample that differs: 21 at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   QUADRUPLE_TANK_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   QUADRUPLE_TANK_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *                              FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *                              rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef QUADRUPLE_TANK_CHECK_MAIN
#include <stdio.h>
#endif

#include "quadruple_tank.h"

#if defined(QUADRUPLE_TANK_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define QUADRUPLE_TANK_EVERY_BIT
#endif

unsigned quadruple_tank_check(void);

static const float given[64][4] = { /* in.v1, in.v2, measurement.y1, measurement.y2 */
    {1.5f, 1.5f, 8.6f, 8.6f},
    {1.6621622f, 1.6621622f, 8.717442f, 8.688863f},
    {1.8243244f, 1.8243244f, 8.841169f, 8.78371f},
    {1.9864864f, 1.9864864f, 8.971266f, 8.884542f},
    {2.1486487f, 2.1486487f, 9.107815f, 8.991367f},
    {2.3108108f, 2.3108108f, 9.250907f, 9.104191f},
    {2.4729729f, 2.4729729f, 9.400636f, 9.223023f},
    {2.6351352f, 2.6351352f, 9.557098f, 9.347878f},
    {2.7972972f, 2.7972972f, 9.720399f, 9.478771f},
    {2.9594595f, 2.9594595f, 9.890639f, 9.615718f},
    {3.1216216f, 3.1216216f, 10.067928f, 9.7587385f},
    {3.2837837f, 3.2837837f, 10.2523775f, 9.907855f},
    {3.445946f, 3.445946f, 10.444097f, 10.06309f},
    {3.608108f, 3.608108f, 10.643202f, 10.224471f},
    {3.7702703f, 3.7702703f, 10.849808f, 10.392024f},
    {3.9324324f, 3.9324324f, 11.064031f, 10.565779f},
    {4.0945945f, 4.0945945f, 11.285987f, 10.745765f},
    {4.256757f, 4.256757f, 11.515793f, 10.932014f},
    {4.418919f, 4.418919f, 11.753565f, 11.124562f},
    {4.418919f, 4.418919f, 11.992933f, 11.318583f},
    {4.256757f, 4.256757f, 0.0f, 0.0f},
    {4.0945945f, 4.0945945f, 12.431605f, 11.6773f},
    {3.9324324f, 3.9324324f, 12.624704f, 11.837329f},
    {3.7702703f, 3.7702703f, 12.8004875f, 11.984598f},
    {3.608108f, 3.608108f, 12.95908f, 12.119198f},
    {3.445946f, 3.445946f, 3.2e+38f, 3.2e+38f},
    {3.2837837f, 3.2837837f, 13.225149f, 12.350726f},
    {3.1216216f, 3.1216216f, 13.332842f, 12.447816f},
    {2.9594595f, 2.9594595f, 13.423775f, 12.5325575f},
    {2.7972972f, 2.7972972f, 13.498042f, 12.605023f},
    {2.6351352f, 2.6351352f, 39.57f, 39.57f},
    {2.4729729f, 2.4729729f, 13.596934f, 12.713403f},
    {2.3108108f, 2.3108108f, 13.621728f, 12.749447f},
    {2.1486487f, 2.1486487f, 13.630191f, 12.7734785f},
    {1.9864864f, 1.9864864f, 13.622397f, 12.785557f},
    {1.8243244f, 1.8243244f, 13.598416f, 12.785739f},
    {1.6621622f, 1.6621622f, 13.558314f, 12.77408f},
    {1.5f, 1.5f, 13.502153f, 12.750634f},
    {1.6621622f, 1.6621622f, 13.442975f, 12.725178f},
    {1.8243244f, 1.8243244f, 13.393858f, 12.707466f},
    {0.0f, 0.0f, 13.354923f, 12.69752f},
    {2.1486487f, 2.1486487f, 13.326291f, 12.695367f},
    {2.3108108f, 2.3108108f, 13.308086f, 12.701029f},
    {2.4729729f, 2.4729729f, 13.300436f, 12.714536f},
    {2.6351352f, 2.6351352f, 13.303466f, 12.735915f},
    {12.0f, 12.0f, 13.317301f, 12.765197f},
    {2.9594595f, 2.9594595f, 13.342065f, 12.802412f},
    {3.1216216f, 3.1216216f, 13.37788f, 12.847591f},
    {3.2837837f, 3.2837837f, 13.424863f, 12.900769f},
    {3.445946f, 3.445946f, 13.483128f, 12.961976f},
    {3.608108f, 3.608108f, 13.552781f, 13.031247f},
    {3.7702703f, 3.7702703f, 13.6339245f, 13.108613f},
    {3.9324324f, 3.9324324f, 13.726652f, 13.194109f},
    {4.0945945f, 4.0945945f, 13.831051f, 13.2877655f},
    {4.256757f, 4.256757f, 13.9472f, 13.389614f},
    {4.418919f, 4.418919f, 14.075169f, 13.499686f},
    {4.418919f, 4.418919f, 14.208524f, 13.613147f},
    {4.256757f, 4.256757f, 14.334288f, 13.720291f},
    {4.0945945f, 4.0945945f, 14.445921f, 13.816277f},
    {3.9324324f, 3.9324324f, 14.543367f, 13.901126f},
    {3.7702703f, 3.7702703f, -17.43f, -17.43f},
    {3.608108f, 3.608108f, 14.695525f, 14.037501f},
    {3.445946f, 3.445946f, 14.75016f, 14.089072f},
    {3.2837837f, 3.2837837f, 14.790459f, 14.129592f},
};

static const float wanted[64][4] = { /* x.h1, x.h2, x.h3, x.h4 */
    {8.600004f, 8.600004f, 9.275f, 9.275f},
    {8.717627f, 8.689083f, 8.209824f, 8.373433f},
    {8.841256f, 8.783829f, 7.9115357f, 8.077417f},
    {8.971322f, 8.884623f, 7.676325f, 7.8659763f},
    {9.107857f, 8.991427f, 7.4657598f, 7.683374f},
    {9.25094f, 9.104239f, 7.2720838f, 7.5168395f},
    {9.400663f, 9.223063f, 7.0926356f, 7.361884f},
    {9.557122f, 9.347913f, 6.9261613f, 7.216525f},
    {9.72042f, 9.478802f, 6.771951f, 7.0796967f},
    {9.890657f, 9.615745f, 6.629504f, 6.950764f},
    {10.067945f, 9.758762f, 6.4984484f, 6.82932f},
    {10.252393f, 9.907877f, 6.3784733f, 6.715067f},
    {10.44411f, 10.06311f, 6.2692876f, 6.607776f},
    {10.643214f, 10.224489f, 6.170644f, 6.507269f},
    {10.849819f, 10.392041f, 6.0822883f, 6.413382f},
    {11.064041f, 10.565795f, 6.0039883f, 6.325976f},
    {11.285996f, 10.74578f, 5.9355145f, 6.2449193f},
    {11.515802f, 10.932029f, 5.876643f, 6.170095f},
    {11.753573f, 11.124576f, 5.8271575f, 6.101396f},
    {11.992942f, 11.318595f, 5.782816f, 6.0362887f},
    {12.221196f, 11.504623f, 5.7357116f, 5.970405f},
    {12.431613f, 11.677312f, 5.681246f, 5.8997917f},
    {12.624711f, 11.837339f, 5.6202483f, 5.8260665f},
    {12.800494f, 11.984608f, 5.5526533f, 5.748772f},
    {12.959085f, 12.119207f, 5.47862f, 5.667969f},
    {13.100698f, 12.241373f, 5.3984327f, 5.584022f},
    {13.225155f, 12.350736f, 5.311872f, 5.4960876f},
    {13.332848f, 12.4478245f, 5.2194734f, 5.405136f},
    {13.4237795f, 12.532565f, 5.1212707f, 5.310936f},
    {13.498047f, 12.605031f, 5.0174246f, 5.2135544f},
    {13.555816f, 12.665413f, 4.9081745f, 5.113252f},
    {13.596939f, 12.71341f, 4.793443f, 5.0095162f},
    {13.621733f, 12.749454f, 4.6736355f, 4.9029984f},
    {13.630195f, 12.773485f, 4.5488367f, 4.7935796f},
    {13.622401f, 12.785563f, 4.419217f, 4.6813316f},
    {13.59842f, 12.785746f, 4.284946f, 4.5663295f},
    {13.558318f, 12.774086f, 4.146198f, 4.448649f},
    {13.502157f, 12.75064f, 4.0031514f, 4.3283677f},
    {13.442979f, 12.7251835f, 3.864023f, 4.2104006f},
    {13.393862f, 12.707472f, 3.73673f, 4.099535f},
    {13.354551f, 12.697245f, 3.6215835f, 3.9983213f},
    {13.325898f, 12.695078f, 3.517876f, 3.9040177f},
    {13.308069f, 12.701023f, 3.424649f, 3.813861f},
    {13.300441f, 12.714546f, 3.3418903f, 3.730079f},
    {13.303472f, 12.735927f, 3.2695615f, 3.6528246f},
    {13.324739f, 12.770772f, 3.207767f, 3.5442402f},
    {13.34994f, 12.80826f, 3.1525936f, 3.440534f},
    {13.37833f, 12.847842f, 3.1054428f, 3.3803189f},
    {14.05099f, 13.553578f, 20.852081f, 19.446072f},
    {13.5370035f, 13.011991f, 20.3083f, 18.892195f},
    {13.57346f, 13.045906f, 19.907019f, 18.561478f},
    {13.652518f, 13.121083f, 19.523647f, 18.25128f},
    {14.337543f, 13.593723f, 20.0f, 17.606842f},
    {13.8839855f, 13.322206f, 19.478502f, 17.173296f},
    {13.967334f, 13.402571f, 19.112772f, 16.884243f},
    {1.0f, 13.499686f, 0.5f, 0.5f},
    {14.208462f, 13.613147f, 1.6408663f, 0.57868004f},
    {14.334153f, 13.72015f, 2.8578916f, 2.1266525f},
    {14.445921f, 13.81622f, 0.5f, 0.5f},
    {14.543366f, 13.9010105f, 0.6266797f, 2.0096693f},
    {-17.394455f, -16.002102f, -19.0f, -19.0f},
    {14.695465f, 14.037444f, 0.5f, 0.5f},
    {14.7500725f, 14.088961f, 2.0436027f, 1.9600236f},
    {14.788808f, 14.128356f, 2.2453744f, 2.1453915f},
};

static const uint32_t expected[64] = { /* status */
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
    0u, 0u, 0u, 0u, 5u, 0u, 0u, 0u, 0u, 5u, 0u, 0u, 0u, 0u, 10u, 0u,
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 80u, 0u, 0u, 0u, 0u, 160u, 0u, 0u,
    256u, 256u, 0u, 0u, 4096u, 0u, 0u, 2048u, 0u, 0u, 2560u, 0u, 768u, 1024u, 0u, 0u,
};

#ifndef QUADRUPLE_TANK_EVERY_BIT
static const float tolerance[4] = {5.0676786e-05f, 4.317294e-05f, 0.00033512682f, 0.00032224072f};
#endif

static bool quadruple_tank_near(float have, unsigned k, unsigned i)
{
#if defined(QUADRUPLE_TANK_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(QUADRUPLE_TANK_USE_CMSIS)
    const float room = 160.0f*tolerance[i];
#else
    const float room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned quadruple_tank_check(void)
{
    volatile const float nan_given = (float)NAN;
    const float none = nan_given;
    unsigned bad = (none >= none) ? 21u : 0u; /* compiled to take it for a number: sample 21 is lost */
    quadruple_tank_state s;
    quadruple_tank_params p;
    quadruple_tank_input in;
    quadruple_tank_output measurement;
    quadruple_tank_plant x;
    unsigned char saved[QUADRUPLE_TANK_SAVED];
    quadruple_tank_init(&s, &p);
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        if (k == 0u) {
            s.z[0] = 9.55f;
            s.z[1] = 9.55f;
            s.z[2] = 9.275f;
            s.z[3] = 9.275f;
        }
        if (k == 48u) {
            s.z[0] = 23.8f;
            s.z[1] = 23.8f;
            s.z[2] = 23.9f;
            s.z[3] = 23.9f;
            s.fault_count_y_y1 = 0.0f;
            s.fault_limit_y_y1 = 115.0f;
            s.fault_count_y_y2 = 0.0f;
            s.fault_limit_y_y2 = 115.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 229.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 52u) {
            s.z[0] = 23.8f;
            s.z[1] = 23.8f;
            s.z[2] = 23.9f;
            s.z[3] = 23.9f;
            s.fault_count_y_y1 = 0.0f;
            s.fault_limit_y_y1 = 115.0f;
            s.fault_count_y_y2 = 0.0f;
            s.fault_limit_y_y2 = 115.0f;
            s.fault_count_range = 229.0f;
            s.fault_limit_range = 229.0f;
            s.fault_checksum = 229.0f;
        }
        if (k == 55u) {
            s.z[0] = 33.3f;
            s.z[1] = 33.3f;
            s.z[2] = 33.65f;
            s.z[3] = 33.65f;
            s.fault_count_y_y1 = 115.0f;
            s.fault_limit_y_y1 = 115.0f;
            s.fault_count_y_y2 = 115.0f;
            s.fault_limit_y_y2 = 115.0f;
            s.fault_count_range = 229.0f;
            s.fault_limit_range = 229.0f;
            s.fault_checksum = 459.0f;
        }
        if (k == 58u) {
            s.z[0] = 33.3f;
            s.z[1] = 33.3f;
            s.z[2] = 33.65f;
            s.z[3] = 33.65f;
            s.fault_count_y_y1 = -115.0f;
            s.fault_limit_y_y1 = 115.0f;
            s.fault_count_y_y2 = -115.0f;
            s.fault_limit_y_y2 = 115.0f;
            s.fault_count_range = 229.0f;
            s.fault_limit_range = 229.0f;
            s.fault_checksum = 459.0f;
        }
        if (k == 61u) {
            s.z[0] = 1e+37f;
            s.z[1] = 1e+37f;
            s.z[2] = 1e+37f;
            s.z[3] = 1e+37f;
            s.fault_count_y_y1 = 0.0f;
            s.fault_limit_y_y1 = 115.0f;
            s.fault_count_y_y2 = 0.0f;
            s.fault_limit_y_y2 = 115.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 229.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 32u) {
            quadruple_tank_save(&s, saved);
            quadruple_tank_reset(&s);
            /* refused, it leaves the reset state, which differs */
            (void)quadruple_tank_restore(&s, saved, sizeof(saved));
        }
        in.v1 = (k == 40u) ? none : given[k][0];
        in.v2 = (k == 40u) ? none : given[k][1];
        measurement.y1 = (k == 20u) ? none : given[k][2];
        measurement.y2 = (k == 20u) ? none : given[k][3];
        const uint32_t status = quadruple_tank_step(&s, &p, &in, &measurement);
        quadruple_tank_estimate(&s, &p, &x);
        if (status != expected[k] || !quadruple_tank_near(x.h1, k, 0u) || !quadruple_tank_near(x.h2, k, 1u)
            || !quadruple_tank_near(x.h3, k, 2u) || !quadruple_tank_near(x.h4, k, 3u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef QUADRUPLE_TANK_CHECK_MAIN
int main(void)
{
    const unsigned bad = quadruple_tank_check();
    if (bad != 0u) {
        (void)printf("quadruple_tank: sample %u differs\n", bad);
    } else {
#if defined(QUADRUPLE_TANK_EXACT) && !defined(QUADRUPLE_TANK_EVERY_BIT)
        (void)printf("quadruple_tank: 64 samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\n");
#else
        (void)printf("quadruple_tank: 64 samples as recorded\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
