"""What an export begins with: a run's photographs at their best poses, and its field if it has one."""

from dataclasses import dataclass
from typing import Literal

from mulan.errors import InputError
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.field_file import FieldDescription, load_field
from mulan.reconstruction.refinement.refine import REFINED

Poses = Literal["best", "refined", "localized"]


@dataclass(frozen=True)
class ExportedRun:
    """One run's photographs.

    Attributes:
        run: Its folder.
        images: Photographs with poses in the run's world: the first robot's start frame, in metres.
        refined: Whether the poses of the training images are those corrected while the field was learnt.
    """

    run: RunFolder
    images: PosedImageSet
    refined: bool

    @staticmethod
    def of(run: RunFolder, poses: Poses = "best") -> "ExportedRun":
        """Read a run's posed images.

        Args:
            run: Its folder.
            poses: Which ones; the best are the refined ones if the run's field was learnt at them.

        Raises:
            InputError: The run has no poses, or no refined ones and these were asked for.
        """
        path = run.root / REFINED
        if poses == "refined" and not path.exists():
            raise InputError(path, "file", "does not exist", "make it with 'mulan train --refine-poses'")
        if poses == "refined" or (poses == "best" and path.exists() and _field_follows(run)):
            return ExportedRun(run, read_transforms(path), True)
        if not run.transforms.exists():
            raise InputError(
                run.transforms,
                "file",
                "does not exist, so the run has no poses",
                "make it with 'mulan localize', or 'mulan train --data'",
            )
        return ExportedRun(run, read_transforms(run.transforms), False)

    def field(self) -> tuple[RadianceEngine, FieldDescription]:
        """The trained field.

        Raises:
            InputError: The run has none, or it is damaged.
        """
        if not self.run.field.exists():
            raise InputError(
                self.run.field,
                "file",
                "does not exist, so the run has no field to export from",
                f"make it with 'mulan train {self.run.root}'",
            )
        return load_field(self.run.field)


def _field_follows(run: RunFolder) -> bool:
    """Whether the last training refined poses; an older file may lie beside a field learnt without."""
    if not run.metrics.exists():
        return True
    return "median_correction_m" in read_json(run.metrics, "mulan train")
