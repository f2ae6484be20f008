// Picks the newest build the processor can run. Compiled for the plain processor.
#include <atomic>
#include <cstring>

#include "kernels.h"

namespace mulan {

#if MULAN_X86_DISPATCH
namespace x86_64 {
extern const Kernels table;
}
namespace x86_64_v3 {
extern const Kernels table;
}
namespace x86_64_v4 {
extern const Kernels table;
}

static bool runs_v3() {
#if !defined(__clang__)  // clang 14 cannot ask; no processor has AVX2 and FMA without it
    if (!__builtin_cpu_supports("f16c")) return false;
#endif
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
}
static bool runs_v4() {
    return runs_v3() && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
}

static const Kernels* find(const char* name) {
    if ((!name || !std::strcmp(name, "x86-64-v4")) && runs_v4()) return &x86_64_v4::table;
    if ((!name || !std::strcmp(name, "x86-64-v3")) && runs_v3()) return &x86_64_v3::table;
    if (!name || !std::strcmp(name, "x86-64")) return &x86_64::table;
    return nullptr;
}
#else
namespace generic {
extern const Kernels table;
}
static const Kernels* find(const char* name) {
    return !name || !std::strcmp(name, generic::table.instruction_set) ? &generic::table : nullptr;
}
#endif

static std::atomic<const Kernels*> chosen{nullptr};

const Kernels& kernels() {
    const Kernels* k = chosen.load(std::memory_order_acquire);
    if (!k) {
        k = find(nullptr);
        chosen.store(k, std::memory_order_release);
    }
    return *k;
}

bool choose_kernels(const char* instruction_set) {
    const Kernels* k = instruction_set ? find(instruction_set) : nullptr;
    if (k) chosen.store(k, std::memory_order_release);
    return k != nullptr;
}

}  // namespace mulan
