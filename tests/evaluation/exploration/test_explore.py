from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.exploration.explore import Exploration, ExplorationConfig, Loss
from mulan.geometry import se3
from mulan.localization.accuracy import accuracy
from mulan.mission.run_folder import RunFolder, read_json
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.knowledge import LookConfig
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import EnsembleConfig
from mulan.simulation.from_scene import SceneMissionConfig
from mulan.simulation.radio import RadioConfig
from mulan.simulation.recording import SensorConfig
from mulan.simulation.team_in_world import TeamInWorldConfig
from mulan.simulation.timeline import ApertureConfig, TourConfig

# a checkered block under a lamp
XML = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/></integrator>
<emitter type="constant"><rgb name="radiance" value="0.8"/></emitter>
<shape type="cube"><transform name="to_world"><scale x="0.5" y="0.4" z="0.5"/></transform>
<bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
<transform name="to_uv"><scale value="6"/></transform></texture></bsdf></shape></scene>"""
LEAST_APART_M = 0.8 * TeamInWorldConfig.apart_m
# enough radio to be placed by, little enough for a test
TOUR = TourConfig(rounds=1, pose_rate_hz=25, aperture=ApertureConfig(radius_m=0.15, duration_s=1.0))
SENSORS = SensorConfig(radio=RadioConfig(packets_per_second=100))
TEAM = TeamInWorldConfig(samples_per_pixel=1, tour=TOUR, sensors=SENSORS)


def config(scene_file: Path) -> ExplorationConfig:
    return ExplorationConfig(
        scene=SceneMissionConfig(robots=3, width=24, height=18, held_out=2, scene_file=scene_file),
        steps=2,
        lose=Loss("beta", 2),
        team=TEAM,
        plan=TeamPlanConfig(free_space=FreeSpaceConfig(places=6), refinements=0),
        ensemble=EnsembleConfig(members=2, steps=4, image_size=24),
        looks=LookConfig(8, 8),
    )


def test_a_team_explores_without_collision_and_goes_on_without_a_lost_robot(tmp_path: Path):
    scene = tmp_path / "block.xml"
    scene.write_text(XML)
    run = RunFolder(tmp_path / "run")
    exploration = Exploration(config(scene), run)
    localization, images = exploration.run(lambda *_: None)
    mission = exploration.team.mission
    photographs = {robot.name: len(robot.photos) for robot in mission.robots}
    assert photographs["beta"] <= 5, "it took part in one step only"
    assert photographs["alpha"] + photographs["gamma"] > 9, "the others went on"
    steps = read_json(run.root / "steps.json", "test")["steps"]
    assert [sorted(step["robots"]) for step in steps[1:]] == [["alpha", "gamma"]] * (len(steps) - 1)
    truth = {robot.name: robot.ground_truth for robot in mission.robots}
    alpha, gamma = truth["alpha"], truth["gamma"]
    assert alpha is not None
    assert gamma is not None
    then = se3.interpolate(gamma.time_s, gamma.T_world_body, alpha.time_s)
    apart_m = np.linalg.norm(alpha.T_world_body[:, :3, 3] - then[:, :3, 3], axis=1)
    assert apart_m.min() > LEAST_APART_M
    for track in (alpha, gamma):
        inside = (np.abs(track.T_world_body[:, :3, 3]) < [0.6, 0.5, 0.6]).all(1)
        assert not inside.any()
    # what was believed is what the radios and the odometry of all legs say, and it is right
    errors = accuracy(localization, mission)
    assert errors is not None
    assert max(error.position_rms_m for error in errors.values()) < 0.3
    assert len(images.train) == sum(photographs.values())
    for robot in mission.robots:
        assert (np.diff(robot.odometry.time_s) > 0).all()
        for track in robot.csi.values():
            assert (np.diff(track.frame_counter.astype(int)) > 0).all()


def test_a_robot_that_takes_no_part_cannot_be_lost(tmp_path: Path):
    with pytest.raises(InputError, match="delta"):
        Exploration(replace(config(tmp_path), lose=Loss("delta", 1)), RunFolder(tmp_path))
