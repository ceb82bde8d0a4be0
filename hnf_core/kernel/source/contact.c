/* Linear contact, state by state: the twin of linear_texture.py and linear_contact.py in hnf_core/field, where the
 * physics, its reasons and its sources stand.
 *
 * What follows from the token alone is worked out when another one comes, what follows from its angle to the stroke when
 * that changes, and what follows from the load likewise. Numbers stand band by band, so that a compiler takes several at
 * once. */
#include "contact.h"

#include <math.h>
#include <string.h>

#include "elementary.h"
#include "fades.h"

#define TWO_PI 6.283185307179586476925
#define TWICE_LOG_OF_10 4.605170185988091368036

/* Four numbers at once, whatever the processor's own vectors are. */
typedef double four __attribute__((vector_size(32), aligned(8)));
#define WIDE 4

/* Consecutive numbers of a piece of memory. */
static double *taken(double **from, int64_t count)
{
    double *begin = *from;
    *from += count;
    return begin;
}

/* So many numbers and as many more as leave none over where WIDE are taken at once. */
static int64_t widened(int64_t count) { return (count + WIDE - 1) / WIDE * WIDE; }

/* Numbers of a row that is read from any shift on, four at once. */
static int64_t padded(const hnf_tables *t)
{
    int64_t farthest = 0;
    for (int64_t angle = 0; angle < t->angles; angle++)
        farthest = t->shift[angle] > farthest ? t->shift[angle] : farthest;
    return t->bands + farthest + WIDE;
}

/* scratch: 6 * bands + 22 * (token_bands + 3) + (3 + angles) * (bands + the farthest shift + 4). */
contact_work contact_work_in(const hnf_tables *t, double *scratch)
{
    int64_t count = t->token_bands, row = padded(t);
    contact_work work = {.row = row};
    work.known = (known_token){
        taken(&scratch, count), taken(&scratch, count), taken(&scratch, count), taken(&scratch, count),
        taken(&scratch, count), taken(&scratch, count), taken(&scratch, count), taken(&scratch, count),
        taken(&scratch, t->bands),
    };
    work.seen = (seen_token){taken(&scratch, 2 * count), taken(&scratch, 2 * count), taken(&scratch, t->angles * row)};
    work.passed = taken(&scratch, t->bands);
    work.leaned = taken(&scratch, t->bands);
    work.of = taken(&scratch, 3 * row);
    work.room = scratch; /* 3 * bands, or 10 * (token_bands + 3) */
    for (int64_t angle = 0; angle < t->angles; angle++)
        memset(work.seen.density + angle * row + t->bands, 0, (size_t)(row - t->bands) * sizeof(double));
    for (int64_t part = 0; part < 3; part++)
        memset(work.of + part * row + t->bands, 0, (size_t)(row - t->bands) * sizeof(double));
    return work;
}

/* The axes of a lattice, by the moments of its directions. cosine, sine: of twice the angle from the stroke to the one
 * that is at most 45 degrees off. along: how much of all stands along it, 0 ... 1. */
static void axes(const double *two_re, const double *two_im, const double *four_re, const double *four_im,
                 int64_t count, double *cosine, double *sine, double *along, double *fourfold)
{
    for (int64_t band = 0; band < count; band++) {
        double size = sqrt(four_re[band] * four_re[band] + four_im[band] * four_im[band]);
        fourfold[band] = size;
        double c = size > 0.0 ? four_re[band] / size : 1.0, s = size > 0.0 ? four_im[band] / size : 0.0;
        /* Half the angle, by whichever of the two formulas loses no digits. */
        double larger = sqrt(0.5 * (1.0 + fabs(c))), smaller = 0.5 * fabs(s) / larger;
        cosine[band] = c >= 0.0 ? larger : smaller;
        sine[band] = copysign(c >= 0.0 ? smaller : larger, s);
        along[band] = clipped(0.5 * (1.0 + two_re[band] * cosine[band] + two_im[band] * sine[band]), 0.0, 1.0);
    }
}

