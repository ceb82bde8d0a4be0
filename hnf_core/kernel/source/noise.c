/* Noise bands as waves: the twins of band_bins (hnf_core/field/carriers.py) and of real_waves and complex_waves
 * (hnf_core/field/carriers.py). */
#include <math.h>

#include "sums.h"

#define TWO_PI 6.283185307179586476925
#define WORDS 4
#define PARTS 2
#define TILE (PARTS * LANES)

static uint64_t product(uint64_t a, uint64_t b, uint64_t *high)
{
    unsigned __int128 wide = (unsigned __int128)a * b;
    *high = (uint64_t)(wide >> 64);
    return (uint64_t)wide;
}

/* Philox4x64-10 (Salmon et al. 2011), numbered as numpy numbers its words: those from WORDS * group on. */
static void words_of(uint64_t seed, uint64_t stream, uint64_t block, uint64_t group, uint64_t *out)
{
    uint64_t c[WORDS] = {group + 1, block, 0, 0}, key[2] = {seed, stream};
    for (int round = 0; round < 10; round++) {
        uint64_t high0, high1, low0 = product(0xD2E7470EE14C6C93u, c[0], &high0);
        uint64_t low1 = product(0xCA5A826395121157u, c[2], &high1);
        uint64_t next[WORDS] = {high1 ^ c[1] ^ key[0], low1, high0 ^ c[3] ^ key[1], low0};
        for (int i = 0; i < WORDS; i++)
            c[i] = next[i];
        key[0] += 0x9E3779B97F4A7C15u;
        key[1] += 0xBB67AE8584CAA73Bu;
    }
    for (int i = 0; i < WORDS; i++)
        out[i] = c[i];
}

/* Words one after another, wherever one begins. */
typedef struct {
    uint64_t seed, stream, block, next, kept[WORDS];
} words;

static inline double uniform(words *from)
{
    if (from->next % WORDS == 0)
        words_of(from->seed, from->stream, from->block, from->next / WORDS, from->kept);
    return ((double)(from->kept[from->next++ % WORDS] >> 11) + 0.5) * 0x1p-53;
}

static words words_from(uint64_t seed, uint64_t stream, uint64_t block, int64_t first)
{
    words from = {seed, stream, block, (uint64_t)first, {0}};
    if (first % WORDS)
        words_of(seed, stream, block, (uint64_t)first / WORDS, from.kept);
    return from;
}

/* Bins first ... first + count - 1 of a block of `pairs`, by Box and Muller: out[2 i], out[2 i + 1] = level[i]
 * sqrt(-2 log u) (cos, sin) 2 pi v, of word first + i for u and word pairs + first + i for v. */
void hnf_bins(uint64_t seed, uint64_t stream, uint64_t block, int64_t pairs, int64_t first, int64_t count,
              const double *level, double *out)
{
    words radius = words_from(seed, stream, block, first), angle = words_from(seed, stream, block, pairs + first);
    for (int64_t i = 0; i < count; i++) {
        double far = level[i] * sqrt(-2.0 * log(uniform(&radius))), turn = TWO_PI * uniform(&angle);
        out[2 * i] = far * cos(turn);
        out[2 * i + 1] = far * sin(turn);
    }
}

/* Of sum_w X_w e^(2 pi i w n / size), X = x + i y, all that is needed at n and at -n: sums of x cos, y sin, y cos and
 * x sin. */
typedef struct { lanes xc[PARTS], ys[PARTS], yc[PARTS], xs[PARTS]; } halves;

/* TILE samples from `at` on. bins: (width,) X. slow: (2 * widest, half) cosines of w = 0 ... widest - 1, then sines. */
static inline __attribute__((always_inline)) halves envelope(const double *bins, int64_t width, int64_t widest,
                                                             int64_t half, const float *slow, int64_t at)
{
    halves sum = {0};
    for (int64_t w = 0; w < width; w++) {
        const lanes *cosine = (const lanes *)(slow + w * half + at);
        const lanes *sine = (const lanes *)(slow + (widest + w) * half + at);
        float x = (float)bins[2 * w], y = (float)bins[2 * w + 1];
        for (int j = 0; j < PARTS; j++) {
            sum.xc[j] += x * cosine[j];
            sum.ys[j] += y * sine[j];
            sum.yc[j] += y * cosine[j];
            sum.xs[j] += x * sine[j];
        }
    }
    return sum;
}

/* The middle, n = size / 2, where sines are 0 and cosines turn with w. */
static void middle_of(const double *bins, int64_t width, float *re, float *im)
{
    *re = *im = 0.0f;
    for (int64_t w = 0; w < width; w++) {
        *re += (w & 1 ? -1.0f : 1.0f) * (float)bins[2 * w];
        *im += (w & 1 ? -1.0f : 1.0f) * (float)bins[2 * w + 1];
    }
}

static lanes turned_round(lanes v) { return __builtin_shufflevector(v, v, 7, 6, 5, 4, 3, 2, 1, 0); }

