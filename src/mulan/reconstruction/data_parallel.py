"""Training steps taken by several processes together, each on its part of one joint batch."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from mulan.errors import InputError
from mulan.radiance.engine import RadianceEngine, StepReport
from mulan.radiance.split_step import BatchPart, ParameterGradients, SplitStepEngine
from mulan.reconstruction.checkpoint import Progress
from mulan.reconstruction.gradient_sum import GradientSum
from mulan.reconstruction.meeting import meeting_of
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.process_group import ProcessGroup


class DataParallel:
    """Keeps equal engines equal: the same joint batch, the same mean gradient, the same decisions.

    Attributes:
        stop_agreed: Whether a process was asked to stop; all learn of it in the same step.
    """

    def __init__(self, group: ProcessGroup, engine: RadianceEngine) -> None:
        """Prepare the exchange.

        Raises:
            InputError: The engine cannot split its step.
        """
        if not isinstance(engine, SplitStepEngine):
            raise InputError(
                "torchrun",
                "engine",
                f"{type(engine).__name__} learns in one process only",
                "add --device cpu, or start just one",
            )
        self._group, self._engine = group, engine
        self._meeting = meeting_of(group)
        self._sum = GradientSum(group, engine.parameter_count, engine.device)
        self._stop_asked = self.stop_agreed = False
        self._owed_s = 0.0

    def step(
        self,
        data: PosedPixels,
        rays: int,
        pairs: bool,
        sampler: torch.Generator,
        learning_rate_factor: float,
    ) -> tuple[StepReport, float]:
        """One optimiser step on the joint batch.

        Args:
            data: Photographs, the same everywhere.
            rays: Rays of the joint batch.
            pairs: Whether two rays make a pixel.
            sampler: Draws them; equal everywhere.
            learning_rate_factor: As in :meth:`RadianceEngine.train_step`.

        Returns:
            The joint batch's report and the seconds learnt since the last one, by the leader's clock.

        Raises:
            InputError: Another process failed or is gone.
        """
        began, place = time.perf_counter(), self._group.place
        error, gradients, report = None, None, StepReport(0.0, 0.0, 0)
        try:
            a_pixel, draw = (2, data.sample_pairs) if pairs else (1, data.sample)
            part = BatchPart.of_process(max(rays // a_pixel, 1), place.rank, place.processes).in_rays(a_pixel)
            batch = draw(part.joint_rays, sampler, part)
            gradients, report = self._engine.gradients(batch, part, self._sum.own())
        except Exception as caught:
            error = caught
        meeting = time.perf_counter()
        took_s = self._owed_s + meeting - began if place.leads else 0.0
        told = _told(gradients, report, place.rank, place.processes)
        seconds, stop, failed, loss, squared_error, used, samples, *weights = self._meeting.sum(
            [took_s, float(self._stop_asked), float(error is not None), *told]
        )
        if failed > 0:
            with self._group.all_or_none():
                if error is not None:
                    raise error
        weight = max(sum(weights), 1e-12)
        values = self._sum.total([w / weight for w in weights])
        self._engine.apply(ParameterGradients(values, weight, int(used)), learning_rate_factor)
        self.stop_agreed = stop > 0
        self._owed_s = time.perf_counter() - meeting
        return StepReport(loss / weight, squared_error / max(used, 1), int(samples)), seconds

    def share(self, sampler: torch.Generator, progress: Progress) -> Progress:
        """Give everyone the leader's engine, sampler and progress.

        At the start this hands out what a checkpoint held. Later it undoes the last-bit drift of machines
        whose processors round differently; on equal machines it changes nothing.
        """
        state = self._engine.state()
        state["trainer.sampler"] = sampler.get_state()
        for tensor in state.values():
            byte = tensor.view(torch.uint8) if tensor.dtype == torch.bool else tensor
            self._group.broadcast(byte)
        sampler.set_state(state.pop("trainer.sampler"))
        self._engine.load_state(state)
        told = self._group.broadcast_json({**progress.__dict__, "history": list(progress.history)})
        return Progress(**{**told, "history": tuple(told["history"])})

    @contextmanager
    def stopping_together(self) -> Iterator[None]:
        """Turn Ctrl-C and torchrun's SIGTERM into :attr:`stop_agreed`."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def ask(*_: object) -> None:
            self._stop_asked = True

        signals = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(number, ask) for number in signals]
        try:
            yield
        finally:
            for number, handler in zip(signals, before, strict=True):
                signal.signal(number, handler)


def _told(gradients: ParameterGradients | None, report: StepReport, rank: int, processes: int) -> list[float]:
    """What a process says of its part of a batch; the sums over the processes are the joint batch's."""
    weights = [0.0] * processes
    if gradients is None:
        return [0.0] * 4 + weights
    weights[rank] = gradients.weight
    loss, squared_error = report.loss * gradients.weight, report.mean_squared_error * gradients.rays
    return [loss, squared_error, float(gradients.rays), float(report.samples), *weights]
