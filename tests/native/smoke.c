/* The C interface without Python: learns a small scene, prints numbers that another build must reproduce.
 * tests/native/test_other_processors.py runs it on an emulated ARM64 processor and on this one. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "mulan_native.h"

enum { LEVELS = 5, TABLE = 1 << 9, RAYS = 100, SIDE = 16, POINTS = 37 };

static uint32_t state = 1;
static float random_number(void) { /* the same on every machine, in [-1, 1) */
    state = state * 1664525u + 1013904223u;
    return (float)(state >> 8) * 0x1p-23f - 1;
}
static float* random_array(int n, float scale) {
    float* a = malloc(sizeof(float) * (size_t)n);
    for (int i = 0; i < n; ++i) a[i] = scale * random_number();
    return a;
}
static float* zeros(int n) { return calloc((size_t)n, sizeof(float)); }
static void print(const char* name, const float* values, int n) {
    printf("%s", name);
    for (int i = 0; i < n; ++i) printf(" %.9g", values[i]);
    printf("\n");
}
static void must(int32_t status, const char* what) {
    if (status == MULAN_OK) return;
    fprintf(stderr, "%s: status %d\n", what, status);
    exit(1);
}

static MulanField field = {LEVELS, 9, 24, 7, 4, {4, 7, 12, 22, 40}, {1, 1}, {1, 1, 1, 1, 1}, -1.5f, 15, 1e-4f};

static void run_scene(MulanWorkspace* w, int unbounded, int jitter) {
    MulanScene scene = {.radius_m = 1, .near_radii = 0.02f, .growth = 4.85f, .background = {1, 1, 1}};
    scene.min_transmittance = 1e-4f;
    scene.unbounded = unbounded;
    scene.steps = 60;
    scene.occupancy_resolution = SIDE;
    scene.cascades = 1;
    uint8_t* occupied = malloc(SIDE * SIDE * SIDE);
    for (int i = 0; i < SIDE * SIDE * SIDE; ++i) occupied[i] = random_number() > -0.5f;
    uint64_t* words = calloc(SIDE * SIDE * SIDE / 64, 8);
    MulanOccupancy occupancy = {.words = words};
    must(mulan_occupancy_pack(SIDE, 1, occupied, words, occupancy.lower, occupancy.upper), "pack");

    const int parameters = (int)mulan_network_parameters(&field), entries = LEVELS * TABLE * 2;
    float *table = random_array(entries, 0.1f), *networks = random_array(parameters, 0.4f);
    float *o = random_array(3 * RAYS, 0.3f), *d = random_array(3 * RAYS, 1);
    float *colours = zeros(3 * RAYS), *weights = zeros(RAYS);
    for (int i = 0; i < RAYS; ++i) {
        const float norm = sqrtf(d[3 * i] * d[3 * i] + d[3 * i + 1] * d[3 * i + 1] + d[3 * i + 2] * d[3 * i + 2]);
        for (int a = 0; a < 3; ++a) {
            d[3 * i + a] /= norm;
            if (!unbounded) o[3 * i + a] -= 3 * d[3 * i + a];
            colours[3 * i + a] = 0.5f + 0.4f * d[3 * i + a];
        }
        weights[i] = i % 7 ? 1 : 0;
    }
    const MulanRays rays = {RAYS, o, d, 11, jitter};
    const MulanObjective objective = {.colours = colours, .weights = weights, .huber_delta = 0.1f, .variance_weight = 1,
                                       .rays_a_pixel = 1};
    MulanAdam adam = {zeros(entries), zeros(entries), zeros(parameters), zeros(parameters),
                      1e-2f,          1e-2f,          0.9f,              0.99f,
                      1e-15f,         0,              1};
    float *to_origins = zeros(3 * RAYS), *to_directions = zeros(3 * RAYS), *rendered = zeros(6 * RAYS);
    double first_loss = 0;
    MulanStepReport report;
    for (adam.step = 1; adam.step <= 8; ++adam.step) {
        must(mulan_train_step(w, &field, &scene, &occupancy, table, networks, &rays, &objective, &adam, to_origins,
                              to_directions, NULL, &report),
             "train step");
        if (adam.step > 1) continue;
        first_loss = report.loss;
        print("to_origins", to_origins, 60);
        print("to_directions", to_directions, 60);
    }
    const float facts[] = {(float)first_loss, (float)report.loss, (float)report.samples, (float)report.rays};
    print("losses", facts, 4);
    const MulanParameters p = {table, networks};
    const MulanRendering out = {rendered, rendered + 3 * RAYS, rendered + 4 * RAYS, rendered + 5 * RAYS};
    must(mulan_render(w, &field, &scene, &occupancy, &p, &rays, &out), "render");
    print("rendered", rendered, 6 * RAYS);
    if (!(report.loss < 0.9 * first_loss)) {
        fprintf(stderr, "nothing was learnt: %g after %g\n", report.loss, first_loss);
        exit(1);
    }
}

int main(void) {
    MulanWorkspace* w = mulan_workspace_create(3);
    if (!w) return 1;
    float *points = random_array(3 * POINTS, 0.7f), *table = random_array(LEVELS * TABLE * 2, 1);
    for (int i = 0; i < 3 * POINTS; ++i) points[i] += 0.5f; /* some outside the cube */
    float *encoded = zeros(2 * LEVELS * POINTS), *harmonics = zeros(16 * POINTS), *back = zeros(3 * POINTS);
    must(mulan_encode(&field, table, POINTS, points, encoded), "encode");
    print("encoded", encoded, 2 * LEVELS * POINTS);
    float* to_table = zeros(LEVELS * TABLE * 2);
    must(mulan_encode_backward(&field, table, POINTS, points, encoded, to_table, back), "encode backward");
    print("to_points", back, 3 * POINTS);
    must(mulan_harmonics(4, POINTS, points, harmonics), "harmonics");
    print("harmonics", harmonics, 16 * POINTS);
    run_scene(w, 0, 0);
    run_scene(w, 1, 1);
    mulan_workspace_destroy(w);
    fprintf(stderr, "%s\n", mulan_instruction_set());
    return 0;
}
