"""The structures of ``native/include/mulan_native.h``, field by field, for ctypes. Pointers are addresses."""

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_uint64, c_void_p

ABI_VERSION = 5
MAX_LEVELS = 32


class NativeField(ctypes.Structure):
    """MulanField: sizes of the field."""

    _fields_ = (
        ("levels", c_int32),
        ("log2_table_size", c_int32),
        ("width", c_int32),
        ("geometry_features", c_int32),
        ("harmonics_degree", c_int32),
        ("resolution", c_int32 * MAX_LEVELS),
        ("dense", c_int32 * MAX_LEVELS),
        ("level_weight", c_float * MAX_LEVELS),
        ("log_density_offset", c_float),
        ("log_density_max", c_float),
        ("variance_floor", c_float),
    )


class NativeScene(ctypes.Structure):
    """MulanScene: where the field lives and how rays are sampled."""

    _fields_ = (
        ("centre_m", c_float * 3),
        ("radius_m", c_float),
        ("near_radii", c_float),
        ("growth", c_float),
        ("background", c_float * 3),
        ("min_transmittance", c_float),
        ("unbounded", c_int32),
        ("steps", c_int32),
        ("occupancy_resolution", c_int32),
        ("cascades", c_int32),
    )


class NativeParameters(ctypes.Structure):
    """MulanParameters."""

    _fields_ = (("table", c_void_p), ("networks", c_void_p))


class NativeOccupancy(ctypes.Structure):
    """MulanOccupancy: one bit a cell, and the bounds of the occupied cells."""

    _fields_ = (
        ("words", c_void_p),
        ("lower", c_float * 3),
        ("upper", c_float * 3),
        ("least_opacity", c_float),
    )


class NativeRays(ctypes.Structure):
    """MulanRays."""

    _fields_ = (
        ("count", c_int64),
        ("origins", c_void_p),
        ("directions", c_void_p),
        ("seed", c_uint64),
        ("jitter", c_int32),
        ("first", c_int64),
    )


class NativeObjective(ctypes.Structure):
    """MulanObjective: what a step learns from."""

    _fields_ = (
        ("colours", c_void_p),
        ("weights", c_void_p),
        ("colour_gradient", c_void_p),
        ("backgrounds", c_void_p),
        ("huber_delta", c_float),
        ("variance_weight", c_float),
        ("likelihood", c_int32),
        ("distortion_weight", c_float),
        ("entropy_weight", c_float),
        ("rays_a_pixel", c_int32),
    )


class NativePoses(ctypes.Structure):
    """MulanPoses: where the gradient to camera poses goes."""

    _fields_ = (
        ("images", c_int64),
        ("image_index", c_void_p),
        ("R_world_camera", c_void_p),
        ("gradient", c_void_p),
    )


class NativeGradients(ctypes.Structure):
    """MulanGradients: where gradients go."""

    _fields_ = (
        ("table", c_void_p),
        ("networks", c_void_p),
        ("origins", c_void_p),
        ("directions", c_void_p),
        ("fresh", c_int32),
    )


class NativeAdam(ctypes.Structure):
    """MulanAdam: moments and rates."""

    _fields_ = (
        ("table_mean", c_void_p),
        ("table_square", c_void_p),
        ("networks_mean", c_void_p),
        ("networks_square", c_void_p),
        ("table_rate", c_float),
        ("networks_rate", c_float),
        ("beta1", c_float),
        ("beta2", c_float),
        ("epsilon", c_float),
        ("step", c_int64),
        ("skip_untouched", c_int32),
    )


class NativeStepReport(ctypes.Structure):
    """MulanStepReport."""

    _fields_ = (
        ("loss", c_double),
        ("squared_error", c_double),
        ("samples", c_int64),
        ("kept", c_int64),
        ("rays", c_int64),
    )


class NativeRendering(ctypes.Structure):
    """MulanRendering: where renderings go."""

    _fields_ = (
        ("colour", c_void_p),
        ("depth_m", c_void_p),
        ("opacity", c_void_p),
        ("variance", c_void_p),
    )


class NativePixels(ctypes.Structure):
    """MulanPixels: the pixels of all photographs."""

    _fields_ = (
        ("pixels", c_int64),
        ("images", c_int64),
        ("directions", c_int64),
        ("colours", c_void_p),
        ("opacity", c_void_p),
        ("weights", c_void_p),
        ("image", c_void_p),
        ("camera_directions", c_void_p),
        ("direction_shift", c_void_p),
        ("T_world_camera", c_void_p),
    )


class NativeRayBatch(ctypes.Structure):
    """MulanRayBatch: where drawn rays go."""

    _fields_ = (
        ("origins", c_void_p),
        ("directions", c_void_p),
        ("colours", c_void_p),
        ("weights", c_void_p),
        ("image_index", c_void_p),
        ("opacity", c_void_p),
    )
