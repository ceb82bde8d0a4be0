/* The carriers, modulated: the twins of _faded and _in_arc in hnf_core/field/texture.py. */
#include <math.h>
#include <string.h>

#include "hnf_kernel.h"

#define TILE 64

/* Samples from `at` on that lie between the same two knots: where they end. */
static int64_t stretch_end(const int64_t *row, int64_t at, int64_t count)
{
    int64_t here = row[at];
    do {
        at++;
    } while (at < count && row[at] == here);
    return at;
}

/* Sum over bands of A_k(t) c_k(t), A linear between knots. waves: (bands, count). */
void hnf_faded(const float *amplitude, int64_t stride, int64_t bands, const float *waves, int64_t count,
               const int64_t *row, const float *share, float *out)
{
    for (int64_t low = 0, high; low < count; low = high) {
        high = stretch_end(row, low, count);
        const float *before = amplitude + row[low] * stride, *after = before + stride;
        for (int64_t at = low; at < high; at += TILE) {
            int64_t many = high - at < TILE ? high - at : TILE;
            float here[TILE] = {0}, next[TILE] = {0};
            for (int64_t band = 0; band < bands; band++) {
                const float *wave = waves + band * count + at;
                float a = before[band], b = after[band];
                for (int64_t j = 0; j < many; j++) {
                    here[j] += a * wave[j];
                    next[j] += b * wave[j];
                }
            }
            for (int64_t j = 0; j < many; j++)
                out[at + j] = here[j] + share[at + j] * (next[j] - here[j]);
        }
    }
}

/* sin 2 pi x for |x| <= 1/4, by its series: what is left out is 6e-8. */
static inline float sine_of_turn(float x)
{
    float z = x * x;
    return x * (6.28318531f + z * (-41.3417022f + z * (81.6052493f + z * (-76.7058598f + z * (42.0586939f
           + z * -15.0946426f)))));
}

/* sin 2 pi x for any x of moderate size. */
static inline float sine(float x)
{
    float part = x - rintf(x);
    float half = part > 0.0f ? 0.5f : -0.5f;
    return sine_of_turn(fabsf(part) > 0.25f ? half - part : part);
}

/* Bands summed on cells `begin` ... `begin + width - 1`, with the amplitudes at the knot before and at the one after. */
static void summed(const float *before, const float *after, int64_t bands, const hnf_complex *const *hops,
                   int64_t hop_cells, int64_t begin, int64_t width, float *restrict here, float *restrict next)
{
    memset(here, 0, (size_t)width * sizeof(hnf_complex));
    memset(next, 0, (size_t)width * sizeof(hnf_complex));
    for (int64_t at = 0; at < width;) {
        int64_t hop = (begin + at) / hop_cells, inside = (begin + at) % hop_cells;
        int64_t many = hop_cells - inside < width - at ? hop_cells - inside : width - at;
        for (int64_t band = 0; band < bands; band++) {
            const float *wave = (const float *)(hops[hop] + band * hop_cells + inside);
            float a = before[band], b = after[band];
            for (int64_t j = 0; j < 2 * many; j++) {
                here[2 * at + j] += a * wave[j];
                next[2 * at + j] += b * wave[j];
            }
        }
        at += many;
    }
}

/* Adds sum over an octave's bands of A_k(t) Re(c_k(s(t)) e^(2 pi i turns s)) to out.
 *
 * hops: neighbouring pieces (bands, hop_cells) of c from first_cell on, which no place comes nearer than a cell before
 * or two after. scratch: 4 numbers for each cell between the first and the last that are read. Bands are summed once on
 * the cells that a stretch between two knots covers, and then read there by cubic weights. */
void hnf_read_arc(const float *amplitude, int64_t stride, int64_t bands, const hnf_complex *const *hops,
                  int64_t hop_cells, int64_t first_cell, double cells_per_m, double turns_per_cell,
                  const double *place, const float *cubic, const int64_t *row, const float *share, int64_t count,
                  float *scratch, float *out)
{
    for (int64_t low = 0, high; low < count; low = high) {
        high = stretch_end(row, low, count);
        double least = place[low], most = place[low];
        for (int64_t j = low + 1; j < high; j++) {
            least = place[j] < least ? place[j] : least;
            most = place[j] > most ? place[j] : most;
        }
        int64_t begin = (int64_t)floor(least * cells_per_m) - 1;
        int64_t width = (int64_t)floor(most * cells_per_m) + 3 - begin;
        const float *before = amplitude + row[low] * stride;
        float *here = scratch, *next = scratch + 2 * width;
        summed(before, before + stride, bands, hops, hop_cells, begin - first_cell, width, here, next);
        for (int64_t at = low; at < high; at += TILE) {
            int64_t many = high - at < TILE ? high - at : TILE;
            int32_t cell[TILE];
            float t[TILE], turn[TILE];
            for (int64_t j = 0; j < many; j++) {
                double where = place[at + j] * cells_per_m, whole = floor(where), turns = where * turns_per_cell;
                t[j] = (float)(where - whole);
                cell[j] = (int32_t)((int64_t)whole - 1 - begin);
                turn[j] = (float)(turns - floor(turns));
            }
            for (int64_t j = 0; j < many; j++) {
                const float *h = here + 2 * cell[j], *n = next + 2 * cell[j];
                float hre = 0.0f, him = 0.0f, nre = 0.0f, nim = 0.0f;
                for (int tap = 0; tap < 4; tap++) {
                    const float *power = cubic + 4 * tap;
                    float weight = ((power[3] * t[j] + power[2]) * t[j] + power[1]) * t[j] + power[0];
                    hre += weight * h[2 * tap];
                    him += weight * h[2 * tap + 1];
                    nre += weight * n[2 * tap];
                    nim += weight * n[2 * tap + 1];
                }
                float re = hre + share[at + j] * (nre - hre), im = him + share[at + j] * (nim - him);
                out[at + j] += re * sine(turn[j] + 0.25f) - im * sine(turn[j]);
            }
        }
    }
}
