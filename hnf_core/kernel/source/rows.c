/* What lies between the rows of a table: the twin of between in hnf_core/field/adaptive_sampling.py. */
#include "hnf_kernel.h"

#include <string.h>

#define TILE 128

/* out[i] = sum over `terms` of factor * (values[row] + share * (values[row + 1] - values[row])), rows of width numbers,
 * summed in double; row, share, factor: (count, terms). */
void hnf_between_rows(const float *values, int64_t width, const int64_t *row, const double *share,
                      const double *factor, int64_t terms, int64_t count, float *out)
{
    for (int64_t i = 0; i < count; i++, row += terms, share += terms, factor += terms, out += width) {
        for (int64_t at = 0; at < width; at += TILE) {
            int64_t many = width - at < TILE ? width - at : TILE;
            double sum[TILE];
            memset(sum, 0, sizeof sum);
            for (int64_t term = 0; term < terms; term++) {
                const float *before = values + row[term] * width + at, *after = before + width;
                double far = factor[term] * share[term], near = factor[term] - far;
                if (factor[term] == 0.0)
                    continue;
                for (int64_t k = 0; k < many; k++)
                    sum[k] += near * (double)before[k] + far * (double)after[k];
            }
            for (int64_t k = 0; k < many; k++)
                out[at + k] = (float)sum[k];
        }
    }
}
