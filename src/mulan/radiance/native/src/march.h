// Where samples lie on a ray: uniform steps through a box or growing ones to infinity, kept where cells are occupied.
#pragma once
#include "space.h"

namespace mulan::MULAN_ISA {

// sinh and cosh at the start of each step of an unbounded ray: the same for every ray.
inline void fill_march_table(const MulanScene& s, float* table) {
    for (int i = 0; i < s.steps; ++i) {
        const double a = (double)s.growth * i / s.steps;
        table[2 * i] = (float)__builtin_sinh(a);
        table[2 * i + 1] = (float)__builtin_cosh(a);
    }
}

// What all rays of a call share.
struct March {
    const MulanScene& scene;
    const MulanOccupancy& occupancy;
    const float* table;  // of fill_march_table; unbounded scenes only
    float bounded_step_m;

    March(const MulanScene& s, const MulanOccupancy& o, const float* growth_table)
        : scene(s), occupancy(o), table(growth_table), bounded_step_m(2 * 1.7320508f * s.radius_m / (float)s.steps) {}

    float step_m(float t) const {
        if (!scene.unbounded) return bounded_step_m;
        const float beyond = t - scene.near_radii * scene.radius_m;
        return scene.growth / (float)scene.steps *
               __builtin_sqrtf(scene.radius_m * scene.radius_m + beyond * beyond);
    }

    // Distance in units in which all steps of a ray are equally long and make 1 together.
    float fraction(float t) const {
        if (!scene.unbounded) return t / (bounded_step_m * (float)scene.steps);
        return __builtin_asinhf(t / scene.radius_m - scene.near_radii) / scene.growth;
    }

    // Opacity below which a sample counts as empty.
    float thinnest() const { return scene.unbounded ? occupancy.least_opacity : 0.0f; }

    // Where a unit point lies: the finest cascade that holds it, magnified so often, and its cell there.
    struct Cell {
        int at[3], bit;
        float magnification;
        uint64_t word;  // of its 4x4x4 block

        bool occupied() const { return word >> bit & 1; }
    };

    Cell find(const float unit[3]) const {
        const int cells = scene.occupancy_resolution, blocks = cells / 4;
        Cell cell{};
        cell.magnification = 1;
        int cascade = scene.cascades - 1;
        if (cascade > 0) {
            float norm = 0;
            for (int a = 0; a < 3; ++a) norm = larger(norm, __builtin_fabsf(unit[a] - 0.5f));
            for (; cascade > 0 && norm * cell.magnification < 0.25f; --cascade) cell.magnification *= 2;
        }
        for (int a = 0; a < 3; ++a) {
            const float scaled = ((unit[a] - 0.5f) * cell.magnification + 0.5f) * (float)cells;
            cell.at[a] = scaled > 0 ? (scaled < (float)cells ? (int)scaled : cells - 1) : 0;
        }
        cell.bit = (cell.at[0] & 3) + 4 * (cell.at[1] & 3) + 16 * (cell.at[2] & 3);
        cell.word = occupancy.words[(cell.at[0] >> 2) + blocks * ((cell.at[1] >> 2) +
                                                                 blocks * ((cell.at[2] >> 2) + blocks * cascade))];
        return cell;
    }
};

// One ray; collect() goes on where it stopped.
class RayMarch {
  public:
    RayMarch() = default;
    RayMarch(const March& march, const float* origin, const float* direction, float jitter) : jitter_(jitter) {
        const MulanScene& s = march.scene;
        for (int a = 0; a < 3; ++a) {
            origin_[a] = origin[a];
            direction_[a] = direction[a];
        }
        last_ = s.steps;
        if (s.unbounded) {
            sinh_ = __builtin_sinhf(s.growth * jitter / (float)s.steps);
            cosh_ = __builtin_coshf(s.growth * jitter / (float)s.steps);
            return;
        }
        float low[3], high[3];
        for (int a = 0; a < 3; ++a) {
            start_[a] = (origin[a] - s.centre_m[a]) / s.radius_m * 0.5f + 0.5f;
            const float safe = __builtin_fabsf(direction[a]) < 1e-9f ? 1e-9f : direction[a];
            slope_[a] = safe * (0.5f / s.radius_m);
            inverse_[a] = 1 / slope_[a];
            low[a] = 0;
            high[a] = 1;
        }
        interval(low, high, enter_, leave_);
        enter_ = larger(enter_, 0.0f);
        if (!(leave_ > enter_)) {
            last_ = 0;
            return;
        }
        float first, final;
        interval(march.occupancy.lower, march.occupancy.upper, first, final);
        // A step's margin of 1e-3: rounding must never skip a sample that a plain walk would take.
        next_ = step_at(march, larger(first, enter_), -1e-3f);
        last_ = smaller(last_, step_at(march, smaller(final, leave_), 1e-3f) + 1);
    }

