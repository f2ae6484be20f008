import numpy as np
import torch

from mulan.geometry import se3, so3
from mulan.mission.posed_images import PosedImage
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.scene_space import choose_space, look_at_centre

from .cube_scene import cube_images


def test_a_cut_out_object_lies_inside_the_box_whatever_the_yaw_of_the_world(tmp_path):
    images = cube_images(tmp_path).train
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    for yaw in np.linspace(0, np.pi / 2, 5):
        T = se3.from_parts(so3.about_z(yaw), np.array([4.0, -2.0, 1.0]))
        moved = [PosedImage(i.path, i.camera, T @ i.T_world_camera) for i in images]
        space = choose_space(load_captured(moved, None))
        assert not space.unbounded
        unit = space.to_unit(torch.from_numpy(corners @ T[:3, :3].T + T[:3, 3]))
        assert ((unit > 0) & (unit < 1)).all()
        assert space.radius_m < 2 * 0.5 * np.sqrt(3)


def test_photographs_with_a_background_make_an_unbounded_space_about_what_they_look_at(tmp_path):
    space = choose_space(load_captured(cube_images(tmp_path, opaque=True).train, None))
    assert space.unbounded
    np.testing.assert_allclose(space.centre_m, 0, atol=1e-3)
    assert 2.4 < space.radius_m < 3.0


def test_cameras_that_look_outward_surround_the_centre():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    forward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    centre, distance_m = look_at_centre(0.5 * forward + 7.0, forward)
    np.testing.assert_allclose(centre, 7.0, atol=1e-3)
    assert 0.2 < distance_m < 2.0


def test_parallel_or_single_cameras_get_a_finite_space_in_front_of_them():
    for origins in (np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])):
        forward = np.tile([0.0, 1.0, 0.0], (len(origins), 1))
        centre, distance_m = look_at_centre(origins, forward)
        assert centre[1] > 0
        assert 0 < distance_m < 10
