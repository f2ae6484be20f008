// The C interface: checks sizes, keeps exceptions inside, calls the chosen build.
#include <cmath>
#include <initializer_list>
#include <new>
#include <thread>

#include "kernels.h"

using mulan::kernels;

namespace {

bool valid(const MulanField* f) {
    if (!f || f->levels < 1 || f->levels > MULAN_MAX_LEVELS || f->log2_table_size < 4 || f->log2_table_size > 28)
        return false;
    if (f->width < 1 || f->width > 1024 || f->geometry_features < 1 || f->geometry_features > 1024) return false;
    if (f->harmonics_degree < 1 || f->harmonics_degree > 4) return false;
    for (int i = 0; i < f->levels; ++i) {
        const int64_t r = f->resolution[i];
        if (r < 1 || r > (1 << 22) || !std::isfinite(f->level_weight[i])) return false;
        if (f->dense[i] && (r > 2000 || (r + 1) * (r + 1) * (r + 1) > (int64_t)1 << f->log2_table_size)) return false;
    }
    return true;
}

bool valid(const MulanScene* s) {
    if (!s || !(s->radius_m > 0) || !std::isfinite(s->radius_m)) return false;
    if (s->steps < 1 || s->steps > (1 << 16)) return false;
    if (s->cascades < 1 || s->cascades > MULAN_MAX_CASCADES) return false;
    const int whole = s->cascades > 1 ? 16 : 4;  // a word's cells must not straddle a finer cascade's rim
    return s->occupancy_resolution >= 4 && s->occupancy_resolution <= 512 && s->occupancy_resolution % whole == 0;
}

bool valid(const MulanOccupancy* o) { return o && o->words; }
bool valid(const MulanParameters* p) { return p && p->table && p->networks; }
bool valid(const MulanRays* r) { return r && r->count >= 0 && (r->count == 0 || (r->origins && r->directions)); }
bool valid(const MulanObjective* o, const MulanRays* r) {
    return o && r && (r->count == 0 || o->colour_gradient || (o->colours && o->weights));
}

template <class Call> int32_t guarded(bool valid_arguments, const Call& call) {
    if (!valid_arguments) return MULAN_BAD_ARGUMENT;
    try {
        return call();
    } catch (const std::bad_alloc&) {
        return MULAN_OUT_OF_MEMORY;
    }
}

}  // namespace

int32_t mulan_abi_version(void) { return MULAN_ABI_VERSION; }
const char* mulan_instruction_set(void) { return kernels().instruction_set; }
int32_t mulan_use_instruction_set(const char* name) {
    return mulan::choose_kernels(name) ? MULAN_OK : MULAN_BAD_ARGUMENT;
}

MulanWorkspace* mulan_workspace_create(int32_t threads) {
    try {
        return new MulanWorkspace(threads > 0 ? threads : (int)std::thread::hardware_concurrency());
    } catch (...) {
        return nullptr;  // no memory, or no more threads
    }
}
void mulan_workspace_destroy(MulanWorkspace* w) { delete w; }
int64_t mulan_workspace_bytes(const MulanWorkspace* w) {
    int64_t bytes = 0;
    for (const mulan::Buffer* b :
         {&w->packed_networks, &w->tiles, &w->march_table, &w->ray_samples, &w->ray_lists, &w->tile_lists,
          &w->group_gradients, &w->network_gradient, &w->scatter_points, &w->scatter_gradients, &w->table_gradient,
          &w->ray_gradients})
        bytes += (int64_t)b->bytes();
    return bytes;
}

int64_t mulan_network_parameters(const MulanField* f) {
    const int64_t encoded = 2 * f->levels, width = f->width, geometry = f->geometry_features;
    const int64_t bands = f->harmonics_degree * f->harmonics_degree;
    return encoded * width + width * geometry + width * (bands + geometry) + width * width + 3 * width + width +
           geometry;
}

int32_t mulan_train_step(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                         float* table, float* networks, const MulanRays* rays, const MulanObjective* objective,
                         const MulanAdam* adam, float* origin_gradient, float* direction_gradient,
                         const MulanPoses* poses, MulanStepReport* report) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && table && networks && valid(rays) && valid(objective, rays) &&
                    adam && adam->step > 0 && !origin_gradient == !direction_gradient &&
                    (!poses || mulan::valid(poses, rays->count)) && report;
    return guarded(ok, [&] {
        return kernels().train_step(w, f, s, o, table, networks, rays, objective, adam, origin_gradient,
                                    direction_gradient, poses, report);
    });
}

int32_t mulan_gradients(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                        const MulanParameters* p, const MulanRays* rays, const MulanObjective* objective,
                        const MulanGradients* g, const MulanRendering* rendering, MulanStepReport* report) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && valid(p) && valid(rays) && valid(objective, rays) && g &&
                    !g->table == !g->networks && !g->origins == !g->directions && report;
    return guarded(ok, [&] { return kernels().gradients(w, f, s, o, p, rays, objective, g, rendering, report); });
}

int32_t mulan_render(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                     const MulanParameters* p, const MulanRays* rays, const MulanRendering* out) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && valid(p) && valid(rays) && out;
    return guarded(ok, [&] { return kernels().render(w, f, s, o, p, rays, out); });
}

