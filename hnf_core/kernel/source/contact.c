/* Linear contact, state by state: the twin of linear_texture.py and linear_contact.py in hnf_core/field, where the
 * physics, its reasons and its sources stand. */
#include <math.h>
#include <string.h>

#include "fades.h"
#include "hnf_kernel.h"

#define TWO_PI 6.283185307179586476925

/* A token seen from the stroke, per band. log_noise: of the power per arc band that is no tone. lines: (2,
 * token_bands) powers of the tones along and across the lattice, cosine: |cos| of their angles to the stroke. density:
 * (angles, token_bands) of the noise, folded: what stands at a and at pi - a is moved alike. */
typedef struct {
    double *log_noise, *lines, *cosine, *density;
} seen;

static void see(const hnf_tables *t, const double *token, double angle, const seen *out)
{
    double cos_two = cos(2.0 * angle), sin_two = sin(2.0 * angle);
    double cos_four = cos(4.0 * angle), sin_four = sin(4.0 * angle);
    for (int64_t band = 0; band < t->token_bands; band++) {
        const double *f = token + band * t->features;
        double power = pow(10.0, 2.0 * f[t->level]), peak = f[t->peak];
        double two_re = f[t->cos2] * cos_two + f[t->sin2] * sin_two, two_im = f[t->sin2] * cos_two - f[t->cos2] * sin_two;
        double four_re = f[t->cos4] * cos_four + f[t->sin4] * sin_four;
        double four_im = f[t->sin4] * cos_four - f[t->cos4] * sin_four;
        double axis = 0.25 * atan2(four_im, four_re), axis_cos = cos(2.0 * axis), axis_sin = sin(2.0 * axis);
        double along = clipped(0.5 * (1.0 + two_re * axis_cos + two_im * axis_sin), 0.0, 1.0);
        double stronger = along > 0.5 ? along : 1.0 - along;
        double tone = peak * along / stronger, other = peak * (1.0 - along) / stronger;
        double most = tone + other > 1.0 ? tone + other : 1.0;
        tone = clipped(tone / most, 0.0, 1.0);
        other = clipped(other / most, 0.0, 1.0);
        double left = clipped(1.0 - (tone + other), 0.0, 1.0), noise = left < t->least_left ? 0.0 : power * left;
        out->log_noise[band] = log((noise > 1e-30 ? noise : 1e-30) / t->per_octave);
        out->lines[band] = power * tone;
        out->lines[t->token_bands + band] = power * other;
        out->cosine[band] = fabs(cos(axis));
        out->cosine[t->token_bands + band] = fabs(sin(axis));
        double size = sqrt(four_re * four_re + four_im * four_im), oriented = size > 1.0 ? 1.0 : size * size;
        for (int64_t a = 0; a < t->angles; a++) {
            const double *turn = t->turn + 4 * a;
            double sum = 0.0;
            for (int side = 0; side < 2; side++) {
                double sine_two = side ? -turn[1] : turn[1], sine_four = side ? -turn[3] : turn[3];
                double series = 1.0 + 4.0 / 3.0 * (two_re * turn[0] + two_im * sine_two)
                              + 2.0 / 3.0 * (four_re * turn[2] + four_im * sine_four);
                double facing = axis_cos * turn[0] + axis_sin * sine_two;
                double line = along * exp(t->concentration * (facing - 1.0))
                            + (1.0 - along) * exp(t->concentration * (-facing - 1.0));
                double density = (1.0 - oriented) * series + oriented * line / t->bump_mean;
                sum += density > 0.0 ? density : 0.0;
            }
            out->density[a * t->token_bands + band] = sum / (double)(2 * t->angles);
        }
    }
}

/* What the tip passes on of a wave, and the spots that bear it, as power. */
static void tip(double kappa, double radius, double *passed, double *leaned)
{
    /* The spots' radius is half the contact's, so that exp(-q^2 / 5) is their fourth power. */
    double q = TWO_PI * 0.5 * kappa * radius, spot = exp(-q * q / 5.0);
    *leaned = spot;
    *passed = spot * spot * spot * spot;
}

/* tokens: (states, token_size). scratch: (5 * bands + (angles + 5) * token_bands). out: power, noise (states, bands),
 * normal (states,), lines (2, states, 2 * token_bands), low (states, 2 * token_bands). */
