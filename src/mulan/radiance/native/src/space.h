// World to unit cube (mulan.radiance.space.SceneSpace).
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

inline void to_unit(const MulanScene& s, const float world[3], float unit[3]) {
    float x[3], norm = 1e-9f;
    for (int a = 0; a < 3; ++a) {
        x[a] = (world[a] - s.centre_m[a]) / s.radius_m;
        norm = larger(norm, __builtin_fabsf(x[a]));
    }
    if (!s.unbounded) {
        for (int a = 0; a < 3; ++a) unit[a] = x[a] * 0.5f + 0.5f;
        return;
    }
    const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
    for (int a = 0; a < 3; ++a) unit[a] = x[a] * scale * 0.25f + 0.5f;
}

inline void to_world(const MulanScene& s, const float unit[3], float world[3]) {
    float y[3], norm = 1e-9f;
    const float spread = s.unbounded ? 4.0f : 2.0f;
    for (int a = 0; a < 3; ++a) {
        y[a] = (unit[a] - 0.5f) * spread;
        norm = larger(norm, __builtin_fabsf(y[a]));
    }
    // the rim of the contracted cube is infinitely far away
    const float scale = !s.unbounded || norm <= 1 ? 1.0f : 1 / (larger(2 - norm, 1e-6f) * norm);
    for (int a = 0; a < 3; ++a) world[a] = s.centre_m[a] + s.radius_m * scale * y[a];
}

// Gradient to the world point from the gradient to the unit point.
inline void to_unit_backward(const MulanScene& s, const float world[3], const float g[3], float out[3]) {
    if (!s.unbounded) {
        for (int a = 0; a < 3; ++a) out[a] = g[a] * 0.5f / s.radius_m;
        return;
    }
    float x[3], norm = 0;
    int widest = 0;
    for (int a = 0; a < 3; ++a) {
        x[a] = (world[a] - s.centre_m[a]) / s.radius_m;
        if (__builtin_fabsf(x[a]) > norm) {
            norm = __builtin_fabsf(x[a]);
            widest = a;
        }
    }
    const float outer = 0.25f / s.radius_m;
    const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
    for (int a = 0; a < 3; ++a) out[a] = outer * scale * g[a];
    if (norm <= 1) return;
    // the scale depends on the widest coordinate alone
    const float slope = (2 / norm - 2) / (norm * norm);
    const float along = x[0] * g[0] + x[1] * g[1] + x[2] * g[2];
    out[widest] += outer * slope * along * (x[widest] < 0 ? -1.0f : 1.0f);
}

}  // namespace mulan::MULAN_ISA
