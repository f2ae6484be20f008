// The C interface: checks sizes, keeps exceptions inside, calls the chosen build.
#include <cmath>
#include <initializer_list>
#include <new>
#include <thread>

#include "kernels.h"

using mulan::kernels;

namespace {

bool finite(const float* values, int n) {
    for (int i = 0; i < n; ++i)
        if (!std::isfinite(values[i])) return false;
    return true;
}

// Whether all are given, or n is 0 and nothing will be read.
bool given(int64_t n, std::initializer_list<const void*> arrays) {
    if (n < 0) return false;
    for (const void* array : arrays)
        if (n > 0 && !array) return false;
    return true;
}

bool valid(const MulanField* f) {
    if (!f || f->levels < 1 || f->levels > MULAN_MAX_LEVELS || f->log2_table_size < 4 || f->log2_table_size > 28)
        return false;
    if (f->width < 1 || f->width > 1024 || f->geometry_features < 1 || f->geometry_features > 1024) return false;
    if (f->harmonics_degree < 1 || f->harmonics_degree > 4) return false;
    if (!finite(&f->log_density_offset, 1) || !finite(&f->log_density_max, 1) || !finite(&f->variance_floor, 1))
        return false;
    for (int i = 0; i < f->levels; ++i) {
        const int64_t r = f->resolution[i];
        if (r < 1 || r > (1 << 22) || !finite(&f->level_weight[i], 1)) return false;
        if (f->dense[i] && (r > 2000 || (r + 1) * (r + 1) * (r + 1) > (int64_t)1 << f->log2_table_size)) return false;
    }
    return true;
}

bool valid(const MulanScene* s) {
    if (!s || !(s->radius_m > 0) || !finite(&s->radius_m, 1) || !finite(s->centre_m, 3)) return false;
    if (!finite(&s->near_radii, 1) || !finite(&s->growth, 1) || !finite(s->background, 3)) return false;
    if (!finite(&s->min_transmittance, 1)) return false;
    if (s->steps < 1 || s->steps > (1 << 16)) return false;
    if (s->cascades < 1 || s->cascades > MULAN_MAX_CASCADES) return false;
    const int whole = s->cascades > 1 ? 16 : 4;  // a word's cells must not straddle a finer cascade's rim
    return s->occupancy_resolution >= 4 && s->occupancy_resolution <= 512 && s->occupancy_resolution % whole == 0;
}

bool valid(const MulanOccupancy* o) { return o && o->words; }
bool valid(const MulanParameters* p) { return p && p->table && p->networks; }
bool valid(const MulanRays* r) { return r && given(r->count, {r->origins, r->directions}); }
bool valid(const MulanObjective* o, const MulanRays* r) {
    if (!o || !r || !finite(&o->huber_delta, 1) || !finite(&o->variance_weight, 1)) return false;
    if (!finite(&o->distortion_weight, 1) || !finite(&o->entropy_weight, 1)) return false;
    if (o->colour_gradient) return o->rays_a_pixel == 1;
    if (o->rays_a_pixel < 1 || o->rays_a_pixel > MULAN_MAX_RAYS_A_PIXEL || r->count % o->rays_a_pixel) return false;
    return given(r->count, {o->colours, o->weights});
}
bool valid(const MulanAdam* a) {
    if (!a || a->step < 1) return false;
    for (float number : {a->table_rate, a->networks_rate, a->beta1, a->beta2, a->epsilon})
        if (!std::isfinite(number)) return false;
    return given(1, {a->table_mean, a->table_square, a->networks_mean, a->networks_square});
}
bool valid(const MulanRendering* out, int64_t rays) {
    return out && given(rays, {out->colour, out->depth_m, out->opacity, out->variance});
}
// Samples between the [rays + 1] starts of rays, which never fall; -1 if they do.
int64_t packed_samples(const int64_t* offsets, int64_t rays) {
    if (!offsets || rays < 0 || (rays > 0 && offsets[0] < 0)) return -1;
    for (int64_t i = 0; i < rays; ++i)
        if (offsets[i + 1] < offsets[i] || offsets[i + 1] - offsets[i] > INT32_MAX / 2) return -1;
    return rays > 0 ? offsets[rays] - offsets[0] : 0;
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
        if (threads < 0 || threads > MULAN_MAX_THREADS) return nullptr;
        return new MulanWorkspace(threads > 0 ? threads : (int)std::thread::hardware_concurrency());
    } catch (...) {
        return nullptr;  // no memory, or no more threads
    }
}
void mulan_workspace_destroy(MulanWorkspace* w) { delete w; }
int64_t mulan_workspace_bytes(const MulanWorkspace* w) {
    if (!w) return 0;
    int64_t bytes = 0;
    for (const mulan::Buffer* b :
         {&w->packed_networks, &w->tiles, &w->march_table, &w->ray_samples, &w->ray_lists, &w->tile_lists,
          &w->group_gradients, &w->network_gradient, &w->samples, &w->encoded, &w->scatter_gradients,
          &w->table_gradient, &w->ray_gradients})
        bytes += (int64_t)b->bytes();
    return bytes;
}

