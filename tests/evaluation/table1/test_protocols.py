import numpy as np
import pytest

from mulan.evaluation.table1.loop import LoopSource
from mulan.evaluation.table1.real_radio import RealRadioSource
from mulan.evaluation.table1.recorded_bearings import RecordedBearing, core_sigma_rad, draw
from mulan.mission.run_folder import RunFolder
from mulan.simulation.timeline import TourConfig
from mulan.wireless.azimuth_density import AzimuthMixture

from ...reconstruction.cube_scene import cube_images


def mixture(*sigma_weight, outlier_mass):
    sigma, weight = (np.array(column) for column in zip(*sigma_weight, strict=True))
    return AzimuthMixture(np.zeros(len(sigma)), sigma, weight, outlier_mass)


def test_core_sigma_is_that_of_a_lone_peak_and_grows_with_the_outlier_mass():
    assert core_sigma_rad(mixture((0.1, 1.0), outlier_mass=0.0)) == pytest.approx(0.1, rel=1e-3)
    assert 0.1 < core_sigma_rad(mixture((0.1, 0.9), outlier_mass=0.1)) < 0.15
    assert core_sigma_rad(mixture((0.1, 0.3), outlier_mass=0.7)) > 1


def ignore(*_):
    pass


def bearings(n=30):
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.02, 0.3, n)
    return [RecordedBearing(str(i), s * rng.normal(), s) for i, s in enumerate(sigma)]


def test_no_link_is_drawn_twice_before_all_were_drawn_once():
    names = [link.name for link in draw(bearings(30), 70, np.random.default_rng(0))]
    assert len(set(names[:30])) == len(set(names[30:60])) == 30
    assert len(names) == 70


def test_each_image_is_displaced_by_its_links_error_and_believes_its_links_sigma(tmp_path):
    images = cube_images(tmp_path, train=16, test=1, side=12)
    wrong = [RecordedBearing("wrong", np.radians(40), np.radians(40))]
    sure = [RecordedBearing("sure", 0.0, np.radians(0.5))]
    rms = {}
    for links in (wrong, sure):
        team = RealRadioSource(images, links).team(0, RunFolder(tmp_path), ignore)
        pairs = [
            (believed, true)
            for believed, true in zip(team.believed.train, team.true.train, strict=True)
            if believed.pose_covariance is not None
        ]
        error = [b.T_world_camera[:3, 3] - t.T_world_camera[:3, 3] for b, t in pairs]
        believed = [np.trace(np.asarray(b.pose_covariance)[3:, 3:]) for b, _ in pairs]
        rms[links[0].name] = np.sqrt(np.mean(np.square(error)) * 3), np.sqrt(np.mean(believed))
    assert rms["wrong"][0] > 10 * rms["sure"][0]
    assert rms["wrong"][1] > 10 * rms["sure"][1]


def test_a_localized_team_is_kept_and_read_back_exactly(tmp_path):
    images = cube_images(tmp_path, train=12, test=2, side=12)
    source = LoopSource(images, tour=TourConfig(rounds=2))
    team = source.team(0, RunFolder(tmp_path / "seed"), ignore)
    assert len({image.robot_id for image in team.true.train}) == 2
    for believed, true in zip(team.believed.train, team.true.train, strict=True):
        assert believed.path == true.path
        assert believed.pose_covariance is not None
        assert np.linalg.norm(believed.T_world_camera[:3, 3] - true.T_world_camera[:3, 3]) < 2
    again = source.team(0, RunFolder(tmp_path / "seed"), ignore)
    for a, b in ((team.true, again.true), (team.believed, again.believed)):
        for first, second in zip(a.train + a.test, b.train + b.test, strict=True):
            np.testing.assert_array_equal(first.T_world_camera, second.T_world_camera)
            assert first.robot_id == second.robot_id
            assert (first.pose_covariance is None) == (second.pose_covariance is None)
    assert again.anchor == team.anchor
    assert team.anchor in {image.robot_id for image in team.true.train}


@pytest.mark.data
def test_real_links_give_errors_as_large_as_their_sigmas(data, tmp_path):
    from mulan.evaluation.table1.recorded_bearings import recorded_bearings

    folder = tmp_path / "wsr"
    for name in ("npz", "reference.csv"):
        (folder / "LOS_Set_A").mkdir(parents=True, exist_ok=True)
        target = data / "wsr_aoa" / "LOS_Set_A" / name
        if name == "npz":
            (folder / "LOS_Set_A" / "npz").mkdir()
            for path in sorted(target.glob("*.npz"))[:4]:
                (folder / "LOS_Set_A" / "npz" / path.name).symlink_to(path)
        else:
            (folder / "LOS_Set_A" / name).symlink_to(target)
    links = recorded_bearings(folder, tmp_path / "bearings.json", 1, ignore)
    assert len(links) == 12
    level = np.array([link.error_rad / link.sigma_rad for link in links])
    assert 0.1 < np.sqrt((level**2).mean()) < 3
    assert recorded_bearings(folder, tmp_path / "bearings.json", 1, ignore) == links
