/* Tones of regular surfaces: the twin of render_line in hnf_core/field/tones.py. */
#include "hnf_kernel.h"

#include <math.h>

#include "fades.h"
#include "sine.h"

#define STRETCH 256

/* out += sum over a line's harmonics of sqrt(2) A_h sin 2 pi (h phase + offset). */
static void sounding(const hnf_tones_course *c, int64_t line, const hnf_displacement *d, const double *way,
                     const double *position, int64_t start, int64_t count, double *out)
{
    int64_t row = 0, has_next = c->knot_count > 1, last = has_next ? c->knot_count - 2 : 0;
    int64_t next = has_next ? c->harmonics * c->lines : 0;
    for (int64_t at = 0; at < count; at += STRETCH) {
        int64_t many = count - at < STRETCH ? count - at : STRETCH;
        double turns[STRETCH];
        float strength[STRETCH], phase[STRETCH];
        int64_t rows[STRETCH];
        float share[STRETCH];
        for (int64_t j = 0; j < many; j++) {
            int64_t sample = start + at + j, state = sample < 0 ? 0 : sample / c->per_state;
            state = state > c->states - 2 ? c->states - 2 : state;
            state = state < 0 ? 0 : state;
            turns[j] = c->turns[state * c->lines + line] + c->between[state * c->lines + line] * way[at + j];
            if (d->points > 1) {
                const double *shift = c->scatter + state * 2 * c->lines + line;
                double place = clipped((position[at + j] - d->start) * d->per_m, 0.0, (double)(d->points - 1));
                int64_t low = (int64_t)place < d->points - 2 ? (int64_t)place : d->points - 2;
                const double *x = d->grid + low, *y = x + d->points;
                double part = place - (double)low;
                turns[j] += shift[0] * (x[0] + part * (x[1] - x[0])) + shift[c->lines] * (y[0] + part * (y[1] - y[0]));
            }
            while (row < last && c->knots[row + 1] <= sample)
                row++;
            rows[j] = row;
            double gap = next ? (double)(c->knots[row + 1] - c->knots[row]) : 1.0;
            double part = (double)(sample - c->knots[row]) / (gap > 1.0 ? gap : 1.0);
            share[j] = (float)(part < 0.0 ? 0.0 : part > 1.0 ? 1.0 : part);
        }
        for (int64_t order = 0; order < c->harmonics; order++) {
            int64_t column = line * c->harmonics + order;
            float loudest = 0.0f;
            for (int64_t j = 0; j < many; j++) {
                const double *a = c->amplitude + rows[j] * c->harmonics * c->lines + column;
                strength[j] = (float)(a[0] + share[j] * (a[next] - a[0]));
                loudest = strength[j] > loudest ? strength[j] : loudest;
            }
            if (loudest <= 0.0f)
                continue;
            double factor = c->factors[order], offset = c->offsets[column];
            for (int64_t j = 0; j < many; j++) {
                double x = factor * turns[j] + offset;
                phase[j] = (float)(x - floor(x));
            }
            for (int64_t j = 0; j < many; j++)
                out[at + j] += 1.41421356f * strength[j] * sine(phase[j]);
        }
    }
}

void hnf_tones(const hnf_tones_course *course, const hnf_displacement *displacement, const double *way,
               const double *position, int64_t start, int64_t count, double *out)
{
    for (int64_t line = 0; line < course->lines; line++)
        sounding(course, line, displacement, way, position, start, count, out);
}
