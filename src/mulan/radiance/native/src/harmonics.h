// Real spherical harmonics of a direction, order and signs as in instant-ngp (Sloan 2013), and their derivative.
#pragma once
#include "simd.h"

namespace mulan::MULAN_ISA {

inline void harmonics(int degree, const float* d, float* out) {
    const float x = d[0], y = d[1], z = d[2];
    out[0] = 0.28209479177387814f;
    if (degree < 2) return;
    out[1] = -0.48860251190291987f * y;
    out[2] = 0.48860251190291987f * z;
    out[3] = -0.48860251190291987f * x;
    if (degree < 3) return;
    out[4] = 1.0925484305920792f * x * y;
    out[5] = -1.0925484305920792f * y * z;
    out[6] = 0.94617469575756f * z * z - 0.31539156525252f;
    out[7] = -1.0925484305920792f * x * z;
    out[8] = 0.5462742152960396f * (x * x - y * y);
    if (degree < 4) return;
    out[9] = 0.5900435899266435f * y * (-3 * x * x + y * y);
    out[10] = 2.890611442640554f * x * y * z;
    out[11] = 0.4570457994644657f * y * (1 - 5 * z * z);
    out[12] = 0.3731763325901154f * z * (5 * z * z - 3);
    out[13] = 0.4570457994644657f * x * (1 - 5 * z * z);
    out[14] = 1.445305721320277f * z * (x * x - y * y);
    out[15] = 0.5900435899266435f * x * (-x * x + 3 * y * y);
}

// Adds the gradient to the direction, whose three numbers count as independent.
inline void harmonics_backward(int degree, const float* d, const float* g, float* out) {
    const float x = d[0], y = d[1], z = d[2];
    if (degree < 2) return;
    out[0] += -0.48860251190291987f * g[3];
    out[1] += -0.48860251190291987f * g[1];
    out[2] += 0.48860251190291987f * g[2];
    if (degree < 3) return;
    out[0] += 1.0925484305920792f * (y * g[4] - z * g[7] + x * g[8]);
    out[1] += 1.0925484305920792f * (x * g[4] - z * g[5] - y * g[8]);
    out[2] += 1.0925484305920792f * (-y * g[5] - x * g[7]) + 1.89234939151512f * z * g[6];
    if (degree < 4) return;
    const float a = 0.5900435899266435f, b = 2.890611442640554f, c = 0.4570457994644657f, e = 0.3731763325901154f,
                f = 1.445305721320277f;
    out[0] += -6 * a * x * y * g[9] + b * y * z * g[10] + c * (1 - 5 * z * z) * g[13] + 2 * f * x * z * g[14] +
              3 * a * (y * y - x * x) * g[15];
    out[1] += 3 * a * (y * y - x * x) * g[9] + b * x * z * g[10] + c * (1 - 5 * z * z) * g[11] -
              2 * f * y * z * g[14] + 6 * a * x * y * g[15];
    out[2] += b * x * y * g[10] - 10 * c * z * (y * g[11] + x * g[13]) + e * (15 * z * z - 3) * g[12] +
              f * (x * x - y * y) * g[14];
}

}  // namespace mulan::MULAN_ISA
