// The small networks, repacked for the matrix products: inputs and outputs padded to whole vectors.
#pragma once
#include "../include/mulan_native.h"
#include "matmul.h"

namespace mulan::MULAN_ISA {

// A bump allocator over one block; with no block it only counts.
struct Arena {
    char* base = nullptr;
    int64_t used = 0;

    template <class T> T* take(int64_t count) {
        T* p = base ? (T*)(base + used) : nullptr;
        used += (count * (int64_t)sizeof(T) + 63) / 64 * 64;
        return p;
    }
};

// One matrix [outputs, inputs]: element (j, i) is parameter first + j * row + i.
struct Layer {
    int inputs, outputs, in_padded, out_padded;
    int first, row;
    float* forward;        // [inputs, out_padded]
    float* backward;       // [outputs, in_padded]
    int64_t gradient_at;   // of [outputs, in_padded] in a padded gradient
};

// The first colour layer is split in the part that reads the direction (once a ray) and the part that reads the
// geometry features (every sample); the variance head is split likewise.
struct Networks {
    Layer density_hidden, density_out, colour_direction, colour_geometry, colour_hidden, colour_out;
    Layer variance_hidden, variance_geometry;
    int encoded, width, geometry, harmonics;  // padded
    int64_t gradient_length;
    int parameters;
};

constexpr int network_layers = 8;

inline void each_layer(Networks& n, Layer* out[network_layers]) {
    Layer* all[network_layers] = {&n.density_hidden, &n.density_out,     &n.colour_direction, &n.colour_geometry,
                                  &n.colour_hidden,  &n.colour_out,      &n.variance_hidden,  &n.variance_geometry};
    for (int i = 0; i < network_layers; ++i) out[i] = all[i];
}

inline Networks plan_networks(const MulanField& f, Arena& arena) {
    Networks n{};
    const int encoded = 2 * f.levels, width = f.width, geometry = f.geometry_features;
    const int bands = f.harmonics_degree * f.harmonics_degree;
    auto layer = [&](int inputs, int outputs, int first, int row) {
        Layer l{inputs, outputs, padded(inputs), padded(outputs), first, row, nullptr, nullptr, n.gradient_length};
        l.forward = arena.take<float>((int64_t)inputs * l.out_padded);
        l.backward = arena.take<float>((int64_t)outputs * l.in_padded);
        n.gradient_length += (int64_t)outputs * l.in_padded;
        return l;
    };
    int at = 0;
    n.density_hidden = layer(encoded, width, at, encoded);
    at += encoded * width;
    n.density_out = layer(width, geometry, at, width);
    at += width * geometry;
    n.colour_direction = layer(bands, width, at, bands + geometry);
    n.colour_geometry = layer(geometry, width, at + bands, bands + geometry);
    at += width * (bands + geometry);
    n.colour_hidden = layer(width, width, at, width);
    at += width * width;
    n.colour_out = layer(width, 3, at, width);
    at += 3 * width;
    n.variance_hidden = layer(width, 1, at, width + geometry);
    n.variance_geometry = layer(geometry, 1, at + width, width + geometry);
    n.parameters = at + width + geometry;
    n.encoded = padded(encoded);
    n.width = padded(width);
    n.geometry = padded(geometry);
    n.harmonics = padded(bands);
    return n;
}

inline void pack_networks(Networks& n, const float* parameters) {
    Layer* layers[network_layers];
    each_layer(n, layers);
    for (const Layer* l : layers) {
        for (int64_t k = 0; k < (int64_t)l->inputs * l->out_padded; ++k) l->forward[k] = 0;
        for (int64_t k = 0; k < (int64_t)l->outputs * l->in_padded; ++k) l->backward[k] = 0;
        for (int j = 0; j < l->outputs; ++j)
            for (int i = 0; i < l->inputs; ++i) {
                const float w = parameters[l->first + j * l->row + i];
                l->forward[i * l->out_padded + j] = w;
                l->backward[j * l->in_padded + i] = w;
            }
    }
}

// Adds a padded gradient to one laid out as the parameters.
inline void unpack_gradient(Networks& n, const float* padded_gradient, float* gradient) {
    Layer* layers[network_layers];
    each_layer(n, layers);
    for (const Layer* l : layers)
        for (int j = 0; j < l->outputs; ++j)
            for (int i = 0; i < l->inputs; ++i)
                gradient[l->first + j * l->row + i] += padded_gradient[l->gradient_at + j * l->in_padded + i];
}

// in [rows, inputs] -> finish(in @ W^T) [rows, outputs]
template <class Finish>
inline void forward(const Layer& l, const float* in, int rows, float* out, const Finish& finish) {
    multiply(in, l.in_padded, l.forward, l.out_padded, l.inputs, rows, out, l.out_padded, finish);
}

// upstream [rows, outputs] -> finish(upstream @ W) [rows, inputs]
template <class Finish>
inline void backward(const Layer& l, const float* upstream, int rows, float* out, const Finish& finish) {
    multiply(upstream, l.out_padded, l.backward, l.in_padded, l.outputs, rows, out, l.in_padded, finish);
}

inline void add_gradient(const Layer& l, const float* upstream, const float* in, int rows, float* padded_gradient) {
    add_outer(upstream, l.out_padded, l.outputs, in, l.in_padded, l.in_padded, rows,
              padded_gradient + l.gradient_at);
}

}  // namespace mulan::MULAN_ISA
