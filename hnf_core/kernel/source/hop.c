/* Hops of carriers in time and in arc length, modulated: the twin of texture_hops in hnf_core/field/carrier_rendering.py. */
#include <math.h>
#include <string.h>

#include "arc.h"
#include "sums.h"

#define TILE 64

static int64_t least_of(int64_t a, int64_t b) { return a < b ? a : b; }
static int64_t most_of(int64_t a, int64_t b) { return a > b ? a : b; }
/* Toward plus infinity. */
static int64_t shifted_up(int64_t value, int64_t level) { return -(-value >> level); }

/* value << level, which is undefined in C of what is negative. */
static int64_t shifted_back(int64_t value, int64_t level) { return value * ((int64_t)1 << level); }

static int64_t kept_count(const hnf_carriers *c, int64_t level) { return (c->hop >> level) + 2 * c->margin[level]; }
static int64_t kept_first(const hnf_carriers *c, int64_t first, int64_t level)
{
    return first - (c->margin[level] << level);
}

/* Whether any of an octave's amplitudes at a knot is not zero. */
static int loud(const hnf_knots *k, int64_t knot, int64_t column, int64_t bands)
{
    const float *row = k->amplitude + knot * k->stride + column;
    float any = 0.0f;
    for (int64_t band = 0; band < bands; band++)
        any = row[band] != 0.0f ? 1.0f : any;
    return any != 0.0f;
}

/* The first sample of low ... high - 1 that a rate keeps, and how many they are. */
static void kept(const hnf_carriers *c, int64_t first, int64_t level, int64_t low, int64_t high, hnf_reading *out)
{
    int64_t begin = kept_first(c, first, level), end = first + c->hop + (c->margin[level] << level);
    out->level = level;
    out->start = shifted_back(shifted_up(most_of(low, begin), level), level);
    out->count = most_of(shifted_up(least_of(high, end) - out->start, level), 0);
}

/* Of neighbouring samples: where they are, and how far apart at most. */
typedef struct { double least, most, fastest; } extent;

static extent extent_of(const double *place, int64_t count)
{
    /* Four of each at once, since each waits for the one before it. */
    double least[4] = {*place, *place, *place, *place}, most[4] = {*place, *place, *place, *place}, fastest[4] = {0};
    int64_t i = 0;
    for (; i + 4 < count; i += 4) {
        for (int j = 0; j < 4; j++) {
            double here = place[i + j], step = fabs(place[i + j + 1] - here);
            least[j] = here < least[j] ? here : least[j];
            most[j] = here > most[j] ? here : most[j];
            fastest[j] = step > fastest[j] ? step : fastest[j];
        }
    }
    for (; i < count; i++) {
        least[0] = place[i] < least[0] ? place[i] : least[0];
        most[0] = place[i] > most[0] ? place[i] : most[0];
        double step = i + 1 < count ? fabs(place[i + 1] - place[i]) : 0.0;
        fastest[0] = step > fastest[0] ? step : fastest[0];
    }
    for (int j = 1; j < 4; j++) {
        least[0] = least[j] < least[0] ? least[j] : least[0];
        most[0] = most[j] > most[0] ? most[j] : most[0];
        fastest[0] = fastest[j] > fastest[0] ? fastest[j] : fastest[0];
    }
    return (extent){least[0], most[0], fastest[0]};
}

/* One stretch of an octave that is nowhere too fast to sound, as a reading. Returns whether there is any. */
static int reading_of(const hnf_carriers *c, int64_t first, int64_t octave, int64_t low, int64_t high, extent about,
                      hnf_reading *out)
{
    int64_t level = c->levels - 1;
    double top = 2.0 * ldexp(c->lowest, (int)octave) * about.fastest * c->rate;
    while (level && top > ldexp(c->highest * c->rate, -(int)level))
        level--;
    kept(c, first, level, low, high, out);
    out->octave = octave;
    out->first_cell = (int64_t)floor(about.least * c->cells_per_m[octave]) - 1;
    out->last_cell = (int64_t)floor(about.most * c->cells_per_m[octave]) + 2;
    return out->count > 0;
}

static int64_t noted(int64_t found, int64_t room, const hnf_reading *one, hnf_reading *out)
{
    if (found < room)
        out[found] = *one;
    return found + 1;
}

/* What of samples low ... high - 1 is not too fast for an octave to sound, as readings from `found` on; how many there
 * are now. A jump of the hand, whose amplitudes are zero, would ask for metres of cells. all: of the whole hop and what
 * is about it. */
