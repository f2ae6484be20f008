"""From tensors and configs to what libmulan_native reads."""

import math

import torch
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.march import FAR_RADII, NEAR_RADII, step_count
from mulan.radiance.kernels.native_structures import MAX_LEVELS, NativeField, NativeScene
from mulan.radiance.networks import LOG_DENSITY_MAX, LOG_DENSITY_OFFSET, VARIANCE_FLOOR
from mulan.radiance.space import SceneSpace


def address(array: Tensor, shape: tuple[int, ...] | None = None, dtype: torch.dtype = torch.float32) -> int:
    """Where an array lies; the caller keeps it alive.

    Raises:
        ValueError: It is not contiguous, not in main memory, or of another shape or type. An array of
            integers is checked for its type only together with a shape.
    """
    if not array.is_contiguous() or array.device.type != "cpu":
        raise ValueError("the native engine needs contiguous tensors in main memory")
    if shape is not None and tuple(array.shape) != shape:
        raise ValueError(f"expected an array of shape {shape}, not {tuple(array.shape)}")
    if (shape is not None or array.is_floating_point()) and array.dtype != dtype:
        raise ValueError(f"expected {dtype}, not {array.dtype}")
    return array.data_ptr()


def native_field(config: FieldConfig) -> NativeField:
    """Sizes of a field.

    Raises:
        ValueError: Not two features an entry, or too many levels.
    """
    if config.features != 2:
        raise ValueError(f"the native engine has 2 features an entry, not {config.features}")
    if config.levels > MAX_LEVELS:
        raise ValueError(f"the native engine has at most {MAX_LEVELS} levels, not {config.levels}")
    field = NativeField(
        levels=config.levels,
        log2_table_size=config.log2_table_size,
        width=config.width,
        geometry_features=config.geometry_features,
        harmonics_degree=config.harmonics_degree,
        log_density_offset=LOG_DENSITY_OFFSET,
        log_density_max=LOG_DENSITY_MAX,
        variance_floor=VARIANCE_FLOOR,
    )
    for level in range(config.levels):
        field.resolution[level] = config.level_resolution(level)
        field.dense[level] = config.level_is_dense(level)
        field.level_weight[level] = 1.0
    return field


def native_scene(march: MarchConfig, space: SceneSpace, white_background: bool) -> NativeScene:
    """Sampling and space of a scene.

    Raises:
        ValueError: The occupancy grid's side is not a multiple of 4.
    """
    side = march.occupancy_resolution
    if side % 4:
        raise ValueError(f"the native engine's occupancy grid has a side that is a multiple of 4, not {side}")
    scene = NativeScene(
        radius_m=space.radius_m,
        near_radii=NEAR_RADII,
        growth=math.asinh(FAR_RADII - NEAR_RADII),
        min_transmittance=march.min_transmittance,
        unbounded=space.unbounded,
        steps=step_count(march),
        occupancy_resolution=march.occupancy_resolution,
        cascades=march.cascades,
    )
    scene.centre_m[:] = space.centre_m
    scene.background[:] = [1.0 if white_background else 0.0] * 3
    return scene
