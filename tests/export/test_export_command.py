"""A run that was learnt, through the command line into other programs' formats."""

import json
from pathlib import Path

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.export.camera_path import smoothed_way
from mulan.geometry import se3
from mulan.mission import pixels
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.mission.tum import read_tum
from mulan.radiance.config import FieldConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights

from ..reconstruction.cube_scene import HALF_SIDE_M, cube_images
from .nerfstudio_rules import check_nerfstudio

TILES = 6
COLOURS = np.random.default_rng(8).integers(0, 256, (TILES, TILES, TILES, 3), np.uint8)
CONFIG = TrainConfig(
    image_size=48,
    steps=300,
    batch_samples=8192,
    field=FieldConfig(levels=6, log2_table_size=14, finest_resolution=64, width=16),
)
SMALL = ("--mesh.resolution", "64", "--points.count", "4000")
SIGMA = np.diag([0.01, 0.01, 0.02, 0.03, 0.03, 0.05]) ** 2


def tiled(images: PosedImageSet) -> PosedImageSet:
    """The cube's photographs with tiles instead of smooth colours, which a haze could imitate."""
    for image in (*images.train, *images.test):
        rgba = pixels.decode(image.path.read_bytes(), str(image.path))
        tile = np.minimum(rgba[..., :3].astype(int) * TILES // 255, TILES - 1)
        rgba[..., :3] = np.where(rgba[..., 3:] > 0, COLOURS[tuple(np.moveaxis(tile, 2, 0))], 0)
        image.path.write_bytes(pixels.encode_png(rgba))
    return images


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A cube of one metre, learnt from exact photographs in seconds."""
    folder = tmp_path_factory.mktemp("cube")
    (folder / "photos").mkdir()
    images = tiled(cube_images(folder / "photos", train=24, test=3, side=48))
    run = RunFolder(folder / "run")
    write_transforms(images, run.transforms)
    train(images, NoWeights(), CONFIG, run)
    return folder / "run"


def export(run: Path, out: Path, *to: str, options: tuple[str, ...] = ()) -> Path:
    assert run_command(["export", str(run), "--to", *to, "--out", str(out), *options]) == 0
    return out


def test_a_cube_of_one_metre_comes_out_as_one(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("skimage")
    out = export(run, tmp_path, "mesh", "points", options=SMALL)
    mesh = trimesh.load(out / "mesh.ply", process=False)
    cloud = trimesh.load(out / "points.ply")
    for position_m in (mesh.vertices, cloud.vertices):
        half_m = np.median(np.abs(position_m).max(1))
        assert half_m == pytest.approx(HALF_SIDE_M, rel=0.04)
    # the colours of the tiles' middles are the tiles' colours
    place = (mesh.vertices + HALF_SIDE_M).clip(0, 1 - 1e-6) * TILES
    on_face = np.abs(mesh.vertices).max(1) > 0.46
    middle = (np.sort(np.abs(place % 1 - 0.5), axis=1)[:, :2] < 0.2).all(1) & on_face
    true = COLOURS[tuple(place[middle].astype(int).T)].astype(float)
    assert np.median(np.abs(mesh.visual.vertex_colors[middle, :3] - true)) < 40


def test_nerfstudios_rules_hold(run, tmp_path):
    out = export(run, tmp_path, "nerfstudio", "points", options=("--points.count", "500"))
    meta = check_nerfstudio(out / "nerfstudio")
    assert len(meta["train_filenames"]) == 24
    assert meta["val_filenames"] == meta["test_filenames"]
    assert (out / "nerfstudio" / meta["ply_file_path"]).is_file()
    before, after = (read_transforms(p / "transforms.json") for p in (run, out / "nerfstudio"))
    for a, b in zip((*before.train, *before.test), (*after.train, *after.test), strict=True):
        np.testing.assert_allclose(a.T_world_camera, b.T_world_camera, atol=1e-12)
        assert a.camera == b.camera
        assert a.path.read_bytes() == b.path.read_bytes()


def test_colmap_gets_every_photograph_and_points_to_begin_from(run, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    options = ("--points.count", "500", "--colmap-text", "--link")
    out = export(run, tmp_path, "colmap", "points", options=options)
    model = pycolmap.Reconstruction(str(out / "colmap" / "sparse" / "0"))
    assert model.num_images() == 27
    assert model.num_points3D() > 300
    assert all((out / "colmap" / "images" / image.name).is_file() for image in model.images.values())


def test_videos_play_and_have_the_frames_asked_for(run, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    options = (
        "--video.frames",
        "5",
        "--video.image-size",
        "49",
        "--video.shows",
        "colour",
        "depth",
        "variance",
    )
    out = export(run, tmp_path, "video", options=options)
    for name in ("video.mp4", "video_depth.mp4", "video_variance.mp4"):
        frames, _ = ffmpeg.count_frames_and_secs(str(out / name))
        assert frames == 5
    reader = ffmpeg.read_frames(str(out / "video.mp4"))
    width, height = next(reader)["source_size"]
    picture = np.frombuffer(next(reader), np.uint8).reshape(height, width, 3)
    reader.close()
    assert (width, height) == (48, 48)
    assert picture[0, 0].min() > 230  # white where nothing is
    assert picture[height // 2, width // 2].min() < 200  # the cube in the middle
    assert sorted(p.name for p in out.iterdir()) == ["video.mp4", "video_depth.mp4", "video_variance.mp4"]


def test_a_robots_way_is_smoothed_and_evenly_paced():
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, 0, 3] = np.linspace(0, 3, 30)
    shaken = T @ se3.exp(0.02 * rng.normal(size=(30, 6)))
    way = smoothed_way(shaken, 120, 2.0)
    roughness = [np.abs(np.diff(x[:, :3, 3], 2, axis=0)).max() for x in (shaken, way)]
    assert roughness[1] < 0.1 * roughness[0]
    np.testing.assert_allclose(
        np.swapaxes(way[:, :3, :3], 1, 2) @ way[:, :3, :3], np.tile(np.eye(3), (120, 1, 1)), atol=1e-9
    )
    middle = np.linalg.norm(np.diff(way[20:-20, :3, 3], axis=0), axis=1)
    assert middle.max() < 3 * middle.min()


def localized(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A run as localization leaves it, with refined poses beside; and the camera's mount."""
    run = RunFolder(tmp_path / "run")
    images = cube_images(tmp_path, train=6, test=0, side=16)
    T_body_camera = se3.exp(np.array([0.1, -0.2, 0.3, 0.5, 0.0, 0.25]))
    from dataclasses import replace

    train = [
        replace(image, robot_id="alpha" if i % 2 else "beta", timestamp_s=10.0 - i, pose_covariance=SIGMA)
        for i, image in enumerate(images.train)
    ]
    write_transforms(replace(images, train=tuple(train)), run.transforms)
    robots = {}
    for name in ("alpha", "beta"):
        T = np.stack([i.T_world_camera for i in train if i.robot_id == name])
        robots[name] = {"T_world_body": (T @ se3.inverse(T_body_camera)).tolist()}
        write_json(run.poses / f"{name}.json", {"T_world_camera": T.tolist()})
    write_json(run.localization, {"anchor": "beta", "robots": robots})
    return run.root, T_body_camera


def test_trajectories_are_of_bodies_and_of_optical_frames(tmp_path):
    run, T_body_camera = localized(tmp_path)
    out = export(run, tmp_path / "out", "tum") / "tum"
    assert sorted(p.name for p in out.iterdir()) == [
        f"{robot}{end}" for robot in ("alpha", "beta") for end in (".json", ".tum", "_camera.tum")
    ]
    body, camera = read_tum(out / "alpha.tum"), read_tum(out / "alpha_camera.tum")
    assert list(body.time_s) == [5.0, 7.0, 9.0]  # sorted
    optical = np.diag([1.0, -1.0, -1.0, 1.0])
    np.testing.assert_allclose(camera.T_world_body @ optical, body.T_world_body @ T_body_camera, atol=1e-9)
    record = json.loads((out / "alpha.json").read_text())
    moved = se3.covariance_of_composition(se3.inverse(T_body_camera), SIGMA)
    np.testing.assert_allclose(record["body_covariance"][0], moved, atol=1e-12)
    assert record["refined"] is False


def test_refined_poses_are_taken_where_the_field_was_learnt_at_them(tmp_path):
    run, _ = localized(tmp_path)
    refined = json.loads((run / "transforms.json").read_text())
    for frame in refined["frames"]:
        frame["transform_matrix"][2][3] += 0.5
    (run / "transforms_refined.json").write_text(json.dumps(refined))
    heights = {}
    for name, options in {"auto": (), "no": ("--poses", "localized"), "yes": ("--poses", "refined")}.items():
        out = export(run, tmp_path / name, "tum", options=options) / "tum"
        heights[name] = read_tum(out / "beta_camera.tum").T_world_body[0, 2, 3]
    assert heights["auto"] == heights["yes"] == pytest.approx(heights["no"] + 0.5)
    write_json(run / "metrics.json", {"psnr_db": 20.0})  # trained again, without refinement
    out = export(run, tmp_path / "stale", "tum") / "tum"
    assert read_tum(out / "beta_camera.tum").T_world_body[0, 2, 3] == pytest.approx(heights["no"])


def test_robots_photographs_of_one_name_do_not_overwrite_each_other(tmp_path):
    run, _ = localized(tmp_path)
    record = json.loads((run / "transforms.json").read_text())
    for frame in record["frames"]:
        source = run / frame["file_path"]
        target = run / "images" / frame["robot_id"] / f"{int(source.stem) // 2}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(source.read_bytes())
        frame["file_path"] = str(target.relative_to(run))
    record["frames"][0]["robot_id"] = "../../beta"  # a hostile name stays in the folder
    (run / "transforms.json").write_text(json.dumps(record))
    out = export(run, tmp_path / "out", "nerfstudio", options=("--link",))
    check_nerfstudio(out / "nerfstudio")
    assert len(list((out / "nerfstudio" / "images").iterdir())) == 6
    assert sorted(p.name for p in out.iterdir()) == ["nerfstudio"]


def test_exporting_again_replaces_files_whole(run, tmp_path):
    options = ("--points.count", "300")
    out = export(run, tmp_path, "points", options=options)
    first = (out / "points.ply").read_bytes()
    export(run, tmp_path, "points", options=options)
    assert (out / "points.ply").read_bytes() == first
    assert [p.name for p in out.iterdir()] == ["points.ply"]


@pytest.mark.parametrize("what", ["mesh", "points", "video"])
def test_a_run_without_a_field_says_how_to_get_one(tmp_path, what):
    run, _ = localized(tmp_path)
    with pytest.raises(InputError, match=r"no field to export from.*mulan train"):
        run_command(["export", str(run), "--to", what])


def test_a_run_without_poses_says_how_to_get_them(tmp_path):
    with pytest.raises(InputError, match=r"no poses.*mulan localize"):
        run_command(["export", str(tmp_path), "--to", "tum"])


def test_photographs_without_times_have_no_trajectory(run, tmp_path):
    with pytest.raises(InputError, match="no photograph has both"):
        run_command(["export", str(run), "--to", "tum", "--out", str(tmp_path)])
