// Operations that gain nothing from wide vectors: compiled once.
#include <cmath>

#include "../include/mulan_native.h"

int32_t mulan_occupancy_pack(int32_t side, const uint8_t* occupied, uint64_t* words, float* lower, float* upper) {
    if (side < 4 || side > 512 || side % 4 || !occupied || !words || !lower || !upper) return MULAN_BAD_ARGUMENT;
    const int blocks = side / 4;
    int low[3] = {side, side, side}, high[3] = {0, 0, 0};
    for (int64_t i = 0; i < (int64_t)blocks * blocks * blocks; ++i) words[i] = 0;
    for (int z = 0; z < side; ++z)
        for (int y = 0; y < side; ++y)
            for (int x = 0; x < side; ++x) {
                if (!occupied[x + (int64_t)side * (y + (int64_t)side * z)]) continue;
                const int bit = (x & 3) + 4 * (y & 3) + 16 * (z & 3);
                words[(x >> 2) + blocks * ((y >> 2) + (int64_t)blocks * (z >> 2))] |= 1ull << bit;
                const int cell[3] = {x, y, z};
                for (int a = 0; a < 3; ++a) {
                    if (cell[a] < low[a]) low[a] = cell[a];
                    if (cell[a] + 1 > high[a]) high[a] = cell[a] + 1;
                }
            }
    for (int a = 0; a < 3; ++a) {
        lower[a] = (float)low[a] / (float)side;
        upper[a] = (float)high[a] / (float)side;
    }
    return MULAN_OK;
}

// The camera at T moves to T exp(rotation, translation): an origin moves by R translation and a direction turns by
// R rotation, so in the world frame the gradients are the sum of the origins' and the sum of direction x gradient.
int32_t mulan_pose_gradients(int64_t rays, const float* directions, const float* origin_gradient,
                             const float* direction_gradient, const int64_t* image_index, int64_t images,
                             const float* R_world_camera, float* gradient) {
    if (rays < 0 || images < 0 || (images > 0 && (!gradient || !R_world_camera))) return MULAN_BAD_ARGUMENT;
    if (rays > 0 && (!directions || !origin_gradient || !direction_gradient || !image_index)) return MULAN_BAD_ARGUMENT;
    for (int64_t i = 0; i < rays; ++i)
        if (image_index[i] < 0 || image_index[i] >= images) return MULAN_BAD_ARGUMENT;
    for (int64_t i = 0; i < 6 * images; ++i) gradient[i] = 0;
    for (int64_t i = 0; i < rays; ++i) {
        const float *d = directions + 3 * i, *g = direction_gradient + 3 * i, *o = origin_gradient + 3 * i;
        float* sum = gradient + 6 * image_index[i];
        sum[0] += d[1] * g[2] - d[2] * g[1];
        sum[1] += d[2] * g[0] - d[0] * g[2];
        sum[2] += d[0] * g[1] - d[1] * g[0];
        for (int a = 0; a < 3; ++a) sum[3 + a] += o[a];
    }
    for (int64_t i = 0; i < images; ++i) {
        const float* R = R_world_camera + 9 * i;
        for (int part = 0; part < 2; ++part) {
            float* v = gradient + 6 * i + 3 * part;
            const float world[3] = {v[0], v[1], v[2]};
            for (int a = 0; a < 3; ++a) v[a] = R[a] * world[0] + R[3 + a] * world[1] + R[6 + a] * world[2];
        }
    }
    return MULAN_OK;
}
