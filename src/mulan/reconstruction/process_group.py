"""The processes of one data-parallel training, and how they agree."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from mulan.errors import InputError
from mulan.reconstruction.torchrun import Place, place_of_this_process, threads_for

LONGEST_WAIT = timedelta(hours=6)  # for the leader to decode or evaluate; a dead process is noticed at once
_MESSAGE_BYTES = 2048
_FIELDS = "\x1f"


class ProcessGroup:
    """All processes torchrun started; every method is called by all of them, in the same order."""

    def __init__(self, place: Place) -> None:
        """Join the others; gloo carries what lies in main memory, nccl what lies on a GPU.

        Raises:
            InputError: They cannot be reached.
        """
        self.place = place
        torch.set_num_threads(threads_for(place))
        cuda = torch.cuda.is_available() and dist.is_nccl_available()
        if cuda:
            torch.cuda.set_device(place.local_rank % torch.cuda.device_count())
        with self.connected():
            dist.init_process_group("cpu:gloo,cuda:nccl" if cuda else "gloo", timeout=LONGEST_WAIT)

    @property
    def leads(self) -> bool:
        """Whether this process writes files and talks."""
        return self.place.leads

    def close(self) -> None:
        """Leave the group."""
        dist.destroy_process_group()

    def sum(self, tensor: Tensor) -> None:
        """Replace a tensor by its sum over the processes; every process has the same bits afterwards."""
        with self.connected():
            dist.all_reduce(tensor)

    def gather(self, tensor: Tensor) -> list[Tensor]:
        """Every process's tensor of one shape, in order."""
        parts = [torch.empty_like(tensor) for _ in range(self.place.processes)]
        with self.connected():
            dist.all_gather(parts, tensor)
        return parts

    def broadcast(self, tensor: Tensor) -> None:
        """Replace a tensor by the leader's."""
        with self.connected():
            dist.broadcast(tensor, 0)

    def broadcast_json(self, value: Any) -> Any:
        """The leader's value, as JSON gives it back; the others' are not looked at."""
        data = bytearray(json.dumps(value if self.leads else None).encode())
        length = torch.tensor([len(data)])
        self.broadcast(length)
        text = torch.frombuffer(data, dtype=torch.uint8).clone()
        text = text if self.leads else torch.empty(int(length), dtype=torch.uint8)
        self.broadcast(text)
        return json.loads(bytes(text.tolist()))

    def wait_for_all(self) -> None:
        """Return when every process has come here."""
        self.sum(torch.zeros(1))

    @contextmanager
    def all_or_none(self) -> Iterator[None]:
        """A stretch of work that counts as done only when it succeeded everywhere.

        Raises:
            InputError: It failed in another process, whose message this is; a process's own error is raised
                as it is.
        """
        error: Exception | None = None
        try:
            yield
        except Exception as caught:
            error = caught
        message = torch.zeros(_MESSAGE_BYTES, dtype=torch.uint8)
        if error is not None:
            text = list(_FIELDS.join(self._told(error)).encode()[:_MESSAGE_BYTES])
            message[: len(text)] = torch.tensor(text, dtype=torch.uint8)
        messages = self.gather(message)
        if error is not None:
            raise error
        for other in messages:
            if other.any():
                fields = bytes(other.tolist()).rstrip(b"\0").decode(errors="replace").split(_FIELDS)
                raise InputError(*(fields + [""] * 4)[:4])

    @contextmanager
    def leader_first(self) -> Iterator[None]:
        """As :meth:`all_or_none`; the leader is done before the others begin, so they find its files."""
        with self.all_or_none():
            if not self.leads:
                self.wait_for_all()
            try:
                yield
            finally:
                if self.leads:
                    self.wait_for_all()

    def _told(self, error: Exception) -> tuple[str, str, str, str]:
        if isinstance(error, InputError):
            return error.source, error.field, error.problem, error.remedy
        problem = f"failed ({type(error).__name__}: {error})"
        return self.place.name, "training", problem[:1000], "its own output says where"

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Turn what a lost connection raises into a sentence.

        Raises:
            InputError: The connection to another process was lost or could not be made.
        """
        try:
            yield
        except (RuntimeError, OSError) as error:
            raise InputError(
                self.place.name,
                "connection",
                "to another process was lost or could not be made",
                "see why that process ended; the same command resumes from the last checkpoint",
            ) from error


@contextmanager
def processes_of_torchrun() -> Iterator[ProcessGroup | None]:
    """The group torchrun started this process in, left at the end; None for a process on its own.

    Raises:
        InputError: The others cannot be reached.
    """
    place = place_of_this_process()
    if place is None:
        yield None
        return
    group = ProcessGroup(place)
    try:
        yield group
    finally:
        group.close()
