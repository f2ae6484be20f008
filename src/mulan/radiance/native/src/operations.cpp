// The operations one by one on arrays of any length, as tests compare them with the reference.
#include "adam.h"
#include "setup.h"

namespace mulan::MULAN_ISA {
namespace {

// Up to tile_samples points as one array an axis, with the spare numbers that the encoding reads.
struct PointTile {
    float x[tile_samples + row_padding] = {}, y[tile_samples + row_padding] = {}, z[tile_samples + row_padding] = {};

    Points load(const float* points, int n) {
        for (int i = 0; i < n; ++i) {
            x[i] = points[3 * i];
            y[i] = points[3 * i + 1];
            z[i] = points[3 * i + 2];
        }
        return {x, y, z};
    }
};

template <class Body> void in_tiles(int64_t n, const Body& body) {
    for (int64_t first = 0; first < n; first += tile_samples)
        body(first, (int)smaller<int64_t>(tile_samples, n - first));
}

void copy_rows(const float* from, int from_stride, float* to, int to_stride, int columns, int rows) {
    for (int i = 0; i < rows; ++i)
        for (int c = 0; c < columns; ++c) to[(int64_t)i * to_stride + c] = from[(int64_t)i * from_stride + c];
}

// Forward pass of the networks on rows first .. first + n of the caller's arrays, one ray slot a sample.
void evaluate_rows(const Evaluation& e, Tile& t, const float* encoded, const float* directions, int n) {
    const Networks& net = e.networks;
    const int width = 2 * e.field.levels;
    copy_rows(encoded, width, t.encoded, net.encoded, width, n);
    forward(net.density_hidden, t.encoded, n, t.hidden, Rectified{});
    forward(net.density_out, t.hidden, n, t.geometry, Plain{});
    for (int k = 0; k < n; ++k) {
        t.ray[k] = k;
        evaluate_direction(e, t, k, directions + 3 * k);
    }
    evaluate_directions(e, t, n);
    evaluate_colour(e, t, n);
    evaluate_variance(e, t, n);
}

}  // namespace

int32_t encode(const MulanField* field, const float* table, int64_t n, const float* unit_points, float* encoded) {
    PointTile tile;
    const int width = 2 * field->levels;
    in_tiles(n, [&](int64_t first, int count) {
        encode(*field, table, tile.load(unit_points + 3 * first, count), count, encoded + first * width, width);
    });
    return MULAN_OK;
}

int32_t encode_backward(const MulanField* field, const float* table, int64_t n, const float* unit_points,
                        const float* gradient, float* table_gradient, float* point_gradient) {
    PointTile tile;
    float g[3][tile_samples + row_padding];
    const int width = 2 * field->levels;
    const int64_t size = (int64_t)2 << field->log2_table_size;
    in_tiles(n, [&](int64_t first, int count) {
        const Points p = tile.load(unit_points + 3 * first, count);
        const float* rows = gradient + first * width;
        if (table_gradient)
            for (int level = 0; level < field->levels; ++level)
                scatter_level(*field, level, p, rows + 2 * level, width, count, table_gradient + level * size);
        if (!point_gradient) return;
        encode_backward_points(*field, table, p, count, rows, width, g[0], g[1], g[2]);
        for (int i = 0; i < count; ++i)
            for (int a = 0; a < 3; ++a) point_gradient[3 * (first + i) + a] = g[a][i];
    });
    return MULAN_OK;
}

int32_t harmonics(int32_t degree, int64_t n, const float* directions, float* out) {
    for (int64_t i = 0; i < n; ++i) harmonics(degree, directions + 3 * i, out + i * degree * degree);
    return MULAN_OK;
}

int32_t harmonics_backward(int32_t degree, int64_t n, const float* directions, const float* gradient,
                           float* direction_gradient) {
    for (int64_t i = 0; i < n; ++i)
        harmonics_backward(degree, directions + 3 * i, gradient + i * degree * degree, direction_gradient + 3 * i);
    return MULAN_OK;
}

int32_t march(const MulanScene* scene, const MulanOccupancy* occupancy, const MulanRays* rays, int32_t capacity,
              int32_t* count, float* t_m, float* dt_m) {
    MulanWorkspace w(1);
    const March march(*scene, *occupancy, prepare_march_table(w, *scene));
    float* t = (float*)w.ray_samples.reserve((size_t)scene->steps * 4);
    for (int64_t i = 0; i < rays->count; ++i) {
        RayMarch walk(march, rays->origins + 3 * i, rays->directions + 3 * i, ray_jitter(*rays, i));
        count[i] = walk.collect(march, t, t_m ? smaller(capacity, scene->steps) : scene->steps);
        if (!t_m) continue;
        for (int k = 0; k < count[i]; ++k) {
            t_m[i * capacity + k] = t[k];
            dt_m[i * capacity + k] = march.step_m(t[k]);
        }
    }
    return MULAN_OK;
}

int32_t networks(MulanWorkspace* w, const MulanField* field, const float* parameters, int64_t n,
                 const float* encoded, const float* directions, float* log_density, float* colour, float* variance) {
    const Networks net = prepare_networks(*w, *field, parameters);
    Tile t = prepare_tiles(*w, net, tile_samples).of(0);
    const MulanScene scene{};
    const Evaluation e{*field, scene, nullptr, net};
    in_tiles(n, [&](int64_t first, int count) {
        evaluate_rows(e, t, encoded + first * 2 * field->levels, directions + 3 * first, count);
        copy_rows(t.geometry, net.geometry, log_density + first, 1, 1, count);
        copy_rows(t.colour, 3, colour + 3 * first, 3, 3, count);
        copy_rows(t.variance, 1, variance + first, 1, 1, count);
    });
    return MULAN_OK;
}

int32_t networks_backward(MulanWorkspace* w, const MulanField* field, const float* parameters, int64_t n,
                          const float* encoded, const float* directions, const float* log_density_gradient,
                          const float* colour_gradient, const float* variance_gradient, float* network_gradient,
                          float* encoded_gradient, float* direction_gradient) {
    Networks net = prepare_networks(*w, *field, parameters);
    Tile t = prepare_tiles(*w, net, tile_samples).of(0);
    const MulanScene scene{};
    const Evaluation e{*field, scene, nullptr, net};
    const int width = 2 * field->levels;
    float* padded_gradient = (float*)w->group_gradients.reserve((size_t)net.gradient_length * 4);
    __builtin_memset(padded_gradient, 0, (size_t)net.gradient_length * 4);
    in_tiles(n, [&](int64_t first, int count) {
        evaluate_rows(e, t, encoded + first * width, directions + 3 * first, count);
        for (int k = 0; k < count; ++k) {
            for (int c = 0; c < 3; ++c) {
                const float value = t.colour[3 * k + c];
                t.d_logits[k * lanes + c] = colour_gradient[3 * (first + k) + c] * value * (1 - value);
            }
            t.depth[k] = 1;  // so that the gradient to the depth is that to the log-density
            t.d_depth[k] = log_density_gradient[first + k];
            t.d_variance[k] = variance_gradient[first + k];
        }
        backpropagate(e, t, count, count, false, padded_gradient);
        add_variance_gradient(e, t, count, padded_gradient);
        copy_rows(t.d_encoded, net.encoded, encoded_gradient + first * width, width, width, count);
        backward(net.colour_direction, t.d_direction_term, count, t.d_harmonics, Plain{});
        for (int k = 0; k < count; ++k)
            harmonics_backward(field->harmonics_degree, directions + 3 * (first + k),
                               t.d_harmonics + (int64_t)k * net.harmonics, direction_gradient + 3 * (first + k));
    });
    unpack_gradient(net, padded_gradient, network_gradient);
    return MULAN_OK;
}

namespace {

// Opacities and blends of one packed ray, in the workspace; returns how many samples are kept.
int blend_packed(const MulanScene& scene, const float* density, const float* dt_m, int n, float* alpha, float* passed,
                 float* blend, float* reach_after) {
    for (int k = 0; k < n; k += lanes) {
        float depth[lanes] = {};
        for (int i = 0; i < lanes && k + i < n; ++i) depth[i] = density[k + i] * dt_m[k + i];
        vfloat a, p;
        opacity_of(load(depth), a, p);
        store(alpha + k, a);
        store(passed + k, p);
    }
    float transmittance = 1;
    return blend_ray(n, alpha, passed, scene.min_transmittance, transmittance, blend, reach_after);
}

}  // namespace

int32_t composite(const MulanScene* scene, int64_t rays, const int64_t* offsets, const float* density,
                  const float* dt_m, const float* t_m, const float* colour, const float* variance, float* blend,
                  const MulanRendering* out) {
    MulanWorkspace w(1);
    for (int64_t ray = 0; ray < rays; ++ray) {
        const int64_t at = offsets[ray];
        const int n = (int)(offsets[ray + 1] - at);
        const int64_t room = n + row_padding;
        float* scratch = (float*)w.ray_samples.reserve((size_t)room * 4 * 4);
        float* kept_blend = scratch + 2 * room;
        const int kept =
            blend_packed(*scene, density + at, dt_m + at, n, scratch, scratch + room, kept_blend, scratch + 3 * room);
        float sum[3] = {}, opacity = 0, moment = 0, spread = 0;
        for (int k = 0; k < n; ++k) {
            const float b = k < kept ? kept_blend[k] : 0;
            blend[at + k] = b;
            for (int c = 0; c < 3; ++c) sum[c] += b * colour[3 * (at + k) + c];
            opacity += b;
            moment += b * t_m[at + k];
            spread += b * b * variance[at + k];
        }
        for (int c = 0; c < 3; ++c) out->colour[3 * ray + c] = sum[c] + (1 - opacity) * scene->background[c];
        out->depth_m[ray] = moment / larger(opacity, 1e-10f);
        out->opacity[ray] = opacity;
        out->variance[ray] = spread;
    }
    return MULAN_OK;
}

int32_t composite_backward(const MulanScene* scene, int64_t rays, const int64_t* offsets, const float* density,
                           const float* dt_m, const float* colour, const float* ray_colour_gradient,
                           float* density_gradient, float* colour_gradient) {
    MulanWorkspace w(1);
    for (int64_t ray = 0; ray < rays; ++ray) {
        const int64_t at = offsets[ray];
        const int n = (int)(offsets[ray + 1] - at);
        const int64_t room = n + row_padding;
        float* scratch = (float*)w.ray_samples.reserve((size_t)room * 4 * 4);
        float *blend = scratch + 2 * room, *reach_after = scratch + 3 * room;
        const int kept =
            blend_packed(*scene, density + at, dt_m + at, n, scratch, scratch + room, blend, reach_after);
        const float* g = ray_colour_gradient + 3 * ray;
        for (int k = 0; k < kept; ++k) {
            density_gradient[at + k] = 0;
            for (int c = 0; c < 3; ++c)
                density_gradient[at + k] += g[c] * (colour[3 * (at + k) + c] - scene->background[c]);
        }
        blend_ray_backward(kept, blend, reach_after, density_gradient + at);
        for (int k = 0; k < n; ++k) {
            density_gradient[at + k] = k < kept ? density_gradient[at + k] * dt_m[at + k] : 0;
            for (int c = 0; c < 3; ++c) colour_gradient[3 * (at + k) + c] = k < kept ? g[c] * blend[k] : 0;
        }
    }
    return MULAN_OK;
}

int32_t adam(int64_t n, float* value, float* mean, float* square, const float* gradient, float rate, float beta1,
             float beta2, float epsilon, int64_t step, int32_t skip_untouched) {
    FlushDenormals flush;
    adam(AdamStep(rate, beta1, beta2, epsilon, step, skip_untouched), n, value, mean, square, gradient);
    return MULAN_OK;
}

}  // namespace mulan::MULAN_ISA
