/* What lies between the rows of a table: the twin of between in hnf_core/field/adaptive.py. */
#include "hnf_kernel.h"

#include <string.h>

/* out[i] = sum over `terms` of factor * (values[row] + share * (values[row + 1] - values[row])), rows of width numbers;
 * row, share, factor: (count, terms). */
void hnf_between_rows(const double *values, int64_t width, const int64_t *row, const double *share,
                      const double *factor, int64_t terms, int64_t count, double *out)
{
    for (int64_t i = 0; i < count; i++, row += terms, share += terms, factor += terms, out += width) {
        memset(out, 0, (size_t)width * sizeof(double));
        for (int64_t term = 0; term < terms; term++) {
            const double *before = values + row[term] * width, *after = before + width;
            double far = factor[term] * share[term], near = factor[term] - far;
            if (factor[term] == 0.0)
                continue;
            for (int64_t k = 0; k < width; k++)
                out[k] += near * before[k] + far * after[k];
        }
    }
}
