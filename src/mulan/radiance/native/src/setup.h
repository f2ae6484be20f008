// Preparing a call: packed networks, a tile a thread, the march table.
#pragma once
#include "parallel.h"
#include "random.h"
#include "tile.h"
#include "workspace.h"

namespace mulan::MULAN_ISA {

inline Networks prepare_networks(MulanWorkspace& w, const MulanField& field, const float* parameters) {
    Arena size;
    plan_networks(field, size);
    Arena arena{(char*)w.packed_networks.reserve((size_t)size.used), 0};
    Networks n = plan_networks(field, arena);
    pack_networks(n, parameters);
    return n;
}

// One tile a thread.
struct Tiles {
    char* base;
    int64_t bytes;
    const Networks* networks;
    int capacity;

    Tile of(int thread) const {
        Arena arena{base + thread * bytes, 0};
        return carve_tile(*networks, capacity, arena);
    }
};

inline Tiles prepare_tiles(MulanWorkspace& w, const Networks& n, int capacity) {
    Arena size;
    carve_tile(n, capacity, size);
    // an odd number of cache lines more, lest all threads' rows fall on the same cache sets
    const int64_t bytes = size.used + 4096 + 64 * 5;
    return {(char*)w.tiles.reserve((size_t)(bytes * w.pool.threads())), bytes, &n, capacity};
}

inline const float* prepare_march_table(MulanWorkspace& w, const MulanScene& scene) {
    float* table = (float*)w.march_table.reserve((size_t)scene.steps * 8);
    if (scene.unbounded) fill_march_table(scene, table);
    return table;
}

inline float ray_jitter(const MulanRays& rays, int64_t ray) {
    return rays.jitter ? uniform(rays.seed, (uint32_t)(rays.first + ray), 0) : 0.5f;
}

}  // namespace mulan::MULAN_ISA
