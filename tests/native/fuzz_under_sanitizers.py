"""Run in its own process with a sanitizer's run-time loaded: numpy and the C interface only.

python tests/native/fuzz_under_sanitizers.py LIBRARY [CASES]
"""

import sys
from pathlib import Path

import numpy as np

from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import (
    NativeAdam,
    NativeGradients,
    NativeObjective,
    NativeParameters,
    NativePixels,
    NativePoses,
    NativeRayBatch,
    NativeRays,
    NativeRendering,
    NativeStepReport,
)
from tests.native.odd_inputs import Case, at, odd_case, odd_rays

MOST_RAYS = 300


def run(library: NativeLibrary, workspace: int, rng: np.random.Generator, case: Case) -> None:
    """Every operation that rays or points go into, on rays of all kinds."""
    c, n = library.functions, int(rng.integers(0, MOST_RAYS))
    origins, directions = odd_rays(rng, case.scene, n)
    rays = NativeRays(n, at(origins), at(directions), int(rng.integers(2**63)), int(rng.integers(2)))
    colours, weights = rng.random((n, 3), np.float32), rng.random(n, np.float32)
    if rng.random() < 0.2:
        colours[rng.random((n, 3)) < 0.1], weights[rng.random(n) < 0.1] = np.nan, np.inf
    out = [np.zeros((n, 3), np.float32), *(np.zeros(n, np.float32) for _ in range(3))]
    rendering = NativeRendering(*(at(x) for x in out))
    parameters = NativeParameters(at(case.table), at(case.networks))
    context = (workspace, case.field, case.scene, case.occupancy)
    check(c.mulan_render(*context, parameters, rays, rendering))

    march_and_sample(library, context, parameters, rays)
    gradients = [np.zeros_like(x) for x in (case.table, case.networks, origins, directions)]
    behind = rng.random((n, 3), np.float32)
    objective = NativeObjective(at(colours), at(weights), None, at(behind), float(rng.choice([0, 0.1])), 1.0)
    objective.likelihood, objective.distortion_weight = int(rng.integers(2)), float(rng.choice([0, 0.1]))
    objective.entropy_weight = float(rng.choice([0, 0.1]))
    objective.rays_a_pixel = int(rng.choice([k for k in (1, 2, 3, 16) if n % k == 0]))
    index, R = rng.integers(0, 4, n), rng.random((4, 3, 3), np.float32)
    to_poses = np.zeros((4, 6), np.float32)
    poses = NativePoses(4, at(index), at(R), at(to_poses))
    report = NativeStepReport()
    wanted = NativeGradients(*(at(x) for x in gradients))
    check(c.mulan_gradients(*context, parameters, rays, objective, wanted, rendering, report))
    only_rays = NativeGradients(None, None, at(gradients[2]), at(gradients[3]))
    given = NativeObjective(colour_gradient=at(colours), rays_a_pixel=1)
    check(c.mulan_gradients(*context, parameters, rays, given, only_rays, None, report))
    moments = [np.zeros_like(x) for x in (case.table, case.table, case.networks, case.networks)]
    adam = NativeAdam(*(at(x) for x in moments), 1e-2, 1e-2, 0.9, 0.99, 1e-15, 1, int(rng.integers(2)))
    for wanted_here in ((at(gradients[2]), at(gradients[3]), None), (None, None, poses), (None, None, None)):
        arrays = at(case.table), at(case.networks)
        check(c.mulan_train_step(*context, *arrays, rays, objective, adam, *wanted_here, report))

    opacity = np.zeros(len(case.occupied), np.float32)
    strides = int(rng.integers(1, 9)), int(rng.integers(1, 4)), int(rng.integers(2**31))
    cells = at(case.occupied), at(opacity)
    check(c.mulan_occupancy_refresh(workspace, case.field, case.scene, parameters, 0.95, *strides, 5, *cells))
    encode_points(library, workspace, parameters, case, odd_rays(rng, case.scene, n)[0])
    arrays = (at(x) for x in (directions, *gradients[2:]))
    check(c.mulan_pose_gradients(n, *arrays, poses))
    gather(library, rng, n)


