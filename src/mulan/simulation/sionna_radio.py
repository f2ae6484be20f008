"""Radio among the things of a scene: paths by Sionna RT, phases by exact distances."""

import importlib.util
import multiprocessing

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.simulation.propagation import SPEED_OF_LIGHT_M_PER_S
from mulan.simulation.radio_surfaces import RadioSurface
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.sionna_tracer import TracedPaths, TraceRequest, serve

_REMEDY = "install LLVM 16 or later (Debian: libllvm19) and name its library in DRJIT_LIBLLVM_PATH"
_SENDER = 0.1  # side of its cells over that of the listener's
_ROWS = 512  # whose paths are summed at once
_STRAIGHT_M = 1e-3

_Cell = tuple[int, int, int]


class SionnaRadio:
    """A :class:`mulan.simulation.propagation.Propagation` by ray tracing.

    Positions are gathered in cells, a tenth as wide where the sending antenna is. Paths are traced between
    middles of cells, and each is carried to the positions about them as if it came from a point, its mirror
    image: exact for the direct path and for the listener's end of a reflected one, of first order in the
    sender's offset. Channels are the same either way, so at each time the end that stands still is taken to
    send. Where both move, every position of the one needs rays of its own, which is slow.
    """

    def __init__(self, surfaces: tuple[RadioSurface, ...], config: SionnaConfig) -> None:
        """Start the process that traces; it ends with this object, or with the program.

        Args:
            surfaces: What is there; none for free space.
            config: How to trace.

        Raises:
            InputError: Sionna RT or an LLVM it can use is missing.
        """
        if importlib.util.find_spec("sionna") is None:
            raise InputError(
                "--radio sionna", "package 'sionna-rt'", "is missing", "run: pip install 'mulan[sionna]'"
            )
        self._config = config
        self._known: dict[tuple[float, _Cell, _Cell], TracedPaths] = {}
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, surfaces, config), daemon=True)
        self._process.start()
        theirs.close()
        self._answer()

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join()

    def channel(
        self,
        transmitter_world_m: Float[NDArray, "n 3"],
        receiver_world_m: Float[NDArray, "n 3"],
        subcarrier_hz: Float[NDArray, "s"],
    ) -> Complex[NDArray, "n s"]:
        """Noise-free channel, row by row, in the units of the built-in radio.

        Raises:
            InputError: The tracing process failed.
        """
        if not len(transmitter_world_m):
            return np.zeros((0, len(subcarrier_hz)), dtype=complex)
        swapped = self._swapped(transmitter_world_m, receiver_world_m)[:, None]
        sender = np.where(swapped, receiver_world_m, transmitter_world_m)
        listener = np.where(swapped, transmitter_world_m, receiver_world_m)
        frequency_hz = float(subcarrier_hz.min() + subcarrier_hz.max()) / 2
        self._trace(sender, listener, frequency_hz)
        blocks = range(0, len(sender), _ROWS)
        return np.concatenate(
            [
                self._sum(sender[k : k + _ROWS], listener[k : k + _ROWS], subcarrier_hz, frequency_hz)
                for k in blocks
            ]
        )

    def _swapped(
        self, transmitter_world_m: Float[NDArray, "n 3"], receiver_world_m: Float[NDArray, "n 3"]
    ) -> Bool[NDArray, "n"]:
        """Where the receiver stays longer in one small cell than the transmitter, so had better send."""
        stay, cells = [], []
        for position_m in (transmitter_world_m, receiver_world_m):
            cell = self._sender_cells(position_m)
            _, row, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
            stay.append(count[row.ravel()])
            cells.append(cell)
        # ties go the same way when the ends are exchanged
        first = np.argmax(cells[0] != cells[1], axis=1)[:, None]
        below = np.take_along_axis(cells[1] - cells[0], first, 1)[:, 0] < 0
        return (stay[1] > stay[0]) | ((stay[1] == stay[0]) & below)

    def _listener_cells(self, position_world_m: Float[NDArray, "n 3"]) -> Int[NDArray, "n 3"]:
        return np.floor(position_world_m / self._config.cell_m).astype(np.int64)

    def _sender_cells(self, position_world_m: Float[NDArray, "n 3"]) -> Int[NDArray, "n 3"]:
        return np.floor(position_world_m / (self._config.cell_m * _SENDER)).astype(np.int64)

    def _listener_middle(self, cells: Int[NDArray, "n 3"]) -> Float[NDArray, "n 3"]:
        return (cells + 0.5) * self._config.cell_m

    def _sender_middle(self, cells: Int[NDArray, "*n 3"]) -> Float[NDArray, "*n 3"]:
        return (cells + 0.5) * (self._config.cell_m * _SENDER)

    def _trace(
        self, sender: Float[NDArray, "n 3"], listener: Float[NDArray, "n 3"], frequency_hz: float
    ) -> None:
        """Get to know the paths between all cells in use."""
        wanted: dict[_Cell, list[_Cell]] = {}
        pairs = np.unique(
            np.concatenate([self._sender_cells(sender), self._listener_cells(listener)], 1), axis=0
        )
        for pair in pairs.tolist():
            here, there = tuple(pair[:3]), tuple(pair[3:])
            if (frequency_hz, here, there) not in self._known:
                wanted.setdefault(here, []).append(there)
        for here, cells in wanted.items():
            receivers = self._listener_middle(np.array(cells))
            self._pipe.send(TraceRequest(self._sender_middle(np.array(here)), receivers, frequency_hz))
            traced = self._answer()
            rows = [(part, row) for part in traced for row in range(len(part.gain))]
            for there, (part, row) in zip(cells, rows, strict=True):
                kept = np.abs(part.gain[row]) > 0
                self._known[frequency_hz, here, there] = TracedPaths(
                    part.gain[row, kept],
                    part.distance_m[row, kept],
                    part.toward_transmitter[row, kept],
                    part.toward_receiver[row, kept],
                )

    def _sum(
        self,
        sender: Float[NDArray, "n 3"],
        listener: Float[NDArray, "n 3"],
        subcarrier_hz: Float[NDArray, "s"],
        frequency_hz: float,
    ) -> Complex[NDArray, "n s"]:
        """The channel out of known paths."""
        sender_cell, listener_cell = self._sender_cells(sender), self._listener_cells(listener)
        pairs = zip(sender_cell.tolist(), listener_cell.tolist(), strict=True)
        known = [self._known[frequency_hz, tuple(one), tuple(other)] for one, other in pairs]
        count = max(len(paths.gain) for paths in known)
        gain = _padded([paths.gain for paths in known], count)
        length_m = _padded([paths.distance_m for paths in known], count)
        arrival = _padded([paths.toward_transmitter for paths in known], count)
        departure = _padded([paths.toward_receiver for paths in known], count)
        here, there = self._sender_middle(sender_cell), self._listener_middle(listener_cell)
        distance_m = (
            np.linalg.norm(length_m[..., None] * arrival - (listener - there)[:, None], axis=-1)
            + np.linalg.norm(length_m[..., None] * departure - (sender - here)[:, None], axis=-1)
            - length_m
        )
        straight = np.abs(length_m - np.linalg.norm(there - here, axis=1)[:, None]) < _STRAIGHT_M
        distance_m = np.where(straight, np.linalg.norm(listener - sender, axis=1)[:, None], distance_m)
        amplitude = np.divide(gain, distance_m, out=np.zeros_like(gain), where=np.abs(gain) > 0)
        wavenumber = 2 * np.pi * subcarrier_hz / SPEED_OF_LIGHT_M_PER_S
        return (amplitude[..., None] * np.exp(-1j * distance_m[..., None] * wavenumber)).sum(1)

    def _answer(self) -> list[TracedPaths]:
        """What the other process says.

        Raises:
            InputError: It failed, or died.
        """
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError) as error:
            self._process.join()
            how = f"ended with code {self._process.exitcode}, as it does where LLVM is too old"
            raise InputError("--radio sionna", "Sionna RT", how, _REMEDY) from error
        if isinstance(answer, str):
            if not answer:
                return []
            remedy = _REMEDY if "llvm" in answer.lower() else "use '--radio mirrors' for this scene"
            raise InputError("--radio sionna", "Sionna RT", answer.rstrip("."), remedy)
        return answer


def _padded(rows: list[NDArray], count: int) -> NDArray:
    """Rows of different lengths as one array, the rest zero."""
    padded = np.zeros((len(rows), count, *rows[0].shape[1:]), dtype=rows[0].dtype)
    for k, row in enumerate(rows):
        padded[k, : len(row)] = row
    return padded
