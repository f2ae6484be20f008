"""Photographs kept in files instead of memory."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.pixels import encode_png
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.radiance.space import SceneSpace
from mulan.reconstruction import mapped_photographs
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.mapped_images import MappedImages
from mulan.reconstruction.mapped_photographs import map_photographs
from mulan.reconstruction.photographs import FiledPhotographs, load_photographs
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights, Weighting

from .cube_scene import cube_images, look_at, photograph

SPACE = SceneSpace((0.0, 0.0, 0.0), 1.0, False)
UNCERTAIN = UncertaintyWeights(colour_variance=1e-4, threshold=0.05)
NO_ROOM = TrainConfig(image_size=24, image_memory_share=1e-12)


@pytest.fixture
def posed(tmp_path: Path) -> tuple[PosedImage, ...]:
    """Two lenses, sizes and kinds of file; some poses uncertain."""
    images = list(cube_images(tmp_path, train=4).train)
    camera = PinholeCamera(30, 18, 33.0, 35.0, 14.0, 9.0, k1=0.05)
    for i in range(2):
        T = look_at([2.0 + i, 1.0, 0.5])
        path = tmp_path / f"opaque{i}.png"
        path.write_bytes(encode_png(np.ascontiguousarray(photograph(camera, T)[..., :3])))
        images.insert(2 * i, PosedImage(path, camera, T))
    covariance = np.diag([1e-4] * 3 + [0.05] * 3)
    return tuple(replace(p, pose_covariance=covariance if i % 2 else None) for i, p in enumerate(images))


def in_memory(posed: tuple[PosedImage, ...], weighting: Weighting) -> ImageTensors:
    captured = load_captured(posed, 24)
    return ImageTensors(captured, weighting.weight_maps(captured, SPACE))


def in_files(posed: tuple[PosedImage, ...], weighting: Weighting, folder: Path) -> MappedImages:
    return MappedImages(map_photographs(posed, 24, folder), weighting, SPACE, folder)


def assert_same_rays(a: PosedPixels, b: PosedPixels) -> None:
    g, h = torch.Generator().manual_seed(1), torch.Generator().manual_seed(1)
    batches = [(a.sample(700, g), b.sample(700, h)) for _ in range(3)]
    batches += [(a.image_rays(i), b.image_rays(i)) for i in range(len(a))]
    for left, right in batches:
        for name in ("origins", "directions", "colours", "weights", "image_index"):
            assert torch.equal(getattr(left, name), getattr(right, name)), name
        assert (left.opacity is None) == (right.opacity is None)
        assert left.opacity is None or right.opacity is None or torch.equal(left.opacity, right.opacity)


@pytest.mark.parametrize("weighting", [NoWeights(), UNCERTAIN])
def test_batches_equal_those_from_memory_bit_for_bit(
    posed: tuple[PosedImage, ...], weighting: Weighting, tmp_path: Path
) -> None:
    memory, files = in_memory(posed, weighting), in_files(posed, weighting, tmp_path / "decoded")
    assert_same_rays(memory, files)
    assert files.fingerprint() == memory.fingerprint()
    assert files.drawable_pixels == memory.drawable_pixels
    assert (files.drawable_pixels < sum(i.colour[..., 0].size for i in files.images)) == (
        weighting == UNCERTAIN
    )
    for mine, true in zip(files.images, memory.images, strict=True):
        assert np.array_equal(mine.colour, true.colour)
        assert (mine.alpha is None) == (true.alpha is None)
        assert np.array_equal(mine.colour_and_alpha, true.colour_and_alpha)


def test_photographs_are_decoded_once(posed: tuple[PosedImage, ...], tmp_path: Path) -> None:
    first = in_files(posed, UNCERTAIN, tmp_path / "decoded")
    nothing_is_read = mock.Mock(side_effect=AssertionError)
    with mock.patch.object(mapped_photographs, "load_captured", nothing_is_read):
        assert_same_rays(first, in_files(posed, UNCERTAIN, tmp_path / "decoded"))


def test_a_changed_photograph_is_decoded_again(posed: tuple[PosedImage, ...], tmp_path: Path) -> None:
    before = in_files(posed, NoWeights(), tmp_path / "decoded").fingerprint()
    picture = np.zeros((24, 24, 4), np.uint8)
    posed[1].path.write_bytes(encode_png(picture))
    after = in_files(posed, NoWeights(), tmp_path / "decoded")
    assert after.fingerprint() != before
    assert_same_rays(after, in_memory(posed, NoWeights()))


@pytest.mark.parametrize("cut", [0, 5, 100, -1])
def test_a_damaged_file_is_made_again(posed: tuple[PosedImage, ...], cut: int, tmp_path: Path) -> None:
    in_files(posed, NoWeights(), tmp_path / "decoded")
    for path in (tmp_path / "decoded").iterdir():
        path.write_bytes(path.read_bytes()[:cut])
    assert_same_rays(in_files(posed, NoWeights(), tmp_path / "decoded"), in_memory(posed, NoWeights()))


def test_an_interrupted_decoding_leaves_no_file(posed: tuple[PosedImage, ...], tmp_path: Path) -> None:
    whole = load_captured

    def interrupted(images: list[PosedImage], side: int):
        if images[0].path == posed[3].path:
            raise KeyboardInterrupt
        return whole(images, side)

    with (
        mock.patch.object(mapped_photographs, "load_captured", interrupted),
        pytest.raises(KeyboardInterrupt),
    ):
        in_files(posed, NoWeights(), tmp_path / "decoded")
    assert list((tmp_path / "decoded").iterdir()) == []


def test_a_full_disk_is_one_sentence(posed: tuple[PosedImage, ...], tmp_path: Path) -> None:
    folder = tmp_path / "decoded"
    nearly_full = mock.patch("shutil.disk_usage", return_value=mock.Mock(free=1000))
    with nearly_full, pytest.raises(InputError, match=r"the disk has 0\.00 GB left"):
        in_files(posed, NoWeights(), folder)

    # another program may take the room while this one writes
    def filling_up(*_: object):
        yield np.zeros(3, np.uint8)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    full = mock.patch.object(mapped_photographs, "_decoded", filling_up)
    with full, pytest.raises(InputError, match="No space left"):
        in_files(posed, NoWeights(), folder)
    assert list(folder.iterdir()) == []


def test_training_from_files_equals_training_from_memory(tmp_path: Path) -> None:
    images = cube_images(tmp_path)
    config = replace(NO_ROOM, steps=12, batch_samples=2048, image_cache=tmp_path / "cache")
    files = train(images, UNCERTAIN, config, RunFolder(tmp_path / "files"))
    memory = train(images, UNCERTAIN, replace(config, image_memory_share=1.0), RunFolder(tmp_path / "memory"))
    a, b = files.engine.state(), memory.engine.state()
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert sorted(p.name.split("-")[0] for p in (tmp_path / "cache").iterdir()) == [
        *("directions", "photographs", "photographs", "weights")
    ]
    assert not (tmp_path / "memory" / "decoded").exists()


def test_the_share_of_free_memory_decides(tmp_path: Path) -> None:
    images = cube_images(tmp_path)
    folder = tmp_path / "decoded"
    assert isinstance(load_photographs(images, NO_ROOM, folder), FiledPhotographs)
    roomy = replace(NO_ROOM, image_memory_share=0.5)
    assert not isinstance(load_photographs(images, roomy, folder), FiledPhotographs)


@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's account of a process's memory")
def test_a_set_larger_than_the_memory_limit_is_learnt_from(tmp_path: Path) -> None:
    side, count = 1000, 12
    camera = PinholeCamera(side, side, 900.0, 900.0, 500.0, 500.0)
    picture = np.zeros((side, side, 3), np.uint8)
    images = []
    for i in range(count):
        picture[:] = 20 * i
        path = tmp_path / f"{i}.png"
        path.write_bytes(encode_png(picture))
        images.append(PosedImage(path, camera, look_at([2.5, 0.1 * i, 0.5])))
    write_transforms(PosedImageSet(tuple(images), (), tmp_path), tmp_path / "transforms.json")
    headroom = 160_000_000
    assert side * side * count * 19 > headroom  # what it takes in memory where every pixel may be drawn

    def load(share: float) -> dict:
        script = str(Path(__file__).with_name("under_a_memory_limit.py"))
        command = [sys.executable, script, str(tmp_path), str(share), str(headroom)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    assert load(share=1e9) == {"fits": False}
    assert load(share=1e-12)["fits"]