void hnf_linear_contact(const hnf_tables *t, const double *tokens, int64_t token_size, const hnf_touch *touch,
                        int64_t states, double *scratch, const hnf_contact *out)
{
    int64_t bands = t->bands, lines = 2 * t->token_bands;
    double *flat = scratch, *slope = flat + bands, *lean = slope + bands, *up = lean + bands, *aside = up + bands;
    seen now = {aside + bands, aside + bands + t->token_bands, aside + bands + 3 * t->token_bands,
                aside + bands + 5 * t->token_bands};
    for (int64_t state = 0; state < states; state++) {
        const hnf_touch *hand = touch + state;
        double *noise = out->noise + state * bands, *power = out->power + state * bands, normal = 0.0;
        see(t, tokens + state * token_size, hand->angle, &now);
        for (int64_t k = 0; k < bands; k++) {
            double passed, leaned, wave = TWO_PI * t->kappa[k];
            const double *level = now.log_noise + t->below[k];
            double height = exp(level[0] * (1.0 - t->share[k]) + level[1] * t->share[k]);
            tip(t->kappa[k], hand->radius, &passed, &leaned);
            flat[k] = height * passed;
            slope[k] = height * leaned * wave * wave;
            lean[k] = height * leaned;
        }
        /* The cut, in place: what stands at an angle is met further down, and its own place is read before. */
        double *flat_cut = power, *lean_cut = noise, *slope_cut = aside;
        memset(flat_cut, 0, (size_t)bands * sizeof(double));
        memset(lean_cut, 0, (size_t)bands * sizeof(double));
        memset(slope_cut, 0, (size_t)bands * sizeof(double));
        for (int64_t angle = 0; angle < t->angles; angle++) {
            const double *share = now.density + angle * t->token_bands;
            int64_t moved = t->shift[angle];
            for (int64_t k = moved, end; k < bands; k = end) {
                double here = share[t->token_band[k]];
                for (end = k + 1; end < bands && t->token_band[end] == t->token_band[k];)
                    end++;
                for (int64_t j = k; j < end; j++) {
                    flat_cut[j - moved] += here * flat[j];
                    slope_cut[j - moved] += here * slope[j];
                    lean_cut[j - moved] += here * lean[j];
                }
            }
        }
        for (int64_t k = 0; k < bands; k++) {
            double f = t->kappa[k] * hand->speed, omega = TWO_PI * f, square = omega * omega, fade = arc_gain(f);
            double damped = hand->damping * square, off = hand->stiffness - hand->mass * square;
            double below = off * off + damped, spring = hand->stiffness * hand->stiffness + damped;
            double sideways = (t->hand - square) * (t->hand - square) + t->hand_damping * square;
            double wave = TWO_PI * t->kappa[k], leaning = slope_cut[k] + hand->flank * wave * wave * lean_cut[k];
            up[k] = (below != 0.0 ? square * square * spring / below : 0.0) * fade * fade;
            aside[k] = square * square / sideways * hand->load_square * fade * fade;
            double met = flat_cut[k] * up[k];
            normal += met;
            power[k] = noise[k] = met * hand->rubbed + leaning * aside[k];
        }
        /* The same for the tones, each in the two bands about it. */
        for (int64_t line = 0; line < lines; line++) {
            int64_t band = line % t->token_bands;
            const double *f = tokens + state * token_size + band * t->features;
            double own = exp2(clipped(f[t->offset], -0.5, 0.5)) / t->wavelength[band], passed, leaned;
            double octaves = t->per_octave * log2(own / t->kappa[0]);
            int64_t place = (int64_t)clipped(rint(octaves), 0.0, (double)(bands - 1));
            tip(t->kappa[place], hand->radius, &passed, &leaned);
            double met = own * now.cosine[line], wave = TWO_PI * t->kappa[place];
            double where = t->per_octave * log2((met > 1e-9 ? met : 1e-9) / t->kappa[0]), whole = floor(where);
            int64_t low = (int64_t)clipped(whole, -1e9, 1e9);
            out->low[state * lines + line] = low;
            for (int tap = 0; tap < 2; tap++) {
                double height = now.lines[line] * (tap ? where - whole : 1.0 - (where - whole));
                int64_t at = low + tap < 0 ? 0 : low + tap > bands - 1 ? bands - 1 : low + tap;
                double wide = TWO_PI * t->kappa[at], tone = height * passed * up[at];
                double leaning = height * leaned * (wave * wave + hand->flank * wide * wide);
                double sum = tone * hand->rubbed + leaning * aside[at];
                out->lines[(tap * states + state) * lines + line] = sum;
                if (at == low + tap) {
                    power[at] += sum;
                    normal += tone;
                }
            }
        }
        out->normal[state] = normal;
    }
}
