// Multiresolution hash encoding (Müller et al. 2022): values, gradient to the table, gradient to the points.
#pragma once
#include "../include/mulan_native.h"
#include "simd.h"

namespace mulan::MULAN_ISA {

// One level of the table; two features an entry.
struct LevelGrid {
    const float* entries;
    float cells;
    int32_t last_cell;
    uint32_t factor_y, factor_z, mask;  // strides of a dense level, primes of a hashed one
    bool dense;
};

inline LevelGrid level_grid(const MulanField& field, const float* table, int level) {
    LevelGrid g;
    const uint32_t side = (uint32_t)field.resolution[level] + 1;
    g.entries = table + ((int64_t)level << field.log2_table_size) * 2;
    g.cells = (float)field.resolution[level];
    g.last_cell = field.resolution[level] - 1;
    g.dense = field.dense[level];
    g.factor_y = g.dense ? side : 2654435761u;
    g.factor_z = g.dense ? side * side : 805459861u;
    g.mask = (1u << field.log2_table_size) - 1;
    return g;
}

// Points of the unit cube, one array an axis.
struct Points {
    const float *x, *y, *z;
};

// The cells of `lanes` points: entry numbers and weights of their corners (bit 0 of the corner: x, 1: y, 2: z).
struct Corners {
    alignas(64) uint32_t index[8][lanes];
    alignas(64) float weight[8][lanes];
    alignas(64) float yz[4][lanes], x[lanes];  // their factors: weight = yz times x or 1 - x
    vfloat fraction[3];
};

inline void split_axis(const LevelGrid& g, vfloat p, vuint& cell, vfloat& fraction) {
    vfloat scaled = clamp(p, 0.0f, 1.0f) * g.cells;
    vint whole = __builtin_convertvector(scaled, vint);
    whole = whole < g.last_cell ? whole : vint{} + g.last_cell;
    fraction = scaled - __builtin_convertvector(whole, vfloat);
    cell = (vuint)whole;
}

template <bool dense> inline void corner_indices(const LevelGrid& g, const vuint cell[3], Corners& c) {
    for (int corner = 0; corner < 8; ++corner) {
        vuint x = cell[0] + (uint32_t)(corner & 1);
        vuint y = (cell[1] + (uint32_t)(corner >> 1 & 1)) * g.factor_y;
        vuint z = (cell[2] + (uint32_t)(corner >> 2)) * g.factor_z;
        store(c.index[corner], dense ? x + y + z : (x ^ y ^ z) & g.mask);
    }
}

inline void find_corners(const LevelGrid& g, const Points& p, int64_t first, Corners& c) {
    vuint cell[3];
    split_axis(g, load(p.x + first), cell[0], c.fraction[0]);
    split_axis(g, load(p.y + first), cell[1], c.fraction[1]);
    split_axis(g, load(p.z + first), cell[2], c.fraction[2]);
    if (g.dense)
        corner_indices<true>(g, cell, c);
    else
        corner_indices<false>(g, cell, c);
    const vfloat fx = c.fraction[0], fy = c.fraction[1], fz = c.fraction[2];
    const vfloat yz[4] = {(1 - fy) * (1 - fz), fy * (1 - fz), (1 - fy) * fz, fy * fz};
    store(c.x, fx);
    for (int k = 0; k < 4; ++k) {
        store(c.yz[k], yz[k]);
        store(c.weight[2 * k], yz[k] * (1 - fx));
        store(c.weight[2 * k + 1], yz[k] * fx);
    }
}

// Features of the first `count` points of a group. Corners that differ in x only are summed side by side; on a dense
// level they are neighbours in memory, one load.
template <bool dense>
inline void blend_corners(const LevelGrid& g, const Corners& c, int count, float scale, float* rows, int stride) {
    for (int i = 0; i < count; ++i) {
        vquad total{};
#pragma GCC unroll 4
        for (int k = 0; k < 8; k += 2) {
            const float* low = g.entries + 2 * (int64_t)c.index[k][i];
            const vquad both = dense ? load_quad(low)
                                     : join(load_pair(low), load_pair(g.entries + 2 * (int64_t)c.index[k + 1][i]));
            total += both * (c.yz[k / 2][i] - vquad{});
        }
        const vpair at_low = __builtin_shufflevector(total, total, 0, 1);
        const vpair at_high = __builtin_shufflevector(total, total, 2, 3);
        store(rows + (int64_t)i * stride, (at_low + c.x[i] * (at_high - at_low)) * scale);
    }
}

// One level's features of n points. Reads points in groups of `lanes`: arrays need row_padding spare numbers.
inline void encode_level(const MulanField& field, const float* table, int level, Points p, int n, float* rows,
                         int stride) {
    const float scale = field.level_weight[level];
    float* out = rows + 2 * level;
    if (scale == 0.0f) {
        for (int i = 0; i < n; ++i) out[(int64_t)i * stride] = out[(int64_t)i * stride + 1] = 0.0f;
        return;
    }
    const LevelGrid g = level_grid(field, table, level);
    Corners c;
    for (int first = 0; first < n; first += lanes) {
        find_corners(g, p, first, c);
        const int count = smaller(lanes, n - first);
        if (g.dense)
            blend_corners<true>(g, c, count, scale, out + (int64_t)first * stride, stride);
        else
            blend_corners<false>(g, c, count, scale, out + (int64_t)first * stride, stride);
    }
}

// Rows of features, level after level.
inline void encode(const MulanField& field, const float* table, Points p, int n, float* rows, int stride) {
    for (int level = 0; level < field.levels; ++level) encode_level(field, table, level, p, n, rows, stride);
}

// Adds one level's gradient to its table gradient. gradient[i * stride] and the next are those of point i's features.
inline void scatter_level(const MulanField& field, int level, Points p, const float* gradient, int stride, int64_t n,
                          float* level_gradient) {
    const LevelGrid g = level_grid(field, nullptr, level);
    const float scale = field.level_weight[level];
    Corners c;
    for (int64_t first = 0; first < n; first += lanes) {
        find_corners(g, p, first, c);
        const int count = (int)smaller<int64_t>(lanes, n - first);
        for (int i = 0; i < count; ++i) {
            const vpair upstream = scale * load_pair(gradient + (first + i) * stride);
#pragma GCC unroll 8
            for (int corner = 0; corner < 8; ++corner) {
                float* entry = level_gradient + 2 * (int64_t)c.index[corner][i];
                store(entry, load_pair(entry) + c.weight[corner][i] * upstream);
            }
        }
    }
}

// Gradient to the points (in the unit cube), from rows of gradients to their encodings.
inline void encode_backward_points(const MulanField& field, const float* table, Points p, int n, const float* rows,
                                   int stride, float* gx, float* gy, float* gz) {
    for (int i = 0; i < n; ++i) gx[i] = gy[i] = gz[i] = 0.0f;
    Corners c;
    alignas(64) float fraction[3][lanes];
    for (int level = 0; level < field.levels; ++level) {
        const float scale = field.level_weight[level] * (float)field.resolution[level];
        if (scale == 0.0f) continue;
        const LevelGrid g = level_grid(field, table, level);
        for (int first = 0; first < n; first += lanes) {
            find_corners(g, p, first, c);
            for (int axis = 0; axis < 3; ++axis) store(fraction[axis], c.fraction[axis]);
            const int count = smaller(lanes, n - first);
            for (int i = 0; i < count; ++i) {
                const float* d = rows + (int64_t)(first + i) * stride + 2 * level;
                float v[8];
                for (int corner = 0; corner < 8; ++corner) {
                    const float* entry = g.entries + 2 * (int64_t)c.index[corner][i];
                    v[corner] = entry[0] * d[0] + entry[1] * d[1];
                }
                const float fx = fraction[0][i], fy = fraction[1][i], fz = fraction[2][i];
                const float x00 = v[0] + fx * (v[1] - v[0]), x10 = v[2] + fx * (v[3] - v[2]);
                const float x01 = v[4] + fx * (v[5] - v[4]), x11 = v[6] + fx * (v[7] - v[6]);
                gx[first + i] += scale * ((1 - fz) * ((1 - fy) * (v[1] - v[0]) + fy * (v[3] - v[2])) +
                                          fz * ((1 - fy) * (v[5] - v[4]) + fy * (v[7] - v[6])));
                gy[first + i] += scale * ((1 - fz) * (x10 - x00) + fz * (x11 - x01));
                gz[first + i] += scale * ((1 - fy) * (x01 - x00) + fy * (x11 - x10));
            }
        }
    }
}

}  // namespace mulan::MULAN_ISA
