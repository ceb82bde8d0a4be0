/* From states to what F_Theta takes, and from what it answers to amplitudes: the twins of build_inputs
 * (hnf_core/field/features.py) and _in_numpy (field.py), where the reasons stand. */
#include <math.h>
#include <string.h>

#include "contact.h"
#include "elementary.h"
#include "fades.h"
#include "hnf_kernel.h"

static inline double log_amplitude(double power, double quiet) { return 0.5 * log_of(power + quiet); }

/* Power of each band in time when the surface passes at a speed: power (bands,) per arc band. */
static void in_time(const hnf_emitter *e, const double *power, int64_t bands, double per_octave, double speed,
                    double *sums, double *out)
{
    double octaves = per_octave * log2(speed), before = 0.0;
    sums[0] = 0.0;
    for (int64_t k = 0; k < bands; k++)
        sums[k + 1] = sums[k] + power[k];
    for (int64_t edge = 0; edge <= e->time_bands; edge++) {
        double place = clipped(e->time_edge[edge] - octaves, 0.0, (double)bands);
        int64_t low = (int64_t)place < bands ? (int64_t)place : bands - 1;
        double here = sums[low] + (place - (double)low) * (sums[low + 1] - sums[low]);
        if (edge)
            out[edge - 1] = here - before;
        before = here;
    }
}

/* The token as the stroke meets it, where the field is told it so. */
static void token_of(const hnf_tables *t, const hnf_emitter *e, const double *token, const hnf_motion *m, float *x)
{
    for (int64_t i = 0; i < e->token_size; i++)
        x[i] = (float)((token[i] - e->token_shift[i]) * e->token_scale[i]);
    if (!e->stroke_frame)
        return;
    double angle = atan2(m->y, m->x);
    for (int fold = 2; fold <= 4; fold += 2) {
        double c = cos(fold * angle), s = sin(fold * angle);
        int64_t re = fold == 2 ? t->cos2 : t->cos4, im = fold == 2 ? t->sin2 : t->sin4;
        for (int64_t band = 0; band < t->token_bands; band++) {
            const double *f = token + band * t->features;
            float *to = x + band * t->features;
            to[re] = (float)((f[re] * c + f[im] * s - e->token_shift[band * t->features + re])
                             * e->token_scale[band * t->features + re]);
            to[im] = (float)((f[im] * c - f[re] * s - e->token_shift[band * t->features + im])
                             * e->token_scale[band * t->features + im]);
        }
    }
}

/* x (states, inputs), which may be NULL, and what is expected. fixed: (states, fixed) inputs as they are. scratch: what
 * hnf_linear_contact needs, and 3 * arc bands + time bands + 1 + 4 * token bands more. */
void hnf_inputs(const hnf_tables *t, const hnf_emitter *e, const double *tokens, int64_t token_stride,
                const double *fixed, const hnf_motion *motion, const hnf_touch *touch, int64_t states, double *scratch,
                float *x, const hnf_expected *expected)
{
    int64_t lines = 2 * t->token_bands;
    double *power = scratch, *noise = power + t->bands, *sums = noise + t->bands, *in_bands = sums + t->bands + 1;
    double *line = in_bands + e->time_bands, normal;
    contact_work work = contact_work_in(t, line + 2 * lines);
    for (int64_t state = 0; state < states; state++) {
        const hnf_motion *m = motion + state;
        double *prior = expected->prior + state * e->carriers, *level = expected->line + state * 2 * lines, all = 0.0;
        hnf_contact contact = {power, noise, &normal, line, expected->low + state * lines};
        contact_of(t, &work, tokens + state * token_stride, touch + state, lines, &contact);
        in_time(e, power, t->bands, t->per_octave, m->speed, sums, in_bands);
        for (int64_t band = 0; band < e->time_bands; band++)
            prior[band] = log_amplitude(in_bands[band] * e->time_share, e->quiet_power);
        const double *own = e->line_gains ? noise : power;
        for (int64_t k = 0; k < t->bands; k++)
            prior[e->time_bands + k] = log_amplitude(own[k], e->quiet_power);
        for (int64_t j = 0; j < 2 * lines; j++)
            level[j] = line[j] + e->quiet_line_power;
        if (!x)
            continue;
        for (int64_t k = 0; k < t->bands; k++)
            all += power[k];
        float *to = x + state * e->inputs;
        token_of(t, e, tokens + state * token_stride, m, to);
        for (int64_t i = 0; i < e->fixed; i++)
            to[e->fixed_at + i] = (float)fixed[state * e->fixed + i];
        int told = e->directed && !e->stroke_frame;
        to += e->direction_at;
        *to++ = told ? (float)m->x : 0.0f;
        *to++ = told ? (float)m->y : 0.0f;
        *to++ = (float)log(m->speed / e->pace);
        *to++ = (float)log(m->force);
        for (int64_t band = 0; band < e->time_bands; band++)
            *to++ = (float)((log_amplitude(in_bands[band], e->quiet_power) + 5.0) / 3.0);
        *to++ = (float)(0.5 * log_amplitude(all, e->quiet_power));
        *to++ = (float)(0.5 * log(m->mass * sqrt(normal) / m->force + 1e-3));
        *to = (float)log(m->resonance / e->pitch);
    }
}

