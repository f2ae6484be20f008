// Loops over independent iterations, shared among a workspace's threads.
#pragma once
#include "simd.h"
#include "workspace.h"

namespace mulan::MULAN_ISA {

// Calls body(i, thread) for every i below `iterations`; which thread takes which, and in what order, is open.
template <class Body> void parallel_for(MulanWorkspace& w, int64_t iterations, const Body& body) {
    w.pool.run(
        iterations,
        [](const void* b, ThreadPool& pool, int thread) {
            FlushDenormals flush;
            for (int64_t i = pool.claim(); i >= 0; i = pool.claim()) (*(const Body*)b)(i, thread);
        },
        &body);
}

}  // namespace mulan::MULAN_ISA
