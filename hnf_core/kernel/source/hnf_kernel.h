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
#define HNF_ABI 12

typedef struct { float re, im; } hnf_complex;

/* Samples from `at` on that lie between the same two knots: where they end. */
static inline int64_t hnf_stretch_end(const int64_t *row, int64_t at, int64_t count)
{
    int64_t here = row[at];
    do {
        at++;
    } while (at < count && row[at] == here);
    return at;
}

HNF_EXPORT int64_t hnf_abi(void);
HNF_EXPORT int64_t hnf_has_wide_vectors(void);

/* What no stroke changes of the carriers and of the pieces that are kept of them (hnf_core/field/noise_cache.py). */
typedef struct {
    int64_t hop, reach;                      /* samples of a hop, and those about it that it is made from */
    int64_t levels;                          /* rates: each half of the one before */
    int64_t time_first, arc_first;           /* first column of either family in a row of amplitudes */
    int64_t octaves, bands, piece_cells;     /* of arc length: bands in each, cells of a piece */
    int64_t taps;                            /* on either side of a reading halfway between two samples */
    double rate, highest, band_end;          /* Hz; the highest frequency over its rate; Hz where nothing sounds */
    double lowest, turns;                    /* cycles/m with which octaves begin; demodulation, cycles per cell */
    const int64_t *margin;                   /* (levels,) samples before and after a hop */
    const int64_t *time_band, *time_bands;   /* (levels,) first carrier in time kept there, and how many */
    const double *cells_per_m;               /* (octaves,) */
    const float *half_band;                  /* (2 taps,) */
    const float *cubic;                      /* (4, 4) per cell that is read, powers of the way to the next */
} hnf_carriers;

/* at: (count,) ascending samples; rows of amplitudes there, stride apart, linear between. */
typedef struct {
    const int64_t *at;
    const float *amplitude;
    int64_t count, stride;
} hnf_knots;

/* Every (1 << level)-th sample from start on, at which an octave is read; the cells that are read, and where the
 * caller put them: the first of its pieces, and the cell with which that begins. */
typedef struct { int64_t octave, level, start, count, first_cell, last_cell, piece, piece_cell; } hnf_reading;

/* arc.c */
HNF_EXPORT void hnf_read_arcs(const hnf_carriers *carriers, const float *amplitude, int64_t stride,
                              const hnf_complex *const *pieces, const hnf_reading *readings, int64_t readings_count,
                              const double *place, const int64_t *row, const float *share, int64_t count,
                              double *scratch, float *out);

/* hop.c */
HNF_EXPORT int64_t hnf_plan_hops(const hnf_carriers *carriers, const hnf_knots *knots, int64_t first, int64_t hops,
                                 const double *place, int64_t room, hnf_reading *out, int64_t *counts);
HNF_EXPORT void hnf_hops(const hnf_carriers *carriers, const hnf_knots *knots, int64_t first, int64_t hops,
                         const double *place, const float *const *time_waves, const hnf_complex *const *pieces,
                         const hnf_reading *readings, const int64_t *counts, double *scratch, double *out);

/* contact.c */

/* load_square: (F / m)^2 [m^2/s^4]. rubbed: 1 + mu^2. flank: (1 + FLANK_FRICTION (1 - a / R)^2)^2 - 1, a the contact's
 * radius and R the tip's. The rest in SI units; damping: (2 zeta)^2 k m. */
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
    const int64_t *nearest_end; /* (token_bands,) arc bands to which each is the nearest end before this one */
    const double *wavelength;   /* (token_bands,) m */
    const double *line_share;   /* (token_bands,) of a band's power from which on its strongest wave is a line */
    const double *turn;         /* (angles, 4) cos 2a, sin 2a, cos 4a, sin 4a */
    const int64_t *shift;       /* (angles,) bands by which a cut moves a wave that stands there */
    double per_octave, concentration, bump_mean, least_left, hand, hand_damping, least_across, clear_peak,
        least_offset_scale;
} hnf_tables;

typedef struct {
    double *power, *noise, *normal, *lines;
    int64_t *low;
} hnf_contact;

HNF_EXPORT void hnf_linear_contact(const hnf_tables *tables, const double *tokens, int64_t token_size,
                                   const hnf_touch *touch, int64_t states, double *scratch, const hnf_contact *out);

/* emission.c */

