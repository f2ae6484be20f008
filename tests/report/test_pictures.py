import base64
import io

import numpy as np
import pytest
from PIL import Image

from mulan.report.pictures import absolute_error, colour_error, data_uri, error_scale, psnr_db


def test_psnr_of_a_constant_offset_is_its_closed_form():
    true = np.full((8, 9, 3), 0.5)
    assert psnr_db(true, true + 0.1) == pytest.approx(20.0)
    assert psnr_db(true, true) == float("inf")


def test_error_colours_get_brighter_with_the_error():
    error = np.array([[0.0, 0.05, 0.1, 0.2, 0.9]])
    light = colour_error(error, 0.2).mean(-1)[0]
    assert (np.diff(light[:4]) > 0).all()
    assert light[4] == light[3]  # beyond the scale: saturated


def test_the_error_scale_is_round_and_holds_nearly_all_pixels():
    rng = np.random.default_rng(0)
    error = absolute_error(np.zeros((50, 50, 3)), rng.uniform(0, 0.17, (50, 50, 3)))
    assert error_scale([error]) == 0.2
    assert error_scale([]) > 0


def test_a_data_uri_holds_the_picture_no_larger_than_asked():
    image = np.random.default_rng(0).uniform(size=(400, 300, 3))
    header, data = data_uri(image, 100).split(",")
    assert header in ("data:image/png;base64", "data:image/jpeg;base64")
    assert Image.open(io.BytesIO(base64.b64decode(data))).size == (75, 100)
