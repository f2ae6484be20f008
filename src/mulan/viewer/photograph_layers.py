"""Photographs in the scene: each a frustum at its camera's pose with the picture in it."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image
from viser import CameraFrustumHandle, SceneApi, SceneNodePointerEvent, ViserServer

from mulan.geometry import so3
from mulan.geometry.camera import R_OPTICAL_OPENGL, PinholeCamera
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.report.charts import colour_of
from mulan.viewer.mission_layers import rgb

_ROOT = "/photographs"
_THUMBNAIL_SIDE = 96
_MOST_PHOTOGRAPHS = 150  # more would hide the scene, and slow the browser


def optical_wxyz(T_world_camera: Float[NDArray, "4 4"]) -> tuple[float, float, float, float]:
    """Orientation (w, x, y, z) of a camera with OpenGL axes for viser, whose cameras have OpenCV axes."""
    x, y, z, w = so3.to_quaternion(T_world_camera[:3, :3] @ R_OPTICAL_OPENGL)
    return float(w), float(x), float(y), float(z)


def add_frustum(
    scene: SceneApi,
    name: str,
    camera: PinholeCamera,
    T_world_camera: Float[NDArray, "4 4"],
    colour: tuple[int, int, int],
    scale_m: float,
    picture: NDArray[np.uint8] | None = None,
) -> CameraFrustumHandle:
    """Draw one camera."""
    return scene.add_camera_frustum(
        name,
        fov=2 * np.arctan(camera.height / (2 * camera.fy)),
        aspect=camera.width / camera.height,
        scale=scale_m,
        thickness=1.5,
        thickness_units="screen",
        color=colour,
        image=picture,
        wxyz=optical_wxyz(T_world_camera),
        position=tuple(T_world_camera[:3, 3]),
        cast_shadow=False,
    )


class PhotographLayers:
    """The training photographs of a run; a click on one moves the visitor's camera there.

    Attributes:
        images: Those that are drawn.
    """

    def __init__(self, server: ViserServer, images: PosedImageSet, scale_m: float) -> None:
        every = max(1, -(-len(images.train) // _MOST_PHOTOGRAPHS))
        self._server, self._scale_m = server, scale_m
        self.images = images.train[::every]
        self._robots = sorted({image.robot_id or "camera" for image in images.train})
        self._frusta: list[CameraFrustumHandle] = []

    def remove(self) -> None:
        """Take all of them out of the scene."""
        for handle in self._frusta:
            handle.remove()
        self._frusta = []

    def show(self, visible: bool, until_s: float = np.inf) -> None:
        """Show the photographs taken by a time, or none."""
        if visible and not self._frusta:
            self._frusta = [self._add(index) for index in range(len(self.images))]
        for image, handle in zip(self.images, self._frusta, strict=bool(self._frusta)):
            handle.visible = visible and (image.timestamp_s is None or image.timestamp_s <= until_s)

    def _add(self, index: int) -> CameraFrustumHandle:
        image = self.images[index]
        colour = rgb(colour_of(self._robots.index(image.robot_id or "camera")))
        handle = add_frustum(
            self._server.scene,
            f"{_ROOT}/{index}",
            image.camera,
            image.T_world_camera,
            colour,
            self._scale_m,
            _thumbnail(image),
        )
        self._go_there_on_click(self._server, image, handle)
        return handle

    def _go_there_on_click(self, server: ViserServer, image: PosedImage, handle: CameraFrustumHandle) -> None:
        @handle.on_click
        def _(event: SceneNodePointerEvent[CameraFrustumHandle]) -> None:
            client = server.get_clients().get(event.client_id)
            if client is not None:
                with client.atomic():
                    client.camera.position = image.T_world_camera[:3, 3]
                    client.camera.wxyz = np.array(optical_wxyz(image.T_world_camera))


def _thumbnail(image: PosedImage) -> NDArray[np.uint8] | None:
    """A small copy; None where the file cannot be read, which is for 'mulan train' to complain of."""
    try:
        with Image.open(image.path) as picture:
            picture.draft("RGB", (_THUMBNAIL_SIDE, _THUMBNAIL_SIDE))
            picture.thumbnail((_THUMBNAIL_SIDE, _THUMBNAIL_SIDE))
            flat = Image.new("RGB", picture.size, "white")
            flat.paste(picture, mask=picture.getchannel("A") if picture.mode == "RGBA" else None)
            return np.asarray(flat)
    except (OSError, ValueError):
        return None
