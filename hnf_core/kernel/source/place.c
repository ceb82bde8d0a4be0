/* Where the hand is between the states of the action: the twin of position_beyond in hnf_core/field/plain.py. */
#include "hnf_kernel.h"

/* Catmull and Rom's spline, t on the way from state to the next, both of which exist. */
static inline double spline(const double *position, int64_t states, int64_t state, double t)
{
    double one = position[state], two = position[state + 1];
    double before = state > 0 ? position[state - 1] : 2.0 * one - two;
    double after = state < states - 2 ? position[state + 2] : 2.0 * two - one;
    return 0.5 * t * (2.0 * t - 1.0 - t * t) * before + (1.0 + t * t * (1.5 * t - 2.5)) * one
           + 0.5 * t * (1.0 + 4.0 * t - 3.0 * t * t) * two + 0.5 * t * t * (t - 1.0) * after;
}

/* s(t) through position (states,), two at least, at samples start ... start + count - 1; beyond the ends it goes on as
 * fast as it began and ended. */
void hnf_place(const double *position, int64_t states, int64_t samples_per_state, int64_t start, int64_t count,
               double *out)
{
    int64_t last = (states - 1) * samples_per_state, end = start + count;
    double step = 1.0 / (double)samples_per_state;
    double begun = spline(position, states, 0, step) - position[0];
    double ended = position[states - 1] - spline(position, states, states - 2, 1.0 - step);
    int64_t at = start;
    for (; at < end && at < 0; at++)
        out[at - start] = position[0] + (double)at * begun;
    while (at < end && at < last) {
        int64_t state = at / samples_per_state, first = state * samples_per_state;
        int64_t stop = first + samples_per_state < end ? first + samples_per_state : end;
        for (; at < stop; at++)
            out[at - start] = spline(position, states, state, (double)(at - first) * step);
    }
    for (; at < end; at++)
        out[at - start] = position[states - 1] + (double)(at - last) * ended;
}
