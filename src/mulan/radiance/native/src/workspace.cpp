#include "workspace.h"

#include <cstdint>
#include <cstring>
#include <new>

namespace mulan {

// Not std::aligned_alloc, which neither MinGW nor macOS before 10.15 has.
constexpr std::align_val_t page{4096};

Buffer::~Buffer() { ::operator delete(memory_, page); }

void* Buffer::reserve(size_t bytes) {
    if (bytes <= bytes_) return memory_;
    if (bytes > SIZE_MAX / 2) throw std::bad_alloc();
    const size_t rounded = (bytes + bytes / 4 + 4095) / 4096 * 4096;  // a quarter more: batches vary in size
    ::operator delete(memory_, page);
    memory_ = nullptr;
    bytes_ = 0;
    memory_ = ::operator new(rounded, page);
    bytes_ = rounded;
    return std::memset(memory_, 0, rounded);
}

size_t Buffer::bytes() const { return bytes_; }

bool valid(const MulanPoses* p, int64_t rays) {
    if (!p || rays < 0 || p->images < 0 || (p->images > 0 && (!p->gradient || !p->R_world_camera))) return false;
    if (rays > 0 && !p->image_index) return false;
    for (int64_t i = 0; i < rays; ++i)
        if (p->image_index[i] < 0 || p->image_index[i] >= p->images) return false;
    return true;
}

}  // namespace mulan

MulanWorkspace::MulanWorkspace(int threads) : pool(threads) {}
