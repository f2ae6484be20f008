// Rendering: blocks of rays advance together in rounds, so that nothing behind an opaque surface is evaluated.
#include "setup.h"

namespace mulan::MULAN_ISA {
namespace {

constexpr int block_rays = 64;

struct Sums {
    float colour[3], opacity, moment, variance;
};

struct Block {
    RayMarch march[block_rays];
    Sums sums[block_rays];
    int32_t alive[block_rays];
};

void add_samples(const Tile& t, int slot, Sums& s) {
    for (int k = t.first[slot]; k < t.first[slot] + t.kept[slot]; ++k) {
        const float blend = t.blend[k];
        for (int c = 0; c < 3; ++c) s.colour[c] += blend * t.colour[3 * k + c];
        s.opacity += blend;
        s.moment += blend * t.t[k];
        s.variance += blend * blend * t.variance[k];
    }
}

// The next few samples of every ray still alive; returns how many rays go on.
int advance(const Evaluation& e, const March& march, const MulanRays& rays, int64_t first_ray, Block& b, Tile& t,
            int alive, float* left_transmittance) {
    const int share = tile_samples / alive;
    int n = 0, going_on = 0;
    for (int slot = 0; slot < alive; ++slot) {
        const int i = b.alive[slot];
        const int64_t ray = first_ray + i;
        t.first[slot] = n;
        t.count[slot] = b.march[i].collect(march, t.t + n, share);
        t.transmittance[slot] = left_transmittance[i];
        place_samples(e, march, t, slot, n, t.count[slot], rays.origins + 3 * ray, rays.directions + 3 * ray);
        evaluate_direction(e, t, slot, rays.directions + 3 * ray);
        n += t.count[slot];
    }
    evaluate_density(e, t, n);
    n = drop_unreached(e, t, alive, march.thinnest());
    evaluate_directions(e, t, alive);
    evaluate_colour(e, t, n);
    evaluate_variance(e, t, n);
    for (int slot = 0; slot < alive; ++slot) {
        const int i = b.alive[slot];
        add_samples(t, slot, b.sums[i]);
        left_transmittance[i] = t.transmittance[slot];
        if (t.count[slot] == share && t.transmittance[slot] > e.scene.min_transmittance) b.alive[going_on++] = i;
    }
    return going_on;
}

}  // namespace

int32_t render(MulanWorkspace* w, const MulanField* field, const MulanScene* scene, const MulanOccupancy* occupancy,
               const MulanParameters* p, const MulanRays* rays, const MulanRendering* out) {
    const Networks networks = prepare_networks(*w, *field, p->networks);
    const Tiles tiles = prepare_tiles(*w, networks, tile_samples);
    const March march(*scene, *occupancy, prepare_march_table(*w, *scene));
    const Evaluation e{*field, *scene, p->table, networks};
    const int64_t blocks = (rays->count + block_rays - 1) / block_rays;
    parallel_for(*w, blocks, [&](int64_t block, int thread) {
        Tile tile = tiles.of(thread);
        Block b;
        float transmittance[block_rays];
        const int64_t first = block * block_rays;
        const int count = (int)smaller<int64_t>(block_rays, rays->count - first);
        for (int i = 0; i < count; ++i) {
            const int64_t ray = first + i;
            b.march[i] = RayMarch(march, rays->origins + 3 * ray, rays->directions + 3 * ray,
                                  ray_jitter(*rays, ray));
            b.sums[i] = Sums{};
            b.alive[i] = i;
            transmittance[i] = 1;
        }
        for (int alive = count; alive > 0;)
            alive = advance(e, march, *rays, first, b, tile, alive, transmittance);
        for (int i = 0; i < count; ++i) {
            const int64_t ray = first + i;
            const Sums& s = b.sums[i];
            for (int c = 0; c < 3; ++c) {
                const float value = s.colour[c] + (1 - s.opacity) * scene->background[c];
                out->colour[3 * ray + c] = smaller(larger(value, 0.0f), 1.0f);
            }
            out->depth_m[ray] = s.moment / larger(s.opacity, 1e-10f);
            out->opacity[ray] = s.opacity;
            out->variance[ray] = s.variance;
        }
    });
    return MULAN_OK;
}

int32_t sample(MulanWorkspace* w, const MulanField* field, const MulanScene* scene, const MulanOccupancy* occupancy,
               const MulanParameters* p, const MulanRays* rays, const int64_t* offsets, int32_t* kept, float* blend,
               float* colour, float* variance, float* distance_m) {
    const Networks networks = prepare_networks(*w, *field, p->networks);
    const Tiles tiles = prepare_tiles(*w, networks, larger(tile_samples, scene->steps));
    const March march(*scene, *occupancy, prepare_march_table(*w, *scene));
    const Evaluation e{*field, *scene, p->table, networks};
    parallel_for(*w, rays->count, [&](int64_t ray, int thread) {
        Tile t = tiles.of(thread);
        const float *o = rays->origins + 3 * ray, *d = rays->directions + 3 * ray;
        RayMarch walk(march, o, d, ray_jitter(*rays, ray));
        // no more than the caller made room for, whatever the arguments
        const int room = (int)smaller<int64_t>(scene->steps, offsets[ray + 1] - offsets[ray]);
        t.first[0] = 0;
        t.count[0] = walk.collect(march, t.t, larger(room, 0));
        t.transmittance[0] = 1;
        place_samples(e, march, t, 0, 0, t.count[0], o, d);
        evaluate_direction(e, t, 0, d);
        evaluate_density(e, t, t.count[0]);
        const int n = drop_unreached(e, t, 1, march.thinnest());
        evaluate_directions(e, t, 1);
        evaluate_colour(e, t, n);
        evaluate_variance(e, t, n);
        kept[ray] = n;
        const int64_t at = offsets[ray];
        __builtin_memcpy(blend + at, t.blend, sizeof(float) * (size_t)n);
        __builtin_memcpy(colour + 3 * at, t.colour, sizeof(float) * (size_t)(3 * n));
        __builtin_memcpy(variance + at, t.variance, sizeof(float) * (size_t)n);
        __builtin_memcpy(distance_m + at, t.t, sizeof(float) * (size_t)n);
    });
    return MULAN_OK;
}

}  // namespace mulan::MULAN_ISA
