"""COLMAP's lens models and our pinhole camera."""

from dataclasses import dataclass

from mulan.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class LensModel:
    """One of COLMAP's models.

    Attributes:
        id: Number in binary files.
        name: Word in text files.
        parameters: Our names of its parameters in order; ``f`` is both focal lengths. Empty where the lens is
            no pinhole with OpenCV distortion.
        count: Numbers it has.
    """

    id: int
    name: str
    parameters: tuple[str, ...]
    count: int


def _pinhole(id: int, name: str, parameters: str) -> LensModel:
    words = tuple(parameters.split())
    return LensModel(id, name, words, len(words))


OPENCV = _pinhole(4, "OPENCV", "fx fy cx cy k1 k2 p1 p2")
FULL_OPENCV = _pinhole(6, "FULL_OPENCV", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6")
PINHOLE = _pinhole(1, "PINHOLE", "fx fy cx cy")
_MODELS = (
    _pinhole(0, "SIMPLE_PINHOLE", "f cx cy"),
    PINHOLE,
    _pinhole(2, "SIMPLE_RADIAL", "f cx cy k1"),
    _pinhole(3, "RADIAL", "f cx cy k1 k2"),
    OPENCV,
    FULL_OPENCV,
    # known only so that the sentence can name them
    LensModel(5, "OPENCV_FISHEYE", (), 8),
    LensModel(7, "FOV", (), 5),
    LensModel(8, "SIMPLE_RADIAL_FISHEYE", (), 4),
    LensModel(9, "RADIAL_FISHEYE", (), 5),
    LensModel(10, "THIN_PRISM_FISHEYE", (), 12),
    LensModel(11, "RAD_TAN_THIN_PRISM_FISHEYE", (), 16),
)
BY_ID = {model.id: model for model in _MODELS}
BY_NAME = {model.name: model for model in _MODELS}


def to_parameters(camera: PinholeCamera) -> tuple[LensModel, tuple[float, ...]]:
    """The simplest model that holds a camera exactly, and its parameters."""
    model = PINHOLE if not any(camera.distortion) else FULL_OPENCV if camera.k3 else OPENCV
    return model, tuple(float(getattr(camera, name, 0.0)) for name in model.parameters)


def to_camera(model: LensModel, width: int, height: int, parameters: tuple[float, ...]) -> PinholeCamera:
    """The camera of a model's parameters.

    Raises:
        ValueError: The model is no pinhole, or uses coefficients ours lacks, or the focal length or size is
            not positive.
    """
    if not model.parameters:
        raise ValueError(f"lens model {model.name} is not supported")
    values = dict(zip(model.parameters, parameters, strict=True))
    if any(values.pop(name, 0.0) for name in ("k4", "k5", "k6")):
        raise ValueError("k4, k5, k6 of FULL_OPENCV are not supported")
    focal = values.pop("f", 0.0)
    values.setdefault("fx", focal)
    values.setdefault("fy", focal)
    if min(values["fx"], values["fy"], width, height) <= 0:
        raise ValueError("the focal length or the image size is not positive")
    return PinholeCamera(width, height, **values)
