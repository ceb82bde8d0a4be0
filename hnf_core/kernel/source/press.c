/* What a hand that presses harder or less hard makes felt: the twin of FilterBank.force_term in
 * hnf_core/field/contact/contact_filter.py. */
#include "hnf_kernel.h"

#include <string.h>

#define MOST_SAMPLES 64

static inline double at_state(const double *values, int64_t states, int64_t state)
{
    return values[state < 0 ? 0 : state < states ? state : states - 1];
}

/* sum[j] = sum over rows of force at states first, first + 1, ... times row[j]. */
static void added_up(const double *force, int64_t states, int64_t first, int64_t rows, const double *row,
                     int64_t samples, double *sum)
{
    memset(sum, 0, (size_t)samples * sizeof(double));
    int64_t r = 0;
    for (; r + 4 <= rows; r += 4, row += 4 * samples) {
        double one = at_state(force, states, first + r), two = at_state(force, states, first + r + 1);
        double three = at_state(force, states, first + r + 2), four = at_state(force, states, first + r + 3);
        const double *second = row + samples, *third = second + samples, *fourth = third + samples;
        for (int64_t j = 0; j < samples; j++)
            sum[j] += (one * row[j] + two * second[j]) + (three * third[j] + four * fourth[j]);
    }
    for (; r < rows; r++, row += samples) {
        double one = at_state(force, states, first + r);
        for (int64_t j = 0; j < samples; j++)
            sum[j] += one * row[j];
    }
}

/* out (count, samples): acceleration from states first ... first + count - 1 on, each to the next.
 *
 * force: (states,), held beyond its ends. weight: (states, contacts) of each contact, linear in between. given: per
 * contact what 1 N in the states about a state's samples adds to them, (rows, samples), the earliest first; the last
 * `ahead` of them come after the state's own. samples: 64 at most. Where all the states that count press alike there
 * is nothing, exactly. */
void hnf_press(const double *force, int64_t states, const double *weight, int64_t contacts,
               const double *const *given, const int64_t *rows, int64_t ahead, int64_t samples, int64_t first,
               int64_t count, double *out)
{
    int64_t alike = 0, longest = 1; /* states up to the last that counts, which press as that one does */
    for (int64_t c = 0; c < contacts; c++)
        longest = rows[c] > longest ? rows[c] : longest;
    for (int64_t back = 1; back <= longest; back++, alike++)
        if (at_state(force, states, first + ahead - back) != at_state(force, states, first + ahead - 1))
            break;
    for (int64_t state = first; state < first + count; state++, out += samples) {
        int same = at_state(force, states, state + ahead) == at_state(force, states, state + ahead - 1);
        alike = same ? alike + 1 : 1;
        memset(out, 0, (size_t)samples * sizeof(double));
        const double *now = weight + contacts * (state < 0 ? 0 : state < states ? state : states - 1);
        const double *next = state >= 0 && state < states - 1 ? now + contacts : now;
        for (int64_t c = 0; c < contacts; c++) {
            double sum[MOST_SAMPLES], rise = (next[c] - now[c]) / (double)samples;
            if (alike >= rows[c] || (now[c] == 0.0 && next[c] == 0.0))
                continue;
            added_up(force, states, state + ahead + 1 - rows[c], rows[c], given[c], samples, sum);
            for (int64_t j = 0; j < samples; j++)
                out[j] += (now[c] + rise * (double)j) * sum[j];
        }
    }
}
