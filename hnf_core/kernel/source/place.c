/* Where the hand is between the states of the action: the twin of position_beyond in hnf_core/field/stroke.py. */
#include "hnf_kernel.h"

/* Catmull and Rom's spline from a state to the next, both of which exist: powers of the way. */
typedef struct { double none, one, two, three; } powers;

static powers spline(const double *position, int64_t states, int64_t state)
{
    double here = position[state], next = position[state + 1];
    double before = state > 0 ? position[state - 1] : 2.0 * here - next;
    double after = state < states - 2 ? position[state + 2] : 2.0 * next - here;
    return (powers){here, 0.5 * (next - before), before - 2.5 * here + 2.0 * next - 0.5 * after,
                    0.5 * (after - before) + 1.5 * (here - next)};
}

static inline double read(powers p, double t) { return p.none + t * (p.one + t * (p.two + t * p.three)); }

/* s(t) through position (states,), two at least, at samples start ... start + count - 1; beyond the ends it goes on as
 * fast as it began and ended. */
void hnf_place(const double *position, int64_t states, int64_t samples_per_state, int64_t start, int64_t count,
               double *out)
{
    int64_t last = (states - 1) * samples_per_state, end = start + count;
    double step = 1.0 / (double)samples_per_state;
    double begun = read(spline(position, states, 0), step) - position[0];
    double ended = position[states - 1] - read(spline(position, states, states - 2), 1.0 - step);
    int64_t at = start;
    for (; at < end && at < 0; at++)
        out[at - start] = position[0] + (double)at * begun;
    while (at < end && at < last) {
        int64_t state = at / samples_per_state, first = state * samples_per_state;
        int64_t stop = first + samples_per_state < end ? first + samples_per_state : end;
        powers here = spline(position, states, state);
        for (; at < stop; at++)
            out[at - start] = read(here, (double)(at - first) * step);
    }
    for (; at < end; at++)
        out[at - start] = position[states - 1] + (double)(at - last) * ended;
}
