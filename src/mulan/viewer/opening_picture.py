"""The field from the first camera, kept ready: a browser shows it before it has told where it looks from."""

import threading
from collections.abc import Callable
from contextlib import suppress

from jaxtyping import UInt8
from numpy.typing import NDArray

from mulan.viewer.client_pictures import ClientCamera
from mulan.viewer.engine_access import EngineAccess, NoFieldError
from mulan.viewer.frame import render_frame


class OpeningPicture:
    """Drawn anew in a thread of its own while nobody looks, and sent first to whoever comes.

    It has no depth: what lies behind its surfaces shows through until the browser's own picture comes.
    """

    def __init__(
        self,
        send: Callable[[UInt8[NDArray, "h w 3"]], None],
        engine: EngineAccess,
        view: ClientCamera,
        longest_side: int,
        somebody_looks: Callable[[], bool],
        period_s: float | None,
    ) -> None:
        """Draw it as soon as there is a field.

        Args:
            send: Given the picture, sRGB.
            engine: The field.
            view: The first camera; windows of another shape show it stretched.
            longest_side: Of the picture, pixels.
            somebody_looks: Whether a browser is there, whose own picture must stay.
            period_s: How often a field that still learns is drawn again; None if it only changes when told.
        """
        self._send, self._engine, self._view, self._longest_side = send, engine, view, longest_side
        self._somebody_looks, self._period_s = somebody_looks, period_s
        self._changed, self._gone = threading.Event(), threading.Event()
        self._changed.set()
        self._thread = threading.Thread(target=self._keep_ready, name="opening picture", daemon=True)
        self._thread.start()

    def redraw(self) -> None:
        """The field has changed, or the last browser has gone."""
        self._changed.set()

    def stop(self) -> None:
        """Nobody will come any more."""
        self._gone.set()
        self._changed.set()
        self._thread.join(timeout=10)

    def _keep_ready(self) -> None:
        with suppress(NoFieldError):  # a training that failed before its first step
            while True:
                self._changed.wait(self._period_s)
                self._changed.clear()
                if self._gone.is_set():
                    return
                if not self._somebody_looks():
                    self._draw()

    def _draw(self) -> None:
        camera, T = self._view.camera(self._longest_side), self._view.T_world_camera
        frame = self._engine.use(lambda engine: render_frame(engine, camera, T, "colour", preview=True))
        if not self._somebody_looks() and not self._gone.is_set():
            self._send(frame.picture)
