"""A COLMAP model and its photographs as a posed image set."""

from pathlib import Path

from mulan.errors import InputError
from mulan.mission import pixels
from mulan.mission.colmap.read_model import find_model, read_model
from mulan.mission.posed_images import PosedImage, PosedImageSet


def read_colmap_images(
    folder: Path, image_folder: Path | None = None, metres_a_unit: float = 1.0
) -> PosedImageSet:
    """Read a model below a folder (``sparse/0``, ``sparse`` or the folder itself) and find its photographs.

    Args:
        folder: The project.
        image_folder: Photographs; ``images`` in the project or beside the model if not given.
        metres_a_unit: COLMAP's scale is arbitrary; positions are multiplied by this.

    Raises:
        InputError: There is no model, it cannot be used, or a photograph is missing or of another size than
            its camera.
    """
    at = find_model(folder)
    if at is None:
        raise InputError(
            folder, "folder", "holds no COLMAP model", "name a folder with cameras.bin or cameras.txt"
        )
    if not 0 < metres_a_unit < float("inf"):
        raise InputError("--scale", "value", f"is {metres_a_unit}", "give metres a COLMAP unit, above zero")
    model = read_model(at)
    places = (
        [image_folder] if image_folder else [folder / "images", at / "images", at.parent.parent / "images"]
    )
    images = []
    for image in sorted(model.images, key=lambda image: image.name):
        path = next((place / image.name for place in places if (place / image.name).is_file()), None)
        if path is None:
            raise InputError(
                places[0] / image.name,
                "image",
                "does not exist",
                "name the photographs' folder with --images",
            )
        camera = model.cameras[image.camera_id]
        width, height = pixels.image_size(path, str(path))
        if (width, height) != (camera.width, camera.height):
            # the same photographs scaled down, as trainers like them
            if abs(width / camera.width - height / camera.height) > 0.02:
                raise InputError(
                    path,
                    "image",
                    f"has {width}x{height} pixels, its camera {camera.width}x{camera.height}",
                    "give the photographs COLMAP saw, or these scaled",
                )
            camera = camera.resized(width, height)
        T = image.T_world_camera.copy()
        T[:3, 3] *= metres_a_unit
        images.append(PosedImage(path, camera, T))
    return PosedImageSet(tuple(images), (), folder)