def march_and_sample(
    library: NativeLibrary, context: tuple, parameters: NativeParameters, rays: NativeRays
) -> None:
    c, n = library.functions, rays.count
    _, _, scene, occupancy = context
    count = np.zeros(n, np.int32)
    check(c.mulan_march(scene, occupancy, rays, 0, at(count), None, None))
    assert count.max(initial=0) <= scene.steps
    offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    room = int(offsets[-1])
    samples = [np.zeros(n, np.int32), *(np.zeros((room, k), np.float32) for k in (1, 3, 1, 1))]
    check(c.mulan_sample(*context, parameters, rays, at(offsets), *(at(x) for x in samples)))
    assert (samples[0] <= count).all()
    capacity = max(scene.steps // 2, 1)
    t, dt = np.zeros((n, capacity), np.float32), np.zeros((n, capacity), np.float32)
    check(c.mulan_march(scene, occupancy, rays, capacity, at(count), at(t), at(dt)))
    assert count.max(initial=0) <= capacity


def encode_points(
    library: NativeLibrary, workspace: int, parameters: NativeParameters, case: Case, points: np.ndarray
) -> None:
    c, n, field = library.functions, len(points), case.field
    density, back = np.zeros(n, np.float32), np.zeros_like(points)
    check(c.mulan_density(workspace, field, parameters, n, at(points), at(density)))
    encoded = np.zeros((n, 2 * field.levels), np.float32)
    check(c.mulan_encode(field, at(case.table), n, at(points), at(encoded)))
    gradient = np.zeros_like(case.table)
    arrays = at(points), at(encoded), at(gradient), at(back)
    check(c.mulan_encode_backward(field, at(case.table), n, *arrays))
    harmonics = np.zeros((n, field.harmonics_degree**2), np.float32)
    check(c.mulan_harmonics(field.harmonics_degree, n, at(points), at(harmonics)))
    arrays = at(points), at(harmonics), at(back)
    check(c.mulan_harmonics_backward(field.harmonics_degree, n, *arrays))


def gather(library: NativeLibrary, rng: np.random.Generator, n: int) -> None:
    """Rays of pixels of photographs of one camera or several; then a pixel, image and shift out of range."""
    pixels, images = int(rng.integers(1, 400)), int(rng.integers(1, 5))
    image = np.sort(rng.integers(0, images, pixels)).astype(np.int32)
    # the images share the camera of as many pixels as the largest has, or each has its own
    starts = np.searchsorted(image, np.arange(images))
    shared = rng.random() < 0.5
    rows = int(np.bincount(image).max()) if shared else pixels
    shift = -starts if shared else np.zeros(images, np.int64)
    shift = np.ascontiguousarray(shift, np.int64)
    directions, T = rng.normal(size=(rows, 3)).astype(np.float32), rng.random((images, 4, 4), np.float32)
    directions[rng.random(rows) < 0.1] = rng.choice(np.array([0, np.nan, np.inf, 1e30], np.float32))
    colours, opacity = rng.integers(0, 256, (pixels, 3), np.uint8), rng.integers(0, 256, pixels, np.uint8)
    weights, cut_out = rng.random(pixels, np.float32), rng.random() < 0.5
    drawn = rng.integers(0, pixels, n)
    vectors, image_of = [np.zeros((n, 3), np.float32) for _ in range(3)], np.zeros(n, np.int64)
    scalars = [np.zeros(n, np.float32) for _ in range(2)]
    table = NativePixels(pixels, images, rows, at(colours), at(opacity) if cut_out else None, at(weights))
    table.image, table.camera_directions = at(image), at(directions)
    table.direction_shift, table.T_world_camera = at(shift), at(T)
    out = NativeRayBatch(*(at(x) for x in vectors), at(scalars[0]), at(image_of), at(scalars[1]))
    gather_rays = library.functions.mulan_gather_rays
    check(gather_rays(table, n, at(drawn), out))
    assert (image_of == image[drawn]).all()
    if n == 0:
        return
    for array, entry, wrong in (
        (drawn, 0, pixels),
        (image, drawn[-1], images),
        (shift, image[drawn[-1]], rows),
    ):
        before, far = array[entry], array.dtype.type(rng.choice([-1, 1]) * 2**30)
        for array[entry] in (wrong, far):
            assert gather_rays(table, n, at(drawn), out) != 0
        array[entry] = before


def main() -> None:
    library = NativeLibrary(Path(sys.argv[1]))
    cases = int(sys.argv[2]) if len(sys.argv) > 2 else 40
    # one workspace throughout: what a call leaves in it must not harm one of other sizes
    workspace = library.functions.mulan_workspace_create(3)
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        run(library, workspace, rng, odd_case(rng, library))
    library.functions.mulan_workspace_destroy(workspace)
    print("clean")


if __name__ == "__main__":
    main()
