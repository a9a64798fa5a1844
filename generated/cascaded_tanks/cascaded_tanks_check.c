/*
 * Self-check of cascaded_tanks.c: 64 recorded samples,
 * a missing, an absurd, a lost and an excessive one among them.
 * cascaded_tanks_check() returns 0, or the number of the first sample that differs: 21 at once where the
 * compiler was told, as by clang's -fno-honor-nans, that nothing is ever not a number. Define
 *   CASCADED_TANKS_CHECK_MAIN  to have a program that says what it returns; without it firmware calls it
 *   CASCADED_TANKS_EXACT       to ask for every bit: bundled functions, -ffp-contract=off, and
 *                              FLT_EVAL_METHOD of <float.h> 0, for elsewhere intermediate results are
 *                              rounded otherwise; without it other roundings are allowed for
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#ifdef CASCADED_TANKS_CHECK_MAIN
#include <stdio.h>
#endif

#include "cascaded_tanks.h"

#if defined(CASCADED_TANKS_EXACT) && defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 0)
#define CASCADED_TANKS_EVERY_BIT
#endif

unsigned cascaded_tanks_check(void);

static const float given[64][2] = { /* in.u, measurement.y */
    {1.75f, 2.5f},
    {1.9391892f, 2.9347825f},
    {2.1283784f, 3.3695652f},
    {2.3175676f, 3.8043478f},
    {2.5067568f, 4.2391305f},
    {2.695946f, 4.673913f},
    {2.8851352f, 5.1086955f},
    {3.0743244f, 5.5434785f},
    {3.2635136f, 5.978261f},
    {3.4527028f, 6.4130435f},
    {3.641892f, 6.847826f},
    {3.8310812f, 7.2826085f},
    {4.0202703f, 7.2826085f},
    {4.2094593f, 6.847826f},
    {4.3986487f, 6.4130435f},
    {4.5878377f, 5.978261f},
    {4.777027f, 5.5434785f},
    {4.966216f, 5.1086955f},
    {5.1554055f, 4.673913f},
    {5.1554055f, 4.2391305f},
    {4.966216f, 0.0f},
    {4.777027f, 3.3695652f},
    {4.5878377f, 2.9347825f},
    {4.3986487f, 2.5f},
    {4.2094593f, 2.9347825f},
    {4.0202703f, 3.3695652f},
    {3.8310812f, 3.8043478f},
    {3.641892f, 4.2391305f},
    {3.4527028f, 4.673913f},
    {3.2635136f, 5.1086955f},
    {3.0743244f, 1e+30f},
    {2.8851352f, 5.978261f},
    {2.695946f, 6.4130435f},
    {2.5067568f, 6.847826f},
    {2.3175676f, 7.2826085f},
    {2.1283784f, 7.2826085f},
    {1.9391892f, 6.847826f},
    {1.75f, 6.4130435f},
    {1.9391892f, 5.978261f},
    {2.1283784f, 5.5434785f},
    {0.0f, 5.1086955f},
    {2.5067568f, 4.673913f},
    {2.695946f, 4.2391305f},
    {2.8851352f, 3.8043478f},
    {3.0743244f, 3.3695652f},
    {3.2635136f, 2.9347825f},
    {3.4527028f, 2.5f},
    {3.641892f, 2.9347825f},
    {3.8310812f, 3.3695652f},
    {4.0202703f, 3.8043478f},
    {14.0f, 4.2391305f},
    {4.3986487f, 4.673913f},
    {4.5878377f, 5.1086955f},
    {4.777027f, 5.5434785f},
    {4.966216f, 5.978261f},
    {5.1554055f, 6.4130435f},
    {5.1554055f, 6.847826f},
    {4.966216f, 7.2826085f},
    {4.777027f, 7.2826085f},
    {4.5878377f, 6.847826f},
    {4.3986487f, 6.4130435f},
    {4.2094593f, 5.978261f},
    {4.0202703f, 5.5434785f},
    {3.8310812f, 5.1086955f},
};

