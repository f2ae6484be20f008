// What parallel loops need to know of their thread.
#pragma once
#ifdef _OPENMP
#include <omp.h>
#endif

namespace mulan::MULAN_ISA {

inline int thread_number() {
#ifdef _OPENMP
    return omp_get_thread_num();
#else
    return 0;
#endif
}

}  // namespace mulan::MULAN_ISA
