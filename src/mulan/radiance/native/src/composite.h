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

// Turns the gradient to the blends into that to the optical depths, in place.
inline void blend_ray_backward(int kept, const float* blend, const float* reach_after, float* gradient) {
    float later = 0;
    for (int i = kept - 1; i >= 0; --i) {
        const float to_blend = gradient[i];
        gradient[i] = to_blend * reach_after[i] - later;
        later += to_blend * blend[i];
    }
}

// Distortion of one ray's blend, times a weight (mip-NeRF 360, eq. 15), in one pass as the samples' places are in
// order (DVGO v2, eq. 4); adds its gradient to that of the blends. step: length of ray a sample stands for.
inline float distort(int n, const float* blend, const float* place, float step, float weight, float* to_blend) {
    float all = 0, all_moments = 0, before = 0, moments_before = 0, cost = 0;
    for (int i = 0; i < n; ++i) {
        all += blend[i];
        all_moments += blend[i] * place[i];
    }
    for (int i = 0; i < n; ++i) {
        const float b = blend[i], s = place[i], in_front = s * before - moments_before;
        before += b;
        moments_before += b * s;
        const float behind = all_moments - moments_before - s * (all - before);
        cost += 2 * b * in_front + b * b * step / 3;
        to_blend[i] += weight * 2 * (in_front + behind + b * step / 3);
    }
    return weight * cost;
}

}  // namespace mulan::MULAN_ISA
