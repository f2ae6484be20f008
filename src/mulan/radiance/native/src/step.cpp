// The training step: samples are encoded level by level, then everything about a tile of rays is done while it is in
// the cache, then the table learns level by level.
//
// The result does not depend on the number of threads: tiles are cut by the rays alone, every sum is taken in a fixed
// order (within a tile, over groups of tiles, over the tiles of a level), and no two threads add to one number.
#include "adam.h"
#include "pixels.h"
#include "reach.h"
#include "setup.h"

namespace mulan::MULAN_ISA {
namespace {

constexpr int rays_at_once = 64;         // marched by one thread before it looks for more
constexpr int gradient_groups = 32;      // networks' gradients summed apart, then together
constexpr int encoded_at_once = 2048;    // samples of some tiles, level after level
constexpr int64_t wave_samples = 1 << 20;  // bounds memory: rays beyond it wait for the next wave

struct Learn {
    MulanWorkspace& w;
    const MulanField& field;
    const MulanScene& scene;
    const MulanOccupancy& occupancy;
    const MulanRays& rays;
    const MulanObjective& objective;
    const Pixels& pixels;
    const MulanRendering* rendering;
    float *origin_gradient, *direction_gradient;
    bool parameters_wanted;

    const March& march;
    Networks networks;
    Tiles tiles;
    const float* table;

    // of the wave
    float* t = nullptr;         // [rays, steps]
    int32_t* counts = nullptr;  // [rays]
    int32_t* listed = nullptr;  // rays of the wave with samples
    TileRange* ranges = nullptr;
    int tile_count = 0;
    float* padded_gradients = nullptr;  // [groups, length]
    // marched samples, tile after tile; a tile closes its gaps in place
    float *sx = nullptr, *sy = nullptr, *sz = nullptr, *st = nullptr, *sstep = nullptr;
    int32_t* sray = nullptr;
    float* encoded = nullptr;  // [samples, encoded]
    float* scatter = nullptr;  // [levels, samples, 2]
    int64_t scatter_capacity = 0;

    void find_samples(int64_t first, int count) {
        const int steps = scene.steps;
        parallel_for(w, (count + rays_at_once - 1) / rays_at_once, [&](int64_t chunk, int) {
            const int begin = (int)chunk * rays_at_once, end = smaller(begin + rays_at_once, count);
            for (int i = begin; i < end; ++i) {
                const int64_t ray = first + i;
                counts[i] = 0;
                if (pixels.ignored(ray)) continue;
                RayMarch walk(march, rays.origins + 3 * ray, rays.directions + 3 * ray, ray_jitter(rays, ray));
                counts[i] = walk.collect(march, t + (int64_t)i * steps, steps);
            }
        });
    }

    int samples_of_pixel(int first) const {
        int samples = 0;
        for (int i = first; i < first + objective.rays_a_pixel; ++i) samples += counts[i];
        return samples;
    }

    // Consecutive rays with samples, until a tile is full; a pixel's rays stay together.
    void cut_tiles(int count) {
        int listed_count = 0;
        int64_t at = 0, in_tile = 0;
        tile_count = 0;
        for (int pixel = 0; pixel < count; pixel += objective.rays_a_pixel) {
            const int samples = samples_of_pixel(pixel);
            if (samples == 0) continue;
            if (tile_count == 0 || in_tile + samples > tile_samples) {
                at += (in_tile + row_padding - 1) / row_padding * row_padding;
                ranges[tile_count++] = TileRange{listed_count, 0, at, 0, 0, 0, 0};
                in_tile = 0;
            }
            in_tile += samples;
            TileRange& range = ranges[tile_count - 1];
            range.marched = in_tile;
            for (int i = pixel; i < pixel + objective.rays_a_pixel; ++i) {
                if (counts[i] == 0) continue;
                range.rays++;
                listed[listed_count++] = i;
            }
        }
        scatter_capacity = (at + in_tile) / row_padding * row_padding + 2 * row_padding;
    }

    // The tile's scratch memory, with the samples of a range in place of its own.
    Tile tile_of(const TileRange& range, int thread) const {
        Tile tile = tiles.of(thread);
        const int64_t at = range.scatter_at;
        tile.x = sx + at;
        tile.y = sy + at;
        tile.z = sz + at;
        tile.t = st + at;
        tile.step = sstep + at;
        tile.ray = sray + at;
        tile.encoded = encoded + at * networks.encoded;
        return tile;
    }

    void place(const TileRange& range, int64_t wave_first, int thread) const {
        const Evaluation e{field, scene, table, networks};
        Tile tile = tile_of(range, thread);
        int marched = 0;
        for (int slot = 0; slot < range.rays; ++slot) {
            const int local = listed[range.first_ray + slot];
            const int64_t ray = wave_first + local;
            __builtin_memcpy(tile.t + marched, t + (int64_t)local * scene.steps, sizeof(float) * (size_t)counts[local]);
            place_samples(e, march, tile, slot, marched, counts[local], rays.origins + 3 * ray,
                          rays.directions + 3 * ray);
            marched += counts[local];
        }
    }

