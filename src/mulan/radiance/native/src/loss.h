// What a ray's error costs, and the gradient of that to what the ray sees (mulan.radiance.loss).
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

constexpr float rendered_variance_floor = 1e-4f;
constexpr float entropy_rim = 1e-3f;  // opacities nearer to 0 or 1 count as decided

struct RayLoss {
    double loss = 0;           // weighted by the ray's share
    double squared_error = 0;  // mean over channels, unweighted
    float share = 0;           // the ray's weight over the sum of weights
    float colour_gradient[3] = {};
    float opacity_gradient = 0;   // beside what the colour says
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

// Entropy of hitting something, flat at its ends.
inline void judge_opacity(float weight, float opacity, RayLoss& r) {
    const float o = smaller(larger(opacity, entropy_rim), 1 - entropy_rim);
    const float hit = natural_logarithm(o), miss = natural_logarithm(1 - o);
    r.loss -= r.share * weight * (o * hit + (1 - o) * miss);
    if (o == opacity) r.opacity_gradient = r.share * weight * (miss - hit);
}

inline RayLoss ray_loss(const MulanObjective& o, const float* target, float share, const float colour[3],
                        float opacity, float variance) {
    RayLoss r;
    r.share = share;
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
    if (o.entropy_weight > 0) judge_opacity(o.entropy_weight, opacity, r);
    return r;
}

}  // namespace mulan::MULAN_ISA
