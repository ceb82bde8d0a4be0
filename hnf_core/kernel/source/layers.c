/* The layers and heads of F_Theta: the twin of heads in hnf_core/field/field.py.
 *
 * Every output of every state is one sum over the inputs, in their order, whatever is worked out beside it: what a state
 * gives is the same to the last bit alone and among thousands, on any number of threads, in vectors of any width.
 */
#include <string.h>

#include "sums.h"

/* Outputs whose weights lie side by side, input after input: PANEL in kernel/compiled_field.py. */
#define PANEL 32
#define GROUPS (PANEL / LANES)

/* Sums of LANES that registers hold beside what they are made from. */
#if defined(__AVX__) || defined(__aarch64__)
#define SUMS 12
#else
#define SUMS 6
#endif

#define UNROLLED _Pragma("GCC unroll 8")

typedef int32_t choice __attribute__((vector_size(32)));

/* What is no number stays none. */
static inline lanes rectified(lanes x) { return (lanes)((choice)x & ~(x < (lanes){0})); }

/* Some groups of a panel's outputs, the first `keep` of them, for so many states. */
static inline __attribute__((always_inline)) void tile(int states, int groups, const float *panel, const float *bias,
                                                       int64_t inputs, const float *x, int relu, int64_t keep,
                                                       int64_t outputs, float *out)
{
    lanes sum[6][GROUPS];
    UNROLLED for (int s = 0; s < states; s++)
        UNROLLED for (int g = 0; g < groups; g++)
            sum[s][g] = *(const lanes *)(bias + g * LANES);
    for (int64_t k = 0; k < inputs; k++, panel += PANEL)
        UNROLLED for (int s = 0; s < states; s++) {
            float input = x[s * inputs + k];
            UNROLLED for (int g = 0; g < groups; g++)
                sum[s][g] += input * *(const lanes *)(panel + g * LANES);
        }
    UNROLLED for (int s = 0; s < states; s++, out += outputs)
        UNROLLED for (int g = 0; g < groups; g++) {
            lanes told = relu ? rectified(sum[s][g]) : sum[s][g];
            int64_t some = keep - g * LANES;
            if (some >= LANES)
                *(lanes *)(out + g * LANES) = told;
            else if (some > 0)
                memcpy(out + g * LANES, &told, (size_t)some * sizeof(float));
        }
}

/* One to six states with one panel. */
static void with_panel(int64_t states, const float *panel, const float *bias, int64_t inputs, const float *x, int relu,
                       int64_t keep, int64_t outputs, float *out)
{
#define TILES(states, groups)                                                                                        \
    for (int64_t at = 0; at < keep; at += (groups)*LANES)                                                            \
        tile(states, groups, panel + at, bias + at, inputs, x, relu, keep - at, outputs, out + at)
    switch (states) {
    case 1: TILES(1, SUMS < 4 ? 2 : 4); return;
    case 2: TILES(2, SUMS < 8 ? 2 : 4); return;
    case 3: TILES(3, 2); return;
    case 4: TILES(4, 2); return;
    case 5: TILES(5, 2); return;
    default: TILES(6, 2); return;
    }
#undef TILES
}

static void layer(const float *panels, const float *biases, int64_t inputs, int64_t outputs, int relu,
                  const float *x, int64_t states, float *out)
{
    const int64_t most = SUMS / 2;
    for (int64_t at = 0; at < outputs; at += PANEL)
        for (int64_t s = 0, some; s < states; s += some) {
            int64_t left = states - s, keep = outputs - at < PANEL ? outputs - at : PANEL;
            some = left < most ? left : left < 2 * most ? (left + 1) / 2 : most;
            with_panel(some, panels + at * inputs, biases + at, inputs, x + s * inputs, relu, keep, outputs,
                       out + s * outputs + at);
        }
}

/* So many states (each of widths[0] inputs) through `layers` ReLU layers and two heads. panels, biases: (layers + 2), the
 * heads last, that of alpha first; panels (outputs / PANEL, inputs, PANEL) and biases filled up with zeros. widths:
 * (layers + 3) of the inputs, of each layer, and of the heads. scratch: two of the widest layer a state. */
void hnf_layers(const float *const *panels, const float *const *biases, const int64_t *widths, int64_t layers,
                const float *x, int64_t states, float *scratch, float *head, float *sigma)
{
    int64_t widest = 0;
    for (int64_t i = 0; i <= layers; i++)
        widest = widths[i] > widest ? widths[i] : widest;
    for (int64_t i = 0; i < layers; i++) {
        float *out = scratch + (i % 2) * widest * states;
        layer(panels[i], biases[i], widths[i], widths[i + 1], 1, x, states, out);
        x = out;
    }
    layer(panels[layers], biases[layers], widths[layers], widths[layers + 1], 0, x, states, head);
    layer(panels[layers + 1], biases[layers + 1], widths[layers], widths[layers + 2], 0, x, states, sigma);
}