    // Encodes the samples of many tiles level after level: a level's entries stay in the cache meanwhile.
    void encode_wave(int64_t wave_first) {
        const int64_t parts = (scatter_capacity + encoded_at_once - 1) / encoded_at_once;
        parallel_for(w, parts, [&](int64_t part, int thread) {
            int begin = 0;
            while (begin < tile_count && ranges[begin].scatter_at < part * encoded_at_once) ++begin;
            int end = begin;
            for (; end < tile_count && ranges[end].scatter_at < (part + 1) * encoded_at_once; ++end)
                place(ranges[end], wave_first, thread);
            if (begin == end) return;
            const int64_t at = ranges[begin].scatter_at;
            const int n = (int)(ranges[end - 1].scatter_at + ranges[end - 1].marched - at);
            for (int level = 0; level < field.levels; ++level)
                encode_level(field, table, level, {sx + at, sy + at, sz + at}, n, encoded + at * networks.encoded,
                             networks.encoded);
        });
    }

    void process(TileRange& range, int64_t wave_first, int thread, float* padded) {
        const Evaluation e{field, scene, table, networks};
        Tile tile = tile_of(range, thread);
        int marched = 0;
        for (int slot = 0; slot < range.rays; ++slot) {
            const int local = listed[range.first_ray + slot];
            tile.ray_id[slot] = wave_first + local;
            tile.first[slot] = marched;
            tile.count[slot] = counts[local];
            tile.transmittance[slot] = 1;
            evaluate_direction(e, tile, slot, rays.directions + 3 * tile.ray_id[slot]);
            marched += counts[local];
        }
        evaluate_encoded(e, tile, marched);
        const int n = drop_unreached(e, tile, range.rays);
        evaluate_directions(e, tile, range.rays);
        evaluate_colour(e, tile, n);
        const bool head = rendering || objective.likelihood || (parameters_wanted && objective.variance_weight > 0);
        if (head) evaluate_variance(e, tile, n);
        for (int slot = 0; slot < range.rays;) slot = pixels.learn_pixel(range, tile, slot, head);
        backpropagate(e, tile, n, range.rays, objective.likelihood, padded);
        range.kept = n;
        if (padded) {
            if (objective.likelihood || objective.variance_weight > 0) add_variance_gradient(e, tile, n, padded);
            keep_for_scatter(range, tile, n);
        }
        if (origin_gradient) ray_gradients(e, range, tile, n);
    }

    // The table's gradient waits, sorted by level, until all tiles are done.
    void keep_for_scatter(const TileRange& range, const Tile& tile, int n) {
        for (int level = 0; level < field.levels; ++level) {
            float* out = scatter + 2 * (level * scatter_capacity + range.scatter_at);
            const float* in = tile.d_encoded + 2 * level;
            for (int k = 0; k < n; ++k) {
                out[2 * k] = in[(int64_t)k * networks.encoded];
                out[2 * k + 1] = in[(int64_t)k * networks.encoded + 1];
            }
        }
    }

    // Each ray belongs to one tile, so its gradient is complete here. Sample distances count as given.
    void ray_gradients(const Evaluation& e, const TileRange& range, Tile& tile, int n) {
        encode_backward_points(field, table, {tile.x, tile.y, tile.z}, n, tile.d_encoded, networks.encoded, tile.d_x,
                               tile.d_y, tile.d_z);
        backward(networks.colour_direction, tile.d_direction_term, range.rays, tile.d_harmonics, Plain{});
        for (int slot = 0; slot < range.rays; ++slot) {
            const int64_t ray = tile.ray_id[slot];
            const float *o = rays.origins + 3 * ray, *d = rays.directions + 3 * ray;
            float to_origin[3] = {}, to_direction[3] = {};
            harmonics_backward(field.harmonics_degree, d, tile.d_harmonics + (int64_t)slot * networks.harmonics,
                               to_direction);
            for (int k = tile.first[slot]; k < tile.first[slot] + tile.kept[slot]; ++k) {
                const float world[3] = {o[0] + tile.t[k] * d[0], o[1] + tile.t[k] * d[1], o[2] + tile.t[k] * d[2]};
                const float unit[3] = {tile.d_x[k], tile.d_y[k], tile.d_z[k]};
                float g[3];
                to_unit_backward(e.scene, world, unit, g);
                for (int a = 0; a < 3; ++a) {
                    to_origin[a] += g[a];
                    to_direction[a] += tile.t[k] * g[a];
                }
            }
            for (int a = 0; a < 3; ++a) {
                origin_gradient[3 * ray + a] = to_origin[a];
                direction_gradient[3 * ray + a] = to_direction[a];
            }
        }
    }

