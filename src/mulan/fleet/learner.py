"""Localizes and learns beside the base station, from the bag it writes, while messages arrive."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.fleet.growing_bag import GrowingBag
from mulan.fleet.live_state import LiveRobot, LiveState, write_state
from mulan.fleet.measurement_requests import measurement_requests
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements
from mulan.localization.posed_images import localized_images
from mulan.localization.run_files import write_localization
from mulan.localization.scheduling import SchedulingConfig
from mulan.localization.types import Localization
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_atomically, write_json
from mulan.mission.types import Mission, RobotLog
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.knowledge import Knowledge, LookConfig
from mulan.planning.plan import ViewPlan
from mulan.planning.run_files import last_views, looked_at_m, plan_as_json, write_plan
from mulan.planning.team_plan import TeamPlanConfig, plan_team
from mulan.planning.view import View
from mulan.reconstruction.held_out import evaluate_held_out
from mulan.reconstruction.live_training import LiveTraining
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.ranging import thin_ranges
from mulan.wireless.remembered_bearings import RememberedBearings

_LOOK_AGAIN_S = 0.5
_SUFFIX = {"jpeg": "jpg", "png": "png"}


@dataclass(frozen=True)
class LearnConfig:
    """How the base station localizes and learns while messages arrive."""

    round_s: float = 10.0
    """Seconds of learning between two looks at the bag; longer where looking takes longer."""
    fewest_photographs: int = 12
    """Nothing is learnt from fewer: where the scene lies must be seen, or the field is soon begun anew."""
    margin_s: float = 1.0
    """What is newer than a robot's newest odometry less this waits for the next look: it may lack parts."""
    hold_out_every: int = 8
    """Every n-th photograph of a robot is held out, for the training curve; 0 holds out none."""
    idle_s: float = 300.0
    """Learning stands still when nothing has come for so long."""
    settle_share: float = 1.0
    """At the end the field learns from the finished bag for this share of the time learnt until then, while
    the learning rate falls, ..."""
    most_settle_s: float = 300.0
    """... but no longer than this."""
    goals: bool = True
    """Choose where robots should look next."""
    seen_views: int = 12
    """So many photographs, spread evenly over all, stand for what was seen when goals are chosen."""
    train: tyro.conf.AvoidSubcommands[TrainConfig] = field(default_factory=TrainConfig)
    """Training; its time budget is not used."""
    graph: LocalizationConfig = field(default_factory=LocalizationConfig)
    """Factor graph."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """Radio bearings."""
    requests: SchedulingConfig = field(
        default_factory=lambda: SchedulingConfig(position_goal_m=0.05, heading_goal_deg=0.7, most=16)
    )
    """When a pair of robots is asked to measure."""
    looks: LookConfig = field(default_factory=lambda: LookConfig(columns=12, chosen_columns=24))
    """Rays of a look at a view, when goals are chosen."""
    plan: TeamPlanConfig = field(
        default_factory=lambda: TeamPlanConfig(free_space=FreeSpaceConfig(places=4), refinements=0)
    )
    """Candidate views; the field itself tells what is free and seen."""


class Learner:
    """Turns a growing bag into a run folder, round by round: look, localize, learn, plan.

    Localization is the batch solution over the bag so far, each bearing estimated once: every photograph's
    pose and covariance improve with what came after it, and the last round gives what ``mulan localize``
    would. Started again, it reads the bag and its checkpoint and goes on.

    Attributes:
        run: Folder it writes.
        training: The field.
        rounds: Looks at the bag that brought something new.
    """

    def __init__(
        self, bag: Path, run: RunFolder, config: LearnConfig, tell: Callable[[str], object] = lambda _: None
    ) -> None:
        """Prepare; the bag need not exist yet.

        Args:
            bag: What a base station writes.
            run: Folder to write.
            config: Options.
            tell: Called with a sentence when something happens that a person should know.

        Raises:
            InputError: The folder cannot be written, or holds a checkpoint of other options.
        """
        run.check_writable()
        self.run, self.rounds = run, 0
        self.training = LiveTraining(run, config.train, UncertaintyWeights())
        self._config, self._tell = config, tell
        self._bag = GrowingBag(bag)
        self._bearings = RememberedBearings()
        self._images: PosedImageSet | None = None
        self._robots: dict[str, LiveRobot] = {}
        self._told = ""

    def follow(self, stop: Callable[[], bool] = lambda: False) -> bool:
        """Go on until the bag is finished, then settle; whether it came to that before it was told to stop.

        Raises:
            InputError: The disk is full, or the bag is none a base station writes.
        """
        heard_s = time.monotonic()
        while not stop():
            finished, began_s = self._bag.finished, time.monotonic()
            news = self.look(0.0 if finished else self._config.margin_s, last=finished)
            if finished:
                if not self._settled():
                    self._settle(stop)
                return not stop()
            heard_s = time.monotonic() if news else heard_s
            if self._images is None or time.monotonic() - heard_s > self._config.idle_s:
                _wait(_LOOK_AGAIN_S, stop)
                continue
            looking_s = time.monotonic() - began_s
            self.training.learn(max(self._config.round_s, looking_s), stop)
            self.training.save()
            planning_s = time.monotonic()
            if news and not stop():
                self._plan()
                self._say(
                    f"{self.training.progress.seconds:.0f} s learnt; looking took {looking_s:.1f} s,"
                    f" planning {time.monotonic() - planning_s:.1f} s"
                )
        return False

    def look(self, margin_s: float, last: bool = False) -> bool:
        """Read what is new and localize with it; whether there was anything.

        Args:
            margin_s: What is newer than a robot's newest odometry less this is left for later.
            last: Whether nothing will come after this; then the picture of it is drawn too.

        Raises:
            InputError: The disk is full, or the bag is none a base station writes.
        """
        if not self._bag.read() and not last:
            return False
        try:
            mission = self._bag.mission(margin_s)
            localization = None if mission is None else self._localize(mission)
        except InputError as error:
            # a recording's beginning can be of no use by itself
            self._say(f"not localized yet: {error}")
            return True
        if mission is None or localization is None:
            return True
        self._take(mission, localization, last)
        return True

    def _localize(self, mission: Mission) -> Localization:
        config = self._config
        bearings = estimate_bearings(mission.robots, config.bearings, of_aperture=self._bearings)
        self._bearings.forget_others()
        ranges = thin_ranges(mission.robots, config.graph.ranging)
        return localize_from_measurements(mission.robots, bearings, ranges, config.graph)

    def _take(self, mission: Mission, localization: Localization, last: bool) -> None:
        """Show the training what was localized."""
        write_localization(localization, mission, self.run, picture=last)
        files = _photograph_files(mission, self.run)
        images = localized_images(mission, localization, files, None, self._config.hold_out_every)
        self.rounds += 1
        placed = ", ".join(localization.trajectories)
        waiting = "".join(f"; {robot.sentence()}" for robot in localization.undetermined)
        self._say(f"{len(images.train)} photographs of {placed}{waiting}")
        if len(images.train) < self._config.fewest_photographs:
            return
        self._images = images
        write_transforms(images, self.run.transforms)
        self.training.show(images)
        requests = measurement_requests(localization, self._config.requests)
        self._robots = {
            robot.name: replace(_live_robot(robot, localization), measure_with=requests.get(robot.name))
            for robot in mission.robots
            if robot.name in localization.trajectories and robot.photos
        }
        self._write_state(self._robots)

    def _plan(self) -> ViewPlan | None:
        """Choose where every robot should look next, and say so in plan.json and live.json."""
        engine, images = self.training.engine, self._images
        if not self._config.goals or engine is None or images is None:
            return None
        every = max(1, -(-len(images.train) // self._config.seen_views))
        # the newest are always among them
        seen = [
            View(image.camera, image.T_world_camera, image.pose_covariance)
            for image in _by_time(images)[::-1][::every]
            if image.pose_covariance is not None
        ]
        knowledge = Knowledge([engine], self.training.description.space, seen, self._config.looks)
        plan = plan_team(knowledge, engine, last_views(images), looked_at_m(images), self._config.plan)
        write_json(self.run.plan, plan_as_json(plan))
        goals = _goals(plan)
        self._robots = {
            name: replace(robot, T_world_camera_goal=goals.get(name)) for name, robot in self._robots.items()
        }
        self._write_state(self._robots)
        return plan

    def _settled(self) -> bool:
        """Whether an earlier process came to the end of this very bag."""
        if not (self.run.metrics.exists() and self.run.field.exists()):
            return False
        return read_json(self.run.metrics, "mulan fleet learn").get("messages") == self._bag.received

    def _settle(self, stop: Callable[[], bool]) -> None:
        """Nothing more will come: let the rate fall, and judge the field."""
        if self._images is None or self.training.engine is None:
            self._say("the bag ended before anything could be learnt from it")
            return
        config, learnt_s = self._config, self.training.progress.seconds
        settle_s = min(config.settle_share * learnt_s, config.most_settle_s)
        self.training.cool_down(max(settle_s, config.round_s), stop)
        self.training.save()
        if stop():
            return
        plan = self._plan()
        if plan is not None:
            write_plan(self.run, self._images, plan, self.training.engine)
        progress, description = self.training.progress, self.training.description
        metrics = {
            "train_seconds": progress.seconds,
            "steps": progress.steps,
            "samples_per_s": progress.samples / max(progress.seconds, 1e-9),
            "rounds": self.rounds,
            "messages": self._bag.received,
            "begun_anew": self.training.begun_anew,
        }
        metrics |= evaluate_held_out(
            self.training.engine, self.training.test, self.run, sub_pixels=description.sub_pixels
        )
        write_json(self.run.metrics, metrics)

    def _write_state(self, robots: Mapping[str, LiveRobot]) -> None:
        write_state(LiveState(time.time_ns(), robots), self.run)

    def _say(self, text: str) -> None:
        if text != self._told:
            self._told = text
            self._tell(text)


def _live_robot(robot: RobotLog, localization: Localization) -> LiveRobot:
    """A robot as it stood at its last photograph."""
    trajectory = localization.trajectories[robot.name]
    at = trajectory.time_s[-1:]
    T_odom_body = se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, at)[0]
    T_world_body = trajectory.T_world_body[-1]
    T_world_odom = T_world_body @ se3.inverse(T_odom_body)
    return LiveRobot(float(at[0]), T_world_body, trajectory.covariance[-1], T_world_odom, robot.T_body_camera)


def _by_time(images: PosedImageSet) -> list[PosedImage]:
    return sorted(images.train, key=lambda image: image.timestamp_s or 0.0)


def _goals(plan: ViewPlan) -> dict[str, Float[NDArray, "4 4"]]:
    return {
        robot.robot.robot: robot.T_world_candidate[robot.best]
        for robot in plan.robots
        if robot.best is not None
    }


def _photograph_files(mission: Mission, run: RunFolder) -> dict[str, list[Path]]:
    """Photographs of a mission as files named after their times, so that one that came late renames no other.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    files: dict[str, list[Path]] = {}
    for robot in mission.robots:
        files[robot.name] = []
        for photo in robot.photos:
            name = f"{round(photo.time_s * 1e6):016d}.{_SUFFIX[photo.encoding]}"
            path = run.images / robot.name / name
            if not path.exists():
                write_atomically(path, lambda temporary, data=photo.data: temporary.write_bytes(data))
            files[robot.name].append(path)
    return files


def _wait(seconds: float, stop: Callable[[], bool]) -> None:
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s and not stop():
        time.sleep(0.05)
