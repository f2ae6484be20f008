// How far light travels along each ray of an unbounded scene, by densities alone, before anything is learnt from it.
//
// Behind the walls of a room lies most of a ray, and the air before them is nearly empty; so it pays to evaluate the
// front part twice rather than fill the tiles with samples that are dropped anyway.
#pragma once
#include "setup.h"

namespace mulan::MULAN_ISA {

constexpr int reach_block = 64;            // rays that advance together
constexpr float exploring_share = 0.1f;    // rays that learn from thin samples too, or nothing could ever grow

struct Reach {
    int32_t local, done, kept;  // ray of the wave; samples evaluated, and those worth learning from
    float transmittance, least_opacity;
};

struct ReachBlock {
    Reach alive[reach_block];
    int rays = 0;
};

// The samples found on a wave of rays: t [rays, steps] and counts [rays], both shortened here.
struct FoundSamples {
    Evaluation e;
    const March& march;
    const MulanRays& rays;
    MulanWorkspace& w;
    const Tiles& tiles;
    int64_t wave_first;
    float* t;
    int32_t* counts;
};

// The next few samples of every ray light still travels on.
inline void reach_further(const FoundSamples& f, Tile& tile, ReachBlock& block) {
    const MulanScene& scene = f.e.scene;
    const int share = tile_samples / block.rays;
    int n = 0;
    for (int slot = 0; slot < block.rays; ++slot) {
        const Reach& reach = block.alive[slot];
        const int64_t ray = f.wave_first + reach.local;
        const int more = smaller(share, f.counts[reach.local] - reach.done);
        tile.count[slot] = more;
        __builtin_memcpy(tile.t + n, f.t + (int64_t)reach.local * scene.steps + reach.done,
                         sizeof(float) * (size_t)more);
        place_samples(f.e, f.march, tile, slot, n, more, f.rays.origins + 3 * ray, f.rays.directions + 3 * ray);
        n += more;
    }
    evaluate_density(f.e, tile, n);
    int going_on = 0, at = 0;
    for (int slot = 0; slot < block.rays; ++slot) {
        Reach reach = block.alive[slot];
        float* ray_t = f.t + (int64_t)reach.local * scene.steps;
        for (int k = at; k < at + tile.count[slot] && reach.transmittance > scene.min_transmittance; ++k) {
            if (tile.alpha[k] < reach.least_opacity) continue;
            reach.transmittance *= tile.passed[k];
            ray_t[reach.kept++] = tile.t[k];
        }
        at += tile.count[slot];
        reach.done += tile.count[slot];
        if (reach.transmittance > scene.min_transmittance && reach.done < f.counts[reach.local])
            block.alive[going_on++] = reach;
        else
            f.counts[reach.local] = reach.kept;
    }
    block.rays = going_on;
}

// Forgets the samples that no light reaches or that are nearly empty. Blocks of rays do not depend on each other.
inline void forget_unreached(const FoundSamples& f, int count) {
    parallel_for(f.w, (count + reach_block - 1) / reach_block, [&](int64_t chunk, int thread) {
        Tile tile = f.tiles.of(thread);
        const int begin = (int)chunk * reach_block, end = smaller(begin + reach_block, count);
        ReachBlock block;
        for (int i = begin; i < end; ++i) {
            if (f.counts[i] == 0) continue;
            const bool exploring = uniform(f.rays.seed, (uint32_t)(f.rays.first + f.wave_first + i), 4) < exploring_share;
            block.alive[block.rays++] = {i, 0, 0, 1.0f, exploring ? 0.0f : f.march.occupancy.least_opacity};
        }
        while (block.rays > 0) reach_further(f, tile, block);
    });
}

}  // namespace mulan::MULAN_ISA
