/* A probe dragged over a relief, integrated in time: integrate_numpy's twin in hnf_core/field/contact/contact_motion.py. */
#include "hnf_kernel.h"

#include <math.h>

#include "elastic.h"
#include "elementary.h"

void hnf_contact_motion(const hnf_moving_contact *c, const double *drives, int64_t stride, int64_t steps,
                        double *state, double *normal_out, double *along_out)
{
    const double *height = drives, *slope = drives + stride, *velocity = drives + 2 * stride,
                 *load = drives + 3 * stride, *flank_friction = drives + 4 * stride;
    double z = state[0], vz = state[1], lateral = state[2], v_lateral = state[3], bristle = state[4];
    double dt = c->dt, rate = 1.0 / dt, bristle_step = c->bristle_stiffness * dt;
    double bristle_damping = c->bristle_damping / bristle_step, inverse_stribeck = -1.0 / (c->stribeck * c->stribeck);
    for (int64_t i = 1; i <= steps; i++) {
        double depth = height[i] - z, normal = 0.0;
        if (depth > 0.0) {
            double stiffness, climb = (height[i + 1] - height[i - 1]) * (0.5 * rate);
            normal = elastic_force(depth, c->compliance, c->inverse_spring, &stiffness);
            normal += c->damping * sqrt(stiffness) * (climb - vz);
            normal = normal > 0.0 ? normal : 0.0;
        }
        double az = (normal - load[i]) * c->inverse_mass - c->drag * vz;
        vz += dt * az;
        z += dt * vz;
        normal_out[i - 1] = az;
        double sliding = velocity[i] + v_lateral, square = sliding * sliding + 1e-14, speed = sqrt(square);
        double stribeck = square * inverse_stribeck > -60.0 ? exp_of(square * inverse_stribeck) : 0.0;
        double level = c->friction * (1.0 + c->stiction * stribeck) + slope[i] * sliding * flank_friction[i] / speed;
        level = level > 1e-6 ? level : 1e-6;
        if (normal <= 0.0)
            bristle = 0.0;
        double divided = 1.0 / (1.0 + bristle_step * speed / level), predicted = bristle * divided;
        double damped = bristle_damping * stribeck, gain = 1.0 + damped, share = bristle_step * divided;
        double impulse = normal * dt * c->inverse_mass;
        double fixed = gain * predicted - damped * bristle + slope[i];
        double next = sliding - impulse * fixed - dt * (c->hand_spring * lateral + c->hand_damper * v_lateral);
        next /= 1.0 + impulse * gain * share;
        bristle = predicted + share * next;
        along_out[i - 1] = (next - sliding) * rate;
        v_lateral += next - sliding;
        lateral += dt * v_lateral;
    }
    state[0] = z, state[1] = vz, state[2] = lateral, state[3] = v_lateral, state[4] = bristle;
}