/* What no state changes of how a field's inputs and amplitudes are made (hnf_core/field/features.py, field.py). */
typedef struct {
    int64_t inputs, token_size, fixed_at, fixed, direction_at; /* numbers in, those of a token, where others begin */
    int64_t time_bands, carriers, outputs, harmonics;          /* carriers in time come first; outputs of the head */
    int64_t stroke_frame, directed, line_gains;
    double quiet_power, quiet_line_power, time_share, ceiling, pace, pitch;
    const double *token_shift, *token_scale;                   /* (token_size,) */
    const double *time_edge;                                   /* (time_bands + 1,) arc bands below each at 1 m/s */
    const double *skip;                                        /* (carriers,) */
    const int64_t *knot;                                       /* (arc bands,) the output below each, */
    const double *knot_share;                                  /* and how far it is on the way to the next */
    const int64_t *harmonic_shift;                             /* (harmonics,) arc bands */
    const double *harmonic_start;                              /* (harmonics,) log gain */
} hnf_emitter;

/* speed and force are not below their floors. moving: 0 ... 1, how much of what is emitted counts. */
typedef struct { double x, y, speed, force, mass, resonance, moving; } hnf_motion;

/* What linear contact expects. prior: (states, carriers) log amplitudes; line: (states, 2, lines) powers in the two arc
 * bands about each tone; low: (states, lines) the lower one. */
typedef struct {
    double *prior, *line;
    int64_t *low;
} hnf_expected;

HNF_EXPORT void hnf_inputs(const hnf_tables *tables, const hnf_emitter *emitter, const double *tokens,
                           int64_t token_stride, const double *fixed, const hnf_motion *motion, const hnf_touch *touch,
                           int64_t states, double *scratch, float *x, const hnf_expected *expected);
HNF_EXPORT void hnf_emitted(const hnf_tables *tables, const hnf_emitter *emitter, const float *head,
                            const hnf_motion *motion, const hnf_expected *expected, int64_t states, double *scratch,
                            double *alpha);

/* Lines whose tones are apart from the carriers. column: (states, count) places among the 2 * token_bands lines; pitch,
 * along: (states, count) wavenumbers across the crests (0: no such line) and along the path [1/m]; scatter:
 * (states,) displacement [m]; tones: (states, count * harmonics) RMS. */
typedef struct {
    const int64_t *column;
    const double *pitch, *along, *scatter;
    double *tones;
    int64_t count;
} hnf_path_lines;

/* Between hnf_inputs and hnf_emitted: the tones, and no power left of their lines in what is expected. */
HNF_EXPORT void hnf_take_tones(const hnf_tables *tables, const hnf_emitter *emitter, const float *head,
                               const hnf_motion *motion, const hnf_expected *expected, int64_t states,
                               const hnf_path_lines *lines);
/* After hnf_emitted: the tones get what scatter spreads about them, from alpha (states, carriers). scratch: 2 bands and
 * the lines. */
HNF_EXPORT void hnf_gather_sidebands(const hnf_tables *tables, const hnf_emitter *emitter, int64_t states,
                                     const hnf_path_lines *lines, double *scratch, double *alpha);

/* force_noise.c */

/* Tables of one material under one probe (hnf_core/field/force_noise.py). gain, body: (size,) power gains of a force and
 * of a motion, at frequencies in even steps of log f; those of all arc bands, step apart, begin at one of the first rows,
 * by the speed. loads: of log_loads (loads, arc_bands), the power under a pad; 0 for a stiff tip, whose power is bands
 * (arc_bands,) times force^force_exponent, and the difference of time_power (time_bands + 1,) / speed^exponent, not below
 * time_start. */
typedef struct {
    int64_t time_bands, arc_bands, rows, step, loads, size;
    double per_octave, log_least_speed, log_first_hz, loads_per_octave, log_least_force, force_exponent, exponent,
        time_start;
    const double *gain, *body, *time_gain, *time_body, *bands, *time_power, *log_loads;
} hnf_friction;

/* speed [m/s] and force [N] are not below their floors; scale: factor on the noise's power. */
typedef struct { double speed, force, scale; } hnf_rubbing;

/* alpha: (…, heads, stride), of which rows (states,) get the noise and the body's gain in their first time_bands +
 * arc_bands numbers. scratch: twice as many. */
HNF_EXPORT void hnf_force_noise(const hnf_friction *tables, const hnf_rubbing *rubbing, const int64_t *rows,
                                int64_t states, int64_t heads, int64_t stride, double *scratch, double *alpha);
/* out: (count,) gains of the body at frequencies [Hz]. */
HNF_EXPORT void hnf_body_gains(const hnf_friction *tables, const double *frequency, int64_t count, double *out);

/* layers.c */
HNF_EXPORT void hnf_layers(const float *const *panels, const float *const *biases, const int64_t *widths,
                           int64_t layers, const float *x, int64_t states, float *scratch, float *head, float *sigma);