/* Shares of a band's power that its lines along the axis and across it have: the twin of compute_line_shares. */
static inline void tones(const hnf_tables *t, int64_t band, double peak, double along, double fourfold, double *tone,
                         double *other)
{
    double stronger = along > 0.5 ? along : 1.0 - along, twofold = 2.0 * along - 1.0;
    double one = peak * along / stronger, two = peak * (1.0 - along) / stronger;
    double least = t->least_across * (fourfold + fabs(twofold));
    one = one > t->line_share[band] && fourfold + twofold > least ? one : 0.0;
    two = two > t->line_share[band] && fourfold - twofold > least ? two : 0.0;
    double most = one + two > 1.0 ? one + two : 1.0;
    *tone = clipped(one / most, 0.0, 1.0);
    *other = clipped(two / most, 0.0, 1.0);
}

/* What a token is, from wherever the stroke comes. */
static void decode_token(const hnf_tables *t, const double *token, double *room, const known_token *out)
{
    int64_t count = t->token_bands;
    double *cosine = taken(&room, count), *sine = taken(&room, count), *along = taken(&room, count);
    double *level = taken(&room, count), *fourfold = taken(&room, count);
    for (int64_t band = 0; band < count; band++) {
        const double *f = token + band * t->features;
        out->power[band] = exp_of(TWICE_LOG_OF_10 * f[t->level]);
        out->peak[band] = f[t->peak];
        out->two_re[band] = f[t->cos2];
        out->two_im[band] = f[t->sin2];
        out->four_re[band] = f[t->cos4];
        out->four_im[band] = f[t->sin4];
        double scale = clipped(f[t->peak] / t->clear_peak, t->least_offset_scale, 1.0);
        out->octaves[band] = clipped(f[t->offset] / scale, -0.5, 0.5) - log2_of(t->wavelength[band] * t->kappa[0]);
        out->place[band] = clipped(rint(t->per_octave * out->octaves[band]), 0.0, (double)(t->bands - 1));
    }
    axes(out->two_re, out->two_im, out->four_re, out->four_im, count, cosine, sine, along, fourfold);
    for (int64_t band = 0; band < count; band++) {
        double tone, other;
        tones(t, band, out->peak[band], along[band], fourfold[band], &tone, &other);
        double left = clipped(1.0 - (tone + other), 0.0, 1.0);
        double noise = left < t->least_left ? 0.0 : out->power[band] * left;
        level[band] = log_of((noise > 1e-30 ? noise : 1e-30) / t->per_octave);
    }
    for (int64_t k = 0; k < t->bands; k++) {
        const double *at = level + t->below[k];
        out->height[k] = exp_of(at[0] * (1.0 - t->share[k]) + at[1] * t->share[k]);
    }
}

/* Angular density of a token's waves at an angle and at its mirror image, for `count` numbers. What is strictly oriented
 * is along e^(c (f - 1)) + across e^(c (-f - 1)), f = cos 2a cosine +- sin 2a sine. */
static void angular_density(const hnf_tables *t, const double *turn, const double *const moments[4],
                            const double *cosine, const double *sine, const double *along, const double *oriented,
                            int64_t count, double *out)
{
    const double *two_re = moments[0], *two_im = moments[1], *four_re = moments[2], *four_im = moments[3];
    double level = exp_of(-t->concentration) / t->bump_mean, share = 1.0 / (double)(2 * t->angles);
    for (int64_t band = 0; band < count; band++) {
        double even = 1.0 + 4.0 / 3.0 * two_re[band] * turn[0] + 2.0 / 3.0 * four_re[band] * turn[2];
        double odd = 4.0 / 3.0 * two_im[band] * turn[1] + 2.0 / 3.0 * four_im[band] * turn[3];
        double one = exp_of(t->concentration * cosine[band] * turn[0]), under_one = 1.0 / one;
        double other = exp_of(t->concentration * sine[band] * turn[1]), under_other = 1.0 / other;
        double line = along[band] * one * other + (1.0 - along[band]) * under_one * under_other;
        double mirrored = along[band] * one * under_other + (1.0 - along[band]) * under_one * other;
        double left = 1.0 - oriented[band], drawn = oriented[band] * level;
        double here = left * (even + odd) + drawn * line, there = left * (even - odd) + drawn * mirrored;
        out[band] = ((here > 0.0 ? here : 0.0) + (there > 0.0 ? there : 0.0)) * share;
    }
}

