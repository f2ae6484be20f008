// Operations that gain nothing from wide vectors: compiled once.
#include <cmath>

#include "workspace.h"

int32_t mulan_occupancy_pack(int32_t side, int32_t cascades, const uint8_t* occupied, uint64_t* words, float* lower,
                             float* upper) {
    if (side < 4 || side > 512 || side % 4 || cascades < 1 || cascades > MULAN_MAX_CASCADES || !occupied || !words ||
        !lower || !upper)
        return MULAN_BAD_ARGUMENT;
    const int64_t blocks = side / 4, cells = (int64_t)side * side * side;
    for (int64_t i = 0; i < cascades * blocks * blocks * blocks; ++i) words[i] = 0;
    for (int a = 0; a < 3; ++a) {
        lower[a] = 1;
        upper[a] = 0;
    }
    for (int k = 0; k < cascades; ++k) {
        int low[3] = {side, side, side}, high[3] = {0, 0, 0};
        uint64_t* own = words + k * blocks * blocks * blocks;
        for (int z = 0; z < side; ++z)
            for (int y = 0; y < side; ++y)
                for (int x = 0; x < side; x += 4) {
                    uint32_t four;
                    __builtin_memcpy(&four, occupied + k * cells + x + (int64_t)side * (y + (int64_t)side * z), 4);
                    if (four == 0) continue;
                    const uint64_t bits = ((four & 0x01010101u) * 0x10204080u) >> 28;  // one bit a byte, gathered
                    own[(x >> 2) + blocks * ((y >> 2) + blocks * (z >> 2))] |= bits << (4 * (y & 3) + 16 * (z & 3));
                    const int first[3] = {x + __builtin_ctzll(bits), y, z};
                    const int end[3] = {x + 64 - __builtin_clzll(bits), y + 1, z + 1};
                    for (int a = 0; a < 3; ++a) {
                        if (first[a] < low[a]) low[a] = first[a];
                        if (end[a] > high[a]) high[a] = end[a];
                    }
                }
        const float span = std::ldexp(1.0f, k + 1 - cascades);
        for (int a = 0; a < 3 && low[a] < high[a]; ++a) {
            lower[a] = std::fmin(lower[a], 0.5f + ((float)low[a] / (float)side - 0.5f) * span);
            upper[a] = std::fmax(upper[a], 0.5f + ((float)high[a] / (float)side - 0.5f) * span);
        }
    }
    return MULAN_OK;
}

// The camera at T moves to T exp(rotation, translation): an origin moves by R translation and a direction turns by
// R rotation, so in the world frame the gradients are the sum of the origins' and the sum of direction x gradient.
int32_t mulan_pose_gradients(int64_t rays, const float* directions, const float* origin_gradient,
                             const float* direction_gradient, const MulanPoses* poses) {
    if (!mulan::valid(poses, rays)) return MULAN_BAD_ARGUMENT;
    if (rays > 0 && (!directions || !origin_gradient || !direction_gradient)) return MULAN_BAD_ARGUMENT;
    const int64_t images = poses->images, *image_index = poses->image_index;
    float* gradient = poses->gradient;
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
        const float* R = poses->R_world_camera + 9 * i;
        for (int part = 0; part < 2; ++part) {
            float* v = gradient + 6 * i + 3 * part;
            const float world[3] = {v[0], v[1], v[2]};
            for (int a = 0; a < 3; ++a) v[a] = R[a] * world[0] + R[3 + a] * world[1] + R[6 + a] * world[2];
        }
    }
    return MULAN_OK;
}

int32_t mulan_gather_rays(const MulanPixels* p, int64_t rays, const int64_t* pixel, const MulanRayBatch* out) {
    if (!p || !out || rays < 0 || (p->opacity && !out->opacity)) return MULAN_BAD_ARGUMENT;
    if (rays == 0) return MULAN_OK;
    if (!pixel || p->pixels < 1 || !p->colours || !p->weights || !p->image || !p->camera_directions ||
        !p->direction_shift || !p->T_world_camera || !out->origins || !out->directions || !out->colours ||
        !out->weights || !out->image_index)
        return MULAN_BAD_ARGUMENT;
    for (int64_t r = 0; r < rays; ++r)
        if (pixel[r] < 0 || pixel[r] >= p->pixels) return MULAN_BAD_ARGUMENT;
    constexpr int64_t ahead = 8;  // pixels are drawn at random: each would wait for memory several times
    for (int64_t r = 0; r < rays; ++r) {
        if (r + ahead < rays) {
            const int64_t next = pixel[r + ahead];
            __builtin_prefetch(p->image + next);
            __builtin_prefetch(p->colours + 3 * next);
            __builtin_prefetch(p->weights + next);
        }
        const int64_t at = pixel[r], image = p->image[at];
        if (image < 0 || image >= p->images) return MULAN_BAD_ARGUMENT;
        const int64_t row = at + p->direction_shift[image];
        if (row < 0 || row >= p->directions) return MULAN_BAD_ARGUMENT;
        const float *T = p->T_world_camera + 16 * image, *d = p->camera_directions + 3 * row;
        float world[3], square = 0;
        for (int a = 0; a < 3; ++a) {
            world[a] = T[4 * a] * d[0] + T[4 * a + 1] * d[1] + T[4 * a + 2] * d[2];
            square += world[a] * world[a];
        }
        const float length = std::sqrt(square);
        for (int a = 0; a < 3; ++a) {
            out->origins[3 * r + a] = T[4 * a + 3];
            out->directions[3 * r + a] = world[a] / (length > 1e-12f ? length : 1e-12f);
            out->colours[3 * r + a] = (float)p->colours[3 * at + a] / 255.0f;
        }
        if (p->opacity) out->opacity[r] = (float)p->opacity[at] / 255.0f;
        out->weights[r] = p->weights[at];
        out->image_index[r] = image;
    }
    return MULAN_OK;
}