int64_t mulan_network_parameters(const MulanField* f) {
    if (!valid(f)) return 0;
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
                    valid(adam) && !origin_gradient == !direction_gradient &&
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
                    !g->table == !g->networks && !g->origins == !g->directions &&
                    (!rendering || valid(rendering, rays->count)) && report;
    return guarded(ok, [&] { return kernels().gradients(w, f, s, o, p, rays, objective, g, rendering, report); });
}

int32_t mulan_render(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                     const MulanParameters* p, const MulanRays* rays, const MulanRendering* out) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && valid(p) && valid(rays) && valid(out, rays->count);
    return guarded(ok, [&] { return kernels().render(w, f, s, o, p, rays, out); });
}

int32_t mulan_sample(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanOccupancy* o,
                     const MulanParameters* p, const MulanRays* rays, const int64_t* offsets, int32_t* kept,
                     float* blend, float* colour, float* variance, float* distance_m) {
    const bool ok = w && valid(f) && valid(s) && valid(o) && valid(p) && valid(rays) && given(rays->count, {kept}) &&
                    given(packed_samples(offsets, rays->count), {blend, colour, variance, distance_m});
    return guarded(ok, [&] {
        return kernels().sample(w, f, s, o, p, rays, offsets, kept, blend, colour, variance, distance_m);
    });
}

int32_t mulan_density(MulanWorkspace* w, const MulanField* f, const MulanParameters* p, int64_t n,
                      const float* unit_points, float* density) {
    return guarded(w && valid(f) && valid(p) && given(n, {unit_points, density}),
                   [&] { return kernels().density(w, f, p, n, unit_points, density); });
}

int32_t mulan_occupancy_refresh(MulanWorkspace* w, const MulanField* f, const MulanScene* s, const MulanParameters* p,
                                float decay, int32_t stride, int32_t occupied_stride, int32_t phase, uint64_t seed,
                                const uint8_t* occupied, float* opacity) {
    const bool ok = w && valid(f) && valid(s) && valid(p) && stride > 0 && occupied_stride > 0 && phase >= 0 &&
                    finite(&decay, 1) && occupied && opacity;
    return guarded(ok, [&] {
        return kernels().occupancy_refresh(w, f, s, p, decay, stride, occupied_stride, phase, seed, occupied, opacity);
    });
}

int32_t mulan_encode(const MulanField* f, const float* table, int64_t n, const float* points, float* encoded) {
    const bool ok = valid(f) && table && given(n, {points, encoded});
    return guarded(ok, [&] { return kernels().encode(f, table, n, points, encoded); });
}

int32_t mulan_encode_backward(const MulanField* f, const float* table, int64_t n, const float* points,
                              const float* gradient, float* table_gradient, float* point_gradient) {
    return guarded(valid(f) && table && given(n, {points, gradient}), [&] {
        return kernels().encode_backward(f, table, n, points, gradient, table_gradient, point_gradient);
    });
}

