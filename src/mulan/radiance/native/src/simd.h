// Short vectors of floats through the compiler's own vector types: one source for AVX-512, AVX2, SSE2 and NEON.
//
// Everything in this folder's kernel files lives in namespace mulan::MULAN_ISA, because the same source is compiled
// once an instruction set into one library. For the same reason kernels use no templates of the standard library:
// the linker would merge their copies, and a plain processor could run the AVX-512 one.
#pragma once
#include <stdint.h>

namespace mulan::MULAN_ISA {

#if defined(__AVX512F__)
constexpr int lanes = 16;
constexpr int block_rows = 8;  // 8 rows x 2 vectors of sums fill half of the 32 registers
#elif defined(__AVX2__)
constexpr int lanes = 8;
constexpr int block_rows = 4;
#else
constexpr int lanes = 4;
constexpr int block_rows = 4;
#endif
constexpr int row_padding = 16;  // buffers end with this many spare rows, so that kernels need no remainder loops

typedef float vfloat __attribute__((vector_size(lanes * 4)));
typedef int32_t vint __attribute__((vector_size(lanes * 4)));
typedef uint32_t vuint __attribute__((vector_size(lanes * 4)));

// The two features of one table entry, and of two.
typedef float vpair __attribute__((vector_size(8)));
typedef float vquad __attribute__((vector_size(16)));

constexpr int padded(int n) { return (n + lanes - 1) / lanes * lanes; }

template <class T> inline T smaller(T a, T b) { return b < a ? b : a; }
template <class T> inline T larger(T a, T b) { return a < b ? b : a; }

inline vfloat load(const float* p) {
    vfloat v;
    __builtin_memcpy(&v, p, sizeof v);
    return v;
}
inline void store(float* p, vfloat v) { __builtin_memcpy(p, &v, sizeof v); }
inline void store(uint32_t* p, vuint v) { __builtin_memcpy(p, &v, sizeof v); }
inline vfloat splat(float x) { return x - vfloat{}; }
inline vuint splat(uint32_t x) { return x - vuint{}; }

inline vpair load_pair(const float* p) {
    vpair v;
    __builtin_memcpy(&v, p, sizeof v);
    return v;
}
inline void store(float* p, vpair v) { __builtin_memcpy(p, &v, sizeof v); }
inline vquad load_quad(const float* p) {
    vquad v;
    __builtin_memcpy(&v, p, sizeof v);
    return v;
}
inline vquad join(vpair a, vpair b) { return __builtin_shufflevector(a, b, 0, 1, 2, 3); }

// A NaN gives the lower bound: comparisons with NaN are false.
inline vfloat clamp(vfloat x, float low, float high) {
    x = x > low ? x : splat(low);
    return x < high ? x : splat(high);
}

inline float sum(vfloat v) {
    float total = 0;
    for (int i = 0; i < lanes; ++i) total += v[i];
    return total;
}

inline float dot(const float* a, const float* b, int padded_length) {
    vfloat total{};
    for (int i = 0; i < padded_length; i += lanes) total += load(a + i) * load(b + i);
    return sum(total);
}

// Cephes' expf: 1 unit in the last place or so; saturates instead of overflowing.
inline vfloat exponential(vfloat x) {
    x = clamp(x, -87.3f, 88.3f);
    const float rounding = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer
    vfloat n = (x * 1.44269504088896341f + rounding) - rounding;
    vfloat r = x - n * 0.693359375f + n * 2.12194440e-4f;
    vfloat p = 1.9875691500e-4f * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    vint scale = (__builtin_convertvector(n, vint) + 127) << 23;
    return p * (vfloat)scale;
}

inline vfloat sigmoid(vfloat x) { return 1.0f / (1.0f + exponential(-x)); }

// Cephes' logf for positive, normal numbers.
inline vfloat logarithm(vfloat x) {
    const vint bits = (vint)x;
    vint exponent = ((bits >> 23) & 0xff) - 126;
    vfloat m = (vfloat)((bits & 0x007fffff) | 0x3f000000);  // in [0.5, 1)
    const vint low = m < 0.707106781186547524f;
    exponent += low;  // a true comparison is -1
    m = (low ? m + m : m) - 1.0f;
    vfloat p = 7.0376836292e-2f * m - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    const vfloat e = __builtin_convertvector(exponent, vfloat), square = m * m;
    return m + (p * m * square - 2.12194440e-4f * e - 0.5f * square) + 0.693359375f * e;
}

// log(1 + exp(x)); for very negative x the exponential itself, which 1 + would round away.
inline vfloat softplus(vfloat x) {
    const vfloat small = exponential(x < 0.0f ? x : -x);
    const vfloat tail = small < 1e-4f ? small : logarithm(1.0f + small);
    return (x > 0.0f ? x : vfloat{}) + tail;
}

// Denormal numbers (Adam's fading moments) are slow; kernels treat them as zero and leave the caller's mode as it was.
class FlushDenormals {
#if defined(__x86_64__)
    unsigned saved_ = __builtin_ia32_stmxcsr();

  public:
    FlushDenormals() { __builtin_ia32_ldmxcsr(saved_ | 0x8040); }
    ~FlushDenormals() { __builtin_ia32_ldmxcsr(saved_); }
#elif defined(__aarch64__)
    uint64_t saved_;

  public:
    FlushDenormals() {
        asm volatile("mrs %0, fpcr" : "=r"(saved_));
        asm volatile("msr fpcr, %0" ::"r"(saved_ | (1ull << 24)));
    }
    ~FlushDenormals() { asm volatile("msr fpcr, %0" ::"r"(saved_)); }
#else
  public:
    FlushDenormals() {}
    ~FlushDenormals() {}
#endif
};

}  // namespace mulan::MULAN_ISA
