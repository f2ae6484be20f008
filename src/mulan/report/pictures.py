"""Images of a run as data URIs small enough to travel in one page."""

import base64
import io
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mulan.errors import InputError

_ERROR_COLOURS = colormaps["inferno"]  # perceptually uniform, dark where nothing is wrong
_ERROR_SCALES = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


def load_rgb(path: Path) -> Float32[NDArray, "h w 3"]:
    """An image file as RGB in [0, 1].

    Raises:
        InputError: The file cannot be read as an image.
    """
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), np.float32) / 255
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise InputError(path, "image", str(error), "delete it and render again") from error


def data_uri(image: Float[NDArray, "h w 3"], longest_side: int) -> str:
    """The image as PNG or JPEG, whichever is smaller, no longer than ``longest_side`` pixels."""
    picture = Image.fromarray((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
    picture.thumbnail((longest_side, longest_side), Image.Resampling.BOX)
    encoded = []
    for kind, options in (("png", {"optimize": True}), ("jpeg", {"quality": 92})):
        buffer = io.BytesIO()
        picture.save(buffer, kind, **options)
        encoded.append((len(buffer.getvalue()), kind, buffer.getvalue()))
    _, kind, data = min(encoded)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def psnr_db(true: Float[NDArray, "h w 3"], rendered: Float[NDArray, "h w 3"]) -> float:
    """Peak signal-to-noise ratio of two images in [0, 1]; infinite where they are equal."""
    mean_squared = float(((true - rendered) ** 2).mean())
    return float("inf") if mean_squared == 0 else -10 * float(np.log10(mean_squared))


def absolute_error(true: Float[NDArray, "h w 3"], rendered: Float[NDArray, "h w 3"]) -> Float[NDArray, "h w"]:
    """Mean absolute error over the colour channels."""
    return np.abs(true - rendered).mean(-1)


def error_scale(errors: list[Float[NDArray, "h w"]]) -> float:
    """A round upper end for the error colours that holds 99 % of the pixels of all pictures."""
    if not errors:
        return _ERROR_SCALES[0]
    high = max(float(np.quantile(error, 0.99)) for error in errors)
    return next((scale for scale in _ERROR_SCALES if high <= scale), 1.0)


def colour_error(error: Float[NDArray, "h w"], scale: float) -> Float[NDArray, "h w 3"]:
    """The error in perceptual colours, 0 black to ``scale`` bright."""
    return _ERROR_COLOURS(np.clip(error / scale, 0, 1))[..., :3]


def error_gradient_css() -> str:
    """The error colours as a CSS gradient, for the scale bar."""
    stops = [_ERROR_COLOURS(v)[:3] for v in np.linspace(0, 1, 11)]
    colours = (f"rgb({r * 255:.0f} {g * 255:.0f} {b * 255:.0f})" for r, g, b in stops)
    return f"linear-gradient(90deg, {', '.join(colours)})"
