// Random numbers as a function of what they are for: no state, so no dependence on threads or order.
#pragma once
#include "simd.h"

namespace mulan::MULAN_ISA {

// "lowbias32", Wellons, "Prospecting for hash functions", 2018.
inline uint32_t mix(uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}

// Uniform in [0, 1).
inline float uniform(uint64_t seed, uint32_t index, uint32_t dimension) {
    uint32_t h = mix(index ^ mix((uint32_t)seed ^ mix((uint32_t)(seed >> 32) ^ mix(dimension))));
    return (float)(h >> 8) * 0x1p-24f;
}

}  // namespace mulan::MULAN_ISA
