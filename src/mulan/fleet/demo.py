"""A whole fleet on one machine: a simulated world, its robots, a base station that learns, a page."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mulan.errors import InputError
from mulan.evaluation.provenance import provenance
from mulan.fleet.soak_processes import Member, free_endpoint
from mulan.fleet.world_folder import WorldFolder
from mulan.localization.accuracy import accuracy, world_from_truth
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize
from mulan.localization.posed_images import localized_images
from mulan.localization.run_files import write_localization
from mulan.mission.bag_reader import read_mission
from mulan.mission.extract import extract_photos
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.mission.types import HeldOutViews, Mission, Photo
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.held_out import evaluate_held_out
from mulan.reconstruction.reconstruct import reconstruct
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights
from mulan.simulation.recording import robot_names
from mulan.wireless.bearing import BearingConfig

_POLL_S = 0.1
_STARTING_S = 300.0  # programs load and a world is built on a busy machine
_MISSION = "demo"

Progress = Callable[[float, float, str], None]


@dataclass(frozen=True)
class DemoConfig:
    """Three simulated robots and a base station that learns while they drive, as separate processes."""

    out: Path
    """Folder to write; the run lies in its folder 'run'."""
    minutes: float = 3.0
    """How long the robots drive."""
    robots: int = 3
    """Number of robots."""
    width: int = 96
    """Image width in pixels."""
    height: int = 72
    """Image height in pixels."""
    samples_per_pixel: int = 16
    """Light paths a pixel."""
    held_out: int = 12
    """Test views."""
    packets_per_second: float = 100.0
    """WiFi packet pairs a second and pair of robots."""
    speed: float = 1.0
    """Mission time a second, where the world is computed as fast."""
    round_s: float = 5.0
    """Seconds of learning between two looks at the bag."""
    goals: bool = True
    """Robots go where the base station wants them; else each only drives its tour."""
    offline: Literal["seconds", "steps", "none"] = "seconds"
    """Afterwards learn from the finished bag for as many seconds, or as many steps, and compare; seconds that
    passed while other programs ran hold fewer steps."""
    learner: tuple[str, ...] = field(default_factory=tuple)
    """Further options of the base station's learner, such as --learn.train.batch-samples 4096."""
    port: int = 8080
    """Of the page; the next free one is taken where it is in use."""
    seed: int = 0
    """Source of all randomness."""


