"""Chooses the implementation of the radiance field for this machine."""

import logging
from enum import StrEnum

import torch

from mulan.errors import InputError
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.gpu.find_gpu import find_gpu
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine

_log = logging.getLogger(__name__)

WITHOUT_NATIVE = (
    "the slower torch engine runs; install a C++ compiler (Debian: apt-get install g++, macOS: "
    "xcode-select --install) and run 'pip install --force-reinstall --no-deps' on mulan again, "
    "or install a released wheel, which needs none"
)


class Device(StrEnum):
    """Where to compute."""

    AUTO = "auto"
    CPU = "cpu"
    GPU = "gpu"

    def resolve(self) -> torch.device:
        """The device meant; AUTO is the GPU where there is one that can be used.

        Raises:
            InputError: A GPU was asked for and there is none.
        """
        gpu, reason = find_gpu()
        if self is Device.GPU and gpu is None:
            raise InputError("--device", "gpu", f"is not there: {reason}", "leave the option out")
        return torch.device("cpu") if gpu is None or self is Device.CPU else gpu


def new_engine(
    field: FieldConfig,
    march: MarchConfig,
    space: SceneSpace,
    white_background: bool,
    seed: int,
    optimiser: OptimiserConfig | None = None,
    device: torch.device | None = None,
) -> RadianceEngine:
    """An untrained field on the best backend there is; the first log line says what was lost without it.

    Args:
        field: Sizes.
        march: Sampling.
        space: Where the field lives.
        white_background: What rays that hit nothing see: white, or black.
        seed: Of the initial parameters and of the sampling.
        optimiser: Learning rates and loss.
        device: Where to compute; the GPU if not given and there is one.
    """
    device = device or Device.AUTO.resolve()
    if device.type == "cuda":
        # Triton is not installed everywhere
        from mulan.radiance.gpu.triton_engine import TritonEngine

        return TritonEngine(field, march, space, white_background, seed, device, optimiser)
    library, reason = find_native_library()
    if library is None:
        _log.warning("no native engine (%s): %s", reason, WITHOUT_NATIVE)
        return TorchEngine(field, march, space, white_background, seed, optimiser)
    return NativeEngine(field, march, space, white_background, seed, optimiser)