int32_t mulan_harmonics(int32_t degree, int64_t n, const float* directions, float* harmonics) {
    return guarded(degree >= 1 && degree <= 4 && given(n, {directions, harmonics}),
                   [&] { return kernels().harmonics(degree, n, directions, harmonics); });
}

int32_t mulan_harmonics_backward(int32_t degree, int64_t n, const float* directions, const float* gradient,
                                 float* direction_gradient) {
    return guarded(degree >= 1 && degree <= 4 && given(n, {directions, gradient, direction_gradient}), [&] {
        return kernels().harmonics_backward(degree, n, directions, gradient, direction_gradient);
    });
}

int32_t mulan_march(const MulanScene* s, const MulanOccupancy* o, const MulanRays* rays, int32_t capacity,
                    int32_t* count, float* t_m, float* dt_m) {
    return guarded(valid(s) && valid(o) && valid(rays) && given(rays->count, {count}) && capacity >= 0 &&
                       !t_m == !dt_m,
                   [&] { return kernels().march(s, o, rays, capacity, count, t_m, dt_m); });
}

int32_t mulan_networks(MulanWorkspace* w, const MulanField* f, const float* networks, int64_t n, const float* encoded,
                       const float* directions, float* log_density, float* colour, float* variance) {
    const bool ok = w && valid(f) && networks && given(n, {encoded, directions, log_density, colour, variance});
    return guarded(ok, [&] {
        return kernels().networks(w, f, networks, n, encoded, directions, log_density, colour, variance);
    });
}

int32_t mulan_networks_backward(MulanWorkspace* w, const MulanField* f, const float* networks, int64_t n,
                                const float* encoded, const float* directions, const float* log_density_gradient,
                                const float* colour_gradient, const float* variance_gradient, float* network_gradient,
                                float* encoded_gradient, float* direction_gradient) {
    const bool ok = w && valid(f) && networks && network_gradient &&
                    given(n, {encoded, directions, log_density_gradient, colour_gradient, variance_gradient,
                              encoded_gradient, direction_gradient});
    return guarded(ok, [&] {
        return kernels().networks_backward(w, f, networks, n, encoded, directions, log_density_gradient,
                                           colour_gradient, variance_gradient, network_gradient, encoded_gradient,
                                           direction_gradient);
    });
}

int32_t mulan_composite(const MulanScene* s, int64_t rays, const int64_t* offsets, const float* density,
                        const float* dt_m, const float* t_m, const float* colour, const float* variance, float* blend,
                        const MulanRendering* out) {
    const bool ok = valid(s) && valid(out, rays) &&
                    given(packed_samples(offsets, rays), {density, dt_m, t_m, colour, variance, blend});
    return guarded(ok, [&] {
        return kernels().composite(s, rays, offsets, density, dt_m, t_m, colour, variance, blend, out);
    });
}

int32_t mulan_composite_backward(const MulanScene* s, int64_t rays, const int64_t* offsets, const float* density,
                                 const float* dt_m, const float* colour, const float* ray_colour_gradient,
                                 float* density_gradient, float* colour_gradient) {
    const bool ok = valid(s) && given(rays, {ray_colour_gradient}) &&
                    given(packed_samples(offsets, rays), {density, dt_m, colour, density_gradient, colour_gradient});
    return guarded(ok, [&] {
        return kernels().composite_backward(s, rays, offsets, density, dt_m, colour, ray_colour_gradient,
                                            density_gradient, colour_gradient);
    });
}

int32_t mulan_adam(int64_t n, float* value, float* mean, float* square, const float* gradient, float rate, float beta1,
                   float beta2, float epsilon, int64_t step, int32_t skip_untouched) {
    return guarded(given(n, {value, mean, square, gradient}) && step > 0, [&] {
        return kernels().adam(n, value, mean, square, gradient, rate, beta1, beta2, epsilon, step, skip_untouched);
    });
}
