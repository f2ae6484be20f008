from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mulan.simulation.from_scene import SceneMissionConfig, held_out_cameras, robot_cameras
from mulan.simulation.obstacles import Obstacles
from mulan.simulation.recording import body_poses
from mulan.simulation.scene import render_view
from mulan.simulation.tour import view_path
from mulan.simulation.world import World
from mulan.simulation.world_kind import WorldKind

CONFIG = SceneMissionConfig(photos_per_robot=8, held_out=4, width=48, height=36)
BOX_XML = """<scene version="3.0.0"><shape type="cube">
<transform name="to_world"><scale value="0.5"/></transform></shape></scene>"""


@pytest.fixture(scope="module", params=list(WorldKind), ids=lambda kind: kind.value)
def built(request: pytest.FixtureRequest) -> tuple[SceneMissionConfig, World]:
    config = replace(CONFIG, world=request.param)
    return config, config.build()


def test_every_world_is_well_lit_textured_and_its_course_is_free(built: tuple[SceneMissionConfig, World]):
    config, world = built
    for index in range(config.robots):
        picture = render_view(world.scene, config.camera, robot_cameras(config, index)[4], 9, index) / 255
        assert 0.2 < picture.mean() < 0.65
        assert picture.std() > 0.12
        assert np.mean(picture.min(-1) > 0.99) < 0.12, "too much is burnt out"
    obstacles = Obstacles(world.scene, 0.12)
    for index in range(config.robots):
        path = view_path(body_poses(robot_cameras(config, index)))
        assert obstacles.is_way_free(path.pose(np.linspace(0, path.knot_m[-1], 40))[:, :3, 3])
    assert obstacles.is_free(held_out_cameras(config)[:, :3, 3]).all()
    assert not obstacles.is_free(np.array([[0.3, 0.2, 0.02]])).any(), "the floor was not felt"
    assert not obstacles.is_way_free(np.array([[1.5, 2.5, 1.2], [1.5, 2.5, -1.2]]))


def test_a_users_own_scene_has_obstacles_too(tmp_path: Path):
    path = tmp_path / "box.xml"
    path.write_text(BOX_XML)
    world = replace(CONFIG, scene_file=path).build()
    obstacles = Obstacles(world.scene, 0.2)
    assert obstacles.is_free(np.array([[0.75, 0.0, 0.0], [0.65, 0.0, 0.0]])).tolist() == [True, False]
    around = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    assert obstacles.is_way_free(around)
    assert not obstacles.is_way_free(around @ np.diag([0.6, 1.0, 1.0]))
    through = np.array([[-1.0, 0.1, 0.0], [1.0, 0.1, 0.0]])
    assert not obstacles.is_way_free(through)


def test_shares_of_a_way_overlap_and_cover_it():
    course = replace(CONFIG, world=WorldKind.CORRIDOR).course
    ends = [course.share(robot, 3, np.array([0.0, 1.0])) for robot in range(3)]
    assert ends[0][0] == 0
    assert ends[-1][1] == pytest.approx(1)
    assert all(before[1] > after[0] for before, after in pairwise(ends))