    // One wave of rays: their loss, and the networks' part of the gradient.
    void learn_wave(int64_t first, int count, float* network_gradient, MulanStepReport& report) {
        find_samples(first, count);
        if (scene.unbounded)
            forget_unreached({{field, scene, table, networks}, march, rays, w, tiles, first, t, counts}, count);
        cut_tiles(count);
        const int groups = smaller(gradient_groups, tile_count);
        float** const columns[] = {&sx, &sy, &sz, &st, &sstep};
        float* samples = (float*)w.samples.reserve((size_t)(6 * scatter_capacity) * 4);
        for (float** column : columns) {
            *column = samples;
            samples += scatter_capacity;
        }
        sray = (int32_t*)samples;
        encoded = (float*)w.encoded.reserve((size_t)(scatter_capacity * networks.encoded) * 4);
        encode_wave(first);
        if (parameters_wanted) {
            const int64_t gradients = 2 * scatter_capacity * field.levels;
            scatter = (float*)w.scatter_gradients.reserve((size_t)gradients * 4);
            padded_gradients =
                (float*)w.group_gradients.reserve((size_t)(gradient_groups * networks.gradient_length) * 4);
        }
        parallel_for(w, groups, [&](int64_t group, int thread) {
            float* padded = parameters_wanted ? padded_gradients + group * networks.gradient_length : nullptr;
            if (padded) __builtin_memset(padded, 0, (size_t)networks.gradient_length * 4);
            const int begin = (int)(tile_count * group / groups), end = (int)(tile_count * (group + 1) / groups);
            for (int i = begin; i < end; ++i) process(ranges[i], first, thread, padded);
        });
        for (int i = 0; i < tile_count; ++i) {
            report.loss += ranges[i].loss;
            report.squared_error += ranges[i].squared_error;
            report.samples += ranges[i].marched;
            report.kept += ranges[i].kept;
        }
        for (int pixel = 0; pixel < count; pixel += objective.rays_a_pixel) {
            const bool judged = samples_of_pixel(pixel) > 0;
            for (int i = pixel; i < pixel + objective.rays_a_pixel; ++i)
                see_background(first + i, counts[i], judged, report);
        }
        if (!parameters_wanted) return;
        for (int group = 1; group < groups; ++group)
            for (int64_t k = 0; k < networks.gradient_length; ++k)
                padded_gradients[k] += padded_gradients[group * networks.gradient_length + k];
        if (groups > 0) unpack_gradient(networks, padded_gradients, network_gradient);
    }

    // Rays without samples see the background; nothing there can learn. judged: their pixel's loss is already known.
    void see_background(int64_t ray, int samples, bool judged, MulanStepReport& report) const {
        if (samples > 0) {
            report.rays++;
            return;
        }
        pixels.finish_ray(ray, 0, 0, pixels.background(ray), 0);
        if (origin_gradient)
            for (int a = 0; a < 3; ++a) origin_gradient[3 * ray + a] = direction_gradient[3 * ray + a] = 0;
        if (pixels.ignored(ray)) return;
        report.rays++;
        float flat;
        report.loss += opacity_loss(objective, pixels.share_of_ray(ray), 0, flat);
        if (judged) return;
        const RayLoss r = pixels.judge(pixels.first_of_pixel(ray), pixels.share_of_ray(ray), pixels.background(ray), 0);
        report.loss += r.loss;
        report.squared_error += r.squared_error;
    }

