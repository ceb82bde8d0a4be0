/* exp and log of doubles in plain arithmetic, so that a compiler takes several at once: libm's are one at a time, and
 * most of a state's time went there. Within 2 units of the last place of libm's (tests/core/kernel/test_kernel.py); NaN stays
 * NaN. */
#ifndef HNF_ELEMENTARY_H
#define HNF_ELEMENTARY_H

#include <stdint.h>
#include <string.h>

static inline uint64_t bits_of(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline double from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* e^x; e^-708 = 3e-308 for what is less, and e^709 for what is more. x = n log 2 + r, and the series of e^r. */
static inline double exp_of(double x)
{
    const double whole = 0x1.8p52; /* added to a number it leaves the nearest integer, in the lowest bits */
    x = x < -708.0 ? -708.0 : x;
    x = x > 709.0 ? 709.0 : x;
    double shifted = x * 1.44269504088896340736 + whole, n = shifted - whole;
    double r = (x - n * 0x1.62e42fefa3800p-1) - n * 0x1.ef35793c76730p-45;
    double p = 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r * r + r;
    return (1.0 + p) * from_bits((bits_of(shifted) + 1023u) << 52);
}

/* log x for a normal x > 0: x = 2^n m with m from sqrt(1/2) to sqrt(2), and the series of 2 atanh((m - 1) / (m + 1)). */
static inline double log_of(double x)
{
    const uint64_t root_half = 0x3fe6a09e667f3bcdu, one = 0x3ff0000000000000u, fraction = 0x000fffffffffffffu;
    uint64_t bits = bits_of(x) + (one - root_half);
    double n = from_bits(0x4330000000000000u | bits >> 52) - (0x1p52 + 1023.0);
    double f = from_bits((bits & fraction) + root_half) - 1.0, s = f / (2.0 + f), z = s * s;
    double p = 2.0 / 21.0;
    p = p * z + 2.0 / 19.0;
    p = p * z + 2.0 / 17.0;
    p = p * z + 2.0 / 15.0;
    p = p * z + 2.0 / 13.0;
    p = p * z + 2.0 / 11.0;
    p = p * z + 2.0 / 9.0;
    p = p * z + 2.0 / 7.0;
    p = p * z + 2.0 / 5.0;
    p = p * z + 2.0 / 3.0;
    /* x - x: NaN where there is no number. */
    return n * 0x1.62e42fefa3800p-1 + (2.0 * s + (p * z * s + n * 0x1.ef35793c76730p-45)) + (x - x);
}

#define LOG_OF_2 0.69314718055994530942

static inline double log2_of(double x) { return log_of(x) * (1.0 / LOG_OF_2); }

#endif
