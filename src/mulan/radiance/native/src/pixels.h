// What the pixels of a batch see along their rays, what that costs, and the gradient of that to the rays' samples.
#pragma once
#include "loss.h"
#include "setup.h"

namespace mulan::MULAN_ISA {

// A tile of the wave, and what has been learnt of it so far.
struct TileRange {
    int32_t first_ray, rays;  // in the list of rays with samples
    int64_t scatter_at;       // first row of the tile in the scatter arrays
    int32_t kept;
    int64_t marched;
    double loss, squared_error;
};

// A pixel is one ray or several in a row, judged by their mean.
struct Pixels {
    const MulanScene& scene;
    const March& march;
    const MulanObjective& objective;
    const MulanRendering* rendering;
    float inverse_weight;

    // The first of a pixel's rays speaks for all.
    int64_t first_of_pixel(int64_t ray) const { return ray - ray % objective.rays_a_pixel; }
    bool ignored(int64_t ray) const {
        return !objective.colour_gradient && !(objective.weights[first_of_pixel(ray)] > 0);
    }

    void finish_ray(int64_t ray, float opacity, float moment, const float colour[3], float variance) const {
        if (!rendering) return;
        for (int c = 0; c < 3; ++c) rendering->colour[3 * ray + c] = colour[c];
        rendering->depth_m[ray] = moment / larger(opacity, 1e-10f);
        rendering->opacity[ray] = opacity;
        rendering->variance[ray] = variance;
    }

    const float* background(int64_t ray) const {
        return objective.backgrounds ? objective.backgrounds + 3 * ray : scene.background;
    }

    // share: of the whole loss.
    RayLoss judge(int64_t ray, float share, const float colour[3], float variance) const {
        if (!objective.colour_gradient)
            return pixel_loss(objective, objective.colours + 3 * ray, share, colour, variance);
        RayLoss given;
        for (int c = 0; c < 3; ++c) given.colour_gradient[c] = objective.colour_gradient[3 * ray + c];
        return given;
    }

    float share_of_ray(int64_t ray) const {
        return objective.colour_gradient ? 0 : objective.weights[first_of_pixel(ray)] * inverse_weight;
    }

    // The mean colour of a pixel's rays (of those without samples the background), its loss, and the gradient of that
    // to their samples; returns the slot of the next pixel.
    int learn_pixel(TileRange& range, Tile& tile, int slot, bool head) const {
        const int64_t first = first_of_pixel(tile.ray_id[slot]);
        const float rays_a_pixel = (float)objective.rays_a_pixel;
        float colour[3] = {}, variance = 0;
        int end = slot;
        for (; end < range.rays && tile.ray_id[end] < first + objective.rays_a_pixel; ++end)
            composite_ray(tile, end, head, colour, variance);
        const float empty = rays_a_pixel - (float)(end - slot), *behind = background(first);
        for (int c = 0; c < 3; ++c) colour[c] = (colour[c] + empty * behind[c]) / rays_a_pixel;
        RayLoss r = judge(first, rays_a_pixel * share_of_ray(first), colour, variance / rays_a_pixel);
        range.loss += r.loss;
        range.squared_error += rays_a_pixel * r.squared_error;
        for (int c = 0; c < 3; ++c) r.colour_gradient[c] /= rays_a_pixel;
        r.variance_gradient /= rays_a_pixel;
        for (int k = slot; k < end; ++k) ray_backward(range, tile, k, r);
        return end;
    }

    // Adds one ray's colour and variance to its pixel's.
    void composite_ray(const Tile& tile, int slot, bool head, float pixel_colour[3], float& pixel_variance) const {
        const int first = tile.first[slot], kept = tile.kept[slot];
        float colour[3] = {}, opacity = 0, moment = 0, variance = 0;
        for (int k = first; k < first + kept; ++k) {
            const float blend = tile.blend[k];
            for (int c = 0; c < 3; ++c) colour[c] += blend * tile.colour[3 * k + c];
            opacity += blend;
            moment += blend * tile.t[k];
            if (head) variance += blend * blend * tile.variance[k];
        }
        const float* behind = background(tile.ray_id[slot]);
        for (int c = 0; c < 3; ++c) colour[c] += (1 - opacity) * behind[c];
        finish_ray(tile.ray_id[slot], opacity, moment, colour, variance);
        for (int c = 0; c < 3; ++c) pixel_colour[c] += colour[c];
        pixel_variance += variance;
    }

    // From the gradient to a ray's colour and variance to its samples, with what its samples cost by themselves.
    void ray_backward(TileRange& range, Tile& tile, int slot, const RayLoss& r) const {
        const int first = tile.first[slot], kept = tile.kept[slot];
        const float share = share_of_ray(tile.ray_id[slot]);
        const float* behind = background(tile.ray_id[slot]);
        float opacity_gradient = 0;
        if (objective.entropy_weight > 0) {
            float opacity = 0;
            for (int k = 0; k < kept; ++k) opacity += tile.blend[first + k];
            range.loss += opacity_loss(objective, share, opacity, opacity_gradient);
        }
        float* to_blend = tile.d_depth + first;
        for (int k = 0; k < kept; ++k) {
            const float* sample = tile.colour + 3 * (first + k);
            to_blend[k] = opacity_gradient;
            for (int c = 0; c < 3; ++c) to_blend[k] += r.colour_gradient[c] * (sample[c] - behind[c]);
        }
        if (objective.likelihood)
            for (int k = 0; k < kept; ++k)
                to_blend[k] += 2 * r.variance_gradient * tile.blend[first + k] * tile.variance[first + k];
        if (objective.distortion_weight > 0 && share > 0) {
            float* place = tile.place + first;
            for (int k = 0; k < kept; ++k) place[k] = march.fraction(tile.t[first + k]);
            range.loss += distort(kept, tile.blend + first, place, 1 / (float)scene.steps,
                                  share * objective.distortion_weight, to_blend);
        }
        blend_ray_backward(kept, tile.blend + first, tile.reach_after + first, to_blend);
        for (int k = first; k < first + kept; ++k) {
            for (int c = 0; c < 3; ++c) {
                const float value = tile.colour[3 * k + c];
                tile.d_logits[k * lanes + c] = r.colour_gradient[c] * tile.blend[k] * value * (1 - value);
            }
            tile.d_variance[k] = r.variance_gradient * tile.blend[k] * tile.blend[k];
        }
    }
};

}  // namespace mulan::MULAN_ISA