static int64_t readings_in(const hnf_carriers *c, int64_t first, const double *place, extent all, int64_t octave,
                           int64_t low, int64_t high, int64_t found, int64_t room, hnf_reading *out)
{
    double limit = c->band_end / (ldexp(c->lowest, (int)octave) * c->rate);
    int64_t begin = first - c->reach;
    const double *at = place - begin;
    hnf_reading one;
    if (low >= high)
        return found;
    int whole = low == begin && high == first + c->hop + c->reach;
    extent about = whole ? all : extent_of(at + low, high - low);
    if (about.fastest < limit)
        return reading_of(c, first, octave, low, high, about, &one) ? noted(found, room, &one, out) : found;
    for (int64_t from = low, to; from < high; from = to + 1) {
        for (to = from; to + 1 < high && fabs(at[to + 1] - at[to]) < limit;)
            to++;
        /* A sample between two steps that are too fast belongs to neither. */
        if (to > from && reading_of(c, first, octave, from, to + 1, extent_of(at + from, to + 1 - from), &one))
            found = noted(found, room, &one, out);
    }
    return found;
}

/* Of ascending numbers: how many are less than, or no more than, a limit. */
static int64_t below(const int64_t *at, int64_t count, int64_t limit, int also)
{
    int64_t low = 0;
    while (low < count) {
        int64_t middle = low + (count - low) / 2;
        if (at[middle] < limit || (also && at[middle] == limit))
            low = middle + 1;
        else
            count = middle;
    }
    return low;
}

/* The knots that say what happens in the hop at sample `first` and about it. */
static hnf_knots around(const hnf_carriers *c, const hnf_knots *k, int64_t first)
{
    int64_t low = below(k->at, k->count, first - c->reach, 1) - 1;
    int64_t high = below(k->at, k->count, first + c->hop + c->reach, 0) + 1;
    low = least_of(most_of(low, 0), k->count - 2);
    high = most_of(least_of(high, k->count), 2);
    return (hnf_knots){k->at + low, k->amplitude + low * k->stride, high - low, k->stride};
}

/* Where each octave is to be read in one hop, as readings from `found` on: beside knots that are loud. */
static int64_t plan_hop(const hnf_carriers *c, const hnf_knots *k, int64_t first, const double *place, int64_t found,
                        int64_t room, hnf_reading *out)
{
    int64_t begin = first - c->reach, end = first + c->hop + c->reach;
    extent all = extent_of(place, end - begin);
    for (int64_t octave = 0; octave < c->octaves; octave++) {
        int64_t column = c->arc_first + octave * c->bands;
        int before = loud(k, 0, column, c->bands);
        int64_t from = -1; /* the knot with which a loud stretch begins */
        for (int64_t knot = 1; knot < k->count; knot++) {
            int here = loud(k, knot, column, c->bands), on = before || here;
            if (on && from < 0)
                from = knot - 1;
            int64_t last = on ? knot : knot - 1; /* the knot with which it ends */
            if (from >= 0 && (!on || knot == k->count - 1)) {
                int64_t low = from ? most_of(k->at[from], begin) : begin;
                int64_t high = last < k->count - 1 ? least_of(k->at[last], end) : end;
                found = readings_in(c, first, place, all, octave, low, high, found, room, out);
                from = -1;
            }
            before = here;
        }
    }
    return found;
}

/* Where each octave is to be read in `hops` hops from sample `first` on. place: s [m] from reach samples before it to as
 * many behind the last. counts: (hops,) readings of each. Returns how many there are in all; the first `room` of them
 * are in out. */
int64_t hnf_plan_hops(const hnf_carriers *c, const hnf_knots *k, int64_t first, int64_t hops, const double *place,
                      int64_t room, hnf_reading *out, int64_t *counts)
{
    int64_t found = 0;
    for (int64_t hop = 0; hop < hops; hop++, first += c->hop, place += c->hop) {
        hnf_knots near = around(c, k, first);
        int64_t now = plan_hop(c, &near, first, place, found, room, out);
        counts[hop] = now - found;
        found = now;
    }
    return found;
}

/* Where a rate's samples lie between knots, and on the surface. */
typedef struct {
    int64_t *row;
    float *share, *sum;
    double *place;
} rate_samples;

static void placed(const hnf_carriers *c, const hnf_knots *k, int64_t first, const double *place, int64_t level,
                   const rate_samples *out)
{
    int64_t start = kept_first(c, first, level), count = kept_count(c, level), begin = first - c->reach, row = 0;
    for (int64_t i = 0; i < count; i++)
        out->place[i] = place[start + (i << level) - begin];
    for (int64_t low = 0; low < count;) {
        while (row < k->count - 2 && k->at[row + 1] <= start + (low << level))
            row++;
        int64_t high = row < k->count - 2 ? least_of(shifted_up(k->at[row + 1] - start, level), count) : count;
        double span = 1.0 / (double)(k->at[row + 1] - k->at[row]);
        for (int64_t i = low; i < high; i++) {
            double share = (double)(start + (i << level) - k->at[row]) * span;
            share = share > 0.0 ? share : 0.0;
            out->share[i] = (float)(share < 1.0 ? share : 1.0);
            out->row[i] = row;
        }
        low = high;
    }
}

