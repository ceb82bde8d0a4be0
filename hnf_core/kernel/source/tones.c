/* Tones of regular surfaces: the twin of render_line in hnf_core/field/tones.py. */
#include "hnf_kernel.h"

#include <math.h>

#include "fades.h"
#include "sine.h"

#define STRETCH 256

/* Samples of a stretch, in segments between the same two states and the same two knots; how far each is on the way to the
 * next knot, and the displacement of the lines there. */
typedef struct {
    int64_t segments, end[STRETCH], state[STRETCH], row[STRETCH];
    float share[STRETCH];
    double x[STRETCH], y[STRETCH];
} places;

static void find_places(const hnf_tones_course *c, const hnf_displacement *d, const double *position, int64_t first,
                        int64_t count, int64_t *row, places *out)
{
    int64_t last_state = c->states > 2 ? c->states - 2 : 0, last_row = c->knot_count > 1 ? c->knot_count - 2 : 0;
    int64_t state = first < 0 ? 0 : first / c->per_state;
    out->segments = 0;
    for (int64_t j = 0, stop = 0; j < count; j = stop) {
        int64_t sample = first + j;
        while (sample >= (state + 1) * c->per_state)
            state++;
        while (*row < last_row && c->knots[*row + 1] <= sample)
            ++*row;
        stop = count;
        if (state < last_state && (state + 1) * c->per_state - first < stop)
            stop = (state + 1) * c->per_state - first;
        if (*row < last_row && c->knots[*row + 1] - first < stop)
            stop = c->knots[*row + 1] - first;
        out->state[out->segments] = state < last_state ? state : last_state;
        out->row[out->segments] = *row, out->end[out->segments++] = stop;
        double from = (double)c->knots[*row], gap = c->knot_count > 1 ? (double)c->knots[*row + 1] - from : 1.0;
        double per_sample = 1.0 / (gap > 1.0 ? gap : 1.0);
        for (int64_t i = j; i < stop; i++)
            out->share[i] = (float)clipped(((double)(first + i) - from) * per_sample, 0.0, 1.0);
    }
    for (int64_t j = 0; j < count && d->points > 1; j++) {
        double place = clipped((position[j] - d->start) * d->per_m, 0.0, (double)(d->points - 1));
        int64_t low = (int64_t)place < d->points - 2 ? (int64_t)place : d->points - 2;
        const double *x = d->grid + low, *y = x + d->points;
        double part = place - (double)low;
        out->x[j] = x[0] + part * (x[1] - x[0]), out->y[j] = y[0] + part * (y[1] - y[0]);
    }
}

/* out += sum over a line's harmonics h = 1, 2, ... of sqrt(2) A_h sin 2 pi (h phase + offset_h). The sine and cosine of
 * each harmonic follow from those of the one before and of the first. */
static void add_line(const hnf_tones_course *c, int64_t line, const places *at, int64_t count, int is_displaced,
                     const double *way, double *out)
{
    int64_t width = c->harmonics * c->lines, next = c->knot_count > 1 ? width : 0;
    double turns[STRETCH];
    float strength[STRETCH], sine_1[STRETCH], cosine_1[STRETCH], sine_h[STRETCH], cosine_h[STRETCH];
    for (int64_t i = 0, j = 0; i < at->segments; i++) {
        int64_t entry = at->state[i] * c->lines + line, end = at->end[i];
        const double *shift = c->scatter + 2 * at->state[i] * c->lines + line;
        double begin = c->turns[entry], per_m = c->between[entry];
        double along_x = is_displaced ? shift[0] : 0.0, along_y = is_displaced ? shift[c->lines] : 0.0;
        if (is_displaced)
            for (int64_t k = j; k < end; k++)
                turns[k] = begin + per_m * way[k] + (along_x * at->x[k] + along_y * at->y[k]);
        else
            for (int64_t k = j; k < end; k++)
                turns[k] = begin + per_m * way[k];
        j = end;
    }
    for (int64_t j = 0; j < count; j++)
        sine_1[j] = (float)(turns[j] - floor(turns[j]));
    for (int64_t j = 0; j < count; j++) {
        cosine_h[j] = cosine_1[j] = sine(sine_1[j] + 0.25f);
        sine_h[j] = sine_1[j] = sine(sine_1[j]);
    }
    for (int64_t order = 0; order < c->harmonics; order++) {
        int64_t column = line * c->harmonics + order;
        int sounds = 0;
        float offset = (float)(c->offsets[column] - floor(c->offsets[column]));
        float in_phase = 1.41421356f * sine(offset + 0.25f), quadrature = 1.41421356f * sine(offset);
        if (order)
            for (int64_t j = 0; j < count; j++) {
                float before = sine_h[j];
                sine_h[j] = before * cosine_1[j] + cosine_h[j] * sine_1[j];
                cosine_h[j] = cosine_h[j] * cosine_1[j] - before * sine_1[j];
            }
        for (int64_t i = 0, j = 0; i < at->segments; i++) {
            const double *a = c->amplitude + at->row[i] * width + column;
            float from = (float)a[0], rise = (float)(a[next] - a[0]);
            sounds |= a[0] > 0.0 || a[next] > 0.0;
            for (; j < at->end[i]; j++)
                strength[j] = from + at->share[j] * rise;
        }
        if (!sounds)
            continue;
        for (int64_t j = 0; j < count; j++)
            out[j] += strength[j] * (in_phase * sine_h[j] + quadrature * cosine_h[j]);
    }
}

void hnf_tones(const hnf_tones_course *course, const hnf_displacement *displacement, const double *way,
               const double *position, int64_t start, int64_t count, double *out)
{
    places at;
    int64_t row = 0;
    for (int64_t first = 0; first < count; first += STRETCH) {
        int64_t many = count - first < STRETCH ? count - first : STRETCH;
        find_places(course, displacement, position + first, start + first, many, &row, &at);
        for (int64_t line = 0; line < course->lines; line++)
            add_line(course, line, &at, many, displacement->points > 1, way + first, out + first);
    }
}