static const float wanted[64][4] = { /* x.x1, x.x2, s.theta, s.innovation */
    {5.6150517f, 2.5084267f, 1.0f, 0.0f},
    {9.430797f, 2.9290655f, 3.0f, 206.34998f},
    {9.8696785f, 3.3671262f, 3.5f, 285.9847f},
    {11.116959f, 3.803528f, 3.6666667f, 351.2372f},
    {11.889368f, 4.2388096f, 3.75f, 403.29974f},
    {12.512139f, 4.673685f, 3.8f, 443.4991f},
    {13.10472f, 5.1085005f, 3.8333333f, 473.26898f},
    {13.681833f, 5.543304f, 3.857143f, 494.12262f},
    {14.246832f, 5.978102f, 3.875f, 451.22375f},
    {14.801624f, 6.4128976f, 3.8888888f, 412.30133f},
    {15.347543f, 6.8476915f, 3.8999999f, 377.43546f},
    {15.8856f, 7.2824845f, 3.9090908f, 19.941244f},
    {5.3218822f, 7.284794f, 3.9166665f, 22.644426f},
    {0.2704f, 6.850421f, 3.9230769f, 5.102936f},
    {0.2704f, 6.4147224f, 3.9285715f, 7.0424743f},
    {0.2704f, 5.9802356f, 3.9333334f, 24.559685f},
    {0.2704f, 5.5458956f, 3.9375f, 46.745617f},
    {0.2704f, 5.111797f, 3.9411764f, 128.32072f},
    {0.2704f, 4.678173f, 3.9444444f, 184.97385f},
    {0.2704f, 4.2442417f, 3.9473684f, 366.6301f},
    {0.36079648f, 3.9579203f, 3.95f, 366.6301f},
    {0.2704f, 3.3716905f, 3.952381f, 215.3002f},
    {0.2704f, 2.9389815f, 3.9545455f, 280.97083f},
    {0.2704f, 2.5037968f, 3.9565217f, 92.88225f},
    {8.154918f, 2.919578f, 3.9583333f, 106.42346f},
    {11.03417f, 3.3689737f, 3.96f, 69.99823f},
    {11.498396f, 3.804235f, 3.9615386f, 66.419136f},
    {12.056157f, 4.2389975f, 3.962963f, 23.913597f},
    {12.620643f, 4.673776f, 3.9642859f, 22.252697f},
    {13.171224f, 5.1085587f, 3.9655173f, 20.306095f},
    {12.893511f, 5.515914f, 3.9666667f, 20.306095f},
    {14.076111f, 5.9781713f, 3.967742f, 119.66467f},
    {14.741205f, 6.4128995f, 3.96875f, 157.33347f},
    {15.248125f, 6.8476834f, 3.969697f, 24.901932f},
    {15.742576f, 7.282464f, 3.9705882f, 33.59722f},
    {5.127083f, 7.284596f, 3.9714286f, 7.57557f},
    {0.2704f, 6.8501363f, 3.9722223f, 6.740378f},
    {0.2704f, 6.413666f, 3.972973f, 7.755085f},
    {0.2704f, 5.9788294f, 3.9736843f, 17.561228f},
    {0.2704f, 5.544118f, 3.974359f, 45.242657f},
    {0.2704f, 5.109426f, 3.9750001f, 73.29414f},
    {0.2704f, 4.674754f, 3.9756098f, 198.07227f},
    {0.2704f, 4.240194f, 3.9761906f, 262.46704f},
    {0.2704f, 3.8056307f, 3.9767442f, 487.89725f},
    {0.2704f, 3.3710785f, 3.9772727f, 589.98505f},
    {0.2704f, 2.9365475f, 3.9777777f, 33.818737f},
    {0.2704f, 2.502718f, 3.9782608f, 46.102962f},
    {6.5157113f, 2.9293156f, 3.9787233f, 33.58473f},
    {10.55659f, 3.3686557f, 3.9791665f, 32.26089f},
    {11.460109f, 3.8041544f, 3.9795916f, 15.970164f},
    {12.247961f, 4.239008f, 3.9799998f, 15.2889805f},
    {12.805087f, 4.6738405f, 3.980392f, 16.913704f},
    {13.297877f, 5.108602f, 3.9807692f, 25.439098f},
    {13.86615f, 5.54338f, 3.981132f, 78.11979f},
    {14.432588f, 5.97817f, 3.9814816f, 100.175514f},
    {14.990009f, 6.412961f, 3.9818182f, 186.11778f},
    {15.526821f, 6.847751f, 3.982143f, 216.03735f},
    {16.034874f, 7.282537f, 3.9824562f, 6.9122868f},
    {5.38258f, 7.284689f, 3.9827588f, 7.205632f},
    {0.2704f, 6.8502994f, 3.983051f, 2.8799684f},
    {0.2704f, 6.414732f, 3.9833336f, 8.97379f},
    {0.2704f, 5.9800963f, 3.9836068f, 33.594486f},
    {0.2704f, 5.545598f, 3.9838712f, 61.928295f},
    {0.2704f, 5.111251f, 3.9841273f, 147.00223f},
};

