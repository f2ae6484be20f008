import importlib.util
from itertools import product

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.simulation.image_sources import RoomConfig, image_sources
from mulan.simulation.propagation import SPEED_OF_LIGHT_M_PER_S, Mirrors
from mulan.simulation.radio import RadioConfig
from mulan.simulation.radio_material import RadioMaterial
from mulan.simulation.radio_surfaces import RadioSurface
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.sionna_radio import SionnaRadio

INSTALLED = importlib.util.find_spec("sionna") is not None
needs_sionna = pytest.mark.skipif(not INSTALLED, reason="needs pip install 'mulan[sionna]'")
FREQUENCY = RadioConfig().subcarrier_hz
ROOM = RoomConfig((-3.0, -2.0, 0.0), (4.0, 3.0, 2.5), wall_reflection=1.0)
STILL = np.array([3.413, 0.317, 1.521])


def _loop(n: int):
    turn = np.linspace(0, 2 * np.pi, n)
    return np.array([1.0, 1.5, 1.0]) + 0.2 * np.stack(
        [np.cos(turn), np.sin(turn), 0.4 * np.sin(2 * turn)], -1
    )


def _box():
    corners = np.array(list(product(*zip(ROOM.min_corner_m, ROOM.max_corner_m, strict=True))))
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = np.array([[(a, b, c), (a, c, d)] for a, b, c, d in sides]).reshape(-1, 3)
    return (RadioSurface("box", RadioMaterial.METAL, corners, triangles),)


def _radio(surfaces, config: SionnaConfig):
    try:
        return SionnaRadio(surfaces, config)
    except InputError as error:
        if "LLVM" in str(error):
            pytest.skip(str(error))
        raise


@pytest.fixture(scope="module")
def metal_box():
    radio = _radio(_box(), SionnaConfig(max_depth=1))
    yield radio
    radio.close()


@needs_sionna
def test_a_free_link_has_the_amplitude_and_phase_of_its_distance():
    radio = _radio((), SionnaConfig())
    moving, still = _loop(40), np.tile(STILL, (40, 1))
    channel = radio.channel(still, moving, FREQUENCY)
    distance_m = np.linalg.norm(moving - still, axis=1)[:, None]
    phase_rad = -2 * np.pi * distance_m * FREQUENCY / SPEED_OF_LIGHT_M_PER_S
    assert np.allclose(channel, np.exp(1j * phase_rad) / distance_m, rtol=1e-5)
    assert np.allclose(channel, Mirrors(None).channel(still, moving, FREQUENCY), rtol=1e-5)
    radio.close()


@needs_sionna
def test_a_metal_box_reflects_as_six_mirrors_do(metal_box):
    # the sign of a reflection depends on polarization
    wide_hz = np.linspace(4.5e9, 6.5e9, 400)
    receiver = np.array([[1.07, 1.51, 1.03]])
    channel = metal_box.channel(STILL[None], receiver, wide_hz)[0]
    images, _ = image_sources(STILL[None], ROOM)
    distance_m = np.linalg.norm(images[0] - receiver, axis=-1)
    waves = np.exp(-2j * np.pi * wide_hz[:, None] * distance_m / SPEED_OF_LIGHT_M_PER_S) / distance_m
    gain, *_ = np.linalg.lstsq(waves, channel, rcond=None)
    assert np.allclose(np.abs(gain), 1.0, atol=0.01)
    assert np.abs(channel - waves @ gain).max() < 2e-3 * np.abs(channel).max()


@needs_sionna
def test_a_channel_is_the_same_either_way_and_nearly_so_for_a_row_alone(metal_box):
    moving, still = _loop(30), np.tile(STILL, (30, 1))
    channel = metal_box.channel(still, moving, FREQUENCY)
    assert np.array_equal(channel, metal_box.channel(moving, still, FREQUENCY))
    # alone, a row does not tell which end stands still; the other one's paths are carried as well
    alone = metal_box.channel(still[7:8], moving[7:8], FREQUENCY)[0]
    assert np.abs(alone - channel[7]).max() < 0.02 * np.abs(channel[7]).max()
    assert metal_box.channel(still[:0], moving[:0], FREQUENCY).shape == (0, 30)


@needs_sionna
def test_where_the_ends_move_in_turn_each_standstill_is_traced_once(metal_box):
    before = len({(here, there) for _, here, there in metal_box._known})
    moving, still = _loop(30), np.tile(STILL + 0.01, (30, 1))
    first, second = np.concatenate([still, moving]), np.concatenate([moving, still])
    channel = metal_box.channel(first, second, FREQUENCY)
    senders = {here for _, here, _ in list(metal_box._known)[before:]}
    assert len(senders) == 1
    assert np.array_equal(channel[:30], channel[30:])


@needs_sionna
def test_phases_within_a_cell_are_those_of_mirror_images(metal_box):
    """Two centimetres are 2.3 rad: were paths not carried to each place, it would be another channel."""
    moving, still = _loop(30), np.tile(STILL, (30, 1))
    channel = metal_box.channel(still, moving, FREQUENCY)
    images, _ = image_sources(STILL[None], ROOM)
    distance_m = np.linalg.norm(images[0] - moving[:, None], axis=-1)
    waves = np.exp(-2j * np.pi * distance_m[..., None] * FREQUENCY / SPEED_OF_LIGHT_M_PER_S)
    design = (waves / distance_m[..., None]).transpose(0, 2, 1).reshape(-1, len(images[0]))
    gain, *_ = np.linalg.lstsq(design, channel.ravel(), rcond=None)
    unexplained = np.linalg.norm(channel.ravel() - design @ gain) / np.linalg.norm(channel)
    assert unexplained < 0.01


@needs_sionna
def test_behind_metal_it_is_dark(metal_box):
    inside, outside = STILL[None], np.array([[6.0, 0.0, 1.0]])
    assert np.abs(metal_box.channel(inside, outside, FREQUENCY)).max() < 1e-3


@needs_sionna
def test_a_library_that_is_no_llvm_is_told_in_one_sentence(monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    with pytest.raises(InputError, match=r"--radio sionna.*DRJIT_LIBLLVM_PATH"):
        SionnaRadio((), SionnaConfig())


@pytest.mark.skipif(INSTALLED, reason="Sionna RT is installed")
def test_without_the_extra_one_sentence_says_how_to_install_it():
    with pytest.raises(InputError, match=r"pip install 'mulan\[sionna\]'"):
        SionnaRadio((), SionnaConfig())
