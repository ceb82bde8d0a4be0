/* Rows of numbers, weighted and summed: what every carrier ends in. */
#ifndef HNF_SUMS_H
#define HNF_SUMS_H

#include "hnf_kernel.h"

/* Eight numbers at once, whatever the processor's own vectors are. */
typedef float lanes __attribute__((vector_size(32), aligned(4)));
#define LANES 8

/* Groups of LANES numbers, at these places of each of so many rows, `stride` apart, weighted with before and with after:
 * side by side, since each sum waits for the row before. */
static inline __attribute__((always_inline)) void sum_lanes(const float *before, const float *after, int64_t rows,
                                                            const float *row, int64_t stride, int groups,
                                                            const int64_t *at, float *here, float *next)
{
    lanes one[4] = {0}, two[4] = {0};
    for (int64_t k = 0; k < rows; k++, row += stride) {
        float a = before[k], b = after[k];
        for (int g = 0; g < groups; g++) {
            lanes x = *(const lanes *)(row + at[g]);
            one[g] += a * x;
            two[g] += b * x;
        }
    }
    for (int g = 0; g < groups; g++) {
        *(lanes *)(here + at[g]) = one[g];
        *(lanes *)(next + at[g]) = two[g];
    }
}

/* here[j] = sum of before[k] row_k[j], next[j] = sum of after[k] row_k[j], j < count. */
static inline void sum_rows(const float *before, const float *after, int64_t rows, const float *row, int64_t stride,
                            int64_t count, float *here, float *next)
{
    int64_t done = 0;
    for (; done + 4 * LANES <= count; done += 4 * LANES) {
        int64_t at[4] = {done, done + LANES, done + 2 * LANES, done + 3 * LANES};
        sum_lanes(before, after, rows, row, stride, 4, at, here, next);
    }
    if (done == count)
        return;
    if (count >= LANES) { /* the last group begins where it fits, over what the one before it has */
        int64_t last = count - LANES;
        int64_t at[4] = {done < last ? done : last, done + LANES < last ? done + LANES : last,
                         done + 2 * LANES < last ? done + 2 * LANES : last, last};
        switch ((count - done + LANES - 1) / LANES) {
        case 1: sum_lanes(before, after, rows, row, stride, 1, at, here, next); return;
        case 2: sum_lanes(before, after, rows, row, stride, 2, at, here, next); return;
        case 3: sum_lanes(before, after, rows, row, stride, 3, at, here, next); return;
        default: sum_lanes(before, after, rows, row, stride, 4, at, here, next); return;
        }
    }
    for (int64_t at = done; at < count; at++) {
        here[at] = next[at] = 0.0f;
        for (int64_t k = 0; k < rows; k++) {
            here[at] += before[k] * row[k * stride + at];
            next[at] += after[k] * row[k * stride + at];
        }
    }
}

#endif
