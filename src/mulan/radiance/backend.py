"""Chooses the implementation of the radiance field for this machine."""

import logging

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine

_log = logging.getLogger(__name__)

WITHOUT_NATIVE = (
    "the slower torch engine runs; install a C++ compiler "
    "(Debian: apt-get install g++) and run 'pip install --force-reinstall --no-deps' on mulan again"
)


def new_engine(
    field: FieldConfig,
    march: MarchConfig,
    space: SceneSpace,
    white_background: bool,
    seed: int,
    optimiser: OptimiserConfig | None = None,
) -> RadianceEngine:
    """An untrained field on the best backend there is; the first log line says what was lost without it."""
    library, reason = find_native_library()
    if library is None:
        _log.warning("no native engine (%s): %s", reason, WITHOUT_NATIVE)
        return TorchEngine(field, march, space, white_background, seed, optimiser)
    return NativeEngine(field, march, space, white_background, seed, optimiser)
