// Volume rendering along one ray (NeRF, eq. 3): blend_i = T_i (1 - exp(-depth_i)), T_i = exp(-sum of earlier depths).
#pragma once
#include "simd.h"

namespace mulan::MULAN_ISA {

// 1 - exp(-x) and exp(-x) of optical depths; exact to rounding for thin samples too.
inline void opacity_of(vfloat depth, vfloat& alpha, vfloat& passed) {
    passed = exponential(-depth);
    const vfloat series = depth * (1.0f - depth * (0.5f - depth * (1.0f / 6 - depth * (1.0f / 24))));
    alpha = depth < 0.02f ? series : 1.0f - passed;
}

// Blends the samples that at least min_transmittance of the light reaches, a front part of the ray; returns how many.
// transmittance: what reaches the first sample; on return, what leaves the last kept one.
// reach_after: what leaves each kept sample, for the backward pass.
inline int blend_ray(int n, const float* alpha, const float* passed, float min_transmittance, float& transmittance,
                     float* blend, float* reach_after) {
    int kept = 0;
    while (kept < n && transmittance > min_transmittance) {
        blend[kept] = transmittance * alpha[kept];
        transmittance *= passed[kept];
        reach_after[kept] = transmittance;
        ++kept;
    }
    return kept;
}

// Gradient to the optical depths from the gradient to the colour over the background.
inline void blend_ray_backward(int kept, const float* blend, const float* reach_after, const float* colour,
                               const float background[3], const float gradient[3], float* depth_gradient) {
    float later = 0;
    for (int i = kept - 1; i >= 0; --i) {
        float to_blend = 0;
        for (int c = 0; c < 3; ++c) to_blend += gradient[c] * (colour[3 * i + c] - background[c]);
        depth_gradient[i] = to_blend * reach_after[i] - later;
        later += to_blend * blend[i];
    }
}

}  // namespace mulan::MULAN_ISA
