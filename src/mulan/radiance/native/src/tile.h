// A tile: the samples of a few whole rays, small enough that everything known about them stays in the L2 cache.
//
// Samples are rows; a ray's samples are neighbours. Rows of a layer are padded to whole vectors.
#pragma once
#include "composite.h"
#include "encoding.h"
#include "harmonics.h"
#include "march.h"
#include "network.h"

namespace mulan::MULAN_ISA {

constexpr int tile_samples = 256;  // aimed at; a longer ray makes a tile of its own

struct Tile {
    int capacity;  // samples, and rays
    // by sample
    float *x, *y, *z;      // in the unit cube
    float *t, *step;       // distance [m]; step in scene radii
    int32_t* ray;          // slot in the tile
    float *depth, *alpha, *passed, *blend, *reach_after, *place;
    float *encoded, *hidden, *geometry, *colour_a, *colour_b, *logits, *colour, *variance, *variance_slope;
    // by ray slot
    int64_t* ray_id;
    int32_t *first, *count, *kept;
    float *harmonics, *direction_term, *transmittance;
    // gradients
    float *d_depth, *d_logits, *d_colour_a, *d_colour_b, *d_geometry, *d_hidden, *d_encoded, *d_variance;
    float *d_direction_term, *d_harmonics, *d_x, *d_y, *d_z;
};

inline Tile carve_tile(const Networks& n, int capacity, Arena& arena) {
    Tile t;
    t.capacity = capacity;
    const int64_t rows = capacity + row_padding;
    auto rows_of = [&](int width, auto&... arrays) { ((arrays = arena.take<float>(rows * width)), ...); };
    rows_of(1, t.x, t.y, t.z, t.t, t.step, t.depth, t.alpha, t.passed, t.blend, t.reach_after, t.place, t.variance,
            t.variance_slope, t.transmittance, t.d_depth, t.d_variance, t.d_x, t.d_y, t.d_z);
    rows_of(n.width, t.hidden, t.colour_a, t.colour_b, t.direction_term, t.d_colour_a, t.d_colour_b, t.d_hidden,
            t.d_direction_term);
    rows_of(n.encoded, t.encoded, t.d_encoded);
    rows_of(n.geometry, t.geometry, t.d_geometry);
    rows_of(n.harmonics, t.harmonics, t.d_harmonics);
    rows_of(lanes, t.logits, t.d_logits);
    rows_of(3, t.colour);
    auto integers = [&](auto&... arrays) { ((arrays = arena.take<int32_t>(rows)), ...); };
    integers(t.ray, t.first, t.count, t.kept);
    t.ray_id = arena.take<int64_t>(rows);
    return t;
}

// What a call evaluates: the field and how rays go through it.
struct Evaluation {
    const MulanField& field;
    const MulanScene& scene;
    const float* table;
    const Networks& networks;
};

// Positions of n samples of one ray, stored from row `at` on; distances are already in t.t.
inline void place_samples(const Evaluation& e, const March& march, Tile& t, int slot, int at, int n,
                          const float* origin, const float* direction) {
    for (int k = at; k < at + n; ++k) {
        float world[3], unit[3];
        for (int a = 0; a < 3; ++a) world[a] = origin[a] + t.t[k] * direction[a];
        to_unit(e.scene, world, unit);
        t.x[k] = unit[0];
        t.y[k] = unit[1];
        t.z[k] = unit[2];
        t.step[k] = march.step_m(t.t[k]) / e.scene.radius_m;
        t.ray[k] = slot;
    }
}

// Density network on encoded samples: optical depths, opacities.
inline void evaluate_encoded(const Evaluation& e, Tile& t, int n) {
    const Networks& net = e.networks;
    forward(net.density_hidden, t.encoded, n, t.hidden, Rectified{});
    forward(net.density_out, t.hidden, n, t.geometry, Plain{});
    for (int k = 0; k < n; ++k)
        t.depth[k] = smaller(t.geometry[k * net.geometry] + e.field.log_density_offset, e.field.log_density_max);
    for (int k = 0; k < n; k += lanes) {
        const vfloat depth = exponential(load(t.depth + k)) * load(t.step + k);
        vfloat alpha, passed;
        opacity_of(depth, alpha, passed);
        store(t.depth + k, depth);
        store(t.alpha + k, alpha);
        store(t.passed + k, passed);
    }
}

// Encoding and density network.
inline void evaluate_density(const Evaluation& e, Tile& t, int n) {
    encode(e.field, e.table, {t.x, t.y, t.z}, n, t.encoded, e.networks.encoded);
    evaluate_encoded(e, t, n);
}

inline void copy_row(float* rows, int width, int to, int from) {
    for (int i = 0; i < width; i += lanes)
        store(rows + (int64_t)to * width + i, load(rows + (int64_t)from * width + i));
}

// Blends every ray's samples and closes the gaps that the dropped ones leave; returns how many samples are left.
// Dropped are those that no light reaches and those thinner than a bound, which let all light pass.
// Rays start with t.transmittance, which is updated; t.first and t.kept describe what is left.
inline int drop_unreached(const Evaluation& e, Tile& t, int rays, float least_opacity = 0) {
    const Networks& net = e.networks;
    int left = 0;
    for (int slot = 0; slot < rays; ++slot) {
        const int from = t.first[slot], end = from + t.count[slot];
        float& transmittance = t.transmittance[slot];
        t.first[slot] = left;
        for (int k = from; k < end && transmittance > e.scene.min_transmittance; ++k) {
            if (t.alpha[k] < least_opacity) continue;
            t.blend[left] = transmittance * t.alpha[k];
            transmittance *= t.passed[k];
            t.reach_after[left] = transmittance;
            if (left != k) {
                float* const columns[] = {t.x, t.y, t.z, t.t, t.step, t.depth};
                for (float* column : columns) column[left] = column[k];
                t.ray[left] = t.ray[k];
                copy_row(t.encoded, net.encoded, left, k);
                copy_row(t.hidden, net.width, left, k);
                copy_row(t.geometry, net.geometry, left, k);
            }
            ++left;
        }
        t.kept[slot] = left - t.first[slot];
    }
    return left;
}

// The part of the colour network that depends on the direction alone.
inline void evaluate_direction(const Evaluation& e, Tile& t, int slot, const float* direction) {
    harmonics(e.field.harmonics_degree, direction, t.harmonics + (int64_t)slot * e.networks.harmonics);
}

inline void evaluate_directions(const Evaluation& e, Tile& t, int rays) {
    forward(e.networks.colour_direction, t.harmonics, rays, t.direction_term, Plain{});
}

// Colours of n samples; t.ray tells each one's direction.
inline void evaluate_colour(const Evaluation& e, Tile& t, int n) {
    const Networks& net = e.networks;
    for (int k = n; k % row_padding != 0; ++k) t.ray[k] = 0;  // rows computed along must find a direction too
    forward(net.colour_geometry, t.geometry, n, t.colour_a,
            RectifiedAfterAdding{t.direction_term, net.width, t.ray});
    forward(net.colour_hidden, t.colour_a, n, t.colour_b, Rectified{});
    forward(net.colour_out, t.colour_b, n, t.logits, Plain{});
    for (int k = 0; k < n; ++k)
        for (int c = 0; c < 3; ++c) t.colour[3 * k + c] = t.logits[k * lanes + c];
    for (int i = 0; i < 3 * n; i += lanes) store(t.colour + i, sigmoid(load(t.colour + i)));
}

// Colour variances, and their slope over the head's output.
inline void evaluate_variance(const Evaluation& e, Tile& t, int n) {
    const Networks& net = e.networks;
    for (int k = 0; k < n; ++k) {
        const float raw = dot(t.hidden + (int64_t)k * net.width, net.variance_hidden.backward, net.width) +
                          dot(t.geometry + (int64_t)k * net.geometry, net.variance_geometry.backward, net.geometry);
        t.variance[k] = raw;
    }
    for (int k = 0; k < n; k += lanes) {
        const vfloat raw = load(t.variance + k);
        store(t.variance_slope + k, sigmoid(raw));
        store(t.variance + k, softplus(raw) + e.field.variance_floor);
    }
}

// Adds to n rows what the gradient to the variances means for one of their head's inputs.
template <class Finish>
inline void add_variance_input_gradient(const Tile& t, int n, const float* weights, int width, const Finish& finish,
                                        float* rows) {
    for (int k = 0; k < n; ++k) {
        const float d = t.d_variance[k] * t.variance_slope[k];
        float* row = rows + (int64_t)k * width;
        for (int i = 0; i < width; i += lanes) store(row + i, load(row + i) + finish(d * load(weights + i), k, i));
    }
}

// From gradients to depths and colours back to the encoding; adds the networks' gradient to `padded` if given.
// Reads t.d_depth and t.d_logits; leaves t.d_encoded and, by ray slot, t.d_direction_term. The gradient to the
// variances in t.d_variance goes beyond their head only if asked to.
inline void backpropagate(const Evaluation& e, Tile& t, int n, int rays, bool through_variance, float* padded) {
    const Networks& net = e.networks;
    backward(net.colour_out, t.d_logits, n, t.d_colour_b, Masked{t.colour_b, net.width});
    backward(net.colour_hidden, t.d_colour_b, n, t.d_colour_a, Masked{t.colour_a, net.width});
    backward(net.colour_geometry, t.d_colour_a, n, t.d_geometry, Plain{});
    for (int64_t i = 0; i < (int64_t)rays * net.width; ++i) t.d_direction_term[i] = 0;
    for (int k = 0; k < n; ++k) {
        float* term = t.d_direction_term + (int64_t)t.ray[k] * net.width;
        const float* row = t.d_colour_a + (int64_t)k * net.width;
        for (int i = 0; i < net.width; i += lanes) store(term + i, load(term + i) + load(row + i));
    }
    const float limit = e.field.log_density_max - e.field.log_density_offset;
    for (int k = 0; k < n; ++k) {
        float& d = t.d_geometry[(int64_t)k * net.geometry];
        // depth = exp(output) * step, so its slope is itself
        if (t.geometry[(int64_t)k * net.geometry] < limit) d += t.d_depth[k] * t.depth[k];
    }
    if (through_variance)
        add_variance_input_gradient(t, n, net.variance_geometry.backward, net.geometry, Plain{}, t.d_geometry);
    const Masked active{t.hidden, net.width};
    backward(net.density_out, t.d_geometry, n, t.d_hidden, active);
    if (through_variance)
        add_variance_input_gradient(t, n, net.variance_hidden.backward, net.width, active, t.d_hidden);
    backward(net.density_hidden, t.d_hidden, n, t.d_encoded, Plain{});
    if (!padded) return;
    add_gradient(net.colour_out, t.d_logits, t.colour_b, n, padded);
    add_gradient(net.colour_hidden, t.d_colour_b, t.colour_a, n, padded);
    add_gradient(net.colour_geometry, t.d_colour_a, t.geometry, n, padded);
    add_gradient(net.colour_direction, t.d_direction_term, t.harmonics, rays, padded);
    add_gradient(net.density_out, t.d_geometry, t.hidden, n, padded);
    add_gradient(net.density_hidden, t.d_hidden, t.encoded, n, padded);
}

// Adds the variance head's gradient, from gradients to the variances in t.d_variance. The head's inputs are constants.
inline void add_variance_gradient(const Evaluation& e, const Tile& t, int n, float* padded) {
    const Networks& net = e.networks;
    float* hidden = padded + net.variance_hidden.gradient_at;
    float* geometry = padded + net.variance_geometry.gradient_at;
    for (int k = 0; k < n; ++k) {
        const float d = t.d_variance[k] * t.variance_slope[k];
        for (int i = 0; i < net.width; i += lanes)
            store(hidden + i, load(hidden + i) + d * load(t.hidden + (int64_t)k * net.width + i));
        for (int i = 0; i < net.geometry; i += lanes)
            store(geometry + i, load(geometry + i) + d * load(t.geometry + (int64_t)k * net.geometry + i));
    }
}

}  // namespace mulan::MULAN_ISA
