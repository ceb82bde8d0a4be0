/* A Hertzian contact in series with a spring. */
#ifndef HNF_ELASTIC_H
#define HNF_ELASTIC_H

#include <math.h>
#include <stdint.h>

/* Elastic force [N] at a depth > 0 [m], and the tangent stiffness [N/m]. With s = sqrt(depth / b) / y, depth = b s^2 +
 * s^3 / k gives y^3 = y + beta: two fixed-point steps, then Newton. */
static inline double elastic_force(double depth, double b, double inverse_spring, double *stiffness)
{
    double x = sqrt(depth / b), beta = x / b * inverse_spring, y = sqrt(1.0 + beta);
    y = sqrt(1.0 + beta / y);
    y = sqrt(1.0 + beta / y);
    for (int64_t step = 0; step < 3; step++) {
        double square = y * y;
        y = (2.0 * square * y + beta) / (3.0 * square - 1.0);
    }
    double s = x / y;
    *stiffness = 3.0 * s / (2.0 * b + 3.0 * inverse_spring * s);
    return s * s * s;
}

#endif
