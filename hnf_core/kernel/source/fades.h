/* Between nothing and all of it. */
#ifndef HNF_FADES_H
#define HNF_FADES_H

/* NaN becomes low: what follows may be an index. */
static inline double clipped(double x, double low, double high)
{
    return x > low ? (x < high ? x : high) : low;
}

static inline double smoothstep(double x)
{
    x = clipped(x, 0.0, 1.0);
    return x * x * (3.0 - 2.0 * x);
}

/* How much of an arc band of f Hz may sound: out below 8 to 4 Hz and above 4 to 4.8 kHz. */
static inline double arc_gain(double f)
{
    return smoothstep((f - 4.0) / 4.0) * (1.0 - smoothstep((f - 4000.0) / 800.0));
}

#endif
