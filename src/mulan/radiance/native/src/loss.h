// What a pixel's error costs, and the gradient of that to what it sees (mulan.radiance.loss).
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

constexpr float rendered_variance_floor = 1e-4f;
constexpr float entropy_rim = 1e-3f;  // opacities nearer to 0 or 1 count as decided

struct RayLoss {
    double loss = 0;           // weighted by the share
    double squared_error = 0;  // mean over channels, unweighted
    float colour_gradient[3] = {};
    float variance_gradient = 0;  // to the rendered variance
};

inline float natural_logarithm(float x) { return __builtin_logf(x); }

// Squared error or Huber's loss.
inline void judge_error(float delta, float share, const float error[3], RayLoss& r) {
    double cost = 0;
    for (int c = 0; c < 3; ++c) {
        const float size = __builtin_fabsf(error[c]);
        const bool linear = delta > 0 && size > delta;
        cost += (linear ? delta * (2 * size - delta) : error[c] * error[c]) / 3.0;
        const float slope = linear ? (error[c] < 0 ? -2 * delta : 2 * delta) : 2 * error[c];
        r.colour_gradient[c] = share * slope / 3;
    }
    r.loss = share * cost;
}

// Entropy of a ray's hitting something, flat at its ends; share: the ray's weight over the sum of weights.
inline double opacity_loss(const MulanObjective& objective, float share, float opacity, float& gradient) {
    gradient = 0;
    if (!(objective.entropy_weight > 0)) return 0;
    const float o = smaller(larger(opacity, entropy_rim), 1 - entropy_rim), weight = share * objective.entropy_weight;
    const float hit = natural_logarithm(o), miss = natural_logarithm(1 - o);
    if (o == opacity) gradient = weight * (miss - hit);
    return -weight * (o * hit + (1 - o) * miss);
}

// share: the weights of the pixel's rays over the sum of weights.
inline RayLoss pixel_loss(const MulanObjective& o, const float* target, float share, const float colour[3],
                          float variance) {
    RayLoss r;
    float error[3];
    for (int c = 0; c < 3; ++c) {
        error[c] = colour[c] - target[c];
        r.squared_error += error[c] * error[c] / 3.0;
    }
    // Likelihood of the error under the rendered variance (Kendall and Gal 2017, eq. 5; ActiveNeRF, eq. 10).
    const float v = variance + rendered_variance_floor, square = (float)r.squared_error;
    const float to_variance = share * 0.5f * (1 / v - square / (v * v));
    if (o.likelihood) {
        for (int c = 0; c < 3; ++c) r.colour_gradient[c] = share * error[c] / (3 * v);
        r.variance_gradient = to_variance;
        r.loss = share * 0.5 * (square / v + natural_logarithm(v));
    } else {
        judge_error(o.huber_delta, share, error, r);
        r.variance_gradient = o.variance_weight * to_variance;  // the error counts as given
    }
    return r;
}

}  // namespace mulan::MULAN_ISA
