import struct
import zlib
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mulan.errors import InputError
from mulan.mission import pixels


def noise(height: int, width: int, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(height).integers(0, 256, (height, width, channels), dtype=np.uint8)


def saved(image: Image.Image, kind: str) -> bytes:
    buffer = BytesIO()
    image.save(buffer, kind)
    return buffer.getvalue()


@pytest.mark.parametrize("channels", [3, 4])
def test_png_comes_back_exactly(channels):
    array = noise(5, 7, channels)
    np.testing.assert_array_equal(pixels.decode(pixels.encode_png(array), "x"), array)


def test_jpeg_comes_back_closely():
    smooth = np.broadcast_to(np.arange(0, 240, 5, dtype=np.uint8)[:, None, None], (48, 40, 3)).copy()
    found = pixels.decode(pixels.encode_jpeg(smooth), "x").astype(int)
    assert np.abs(found - smooth).max() <= 4


def test_grey_and_palette_images_become_rgb_or_rgba():
    grey = Image.fromarray(noise(4, 4)[..., 0])
    assert pixels.decode(saved(grey, "PNG"), "x").shape == (4, 4, 3)
    assert pixels.decode(saved(grey.convert("LA"), "PNG"), "x").shape == (4, 4, 4)
    assert pixels.decode(saved(grey.convert("P"), "PNG"), "x").shape == (4, 4, 3)


@pytest.mark.parametrize("data", [b"", b"GIF89a", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"x" * 1000])
def test_bytes_that_are_no_photograph_are_refused(data):
    with pytest.raises(InputError, match="camera 3: image"):
        pixels.decode(data, "camera 3")


@pytest.mark.parametrize("encode", [pixels.encode_png, pixels.encode_jpeg])
def test_a_photograph_cut_short_is_refused(encode):
    data = encode(noise(64, 64))
    # the last 20 bytes of a PNG hold checksums only, no pixels
    for keep in range(1, len(data) - 20, len(data) // 40):
        with pytest.raises(InputError, match=r"a\.jpg"):
            pixels.decode(data[:keep], "a.jpg")


def test_a_header_that_claims_a_gigantic_image_is_refused():
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
    with pytest.raises(InputError, match="implausibly large"):
        pixels.decode(b"\x89PNG\r\n\x1a\n" + chunk + b"\x00\x00\x00\x00IDAT", "bomb.png")


def test_sixteen_bit_grey_is_refused_not_clipped():
    with pytest.raises(InputError, match="not 8-bit"):
        pixels.decode(saved(Image.fromarray(np.full((4, 4), 40_000, np.uint16)), "PNG"), "depth.png")


def test_halving_is_the_mean_of_two_by_two_blocks():
    array = noise(8, 12)
    found = pixels.load_resized(pixels.encode_png(array), 6)
    blocks = array.reshape(4, 2, 6, 2, 3).mean((1, 3)) / 255
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, blocks, atol=1e-6)


def test_a_fraction_of_a_pixel_counts_for_its_share():
    """Three pixels to two: each output covers one pixel and a half."""
    array = np.zeros((3, 3, 3), np.uint8)
    array[:, 1] = 255
    found = pixels.load_resized(pixels.encode_png(array), 2)
    np.testing.assert_allclose(found, 1 / 3, atol=1e-6)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 50))
def test_resampling_keeps_the_mean_and_the_aspect(height, width, longest):
    array = noise(height, width)
    found = pixels.load_resized(pixels.encode_png(array), longest)
    np.testing.assert_allclose(found.mean((0, 1)), array.mean((0, 1)) / 255, atol=1e-5)
    new_width, new_height = pixels.resized_shape(width, height, longest)
    assert found.shape == (new_height, new_width, 3)
    assert max(new_width, new_height) == min(longest, max(width, height))
    # each side is the exact one rounded to whole pixels, and never less than one
    scale = min(1.0, longest / max(width, height))
    assert abs(new_width - max(1.0, width * scale)) <= 0.5
    assert abs(new_height - max(1.0, height * scale)) <= 0.5


def test_colour_of_transparent_pixels_does_not_bleed():
    """A red opaque pixel beside a transparent green one: half-covered red, no green."""
    array = np.array([[[255, 0, 0, 255], [0, 255, 0, 0]]] * 2, np.uint8)
    found = pixels.load_resized(pixels.encode_png(array), 1)
    np.testing.assert_allclose(found[0, 0], [0.5, 0.0, 0.0, 0.5], atol=1e-6)


def test_images_are_read_from_files_and_missing_ones_named(tmp_path):
    path = tmp_path / "photo.png"
    path.write_bytes(pixels.encode_png(noise(4, 6)))
    assert pixels.load_resized(path, None).shape == (4, 6, 3)
    assert pixels.image_size(path, "x") == (6, 4)
    with pytest.raises(InputError, match=r"gone\.png"):
        pixels.load_resized(tmp_path / "gone.png", None)


def test_the_encoding_is_known_by_the_first_bytes():
    assert pixels.encoding_of(pixels.encode_png(noise(2, 2))) == "png"
    assert pixels.encoding_of(pixels.encode_jpeg(noise(2, 2))) == "jpeg"
    assert pixels.encoding_of(b"RIFF") is None
