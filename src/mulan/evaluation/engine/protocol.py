"""The whole benchmark of the engine: part by part, metrics.json after each, the picture at the end."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.engine.listener import Listener
from mulan.evaluation.engine.peers import PeerConfig, PeerTask, run_peer, why_no_peers
from mulan.evaluation.engine.picture import draw_curves
from mulan.evaluation.engine.same_views import ours_on_same_views
from mulan.evaluation.engine.scene_result import measure_scene
from mulan.evaluation.engine.scenes import EngineScene
from mulan.evaluation.engine.throughput import ThroughputConfig, compare_throughput
from mulan.evaluation.engine.torch_training import torch_fields, train_torch_field
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.radiance.backend import Device
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.train_config import TrainConfig

OBJECT, PLACE = "lego_100", "fox_270x480"
THROUGHPUT, TORCH, PEERS = "throughput", "torch", "peers"
PICTURE = "psnr.png"
PEER_SCORE_GROWTH = 1.25  # by which the runners space their scores


@dataclass(frozen=True)
class EngineBenchmarkConfig:
    """How the engine is measured."""

    throughput: ThroughputConfig = field(default_factory=ThroughputConfig)
    """Training throughput against torch."""
    peers: PeerConfig = field(default_factory=PeerConfig)
    """Other people's trainers."""
    torch_budget_s: float = 60.0
    """Seconds of training given to each of the torch fields."""
    torch_curve_points: int = 8
    """How often the torch fields are scored (a score takes them several seconds)."""
    device: Device = Device.CPU
    """Where our own trainings run; everything else is measured on the CPU."""
    seed: int = 0
    """Source of all randomness."""


class EngineBenchmark:
    """Measures part by part; what is measured is on disk at once.

    Attributes:
        metrics: What metrics.json holds; ``measured`` says when and with what each part was made.
        parts: Names of all parts, in the order they are measured.
    """

    def __init__(
        self, scenes: Sequence[EngineScene], config: EngineBenchmarkConfig, run: RunFolder, listener: Listener
    ) -> None:
        """Throughput, torch fields and peers learn ``lego_100``; peers also ``fox_270x480``."""
        self._config, self._run, self._listener = config, run, listener
        self._scenes = {scene.name: scene for scene in scenes}
        measures: dict[str, Callable[[], None]] = {
            scene.name: lambda scene=scene: self._measure_scene(scene) for scene in scenes
        }
        self._measures = measures | {
            THROUGHPUT: self._measure_throughput,
            TORCH: self._train_torch,
            PEERS: self._run_peers,
        }
        self.metrics: dict[str, Any] = {}

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all parts, in the order they are measured."""
        return tuple(self._measures)

    def measure(self, only: Sequence[str] = ()) -> dict[str, Any]:
        """Measure every part, or only those named: then a file that is there keeps its other parts.

        Returns:
            What it wrote to metrics.json.

        Raises:
            InputError: A part is unknown, a set of photographs cannot be used, or the folder not written.
        """
        for name in only:
            if name not in self._measures:
                raise InputError(
                    "--only", f"part '{name}'", "is unknown", f"choose from {', '.join(self.parts)}"
                )
        self._run.check_writable()
        kept = read_json(self._run.metrics, "mulan evaluate engine") if self._run.metrics.exists() else {}
        self.metrics = {"peers": {}, "measured": {}, **(kept if only else {})}
        self.metrics["provenance"] = provenance(self._config.seed)
        try:
            for name in only or self.parts:
                self._measures[name]()
        finally:
            # also of a benchmark that was stopped
            draw_curves(self.metrics, self._run.root / PICTURE)
        return self.metrics

    def _keep(self, part: str, found: dict[str, Any]) -> None:
        self.metrics |= found
        self.metrics["measured"][part] = provenance(self._config.seed)
        write_json(self._run.metrics, self.metrics)

    def _keep_peer(self, part: str, name: str, scene: str, result: dict[str, Any]) -> None:
        peers = self.metrics["peers"]
        if "psnr_curve" in result:
            result = result | {"ours_same_views": ours_on_same_views(self._run, scene, result)}
        self._keep(part, {"peers": peers | {name: peers.get(name, {}) | {scene: result}}})
        if reason := result.get("not_run"):
            self._listener.say(f"{name}, {scene}: {reason}")
        else:
            seconds, psnr_db = result["psnr_curve"][-1]
            self._listener.say(f"{name}, {scene}: {psnr_db:.2f} dB after {seconds:.0f} s")

    def _measure_scene(self, scene: EngineScene) -> None:
        found = measure_scene(scene, self._config.seed, self._config.device, self._run, self._listener)
        self._keep(scene.name, {scene.name: found})

    def _measure_throughput(self) -> None:
        scene = self._scenes[OBJECT]
        photographs = load_captured(scene.images().train, scene.image_size)
        progress = self._listener.begin("Throughput against torch")
        found = compare_throughput(photographs, scene.image_size, self._config.throughput, progress)
        self._keep(THROUGHPUT, found)
        rates = {name: rate for name, rate in found["samples_per_s"].items() if rate is not None}
        self._listener.say(
            "samples/s: " + ", ".join(f"{name} {rate / 1e6:.2f} M" for name, rate in rates.items())
        )

    def _train_torch(self) -> None:
        scene = self._scenes[OBJECT]
        config = TrainConfig(
            image_size=scene.image_size, time_budget_s=self._config.torch_budget_s, seed=self._config.seed
        )
        for name, torch_field in torch_fields(scene, config).items():
            progress = self._listener.begin(f"{name} on {scene.name}")
            points = self._config.torch_curve_points
            result = train_torch_field(torch_field, scene, config, points, progress)
            self._keep_peer(TORCH, name, scene.name, result)

    def _run_peers(self) -> None:
        config = self._config.peers
        reason = why_no_peers(config)
        for words in config.names:
            peer, *arguments = shlex.split(words)
            for scene, budget_s, every_nth_view, scores in (
                (OBJECT, config.budget_s, config.every_nth_view, 12),
                (PLACE, config.fox_budget_s, config.fox_every_nth_view, 4),
            ):
                if budget_s <= 0:
                    continue
                result: dict[str, Any] = {"not_run": reason}
                if reason is None:
                    first_s = budget_s / PEER_SCORE_GROWTH**scores
                    task = PeerTask(
                        peer, tuple(arguments), self._scenes[scene], budget_s, every_nth_view, first_s
                    )
                    progress = self._listener.begin(f"{peer} on {scene}")
                    result = run_peer(task, config, self._run.root / "peers", progress)
                self._keep_peer(PEERS, peer, scene, result)
