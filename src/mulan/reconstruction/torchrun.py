"""What torchrun tells each process it starts; imports nothing heavy, so that any command may ask."""

import os
from collections.abc import Mapping
from dataclasses import dataclass

from mulan.errors import InputError


@dataclass(frozen=True)
class Place:
    """A process among those that train together.

    Attributes:
        rank: Its number; process 0 leads: it writes the files and talks.
        processes: How many there are.
        local_rank, local_processes: The same among those on this machine.
    """

    rank: int
    processes: int
    local_rank: int
    local_processes: int

    @property
    def leads(self) -> bool:
        """Whether this process writes and talks."""
        return self.rank == 0

    @property
    def name(self) -> str:
        """For messages."""
        return f"process {self.rank} of {self.processes}"


def place_of_this_process(environment: Mapping[str, str] = os.environ) -> Place | None:
    """From torchrun's environment variables; None for a process on its own.

    Raises:
        InputError: They make no sense.
    """
    if "RANK" not in environment or "WORLD_SIZE" not in environment:
        return None
    try:
        rank, processes = int(environment["RANK"]), int(environment["WORLD_SIZE"])
        local_rank = int(environment.get("LOCAL_RANK", 0))
        local_processes = int(environment.get("LOCAL_WORLD_SIZE", 1))
    except ValueError:
        raise InputError("environment", "RANK, WORLD_SIZE", "are no numbers", "start with torchrun") from None
    if not 0 <= rank < processes:
        raise InputError("environment", "RANK", f"is {rank} of {processes}", "start with torchrun")
    return Place(rank, processes, local_rank, local_processes) if processes > 1 else None


def is_leader(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether this process may print: the leader, or one on its own."""
    return environment.get("RANK", "0") == "0" or environment.get("WORLD_SIZE", "1") == "1"


def threads_for(place: Place, environment: Mapping[str, str] = os.environ) -> int:
    """Threads each process should use: an even share of the machine's cores.

    torchrun sets OMP_NUM_THREADS to 1 where the user set nothing; a larger value is the user's own.
    """
    chosen = environment.get("OMP_NUM_THREADS", "")
    if chosen.isdigit() and int(chosen) > 1:
        return int(chosen)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, cores // place.local_processes)
