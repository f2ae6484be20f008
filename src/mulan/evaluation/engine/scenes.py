"""What the engine is measured on: a posed image set at a size, and how long it may learn."""

from dataclasses import dataclass, replace
from pathlib import Path

from mulan.errors import InputError
from mulan.mission.image_sets import read_posed_images
from mulan.mission.posed_images import PosedImageSet

HOLD_OUT_EVERY = 8


@dataclass(frozen=True)
class EngineScene:
    """One line of the benchmark.

    Attributes:
        name: Its key in metrics.json.
        data: Folder of the posed image set.
        image_size: Longest image side the field learns from and is scored at.
        budgets_s: Each is a training of its own whose schedule ends there.
        curve_points: How often each training is scored.
    """

    name: str
    data: Path
    image_size: int
    budgets_s: tuple[float, ...]
    curve_points: int

    def images(self) -> PosedImageSet:
        """Its photographs; where the set names no test views, every 8th is held out.

        Raises:
            InputError: The set cannot be read or has nothing to score.
        """
        images = read_posed_images(self.data, HOLD_OUT_EVERY)
        if not images.test:
            raise InputError(self.data, "test images", "there are none to score", "name a set that has some")
        return images


def engine_scenes(lego: Path, fox: Path, budget_scale: float = 1.0) -> tuple[EngineScene, ...]:
    """The object at three sizes and the real place, smallest first so that memory grows."""
    scenes = (
        EngineScene("lego_100", lego, 100, (5.0, 60.0), curve_points=40),
        EngineScene("lego_200", lego, 200, (60.0, 180.0), curve_points=6),
        EngineScene("lego_400", lego, 400, (300.0,), curve_points=3),
        EngineScene("fox_270x480", fox, 480, (15.0, 60.0), curve_points=8),
    )
    return tuple(
        replace(scene, budgets_s=tuple(budget_scale * budget_s for budget_s in scene.budgets_s))
        for scene in scenes
    )