/* NaN where either is, as of numpy's minimum: a network that is broken is not to be the loudest of all. b: a number. */
static inline double least(double a, double b) { return a > b ? b : a; }

/* Power of the tones and their harmonics per arc band. gain: (harmonics, lines) logs; level: (2, lines) powers. room:
 * (2 * lines,). */
static void ringing(const hnf_tables *t, const hnf_emitter *e, const float *gain, const double *level,
                    const int64_t *low, double *room, double *out)
{
    int64_t lines = 2 * t->token_bands;
    double most = exp_of(2.0 * e->ceiling);
    memset(out, 0, (size_t)t->bands * sizeof(double));
    for (int64_t order = 0; order < e->harmonics; order++, gain += lines) {
        for (int64_t line = 0; line < lines; line++) {
            double louder = exp_of(2.0 * (gain[line] + e->harmonic_start[order]));
            room[line] = least(louder * level[line], most);
            room[lines + line] = least(louder * level[lines + line], most);
        }
        for (int64_t line = 0; line < lines; line++) {
            int64_t at = low[line] + e->harmonic_shift[order];
            if (at >= 0 && at < t->bands)
                out[at] += room[line];
            if (at >= -1 && at < t->bands - 1)
                out[at + 1] += room[lines + line];
        }
    }
}

/* alpha (states, carriers) of what the head answers (states, outputs): per band in time, per knot of arc length, and a
 * log gain for each tone and its harmonics. scratch: 2 * arc bands + 4 * token bands. */
void hnf_emitted(const hnf_tables *t, const hnf_emitter *e, const float *head, const hnf_motion *motion,
                 const hnf_expected *expected, int64_t states, double *scratch, double *alpha)
{
    int64_t lines = 2 * t->token_bands, gains = e->line_gains ? e->harmonics * lines : 0;
    double *tones = scratch, *own = tones + t->bands, *room = own + t->bands;
    memset(tones, 0, (size_t)t->bands * sizeof(double));
    for (int64_t state = 0; state < states; state++, head += e->outputs) {
        const hnf_motion *m = motion + state;
        const double *prior = expected->prior + state * e->carriers, *skip = e->skip;
        const float *knots = head + e->time_bands;
        double *out = alpha + state * e->carriers;
        if (m->moving == 0.0) {
            memset(out, 0, (size_t)e->carriers * sizeof(double));
            continue;
        }
        for (int64_t band = 0; band < e->time_bands; band++)
            out[band] = m->moving * exp_of(least(head[band] + skip[band] * prior[band], e->ceiling));
        out += e->time_bands;
        prior += e->time_bands;
        skip += e->time_bands;
        if (gains)
            ringing(t, e, head + e->outputs - gains, expected->line + state * 2 * lines, expected->low + state * lines,
                    room, tones);
        for (int64_t k = 0; k < t->bands; k++) {
            const float *knot = knots + e->knot[k];
            double share = e->knot_share[k];
            own[k] = knot[0] + (share > 0.0 ? share * (knot[1] - knot[0]) : 0.0);
        }
        for (int64_t k = 0; k < t->bands; k++) {
            double noise = exp_of(least(own[k] + skip[k] * prior[k], e->ceiling));
            out[k] = sqrt(noise * noise + tones[k]) * m->moving * arc_gain(t->kappa[k] * m->speed);
        }
    }
}

/* Twin of take_tones (hnf_core/field/contact/lattice_lines.py), with the fades of field.py's _take_tones. */
void hnf_take_tones(const hnf_tables *t, const hnf_emitter *e, const float *head, const hnf_motion *motion,
                    const hnf_expected *expected, int64_t states, const hnf_path_lines *lines)
{
    int64_t all = 2 * t->token_bands;
    double most = exp_of(2.0 * e->ceiling);
    for (int64_t state = 0; state < states; state++, head += e->outputs) {
        const float *gain = head + e->outputs - e->harmonics * all;
        double *level = expected->line + state * 2 * all;
        for (int64_t line = 0; line < lines->count; line++) {
            int64_t at = state * lines->count + line, column = lines->column[at];
            double *tone = lines->tones + at * e->harmonics, *below = level + column, *above = below + all;
            memset(tone, 0, (size_t)e->harmonics * sizeof(double));
            if (lines->pitch[at] <= 0.0)
                continue;
            for (int64_t order = 0; order < e->harmonics; order++) {
                double louder = exp_of(2.0 * (gain[order * all + column] + e->harmonic_start[order])), power = 0.0;
                int64_t low = expected->low[state * all + column] + e->harmonic_shift[order];
                if (low >= 0 && low < t->bands)
                    power += least(louder * *below, most);
                if (low >= -1 && low < t->bands - 1)
                    power += least(louder * *above, most);
                double hertz = (double)(order + 1) * lines->along[at] * motion[state].speed;
                tone[order] = sqrt(power) * arc_gain(hertz) * motion[state].moving;
            }
            *below = *above = 0.0;
        }
    }
}

