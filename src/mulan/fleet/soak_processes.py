"""The processes of a fleet on loopback, started, killed and started again."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mulan.fleet.lossy_link import LossConfig
from mulan.mission.run_folder import read_json


@dataclass
class Member:
    """One program of the fleet through all its processes.

    Attributes:
        name: For file names.
        arguments: Of ``mulan``'s command.
        folder: Where logs and figures go.
        ready_sign: What a process prints when it is at work.
        command: ``mulan``'s command.
        writes_figures: Whether it takes ``--status``.
        processes: Started so far, the last one maybe running.
        killed_s: When it was killed, and when it was started again.
    """

    name: str
    arguments: list[str]
    folder: Path
    ready_sign: str
    command: str = "fleet"
    writes_figures: bool = True
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    killed_s: list[tuple[float, float]] = field(default_factory=list)

    def start(self) -> None:
        """Start a process."""
        count = len(self.processes)
        command = [sys.executable, "-m", "mulan.cli.main", self.command, *self.arguments]
        if self.writes_figures:
            command += ["--status", str(self.folder / f"{self.name}-{count}.json")]
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with (self.folder / f"{self.name}-{count}.log").open("wb") as log:
            self.processes.append(subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | threads))

    @property
    def running(self) -> bool:
        """Whether its last process runs."""
        return bool(self.processes) and self.processes[-1].poll() is None

    @property
    def memory_mb(self) -> float:
        """What its last process holds now; 0 where it is gone or the system does not tell."""
        if not self.running:
            return 0.0
        try:
            with open(f"/proc/{self.processes[-1].pid}/status") as lines:
                return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmRSS:")), 0.0)
        except OSError:
            return 0.0

    @property
    def ready(self) -> bool:
        """Whether its last process is at work: loading programs takes seconds on a small machine."""
        log = self.folder / f"{self.name}-{len(self.processes) - 1}.log"
        return self.running and self.ready_sign in log.read_text(errors="replace")

    @property
    def failed(self) -> bool:
        """Whether its last process ended with an error of its own; being killed is none."""
        return bool(self.processes) and (self.processes[-1].poll() or 0) > 0

    def kill(self) -> None:
        """As a power cut would, for the process."""
        self.processes[-1].send_signal(signal.SIGKILL)
        self.processes[-1].wait()

    def ask_to_end(self) -> None:
        """Ask it to end in good order; do not wait for it."""
        if self.running:
            self.processes[-1].send_signal(signal.SIGTERM)

    def stop(self, timeout_s: float) -> None:
        """Ask it to end in good order; kill it when it does not."""
        if not self.running:
            return
        self.ask_to_end()
        try:
            self.processes[-1].wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.kill()

    def figures(self) -> list[dict[str, Any]]:
        """The last figures each of its processes wrote."""
        found = []
        for count in range(len(self.processes)):
            path = self.folder / f"{self.name}-{count}.json"
            if path.exists():
                found.append(read_json(path, "mulan fleet soak"))
        return found

    def said(self) -> str:
        """The end of what its last process printed."""
        log = self.folder / f"{self.name}-{len(self.processes) - 1}.log"
        return log.read_text(errors="replace")[-500:].strip() if log.exists() else ""


def base_member(folder: Path, bag: Path, endpoint: str, robots: tuple[str, ...]) -> Member:
    """The base station."""
    arguments = ["base", "--out", str(bag), "--mission", "soak", "--link.endpoint", endpoint]
    return Member("base", [*arguments, "--ingest.robots", *robots], folder, "Listening")


def robot_member(folder: Path, name: str, bag: Path, speed: float, endpoint: str, loss: LossConfig) -> Member:
    """One robot that replays its part of a bag over a bad link."""
    arguments = ["robot", "--name", name, "--mission", "soak", "--spool", str(folder / f"{name}.spool")]
    arguments += ["--bag", str(bag), "--speed", json.dumps(speed), "--link.endpoint", endpoint]
    for option in ("loss", "duplicate", "delay_s", "jitter_s", "seed"):
        arguments += [f"--loss.{option.replace('_', '-')}", json.dumps(getattr(loss, option))]
    return Member(name, arguments, folder, "the link is open")


@dataclass
class Kill:
    """A member to be killed and started again.

    Attributes:
        member: Which.
        at_s: When, from the start of the test; later if it is not at work then.
        back_s: When it is started again.
        settled_s: It must have been at work this long since it was last started.
        state: 0 before, 1 while it is gone, 2 after.
    """

    member: Member
    at_s: float
    back_s: float
    settled_s: float = 0.0
    state: int = 0
    ready_s: float | None = None

    def due(self, now_s: float) -> None:
        """Do what the time has come for."""
        if self.state == 0:
            # a program that is still loading has nothing to lose yet
            self.ready_s = (self.ready_s or now_s) if self.member.ready else None
        if self.state == 0 and now_s >= self.at_s:
            if self.ready_s is None or now_s - self.ready_s < self.settled_s:
                return
            self.member.kill()
            self.state, self.back_s = 1, now_s + self.back_s - self.at_s
            self.at_s = now_s
        elif self.state == 1 and now_s >= self.back_s:
            self.member.start()
            self.member.killed_s.append((self.at_s, now_s))
            self.state = 2


def start_all(members: list[Member], timeout_s: float) -> None:
    """Start everyone, the base station first, and wait until all are at work."""
    until_s = time.monotonic() + timeout_s
    members[0].start()
    while not members[0].ready and members[0].running and time.monotonic() < until_s:
        time.sleep(0.05)
    for member in members[1:]:
        member.start()
    while (
        not all(m.ready for m in members) and all(m.running for m in members) and (time.monotonic() < until_s)
    ):
        time.sleep(0.05)


class MemoryWatch:
    """What the processes hold in memory, minute by minute.

    Attributes:
        by_minute: Largest resident megabytes seen in each minute, of the base station and of any robot.
    """

    def __init__(self, members: list[Member]) -> None:
        self.by_minute: list[dict[str, float]] = []
        self._members = members
        self._next_s = 0.0

    def sample(self, now_s: float) -> None:
        """Look, every five seconds."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + 5.0
        while len(self.by_minute) <= int(now_s / 60):
            self.by_minute.append({"base": 0.0, "robot": 0.0})
        of_minute = self.by_minute[-1]
        for member in self._members:
            role = "base" if member is self._members[0] else "robot"
            of_minute[role] = max(of_minute[role], member.memory_mb)


def watch(
    members: list[Member],
    kills: list[Kill],
    until_s: float,
    look: Callable[[float], object] = lambda _: None,
    least_s: float = 0.0,
) -> float:
    """Run until every robot has ended by itself and was killed as planned; returns how long that took.

    Args:
        members: Base station first; all running.
        kills: What happens meanwhile.
        until_s: Give up after this time.
        least_s: The base station is left running this long.
        look: Called again and again with the seconds since the start.
    """
    started_s = time.monotonic()
    while (now_s := time.monotonic() - started_s) < until_s:
        look(now_s)
        for kill in kills:
            kill.due(now_s)
        pending = any(kill.state == 1 for kill in kills)
        robots = any(member.running for member in members[1:])
        if not pending and not robots and now_s >= least_s:
            return now_s
        time.sleep(0.05)
    return until_s


def free_endpoint() -> str:
    """An address on this machine nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