static const unsigned expected[64] = { /* status */
    0u, 0u, 0u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 0u, 16u, 16u, 16u,
    16u, 16u, 16u, 16u, 1u, 16u, 16u, 16u, 0u, 16u, 16u, 16u, 16u, 16u, 18u, 16u,
    16u, 16u, 16u, 0u, 16u, 16u, 16u, 16u, 20u, 16u, 16u, 16u, 16u, 16u, 272u, 0u,
    16u, 16u, 24u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 0u, 16u, 16u, 16u, 16u, 16u,
};

#ifndef CASCADED_TANKS_EVERY_BIT
static const float tolerance[4] = {0.00026108255f, 2.0463893e-05f, 1.2382629e-05f, 0.003520513f};
#endif

static bool cascaded_tanks_near(float have, unsigned k, unsigned i)
{
#if defined(CASCADED_TANKS_EVERY_BIT)
    return have >= wanted[k][i] && have <= wanted[k][i];
#else
#if defined(CASCADED_TANKS_USE_CMSIS)
    const float room = 160.0f*tolerance[i];
#else
    const float room = tolerance[i];
#endif
    return have >= wanted[k][i] - room && have <= wanted[k][i] + room;
#endif
}

unsigned cascaded_tanks_check(void)
{
    volatile const float nan_given = (float)NAN;
    const float none = nan_given;
    unsigned bad = (none >= none) ? 21u : 0u; /* compiled to take it for a number: sample 21 is lost */
    cascaded_tanks_state s;
    cascaded_tanks_params p;
    cascaded_tanks_input in;
    cascaded_tanks_output measurement;
    cascaded_tanks_plant x;
    cascaded_tanks_init(&s, &p);
    s.z[0] = 7.775f;
    s.z[1] = 2.36961f;
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        in.u = (k == 40u) ? none : given[k][0];
        measurement.y = (k == 20u) ? none : given[k][1];
        const unsigned status = cascaded_tanks_step(&s, &p, &in, &measurement);
        cascaded_tanks_estimate(&s, &p, &x);
        if (status != expected[k] || !cascaded_tanks_near(x.x1, k, 0u) || !cascaded_tanks_near(x.x2, k, 1u)
            || !cascaded_tanks_near(s.theta, k, 2u) || !cascaded_tanks_near(s.innovation, k, 3u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifdef CASCADED_TANKS_CHECK_MAIN
int main(void)
{
    const unsigned bad = cascaded_tanks_check();
    if (bad != 0u) {
        (void)printf("cascaded_tanks: sample %u differs\n", bad);
    } else {
#if defined(CASCADED_TANKS_EXACT) && !defined(CASCADED_TANKS_EVERY_BIT)
        (void)printf("cascaded_tanks: 64 samples within the tolerance, ");
        (void)printf("for FLT_EVAL_METHOD is not 0 here and bits may differ\n");
#else
        (void)printf("cascaded_tanks: 64 samples as recorded\n");
#endif
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
