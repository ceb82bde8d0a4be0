/* Where a course bends: the twin of bends in hnf_core/field/adaptive_sampling.py. */
#include <math.h>

#include "hnf_kernel.h"

/* course: (states, channels). kept: (states,) whether a state is one of those between which straight lines go, the first
 * and the last among them; on return, more are, until no channel is off its line by more than `bent`. */
void hnf_bends(const double *course, int64_t states, int64_t channels, double bent, uint8_t *kept)
{
    for (int64_t low = 0; low < states - 1;) {
        int64_t high = low + 1, worst = low;
        double farthest = bent;
        while (!kept[high])
            high++;
        for (int64_t at = low + 1; at < high; at++) {
            double share = (double)(at - low) / (double)(high - low);
            for (int64_t k = 0; k < channels; k++) {
                double begin = course[low * channels + k], rise = course[high * channels + k] - begin;
                double off = fabs(course[at * channels + k] - (begin + share * rise));
                if (off > farthest) {
                    farthest = off;
                    worst = at;
                }
            }
        }
        if (worst > low)
            kept[worst] = 1;
        else
            low = high;
    }
}