/* A token that is known, from a stroke at an angle. row: numbers of a row of its density. */
static void rotate_token(const hnf_tables *t, const known_token *token, double angle, int64_t row, double *room,
                         const seen_token *out)
{
    int64_t count = t->token_bands, wide = widened(count);
    double cos_two = cos(2.0 * angle), sin_two = sin(2.0 * angle);
    double cos_four = cos_two * cos_two - sin_two * sin_two, sin_four = 2.0 * sin_two * cos_two;
    double *two_re = taken(&room, wide), *two_im = taken(&room, wide), *four_re = taken(&room, wide);
    double *four_im = taken(&room, wide), *cosine = taken(&room, wide), *sine = taken(&room, wide);
    double *along = taken(&room, wide), *oriented = taken(&room, wide), *here = taken(&room, wide);
    double *fourfold = taken(&room, wide);
    memset(two_re, 0, (size_t)(10 * wide) * sizeof(double));
    for (int64_t band = 0; band < count; band++) {
        two_re[band] = token->two_re[band] * cos_two + token->two_im[band] * sin_two;
        two_im[band] = token->two_im[band] * cos_two - token->two_re[band] * sin_two;
        four_re[band] = token->four_re[band] * cos_four + token->four_im[band] * sin_four;
        four_im[band] = token->four_im[band] * cos_four - token->four_re[band] * sin_four;
        oriented[band] = clipped(four_re[band] * four_re[band] + four_im[band] * four_im[band], 0.0, 1.0);
    }
    axes(two_re, two_im, four_re, four_im, count, cosine, sine, along, fourfold);
    for (int64_t band = 0; band < count; band++) {
        double *line = out->lines + band, *octaves = out->octaves + band;
        double tone, other, met = sqrt(0.5 * (1.0 + cosine[band])), across = 0.5 * fabs(sine[band]) / met;
        tones(t, band, token->peak[band], along[band], fourfold[band], &tone, &other);
        line[0] = token->power[band] * tone;
        line[count] = token->power[band] * other;
        octaves[0] = token->octaves[band] + log2_of(met);
        octaves[count] = token->octaves[band] + log2_of(across > 1e-30 ? across : 1e-30);
    }
    const double *const moments[4] = {two_re, two_im, four_re, four_im};
    for (int64_t a = 0; a < t->angles; a++) {
        double *density = out->density + a * row;
        angular_density(t, t->turn + 4 * a, moments, cosine, sine, along, oriented, wide, here);
        for (int64_t band = 0, k = 0; band < count; band++)
            for (double value = here[band]; k < t->nearest_end[band]; k++)
                density[k] = value;
    }
}

static void tip_gains(const hnf_tables *t, double radius, double *passed, double *leaned)
{
    for (int64_t k = 0; k < t->bands; k++) {
        /* The spots' radius is half the contact's, so that exp(-q^2 / 5) is their fourth power. */
        double q = TWO_PI * 0.5 * t->kappa[k] * radius, spot = exp_of(-q * q / 5.0), square = spot * spot;
        leaned[k] = spot;
        passed[k] = square * square;
    }
}

/* The cut through the noise: what stands at an angle is met further down. density: (angles, row); of: (3, row); zero
 * beyond their bands. cut: (3, bands). */
static void cut_through(const hnf_tables *t, const double *density, const double *of, int64_t row, double *cut)
{
    int64_t bands = t->bands;
    for (int64_t k = 0; k < bands; k += WIDE) {
        four one = {0}, two = {0}, three = {0};
        const double *share = density + k, *from = of + k;
        for (int64_t angle = 0; angle < t->angles; angle++, share += row) {
            int64_t moved = t->shift[angle];
            four here = *(const four *)(share + moved);
            one += here * *(const four *)(from + moved);
            two += here * *(const four *)(from + row + moved);
            three += here * *(const four *)(from + 2 * row + moved);
        }
        int64_t many = bands - k < WIDE ? bands - k : WIDE;
        memcpy(cut + k, &one, (size_t)many * sizeof(double));
        memcpy(cut + bands + k, &two, (size_t)many * sizeof(double));
        memcpy(cut + 2 * bands + k, &three, (size_t)many * sizeof(double));
    }
}

