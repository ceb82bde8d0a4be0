/* Rows of numbers, weighted and summed: what every carrier ends in. */
#ifndef HNF_SUMS_H
#define HNF_SUMS_H

#include "hnf_kernel.h"

/* Eight numbers at once, whatever the processor's own vectors are. */
typedef float lanes __attribute__((vector_size(32), aligned(4)));
#define LANES 8

/* groups * LANES numbers of each of so many rows, `stride` apart, weighted with before and with after. */
static inline __attribute__((always_inline)) void sum_lanes(const float *before, const float *after, int64_t rows,
                                                            const float *row, int64_t stride, int groups, float *here,
                                                            float *next)
{
    lanes one[4] = {0}, two[4] = {0};
    for (int64_t k = 0; k < rows; k++, row += stride) {
        float a = before[k], b = after[k];
        for (int g = 0; g < groups; g++) {
            lanes x = *(const lanes *)(row + g * LANES);
            one[g] += a * x;
            two[g] += b * x;
        }
    }
    for (int g = 0; g < groups; g++) {
        *(lanes *)(here + g * LANES) = one[g];
        *(lanes *)(next + g * LANES) = two[g];
    }
}

/* here[j] = sum of before[k] row_k[j], next[j] = sum of after[k] row_k[j], j < count. */
static inline void sum_rows(const float *before, const float *after, int64_t rows, const float *row, int64_t stride,
                            int64_t count, float *here, float *next)
{
    int64_t at = 0;
    for (; at + 4 * LANES <= count; at += 4 * LANES)
        sum_lanes(before, after, rows, row + at, stride, 4, here + at, next + at);
    for (; at + LANES <= count; at += LANES)
        sum_lanes(before, after, rows, row + at, stride, 1, here + at, next + at);
    if (at == count)
        return;
    if (count >= LANES) { /* the last ones once more, with those before them */
        at = count - LANES;
        sum_lanes(before, after, rows, row + at, stride, 1, here + at, next + at);
        return;
    }
    for (; at < count; at++) {
        here[at] = next[at] = 0.0f;
        for (int64_t k = 0; k < rows; k++) {
            here[at] += before[k] * row[k * stride + at];
            next[at] += after[k] * row[k * stride + at];
        }
    }
}

#endif
