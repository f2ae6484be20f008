"""The controls beside the picture."""

from collections.abc import Callable
from typing import Any

import numpy as np
from viser import GuiApi

from mulan.viewer.engine_access import TrainingEngine
from mulan.viewer.frame import Quantity
from mulan.viewer.mission_layers import LayerChoice
from mulan.viewer.radio_picture import draw_profile

_QUANTITIES: dict[str, Quantity] = {"Colour": "colour", "Depth": "depth", "Uncertainty": "uncertainty"}


class PictureControls:
    """What the picture shows, and how fast it is drawn."""

    def __init__(self, gui: GuiApi, changed: Callable[[Quantity], None]) -> None:
        with gui.add_folder("Picture"):
            choice = gui.add_button_group("Show", tuple(_QUANTITIES), hint="Uncertainty: σ of the colour")
            self._legend = gui.add_markdown("")

        @choice.on_click
        def _(_: object) -> None:
            changed(_QUANTITIES[str(choice.value)])

    def say(self, text: str) -> None:
        """Show a line below the choice."""
        if self._legend.content != text:
            self._legend.content = text


class LayerControls:
    """Which layers are in the scene, and until when in the mission."""

    def __init__(
        self,
        gui: GuiApi,
        span_s: tuple[float, float] | None,
        has_truth: bool,
        exaggeration: int,
        changed: Callable[[], None],
    ) -> None:
        with gui.add_folder("In the scene"):
            boxes = {"photographs": gui.add_checkbox("Photographs", True)}
            if span_s is not None:
                boxes["paths"] = gui.add_checkbox("Paths", True)
                if has_truth:
                    boxes["truth"] = gui.add_checkbox("True paths", True)
                size = "true size" if exaggeration == 1 else f"drawn {exaggeration}×"
                boxes["ellipsoids"] = gui.add_checkbox(f"95 % regions ({size})", True)
                boxes["bearings"] = gui.add_checkbox("Radio bearings", False)
            boxes["candidates"] = gui.add_checkbox("Proposed views", True)
            slider = None
            if span_s is not None and span_s[1] > span_s[0]:
                step = (span_s[1] - span_s[0]) / 200
                slider = gui.add_slider("Time [s]", span_s[0], span_s[1], step, span_s[1])
        self._boxes, self._slider, self._span_s = boxes, slider, span_s

        for box in boxes.values():
            box.on_update(lambda _: changed())
        if slider is not None:
            slider.on_update(lambda _: changed())

    def lengthen(self, span_s: tuple[float, float]) -> None:
        """The mission has gone on; who looked at its end still does."""
        if self._slider is None or self._span_s is None or span_s[1] <= self._span_s[1]:
            return
        at_end = self._slider.value >= self._span_s[1]
        self._span_s = self._span_s[0], span_s[1]
        self._slider.max = span_s[1]
        if at_end:
            self._slider.value = span_s[1]

    def further(self) -> tuple[bool, bool]:
        """Whether photographs and candidates are wanted."""
        return self._boxes["photographs"].value, self._boxes["candidates"].value

    def choice(self) -> LayerChoice:
        """As the boxes stand."""
        on = {name: box.value for name, box in self._boxes.items()}
        at_end = self._slider is None or self._span_s is None or self._slider.value >= self._span_s[1]
        return LayerChoice(
            paths=on.get("paths", False),
            truth=on.get("truth", False),
            ellipsoids=on.get("ellipsoids", False),
            bearings=on.get("bearings", False),
            until_s=np.inf if at_end or self._slider is None else float(self._slider.value),
        )


class TrainingControls:
    """Pause, step, and how far the training is."""

    def __init__(self, gui: GuiApi, training: TrainingEngine) -> None:
        self._training, self._ended = training, False
        with gui.add_folder("Training"):
            self._words = gui.add_markdown("begins ...")
            pause = gui.add_button("Pause")
            step = gui.add_button("One step", disabled=True)

        @pause.on_click
        def _(_: object) -> None:
            if training.paused:
                training.go_on()
            else:
                training.pause()
            pause.label = "Go on" if training.paused else "Pause"
            step.disabled = not training.paused

        @step.on_click
        def _(_: object) -> None:
            training.one_step()

        self._buttons = pause, step

    def refresh(self) -> None:
        """Show the latest figures."""
        status = self._training.status
        if status is not None and not self._ended:
            state = "paused" if self._training.paused else f"{100 * status.fraction_done:.0f} % done"
            self._words.content = (
                f"**{status.steps}** steps, {state}, {status.train_psnr_db:.1f} dB on training photographs"
            )

    def end(self) -> None:
        """Nothing to control any more."""
        self._ended = True
        for button in self._buttons:
            button.disabled = True
        self._words.content = "finished"


def add_figures(gui: GuiApi, metrics: dict[str, Any], history: list[dict[str, Any]] | None) -> None:
    """Figures of merit, and the curve of the training."""
    lines = []
    if isinstance(metrics.get("psnr_db"), int | float):
        lines.append(f"**{metrics['psnr_db']:.2f} dB** PSNR on held-out photographs")
    if isinstance(metrics.get("ssim"), int | float):
        lines.append(f"{metrics['ssim']:.3f} SSIM")
    points = [(p["seconds"], p["train_psnr_db"]) for p in history or [] if p.get("train_psnr_db") is not None]
    if not lines and len(points) < 2:
        return
    with gui.add_folder("Figures"):
        if lines:
            gui.add_markdown("  \n".join(lines))
        if len(points) >= 2:
            seconds, psnr_db = np.array(points, dtype=float).T
            gui.add_uplot(
                (seconds, psnr_db),
                ({"label": "s"}, {"label": "PSNR [dB]", "stroke": "#3b82f6", "width": 2}),
                scales={"x": {"time": False}},
                title="PSNR of the training photographs",
                aspect=1.8,
            )


def add_radio(gui: GuiApi, localization: dict[str, Any]) -> None:
    """The profile of the sharpest link, where the run keeps one."""
    if localization.get("profile"):
        with gui.add_folder("Radio", expand_by_default=False):
            gui.add_image(draw_profile(localization["profile"]), format="png")
