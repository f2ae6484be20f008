// The C interface of the native radiance field: plain structs and raw pointers, nothing to link against but this.
//
// All arrays are dense, row-major, little-endian and owned by the caller. "r" counts rays, "s" samples, "n" points.
// Every function returns MULAN_OK or says why it did nothing. No function keeps a pointer after it returns;
// scratch memory lives in a MulanWorkspace, which one thread at a time may use.
#pragma once
#include <stdint.h>

#if defined(_WIN32)
#define MULAN_API __declspec(dllexport)
#elif defined(__GNUC__)
#define MULAN_API __attribute__((visibility("default")))
#else
#define MULAN_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define MULAN_ABI_VERSION 5
#define MULAN_MAX_LEVELS 32
#define MULAN_MAX_THREADS 1024
#define MULAN_MAX_RAYS_A_PIXEL 16
#define MULAN_MAX_CASCADES 8

enum MulanStatus { MULAN_OK = 0, MULAN_BAD_ARGUMENT = 1, MULAN_OUT_OF_MEMORY = 2 };

// Sizes of the field (mulan.radiance.config.FieldConfig); two features an entry.
typedef struct {
    int32_t levels, log2_table_size, width, geometry_features, harmonics_degree;
    int32_t resolution[MULAN_MAX_LEVELS];  // cells a side
    int32_t dense[MULAN_MAX_LEVELS];       // 1: every corner has its own entry, 0: hashed
    float level_weight[MULAN_MAX_LEVELS];  // scales a level's features; 0 switches it off
    float log_density_offset, log_density_max;  // density a scene radius = exp(min(output 0 + offset, max))
    float variance_floor;
} MulanField;

// Where the field lives and how rays are sampled (SceneSpace, MarchConfig).
typedef struct {
    float centre_m[3], radius_m;
    float near_radii, growth;  // unbounded rays: distance / radius = near + sinh(growth * fraction of the steps)
    float background[3];
    float min_transmittance;
    int32_t unbounded, steps;
    int32_t occupancy_resolution, cascades;  // nested grids about the centre; grid k spans 2^(k+1-cascades) of the cube
} MulanScene;

// Parameters: table [L, T, 2]; networks one after another, each [out, in]: density (L*2 -> width -> geometry),
// colour (d*d + geometry -> width -> width -> 3), variance head (width + geometry -> 1). No biases.
typedef struct {
    const float* table;
    const float* networks;
} MulanParameters;

// Which cells may hold matter: one bit a cell, 4x4x4 cells a word (see mulan_occupancy_pack), finest grid first.
typedef struct {
    const uint64_t* words;
    float lower[3], upper[3];  // bounds of the occupied cells in the unit cube
    float least_opacity;       // samples of an unbounded ray thinner than this count as empty
} MulanOccupancy;

typedef struct {
    int64_t count;
    const float* origins;     // [r, 3] metres
    const float* directions;  // [r, 3] unit
    uint64_t seed;            // of the sampling jitter
    int32_t jitter;           // 0: samples at the middle of their step
    int64_t first;            // number of the first ray in the joint batch these are part of; the jitter goes by it
} MulanRays;

// What a step learns from.
typedef struct {
    const float* colours;          // [r, 3]
    const float* weights;          // [r]; 0 ignores the ray
    const float* colour_gradient;  // [r, 3] or null; given: dLoss/dcolour, and colours and weights are not read
    const float* backgrounds;      // [r, 3] or null: behind each ray, instead of the scene's
    float huber_delta;             // 0: squared error; else Huber's loss with this corner
    float variance_weight;         // weight of the variance head's likelihood, which trains the head alone
    int32_t likelihood;            // 1: the colour's cost is that likelihood, and it reaches everything
    float distortion_weight;       // of the distortion along each ray (mip-NeRF 360, eq. 15)
    float entropy_weight;          // of the entropy of each ray's opacity
    int32_t rays_a_pixel;          // so many neighbouring rays share one colour, weight and background, and are judged
                                   // by their mean; 1 with a colour gradient, at most MULAN_MAX_RAYS_A_PIXEL
} MulanObjective;

