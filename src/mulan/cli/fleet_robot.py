"""``mulan fleet robot``: a robot that replays a bag, moves in a simulated world, or runs ROS 2."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli.fleet_base import stop_on_signals
from mulan.cli.progress import console
from mulan.errors import InputError
from mulan.fleet.message_choice import ChoiceConfig, MessageChoice
from mulan.fleet.refusals import LinkStatus
from mulan.fleet.replay import Replay, ReplayClock, ReplayConfig
from mulan.fleet.robot_link import RobotConfig, RobotLink
from mulan.fleet.ros_robot import RosConfig, RosRobot
from mulan.fleet.status import robot_status
from mulan.mission import messages
from mulan.mission.run_folder import write_json


@dataclass(frozen=True)
class Options:
    """Send what a robot records: in a bag (--bag), a simulated world (--simulate), or ROS 2 (--ros.endpoint).

    What the base station has not got stays in the spool.
    """

    robot: Annotated[RobotConfig, tyro.conf.arg(name="")]
    """The robot."""
    replay: Annotated[ReplayConfig, tyro.conf.arg(name="")]
    """Replay of a bag."""
    choice: Annotated[ChoiceConfig, tyro.conf.arg(name="")]
    """What of it is sent."""
    ros: RosConfig
    """ROS 2 topics through a zenoh-bridge-ros2dds."""
    simulate: Path | None = None
    """Folder of a world made by 'mulan fleet world'; there the robot goes to the goals it is sent."""
    patience_s: float = 20.0
    """A robot whose name is taken gives up after this time."""
    status: Path | None = None
    """JSON file of figures, written anew every second."""


def main(arguments: Sequence[str]) -> int:
    """Replay, then wait until the base station has everything."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet robot")
    stop, config = stop_on_signals(), options.robot
    given = [options.replay.bag is not None, options.simulate is not None, bool(options.ros.endpoint)]
    if sum(given) != 1:
        problem = "and --simulate and --ros.endpoint exclude each other"
        raise InputError("options", "--bag", problem, "give one of them")
    if options.replay.speed != 1.0:
        config = replace(config, clock_every_s=float("inf"))  # such a clock has no constant offset
    link, source = _start(options, config)
    failed: list[InputError | OSError] = []

    def work() -> None:
        try:
            if isinstance(source, RosRobot):
                source.run(link, stop.is_set)
            else:
                source.run(stop.is_set)
        except (InputError, OSError) as error:
            failed.append(error)

    worker = threading.Thread(target=work, name="replay")
    worker.start()
    try:
        refused = _watch(options, link, source, worker, stop)
    finally:
        stop.set()
        worker.join()
        waiting = len(link.spool)
        if options.status is not None:
            write_json(options.status, robot_status(link, source))
        link.close()
    for error in failed:
        if isinstance(error, InputError):
            raise error
        raise InputError(config.spool, "spool", str(error), "free some space and start again; it goes on")
    if refused is not None:
        raise InputError(config.link.endpoint, f"robot '{config.name}'", "is refused", refused)
    console.print(
        f"{config.name}: {link.counts.stored} messages acknowledged, {waiting} still wait in the spool"
    )
    return 0


def _start(options: Options, config: RobotConfig) -> tuple[RobotLink, Replay | RosRobot]:
    def tell(text: str) -> None:
        console.print(escape(text))

    choice = MessageChoice(options.choice)
    if options.ros.endpoint:
        robot = RosRobot(options.ros, choice, tell)
        return RobotLink(config, time.time_ns, tell, orders=robot.orders(config.name)), robot
    if options.simulate is not None:
        # the simulator's libraries are not for robots that only replay
        from mulan.fleet.simulated_robot import GoalInbox, RequestInbox, SimulatedRobot, WorldClock

        world_clock = WorldClock(options.simulate, options.replay.speed)
        goals, requests = GoalInbox(), RequestInbox()
        orders = {messages.GOAL: goals.put, messages.REQUEST: requests.put}
        link = RobotLink(config, world_clock.now_ns, tell, orders=orders)
        return link, SimulatedRobot(
            options.simulate, options.replay, choice, link, world_clock, goals, requests
        )
    assert options.replay.bag is not None
    clock = ReplayClock(options.replay.bag, config.name, options.replay.speed, config.spool, config.spool_mb)
    link = RobotLink(config, clock.now_ns, tell)
    return link, Replay(options.replay, choice, link, clock)


def _watch(
    options: Options,
    link: RobotLink,
    source: Replay | RosRobot,
    worker: threading.Thread,
    stop: threading.Event,
) -> str | None:
    """Until all is acknowledged or it is stopped; why the base station refuses this robot, if it does."""
    refused_since_s: float | None = None
    written_s = 0.0
    while not stop.wait(0.05):
        now_s = time.monotonic()
        if not worker.is_alive() and len(link.spool) == 0:
            return None
        if options.status is not None and now_s - written_s > 1.0:
            write_json(options.status, robot_status(link, source))
            written_s = now_s
        status = link.status
        if status is None or status is LinkStatus.OPEN:
            refused_since_s = None
            continue
        refused_since_s = now_s if refused_since_s is None else refused_since_s
        if status is not LinkStatus.NAME_TAKEN or now_s - refused_since_s > options.patience_s:
            return status.sentence
    return None
