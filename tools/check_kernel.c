/* Calls every function of a built kernel on fixed inputs and prints two sums of what each gives, so that builds for
 * different systems can be compared: check LIBRARY */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "hnf_kernel.h"

#ifdef _WIN32
#include <windows.h>
static void *opened(const char *path) { return (void *)LoadLibraryA(path); }
static void *found(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
static void *opened(const char *path) { return dlopen(path, RTLD_NOW); }
static void *found(void *library, const char *name) { return dlsym(library, name); }
#endif

#define FIND(name) __typeof__(name) *name##_ = (__typeof__(name) *)found(library, #name); \
    if (!name##_) { printf("no %s\n", #name); return 1; }

enum { COUNT = 300, BANDS = 9, CELLS = 64, LENGTH = 512, WAVES = 6, WIDEST = 20, ARC = 192, TOKEN = 7, STATES = 7,
       ANGLES = 12, FEATURES = 7, HOP = 128, HOPS = 2, REACH = 8, EDGES = 9, FARTHEST = 121,
       INPUTS = TOKEN * FEATURES + 2 + 4 + EDGES + 3, OUTPUTS = EDGES + 11 + 2 * 2 * TOKEN, PANEL = 32, ASKED = 17 };

static uint64_t state = 88172645463325252u;

static uint64_t word(void) /* xorshift64 (G. Marsaglia 2003) */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static double uniform(void) { return (double)(word() >> 11) * 0x1p-53; }

static void fill(float *out, int count) { for (int i = 0; i < count; i++) out[i] = (float)(uniform() - 0.5); }

static void say(const char *name, const double *values, int count, int digits)
{
    double weighted = 0.0, size = 0.0;
    for (int i = 0; i < count; i++) {
        weighted += values[i] * (1 + i % 7);
        size += fabs(values[i]);
    }
    printf("%s %.*e %.*e\n", name, digits, weighted, digits, size);
}

static void say_single(const char *name, const float *values, int count)
{
    static double wide[2 * WAVES * LENGTH];
    for (int i = 0; i < count; i++)
        wide[i] = values[i];
    say(name, wide, count, 5);
}

static float amplitude[5 * BANDS], waves[BANDS * COUNT], share[COUNT], out[COUNT], cubic[16], scratch[8 * CELLS];
static float window[LENGTH], slow[2 * WIDEST * LENGTH], cosine[WAVES * LENGTH], sine[WAVES * LENGTH], real[WAVES * LENGTH];
static hnf_complex pieces[2][BANDS * CELLS], turned[WAVES * LENGTH];
static double place[COUNT], level[COUNT], drawn[2 * COUNT], bins[2 * WAVES * WIDEST], kappa[ARC], between[ARC];
static double wavelength[TOKEN], turn[4 * ANGLES], tokens[STATES * TOKEN * FEATURES], pressed[STATES * 20], felt[12 * 20];
static double room[12 * ARC + 30 * TOKEN + 100 + (3 + ANGLES) * (ARC + FARTHEST + 4)], power[STATES * ARC], noise[STATES * ARC], normal[STATES];
static double lines[4 * STATES * TOKEN], part[STATES], factor[STATES];
static double path[HOPS * HOP + 2 * REACH], hopped[HOPS * HOP];
static float half_band[8], table[10 * ARC], rows[STATES * ARC];
static uint8_t kept[COUNT];
static double shift_of[TOKEN * FEATURES], scale_of[TOKEN * FEATURES], skip[EDGES + ARC], edge[EDGES + 1];
static double knot_share[ARC], prior[STATES * (EDGES + ARC)], line[4 * STATES * TOKEN], alpha[STATES * (EDGES + ARC)];
static float network[STATES * INPUTS], head[STATES * OUTPUTS];
static float panels[4][20 * PANEL], biases[4][PANEL], asked[ASKED * 20], between_layers[2 * ASKED * 20];
static float answers[2][ASKED * 11];
static hnf_motion motion[STATES];
static int64_t knot[ARC], row[COUNT], below[ARC], nearest[TOKEN], shift[ANGLES], low[2 * STATES * TOKEN], at[STATES];
static hnf_touch touch[STATES];

int main(int given, char **words)
{
    void *library = given > 1 ? opened(words[1]) : NULL;
    if (!library) {
        printf("the library does not load\n");
        return 1;
    }
    FIND(hnf_abi) FIND(hnf_has_wide_vectors) FIND(hnf_linear_contact) FIND(hnf_between_rows)
    FIND(hnf_bins) FIND(hnf_real_waves) FIND(hnf_complex_waves) FIND(hnf_plan_hops) FIND(hnf_hops)
    FIND(hnf_place) FIND(hnf_press) FIND(hnf_tap) FIND(hnf_contact_motion) FIND(hnf_tones) FIND(hnf_bends) FIND(hnf_read_arcs)
    FIND(hnf_inputs) FIND(hnf_emitted) FIND(hnf_layers) FIND(hnf_take_tones)
    FIND(hnf_gather_sidebands) FIND(hnf_force_noise) FIND(hnf_body_gains)
    printf("version %d, wide vectors %d\n", (int)hnf_abi_(), (int)hnf_has_wide_vectors_());

    fill(amplitude, 5 * BANDS), fill(waves, BANDS * COUNT), fill(cubic, 16);
    for (int i = 0; i < COUNT; i++) {
        row[i] = i * 4 / COUNT;
        share[i] = (float)uniform();
        place[i] = (70.0 + 40.0 * sin(0.02 * i)) / 1000.0;
        level[i] = uniform();
    }
    fill((float *)pieces, 4 * BANDS * CELLS);
    double states[5] = {0.1, 0.12, 0.12, 0.15, 0.1};
    hnf_place_(states, 5, 20, REACH - 100, HOPS * HOP + 2 * REACH, path);
    say("place", path, HOPS * HOP + 2 * REACH, 9);
    int64_t margin[2] = {0, 4}, time_band[2] = {1, 0}, time_bands[2] = {1, 1}, when[4] = {-50, 10, 40, 300};
    double cells_per_m[2] = {101.3, 203.7};
    fill(half_band, 8);
    hnf_carriers carriers = {HOP, REACH, 2, 0, 2, 2, 2, CELLS, 4, 1e4, 0.25, 4800.0, 50.0, 0.09375, margin, time_band,
                             time_bands, cells_per_m, half_band, cubic};
    hnf_knots knots = {when, amplitude, 4, BANDS};
    hnf_reading readings[4 * HOPS];
    int64_t counts[HOPS], found_readings = hnf_plan_hops_(&carriers, &knots, 0, HOPS, path, 4 * HOPS, readings, counts);
    for (int i = 0; i < found_readings; i++) {
        readings[i].piece = 0, readings[i].piece_cell = -CELLS;
        printf("reading %d %d %d %d %d %d\n", (int)readings[i].octave, (int)readings[i].level, (int)readings[i].start,
               (int)readings[i].count, (int)readings[i].first_cell, (int)readings[i].last_cell);
    }
    const float *time_waves[2 * HOPS] = {waves, waves + COUNT, NULL, waves};
    const hnf_complex *hops[2] = {pieces[0], pieces[1]};
    hnf_hops_(&carriers, &knots, 0, HOPS, path, time_waves, hops, readings, counts, room, hopped);
    say("hops", hopped, HOPS * HOP, 5);
    hnf_read_arcs_(&carriers, amplitude, BANDS, hops, readings, counts[0], path, row, share, HOP, room, out);
    say_single("read_arcs", out, HOP);

    hnf_bins_(word(), word(), word(), 1001, 7, COUNT, level, drawn);
    say("bins", drawn, 2 * COUNT, 9);
    fill(window, LENGTH), fill(slow, 2 * WIDEST * LENGTH), fill(cosine, WAVES * LENGTH), fill(sine, WAVES * LENGTH);
    int64_t starts[WAVES + 1], which[3] = {0, 2, 5};
    for (int i = 0; i <= WAVES; i++)
        starts[i] = 30 + i * WIDEST - (i > 2);
    for (int i = 0; i < 2 * WAVES * WIDEST; i++)
        bins[i] = uniform() - 0.5;
    hnf_real_waves_(bins, starts, which, 3, WIDEST, LENGTH, slow, cosine, sine, window, real);
    say_single("real_waves", real, WAVES * LENGTH);
    hnf_complex_waves_(bins, starts, WAVES, WIDEST, LENGTH, slow, cosine, sine, window, turned);
    say_single("complex_waves", (float *)turned, 2 * WAVES * LENGTH);

    for (int k = 0; k < ARC; k++) {
        kappa[k] = 50.0 * exp2(k / 24.0);
        below[k] = k / 32, between[k] = k % 32 / 32.0;
    }
    for (int a = 0; a < ANGLES; a++) {
        double delta = (a + 0.5) * 0.1308997;
        shift[a] = a * a;
        turn[4 * a] = cos(2 * delta), turn[4 * a + 1] = sin(2 * delta);
        turn[4 * a + 2] = cos(4 * delta), turn[4 * a + 3] = sin(4 * delta);
    }
    for (int b = 0; b < TOKEN; b++)
        wavelength[b] = 0.01 * exp2(-b), nearest[b] = (b + 1) * ARC / TOKEN;
    for (int i = 0; i < STATES * TOKEN * FEATURES; i++)
        tokens[i] = i % FEATURES == 0 ? -5.0 + uniform() : uniform() - 0.3;
    for (int i = 0; i < STATES; i++)
        touch[i] = (hnf_touch){6.0 * uniform(), 0.02 + 0.2 * uniform(), 1e-4 * uniform(), 5e4, 160.0, 0.02, 900.0, 1.1, 2.0};
    double weakest[TOKEN];
    for (int b = 0; b < TOKEN; b++)
        weakest[b] = 0.05 * (b + 1);
    hnf_tables tables = {ARC, TOKEN, FEATURES, ANGLES, 0, 1, 2, 3, 4, 5, 6, kappa, below, between, nearest, wavelength,
                         weakest, turn, shift, 24.0, 20.0, 0.1, 1e-9, 25e3, 16e3, 0.15, 0.3, 0.05};
    hnf_contact contact = {power, noise, normal, lines, low};
    hnf_linear_contact_(&tables, tokens, TOKEN * FEATURES, touch, STATES, room, &contact);
    say("power", power, STATES * ARC, 9), say("noise", noise, STATES * ARC, 9), say("normal", normal, STATES, 9);
    say("lines", lines, 4 * STATES * TOKEN, 9);
    for (int i = 0; i < STATES; i++)
        motion[i] = (hnf_motion){cos(i), sin(i), 0.02 + 0.2 * uniform(), 0.3 + uniform(), 0.02, 150.0, i ? uniform() : 0.0};
    for (int i = 0; i < TOKEN * FEATURES; i++)
        shift_of[i] = uniform(), scale_of[i] = uniform();
    for (int k = 0; k < EDGES + ARC; k++)
        skip[k] = uniform();
    for (int i = 0; i <= EDGES; i++)
        edge[i] = -90.0 + 12.0 * i;
    for (int k = 0; k < ARC; k++)
        knot[k] = k / 20, knot_share[k] = k % 20 / 20.0;
    int64_t order[2] = {0, 24};
    double start[2] = {0.0, -2.0};
    hnf_emitter emitter = {INPUTS, TOKEN * FEATURES, TOKEN * FEATURES, 2, TOKEN * FEATURES + 2, EDGES, EDGES + ARC,
                           OUTPUTS, 2, 1, 1, 1, 4e-8, 1e-10, 0.01, 6.0, 0.1, 150.0, shift_of, scale_of, edge, skip, knot,
                           knot_share, order, start};
    hnf_expected expected = {prior, line, low};
    hnf_inputs_(&tables, &emitter, tokens, TOKEN * FEATURES, level, motion, touch, STATES, room, network, &expected);
    say_single("inputs", network, STATES * INPUTS);
    say("prior", prior, STATES * (EDGES + ARC), 9), say("line", line, 4 * STATES * TOKEN, 9);
    fill(head, STATES * OUTPUTS);
    hnf_emitted_(&tables, &emitter, head, motion, &expected, STATES, room, alpha);
    say("emitted", alpha, STATES * (EDGES + ARC), 6);
    static double crests[2 * STATES], onto_path[2 * STATES], uneven[STATES], apart[4 * STATES];
    int64_t chosen[2 * STATES];
    for (int i = 0; i < 2 * STATES; i++)
        chosen[i] = i % 2 ? TOKEN + 1 : 1, crests[i] = i % 5 ? 400.0 : 0.0, onto_path[i] = crests[i] * uniform();
    for (int i = 0; i < STATES; i++)
        uneven[i] = i % 3 ? 5e-5 : 0.0;
    hnf_path_lines lattice = {chosen, crests, onto_path, uneven, apart, 2};
    hnf_take_tones_(&tables, &emitter, head, motion, &expected, STATES, &lattice);
    hnf_emitted_(&tables, &emitter, head, motion, &expected, STATES, room, alpha);
    hnf_gather_sidebands_(&tables, &emitter, STATES, &lattice, room, alpha);
    say("apart", apart, 4 * STATES, 6), say("left", alpha, STATES * (EDGES + ARC), 6);
    static double gains[30 * ARC], bodies[30 * ARC], loads[3 * ARC], rubbed[STATES * (EDGES + ARC)], bodied[STATES];
    for (int i = 0; i < 30 * ARC; i++)
        gains[i] = uniform(), bodies[i] = 0.5 + uniform();
    for (int i = 0; i < 3 * ARC; i++)
        loads[i] = -8.0 + uniform();
    hnf_rubbing rubbing[STATES];
    int64_t every[STATES];
    for (int i = 0; i < STATES; i++)
        rubbing[i] = (hnf_rubbing){0.01 + 0.2 * uniform(), 0.3 + uniform(), uniform()}, every[i] = i, bodied[i] = 20.0 * i;
    for (int i = 0; i < STATES * (EDGES + ARC); i++)
        rubbed[i] = uniform();
    hnf_friction stiff = {EDGES, ARC, 20 * ARC, 8, 0, 30 * ARC, 192.0, -6.9, 1.6, 8.0, -4.6, 1.4, 0.3, 0.01, gains, bodies,
                          skip, skip, kappa, edge, loads};
    hnf_force_noise_(&stiff, rubbing, every, STATES, 1, EDGES + ARC, room, rubbed);
    say("stiff", rubbed, STATES * (EDGES + ARC), 9);
    hnf_friction soft = stiff;
    soft.loads = 3;
    hnf_force_noise_(&soft, rubbing, every, STATES, 1, EDGES + ARC, room, rubbed);
    say("soft", rubbed, STATES * (EDGES + ARC), 9);
    hnf_body_gains_(&stiff, bodied, STATES, power);
    say("body", power, STATES, 9);
    const float *given_panels[4] = {panels[0], panels[1], panels[2], panels[3]};
    const float *given_biases[4] = {biases[0], biases[1], biases[2], biases[3]};
    int64_t widths[5] = {20, 19, 17, 11, 3};
    fill(panels[0], 4 * 20 * PANEL), fill(biases[0], 4 * PANEL), fill(asked, ASKED * 20);
    hnf_layers_(given_panels, given_biases, widths, 2, asked, ASKED, between_layers, answers[0], answers[1]);
    say_single("layers, first head", answers[0], ASKED * 11);
    say_single("layers, second head", answers[1], ASKED * 3);
    for (int i = 0; i < 10 * ARC; i++)
        table[i] = (float)uniform();
    for (int i = 0; i < STATES; i++)
        at[i] = i, part[i] = uniform(), factor[i] = uniform();
    hnf_between_rows_(table, ARC, at, part, factor, 1, STATES, rows);
    say_single("between_rows", rows, STATES * ARC);
    for (int i = 0; i < 12 * 20; i++)
        felt[i] = uniform() - 0.5;
    int64_t rows_of[2] = {12, 7};
    const double *felt_of[2] = {felt, felt + 20};
    hnf_press_(part, STATES, tokens, 2, felt_of, rows_of, 3, 20, -2, STATES, pressed);
    say("press", pressed, STATES * 20, 9);
    hnf_normal_contact tip = {2e-5, 2.5e-6, 0.13, 28.6, 10.0, 5e-5};
    double mode[5] = {-0.6, 1.2, -0.6, -1.84, 0.92}, moved[4] = {-1e-5, 0.0, 0.0, 0.0}, struck[COUNT / 2];
    for (int i = 0; i < COUNT; i++)
        level[i] = i < COUNT / 2 ? 2.0 * sin(i * 6.2832 / COUNT) : 0.0;
    hnf_tap_(&tip, mode, 1, level, COUNT, 2, moved, struck);
    say("tap", struck, COUNT / 2, 9), say("moved", moved, 4, 9);
    hnf_moving_contact drawn_over = {2e-5, 2.5e-6, 0.13, 28.6, 10.0, 13000.0, 640.0, 0.4, 0.5, 1e-3, 1.6e4, 30.0, 5e-5};
    double drives[5 * (COUNT + 2)], dragged[5] = {-1e-5, 0.0, 0.0, 0.0, 0.1}, upward[COUNT], along[COUNT];
    for (int i = 0; i < COUNT + 2; i++) {
        drives[i] = 1e-6 * sin(0.05 * i), drives[COUNT + 2 + i] = 1e-2 * cos(0.05 * i);
        drives[2 * (COUNT + 2) + i] = 0.02, drives[3 * (COUNT + 2) + i] = 1.0, drives[4 * (COUNT + 2) + i] = 0.5;
    }
    hnf_contact_motion_(&drawn_over, drives, COUNT + 2, COUNT, dragged, upward, along);
    say("upward", upward, COUNT, 9), say("along", along, COUNT, 9), say("dragged", dragged, 5, 9);
    double phases[4] = {0.1, 0.2, 3.1, 5.2}, waves[2] = {500.0, 1000.0}, loud[12];
    double onward[COUNT], sung[COUNT] = {0.0}, shifts[8], begins[6], displaced[2 * 50];
    int64_t ends[2] = {0, COUNT};
    for (int i = 0; i < 12; i++)
        loud[i] = uniform();
    for (int i = 0; i < COUNT; i++)
        onward[i] = 1e-5 * i;
    for (int i = 0; i < 100; i++)
        displaced[i] = cos(0.3 * i);
    for (int i = 0; i < 8; i++)
        shifts[i] = 0.02 * i;
    for (int i = 0; i < 6; i++)
        begins[i] = 0.618 * (i + 1);
    hnf_tones_course lines = {phases, waves, shifts, loud, begins, ends, 2, 2, 3, 2, COUNT};
    hnf_displacement moved_lines = {displaced, 50, -1e-4, 1e4};
    hnf_tones_(&lines, &moved_lines, onward, onward, 0, COUNT, sung);
    say("tones", sung, COUNT, 5);
    kept[0] = kept[99] = 1;
    hnf_bends_(drawn, 100, 3, 0.25, kept);
    int bends = 0;
    for (int i = 0; i < 100; i++)
        bends += kept[i] * (i + 1);
    printf("bends %d\n", bends);
    return 0;
}
