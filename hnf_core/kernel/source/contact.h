/* Linear contact of one state after another: what the last one left is used where the next asks for the same. */
#ifndef HNF_CONTACT_H
#define HNF_CONTACT_H

#include "hnf_kernel.h"

/* A token that is known, per token band: power, peak, its moments, octaves (of its waves above the first arc band) and
 * place (of the arc band there); height: of its noise, as power per arc band. */
typedef struct {
    double *power, *peak, *two_re, *two_im, *four_re, *four_im, *octaves, *place, *height;
} known_token;

/* The same from a stroke. lines: (2, token_bands) powers of the tones along and across the lattice; octaves: (2,
 * token_bands) at which the stroke meets them. density: (angles, row) of the noise per arc band, folded: what stands
 * at a and at pi - a is moved alike. */
typedef struct {
    double *lines, *octaves, *density;
} seen_token;

/* token, angle, radius: what the rest was worked out for; token is NULL where nothing was. passed, leaned: per arc band,
 * what the tip passes on, and the spots that bear it, as power. row: numbers of a row that is read from any shift on; of:
 * (3, row) of them. room: numbers that no state leaves to the next. */
typedef struct {
    const double *token;
    double angle, radius;
    int64_t row;
    known_token known;
    seen_token seen;
    double *passed, *leaned, *of, *room;
} contact_work;

contact_work contact_work_in(const hnf_tables *tables, double *scratch);

/* out: power, noise (bands,), normal, low (2 * token_bands,); lines (2 * token_bands,) of the lower band and, `stride`
 * numbers further, of the upper one. */
void contact_of(const hnf_tables *tables, contact_work *work, const double *token, const hnf_touch *touch,
                int64_t stride, const hnf_contact *out);

#endif
