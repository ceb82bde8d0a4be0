/* What hnf_core.kernel calls: the inner loops of synthesis. Each has a twin in numpy that says the same thing slowly,
 * and a test that both agree. No allocation, no state, no libc beyond libm: a call may run on any thread.
 *
 * This is compiled once for every processor and once for those with AVX2 and FMA; library.py takes the one that fits.
 */
#ifndef HNF_KERNEL_H
#define HNF_KERNEL_H

#include <stdint.h>

#if defined(_WIN32)
#define HNF_EXPORT __declspec(dllexport)
#else
#define HNF_EXPORT __attribute__((visibility("default")))
#endif

/* Raised whenever a signature or a meaning changes; library.py asks. */
#define HNF_ABI 1

typedef struct { float re, im; } hnf_complex;

HNF_EXPORT int64_t hnf_abi(void);
HNF_EXPORT int64_t hnf_has_wide_vectors(void);

/* texture.c */
HNF_EXPORT void hnf_faded(const float *amplitude, int64_t stride, int64_t bands, const float *waves, int64_t count,
                          const int64_t *row, const float *share, float *out);
HNF_EXPORT void hnf_read_arc(const float *amplitude, int64_t stride, int64_t bands, const hnf_complex *const *hops,
                             int64_t hop_cells, int64_t first_cell, double cells_per_m, double turns_per_cell,
                             const double *place, const float *cubic, const int64_t *row, const float *share,
                             int64_t count, float *scratch, float *out);

/* contact.c */
typedef struct {
    double angle, speed, radius, stiffness, damping, mass, load_square, rubbed, flank;
} hnf_touch;

/* What no state changes. bands: of arc length; token_bands: of a token, with so many features each, at these places. */
typedef struct {
    int64_t bands, token_bands, features, angles;
    int64_t level, peak, offset, cos2, sin2, cos4, sin4;
    const double *kappa;        /* (bands,) cycles/m */
    const int64_t *below;       /* (bands,) the token band below each, */
    const double *share;        /* and how far it is on the way to the next */
    const int64_t *token_band;  /* (bands,) the nearest */
    const double *wavelength;   /* (token_bands,) m */
    const double *turn;         /* (angles, 4) cos 2a, sin 2a, cos 4a, sin 4a */
    const int64_t *shift;       /* (angles,) bands by which a cut moves a wave that stands there */
    double per_octave, concentration, bump_mean, least_left, hand, hand_damping;
} hnf_tables;

typedef struct {
    double *power, *noise, *normal, *lines;
    int64_t *low;
} hnf_contact;

HNF_EXPORT void hnf_linear_contact(const hnf_tables *tables, const double *tokens, int64_t token_size,
                                   const hnf_touch *touch, int64_t states, double *scratch, const hnf_contact *out);

/* rows.c */
HNF_EXPORT void hnf_add_rows(const double *values, int64_t width, const int64_t *row, const double *share,
                             const double *factor, int64_t count, double *out);

/* noise.c */
HNF_EXPORT void hnf_bins(const uint64_t *radius, const uint64_t *angle, const double *level, int64_t count,
                         double *out);
HNF_EXPORT void hnf_real_waves(const double *bins, const int64_t *starts, const int64_t *which, int64_t bands,
                               int64_t widest, int64_t size, const float *slow, const float *cosine,
                               const float *sine, float *out);
HNF_EXPORT void hnf_complex_waves(const double *bins, const int64_t *starts, int64_t bands, int64_t widest,
                                  int64_t size, const float *slow, const float *cosine, const float *sine,
                                  hnf_complex *out);

#endif
