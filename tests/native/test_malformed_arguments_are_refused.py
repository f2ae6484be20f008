"""The C interface itself, as a program in another language would misuse it."""

import ctypes
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest

from mulan.radiance.kernels.native_library import NativeLibrary
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

REFUSED = 1
OPTIONAL = {  # arguments that may be null, by position
    "mulan_train_step": {9, 10, 11},  # 9 and 10 but only both
    "mulan_gradients": {8},
    "mulan_march": {4, 5},  # but only both
    "mulan_encode_backward": {5, 6},
}


Structure = TypeVar("Structure", bound=ctypes.Structure)


def copy(structure: Structure) -> Structure:
    return type(structure).from_buffer_copy(structure)


class Calls:
    """One well-formed call of every function that takes arrays."""

    def __init__(self, library: NativeLibrary) -> None:
        rng, self.n = np.random.default_rng(3), 9
        self.library, self.case = library, self._plain_case(rng, library)
        self.workspace = library.functions.mulan_workspace_create(2)
        o, d = odd_rays(rng, self.case.scene, self.n)
        self.buffers: list[np.ndarray] = [o, d]
        floats, a = self._floats, self._floats(500_000)
        self.rays = NativeRays(self.n, at(o), at(d), 1, 1)
        self.objective = NativeObjective(a, a, None, a, 0.1, 1.0)
        self.objective.rays_a_pixel = 1
        self.adam = NativeAdam(*(floats(200_000) for _ in range(4)), 1e-2, 1e-2, 0.9, 0.99, 1e-15, 1, 1)
        self.gradients = NativeGradients(*(floats(200_000) for _ in range(4)))
        self.rendering = NativeRendering(*(floats(1000) for _ in range(4)))
        self.parameters = NativeParameters(at(self.case.table), at(self.case.networks))
        self.poses = NativePoses(self.n, self._integers(self.n), a, floats(100))
        pixels = NativePixels(self.n, 1, self.n, a, a, a, a, a, a, a)
        self.pixels, self.ray_batch = pixels, NativeRayBatch(*(floats(100) for _ in range(6)))
        self.arguments = self._arguments(floats)

    @staticmethod
    def _plain_case(rng: np.random.Generator, library: NativeLibrary) -> Case:
        while True:
            case = odd_case(rng, library)
            if case.scene.steps < 100 and case.scene.occupancy_resolution == 8:
                return case

    def _floats(self, count: int) -> int:
        self.buffers.append(np.zeros(count, np.float32))
        return at(self.buffers[-1])

    def _integers(self, count: int) -> int:
        self.buffers.append(np.arange(count, dtype=np.int64))
        return at(self.buffers[-1])

    def _arguments(self, f: Callable[[int], int]) -> dict[str, list]:
        n, case, w = self.n, self.case, self.workspace
        field, scene, p, rays = case.field, case.scene, self.parameters, self.rays
        a, offsets = f(50_000), self._integers(n + 1)
        context = [w, field, scene, case.occupancy]
        table, networks, occupied = at(case.table), at(case.networks), at(case.occupied)
        report = NativeStepReport()
        return {
            "mulan_train_step": [
                *(*context, table, networks, rays, self.objective, self.adam, a, a, self.poses, report)
            ],
            "mulan_gradients": [*(*context, p, rays, self.objective, self.gradients, self.rendering, report)],
            "mulan_render": [*context, p, rays, self.rendering],
            "mulan_sample": [*context, p, rays, offsets, *(f(1000) for _ in range(5))],
            "mulan_density": [w, field, p, n, a, f(100)],
            "mulan_occupancy_refresh": [w, field, scene, p, 0.9, 1, 1, 0, 5, occupied, f(1000)],
            "mulan_occupancy_pack": [8, 1, occupied, f(100), f(3), f(3)],
            "mulan_pose_gradients": [n, a, a, a, self.poses],
            "mulan_gather_rays": [self.pixels, n, self._integers(n), self.ray_batch],
            "mulan_encode": [field, table, n, a, f(1000)],
            "mulan_encode_backward": [field, table, n, a, a, f(200_000), f(1000)],
            "mulan_harmonics": [3, n, a, f(1000)],
            "mulan_harmonics_backward": [3, n, a, a, f(1000)],
            "mulan_march": [scene, case.occupancy, rays, 10, f(100), f(1000), f(1000)],
            "mulan_networks": [w, field, networks, n, a, a, *(f(1000) for _ in range(3))],
            "mulan_networks_backward": [
                *(w, field, networks, n, *[a] * 5),
                *(f(100_000), f(1000), f(1000)),
            ],
            "mulan_composite": [scene, n, offsets, *[a] * 5, f(100), self.rendering],
            "mulan_composite_backward": [scene, n, offsets, *[a] * 4, f(100), f(100)],
            "mulan_adam": [n, f(10), f(10), f(10), a, *[0.1] * 4, 1, 0],
        }

    def status(self, name: str, arguments: list) -> int:
        return getattr(self.library.functions, name)(*arguments)


@pytest.fixture
def calls(library: NativeLibrary):
    calls = Calls(library)
    yield calls
    library.functions.mulan_workspace_destroy(calls.workspace)


def test_well_formed_calls_are_not(calls: Calls) -> None:
    for name, arguments in calls.arguments.items():
        assert calls.status(name, arguments) == 0, name


