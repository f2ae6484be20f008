// Matrix products for layers a few dozen wide: rows of samples that stay in the L1 or L2 cache, sums in registers.
#pragma once
#include "simd.h"

namespace mulan::MULAN_ISA {

// What becomes of a finished sum; `row` and `column` say where it will be stored.
struct Plain {
    vfloat operator()(vfloat sum, int, int) const { return sum; }
};
struct Rectified {
    vfloat operator()(vfloat sum, int, int) const { return sum > 0.0f ? sum : vfloat{}; }
};
// Adds a row of an earlier product, chosen by the sample's ray, then rectifies.
struct RectifiedAfterAdding {
    const float* rows;
    int stride;
    const int32_t* chosen;
    vfloat operator()(vfloat sum, int row, int column) const {
        sum += load(rows + (int64_t)chosen[row] * stride + column);
        return sum > 0.0f ? sum : vfloat{};
    }
};
// Lets a gradient through where the activation was positive.
struct Masked {
    const float* activation;
    int stride;
    vfloat operator()(vfloat sum, int row, int column) const {
        return load(activation + (int64_t)row * stride + column) > 0.0f ? sum : vfloat{};
    }
};

template <int vectors, class Finish>
inline void multiply_columns(const float* in, int in_stride, const float* weights, int weight_stride, int depth,
                             int rows, float* out, int out_stride, int column, const Finish& finish) {
    for (int row = 0; row < rows; row += block_rows) {
        vfloat sum[block_rows][vectors] = {};
        const float* x = in + (int64_t)row * in_stride;
        for (int k = 0; k < depth; ++k) {
            vfloat w[vectors];
#pragma GCC unroll 4
            for (int v = 0; v < vectors; ++v) w[v] = load(weights + k * weight_stride + column + v * lanes);
#pragma GCC unroll 8
            for (int r = 0; r < block_rows; ++r) {
                const vfloat scale = splat(x[(int64_t)r * in_stride + k]);
#pragma GCC unroll 4
                for (int v = 0; v < vectors; ++v) sum[r][v] += scale * w[v];
            }
        }
#pragma GCC unroll 8
        for (int r = 0; r < block_rows; ++r)
#pragma GCC unroll 4
            for (int v = 0; v < vectors; ++v) {
                const int at = column + v * lanes;
                store(out + (int64_t)(row + r) * out_stride + at, finish(sum[r][v], row + r, at));
            }
    }
}

// out[row, :] = finish(in[row, 0:depth] @ weights[depth, columns]); writes up to block_rows - 1 rows past the last.
template <class Finish>
inline void multiply(const float* in, int in_stride, const float* weights, int columns, int depth, int rows,
                     float* out, int out_stride, const Finish& finish) {
    int column = 0;
    for (; column + 2 * lanes <= columns; column += 2 * lanes)
        multiply_columns<2>(in, in_stride, weights, columns, depth, rows, out, out_stride, column, finish);
    if (column < columns)
        multiply_columns<1>(in, in_stride, weights, columns, depth, rows, out, out_stride, column, finish);
}

template <int outputs, int vectors>
inline void add_outer_block(const float* upstream, int upstream_stride, const float* in, int in_stride, int rows,
                            float* gradient, int gradient_stride) {
    vfloat sum[outputs][vectors] = {};
    for (int row = 0; row < rows; ++row) {
        vfloat x[vectors];
#pragma GCC unroll 4
        for (int v = 0; v < vectors; ++v) x[v] = load(in + (int64_t)row * in_stride + v * lanes);
#pragma GCC unroll 8
        for (int j = 0; j < outputs; ++j) {
            const vfloat scale = splat(upstream[(int64_t)row * upstream_stride + j]);
#pragma GCC unroll 4
            for (int v = 0; v < vectors; ++v) sum[j][v] += scale * x[v];
        }
    }
    for (int j = 0; j < outputs; ++j)
        for (int v = 0; v < vectors; ++v) {
            float* g = gradient + j * gradient_stride + v * lanes;
            store(g, load(g) + sum[j][v]);
        }
}

// gradient[out, in] += sum over rows of upstream[row, out] * in[row, in]; in_columns is padded, outputs is not.
inline void add_outer(const float* upstream, int upstream_stride, int outputs, const float* in, int in_stride,
                      int in_columns, int rows, float* gradient) {
    for (int i = 0; i < in_columns; i += 2 * lanes) {
        const bool two = i + 2 * lanes <= in_columns;
        int j = 0;
        for (; j + block_rows <= outputs; j += block_rows)
            two ? add_outer_block<block_rows, 2>(upstream + j, upstream_stride, in + i, in_stride, rows,
                                                 gradient + j * in_columns + i, in_columns)
                : add_outer_block<block_rows, 1>(upstream + j, upstream_stride, in + i, in_stride, rows,
                                                 gradient + j * in_columns + i, in_columns);
        for (; j < outputs; ++j)
            two ? add_outer_block<1, 2>(upstream + j, upstream_stride, in + i, in_stride, rows,
                                        gradient + j * in_columns + i, in_columns)
                : add_outer_block<1, 1>(upstream + j, upstream_stride, in + i, in_stride, rows,
                                        gradient + j * in_columns + i, in_columns);
    }
}

}  // namespace mulan::MULAN_ISA
