"""Finding and loading libmulan_native, the C++ build of the radiance field."""

import ctypes
import sys
from ctypes import POINTER, c_char_p, c_float, c_int32, c_int64, c_uint64, c_void_p
from functools import cache
from pathlib import Path

import mulan.radiance
from mulan.radiance.kernels.library_file import check_not_cut_off
from mulan.radiance.kernels.native_structures import (
    ABI_VERSION,
    NativeAdam,
    NativeField,
    NativeGradients,
    NativeObjective,
    NativeOccupancy,
    NativeParameters,
    NativePixels,
    NativePoses,
    NativeRayBatch,
    NativeRays,
    NativeRendering,
    NativeScene,
    NativeStepReport,
)

FILE_NAME = {"darwin": "libmulan_native.dylib", "win32": "mulan_native.dll"}.get(
    sys.platform, "libmulan_native.so"
)

_FIELD, _SCENE, _OCCUPANCY = POINTER(NativeField), POINTER(NativeScene), POINTER(NativeOccupancy)
_PARAMETERS, _RAYS, _OBJECTIVE = POINTER(NativeParameters), POINTER(NativeRays), POINTER(NativeObjective)
_RENDERING, _REPORT = POINTER(NativeRendering), POINTER(NativeStepReport)
_AT = c_void_p  # address of an array
_WORKSPACE = c_void_p

# Argument types of every function that returns a MulanStatus, in the order of mulan_native.h.
_SIGNATURES = {
    "mulan_use_instruction_set": [c_char_p],
    "mulan_train_step": [
        *(_WORKSPACE, _FIELD, _SCENE, _OCCUPANCY, _AT, _AT, _RAYS, _OBJECTIVE, POINTER(NativeAdam)),
        *(_AT, _AT, POINTER(NativePoses), _REPORT),
    ],
    "mulan_gradients": [
        *(_WORKSPACE, _FIELD, _SCENE, _OCCUPANCY, _PARAMETERS, _RAYS, _OBJECTIVE, POINTER(NativeGradients)),
        *(_RENDERING, _REPORT),
    ],
    "mulan_render": [_WORKSPACE, _FIELD, _SCENE, _OCCUPANCY, _PARAMETERS, _RAYS, _RENDERING],
    "mulan_sample": [_WORKSPACE, _FIELD, _SCENE, _OCCUPANCY, _PARAMETERS, _RAYS, *[_AT] * 6],
    "mulan_density": [_WORKSPACE, _FIELD, _PARAMETERS, c_int64, _AT, _AT],
    "mulan_occupancy_refresh": [
        *(_WORKSPACE, _FIELD, _SCENE, _PARAMETERS, c_float, c_int32, c_int32, c_int32, c_uint64, _AT, _AT),
    ],
    "mulan_occupancy_pack": [c_int32, c_int32, _AT, _AT, _AT, _AT],
    "mulan_pose_gradients": [c_int64, _AT, _AT, _AT, POINTER(NativePoses)],
    "mulan_gather_rays": [POINTER(NativePixels), c_int64, _AT, POINTER(NativeRayBatch)],
    "mulan_encode": [_FIELD, _AT, c_int64, _AT, _AT],
    "mulan_encode_backward": [_FIELD, _AT, c_int64, _AT, _AT, _AT, _AT],
    "mulan_harmonics": [c_int32, c_int64, _AT, _AT],
    "mulan_harmonics_backward": [c_int32, c_int64, _AT, _AT, _AT],
    "mulan_march": [_SCENE, _OCCUPANCY, _RAYS, c_int32, _AT, _AT, _AT],
    "mulan_networks": [_WORKSPACE, _FIELD, _AT, c_int64, *[_AT] * 5],
    "mulan_networks_backward": [_WORKSPACE, _FIELD, _AT, c_int64, *[_AT] * 8],
    "mulan_composite": [_SCENE, c_int64, *[_AT] * 7, _RENDERING],
    "mulan_composite_backward": [_SCENE, c_int64, *[_AT] * 7],
    "mulan_adam": [c_int64, *[_AT] * 4, *[c_float] * 4, c_int64, c_int32],
}


class NativeLibrary:
    """The loaded library.

    Attributes:
        functions: The C functions of ``mulan_native.h``; arrays are passed as addresses.
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        """Load a library file.

        Raises:
            OSError: The file is missing, is no library, or is of another version.
        """
        check_not_cut_off(path)
        self.path = path
        self.functions = ctypes.CDLL(str(path))
        f = self.functions
        if not hasattr(f, "mulan_abi_version") or f.mulan_abi_version() != ABI_VERSION:
            raise OSError(f"{path} is not version {ABI_VERSION} of libmulan_native")
        for name, arguments in _SIGNATURES.items():
            if not hasattr(f, name):
                raise OSError(f"{path} lacks {name}")
            function = getattr(f, name)
            function.argtypes, function.restype = arguments, c_int32
        f.mulan_instruction_set.argtypes, f.mulan_instruction_set.restype = [], c_char_p
        f.mulan_workspace_create.argtypes, f.mulan_workspace_create.restype = [c_int32], _WORKSPACE
        f.mulan_workspace_destroy.argtypes, f.mulan_workspace_destroy.restype = [_WORKSPACE], None
        f.mulan_workspace_bytes.argtypes, f.mulan_workspace_bytes.restype = [_WORKSPACE], c_int64
        f.mulan_network_parameters.argtypes, f.mulan_network_parameters.restype = [_FIELD], c_int64

    @property
    def instruction_set(self) -> str:
        """Which of its builds runs: x86-64-v4, x86-64-v3, x86-64 or generic."""
        return self.functions.mulan_instruction_set().decode()

    def use_instruction_set(self, name: str) -> bool:
        """Switch to another build (all engines); whether this processor and library have it."""
        return self.functions.mulan_use_instruction_set(name.encode()) == 0


def check(status: int) -> None:
    """Turn a MulanStatus into an exception.

    Raises:
        ValueError: An argument was refused.
        MemoryError: Scratch memory ran out.
    """
    if status == 1:
        raise ValueError(
            "libmulan_native refused an argument: a size is out of bounds, a number is not finite"
            " or an array is missing"
        )
    if status == 2:
        raise MemoryError("libmulan_native could not allocate scratch memory")


@cache
def find_native_library() -> tuple[NativeLibrary | None, str]:
    """The newest library beside the package or in its build folder that loads; or None, and why."""
    # an editable install has its compiled files in another folder of the same package
    folders = [Path(folder) / "native" for folder in mulan.radiance.__path__]
    candidates = [folder / FILE_NAME for native in folders for folder in (native, native / "build")]
    present = [path for path in candidates if path.exists()]
    if not present:
        return None, f"no {FILE_NAME} in " + " or ".join(str(path.parent) for path in candidates)
    refused = []
    for path in sorted(present, key=lambda path: path.stat().st_mtime, reverse=True):
        try:
            library = NativeLibrary(path)
        except OSError as error:
            refused.append(str(error))
        else:
            return library, f"{path} ({library.instruction_set})"
    return None, "; ".join(refused)
