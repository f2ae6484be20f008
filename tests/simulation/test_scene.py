import io
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from mulan.errors import InputError
from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.simulation import mitsuba_parts, scene_pictures, scene_textures
from mulan.simulation.course import look_at
from mulan.simulation.from_scene import (
    SceneMissionConfig,
    held_out_cameras,
    robot_cameras,
    simulate_from_scene,
)
from mulan.simulation.scene import SceneConfig, build_scene, load_scene_file, render_view
from mulan.simulation.timeline import TourConfig

TINY = SceneMissionConfig(
    robots=2,
    photos_per_robot=3,
    held_out=2,
    width=24,
    height=18,
    samples_per_pixel=4,
    tour=TourConfig(rounds=2),
)
MARKER_XML = """<scene version="3.0.0"><integrator type="path"/>
<shape type="sphere"><point name="center" x="0.4" y="0.3" z="0.2"/><float name="radius" value="0.05"/>
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape></scene>"""


@pytest.fixture(scope="module")
def room_scene() -> mi.Scene:
    return build_scene(SceneConfig())


def test_a_glowing_marker_appears_where_the_pinhole_model_projects_it(tmp_path: Path):
    path = tmp_path / "marker.xml"
    path.write_text(MARKER_XML)
    scene = load_scene_file(path)
    camera = PinholeCamera(120, 90, 110.0, 110.0, 52.0, 51.0)
    for seed, eye in enumerate(([2.0, 0.5, 0.7], [-1.5, -1.0, 1.0], [0.3, 2.2, -0.4])):
        roll = se3.from_parts(so3.exp(np.array([0.0, 0.0, 0.5 * seed])), np.zeros(3))
        T = look_at(np.array([eye]), np.array([[0.25, 0.25, 0.3]]))[0] @ roll
        picture = render_view(scene, camera, T, 16, seed).astype(float).sum(-1)
        v, u = np.mgrid[0:90, 0:120] + 0.5
        seen = np.array([(u * picture).sum(), (v * picture).sum()]) / picture.sum()
        expected = camera.project(se3.transform(se3.inverse(T), np.array([0.4, 0.3, 0.2])))
        assert np.linalg.norm(seen - expected) < 0.25
        assert np.linalg.norm(expected - [52.0, 51.0]) > 3, "a centred marker would prove nothing"


def test_the_room_is_well_lit_and_full_of_texture(room_scene: mi.Scene):
    config = SceneMissionConfig(width=64, height=48)
    camera = PinholeCamera(64, 48, 53.0, 53.0, 32.0, 24.0)
    for index in range(3):
        picture = render_view(room_scene, camera, robot_cameras(config, index)[10], 16, index) / 255
        assert 0.3 < picture.mean() < 0.6
        assert picture.std() > 0.15
        assert np.mean(picture.min(-1) > 0.99) < 0.08, "too much is burnt out"
        assert np.abs(np.diff(picture, axis=1)).mean() > 0.04