/* Variance of a line's phase at which hardly a line is left [rad^2], and the largest share of a carrier that is lines';
 * LARGEST_SPREAD and MOST_TAKEN of lattice_lines.py, as what follows is the twin of its gather_sidebands. */
#define LARGEST_SPREAD 1.0
#define MOST_TAKEN 0.9
#define TAU 6.283185307179586

/* The carriers within an octave of a line: place of the line, first and last carrier. */
typedef struct { double place; int64_t first, last; } near_line;

static near_line near_of(const hnf_tables *t, double along)
{
    double place = t->per_octave * log2((along > 1e-9 ? along : 1e-9) / t->kappa[0]);
    near_line near = {place, (int64_t)ceil(clipped(place - t->per_octave, 0.0, (double)t->bands)),
                      (int64_t)floor(clipped(place + t->per_octave, -1.0, (double)(t->bands - 1)))};
    return near;
}

/* Sum of power (bands,) near a line, weighted by 1 at the line to 0 an octave away; four sums at once, since each waits
 * for itself. */
static double sum_near(near_line near, double per_band, const double *power)
{
    double sum[4] = {0.0, 0.0, 0.0, 0.0}, offset = (double)near.first - near.place;
    int64_t k = near.first;
    for (; k + 3 <= near.last; k += 4, offset += 4.0)
        for (int j = 0; j < 4; j++)
            sum[j] += (1.0 - fabs(offset + (double)j) * per_band) * power[k + j];
    for (; k <= near.last; k++, offset += 1.0)
        sum[0] += (1.0 - fabs(offset) * per_band) * power[k];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

void hnf_gather_sidebands(const hnf_tables *t, const hnf_emitter *e, int64_t states, const hnf_path_lines *lines,
                          double *scratch, double *alpha)
{
    double *taken = scratch, *power = taken + t->bands, *share = power + t->bands, per_band = 1.0 / t->per_octave;
    for (int64_t state = 0; state < states; state++) {
        double *arc = alpha + state * e->carriers + e->time_bands;
        double *tones = lines->tones + state * lines->count * e->harmonics;
        if (lines->scatter[state] <= 0.0)
            continue;
        memset(taken, 0, (size_t)t->bands * sizeof(double));
        for (int64_t k = 0; k < t->bands; k++)
            power[k] = arc[k] * arc[k];
        /* What each line asks of the carriers, then what all together leave it. */
        for (int64_t line = 0; line < lines->count; line++) {
            int64_t at = state * lines->count + line;
            double *tone = tones + line * e->harmonics, phase = TAU * lines->pitch[at] * lines->scatter[state];
            double spread = phase * phase < LARGEST_SPREAD ? phase * phase : LARGEST_SPREAD;
            double wanted = tone[0] * tone[0] * expm1(spread), available = 0.0;
            share[line] = 0.0;
            if (wanted <= 0.0)
                continue;
            near_line near = near_of(t, lines->along[at]);
            available = sum_near(near, per_band, power);
            if (available <= 0.0)
                continue;
            share[line] = wanted / available;
            for (int64_t k = near.first; k <= near.last; k++)
                taken[k] += share[line] * (1.0 - fabs((double)k - near.place) * per_band);
        }
        for (int64_t k = 0; k < t->bands; k++)
            power[k] *= taken[k] > MOST_TAKEN ? MOST_TAKEN / taken[k] : 1.0;
        for (int64_t line = 0; line < lines->count; line++) {
            double *tone = tones + line * e->harmonics;
            near_line near = near_of(t, lines->along[state * lines->count + line]);
            if (share[line] > 0.0)
                tone[0] = sqrt(tone[0] * tone[0] + share[line] * sum_near(near, per_band, power));
        }
        for (int64_t k = 0; k < t->bands; k++)
            arc[k] *= sqrt(1.0 - (taken[k] < MOST_TAKEN ? taken[k] : MOST_TAKEN));
    }
}
