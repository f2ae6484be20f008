"""``sensor_msgs/Image`` as a compressed photograph."""

from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray

from mulan.mission import pixels

Compression = Literal["jpeg", "png"]

_CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3, "8UC4": 4}
# OpenCV's own names say nothing of the order; its matrices are blue first
_BLUE_FIRST = ("bgr8", "bgra8", "8UC3", "8UC4")


def to_pixels(message: Any) -> UInt8[NDArray, "h w 3"]:
    """RGB of a raw image; transparency is dropped, since cameras have none.

    Raises:
        ValueError: The encoding is not supported, or the size does not fit the data.
    """
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise ValueError(
            f"encoding '{str(message.encoding)[:40]}' is not supported, only {', '.join(_CHANNELS)}"
        )
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not (0 < height * width <= pixels.MAX_PIXELS and step >= width * channels):
        raise ValueError(f"a size of {width}x{height} with {step} bytes a row is none")
    data = np.asarray(message.data, dtype=np.uint8)
    if len(data) < step * height:
        raise ValueError(f"{len(data)} bytes are too few for {width}x{height} {message.encoding}")
    image = (
        data[: step * height].reshape(height, step)[:, : width * channels].reshape(height, width, channels)
    )
    if channels == 1:
        return np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image[..., 2::-1] if message.encoding in _BLUE_FIRST else image[..., :3])


def compress(message: Any, compression: Compression, jpeg_quality: int) -> bytes:
    """A raw image as a JPEG or PNG file.

    Raises:
        ValueError: See :func:`to_pixels`.
    """
    image = to_pixels(message)
    return pixels.encode_png(image) if compression == "png" else pixels.encode_jpeg(image, jpeg_quality)
