"""One photograph in memory, at the size the field learns from."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.pixels import load_resized
from mulan.mission.posed_images import PosedImage


@dataclass(frozen=True)
class CapturedImage:
    """A resized photograph and where its camera was.

    Attributes:
        posed: The file, pose and covariance it came from.
        camera: Intrinsics at this size.
        colour: sRGB, over white where the file is transparent.
        alpha: Coverage 0..255 by the object, None for a photograph with a background of its own.
    """

    posed: PosedImage
    camera: PinholeCamera
    colour: UInt8[NDArray, "h w 3"]
    alpha: UInt8[NDArray, "h w"] | None

    @property
    def T_world_camera(self) -> Float[NDArray, "4 4"]:
        """Camera pose (OpenGL axes)."""
        return self.posed.T_world_camera

    @property
    def colour_fraction(self) -> Float[NDArray, "h w 3"]:
        """Colour in [0, 1]."""
        return self.colour.astype(np.float32) / 255

    @property
    def colour_and_alpha(self) -> UInt8[NDArray, "h w 4"]:
        """Colour over white and coverage, 255 where there is none."""
        alpha = np.full(self.colour.shape[:2], 255, np.uint8) if self.alpha is None else self.alpha
        return np.concatenate([self.colour, alpha[..., None]], -1)


def load_captured(images: Sequence[PosedImage], longest_side: int | None) -> tuple[CapturedImage, ...]:
    """Read photographs, brought down to ``longest_side`` pixels by area averaging.

    Raises:
        InputError: A file is missing or damaged, or its pose, covariance or lens holds NaN or infinity.
    """
    return tuple(_load(image, longest_side) for image in images)


def check_posed(posed: PosedImage, camera: PinholeCamera) -> None:
    """Refuse numbers that are not finite, or would not be in single precision, before anything uses them.

    Raises:
        InputError: The pose, its covariance or the lens holds one; the sentence names the photograph.
    """
    covariance = np.zeros(1) if posed.pose_covariance is None else posed.pose_covariance
    for field, numbers in (
        ("pose", posed.T_world_camera),
        ("pose covariance", covariance),
        ("lens", np.array(astuple(camera), dtype=float)),
    ):
        if not (np.abs(numbers) <= np.finfo(np.float32).max).all():
            raise InputError(
                posed.path, field, "holds NaN or infinity", "leave the photograph out or measure it again"
            )
    if min(camera.fx, camera.fy) <= 0:
        raise InputError(posed.path, "lens", "has no positive focal length", "calibrate the camera again")


def _load(posed: PosedImage, longest_side: int | None) -> CapturedImage:
    check_posed(posed, posed.camera)
    pixels = load_resized(posed.path, longest_side)
    alpha = None
    if pixels.shape[2] == 4:
        # colours come premultiplied, so white enters with what is left
        coverage = pixels[..., 3:]
        pixels = pixels[..., :3] + (1 - coverage)
        if coverage.min() < 1:
            alpha = _quantised(coverage[..., 0])
    camera = posed.camera.resized(width=pixels.shape[1], height=pixels.shape[0])
    return CapturedImage(posed, camera, _quantised(pixels), alpha)


def _quantised(fraction: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.round(fraction.clip(0, 1) * 255).astype(np.uint8)