def test_a_missing_array_or_structure(calls: Calls) -> None:
    for name, arguments in calls.arguments.items():
        types = getattr(calls.library.functions, name).argtypes
        for i, kind in enumerate(types):
            is_pointer = kind is ctypes.c_void_p or hasattr(kind, "contents")
            if is_pointer and i not in OPTIONAL.get(name, ()):
                without = [*arguments[:i], None, *arguments[i + 1 :]]
                assert calls.status(name, without) == REFUSED, f"{name}, argument {i}"
    for name, i in (("mulan_train_step", 9), ("mulan_train_step", 10), ("mulan_march", 5)):
        arguments = calls.arguments[name]
        assert calls.status(name, [*arguments[:i], None, *arguments[i + 1 :]]) == REFUSED


def test_a_missing_array_within_a_structure(calls: Calls) -> None:
    for structure, names in (
        (calls.rays, ("mulan_render", "mulan_train_step", "mulan_march")),
        (calls.objective, ("mulan_train_step", "mulan_gradients")),
        (calls.adam, ("mulan_train_step",)),
        (calls.rendering, ("mulan_render", "mulan_gradients", "mulan_composite")),
        (calls.parameters, ("mulan_render", "mulan_density", "mulan_occupancy_refresh")),
        (calls.gradients, ("mulan_gradients",)),
        (calls.poses, ("mulan_train_step", "mulan_pose_gradients")),
        (calls.pixels, ("mulan_gather_rays",)),
        (calls.ray_batch, ("mulan_gather_rays",)),
        (calls.case.occupancy, ("mulan_render", "mulan_march")),
    ):
        for field, kind, *_ in structure._fields_:
            if kind is not ctypes.c_void_p or field in ("colour_gradient", "backgrounds"):
                continue
            if structure is calls.pixels and field == "opacity":
                continue
            without = copy(structure)
            setattr(without, field, None)
            for name in names:
                arguments = [without if x is structure else x for x in calls.arguments[name]]
                assert calls.status(name, arguments) == REFUSED, f"{name}, {field}"


@pytest.mark.parametrize(
    ("member", "value"),
    [
        *(("levels", 0), ("levels", 33), ("log2_table_size", 3), ("log2_table_size", 29)),
        *(("width", 0), ("width", -1), ("width", 1025), ("geometry_features", 0)),
        *(("harmonics_degree", 0), ("harmonics_degree", 5), ("log_density_offset", np.nan)),
        *(("radius_m", 0.0), ("radius_m", np.nan), ("radius_m", np.inf), ("steps", 0), ("steps", 65537)),
        *(("occupancy_resolution", 6), ("occupancy_resolution", 516), ("growth", np.inf)),
        *(("min_transmittance", np.nan), ("count", -1), ("step", 0), ("beta1", np.nan)),
        *(("huber_delta", np.nan), ("variance_weight", np.inf)),
        *(
            ("distortion_weight", np.nan),
            ("entropy_weight", np.inf),
            ("rays_a_pixel", 0),
            ("rays_a_pixel", 17),
            ("cascades", 0),
            ("cascades", 9),
        ),
    ],
)
def test_a_number_out_of_bounds(calls: Calls, member: str, value: float) -> None:
    wrong, found = [], False
    for argument in calls.arguments["mulan_train_step"]:
        if isinstance(argument, ctypes.Structure) and hasattr(argument, member):
            argument, found = copy(argument), True
            setattr(argument, member, value)
        wrong.append(argument)
    assert found
    assert calls.status("mulan_train_step", wrong) == REFUSED


def test_a_dense_level_larger_than_its_table(calls: Calls) -> None:
    field = copy(calls.case.field)
    field.resolution[0], field.dense[0] = 1000, 1
    assert calls.status("mulan_encode", [field, *calls.arguments["mulan_encode"][1:]]) == REFUSED


def test_samples_that_run_backwards(calls: Calls) -> None:
    offsets = np.arange(calls.n + 1, dtype=np.int64)
    offsets[4] = 1
    for name, i in (("mulan_composite", 2), ("mulan_composite_backward", 2), ("mulan_sample", 6)):
        arguments = calls.arguments[name]
        assert calls.status(name, [*arguments[:i], at(offsets), *arguments[i + 1 :]]) == REFUSED


def test_an_image_that_does_not_exist(calls: Calls) -> None:
    fewer = copy(calls.poses)
    fewer.images -= 1
    for name in ("mulan_pose_gradients", "mulan_train_step"):
        arguments = [fewer if x is calls.poses else x for x in calls.arguments[name]]
        assert calls.status(name, arguments) == REFUSED


def test_a_pixel_image_or_direction_that_does_not_exist(calls: Calls) -> None:
    pixels, n, drawn, batch = calls.arguments["mulan_gather_rays"]
    for member, value in (("pixels", calls.n - 1), ("images", 0), ("directions", calls.n - 1), ("pixels", 0)):
        fewer = copy(pixels)
        setattr(fewer, member, value)
        assert calls.status("mulan_gather_rays", [fewer, n, drawn, batch]) == REFUSED, member


@pytest.mark.parametrize("threads", [-1, 1025, 2**31 - 1])
def test_more_threads_than_a_machine_has(library: NativeLibrary, threads: int) -> None:
    assert not library.functions.mulan_workspace_create(threads)


def test_nothing_at_all(library: NativeLibrary) -> None:
    c = library.functions
    assert c.mulan_workspace_bytes(None) == 0
    assert c.mulan_network_parameters(None) == 0
    assert c.mulan_use_instruction_set(None) == REFUSED
    assert c.mulan_use_instruction_set(b"abacus") == REFUSED
    c.mulan_workspace_destroy(None)
