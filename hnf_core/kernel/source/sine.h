/* A sine of turns, for phases of moderate size. */
#ifndef HNF_SINE_H
#define HNF_SINE_H

#include <math.h>

/* sin 2 pi x for |x| <= 1/4, by its series: what is left out is 6e-8. */
static inline float sine_of_turn(float x)
{
    float z = x * x;
    return x * (6.28318531f + z * (-41.3417022f + z * (81.6052493f + z * (-76.7058598f + z * (42.0586939f
           + z * -15.0946426f)))));
}

/* sin 2 pi x for any x of moderate size. */
static inline float sine(float x)
{
    float part = x - rintf(x);
    float half = part > 0.0f ? 0.5f : -0.5f;
    return sine_of_turn(fabsf(part) > 0.25f ? half - part : part);
}

#endif
