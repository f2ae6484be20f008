"""Photographs as arrays: decoding, exact area resampling, encoding."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from numpy.typing import NDArray
from PIL import Image
from scipy import sparse

from mulan.errors import InputError

MAX_PIXELS = 100_000_000  # a file that claims more is refused before a byte of it is unpacked
_FORMATS = ("PNG", "JPEG")
_REMEDY = "give an 8-bit PNG or JPEG photograph"


def encoding_of(data: bytes) -> str | None:
    """``"png"`` or ``"jpeg"`` by the file's first bytes, None for anything else."""
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    return "jpeg" if data.startswith(b"\xff\xd8\xff") else None


def image_size(data: bytes | Path, source: str) -> tuple[int, int]:
    """(width, height) from the header alone.

    Raises:
        InputError: As :func:`decode`.
    """
    with _opened(data, source) as image:
        return image.size


def decode(data: bytes, source: str) -> UInt8[NDArray, "h w c"]:
    """Pixels of a PNG or JPEG file; c is 4 where the file has transparency, else 3.

    The pixels are as stored: an EXIF orientation is not applied, since calibrations do not apply it either.

    Args:
        data: The file's bytes.
        source: File or topic to name in an error.

    Raises:
        InputError: Neither PNG nor JPEG, damaged, cut short, 16-bit grey, or beyond MAX_PIXELS.
    """
    with _opened(data, source) as image:
        if image.mode.startswith(("I", "F")):
            raise InputError(source, "image", f"has {image.mode} pixels, not 8-bit ones", _REMEDY)
        has_alpha = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
        try:
            return np.array(image.convert("RGBA" if has_alpha else "RGB"))
        except (OSError, SyntaxError, ValueError, IndexError, EOFError) as error:
            raise InputError(source, "image", f"is damaged ({error})", "copy or record it again") from error


def resized_shape(width: int, height: int, longest_side: int | None) -> tuple[int, int]:
    """(width, height) with the longest side brought down to a limit, the aspect kept; never enlarged."""
    if longest_side is None or max(width, height) <= longest_side:
        return width, height
    scale = longest_side / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def load_resized(file: Path | bytes, longest_side: int | None) -> Float32[NDArray, "h w c"]:
    """Pixels in [0, 1], averaged down over exact areas; RGBA comes back with colour premultiplied by alpha.

    Over a background b the colour is therefore ``rgb + (1 - alpha) * b``.

    Args:
        file: A file or its bytes.
        longest_side: Limit in pixels (see :func:`resized_shape`); None keeps the size.

    Raises:
        InputError: The file is missing or as :func:`decode` says.
    """
    source = str(file) if isinstance(file, Path) else "photograph"
    pixels = decode(read_bytes(file) if isinstance(file, Path) else file, source).astype(np.float32) / 255
    if pixels.shape[2] == 4:
        pixels[..., :3] *= pixels[..., 3:]
    height, width, channels = pixels.shape
    new_width, new_height = resized_shape(width, height, longest_side)
    if (new_width, new_height) == (width, height):
        return pixels
    rows = _area_weights(height, new_height) @ pixels.reshape(height, width * channels)
    columns = rows.reshape(new_height, width, channels).transpose(1, 0, 2).reshape(width, -1)
    result = (_area_weights(width, new_width) @ columns).reshape(new_width, new_height, channels)
    return np.ascontiguousarray(result.transpose(1, 0, 2), dtype=np.float32)


def read_bytes(path: Path) -> bytes:
    """A photograph's file.

    Raises:
        InputError: It is missing or cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            path, "image", error.strerror or str(error), "check the path to the photograph"
        ) from error


def encode_png(pixels: UInt8[NDArray, "h w c"]) -> bytes:
    """PNG file of RGB or RGBA pixels."""
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def encode_jpeg(pixels: UInt8[NDArray, "h w 3"], quality: int = 92) -> bytes:
    """JPEG file of RGB pixels, colour at full resolution."""
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()


def _opened(data: bytes | Path, source: str) -> Image.Image:
    try:
        image = Image.open(BytesIO(data) if isinstance(data, bytes) else data, formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise InputError(source, "image", "is implausibly large", _REMEDY) from error
    except FileNotFoundError:
        raise InputError(source, "image", "does not exist", "check the path to the photograph") from None
    except (OSError, SyntaxError, ValueError, IndexError, EOFError) as error:
        raise InputError(source, "image", "is neither PNG nor JPEG, or is damaged", _REMEDY) from error
    if image.width * image.height > MAX_PIXELS:
        image.close()
        raise InputError(source, "image", f"is implausibly large ({image.width}x{image.height})", _REMEDY)
    return image


def _area_weights(size: int, new_size: int) -> sparse.csr_matrix:
    """Row i averages the stretch of input pixels that output pixel i covers, edges in part."""
    edges = np.linspace(0, size, new_size + 1)
    pixel = np.arange(size)
    overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    return sparse.csr_matrix(np.clip(overlap, 0, None).astype(np.float32) * np.float32(new_size / size))
