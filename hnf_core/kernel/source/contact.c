/* The noise of linear contact, state by state: the twin of the numpy in hnf_core/field/linear_contact.py, where the
 * physics and its sources stand. */
#include <math.h>
#include <string.h>

#include "hnf_kernel.h"

#define TWO_PI 6.283185307179586476925

static double smoothstep(double x)
{
    x = x < 0.0 ? 0.0 : x > 1.0 ? 1.0 : x;
    return x * x * (3.0 - 2.0 * x);
}

/* How much of an arc band of f Hz may sound: out below 8 to 4 Hz and above 4 to 4.8 kHz. */
static double arc_gain(double f)
{
    return smoothstep((f - 4.0) / 4.0) * (1.0 - smoothstep((f - 4000.0) / 800.0));
}

/* height: (states, bands) m^2 per band. density: (angles, states, token_bands), what of it stands at each angle.
 * token_band: (bands,) column of density. shift: (angles,) bands by which the cut moves a wave. hand, hand_damping:
 * stiffness over mass, and 4 zeta^2 times it, of the hand that holds the mass sideways. scratch: 3 * bands.
 * out: (states, bands) each. */
void hnf_linear_contact(const hnf_touch *touch, int64_t states, const double *kappa, int64_t bands,
                        const double *height, const double *density, int64_t token_bands, const int64_t *token_band,
                        const int64_t *shift, int64_t angles, double hand, double hand_damping, double *scratch,
                        const hnf_contact *out)
{
    double *passed_height = scratch, *slope_height = scratch + bands, *leaned_height = scratch + 2 * bands;
    for (int64_t state = 0; state < states; state++) {
        const hnf_touch *now = touch + state;
        const double *own_height = height + state * bands;
        double *noise = out->noise + state * bands, *normal = out->normal + state * bands;
        double *passed = out->passed + state * bands, *leaned = out->leaned + state * bands;
        double *up = out->up + state * bands, *aside = out->aside + state * bands;
        for (int64_t k = 0; k < bands; k++) {
            /* The asperities' radius is half the contact's, so exp(-q^2 / 5) is their fourth power. */
            double q = TWO_PI * 0.5 * kappa[k] * now->radius, wave = TWO_PI * kappa[k];
            leaned[k] = exp(-q * q / 5.0);
            passed[k] = leaned[k] * leaned[k] * leaned[k] * leaned[k];
            passed_height[k] = own_height[k] * passed[k];
            slope_height[k] = own_height[k] * leaned[k] * wave * wave;
            leaned_height[k] = own_height[k] * leaned[k];
        }
        double *height_cut = normal, *slope_cut = aside, *leaned_cut = noise;
        memset(height_cut, 0, (size_t)bands * sizeof(double));
        memset(slope_cut, 0, (size_t)bands * sizeof(double));
        memset(leaned_cut, 0, (size_t)bands * sizeof(double));
        for (int64_t angle = 0; angle < angles; angle++) {
            const double *share = density + (angle * states + state) * token_bands;
            int64_t moved = shift[angle];
            for (int64_t k = moved; k < bands; k++) {
                double here = share[token_band[k]];
                height_cut[k - moved] += here * passed_height[k];
                slope_cut[k - moved] += here * slope_height[k];
                leaned_cut[k - moved] += here * leaned_height[k];
            }
        }
        for (int64_t k = 0; k < bands; k++) {
            double f = kappa[k] * now->speed, omega = TWO_PI * f, square = omega * omega, fade = arc_gain(f);
            double damped = now->damping * square, off = now->stiffness - now->mass * square;
            double below = off * off + damped, sideways = (hand - square) * (hand - square) + hand_damping * square;
            double response = below != 0.0 ? square * square * (now->stiffness * now->stiffness + damped) / below : 0.0;
            double wave = TWO_PI * kappa[k], slope = slope_cut[k] + now->flank * wave * wave * leaned_cut[k];
            up[k] = response * fade * fade;
            aside[k] = square * square / sideways * now->load_square * fade * fade;
            normal[k] = height_cut[k] * up[k];
            noise[k] = normal[k] * now->rubbed + slope * aside[k];
        }
    }
}
