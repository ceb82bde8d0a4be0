/* Onset and release of contact: integrate_numpy's twin in hnf_core/field/contact/taps.py. */
#include "hnf_kernel.h"

#include <math.h>

#include "elastic.h"

void hnf_tap(const hnf_normal_contact *contact, const double *modes, int64_t mode_count, const double *force,
             int64_t steps, int64_t every, double *state, double *out)
{
    double z = state[0], v = state[1];
    for (int64_t i = 0; i < steps; i++) {
        double normal = 0.0;
        if (z < 0.0) {
            double stiffness;
            normal = elastic_force(-z, contact->compliance, contact->inverse_spring, &stiffness);
            normal -= contact->damping * sqrt(stiffness) * v;
            normal = normal > 0.0 ? normal : 0.0;
        }
        double tip = (normal - force[i]) * contact->inverse_mass - contact->drag * v, body = tip;
        v += contact->dt * tip;
        z += contact->dt * v;
        for (int64_t m = 0; m < mode_count; m++) {
            const double *c = modes + 5 * m;
            double *q = state + 2 + 2 * m, y = c[0] * tip + q[0];
            q[0] = c[1] * tip - c[3] * y + q[1];
            q[1] = c[2] * tip - c[4] * y;
            body += y;
        }
        if (i % every == 0)
            out[i / every] = body;
    }
    state[0] = z;
    state[1] = v;
}
