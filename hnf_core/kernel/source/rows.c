/* What lies between the rows of a table: the twin of Sampled.add_alpha in hnf_core/field/adaptive.py. */
#include "hnf_kernel.h"

/* out[i] += factor[i] * (values[row[i]] + share[i] * (values[row[i] + 1] - values[row[i]])), rows of width numbers. */
void hnf_add_rows(const double *values, int64_t width, const int64_t *row, const double *share, const double *factor,
                  int64_t count, double *out)
{
    for (int64_t i = 0; i < count; i++) {
        const double *before = values + row[i] * width, *after = before + width;
        double far = factor[i] * share[i], near = factor[i] - far, *to = out + i * width;
        for (int64_t k = 0; k < width; k++)
            to[k] += near * before[k] + far * after[k];
    }
}