int32_t mulan_sample(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                     const MulanParameters* p, const MulanRays* rays, const int64_t* offsets, int32_t* kept,
                     float* blend, float* colour, float* variance, float* distance_m) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && valid(p) && valid(rays) && offsets &&
                    (kept || rays->count == 0);
    return guarded(ok, [&] {
        return kernels().sample(w, f, s, o, p, rays, offsets, kept, blend, colour, variance, distance_m);
    });
}

int32_t mulan_density(MulanWorkspace* w, const MulanField* f, const MulanParameters* p, int64_t n,
                      const float* unit_points, float* density) {
    return guarded(w && valid(f) && valid(p) && n >= 0,
                   [&] { return kernels().density(w, f, p, n, unit_points, density); });
}

int32_t mulan_occupancy_refresh(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanParameters* p,
                                float decay, int32_t stride, int32_t occupied_stride, int32_t phase, uint64_t seed,
                                const uint8_t* occupied, float* opacity) {
    const bool ok = w && valid(f) && valid(s) && valid(p) && stride > 0 && occupied_stride > 0 && phase >= 0 &&
                    occupied && opacity;
    return guarded(ok, [&] {
        return kernels().occupancy_refresh(w, f, s, p, decay, stride, occupied_stride, phase, seed, occupied, opacity);
    });
}

int32_t mulan_encode(const MulanField* f, const float* table, int64_t n, const float* points, float* encoded) {
    return guarded(valid(f) && table && n >= 0, [&] { return kernels().encode(f, table, n, points, encoded); });
}

int32_t mulan_encode_backward(const MulanField* f, const float* table, int64_t n, const float* points,
                              const float* gradient, float* table_gradient, float* point_gradient) {
    return guarded(valid(f) && table && n >= 0, [&] {
        return kernels().encode_backward(f, table, n, points, gradient, table_gradient, point_gradient);
    });
}

int32_t mulan_harmonics(int32_t degree, int64_t n, const float* directions, float* harmonics) {
    return guarded(degree >= 1 && degree <= 4 && n >= 0,
                   [&] { return kernels().harmonics(degree, n, directions, harmonics); });
}

int32_t mulan_harmonics_backward(int32_t degree, int64_t n, const float* directions, const float* gradient,
                                 float* direction_gradient) {
    return guarded(degree >= 1 && degree <= 4 && n >= 0, [&] {
        return kernels().harmonics_backward(degree, n, directions, gradient, direction_gradient);
    });
}

int32_t mulan_march(const MulanScene* s, const MulanOccupancy* o, const MulanRays* rays, int32_t capacity,
                    int32_t* count, float* t_m, float* dt_m) {
    return guarded(valid(s) && valid(o) && valid(rays) && (count || rays->count == 0) && capacity >= 0 && !t_m == !dt_m,
                   [&] { return kernels().march(s, o, rays, capacity, count, t_m, dt_m); });
}

int32_t mulan_networks(MulanWorkspace* w, const MulanField* f, const float* networks, int64_t n, const float* encoded,
                       const float* directions, float* log_density, float* colour, float* variance) {
    return guarded(w && valid(f) && networks && n >= 0, [&] {
        return kernels().networks(w, f, networks, n, encoded, directions, log_density, colour, variance);
    });
}

int32_t mulan_networks_backward(MulanWorkspace* w, const MulanField* f, const float* networks, int64_t n,
                                const float* encoded, const float* directions, const float* log_density_gradient,
                                const float* colour_gradient, const float* variance_gradient, float* network_gradient,
                                float* encoded_gradient, float* direction_gradient) {
    return guarded(w && valid(f) && networks && n >= 0, [&] {
        return kernels().networks_backward(w, f, networks, n, encoded, directions, log_density_gradient,
                                           colour_gradient, variance_gradient, network_gradient, encoded_gradient,
                                           direction_gradient);
    });
}

int32_t mulan_composite(const MulanScene* s, int64_t rays, const int64_t* offsets, const float* density,
                        const float* dt_m, const float* t_m, const float* colour, const float* variance, float* blend,
                        const MulanRendering* out) {
    return guarded(valid(s) && rays >= 0 && offsets && out, [&] {
        return kernels().composite(s, rays, offsets, density, dt_m, t_m, colour, variance, blend, out);
    });
}

int32_t mulan_composite_backward(const MulanScene* s, int64_t rays, const int64_t* offsets, const float* density,
                                 const float* dt_m, const float* colour, const float* ray_colour_gradient,
                                 float* density_gradient, float* colour_gradient) {
    return guarded(valid(s) && rays >= 0 && offsets, [&] {
        return kernels().composite_backward(s, rays, offsets, density, dt_m, colour, ray_colour_gradient,
                                            density_gradient, colour_gradient);
    });
}

int32_t mulan_adam(int64_t n, float* value, float* mean, float* square, const float* gradient, float rate, float beta1,
                   float beta2, float epsilon, int64_t step, int32_t skip_untouched) {
    return guarded(n >= 0 && step > 0, [&] {
        return kernels().adam(n, value, mean, square, gradient, rate, beta1, beta2, epsilon, step, skip_untouched);
    });
}
