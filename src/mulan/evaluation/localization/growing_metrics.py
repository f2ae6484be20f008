"""``metrics.json`` written after every finished figure: an interrupted evaluation goes on from there."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import RunFolder, read_json, write_json

_UNFINISHED = "unfinished"


class GrowingMetrics:
    """The parts of ``metrics.json``, each a mapping from names to figures.

    A part that has begun and not ended is listed under ``unfinished`` with its options and what is done.

    Args:
        run: Folder.
        command: That makes the file, for the sentence said where it cannot be read.
        seed: For the provenance.

    Raises:
        InputError: There is a file that is not JSON, or the folder cannot be written.
    """

    def __init__(self, run: RunFolder, command: str, seed: int) -> None:
        run.check_writable()
        self._run, self._seed = run, seed
        self.metrics: dict[str, Any] = read_json(run.metrics, command) if run.metrics.exists() else {}

    def begin(self, part: str, options: Mapping[str, Any], keep: bool = False) -> frozenset[str]:
        """Start a part; names of its figures that an interrupted run with equal options has already.

        Args:
            part: Key.
            options: What the figures depend on.
            keep: Figures of an earlier, finished run stay until they are replaced.
        """
        told = json.loads(json.dumps(options))
        before = self.metrics.get(_UNFINISHED, {}).get(part)
        if before is not None and before["options"] == told:
            return frozenset(before["done"])
        if not keep:
            self.metrics[part] = {}
        self.metrics.setdefault(part, {})
        self.metrics.setdefault(_UNFINISHED, {})[part] = {"options": told, "done": []}
        return frozenset()

    def add(self, part: str, name: str, figures: Any) -> None:
        """One figure more, on the disk when this returns."""
        self.metrics[part][name] = figures
        self.metrics[_UNFINISHED][part]["done"].append(name)
        self._write(part)

    def end(self, part: str, order: Sequence[str] = ()) -> None:
        """The part is complete; its figures stand in this order, others behind."""
        figures = self.metrics[part]
        names = [name for name in order if name in figures]
        self.metrics[part] = {
            name: figures[name] for name in [*names, *(n for n in figures if n not in names)]
        }
        self.metrics[_UNFINISHED].pop(part)
        if not self.metrics[_UNFINISHED]:
            self.metrics.pop(_UNFINISHED)
        self._write(part)

    def _write(self, part: str) -> None:
        stamps = self.metrics.get("provenance", {})
        self.metrics["provenance"] = stamps | {part: provenance(self._seed)}
        write_json(self._run.metrics, self.metrics)
