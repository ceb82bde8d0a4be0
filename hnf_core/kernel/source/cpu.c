/* What library.py asks first. */
#include "hnf_kernel.h"

int64_t hnf_abi(void)
{
    return HNF_ABI;
}

#if defined(__x86_64__)
#include <cpuid.h>

/* Whether processor and system know AVX2, FMA and what else x86-64-v3 promises. */
int64_t hnf_has_wide_vectors(void)
{
    unsigned a, b, c, d, low, high;
    const unsigned fma_movbe_osxsave_avx_f16c = 1u << 12 | 1u << 22 | 1u << 27 | 1u << 28 | 1u << 29;
    const unsigned bmi1_avx2_bmi2 = 1u << 3 | 1u << 5 | 1u << 8, lzcnt = 1u << 5;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & fma_movbe_osxsave_avx_f16c) != fma_movbe_osxsave_avx_f16c)
        return 0;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || (b & bmi1_avx2_bmi2) != bmi1_avx2_bmi2)
        return 0;
    if (!__get_cpuid(0x80000001u, &a, &b, &c, &d) || !(c & lzcnt))
        return 0;
    /* The system keeps the upper halves of vectors when it changes threads. */
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return (low & 6u) == 6u;
}
#else
int64_t hnf_has_wide_vectors(void)
{
    return 0;
}
#endif
