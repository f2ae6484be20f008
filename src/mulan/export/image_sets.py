"""Posed photographs for other trainers: nerfstudio's ``transforms.json`` and COLMAP's sparse model."""

from pathlib import Path

from mulan.geometry.camera import PinholeCamera
from mulan.mission.colmap.model import ColmapImage, ColmapModel
from mulan.mission.colmap.write_model import write_model
from mulan.mission.coloured_points import ColouredPoints
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.placed_images import place_images
from mulan.mission.posed_images import PosedImageSet


def export_nerfstudio(
    images: PosedImageSet, folder: Path, link: bool, points_file: Path | None = None
) -> Path:
    """Write ``<folder>/transforms.json`` and ``<folder>/images``; returns the JSON file.

    Held-out views become nerfstudio's ``val`` and ``test`` splits.

    Args:
        images: Photographs and poses; metric scale and frame are kept.
        folder: Target.
        link: See :func:`place_images`.
        points_file: A point cloud in the same frame, named in ``ply_file_path`` for trainers that begin from
            points.

    Raises:
        InputError: A photograph is missing, or the folder cannot be written.
    """
    placed = place_images(images, folder / "images", link)
    path = folder / "transforms.json"
    write_transforms(placed, path, points_file)
    return path


def export_colmap(
    images: PosedImageSet, folder: Path, link: bool, points: ColouredPoints | None, as_text: bool = False
) -> Path:
    """Write ``<folder>/sparse/0`` and ``<folder>/images``; returns the model's folder.

    One COLMAP unit is one metre, the world is the run's. Held-out views are not told apart in this format.

    Args:
        images: Photographs and poses.
        folder: Target.
        link: See :func:`place_images`.
        points: Surface points for ``points3D``, without tracks; None leaves it empty.
        as_text: Text files instead of binary ones.

    Raises:
        InputError: A photograph is missing, or the folder cannot be written.
    """
    placed = place_images(images, folder / "images", link)
    target = folder / "sparse" / "0"
    write_model(_model(placed), points, target, as_text)
    return target


def _model(images: PosedImageSet) -> ColmapModel:
    ids: dict[PinholeCamera, int] = {}
    posed = []
    for image in (*images.train, *images.test):
        key = ids.setdefault(image.camera, len(ids) + 1)
        posed.append(ColmapImage(image.path.name, key, image.T_world_camera))
    return ColmapModel({key: camera for camera, key in ids.items()}, tuple(posed))
