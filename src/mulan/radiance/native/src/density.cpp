// Density without rays: at given points, and in the cells of the occupancy grid.
#include "setup.h"

namespace mulan::MULAN_ISA {
namespace {

// Densities per scene radius at the tile's first n points, left in t.depth.
void evaluate(const Evaluation& e, Tile& t, int n) {
    for (int k = 0; k < n; ++k) t.step[k] = 1;
    evaluate_density(e, t, n);
}

}  // namespace

int32_t density(MulanWorkspace* w, const MulanField* field, const MulanParameters* p, int64_t n,
                const float* unit_points, float* density) {
    const Networks networks = prepare_networks(*w, *field, p->networks);
    const Tiles tiles = prepare_tiles(*w, networks, tile_samples);
    const MulanScene scene{};
    const Evaluation e{*field, scene, p->table, networks};
    parallel_for(*w, (n + tile_samples - 1) / tile_samples, [&](int64_t part, int thread) {
        Tile t = tiles.of(thread);
        const int64_t first = part * tile_samples;
        const int count = (int)smaller<int64_t>(tile_samples, n - first);
        for (int k = 0; k < count; ++k) {
            t.x[k] = unit_points[3 * (first + k)];
            t.y[k] = unit_points[3 * (first + k) + 1];
            t.z[k] = unit_points[3 * (first + k) + 2];
        }
        evaluate(e, t, count);
        __builtin_memcpy(density + first, t.depth, sizeof(float) * (size_t)count);
    });
    return MULAN_OK;
}

int32_t occupancy_refresh(MulanWorkspace* w, const MulanField* field, const MulanScene* scene,
                          const MulanParameters* p, float decay, int32_t stride, int32_t occupied_stride,
                          int32_t phase, uint64_t seed, const uint8_t* occupied, float* opacity) {
    const Networks networks = prepare_networks(*w, *field, p->networks);
    const Tiles tiles = prepare_tiles(*w, networks, tile_samples);
    const MulanOccupancy none{};
    const March march(*scene, none, nullptr);
    const Evaluation e{*field, *scene, p->table, networks};
    const int side = scene->occupancy_resolution;
    const uint32_t every = (uint32_t)stride, occupied_every = (uint32_t)occupied_stride;
    const uint32_t cell_phase = (uint32_t)phase % every, occupied_phase = (uint32_t)phase % occupied_every;
    // every slab is one thread's, and its cells do not depend on each other
    parallel_for(*w, (int64_t)scene->cascades * side, [&](int64_t slab, int thread) {
        Tile t = tiles.of(thread);
        const int cascade = (int)slab / side, z = (int)slab % side;
        const float magnification = (float)(1 << (scene->cascades - 1 - cascade));
        auto within_finer = [&](int i) { return cascade > 0 && i >= side / 4 && i < side - side / 4; };
        int n = 0;
        auto finish = [&] {
            evaluate(e, t, n);
            for (int k = 0; k < n; ++k) {
                const float unit[3] = {t.x[k], t.y[k], t.z[k]};
                float world[3], square = 0;
                to_world(*scene, unit, world);
                for (int a = 0; a < 3; ++a)
                    square += (world[a] - scene->centre_m[a]) * (world[a] - scene->centre_m[a]);
                const float step = march.step_m(__builtin_sqrtf(square)) / scene->radius_m;
                float& value = opacity[t.ray_id[k]];
                value = larger(value * decay, t.depth[k] * step);
            }
            n = 0;
        };
        for (int y = 0; y < side; ++y)
            for (int x = 0; x < side; ++x) {
                if (within_finer(x) && within_finer(y) && within_finer(z)) continue;
                const uint32_t cell = (uint32_t)(x + side * (y + side * (int)slab));
                const bool visited = cell % every == cell_phase ||
                                     (occupied[cell] && cell % occupied_every == occupied_phase);
                if (!visited) continue;
                auto unit = [&](int i, uint32_t axis) {
                    return (((float)i + uniform(seed, cell, axis)) / (float)side - 0.5f) / magnification + 0.5f;
                };
                t.x[n] = unit(x, 1);
                t.y[n] = unit(y, 2);
                t.z[n] = unit(z, 3);
                t.ray_id[n] = cell;
                if (++n == tile_samples) finish();
            }
        finish();
    });
    return MULAN_OK;
}

}  // namespace mulan::MULAN_ISA