/* v times the window at size - at, size - at - 1, ...; what would stand at `size` is left out. */
static void put_mirrored(lanes v, const float *window, int64_t size, int64_t at, float *out)
{
    if (at) {
        int64_t to = size - at - (LANES - 1);
        *(lanes *)(out + to) = turned_round(v) * *(const lanes *)(window + to);
        return;
    }
    for (int k = 1; k < LANES; k++)
        out[size - k] = v[k] * window[size - k];
}

/* Rows `which` of out (every band, size): 2 Re of each band's envelope on its first turn, under the window (size,).
 * size: a multiple of 2 TILE. slow, cosine, sine (bands, half): of half = size / 2 + 1 samples, which say the rest. */
void hnf_real_waves(const double *bins, const int64_t *starts, const int64_t *which, int64_t bands, int64_t widest,
                    int64_t size, const float *slow, const float *cosine, const float *sine, const float *window,
                    float *out)
{
    int64_t half = size / 2 + 1;
    for (int64_t at = 0; at < size / 2; at += TILE) {
        for (int64_t i = 0; i < bands; i++) {
            const int64_t *band = starts + which[i];
            float *to = out + which[i] * size;
            halves sum = envelope(bins + 2 * (band[0] - starts[0]), band[1] - band[0], widest, half, slow, at);
            for (int j = 0; j < PARTS; j++) {
                int64_t here = at + j * LANES;
                lanes c = 2.0f * *(const lanes *)(cosine + i * half + here);
                lanes s = 2.0f * *(const lanes *)(sine + i * half + here);
                lanes ahead = (sum.xc[j] - sum.ys[j]) * c - (sum.yc[j] + sum.xs[j]) * s;
                *(lanes *)(to + here) = ahead * *(const lanes *)(window + here);
                put_mirrored((sum.xc[j] + sum.ys[j]) * c + (sum.yc[j] - sum.xs[j]) * s, window, size, here, to);
            }
        }
    }
    for (int64_t i = 0; i < bands; i++) {
        const int64_t *band = starts + which[i];
        int64_t end = i * half + half - 1;
        float re, im;
        middle_of(bins + 2 * (band[0] - starts[0]), band[1] - band[0], &re, &im);
        out[which[i] * size + half - 1] = 2.0f * (re * cosine[end] - im * sine[end]) * window[half - 1];
    }
}

static void put_pairs(lanes re, lanes im, float *out)
{
    *(lanes *)out = __builtin_shufflevector(re, im, 0, 8, 1, 9, 2, 10, 3, 11);
    *(lanes *)(out + LANES) = __builtin_shufflevector(re, im, 4, 12, 5, 13, 6, 14, 7, 15);
}

/* out (bands, size): the same, complex. */
void hnf_complex_waves(const double *bins, const int64_t *starts, int64_t bands, int64_t widest, int64_t size,
                       const float *slow, const float *cosine, const float *sine, const float *window, hnf_complex *out)
{
    int64_t half = size / 2 + 1;
    for (int64_t at = 0; at < size / 2; at += TILE) {
        for (int64_t band = 0; band < bands; band++) {
            float *to = (float *)(out + band * size);
            halves sum = envelope(bins + 2 * (starts[band] - starts[0]), starts[band + 1] - starts[band], widest, half,
                                  slow, at);
            for (int j = 0; j < PARTS; j++) {
                int64_t here = at + j * LANES, back = size - here - (LANES - 1);
                lanes c = *(const lanes *)(cosine + band * half + here), s = *(const lanes *)(sine + band * half + here);
                lanes re = sum.xc[j] - sum.ys[j], im = sum.yc[j] + sum.xs[j], w = *(const lanes *)(window + here);
                put_pairs((re * c - im * s) * w, (re * s + im * c) * w, to + 2 * here);
                re = sum.xc[j] + sum.ys[j], im = sum.yc[j] - sum.xs[j];
                lanes mirrored_re = re * c + im * s, mirrored_im = im * c - re * s;
                if (here) {
                    w = *(const lanes *)(window + back);
                    put_pairs(turned_round(mirrored_re) * w, turned_round(mirrored_im) * w, to + 2 * back);
                    continue;
                }
                for (int k = 1; k < LANES; k++) {
                    to[2 * (size - k)] = mirrored_re[k] * window[size - k];
                    to[2 * (size - k) + 1] = mirrored_im[k] * window[size - k];
                }
            }
        }
    }
    for (int64_t band = 0; band < bands; band++) {
        int64_t end = band * half + half - 1;
        float re, im, w = window[half - 1];
        middle_of(bins + 2 * (starts[band] - starts[0]), starts[band + 1] - starts[band], &re, &im);
        out[band * size + half - 1] = (hnf_complex){(re * cosine[end] - im * sine[end]) * w,
                                                    (re * sine[end] + im * cosine[end]) * w};
    }
}