static void update_cache(const hnf_tables *t, contact_work *work, const double *token, const hnf_touch *hand)
{
    int other = !work->token || memcmp(token, work->token, (size_t)(t->features * t->token_bands) * sizeof(double));
    int first = !work->token;
    work->token = token;
    if (other)
        decode_token(t, token, work->room, &work->known);
    if (other || hand->angle != work->angle)
        rotate_token(t, &work->known, hand->angle, work->row, work->room, &work->seen);
    if (first || hand->radius != work->radius)
        tip_gains(t, hand->radius, work->passed, work->leaned);
    work->angle = hand->angle;
    work->radius = hand->radius;
}

void contact_of(const hnf_tables *t, contact_work *work, const double *token, const hnf_touch *hand, int64_t stride,
                const hnf_contact *out)
{
    int64_t bands = t->bands, row = work->row;
    update_cache(t, work, token, hand);
    double *of = work->of, *cut = work->room, *up = of, *aside = of + row, *met = of + 2 * row, normal = 0.0;
    for (int64_t k = 0; k < bands; k++) {
        double wave = TWO_PI * t->kappa[k], height = work->known.height[k], leaned = height * work->leaned[k];
        of[k] = height * work->passed[k];
        of[row + k] = leaned * wave * wave;
        of[2 * row + k] = leaned;
    }
    cut_through(t, work->seen.density, of, row, cut);
    for (int64_t k = 0; k < bands; k++) {
        double wave = TWO_PI * t->kappa[k], omega = wave * hand->speed, square = omega * omega;
        double fade = arc_gain(t->kappa[k] * hand->speed), loud = square * square * fade * fade;
        double damped = hand->damping * square, off = hand->stiffness - hand->mass * square;
        double below = off * off + damped, spring = hand->stiffness * hand->stiffness + damped;
        double sideways = (t->hand - square) * (t->hand - square) + t->hand_damping * square;
        double leaning = cut[bands + k] + hand->flank * wave * wave * cut[2 * bands + k];
        up[k] = below != 0.0 ? loud * spring / below : 0.0;
        aside[k] = loud * hand->load_square / sideways;
        met[k] = cut[k] * up[k];
        out->power[k] = out->noise[k] = met[k] * hand->rubbed + leaning * aside[k];
    }
    for (int64_t k = 0; k < bands; k++)
        normal += met[k];
    /* The same for the tones, each in the two bands about it. */
    for (int64_t line = 0; line < 2 * t->token_bands; line++) {
        int64_t place = (int64_t)work->known.place[line % t->token_bands];
        double wave = TWO_PI * t->kappa[place], passed = work->passed[place], leaned = work->leaned[place];
        double where = t->per_octave * work->seen.octaves[line], whole = floor(where);
        int64_t low = (int64_t)clipped(whole, -1e9, 1e9);
        out->low[line] = low;
        for (int tap = 0; tap < 2; tap++) {
            double height = work->seen.lines[line] * (tap ? where - whole : 1.0 - (where - whole));
            int64_t at = low + tap < 0 ? 0 : low + tap > bands - 1 ? bands - 1 : low + tap;
            double wide = TWO_PI * t->kappa[at], tone = height * passed * up[at];
            double sum = tone * hand->rubbed + height * leaned * (wave * wave + hand->flank * wide * wide) * aside[at];
            out->lines[tap * stride + line] = sum;
            if (at == low + tap) {
                out->power[at] += sum;
                normal += tone;
            }
        }
    }
    *out->normal = normal;
}

/* tokens: (states, token_size). scratch: as contact_work_in asks for. out: power, noise (states, bands), normal
 * (states,), lines (2, states, 2 * token_bands), low (states, 2 * token_bands). */
void hnf_linear_contact(const hnf_tables *t, const double *tokens, int64_t token_size, const hnf_touch *touch,
                        int64_t states, double *scratch, const hnf_contact *out)
{
    int64_t lines = 2 * t->token_bands;
    contact_work work = contact_work_in(t, scratch);
    for (int64_t state = 0; state < states; state++) {
        hnf_contact one = {
            out->power + state * t->bands, out->noise + state * t->bands, out->normal + state,
            out->lines + state * lines, out->low + state * lines,
        };
        contact_of(t, &work, tokens + state * token_size, touch + state, states * lines, &one);
    }
}
