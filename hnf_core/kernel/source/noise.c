/* Noise bands as waves: the twins of band_bins (hnf_core/field/noise.py) and of real_waves and complex_waves
 * (hnf_core/field/band_waves.py). */
#include <math.h>

#include "sums.h"

#define TILE 32
#define TWO_PI 6.283185307179586476925

static double uniform(uint64_t word)
{
    return ((double)(word >> 11) + 0.5) * 0x1p-53;
}

/* Box and Muller's pairs from raw words: out[2 i], out[2 i + 1] = level * sqrt(-2 log u) * (cos, sin) 2 pi v. */
void hnf_bins(const uint64_t *radius, const uint64_t *angle, const double *level, int64_t count, double *out)
{
    for (int64_t i = 0; i < count; i++) {
        double far = level[i] * sqrt(-2.0 * log(uniform(radius[i]))), turn = TWO_PI * uniform(angle[i]);
        out[2 * i] = far * cos(turn);
        out[2 * i + 1] = far * sin(turn);
    }
}

#define PARTS (TILE / LANES)

typedef struct { lanes re[PARTS], im[PARTS]; } tile;

/* TILE samples from `at` on of sum_w X_w e^(2 pi i w n / size), under the window that slow carries.
 *
 * bins: (width,) X, real and imaginary. slow: (2 * widest, size) cosines of w = 0 ... widest - 1, then sines. */
static inline tile envelope(const double *bins, int64_t width, int64_t widest, int64_t size, const float *slow,
                            int64_t at)
{
    tile sum = {0};
    for (int64_t w = 0; w < width; w++) {
        const lanes *cosine = (const lanes *)(slow + w * size + at);
        const lanes *sine = (const lanes *)(slow + (widest + w) * size + at);
        float x = (float)bins[2 * w], y = (float)bins[2 * w + 1];
        for (int j = 0; j < PARTS; j++) {
            sum.re[j] += x * cosine[j] - y * sine[j];
            sum.im[j] += y * cosine[j] + x * sine[j];
        }
    }
    return sum;
}

/* Rows `which` of out (every band, size): 2 Re of each band's envelope on its first turn, cosine and sine (bands,
 * size). size: a multiple of TILE. */
void hnf_real_waves(const double *bins, const int64_t *starts, const int64_t *which, int64_t bands, int64_t widest,
                    int64_t size, const float *slow, const float *cosine, const float *sine, float *out)
{
    for (int64_t at = 0; at < size; at += TILE) {
        for (int64_t i = 0; i < bands; i++) {
            const int64_t *band = starts + which[i];
            const lanes *c = (const lanes *)(cosine + i * size + at), *s = (const lanes *)(sine + i * size + at);
            lanes *to = (lanes *)(out + which[i] * size + at);
            tile sum = envelope(bins + 2 * (band[0] - starts[0]), band[1] - band[0], widest, size, slow, at);
            for (int j = 0; j < PARTS; j++)
                to[j] = 2.0f * (sum.re[j] * c[j] - sum.im[j] * s[j]);
        }
    }
}

/* out (bands, size): the same, complex. */
void hnf_complex_waves(const double *bins, const int64_t *starts, int64_t bands, int64_t widest, int64_t size,
                       const float *slow, const float *cosine, const float *sine, hnf_complex *out)
{
    for (int64_t at = 0; at < size; at += TILE) {
        for (int64_t band = 0; band < bands; band++) {
            hnf_complex *to = out + band * size + at;
            const lanes *c = (const lanes *)(cosine + band * size + at), *s = (const lanes *)(sine + band * size + at);
            tile sum = envelope(bins + 2 * (starts[band] - starts[0]), starts[band + 1] - starts[band], widest, size,
                                slow, at);
            for (int j = 0; j < PARTS; j++) {
                lanes re = sum.re[j] * c[j] - sum.im[j] * s[j], im = sum.re[j] * s[j] + sum.im[j] * c[j];
                for (int k = 0; k < LANES; k++)
                    to[j * LANES + k] = (hnf_complex){re[k], im[k]};
            }
        }
    }
}
