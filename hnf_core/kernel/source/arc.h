/* Reading an octave of carriers in arc length, for a hop and for a live hand. */
#ifndef HNF_ARC_H
#define HNF_ARC_H

#include "hnf_kernel.h"

void read_arc(const hnf_carriers *c, const float *amplitude, int64_t stride, const hnf_complex *const *pieces,
              const hnf_reading *reading, const double *place, const int64_t *row, const float *share, float *scratch,
              float *out);

#endif
