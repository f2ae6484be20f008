"""Run by a test in its own process, with the sanitizers' run-time loaded: numpy and the C interface only."""

import ctypes
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import (
    NativeAdam,
    NativeField,
    NativeGradients,
    NativeObjective,
    NativeOccupancy,
    NativeParameters,
    NativePoses,
    NativeRays,
    NativeRendering,
    NativeScene,
    NativeStepReport,
)


def at(x: NDArray) -> int:
    return x.ctypes.data


def odd_rays(rng: np.random.Generator, n: int) -> NDArray:
    """Ordinary rays among enormous, tiny, zero and axis-parallel ones."""
    rays = rng.normal(size=(n, 6)).astype(np.float32)
    odd = np.array(
        [0.0, -0.0, 1e-38, 1e38, -1e38, 1.0, -1.0, 1e-9, 3e9, np.finfo(np.float32).max], np.float32
    )
    strange = rng.random((n, 6)) < 0.3
    rays[strange] = rng.choice(odd, int(strange.sum()))
    return rays


def run(
    library: NativeLibrary,
    workspace: int,
    rng: np.random.Generator,
    unbounded: bool,
    steps: int,
    cascades: int,
) -> None:
    c = library.functions
    n, side, levels, log2 = 300, 16, 3, 6
    field = NativeField(
        levels, log2, 12, 5, 3, log_density_offset=-1.5, log_density_max=15, variance_floor=1e-4
    )
    field.resolution[:levels], field.dense[:levels] = [3, 9, 500], [1, 0, 0]
    field.level_weight[:levels] = [1.0] * levels
    scene = NativeScene(radius_m=1.0, near_radii=0.02, growth=4.8, min_transmittance=1e-4)
    scene.unbounded, scene.steps = unbounded, steps
    scene.occupancy_resolution, scene.cascades = side, cascades
    table = rng.normal(size=(levels, 2**log2, 2)).astype(np.float32)
    networks = rng.normal(size=c.mulan_network_parameters(field)).astype(np.float32)
    occupied = (rng.random(cascades * side**3) < 0.5).astype(np.uint8)
    words = np.zeros(cascades * (side // 4) ** 3, np.uint64)
    occupancy = NativeOccupancy(words=at(words))
    bounds = ctypes.addressof(occupancy.lower), ctypes.addressof(occupancy.upper)
    check(c.mulan_occupancy_pack(side, cascades, at(occupied), at(words), *bounds))

    rays6 = odd_rays(rng, n)
    origins, directions = np.ascontiguousarray(rays6[:, :3]), np.ascontiguousarray(rays6[:, 3:])
    rays = NativeRays(n, at(origins), at(directions), 7, 1)
    colours, weights = rng.random((n, 3), np.float32), rng.random(n, np.float32)
    out = [np.zeros((n, 3), np.float32), *np.zeros((3, n), np.float32)]
    rendering = NativeRendering(*(at(x) for x in out))
    parameters = NativeParameters(at(table), at(networks))
    context = (workspace, field, scene, occupancy)
    check(c.mulan_render(*context, parameters, rays, rendering))

    count = np.zeros(n, np.int32)
    check(c.mulan_march(scene, occupancy, rays, 0, at(count), None, None))
    assert count.max() <= scene.steps
    offsets = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    room = int(offsets[-1])
    samples = [np.zeros(n, np.int32), *(np.zeros((room, k), np.float32) for k in (1, 3, 1, 1))]
    check(c.mulan_sample(*context, parameters, rays, at(offsets), *(at(x) for x in samples)))

    gradients = [np.zeros_like(x) for x in (table, networks, origins, directions)]
    behind = rng.random((n, 3), np.float32)
    objective = NativeObjective(at(colours), at(weights), None, at(behind), 0.1, 1.0)
    objective.likelihood, objective.distortion_weight, objective.entropy_weight = cascades == 2, 0.1, 0.1
    index = rng.integers(0, 4, n)
    rotations, to_poses = rng.normal(size=(4, 3, 3)).astype(np.float32), np.zeros((4, 6), np.float32)
    poses = NativePoses(4, at(index), at(rotations), at(to_poses))
    report = NativeStepReport()
    wanted = NativeGradients(*(at(x) for x in gradients))
    check(c.mulan_gradients(*context, parameters, rays, objective, wanted, rendering, report))
    moments = [np.zeros_like(x) for x in (table, table, networks, networks)]
    adam = NativeAdam(*(at(x) for x in moments), 1e-2, 1e-2, 0.9, 0.99, 1e-15, 1, 1)
    for wanted_here in ((at(gradients[2]), at(gradients[3]), None), (None, None, poses), (None, None, None)):
        arrays = at(table), at(networks)
        check(c.mulan_train_step(*context, *arrays, rays, objective, adam, *wanted_here, report))

    opacity = np.zeros(cascades * side**3, np.float32)
    cells = at(occupied), at(opacity)
    check(c.mulan_occupancy_refresh(workspace, field, scene, parameters, 0.95, 3, 2, 1, 5, *cells))
    points = np.ascontiguousarray(odd_rays(rng, 777)[:, :3])
    points[:5] = np.nan
    density = np.zeros(777, np.float32)
    check(c.mulan_density(workspace, field, parameters, 777, at(points), at(density)))
    encoded = np.zeros((777, 2 * levels), np.float32)
    check(c.mulan_encode(field, at(table), 777, at(points), at(encoded)))
    back = np.zeros_like(points)
    arrays = at(points), at(encoded), at(gradients[0]), at(back)
    check(c.mulan_encode_backward(field, at(table), 777, *arrays))


def main() -> None:
    library = NativeLibrary(Path(sys.argv[1]))
    rng = np.random.default_rng(0)
    # one workspace throughout: what a call leaves in it must not harm one of other sizes
    workspace = library.functions.mulan_workspace_create(3)
    for steps, cascades in ((40, 1), (300, 2), (7, 3), (500, 1)):
        run(library, workspace, rng, unbounded=False, steps=steps, cascades=cascades)
        run(library, workspace, rng, unbounded=True, steps=steps, cascades=cascades)
    library.functions.mulan_workspace_destroy(workspace)
    print("clean")


if __name__ == "__main__":
    main()
