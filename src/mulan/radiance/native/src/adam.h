// Adam (Kingma and Ba 2015), written as torch.optim.Adam computes it.
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

// Which product is fused is not the compiler's choice: wherever Adam is inlined it gives the same bits.
inline float multiply_add(float a, float b, float c) {
#ifdef __FP_FAST_FMAF
    return __builtin_fmaf(a, b, c);
#else
    return a * b + c;
#endif
}

struct AdamStep {
    float rate, beta1, beta2, epsilon, correction;  // rate includes the mean's bias correction
    bool skip_untouched;

    AdamStep(float base_rate, float b1, float b2, float eps, int64_t step, bool skip)
        : beta1(b1), beta2(b2), epsilon(eps), skip_untouched(skip) {
        rate = (float)(base_rate / (1 - __builtin_pow(b1, (double)step)));
        correction = (float)(1 / __builtin_sqrt(1 - __builtin_pow(b2, (double)step)));
    }

    void update(float& value, float& mean, float& square, float g) const {
        mean = multiply_add(beta1, mean, (1 - beta1) * g);
        square = multiply_add(beta2, square, (1 - beta2) * g * g);
        value -= rate * mean / multiply_add(__builtin_sqrtf(square), correction, epsilon);
    }
};

// Entries without gradient are either updated too (their mean still carries them on) or left alone entirely.
inline void adam(const AdamStep& a, int64_t n, float* __restrict value, float* __restrict mean,
                 float* __restrict square, const float* __restrict gradient) {
    constexpr int block = 16;
    int64_t i = 0;
    for (; i + block <= n; i += block) {
        if (a.skip_untouched) {
            uint64_t bits[block / 2], touched = 0;
            __builtin_memcpy(bits, gradient + i, sizeof bits);
            for (uint64_t two : bits) touched |= two;
            if (touched == 0) continue;
        }
#pragma GCC ivdep
        for (int64_t k = i; k < i + block; ++k) {
            const bool update = !a.skip_untouched || gradient[k] != 0;
            float v = value[k], m = mean[k], s = square[k];
            a.update(v, m, s, gradient[k]);
            value[k] = update ? v : value[k];
            mean[k] = update ? m : mean[k];
            square[k] = update ? s : square[k];
        }
    }
    for (; i < n; ++i)
        if (!a.skip_untouched || gradient[i] != 0) a.update(value[i], mean[i], square[i], gradient[i]);
}

}  // namespace mulan::MULAN_ISA
