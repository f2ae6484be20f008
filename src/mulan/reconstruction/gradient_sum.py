"""The sum of all processes' gradients: by shared memory on one machine, else by the process group."""

import contextlib
import mmap
import os
import secrets
import tempfile
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.reconstruction.process_group import ProcessGroup

_PIECE = 2**17  # floats
_TOKEN_BYTES = 64  # begins the shared file; floats follow, aligned


class SharedRows:
    """Memory the processes of one machine share: twice a row of floats each.

    Rows alternate between steps. A process writes its next row only after all have met since the last but
    one was read, so one meeting a step is enough.
    """

    def __init__(self, memory: mmap.mmap, processes: int, length: int) -> None:
        floats = torch.frombuffer(memory, dtype=torch.float32, offset=_TOKEN_BYTES)
        self._rows = floats[: 2 * processes * length].view(2, processes, length)

    def __getitem__(self, step: int) -> Float[Tensor, "processes parameters"]:
        """The rows of one step."""
        return self._rows[step % 2]


def share_rows(group: ProcessGroup, length: int) -> SharedRows | None:
    """Shared memory for rows of ``length`` floats; None where not all processes can have it.

    The file has no name any more when this returns, so nothing is left behind however the processes end.
    """
    processes, token = group.place.processes, secrets.token_hex(_TOKEN_BYTES // 2)
    path, memory = None, None
    if group.leads:
        with contextlib.suppress(OSError):
            path = _new_file(token, _TOKEN_BYTES + 8 * processes * length)
    told = group.broadcast_json({"path": str(path), "token": token})
    with contextlib.suppress(OSError, ValueError):
        memory = _opened(Path(told["path"]), told["token"], _TOKEN_BYTES + 8 * processes * length)
    missing = torch.tensor([float(memory is None)])
    group.sum(missing)
    if path is not None:
        path.unlink(missing_ok=True)
    return None if missing > 0 or memory is None else SharedRows(memory, processes, length)


def _new_file(token: str, size: int) -> Path:
    folder = "/dev/shm" if os.path.isdir("/dev/shm") else None
    handle, name = tempfile.mkstemp(prefix="mulan-", dir=folder)
    try:
        # a full disk must be found now: later it would kill the process
        os.posix_fallocate(handle, 0, size)
        os.write(handle, token.encode())
    except (OSError, AttributeError) as error:
        os.unlink(name)
        raise OSError(str(error)) from error
    finally:
        os.close(handle)
    return Path(name)


def _opened(path: Path, token: str, size: int) -> mmap.mmap:
    """The file, if it is the leader's and not another machine's of the same name."""
    with open(path, "r+b") as file:
        if file.read(_TOKEN_BYTES) != token.encode():
            raise ValueError("another file")
        return mmap.mmap(file.fileno(), size)


class GradientSum:
    """Where a process puts its gradient and finds the weighted sum of all."""

    def __init__(self, group: ProcessGroup, parameters: int, device: torch.device) -> None:
        self._group = group
        self._shared = share_rows(group, parameters) if device.type == "cpu" else None
        self._sum = torch.zeros(parameters, device=device)
        self._step = 0

    def own(self) -> Float[Tensor, "parameters"]:
        """Where this process's gradient of the present step goes."""
        return self._sum if self._shared is None else self._shared[self._step][self._group.place.rank]

    def total(self, shares: list[float]) -> Float[Tensor, "parameters"]:
        """Sum of all gradients times their shares (which sum to one), equal everywhere; ends the step.

        Every process calls this after all have met (:class:`Meeting`) with their gradients in place.
        """
        if self._shared is None:
            self._sum *= shares[self._group.place.rank]
            self._group.sum(self._sum)
        else:
            _weighted_mean(self._shared[self._step], shares, self._sum)
        self._step += 1
        return self._sum


def _weighted_mean(
    rows: Float[Tensor, "processes parameters"], shares: list[float], out: Float[Tensor, "parameters"]
) -> None:
    """Mean of the rows under shares that sum to one, as a running mean: one pass where there are two rows."""
    # piece by piece, so that the running mean of many rows stays in the cache
    for piece, mean in zip(rows.split(_PIECE, dim=1), out.split(_PIECE), strict=True):
        before, weight = piece[0], shares[0]
        for row, share in zip(piece[1:], shares[1:], strict=True):
            weight += share
            torch.lerp(before, row, share / weight if weight > 0 else 0.0, out=mean)
            before = mean
