import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.table1.camera_errors import camera_errors
from mulan.evaluation.table1.setups import SETUPS
from mulan.evaluation.table1.sources import Noise, PaperSource
from mulan.evaluation.table1.team import Split, of_robot, share_photographs, without_covariance
from mulan.mission.run_folder import RunFolder

from ...reconstruction.cube_scene import cube_images


@pytest.fixture
def images(tmp_path):
    return cube_images(tmp_path, train=40, test=2, side=12)


def team_of(images, tmp_path, noise=Noise.EQUAL, split=Split.AZIMUTH, seed=0):
    return PaperSource(images, split, noise).team(seed, RunFolder(tmp_path), lambda *_: None)


def test_halves_by_azimuth_look_from_opposite_sides_and_share_no_photograph(images):
    alpha, beta = share_photographs(images, Split.AZIMUTH, np.random.default_rng(0))
    assert {len(alpha), len(beta)} == {20}
    assert not {image.path for image in alpha} & {image.path for image in beta}
    middle = [np.mean([image.T_world_camera[:2, 3] for image in half], 0) for half in (alpha, beta)]
    assert middle[0] @ middle[1] < -1


def test_fifteen_each_differ_from_seed_to_seed(images):
    drawn = [share_photographs(images, Split.FIFTEEN, np.random.default_rng(seed)) for seed in (0, 1)]
    for alpha, beta in drawn:
        assert (len(alpha), len(beta)) == (15, 15)
    assert {i.path for i in drawn[0][0]} != {i.path for i in drawn[1][0]}


def test_too_few_photographs_are_told_in_one_sentence(tmp_path):
    few = cube_images(tmp_path, train=10, test=1, side=12)
    with pytest.raises(InputError, match="too few for the split 'fifteen'"):
        share_photographs(few, Split.FIFTEEN, np.random.default_rng(0))


@pytest.mark.parametrize("noise", list(Noise))
def test_alpha_is_exact_and_beta_has_a_covariance(images, tmp_path, noise):
    team = team_of(images, tmp_path, noise)
    for true, believed in zip(team.true.train, team.believed.train, strict=True):
        assert true.path == believed.path
        assert true.pose_covariance is None
        assert (believed.pose_covariance is None) == (believed.robot_id == "alpha")
        if believed.robot_id == "alpha":
            np.testing.assert_array_equal(true.T_world_camera, believed.T_world_camera)
    assert (team.believed.joint_pose_covariance is not None) == (noise is Noise.RIGID)


def test_perfect_poses_are_true_but_their_robot_does_not_know(images, tmp_path):
    team = team_of(images, tmp_path, Noise.PERFECT)
    errors = camera_errors(team, team.believed)
    assert errors["camera_max_m"] == 0
    assert errors["nees_per_dof"] < 1e-12


def test_seeds_draw_their_own_noise_and_repeat(images, tmp_path):
    first, again, other = (team_of(images, tmp_path, seed=seed) for seed in (0, 0, 1))
    poses = [np.stack([i.T_world_camera for i in t.believed.train]) for t in (first, again, other)]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert np.abs(poses[0] - poses[2]).max() > 0.01


def test_camera_errors_count_only_cameras_whose_poses_are_not_exact(images, tmp_path):
    team = team_of(images, tmp_path)
    errors = camera_errors(team, team.believed)
    true = {image.path: image.T_world_camera[:3, 3] for image in team.true.train}
    distance = [
        np.linalg.norm(image.T_world_camera[:3, 3] - true[image.path])
        for image in team.believed.train
        if image.robot_id == "beta"
    ]
    assert errors["camera_rms_m"] == pytest.approx(np.sqrt(np.mean(np.square(distance))))
    assert errors["camera_max_m"] == pytest.approx(max(distance))
    assert 0.4 < errors["nees_per_dof"] < 2
    alone = camera_errors(team, of_robot(team.believed, "alpha"))
    assert alone["camera_rms_m"] == 0
    assert alone["nees_per_dof"] is None


def test_one_robots_part_keeps_its_part_of_the_joint_covariance(images, tmp_path):
    team = team_of(images, tmp_path, Noise.RIGID)
    joint = team.believed.joint_pose_covariance
    np.testing.assert_array_equal(of_robot(team.believed, "beta").joint_pose_covariance, joint)
    assert of_robot(team.believed, "alpha").joint_pose_covariance is None
    assert without_covariance(team.believed).joint_pose_covariance is None


def test_each_setup_learns_from_the_poses_its_name_says(images, tmp_path):
    team = team_of(images, tmp_path)
    found = {setup.name: setup.images(team) for setup in SETUPS}
    assert {i.robot_id for i in found["alone"].train} == {"alpha"}
    for name in ("A", "B", "alone"):
        assert all(image.pose_covariance is None for image in found[name].train)
    for name, expected in (("A", team.true), ("B", team.believed), ("ours", team.believed)):
        for image, other in zip(found[name].train, expected.train, strict=True):
            np.testing.assert_array_equal(image.T_world_camera, other.T_world_camera)
