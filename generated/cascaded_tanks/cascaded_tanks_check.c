/*
 * Self-check of cascaded_tanks.c: 64 recorded samples,
 * a missing, an infinite, an absurd, a lost and an excessive one among them.
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
    {1.75f, 4.55f},
    {1.9391892f, 4.626334f},
    {2.1283784f, 4.6905913f},
    {2.3175676f, 4.7451577f},
    {2.5067568f, 4.7923007f},
    {2.695946f, 4.8341527f},
    {2.8851352f, 4.872697f},
    {3.0743244f, 4.9097524f},
    {3.2635136f, 4.946972f},
    {3.4527028f, 4.9858327f},
    {3.641892f, 5.0276413f},
    {3.8310812f, 5.073538f},
    {4.0202703f, 5.1245055f},
    {4.2094593f, 5.1813793f},
    {4.3986487f, 5.244862f},
    {4.5878377f, 5.3155346f},
    {4.777027f, 5.3938723f},
    {4.966216f, 5.480256f},
    {5.1554055f, 5.574988f},
    {5.1554055f, 5.6780753f},
    {4.966216f, 0.0f},
    {4.777027f, 5.904038f},
    {4.5878377f, 6.0229387f},
    {4.3986487f, 6.143391f},
    {4.2094593f, 6.263843f},
    {4.0202703f, 3.2e+38f},
    {3.8310812f, 6.4992876f},
    {3.641892f, 6.611858f},
    {3.4527028f, 6.7195454f},
    {3.2635136f, 6.821365f},
    {3.0743244f, 20.3f},
    {2.8851352f, 7.003781f},
    {2.695946f, 7.0826974f},
    {2.5067568f, 7.1523695f},
    {2.3175676f, 7.2120495f},
    {2.1283784f, 7.261012f},
    {1.9391892f, 7.2985516f},
    {1.75f, 7.3239694f},
    {1.9391892f, 7.3370514f},
    {2.1283784f, 7.3394804f},
    {0.0f, 7.333371f},
    {2.5067568f, 7.3207703f},
    {2.695946f, 7.3036413f},
    {2.8851352f, 7.283845f},
    {3.0743244f, 7.2631254f},
    {14.0f, 7.2430973f},
    {3.4527028f, 7.2252374f},
    {3.641892f, 7.210879f},
    {3.8310812f, 7.2012105f},
    {4.0202703f, 7.197279f},
    {4.2094593f, 7.199994f},
    {4.3986487f, 7.2101364f},
    {4.5878377f, 7.2283664f},
    {4.777027f, 7.2552342f},
    {4.966216f, 7.2911916f},
    {5.1554055f, 7.336601f},
    {5.1554055f, 7.391529f},
    {4.966216f, 7.454951f},
    {4.777027f, 7.5249166f},
    {4.5878377f, 7.5994916f},
    {4.3986487f, -9.7f},
    {4.2094593f, 7.7557096f},
    {4.0202703f, 7.83437f},
    {3.8310812f, 7.9116273f},
};

static const float wanted[64][4] = { /* x.x1, x.x2, s.theta, s.innovation */
    {4.6487203f, 4.550661f, 1.3f, 0.0f},
    {4.0081506f, 4.6269484f, 3.1875f, 2.3272605f},
    {3.8452034f, 4.690661f, 3.5517242f, 3.5114722f},
    {3.7282932f, 4.7451634f, 3.6904762f, 4.7044425f},
    {3.6527267f, 4.7923007f, 3.7636364f, 5.9020734f},
    {3.6091452f, 4.8341527f, 3.8088236f, 7.1000967f},
    {3.5953426f, 4.872697f, 3.8395061f, 8.294188f},
    {3.6096032f, 4.9097524f, 3.8617022f, 9.480093f},
    {3.650358f, 4.946972f, 3.8785048f, 9.469979f},
    {3.7160678f, 4.9858327f, 3.8916667f, 9.449014f},
    {3.8053489f, 5.0276413f, 3.9022555f, 9.4176235f},
    {3.9169202f, 5.073538f, 2.0676801f, 1.9813639e-05f},
    {4.0496507f, 5.1245055f, 1.3927776f, 2.5106956e-05f},
    {4.2024746f, 5.1813793f, 1.1444948f, 3.518787e-05f},
    {4.374471f, 5.244862f, 1.0531566f, 3.6500995e-05f},
    {4.5647917f, 5.3155346f, 1.0195552f, 2.054548e-05f},
    {4.772708f, 5.3938723f, 1.0071939f, 2.0954281e-05f},
    {4.99755f, 5.480256f, 1.0026464f, 1.108302e-05f},
    {5.2387443f, 5.574988f, 1.0009736f, 1.1102509e-05f},
    {5.4819236f, 5.6780753f, 1.0003581f, 4.7429626e-06f},
    {5.699816f, 5.788428f, 1.0001317f, 4.7429626e-06f},
    {5.8801794f, 5.904038f, 1.0000485f, 3.541786e-06f},
    {6.0248556f, 6.0229387f, 1.0000179f, 6.5457225e-06f},
    {6.135549f, 6.143391f, 1.0000066f, 1.3480112e-05f},
    {6.2138286f, 6.263843f, 1.0000024f, 1.9195357e-05f},
    {6.2611485f, 6.3828974f, 1.0000008f, 2.2996988e-05f},
    {6.2788877f, 6.4992876f, 1.0000004f, 3.4144665e-05f},
    {6.2683597f, 6.611858f, 1.0000001f, 4.7405967e-05f},
    {6.230808f, 6.7195454f, 1.0f, 5.9985152e-05f},
    {6.1674314f, 6.821365f, 1.0f, 4.1423755e-05f},
    {6.079389f, 6.9163976f, 1.0f, 4.1423755e-05f},
    {5.967815f, 7.003781f, 1.0f, 2.379269e-05f},
    {5.8338027f, 7.0826974f, 1.0f, 3.016998e-05f},
    {5.678452f, 7.1523695f, 1.0f, 1.863106e-05f},
    {5.502841f, 7.2120495f, 1.0f, 2.3186396e-05f},
    {5.3080344f, 7.261012f, 1.0f, 1.4628497e-05f},
    {5.095122f, 7.2985516f, 1.0f, 1.6020711e-05f},
    {4.865177f, 7.3239694f, 1.0f, 1.1921848e-05f},
    {4.6469445f, 7.3370514f, 1.0f, 1.1005882e-05f},
    {4.4672303f, 7.3394804f, 1.0f, 5.5865944e-06f},
    {4.3120637f, 7.333319f, 1.0f, 5.9735185e-06f},
    {4.1987267f, 7.3205223f, 1.0f, 2.528117e-05f},
    {4.1320963f, 7.303397f, 1.0f, 7.556952e-05f},
    {4.0935564f, 7.283693f, 1.0f, 0.0001987111f},
    {4.0822034f, 7.263048f, 1.0f, 0.00033078482f},
    {4.3391895f, 7.2441406f, 1.0f, 0.00061377324f},
    {4.490093f, 7.2303066f, 1.0f, 0.0019317855f},
    {4.391064f, 7.215889f, 1.0f, 0.009851391f},
    {0.2704f, 8.507854f, 1.0f, 0.024505768f},
    {0.2704f, 7.22308f, 1.0f, 0.057941794f},
    {0.2704f, 6.837516f, 1.0f, 0.09144489f},
    {0.2704f, 6.772375f, 1.0f, 0.18108213f},
    {3.0712998f, 7.2283664f, 1.0f, 0.0f},
    {3.430342f, 7.255077f, 1.0f, 0.037188224f},
    {5.0684605f, 7.2877955f, 1.0f, 0.16934171f},
    {3.0712998f, 7.336601f, 1.0f, 0.0f},
    {3.5187273f, 7.391324f, 1.0f, 0.06276588f},
    {5.6457667f, 7.4504457f, 1.0f, 0.2855338f},
    {3.0712998f, 7.5249166f, 1.0f, 0.0f},
    {3.4704893f, 7.599242f, 1.0f, 0.09333726f},
    {0.2704f, -9.015886f, 3.0f, 1167.975f},
    {3.0712998f, 7.7513075f, 3.0f, 30.375742f},
    {6.0085917f, 7.832592f, 3.5f, 62.342674f},
    {6.418867f, 7.9113936f, 3.6666667f, 95.6515f},
};

