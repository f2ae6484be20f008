// Scratch memory that grows to what the largest call needed and is used again by the next.
// Included by code of every instruction set: declarations only, so that nothing is compiled twice.
#pragma once
#include <stddef.h>

#include "../include/mulan_native.h"
#include "thread_pool.h"

namespace mulan {

class Buffer {
  public:
    Buffer() = default;
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer();
    // At least so many bytes at a 64-byte boundary; zeroed when it grows, else as it was left.
    // Throws std::bad_alloc: call it outside parallel regions.
    void* reserve(size_t bytes);
    size_t bytes() const;

  private:
    void* memory_ = nullptr;
    size_t bytes_ = 0;
};

}  // namespace mulan

namespace mulan {

// Whether every ray belongs to one of the images.
bool valid(const MulanPoses* p, int64_t rays);

}  // namespace mulan

struct MulanWorkspace {
    explicit MulanWorkspace(int threads);

    mulan::ThreadPool pool;
    mulan::Buffer packed_networks, tiles, march_table, ray_samples, ray_lists, tile_lists;
    mulan::Buffer group_gradients, network_gradient, samples, encoded, scatter_gradients;
    mulan::Buffer table_gradient, ray_gradients;
};
