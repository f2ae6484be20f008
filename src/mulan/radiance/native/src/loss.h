// What a ray's error costs, and the gradient of that to its colour.
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

constexpr float rendered_variance_floor = 1e-4f;

struct RayLoss {
    double loss = 0;           // weighted by the ray's share
    double squared_error = 0;  // mean over channels, unweighted
    float colour_gradient[3] = {};
    float variance_gradient = 0;  // to the rendered variance
};

// share: the ray's weight over the sum of weights.
inline RayLoss ray_loss(const MulanObjective& o, const float* target, float share, const float colour[3],
                        float variance) {
    RayLoss r;
    double cost = 0;
    for (int c = 0; c < 3; ++c) {
        const float error = colour[c] - target[c], size = __builtin_fabsf(error), delta = o.huber_delta;
        r.squared_error += error * error / 3.0;
        const bool linear = delta > 0 && size > delta;
        cost += (linear ? delta * (2 * size - delta) : error * error) / 3.0;
        const float slope = linear ? (error < 0 ? -2 * delta : 2 * delta) : 2 * error;
        r.colour_gradient[c] = share * slope / 3;
    }
    r.loss = share * cost;
    // Likelihood of the error under the rendered variance; the error counts as given (ActiveNeRF, eq. 10).
    const float v = variance + rendered_variance_floor;
    r.variance_gradient = o.variance_weight * share * 0.5f * (1 / v - (float)r.squared_error / (v * v));
    return r;
}

}  // namespace mulan::MULAN_ISA
