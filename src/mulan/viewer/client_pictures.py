"""What one browser sees: coarse pictures while its camera moves, a fine one once it stands still."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from viser import ClientHandle

from mulan.geometry import se3, so3
from mulan.geometry.camera import R_OPTICAL_OPENGL, PinholeCamera
from mulan.mission.pixels import resized_shape
from mulan.viewer.engine_access import EngineAccess
from mulan.viewer.frame import AbandonedError, Frame, Quantity, pinhole, render_frame
from mulan.viewer.viewer_config import PictureConfig

_REST_S = 0.15  # a camera that has not moved for so long stands still
_FIRST_REST_S = 1.0  # a browser that has just opened needs the processor to show the first picture
_PATIENCE_S = 0.5  # between looks at whether the client is still there
_MOVING_DEPTH_STRIDE = 2  # viser sends depth as PNG: at full size it costs a tenth of a moving picture


@dataclass(frozen=True)
class ClientCamera:
    """Where a browser looks from.

    Attributes:
        T_world_camera: OpenGL axes.
        vertical_fov_rad: Angle the window's height sees.
        width, height: Window, pixels.
    """

    T_world_camera: Float[NDArray, "4 4"]
    vertical_fov_rad: float
    width: int
    height: int

    def camera(self, longest_side: int) -> PinholeCamera:
        """The lens of a picture of that size."""
        return pinhole(*resized_shape(self.width, self.height, longest_side), self.vertical_fov_rad)


def camera_of(client: ClientHandle) -> ClientCamera:
    """The browser's camera; viser's has OpenCV axes and a quaternion (w, x, y, z)."""
    camera = client.camera
    w, x, y, z = camera.wxyz
    R = so3.from_quaternion(np.array([x, y, z, w])) @ R_OPTICAL_OPENGL
    width, height = camera.image_width or 640, camera.image_height or 360
    return ClientCamera(se3.from_parts(R, np.asarray(camera.position, float)), camera.fov, width, height)


class ClientPictures:
    """Draws one browser's background until it goes away.

    Attributes:
        frames: Pictures drawn so far.
        last: The latest one.
        seconds_a_frame: What the latest took, drawing and sending.
    """

    def __init__(
        self,
        client: ClientHandle,
        engine: EngineAccess,
        config: PictureConfig,
        still_learns: bool,
        after_first: Callable[[], None],
    ) -> None:
        """Begin at once, in a thread of its own.

        Args:
            client: The browser.
            engine: The field.
            config: Sizes.
            still_learns: Whether a standing picture has to be drawn again now and then.
            after_first: Called once the first fine picture has been sent.
        """
        self._client, self._engine, self._config = client, engine, config
        self._changed, self._gone = threading.Event(), threading.Event()
        self._still_learns, self._after_first = still_learns, after_first
        self.quantity: Quantity = "colour"
        self.frames, self.seconds_a_frame = 0, 0.0
        self.last: Frame | None = None
        client.camera.on_update(lambda _: self.redraw())
        self._changed.set()
        self._thread = threading.Thread(target=self._draw, name="client pictures", daemon=True)
        self._thread.start()

    def redraw(self) -> None:
        """What is shown has changed: the camera, the quantity or the field."""
        self._changed.set()

    def stop(self) -> None:
        """The browser is gone."""
        self._gone.set()
        self._changed.set()
        self._thread.join(timeout=10)

    def _draw(self) -> None:
        fine, rested_s, complete = True, 0.0, False
        while not self._gone.is_set():
            rest_s = _REST_S if complete else _FIRST_REST_S
            moved = self._changed.wait(_PATIENCE_S if fine else rest_s)
            self._changed.clear()
            if self._gone.is_set():
                return
            if moved:
                self._draw_one(self._config.moving_side, moving=True)
                fine = False
            elif not fine or (self._still_learns and time.monotonic() - rested_s > self._config.refresh_s):
                with suppress(AbandonedError):  # the camera moves again
                    self._draw_one(self._config.still_side)
                    fine, rested_s = True, time.monotonic()
                    if not complete:
                        self._after_first()
                        complete = True

    def _draw_one(self, side: int, moving: bool = False) -> None:
        began = time.monotonic()
        view, quantity = camera_of(self._client), self.quantity
        wanted = (lambda: True) if moving else (lambda: not self._changed.is_set())
        frame = self._engine.use(
            lambda engine: render_frame(
                engine, view.camera(side), view.T_world_camera, quantity, moving, wanted
            )
        )
        stride = _MOVING_DEPTH_STRIDE if moving else 1
        depth_m = frame.depth_m[::stride, ::stride]
        self._client.scene.set_background_image(
            frame.picture, "jpeg", jpeg_quality=self._config.jpeg_quality, depth=depth_m
        )
        self.last, self.frames, self.seconds_a_frame = frame, self.frames + 1, time.monotonic() - began
