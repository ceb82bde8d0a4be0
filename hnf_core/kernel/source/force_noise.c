/* Force noise of friction and the response of the probe's body: the twin of ForceNoise in
 * hnf_core/field/force_noise.py. */
#include "hnf_kernel.h"

#include <math.h>

#include "elementary.h"
#include "fades.h"

/* noise, body: (carriers,) power of one state at a scale of 1, and the body's gain. */
static void compute_noise(const hnf_friction *t, const hnf_rubbing *rubbing, double *noise, double *body)
{
    double log_speed = log_of(rubbing->speed);
    double place = clipped(t->per_octave * (log_speed - t->log_least_speed) / LOG_OF_2, 0.0, (double)(t->rows - 1));
    int64_t row = (int64_t)(place + 0.5);
    const double *gain = t->gain + row, *arc_body = t->body + row;
    double *arc = noise + t->time_bands;
    for (int64_t k = 0; k < t->time_bands; k++)
        body[k] = t->time_body[k];
    for (int64_t k = 0; k < t->arc_bands; k++)
        body[t->time_bands + k] = arc_body[k * t->step];
    if (t->loads > 1) {
        double load = clipped(t->loads_per_octave * (log_of(rubbing->force) - t->log_least_force) / LOG_OF_2, 0.0,
                              (double)(t->loads - 1));
        int64_t low = (int64_t)load < t->loads - 2 ? (int64_t)load : t->loads - 2;
        double share = load - (double)low;
        const double *below = t->log_loads + low * t->arc_bands, *above = below + t->arc_bands;
        for (int64_t k = 0; k < t->arc_bands; k++)
            arc[k] = exp_of(below[k] * (1.0 - share) + above[k] * share) * gain[k * t->step];
        for (int64_t k = 0; k < t->time_bands; k++)
            noise[k] = 0.0;
        return;
    }
    double load = exp_of(t->force_exponent * log_of(rubbing->force)), pace = exp_of(-t->exponent * log_speed);
    for (int64_t k = 0; k < t->arc_bands; k++)
        arc[k] = load * t->bands[k] * gain[k * t->step];
    for (int64_t k = 0; k < t->time_bands; k++) {
        double from = t->time_power[k] * pace, to = t->time_power[k + 1] * pace;
        from = from > t->time_start ? from : t->time_start;
        to = to > t->time_start ? to : t->time_start;
        noise[k] = (to - from) * load * t->time_gain[k];
    }
}

void hnf_force_noise(const hnf_friction *tables, const hnf_rubbing *rubbing, const int64_t *rows, int64_t states,
                     int64_t heads, int64_t stride, double *scratch, double *alpha)
{
    int64_t carriers = tables->time_bands + tables->arc_bands;
    double *noise = scratch, *body = scratch + carriers;
    for (int64_t i = 0; i < states; i++) {
        compute_noise(tables, rubbing + i, noise, body);
        double scale = rubbing[i].scale;
        for (int64_t head = 0; head < heads; head++) {
            double *a = alpha + (rows[i] * heads + head) * stride;
            for (int64_t k = 0; k < carriers; k++)
                a[k] = sqrt((a[k] * a[k] + noise[k] * scale) * body[k]);
        }
    }
}

void hnf_body_gains(const hnf_friction *tables, const double *frequency, int64_t count, double *out)
{
    double last = (double)tables->size - 1.001;
    for (int64_t j = 0; j < count; j++) {
        double f = frequency[j] > 1e-9 ? frequency[j] : 1e-9;
        double place = clipped(tables->per_octave * (log_of(f) - tables->log_first_hz) / LOG_OF_2, 0.0, last);
        int64_t low = (int64_t)place;
        const double *body = tables->body + low;
        out[j] = sqrt(body[0] + (place - (double)low) * (body[1] - body[0]));
    }
}