/* out = sum over bands of A_k(t) c_k(t), A linear between knots. waves: (bands, count). */
static void faded(const float *amplitude, int64_t stride, int64_t bands, const float *waves, int64_t count,
                  const int64_t *row, const float *share, float *out)
{
    for (int64_t low = 0, high; low < count; low = high) {
        high = hnf_stretch_end(row, low, count);
        const float *before = amplitude + row[low] * stride;
        for (int64_t at = low; at < high; at += TILE) {
            int64_t many = least_of(high - at, TILE);
            float here[TILE], next[TILE];
            sum_rows(before, before + stride, bands, waves + at, count, many, here, next);
            for (int64_t j = 0; j < many; j++)
                out[at + j] = here[j] + share[at + j] * (next[j] - here[j]);
        }
    }
}

/* Adds what a rate holds to the next one up. */
static void add_twice(const hnf_carriers *c, int64_t level, const float *values, float *out)
{
    int64_t wanted = c->margin[level - 1], count = kept_count(c, level - 1) / 2;
    const float *at = values + (c->margin[level] - wanted / 2);
    for (int64_t j = 0; j < count; j++)
        out[2 * j] += at[j];
    for (int64_t low = 0; low < count; low += TILE) {
        int64_t many = least_of(count - low, TILE);
        float between[TILE] = {0};
        for (int64_t tap = 0; tap < 2 * c->taps; tap++) {
            float weight = c->half_band[tap];
            const float *from = at + low + tap - c->taps + 1;
            for (int64_t j = 0; j < many; j++)
                between[j] += weight * from[j];
        }
        for (int64_t j = 0; j < many; j++)
            out[2 * (low + j) + 1] += between[j];
    }
}

/* out (hop,) = sum over all carriers of A_k c_k from sample `first` on. */
static void one_hop(const hnf_carriers *c, const hnf_knots *k, int64_t first, const double *place,
                    const float *const *time_waves, const hnf_complex *const *pieces, const hnf_reading *readings,
                    int64_t count, double *scratch, double *out)
{
    rate_samples rates[8];
    for (int64_t level = 0; level < c->levels; level++) {
        int64_t samples = kept_count(c, level);
        rates[level].place = scratch;
        rates[level].row = (int64_t *)(scratch + samples);
        rates[level].share = (float *)(scratch + 2 * samples);
        rates[level].sum = rates[level].share + samples;
        scratch += 3 * samples;
        placed(c, k, first, place, level, &rates[level]);
        memset(rates[level].sum, 0, (size_t)samples * sizeof(float));
        if (time_waves && time_waves[level])
            faded(k->amplitude + c->time_first + c->time_band[level], k->stride, c->time_bands[level],
                  time_waves[level], samples, rates[level].row, rates[level].share, rates[level].sum);
    }
    for (const hnf_reading *r = readings; r < readings + count; r++) {
        const rate_samples *rate = &rates[r->level];
        int64_t at = (r->start - kept_first(c, first, r->level)) >> r->level;
        read_arc(c, k->amplitude + c->arc_first + r->octave * c->bands, k->stride, pieces, r, rate->place + at,
                 rate->row + at, rate->share + at, (float *)scratch, rate->sum + at);
    }
    for (int64_t level = c->levels - 1; level > 0; level--)
        add_twice(c, level, rates[level].sum, rates[level - 1].sum);
    for (int64_t j = 0; j < c->hop; j++)
        out[j] = rates[0].sum[c->margin[0] + j];
}

/* out (hops * hop,) = sum over all carriers of A_k c_k from sample `first` on, hop by hop, each as it is alone.
 *
 * time_waves: (hops, levels) pieces of the carriers in time; NULL, each or all of them, where they are silent. pieces:
 * of arc length. readings: those of hnf_plan_hops, counts: (hops,) of each. scratch: 3 numbers for each sample that a
 * rate keeps of a hop, and 2 for each cell of the longest reading. */
void hnf_hops(const hnf_carriers *c, const hnf_knots *k, int64_t first, int64_t hops, const double *place,
              const float *const *time_waves, const hnf_complex *const *pieces, const hnf_reading *readings,
              const int64_t *counts, double *scratch, double *out)
{
    for (int64_t hop = 0; hop < hops; hop++, first += c->hop, place += c->hop, out += c->hop) {
        hnf_knots near = around(c, k, first);
        one_hop(c, &near, first, place, time_waves ? time_waves + hop * c->levels : NULL, pieces, readings, counts[hop],
                scratch, out);
        readings += counts[hop];
    }
}
