"""The process that runs Sionna RT, apart from ours: it needs another variant of Mitsuba, and LLVM.

An LLVM too old for Dr.Jit ends the process that loads it; it must not be the user's.
"""

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.simulation.propagation import SPEED_OF_LIGHT_M_PER_S
from mulan.simulation.radio_surfaces import RadioSurface
from mulan.simulation.sionna_config import SionnaConfig

# Of ours at once; for Sionna they transmit. Each transmitter has its own table of the paths it found, and
# paths that share a place in it are lost: half of them where one transmitter serves 128 receivers.
_RECEIVERS = 16
_MOST_PATHS = 20_000  # of one solve
_VARIANT = "llvm_ad_mono_polarized"


@dataclass(frozen=True)
class TracedPaths:
    """Paths from one transmitter to n receivers, or to one; the rows of fewer than p end in gains of zero.

    Attributes:
        gain: Complex amplitude times distance: 1 for the direct path, without the phase of the distance.
        distance_m: Length of each path.
        toward_transmitter: Unit vector along which each path arrives, looked at from its receiver.
        toward_receiver: Unit vector along which it departs, looked at from the transmitter.
    """

    gain: Complex[NDArray, "*n p"]
    distance_m: Float[NDArray, "*n p"]
    toward_transmitter: Float[NDArray, "*n p 3"]
    toward_receiver: Float[NDArray, "*n p 3"]


@dataclass(frozen=True)
class TraceRequest:
    """One transmitter and the receivers to trace to, at one carrier frequency."""

    transmitter_world_m: Float[NDArray, "3"]
    receivers_world_m: Float[NDArray, "n 3"]
    frequency_hz: float


def serve(pipe: Connection, surfaces: Sequence[RadioSurface], config: SionnaConfig) -> None:
    """Answer trace requests until the pipe closes: lists of traced paths, or a sentence on what failed."""
    try:
        tracer = Tracer(surfaces, config)
    except Exception as error:  # whatever it is, the other side must hear of it
        pipe.send(" ".join(f"{type(error).__name__}: {error}".split()))
        return
    pipe.send("")
    while True:
        try:
            request = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(tracer.trace(request))
        except Exception as error:
            pipe.send(" ".join(f"{type(error).__name__}: {error}".split()))


class Tracer:
    """A scene of Sionna RT with one transmitter; isotropic, vertically polarized antennas."""

    def __init__(self, surfaces: Sequence[RadioSurface], config: SionnaConfig) -> None:
        """Make the scene."""
        if llvm := newest_llvm():
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(llvm))
        import drjit as dr
        import mitsuba as mi

        if (threads := os.environ.get("OMP_NUM_THREADS", "")).isdigit():
            dr.set_thread_count(max(int(threads), 1))
        mi.set_variant(_VARIANT)
        rt: Any = importlib.import_module("sionna.rt")  # the extra is not there for every reader of this code

        self._config = config
        self._solve = rt.PathSolver(deterministic=True)
        self._scene = rt.Scene()
        makes = {surface.material: None for surface in surfaces}
        materials = {
            make: rt.ITURadioMaterial(make.value, make.value, thickness=make.thickness_m) for make in makes
        }
        things = []
        for surface in surfaces:
            mesh = _mesh(mi, surface, materials[surface.material])
            material = materials[surface.material]
            things.append(rt.SceneObject(mi_mesh=mesh, name=surface.name, radio_material=material))
        if things:
            self._scene.edit(add=things)
        antenna = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
        self._scene.tx_array = self._scene.rx_array = antenna
        self._one = rt.Receiver("one", position=[0.0, 0.0, 0.0])
        self._many = [rt.Transmitter(f"many {k}", position=[1.0, 0.0, 0.0]) for k in range(_RECEIVERS)]
        self._scene.add([self._one, *self._many])

    def trace(self, request: TraceRequest) -> list[TracedPaths]:
        """Paths to all receivers, some receivers a time."""
        self._scene.frequency = request.frequency_hz
        self._one.position = request.transmitter_world_m.tolist()
        n = len(request.receivers_world_m)
        begins = range(0, n, _RECEIVERS)
        return [self._trace(request.receivers_world_m[k : k + _RECEIVERS], request) for k in begins]

    def _trace(self, receivers_world_m: Float[NDArray, "n 3"], request: TraceRequest) -> TracedPaths:
        n, config = len(receivers_world_m), self._config
        for k, antenna in enumerate(self._many):
            antenna.position = receivers_world_m[min(k, n - 1)].tolist()
        paths = self._solve(
            self._scene,
            max_depth=config.max_depth,
            max_num_paths_per_src=_MOST_PATHS,
            samples_per_src=config.rays,
            refraction=config.refraction,
            diffraction=config.diffraction,
        )
        valid = np.array(paths.valid)[0, :n].astype(bool)
        real, imaginary = (np.array(part)[0, 0, :n, 0] for part in paths.a)
        distance_m = np.where(valid, np.array(paths.tau, dtype=float)[0, :n] * SPEED_OF_LIGHT_M_PER_S, 1.0)
        # Sionna's amplitudes are those of isotropic antennas: λ / (4π d) in free space
        per_metre = SPEED_OF_LIGHT_M_PER_S / request.frequency_hz / (4 * np.pi)
        gain = np.where(valid, real + 1j * imaginary, 0.0) * distance_m / per_metre
        arrival = _unit(np.array(paths.theta_t)[0, :n], np.array(paths.phi_t)[0, :n])
        departure = _unit(np.array(paths.theta_r)[0, :n], np.array(paths.phi_r)[0, :n])
        return TracedPaths(gain, distance_m, arrival, departure)


def newest_llvm() -> Path | None:
    """The newest LLVM of Debian's kind (16 and later) on this machine."""
    found: dict[tuple[int, ...], Path] = {}
    for folder in (*Path("/usr/lib").glob("*-linux-gnu"), *Path("/usr/lib").glob("llvm-*/lib")):
        for path in folder.glob("libLLVM.so.*"):
            numbers = path.name.removeprefix("libLLVM.so.").split(".")
            if all(number.isdigit() for number in numbers):
                found[tuple(map(int, numbers))] = path
    return found[max(found)] if found else None


def _mesh(mi: Any, surface: RadioSurface, material: Any) -> Any:
    properties = mi.Properties()
    properties["mesh_bsdf"] = material
    mesh = mi.Mesh(surface.name, len(surface.vertices_m), len(surface.triangles), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices_m.ravel().astype(np.float32)
    parameters["faces"] = surface.triangles.ravel().astype(np.uint32)
    parameters.update()
    return mesh


def _unit(zenith_rad: Float[NDArray, "n p"], azimuth_rad: Float[NDArray, "n p"]) -> Float[NDArray, "n p 3"]:
    zenith, azimuth = zenith_rad.astype(float), azimuth_rad.astype(float)
    level = np.sin(zenith)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.cos(zenith)], -1)
