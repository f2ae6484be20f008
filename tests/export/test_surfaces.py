"""Meshes and points of fields known exactly, and of one that was learnt."""

import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.export import extras
from mulan.export.crop import Box, CropConfig
from mulan.export.density_mesh import density_mesh
from mulan.export.mesh_files import MeshConfig, export_mesh
from mulan.export.ply import write_points
from mulan.export.surface_hits import surface_hits
from mulan.export.surface_points import PointCloudConfig, surface_points
from mulan.radiance.space import SceneSpace

from .analytic import SIDES_M, BoxEngine, around

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")

SPACE = SceneSpace((0.0, 0.0, 0.0), 0.7, False)
BOX = CropConfig().box(SPACE)
LEVEL = 100.0


def silent(done: float, total: float, text: str) -> None:
    pass


@pytest.mark.parametrize("resolution", [20, 47])
def test_a_mesh_has_the_boxs_size_and_is_closed_across_slabs(resolution):
    mesh = density_mesh(BoxEngine(), BOX, resolution, LEVEL, silent)
    solid = trimesh.Trimesh(mesh.position_m, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    voxel_m = 1.4 / resolution
    assert solid.volume == pytest.approx(np.prod(SIDES_M), rel=0.2)
    np.testing.assert_allclose(solid.extents, SIDES_M, atol=voxel_m)
    # the box stands where it stands: no half voxel to either side
    np.testing.assert_allclose(solid.bounds.mean(0), 0, atol=0.01)


def test_matter_that_leaves_the_box_is_closed_where_it_is_cut():
    cut = Box(np.array([0.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]))
    mesh = density_mesh(BoxEngine(), cut, 40, LEVEL, silent)
    solid = trimesh.Trimesh(mesh.position_m, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.bounds[0, 0] == pytest.approx(0.0, abs=0.05)
    assert solid.bounds[1, 0] == pytest.approx(0.5, abs=0.05)


def test_normals_point_outwards():
    mesh = density_mesh(BoxEngine(), BOX, 24, LEVEL, silent)
    assert (mesh.normals() * mesh.position_m).sum(1).min() > 0


def test_ply_and_glb_open_in_trimesh_in_metres_and_colour(tmp_path):
    engine = BoxEngine()
    config = MeshConfig(resolution=40, level_per_m=LEVEL)
    exported = export_mesh(engine, SPACE, around(tmp_path), BOX, config, tmp_path, silent)
    as_ply = trimesh.load(tmp_path / "mesh.ply", process=False)
    as_glb = trimesh.load(tmp_path / "mesh.glb", process=False)
    assert len(as_ply.faces) == exported.triangles
    np.testing.assert_allclose(as_ply.extents, SIDES_M, atol=0.05)
    # glTF has y up: what is highest in the world is highest there
    width, depth, height = SIDES_M
    np.testing.assert_allclose(as_glb.extents, (width, height, depth), atol=0.05)
    inner = next(iter(as_glb.geometry.values()))
    np.testing.assert_allclose(inner.vertices, as_ply.vertices, atol=1e-6)
    colours = as_ply.visual.vertex_colors
    np.testing.assert_array_equal(inner.visual.vertex_colors, colours)
    # the stripes of the ball run around the box too
    azimuth = np.arctan2(as_ply.vertices[:, 1], as_ply.vertices[:, 0])
    expected = 127.5 + 127.5 * np.sin(engine.stripes * azimuth)
    side = np.abs(as_ply.vertices[:, 2]) < 0.15
    assert np.median(np.abs(colours[side, 0] - expected[side])) < 30


def test_what_no_photograph_saw_is_left_out(tmp_path):
    images = around(tmp_path, 1)  # one camera above
    config = MeshConfig(resolution=40, level_per_m=LEVEL)
    seen = export_mesh(BoxEngine(), SPACE, images, BOX, config, tmp_path, silent)
    everything = MeshConfig(resolution=40, level_per_m=LEVEL, only_seen=False)
    whole = export_mesh(BoxEngine(), SPACE, images, BOX, everything, tmp_path / "whole", silent)
    assert seen.triangles < 0.8 * whole.triangles
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert mesh.triangles_center[:, 2].max() > 0.15  # the lid stays
    lowest = mesh.triangles_center[:, 2] < -0.19
    assert lowest.mean() < 0.02  # the underside is gone


def test_a_level_nothing_reaches_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="nowhere in the box reaches"):
        density_mesh(BoxEngine(), BOX, 20, 1e5, silent)


@pytest.mark.parametrize("resolution", [1, 5000])
def test_resolutions_out_of_bounds_are_refused(resolution):
    with pytest.raises(InputError, match="resolution"):
        density_mesh(BoxEngine(), BOX, resolution, LEVEL, silent)


def test_crops_that_are_no_boxes_are_refused():
    for crop in (CropConfig(size_m=(1.0, 0.0, 1.0)), CropConfig(centre_m=(float("nan"), 0.0, 0.0))):
        with pytest.raises(InputError, match="no box"):
            crop.box(SPACE)


def test_a_missing_library_is_one_sentence():
    with pytest.raises(InputError, match=r"pip install 'mulan\[export\]'"):
        extras.extra_module("no_such_module", "no-such-package", "--to mesh")


def test_points_lie_on_the_surface_in_its_colours(tmp_path):
    points = surface_points(
        BoxEngine(steps=720), around(tmp_path), PointCloudConfig(count=3000), None, silent
    )
    assert 2000 < len(points.position_m) <= 3000
    outside_m = np.abs((np.abs(points.position_m) - np.array(SIDES_M) / 2).max(1))
    assert np.quantile(outside_m, 0.99) < 0.02
    write_points(points, tmp_path / "points.ply")
    cloud = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_allclose(cloud.vertices, points.position_m, atol=1e-5)
    np.testing.assert_array_equal(cloud.colors[:, :3], points.colour)


def test_points_keep_to_the_crop(tmp_path):
    crop = Box(np.array([0.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]))
    points = surface_points(BoxEngine(), around(tmp_path), PointCloudConfig(count=500), crop, silent)
    assert points.position_m[:, 0].min() >= 0
    nowhere = Box(np.array([5.0, 5.0, 5.0]), np.array([6.0, 6.0, 6.0]))
    with pytest.raises(InputError, match="no surface"):
        surface_points(BoxEngine(), around(tmp_path), PointCloudConfig(count=500), nowhere, silent)


def test_rays_that_see_two_surfaces_are_not_sharp():
    class Curtain(BoxEngine):
        """A thin curtain that stops some light, and a wall behind it."""

        def density(self, points):
            x = points[:, 0]
            curtain = (x.abs() < 0.1) * 5.0
            return torch.where(x > 1.0, 50.0, curtain)

    origins = torch.tensor([[-1.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    hits = surface_hits(Curtain(), origins, torch.tensor([[1.0, 0.0, 0.0]]).repeat(2, 1))
    assert hits.sharpness[0] < 0.7 < hits.sharpness[1]
    assert float(hits.distance_m[1]) == pytest.approx(0.5, abs=0.05)
