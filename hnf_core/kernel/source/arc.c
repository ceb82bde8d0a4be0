/* The carriers in arc length, modulated: the twin of _in_arc in hnf_core/field/carrier_rendering.py and of _read_plainly in
 * field/live/carriers.py. */
#include <math.h>
#include <string.h>

#include "arc.h"
#include "sine.h"
#include "sums.h"

#define TILE 64

/* Bands summed on cells `begin` ... `begin + width - 1`, with the amplitudes at the knot before and at the one after. */
static void summed(const float *before, const float *after, int64_t bands, const hnf_complex *const *hops,
                   int64_t hop_cells, int64_t begin, int64_t width, float *here, float *next)
{
    for (int64_t at = 0; at < width;) {
        int64_t hop = (begin + at) / hop_cells, inside = (begin + at) % hop_cells;
        int64_t many = hop_cells - inside < width - at ? hop_cells - inside : width - at;
        sum_rows(before, after, bands, (const float *)(hops[hop] + inside), 2 * hop_cells, 2 * many, here + 2 * at,
                 next + 2 * at);
        at += many;
    }
}

/* Adds sum over an octave's bands of A_k(t) Re(c_k(s(t)) e^(2 pi i turns s)) to out.
 *
 * amplitude: of its first band at the first knot. pieces: of all readings. place, row, share, out: of the samples that
 * are read. scratch: 4 numbers for each cell between the first and the last that are read. Bands are summed once on
 * the cells that a stretch between two knots covers, and then read there by cubic weights. */
void read_arc(const hnf_carriers *c, const float *amplitude, int64_t stride, const hnf_complex *const *pieces,
              const hnf_reading *reading, const double *place, const int64_t *row, const float *share, float *scratch,
              float *out)
{
    const hnf_complex *const *hops = pieces + reading->piece;
    double cells_per_m = c->cells_per_m[reading->octave], turns_per_cell = c->turns;
    const float *cubic = c->cubic;
    int64_t count = reading->count;
    lanes power[4];
    for (int tap = 0; tap < 4; tap++)
        for (int p = 0; p < 4; p++)
            power[p][2 * tap] = power[p][2 * tap + 1] = cubic[4 * tap + p];
    for (int64_t low = 0, high; low < count; low = high) {
        high = hnf_stretch_end(row, low, count);
        double least = place[low], most = place[low];
        for (int64_t j = low + 1; j < high; j++) {
            least = place[j] < least ? place[j] : least;
            most = place[j] > most ? place[j] : most;
        }
        int64_t begin = (int64_t)floor(least * cells_per_m) - 1;
        int64_t width = (int64_t)floor(most * cells_per_m) + 3 - begin;
        const float *before = amplitude + row[low] * stride;
        float *here = scratch, *next = scratch + 2 * width;
        summed(before, before + stride, c->bands, hops, c->piece_cells, begin - reading->piece_cell, width, here, next);
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
            float re[TILE], im[TILE];
            for (int64_t j = 0; j < many; j++) {
                /* Four complex cells at once, on the way from one knot's sums to the other's. */
                lanes h = *(const lanes *)(here + 2 * cell[j]), n = *(const lanes *)(next + 2 * cell[j]);
                lanes weight = ((power[3] * t[j] + power[2]) * t[j] + power[1]) * t[j] + power[0];
                lanes read = weight * (h + share[at + j] * (n - h));
                re[j] = (read[0] + read[4]) + (read[2] + read[6]);
                im[j] = (read[1] + read[5]) + (read[3] + read[7]);
            }
            for (int64_t j = 0; j < many; j++)
                out[at + j] += re[j] * sine(turn[j] + 0.25f) - im[j] * sine(turn[j]);
        }
    }
}

/* out[i] = sum over the octaves of all readings, at samples i < count. amplitude: (knots, octaves * bands), stride
 * apart. scratch: 2 numbers for each cell of the longest reading. */
void hnf_read_arcs(const hnf_carriers *c, const float *amplitude, int64_t stride, const hnf_complex *const *pieces,
                   const hnf_reading *readings, int64_t readings_count, const double *place, const int64_t *row,
                   const float *share, int64_t count, double *scratch, float *out)
{
    memset(out, 0, (size_t)count * sizeof(float));
    for (const hnf_reading *r = readings; r < readings + readings_count; r++)
        read_arc(c, amplitude + r->octave * c->bands, stride, pieces, r, place + r->start, row + r->start,
                 share + r->start, (float *)scratch, out + r->start);
}