// Where the gradient to the poses of the cameras goes.
typedef struct {
    int64_t images;
    const int64_t* image_index;   // [r]
    const float* R_world_camera;  // [images, 3, 3]
    float* gradient;              // [images, 6]: to a right perturbation (rotation, translation)
} MulanPoses;

// Where gradients go; null where they are not wanted.
typedef struct {
    float* table;       // [L, T, 2]
    float* networks;    // as MulanParameters
    float* origins;     // [r, 3]
    float* directions;  // [r, 3]
    int32_t fresh;      // 0: table and networks are added to, 1: they are overwritten
} MulanGradients;

typedef struct {
    float* table_mean;
    float* table_square;
    float* networks_mean;
    float* networks_square;
    float table_rate, networks_rate, beta1, beta2, epsilon;
    int64_t step;         // counted from 1
    int32_t skip_untouched;  // 1: entries without gradient keep value and moments
} MulanAdam;

typedef struct {
    double loss, squared_error;
    int64_t samples;  // marched
    int64_t kept;     // of them, in front of the transmittance cut
    int64_t rays;     // not ignored
} MulanStepReport;

typedef struct {
    float* colour;    // [r, 3]
    float* depth_m;   // [r]
    float* opacity;   // [r]
    float* variance;  // [r]
} MulanRendering;

// The pixels of all photographs one after another, ready to be turned into rays.
typedef struct {
    int64_t pixels, images, directions;
    const uint8_t* colours;          // [pixels, 3]
    const uint8_t* opacity;          // [pixels] or null
    const float* weights;            // [pixels]
    const int32_t* image;            // [pixels]
    const float* camera_directions;  // [directions, 3] in the camera frame; need not be unit
    const int64_t* direction_shift;  // [images]: pixel p of image i looks along row p + direction_shift[i]
    const float* T_world_camera;     // [images, 4, 4]
} MulanPixels;

// Where drawn rays go.
typedef struct {
    float* origins;        // [r, 3]
    float* directions;     // [r, 3], unit
    float* colours;        // [r, 3] in [0, 1]
    float* weights;        // [r]
    int64_t* image_index;  // [r]
    float* opacity;        // [r] or null
} MulanRayBatch;

typedef struct MulanWorkspace MulanWorkspace;

MULAN_API int32_t mulan_abi_version(void);
// The instruction set in use: "x86-64-v4", "x86-64-v3", "x86-64" or "generic".
MULAN_API const char* mulan_instruction_set(void);
// Uses another of the library's builds, for tests; fails if the processor cannot run it.
MULAN_API int32_t mulan_use_instruction_set(const char* name);

// threads 0: one a core. Null without memory, or without so many threads.
MULAN_API MulanWorkspace* mulan_workspace_create(int32_t threads);
MULAN_API void mulan_workspace_destroy(MulanWorkspace*);
MULAN_API int64_t mulan_workspace_bytes(const MulanWorkspace*);
// 0 for a field that is not valid.
MULAN_API int64_t mulan_network_parameters(const MulanField*);

// One optimiser step; parameters and moments change in place. The gradients of its loss, as it was before the step,
// to rays and to camera poses are filled where asked for (null: not wanted).
MULAN_API int32_t mulan_train_step(MulanWorkspace*, const MulanField*, const MulanScene*, const MulanOccupancy*,
                                   float* table, float* networks, const MulanRays*, const MulanObjective*,
                                   const MulanAdam*, float* origin_gradient, float* direction_gradient,
                                   const MulanPoses*, MulanStepReport*);
// The same gradients without the update.
MULAN_API int32_t mulan_gradients(MulanWorkspace*, const MulanField*, const MulanScene*, const MulanOccupancy*,
                                  const MulanParameters*, const MulanRays*, const MulanObjective*,
                                  const MulanGradients*, const MulanRendering*, MulanStepReport*);
MULAN_API int32_t mulan_render(MulanWorkspace*, const MulanField*, const MulanScene*, const MulanOccupancy*,
                               const MulanParameters*, const MulanRays*, const MulanRendering*);
// Samples in front of the cut; ray i's start at offsets[i] (from mulan_march) and number kept[i].
MULAN_API int32_t mulan_sample(MulanWorkspace*, const MulanField*, const MulanScene*, const MulanOccupancy*,
                               const MulanParameters*, const MulanRays*, const int64_t* offsets, int32_t* kept,
                               float* blend, float* colour, float* variance, float* distance_m);