def test_rendering_is_deterministic_given_the_seed(room_scene: mi.Scene):
    camera = PinholeCamera(32, 24, 27.0, 27.0, 16.0, 12.0)
    T = robot_cameras(SceneMissionConfig(), 0)[0]
    first, again, other = (render_view(room_scene, camera, T, 4, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_robots_share_the_circle_keep_their_distance_and_look_at_the_middle():
    config = SceneMissionConfig()
    sectors = []
    for index in range(3):
        T = robot_cameras(config, index)
        radius = np.hypot(T[:, 0, 3], T[:, 1, 3])
        assert radius.min() >= 1.6
        assert radius.max() <= 2.4
        assert T[:, 2, 3].min() >= 0.5
        assert T[:, 2, 3].max() <= 1.5
        to_middle = np.array([0.0, 0.0, 0.5]) - T[:, :3, 3]
        cosine = np.sum(-T[:, :3, 2] * to_middle, 1) / np.linalg.norm(to_middle, axis=1)
        assert np.rad2deg(np.arccos(cosine.min())) < 15
        azimuth = np.unwrap(np.arctan2(T[:, 1, 3], T[:, 0, 3]))
        sectors.append(azimuth[-1] - azimuth[0])
    assert np.rad2deg(sectors) == pytest.approx(168.0)
    assert len(held_out_cameras(config)) == 12


def test_a_whole_mission_comes_out_with_readable_photographs_and_progress():
    calls = []
    mission = simulate_from_scene(TINY, lambda done, total, what: calls.append((done, total, what)))
    assert [done for done, _, _ in calls] == list(range(1, 9))
    assert {total for _, total, _ in calls} == {8}
    for robot in mission.robots:
        assert len(robot.photos) == 3
        assert robot.ground_truth is not None
        truth = se3.interpolate(
            robot.ground_truth.time_s, robot.ground_truth.T_world_body, robot.photo_time_s
        )
        index = mission.robots.index(robot)
        assert np.allclose(truth @ robot.T_body_camera, robot_cameras(TINY, index), atol=1e-7)
        picture = np.asarray(Image.open(io.BytesIO(robot.photos[0].data)))
        assert picture.shape == (18, 24, 3)
        assert 40 < picture.mean() < 200
    assert mission.held_out is not None
    assert len(mission.held_out.photos) == 2


def test_robots_and_antennas_stay_inside_the_room():
    from mulan.simulation.recording import CameraTour, plan_camera_tours

    config = SceneMissionConfig()
    cameras = [robot_cameras(config, index) for index in range(3)]
    camera = PinholeCamera(8, 6, 8.0, 8.0, 4.0, 3.0)
    tours = [CameraTour(camera, T, "jpeg", (b"",) * len(T)) for T in cameras]
    for motion in plan_camera_tours(tours, config.tour):
        antenna = motion.point(motion.sample_times(), np.array([0.0, 0.0, 0.08]))
        assert np.all(antenna > np.array(config.scene.room.min_corner_m) + 0.05)
        assert np.all(antenna < np.array(config.scene.room.max_corner_m) - 0.05)


def test_texture_pictures_stand_upright():
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "light": {"type": "constant"},
            "poster": mitsuba_parts.panel(
                mitsuba_parts.facing((0.0, 0.0, 0.0), 0.0), (2.0, 2.0), mitsuba_parts.textured(_quarters())
            ),
        }
    )
    assert isinstance(scene, mi.Scene)
    T = look_at(np.array([[3.0, 0.0, 0.0]]), np.zeros((1, 3)))[0]
    picture = render_view(scene, PinholeCamera(40, 40, 40.0, 40.0, 20.0, 20.0), T, 16, 0)
    brightest = [picture[v, u].argmax() for v, u in ((12, 12), (12, 28), (28, 12))]
    assert brightest == [0, 1, 2], "red top left, green top right, blue bottom left"


def _quarters():
    image = np.zeros((32, 32, 3), np.uint8)
    image[:16, :16, 0] = image[:16, 16:, 1] = image[16:, :16, 2] = 255
    return image


def test_textures_are_sharp_images_that_depend_only_on_the_seed():
    for make in (
        lambda rng: scene_textures.bricks(8, 4, 128, rng),
        lambda rng: scene_textures.kilim(128, rng),
        lambda rng: scene_textures.books(3, 128, rng),
        lambda rng: scene_pictures.landscape(128, rng),
        lambda rng: scene_pictures.hull_panel(64, "M", rng),
    ):
        first, again = make(np.random.default_rng(3)), make(np.random.default_rng(3))
        assert np.array_equal(first, again)
        assert first.dtype == np.uint8
        assert first.std() > 20


def test_unusable_scenes_and_lenses_are_refused_in_one_sentence(tmp_path: Path, room_scene: mi.Scene):
    with pytest.raises(InputError, match="no such file"):
        load_scene_file(tmp_path / "none.xml")
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><shape type='nonsense'/></scene>")
    with pytest.raises(InputError, match=r"broken\.xml: scene"):
        load_scene_file(tmp_path / "broken.xml")
    fisheye = PinholeCamera(8, 6, 8.0, 8.0, 4.0, 3.0, k1=0.2)
    with pytest.raises(InputError, match="ideal pinhole"):
        render_view(room_scene, fisheye, np.eye(4), 1, 0)
    with pytest.raises(InputError, match="photos_per_robot"):
        simulate_from_scene(replace(TINY, photos_per_robot=1))