/* motion.c */

/* A probe and the surface that it is dragged over: compliance [m/N^(2/3)], inverse_spring [m/N], damping 2 zeta sqrt(m),
 * inverse_mass [1/kg], drag [1/s]; the hand's spring [1/s^2] and damper [1/s] along the path; LuGre's friction, static
 * over kinetic less 1, Stribeck speed [m/s], bristles' stiffness [1/m] and damping [s/m]; dt [s]. */
typedef struct {
    double compliance, inverse_spring, damping, inverse_mass, drag, hand_spring, hand_damper, friction, stiction,
        stribeck, bristle_stiffness, bristle_damping, dt;
} hnf_moving_contact;

/* normal_out, along_out (steps,): acceleration along the normal and along the path. drives: rows of steps + 2, stride
 * apart: height, slope, velocity, load, rise of friction with slope; the first and the last are the neighbors'. state:
 * height, its velocity, place and velocity along the path relative to the hand, bristles; it is continued. */
HNF_EXPORT void hnf_contact_motion(const hnf_moving_contact *contact, const double *drives, int64_t stride,
                                   int64_t steps, double *state, double *normal_out, double *along_out);

/* place.c */
HNF_EXPORT void hnf_place(const double *position, int64_t states, int64_t samples_per_state, int64_t start,
                          int64_t count, double *out);

/* press.c */
HNF_EXPORT void hnf_press(const double *force, int64_t states, const double *weight, int64_t contacts,
                          const double *const *given, const int64_t *rows, int64_t ahead, int64_t samples,
                          int64_t first, int64_t count, double *out);

/* tap.c */

/* A mass on a Hertzian contact, depth = compliance N^(2/3), in series with a spring: m/N^(2/3), m/N, 2 zeta sqrt(m),
 * 1/kg, 1/s, s. */
typedef struct { double compliance, inverse_spring, damping, inverse_mass, drag, dt; } hnf_normal_contact;

/* out (steps / every): every so many steps, the acceleration under a force (steps,). modes: (mode_count, 5) biquads b0,
 * b1, b2, a1, a2 that are added to it. state: height and velocity, and two numbers of each mode; it is continued. */
HNF_EXPORT void hnf_tap(const hnf_normal_contact *contact, const double *modes, int64_t mode_count,
                        const double *force, int64_t steps, int64_t every, double *state, double *out);

/* tones.c */

/* Lines along a path. turns: (states, lines) phases, between: (states - 1, lines) wavenumbers [1/m], scatter: (states, 2,
 * lines) turns by a displacement of 1. knots: (knot_count,) ascending samples, amplitude: (knot_count, lines * harmonics)
 * there. offsets: (lines * harmonics,) turns at the begin. */
typedef struct {
    const double *turns, *between, *scatter, *amplitude, *offsets;
    const int64_t *knots;
    int64_t states, lines, harmonics, knot_count, per_state;
} hnf_tones_course;

/* Displacement along both axes (2, points) at even places along the path, linear in between; none of 0 points. */
typedef struct {
    const double *grid;
    int64_t points;
    double start, per_m;
} hnf_displacement;

/* out (count,) += the tones at samples start ...; way: (count,) [m] along the path from the state before each, position:
 * (count,) along the whole path. */
HNF_EXPORT void hnf_tones(const hnf_tones_course *course, const hnf_displacement *displacement, const double *way,
                          const double *position, int64_t start, int64_t count, double *out);

/* rows.c */
HNF_EXPORT void hnf_between_rows(const float *values, int64_t width, const int64_t *row, const double *share,
                                 const double *factor, int64_t terms, int64_t count, float *out);

/* turns.c */
HNF_EXPORT void hnf_bends(const double *course, int64_t states, int64_t channels, double bent, uint8_t *kept);

/* noise.c */
HNF_EXPORT void hnf_bins(uint64_t seed, uint64_t stream, uint64_t block, int64_t pairs, int64_t first, int64_t count,
                         const double *level, double *out);
HNF_EXPORT void hnf_real_waves(const double *bins, const int64_t *starts, const int64_t *which, int64_t bands,
                               int64_t widest, int64_t size, const float *slow, const float *cosine,
                               const float *sine, const float *window, float *out);
HNF_EXPORT void hnf_complex_waves(const double *bins, const int64_t *starts, int64_t bands, int64_t widest,
                                  int64_t size, const float *slow, const float *cosine, const float *sine,
                                  const float *window, hnf_complex *out);

#endif
