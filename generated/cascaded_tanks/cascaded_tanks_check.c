/*
 * Self-check of cascaded_tanks.c: 64 recorded samples, a missing, an absurd, a lost and an excessive one
 * among them.
 * cascaded_tanks_check() returns 0, or the number of the first sample that differs. Define
 *   CASCADED_TANKS_EXACT    to ask for every bit: bundled functions, -ffp-contract=off; without it other
 *     roundings, as of
 *                           libm or of contraction, are allowed for
 *   CASCADED_TANKS_NO_MAIN  to call it from firmware
 */
#include <stdbool.h>

#include "cascaded_tanks.h"

unsigned cascaded_tanks_check(void);

static const float given[64][2] = { /* in.u, out.y */
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

static const float wanted[64][2] = { /* x1, x2 */
    {3.0712998f, 2.5039937f},
    {9.1374035f, 2.9245994f},
    {9.750393f, 3.3665614f},
    {11.107857f, 3.8034708f},
    {11.8896475f, 4.2388067f},
    {12.512251f, 4.6736856f},
    {13.104724f, 5.1085005f},
    {13.681836f, 5.543304f},
    {14.246835f, 5.978102f},
    {14.801628f, 6.4128976f},
    {15.347547f, 6.8476915f},
    {15.885604f, 7.2824845f},
    {5.3218865f, 7.284794f},
    {0.17885658f, 6.850421f},
    {0.18306203f, 6.4147224f},
    {0.15477143f, 5.9802356f},
    {0.115644954f, 5.5458956f},
    {0.06918744f, 5.111797f},
    {0.020712761f, 4.678173f},
    {9.020069e-05f, 4.2442417f},
    {0.36079726f, 3.9579206f},
    {0.0070542265f, 3.3716905f},
    {0.029297208f, 2.9389815f},
    {0.078347586f, 2.5037968f},
    {8.154922f, 2.919578f},
    {11.034173f, 3.3689737f},
    {11.4984f, 3.804235f},
    {12.056148f, 4.2389975f},
    {12.6206455f, 4.673776f},
    {13.171227f, 5.1085587f},
    {12.893515f, 5.515914f},
    {14.076106f, 5.9781713f},
    {14.7411995f, 6.4128995f},
    {15.24812f, 6.8476834f},
    {15.74257f, 7.282464f},
    {5.12708f, 7.284596f},
    {0.1202493f, 6.8501363f},
    {0.06445296f, 6.413666f},
    {0.035453916f, 5.9788294f},
    {0.019785937f, 5.544118f},
    {0.0070927134f, 5.109426f},
    {0.0014134718f, 4.674754f},
    {1.9049297e-05f, 4.240194f},
    {0.0032874993f, 3.8056307f},
    {0.0140892435f, 3.3710785f},
    {0.03564643f, 2.9365475f},
    {0.07243182f, 2.5020444f},
    {6.1628447f, 2.9233665f},
    {10.663121f, 3.3685575f},
    {11.4742985f, 3.8041718f},
    {12.249117f, 4.2390103f},
    {12.80516f, 4.673841f},
    {13.297866f, 5.108602f},
    {13.866152f, 5.54338f},
    {14.43259f, 5.97817f},
    {14.990011f, 6.412961f},
    {15.526823f, 6.847751f},
    {16.034874f, 7.282537f},
    {5.38258f, 7.284689f},
    {0.18768363f, 6.8502994f},
    {0.18452606f, 6.414732f},
    {0.14362368f, 5.9800963f},
    {0.09667421f, 5.545598f},
    {0.051410247f, 5.111251f},
};

static const unsigned expected[64] = { /* status */
    0u, 0u, 0u, 0u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 0u, 0u, 0u,
    0u, 0u, 0u, 0u, 1u, 0u, 16u, 16u, 16u, 0u, 16u, 16u, 16u, 16u, 18u, 16u,
    16u, 16u, 16u, 16u, 0u, 16u, 16u, 16u, 20u, 16u, 16u, 16u, 16u, 16u, 16u, 16u,
    0u, 16u, 24u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 16u, 0u, 0u, 0u, 0u, 0u,
};

#ifndef CASCADED_TANKS_EXACT
static const float tolerance[2] = {0.00025101105f, 1.8160441e-05f};
#endif

static bool cascaded_tanks_near(float have, unsigned k, unsigned i)
{
#if defined(CASCADED_TANKS_EXACT)
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
    unsigned bad = 0u;
    volatile float zero = 0.0f;
    const float none = zero/zero;
    cascaded_tanks_state s;
    cascaded_tanks_params p;
    cascaded_tanks_input in;
    cascaded_tanks_output out;
    cascaded_tanks_plant x;
    cascaded_tanks_init(&s, &p);
    for (unsigned k = 0u; k < 64u && bad == 0u; ++k) {
        in.u = (k == 40u) ? none : given[k][0];
        out.y = (k == 20u) ? none : given[k][1];
        const unsigned status = cascaded_tanks_step(&s, &p, &in, &out);
        cascaded_tanks_estimate(&s, &p, &x);
        if (status != expected[k] || !cascaded_tanks_near(x.x1, k, 0u) || !cascaded_tanks_near(x.x2, k, 1u)) {
            bad = k + 1u;
        }
    }
    return bad;
}

#ifndef CASCADED_TANKS_NO_MAIN
#include <stdio.h>

int main(void)
{
    const unsigned bad = cascaded_tanks_check();
    if (bad != 0u) {
        printf("cascaded_tanks: sample %u differs\n", bad);
    } else {
        printf("cascaded_tanks: 64 samples as recorded\n");
    }
    return (bad == 0u) ? 0 : 1;
}
#endif