class FleetDemo:
    """Starts the processes, follows them, and judges what was learnt.

    Attributes:
        run: What the base station's learner writes.
        bag: What it received.
    """

    def __init__(self, config: DemoConfig, tell: Callable[[str], object] = lambda _: None) -> None:
        """Prepare.

        Args:
            config: Options.
            tell: Called with a sentence when something happens that a person should know.

        Raises:
            InputError: The folder holds an earlier demo, or cannot be written.
        """
        self.run, self.bag = RunFolder(config.out / "run"), config.out / "mission.mcap"
        if self.bag.exists():
            raise InputError(config.out, "folder", "holds an earlier demo", "choose another --out")
        self.run.check_writable()
        self._config, self._tell = config, tell
        self._world = WorldFolder(config.out / "world")
        names, endpoint = robot_names(config.robots, "demo"), free_endpoint()
        self._base, self._simulator = self._base_member(endpoint, names), self._world_member()
        self._robots = [self._robot_member(name, endpoint) for name in names]
        page = [str(self.run.root), "--no-open-browser", "--viewer.port", str(config.port)]
        self._page = Member("page", page, config.out, "Page:", command="view", writes_figures=False)

    def drive(
        self, page_is_open: Callable[[str], object], enough: Callable[[], bool] = lambda: False
    ) -> None:
        """Run the fleet until the robots have driven and the learner has settled.

        Args:
            page_is_open: Called with the page's address when there is something to see.
            enough: Asked again and again whether the robots may stop before their time.

        Raises:
            InputError: A process failed; the sentence says which and why.
        """
        members = [self._base, self._simulator, *self._robots, self._page]
        try:
            self._start([self._base, self._simulator], lambda: self._world.world.exists())
            self._tell("there is a world; the robots start")
            self._start(self._robots, lambda: all(robot.ready or self._over(robot) for robot in self._robots))
            until_s = time.monotonic() + 180 * self._config.minutes + 4 * _STARTING_S
            told = over = False
            while any(robot.running for robot in self._robots) and time.monotonic() < until_s:
                time.sleep(_POLL_S)
                self._check()
                if not self._page.processes and self.run.field.exists():
                    self._page.start()
                if not over and enough():
                    over = True
                    self._simulator.ask_to_end()
                if not told and (url := self._page_url()) is not None:
                    told = True
                    page_is_open(url)
            self._tell("the robots are done; the learner settles")
            self._base.stop(60 * self._config.minutes + 2 * _STARTING_S)
            self._check()
            if not self.run.metrics.exists():
                problem = f"did not come to an end ({self._base.said()})"
                raise InputError(self._config.out, "learner", problem, "see base-0.log")
        finally:
            for member in reversed(members):
                member.stop(20)

    def judge(self, progress: Progress = lambda *_: None) -> dict[str, Any]:
        """Score the live field on true test views, and one learnt as long from the finished bag.

        Returns:
            What it writes to ``metrics.json``.

        Raises:
            InputError: A file of the demo is missing or damaged.
        """
        config = self._config
        mission = Mission(read_mission(self.bag).robots, self._held_out())
        T_world_truth = world_from_truth(mission)
        assert T_world_truth is not None  # simulated robots send their true poses
        offline = RunFolder(config.out / "offline")
        files = extract_photos(mission, offline)
        bearings = BearingConfig(azimuth_count=180, elevation_count=91)  # as the learner has them
        localization = localize(mission, LocalizationConfig(), bearings)
        localization.require_any_placed()
        write_localization(localization, mission, offline)
        images = localized_images(mission, localization, files, T_world_truth)
        write_transforms(images, offline.transforms)
        live = read_json(self.run.metrics, "mulan fleet demo")
        engine, description = load_field(self.run.field)
        test = load_captured(images.test, max(config.width, config.height))
        live |= evaluate_held_out(engine, test, self.run, sub_pixels=description.sub_pixels)
        write_json(self.run.metrics, live)
        errors = accuracy(localization, mission) or {}
        figures: dict[str, Any] = {
            "provenance": provenance(config.seed),
            "photographs": len(images.train),
            "goals_gone_to": read_json(self._world.over, "mulan fleet world")["obeyed"],
            "camera_rms_m": float(np.sqrt(np.mean([e.position_rms_m**2 for e in errors.values()]))),
            "live": {key: live[key] for key in ("psnr_db", "ssim", "train_seconds", "steps", "begun_anew")},
        }
        if config.offline != "none":
            training = TrainConfig(
                image_size=max(config.width, config.height),
                time_budget_s=live["train_seconds"],
                steps=live["steps"] if config.offline == "steps" else None,
                seed=config.seed,
            )
            again = reconstruct(images, UncertaintyWeights(), training, offline, progress)
            figures["offline"] = {key: again[key] for key in ("psnr_db", "ssim", "train_seconds", "steps")}
            figures["live_minus_offline_db"] = live["psnr_db"] - again["psnr_db"]
        write_json(config.out / "metrics.json", figures)
        return figures

    def _start(self, members: list[Member], ready: Callable[[], bool]) -> None:
        for member in members:
            member.start()
        until_s = time.monotonic() + _STARTING_S
        while not ready():
            self._check()
            if time.monotonic() > until_s:
                problem = "did not start in time"
                raise InputError(self._config.out, members[-1].name, problem, "see the .log files")
            time.sleep(_POLL_S)

    def _check(self) -> None:
        for member in (self._base, self._simulator, *self._robots):
            if member.failed:
                problem = f"failed ({member.said()})"
                raise InputError(self._config.out, member.name, problem, "see its .log file")

    def _over(self, robot: Member) -> bool:
        return bool(robot.processes) and not robot.running

    def _page_url(self) -> str | None:
        if not self._page.processes or not self._page.ready:
            return None
        words = self._page.said().split()
        return words[words.index("Page:") + 1] if "Page:" in words[:-1] else None

    def _held_out(self) -> HeldOutViews | None:
        if not self._config.held_out:
            return None
        images = read_transforms(self._world.held_out).test
        photos = tuple(Photo(float(i), "jpeg", image.path.read_bytes()) for i, image in enumerate(images))
        return HeldOutViews(images[0].camera, photos, np.stack([image.T_world_camera for image in images]))

    def _base_member(self, endpoint: str, names: tuple[str, ...]) -> Member:
        config = self._config
        size = str(max(config.width, config.height))
        arguments = ["base", "--out", str(self.bag), "--mission", _MISSION, "--link.endpoint", endpoint]
        arguments += ["--run", str(self.run.root), "--learn.train.image-size", size]
        arguments += ["--learn.train.seed", str(config.seed), "--learn.round-s", str(config.round_s)]
        # the world's own test views are better ones
        arguments += ["--learn.hold-out-every", "0"]
        # half the grid: peaks are refined from it, and a small machine has more to do
        arguments += ["--learn.bearings.azimuth-count", "180", "--learn.bearings.elevation-count", "91"]
        arguments += ["--learn.goals" if config.goals else "--learn.no-goals", *config.learner]
        return Member("base", [*arguments, "--ingest.robots", *names], config.out, "Listening")

    def _world_member(self) -> Member:
        config = self._config
        arguments = ["world", str(self._world.root), "--minutes", str(config.minutes)]
        for option, value in (
            ("robots", config.robots),
            ("width", config.width),
            ("height", config.height),
            ("samples-per-pixel", config.samples_per_pixel),
            ("held-out", config.held_out),
            ("seed", config.seed),
            ("sensors.radio.packets-per-second", config.packets_per_second),
        ):
            arguments += [f"--scene.{option}", str(value)]
        return Member("world", arguments, config.out, "There is a world", writes_figures=False)

    def _robot_member(self, name: str, endpoint: str) -> Member:
        config = self._config
        arguments = ["robot", "--name", name, "--mission", _MISSION, "--link.endpoint", endpoint]
        arguments += ["--spool", str(config.out / f"{name}.spool"), "--simulate", str(self._world.root)]
        return Member(name, [*arguments, "--speed", str(config.speed)], config.out, "the link is open")