// Density [1/m] at n points of the unit cube.
MULAN_API int32_t mulan_density(MulanWorkspace*, const MulanField*, const MulanParameters*, int64_t n,
                                const float* unit_points, float* density);

// opacity [K, R^3] (x fastest) over one step: the visited cells decay, then take the maximum with the density met at a
// jittered point. Visited are the cells with index % stride == phase % stride, and the occupied ones [K, R^3] with
// index % occupied_stride == phase % occupied_stride; never those that a finer cascade covers.
MULAN_API int32_t mulan_occupancy_refresh(MulanWorkspace*, const MulanField*, const MulanScene*,
                                          const MulanParameters*, float decay, int32_t stride, int32_t occupied_stride,
                                          int32_t phase, uint64_t seed, const uint8_t* occupied, float* opacity);
// Occupied cells [K, R^3], 0 or 1 each, as bits, words [K, (R/4)^3], and their bounds in lower [3] and upper [3].
MULAN_API int32_t mulan_occupancy_pack(int32_t resolution, int32_t cascades, const uint8_t* occupied, uint64_t* words,
                                       float* lower, float* upper);

// From gradients to rays to those of the poses they start from, summed in the order of the rays.
MULAN_API int32_t mulan_pose_gradients(int64_t rays, const float* directions, const float* origin_gradient,
                                       const float* direction_gradient, const MulanPoses*);

// The rays of r pixels. A pixel out of range is refused before anything is written.
MULAN_API int32_t mulan_gather_rays(const MulanPixels*, int64_t rays, const int64_t* pixel, const MulanRayBatch*);

// The operations one by one, as tests compare them with the reference.
MULAN_API int32_t mulan_encode(const MulanField*, const float* table, int64_t n, const float* unit_points,
                               float* encoded);
MULAN_API int32_t mulan_encode_backward(const MulanField*, const float* table, int64_t n, const float* unit_points,
                                        const float* gradient, float* table_gradient, float* point_gradient);
MULAN_API int32_t mulan_harmonics(int32_t degree, int64_t n, const float* directions, float* harmonics);
MULAN_API int32_t mulan_harmonics_backward(int32_t degree, int64_t n, const float* directions, const float* gradient,
                                           float* direction_gradient);
// Steps of each ray that lie in occupied cells: count [r]; t_m [r, capacity] and dt_m or null to count only.
MULAN_API int32_t mulan_march(const MulanScene*, const MulanOccupancy*, const MulanRays*, int32_t capacity,
                              int32_t* count, float* t_m, float* dt_m);
// Networks on given encodings and directions, one direction a sample.
MULAN_API int32_t mulan_networks(MulanWorkspace*, const MulanField*, const float* networks, int64_t n,
                                 const float* encoded, const float* directions, float* log_density, float* colour,
                                 float* variance);
MULAN_API int32_t mulan_networks_backward(MulanWorkspace*, const MulanField*, const float* networks, int64_t n,
                                          const float* encoded, const float* directions,
                                          const float* log_density_gradient, const float* colour_gradient,
                                          const float* variance_gradient, float* network_gradient,
                                          float* encoded_gradient, float* direction_gradient);
// Packed samples to rays; ray i's samples are [offsets[i], offsets[i + 1]).
MULAN_API int32_t mulan_composite(const MulanScene*, int64_t rays, const int64_t* offsets, const float* density,
                                  const float* dt_m, const float* t_m, const float* colour, const float* variance,
                                  float* blend, const MulanRendering*);
MULAN_API int32_t mulan_composite_backward(const MulanScene*, int64_t rays, const int64_t* offsets,
                                           const float* density, const float* dt_m, const float* colour,
                                           const float* ray_colour_gradient, float* density_gradient,
                                           float* colour_gradient);
MULAN_API int32_t mulan_adam(int64_t n, float* value, float* mean, float* square, const float* gradient, float rate,
                             float beta1, float beta2, float epsilon, int64_t step, int32_t skip_untouched);

#ifdef __cplusplus
}
#endif