static const unsigned expected[64] = { /* status */
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u,
    0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 1u, 0u, 0u, 0u, 0u, 2u, 0u,
    0u, 0u, 0u, 0u, 0u, 0u, 0u, 0u, 4u, 0u, 0u, 0u, 0u, 8u, 0u, 0u,
    48u, 16u, 16u, 16u, 176u, 0u, 0u, 176u, 0u, 0u, 176u, 0u, 48u, 64u, 0u, 0u,
};

#ifndef CASCADED_TANKS_EVERY_BIT
static const float tolerance[4] = {0.00014051789f, 2.61688e-05f, 9.106514e-06f, 0.004291007f};
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
    unsigned char saved[CASCADED_TANKS_SAVED];
    cascaded_tanks_init(&s, &p);
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        if (k == 0u) {
            s.z[0] = 5.0875f;
            s.z[1] = 2.156089f;
            s.theta = 1.3f;
        }
        if (k == 48u) {
            s.z[0] = 13.15f;
            s.z[1] = 3.69076f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 30.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 30.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 52u) {
            s.z[0] = 13.15f;
            s.z[1] = 3.69076f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 30.0f;
            s.fault_count_range = 30.0f;
            s.fault_limit_range = 30.0f;
            s.fault_checksum = 30.0f;
        }
        if (k == 55u) {
            s.z[0] = 18.525f;
            s.z[1] = 5.01191f;
            s.fault_count_y = 30.0f;
            s.fault_limit_y = 30.0f;
            s.fault_count_range = 30.0f;
            s.fault_limit_range = 30.0f;
            s.fault_checksum = 60.0f;
        }
        if (k == 58u) {
            s.z[0] = 18.525f;
            s.z[1] = 5.01191f;
            s.fault_count_y = -30.0f;
            s.fault_limit_y = 30.0f;
            s.fault_count_range = 30.0f;
            s.fault_limit_range = 30.0f;
            s.fault_checksum = 60.0f;
        }
        if (k == 61u) {
            s.z[0] = 1e+37f;
            s.z[1] = 1e+37f;
            s.fault_count_y = 0.0f;
            s.fault_limit_y = 30.0f;
            s.fault_count_range = 0.0f;
            s.fault_limit_range = 30.0f;
            s.fault_checksum = 0.0f;
        }
        if (k == 32u) {
            cascaded_tanks_save(&s, saved);
            cascaded_tanks_reset(&s);
            /* refused, it leaves the reset state, which differs */
            (void)cascaded_tanks_restore(&s, saved, sizeof(saved));
        }
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
