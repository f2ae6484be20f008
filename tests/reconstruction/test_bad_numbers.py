"""Poses, lenses, covariances and weights that are no numbers stop before anything is computed from them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import UncertaintyWeights

from .cube_scene import cube_images


def with_pose(image: PosedImage, value: float) -> PosedImage:
    T = image.T_world_camera.copy()
    T[1, 3] = value
    return replace(image, T_world_camera=T)


def with_lens(image: PosedImage, value: float) -> PosedImage:
    return replace(image, camera=replace(image.camera, fx=value))


def with_distortion(image: PosedImage, value: float) -> PosedImage:
    return replace(image, camera=replace(image.camera, k2=value))


def with_covariance(image: PosedImage, value: float) -> PosedImage:
    return replace(image, pose_covariance=np.diag([value] * 6))


@pytest.mark.parametrize("spoil", [with_pose, with_lens, with_distortion, with_covariance])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_the_sentence_names_the_photograph(spoil, value: float, tmp_path: Path) -> None:
    images = list(cube_images(tmp_path, train=3).train)
    good = load_captured(images, None)
    images[1] = spoil(images[1], value)
    config = TrainConfig(image_size=24, steps=1)
    with pytest.raises(InputError, match="NaN or infinity") as caught:
        train(PosedImageSet(tuple(images), (), tmp_path), UncertaintyWeights(), config, RunFolder(tmp_path))
    assert caught.value.source == str(images[1].path)
    # and where photographs were put together by hand
    by_hand = replace(good[1], posed=images[1], camera=images[1].camera)
    with pytest.raises(InputError, match="NaN or infinity"):
        ImageTensors([good[0], by_hand])


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_weights_that_are_no_trust_are_refused(value: float, tmp_path: Path) -> None:
    captured = load_captured(cube_images(tmp_path, train=2).train, None)
    maps = [torch.ones(24, 24), torch.ones(24, 24)]
    maps[1][5, 6] = value
    with pytest.raises(InputError, match=r"01\.png: weights"):
        ImageTensors(captured, maps)


def test_a_lens_without_focal_length_is_refused(tmp_path: Path) -> None:
    images = cube_images(tmp_path, train=1).train
    with pytest.raises(InputError, match="no positive focal length"):
        load_captured([with_lens(images[0], 0.0)], None)