    // Distances of up to `capacity` further samples in occupied cells; fewer only at the end of the ray.
    int collect(const March& march, float* t, int capacity) {
        return march.scene.unbounded ? collect_unbounded(march, t, capacity) : collect_bounded(march, t, capacity);
    }

  private:
    void interval(const float low[3], const float high[3], float& enter, float& leave) const {
        enter = -3e38f;
        leave = 3e38f;
        for (int a = 0; a < 3; ++a) {
            const float p = (low[a] - start_[a]) * inverse_[a], q = (high[a] - start_[a]) * inverse_[a];
            enter = larger(enter, smaller(p, q));
            leave = smaller(leave, larger(p, q));
        }
    }

    // First step whose sample lies at or behind t, give or take a fraction of a step.
    int step_at(const March& march, float t, float margin) const {
        const float step = (t - enter_) / march.bounded_step_m - jitter_ + margin;
        return step > 0 ? (step < 1e6f ? (int)step + (step > (float)(int)step) : 1000000) : 0;
    }

    int collect_bounded(const March& march, float* t, int capacity) {
        int count = 0;
        while (next_ < last_ && count < capacity) {
            const float distance = enter_ + ((float)next_ + jitter_) * march.bounded_step_m;
            if (!(distance < leave_)) {
                next_ = last_;
                break;
            }
            float unit[3];
            for (int a = 0; a < 3; ++a) unit[a] = start_[a] + distance * slope_[a];
            const March::Cell cell = march.find(unit);
            ++next_;
            if (cell.occupied())
                t[count++] = distance;
            else if (cell.word == 0) {
                const float block_side = 4.0f / (float)march.scene.occupancy_resolution;
                float exit = 3e38f;
                for (int a = 0; a < 3; ++a) {
                    const float within = (float)((cell.at[a] >> 2) + (slope_[a] > 0)) * block_side;
                    const float wall = (within - 0.5f) / cell.magnification + 0.5f;
                    exit = smaller(exit, (wall - start_[a]) * inverse_[a]);
                }
                next_ = larger(next_, step_at(march, exit, -1e-3f));
            }
        }
        return count;
    }

    int collect_unbounded(const March& march, float* t, int capacity) {
        const MulanScene& s = march.scene;
        int count = 0;
        for (; next_ < last_ && count < capacity; ++next_) {
            const float growth = march.table[2 * next_] * cosh_ + march.table[2 * next_ + 1] * sinh_;
            const float distance = s.radius_m * (s.near_radii + growth);
            float world[3], unit[3];
            for (int a = 0; a < 3; ++a) world[a] = origin_[a] + distance * direction_[a];
            to_unit(s, world, unit);
            if (march.find(unit).occupied()) t[count++] = distance;
        }
        return count;
    }

    float origin_[3] = {}, direction_[3] = {}, start_[3] = {}, slope_[3] = {}, inverse_[3] = {};
    float jitter_ = 0, enter_ = 0, leave_ = 0, sinh_ = 0, cosh_ = 1;
    int next_ = 0, last_ = 0;
};

}  // namespace mulan::MULAN_ISA
