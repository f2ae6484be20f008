"""The whole pipeline: robots on continuous tours past the photographs, localized by odometry and radio."""

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mulan.evaluation.oracle import oracle_images
from mulan.evaluation.table1.sources import Progress, TeamSource
from mulan.evaluation.table1.team import Split, Team, share_photographs
from mulan.localization.accuracy import world_from_truth
from mulan.localization.localize import LocalizationConfig, localize
from mulan.localization.posed_images import localized_images
from mulan.localization.run_files import write_localization
from mulan.mission.extract import extract_photos
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.mission.types import Mission
from mulan.simulation.from_images import ImageMissionConfig, simulate_from_images
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import TourConfig
from mulan.wireless.bearing import BearingConfig


@dataclass(frozen=True)
class LoopSource(TeamSource):
    """Drifting odometry, CSI and UWB are simulated along tours, and the graph finds the poses.

    No robot is exact: the anchor drifts too. The world is the anchor's start frame.

    Attributes:
        images: The set at its true poses.
        split: Who takes which photograph.
        metres_per_unit: Size of one unit of the set's poses.
        tour: Pace of the robots.
        sensors: Noise of odometry, WiFi and UWB.
        localization: Options of the graph.
        bearings: Options of the radio.
    """

    images: PosedImageSet
    split: Split = Split.AZIMUTH
    metres_per_unit: float = 1.0
    tour: TourConfig = field(default_factory=TourConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)
    bearings: BearingConfig = field(default_factory=BearingConfig)

    def team(self, seed: int, run: RunFolder, progress: Progress) -> Team:
        """See :class:`TeamSource`; a localization finished earlier with the same options is kept.

        Raises:
            InputError: The set cannot be flown past, or a robot cannot be placed.
        """
        true, believed = run.root / "true.json", run.root / "believed.json"
        record, made_from = run.root / "team.json", self._made_from(seed)
        if record.exists() and true.exists() and believed.exists():
            kept = read_json(record, "mulan evaluate table1")
            if kept.get("made_from") == made_from:
                return Team(read_transforms(true), read_transforms(believed), kept["anchor"])
        team = self._localized(seed, run, progress)
        write_transforms(team.true, true)
        write_transforms(team.believed, believed)
        write_json(record, {"made_from": made_from, "anchor": team.anchor})
        # rotations are made orthonormal as they are read: as every later call will have them
        return Team(read_transforms(true), read_transforms(believed), team.anchor)

    def mission(self, seed: int) -> Mission:
        """What the robots record.

        Raises:
            InputError: The set cannot be flown past.
        """
        images, split = self.images, "azimuth"
        if self.split is Split.RANDOM:
            split = "random"
        elif self.split is Split.FIFTEEN:
            alpha, beta = share_photographs(images, self.split, np.random.default_rng([seed, 3]))
            images = replace(images, train=(*alpha, *beta))
        return simulate_from_images(
            images,
            ImageMissionConfig(
                split=split,
                metres_per_unit=self.metres_per_unit,
                seed=seed,
                tour=self.tour,
                sensors=self.sensors,
            ),
        )

    def _localized(self, seed: int, run: RunFolder, progress: Progress) -> Team:
        mission = self.mission(seed)
        files = extract_photos(mission, run)
        T_world_truth = world_from_truth(mission)
        assert T_world_truth is not None  # simulated robots know
        localization = localize(mission, self.localization, self.bearings, progress)
        write_localization(localization, mission, run)
        return Team(
            oracle_images(mission, files, T_world_truth),
            localized_images(mission, localization, files, T_world_truth),
            localization.anchor,
        )

    def _made_from(self, seed: int) -> str:
        simulated = (self.split, self.metres_per_unit, self.tour, self.sensors)
        digest = hashlib.sha256(f"{seed} {simulated} {self.localization} {self.bearings}".encode())
        for image in (*self.images.train, *self.images.test):
            digest.update(f"{_size(image.path)} {image.camera}".encode() + image.T_world_camera.tobytes())
        return digest.hexdigest()[:16]


def _size(path: Path) -> str:
    return f"{path.name} {path.stat().st_size}"