    // Adds the wave to the table's gradient and, after the last wave, moves the table. Levels are independent.
    void learn_table(float* gradient, bool fresh, float* value, const MulanAdam* adam_state) {
        const int64_t size = (int64_t)2 << field.log2_table_size;
        parallel_for(w, field.levels, [&](int64_t i, int) {
            const int level = field.levels - 1 - (int)i;  // the slow, hashed ones first
            float* g = gradient + level * size;
            if (fresh) __builtin_memset(g, 0, (size_t)size * 4);
            if (field.level_weight[level] == 0.0f) return;
            for (int k = 0; k < tile_count; ++k) {
                const int64_t at = ranges[k].scatter_at;
                scatter_level(field, level, {sx + at, sy + at, sz + at},
                              scatter + 2 * (level * scatter_capacity + at), 2, ranges[k].kept, g);
            }
            if (!adam_state) return;
            const MulanAdam& a = *adam_state;
            adam(AdamStep(a.table_rate, a.beta1, a.beta2, a.epsilon, a.step, a.skip_untouched), size,
                 value + level * size, a.table_mean + level * size, a.table_square + level * size, g);
        });
    }
};

// One pass over all rays; moves table and networks where `adam_state` is given.
int32_t learn(MulanWorkspace* w, const MulanField* field, const MulanScene* scene, const MulanOccupancy* occupancy,
              const float* table, const float* networks, const MulanRays* rays, const MulanObjective* objective,
              float* table_gradient, bool fresh, float* network_gradient, float* moving_table,
              const MulanAdam* adam_state,
              float* origin_gradient, float* direction_gradient, const MulanRendering* rendering,
              MulanStepReport* report) {
    *report = MulanStepReport{};
    Networks packed = prepare_networks(*w, *field, networks);
    double weight = 0;
    if (!objective->colour_gradient)
        for (int64_t i = 0; i < rays->count; ++i)
            if (objective->weights[i - i % objective->rays_a_pixel] > 0)
                weight += objective->weights[i - i % objective->rays_a_pixel];
    const March march(*scene, *occupancy, prepare_march_table(*w, *scene));
    const Pixels pixels{*scene, march, *objective, rendering, (float)(1 / (weight > 1e-12 ? weight : 1e-12))};
    Learn job{*w, *field, *scene, *occupancy, *rays, *objective, pixels, rendering, origin_gradient, direction_gradient,
              network_gradient != nullptr, march, packed, Tiles{}, table};
    job.tiles = prepare_tiles(*w, job.networks, larger(tile_samples, scene->steps * objective->rays_a_pixel));
    const int64_t wave_pixels = wave_samples / scene->steps / objective->rays_a_pixel;
    const int64_t wave = larger<int64_t>(wave_pixels, 1) * objective->rays_a_pixel;
    const int64_t most = smaller(wave, rays->count);
    job.t = (float*)w->ray_samples.reserve((size_t)(most * scene->steps) * 4 + 64);
    job.counts = (int32_t*)w->ray_lists.reserve((size_t)most * 8 + 64);
    job.listed = job.counts + most;
    job.ranges = (TileRange*)w->tile_lists.reserve((size_t)(most + 1) * sizeof(TileRange));
    // at least one wave, so that Adam's moments fade even when the batch is empty
    for (int64_t first = 0; first == 0 || first < rays->count; first += wave) {
        const int count = (int)smaller(wave, rays->count - first);
        job.learn_wave(first, count, network_gradient, *report);
        if (network_gradient)
            job.learn_table(table_gradient, fresh && first == 0, moving_table,
                            first + wave >= rays->count ? adam_state : nullptr);
    }
    return MULAN_OK;
}

}  // namespace

int32_t train_step(MulanWorkspace* w, const MulanField* field, const MulanScene* scene,
                   const MulanOccupancy* occupancy, float* table, float* networks, const MulanRays* rays,
                   const MulanObjective* objective, const MulanAdam* a, float* origin_gradient,
                   float* direction_gradient, const MulanPoses* poses, MulanStepReport* report) {
    const int64_t count = mulan_network_parameters(field);
    const size_t table_bytes = ((size_t)field->levels << field->log2_table_size) * 8;
    float* network_gradient = (float*)w->network_gradient.reserve((size_t)count * 4);
    __builtin_memset(network_gradient, 0, (size_t)count * 4);
    float* table_gradient = (float*)w->table_gradient.reserve(table_bytes);
    if (poses && !origin_gradient) {
        origin_gradient = (float*)w->ray_gradients.reserve((size_t)rays->count * 6 * 4);
        direction_gradient = origin_gradient + 3 * rays->count;
    }
    const int32_t status = learn(w, field, scene, occupancy, table, networks, rays, objective, table_gradient, true,
                                 network_gradient, table, a, origin_gradient, direction_gradient, nullptr, report);
    FlushDenormals flush;
    adam(AdamStep(a->networks_rate, a->beta1, a->beta2, a->epsilon, a->step, false), count, networks,
         a->networks_mean, a->networks_square, network_gradient);
    // every ray's gradient is one tile's, and rays are added in their order
    if (poses) mulan_pose_gradients(rays->count, rays->directions, origin_gradient, direction_gradient, poses);
    return status;
}

int32_t gradients(MulanWorkspace* w, const MulanField* field, const MulanScene* scene,
                  const MulanOccupancy* occupancy, const MulanParameters* p, const MulanRays* rays,
                  const MulanObjective* objective, const MulanGradients* g, const MulanRendering* rendering,
                  MulanStepReport* report) {
    if (g->fresh && g->networks) __builtin_memset(g->networks, 0, (size_t)mulan_network_parameters(field) * 4);
    return learn(w, field, scene, occupancy, p->table, p->networks, rays, objective, g->table, g->fresh, g->networks,
                 nullptr, nullptr, g->origins, g->directions, rendering, report);
}

}  // namespace mulan::MULAN_ISA
