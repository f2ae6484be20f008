"""What is fitted to what, and scored on the rest."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mulan.errors import InputError
from mulan.evaluation.uwb.rejection import rejection
from mulan.evaluation.uwb.score import Scored, join, score, summary
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.range_model import RangeModel
from mulan.wireless.recordings.uwb_chemnitz import ChemnitzRun, read_chemnitz
from mulan.wireless.recordings.uwb_murp import murp_files, read_murp_pair
from mulan.wireless.recordings.uwb_planar import (
    STATIC_POSES,
    PlanarRun,
    read_planar_dynamic,
    read_planar_static,
)
from mulan.wireless.recordings.uwb_samples import RangeSamples, concatenate

OUTLIER_TRIAL = ("01", "01 1-3")
_PLANAR_EVERY = 10  # 100 Hz to 10 Hz: neighbours share their errors


@dataclass(frozen=True)
class Split:
    """One model and the ranges it never saw."""

    name: str
    model: RangeModel
    train: RangeSamples
    scored: Scored


def read_planar(folder: Path) -> dict[str, PlanarRun]:
    """The three planar runs by short name."""
    dynamic = read_planar_dynamic(
        folder / "UWB_dynamic_exp_mid.csv.gz", folder / "motion_capture_dynamic_exp_mid.csv.gz"
    )
    static = [read_planar_static(folder / name) for name in STATIC_POSES]
    return {"dynamic": dynamic, "static_deg_0": static[0], "static_deg_60": static[1]}


def _tenth(samples: RangeSamples) -> RangeSamples:
    instant = np.unique(samples.time_s, return_inverse=True)[1]
    return samples.where(instant % _PLANAR_EVERY == 0)


def _split(name: str, train: RangeSamples, test: RangeSamples, config: RangeFitConfig) -> Split:
    model = fit_range_model(train, config)
    return Split(name, model, train, score(model, train, test))


def time_halves(samples: RangeSamples) -> tuple[RangeSamples, RangeSamples]:
    """First and second half of a recording."""
    early = samples.time_s < (samples.time_s.min() + samples.time_s.max()) / 2
    return samples.where(early), samples.where(~early)


def planar_splits(runs: dict[str, PlanarRun], config: RangeFitConfig) -> list[Split]:
    """Halves in time of each run, in both orders, and the dynamic run's model on the static site."""
    thin = {name: _tenth(run.samples) for name, run in runs.items()}
    splits = []
    for name, samples in thin.items():
        first, second = time_halves(samples)
        splits.append(_split(f"{name}, second half", first, second, config))
        splits.append(_split(f"{name}, first half", second, first, config))
    for name in ("static_deg_0", "static_deg_60"):
        splits.append(_split(f"{name} from dynamic", thin["dynamic"], thin[name], config))
    return splits


def read_murp(folder: Path) -> dict[str, list[RangeSamples]]:
    """Pairs of each trial.

    Raises:
        InputError: A file is bad, or there are not two trials to hold one out.
    """
    files = murp_files(folder)
    if len(files) < 2:
        raise InputError(folder, "trials", "there is only one", "leave-one-trial-out needs two or more")
    return {trial: [read_murp_pair(path) for path in paths] for trial, paths in files.items()}


def murp_splits(trials: dict[str, list[RangeSamples]], config: RangeFitConfig) -> list[Split]:
    """Each trial by a model of all other trials."""
    whole = {name: concatenate(name, pairs) for name, pairs in trials.items()}
    return [
        _split(name, concatenate("others", [o for k, o in whole.items() if k != name]), test, config)
        for name, test in whole.items()
    ]


def chemnitz_splits(run: ChemnitzRun, config: RangeFitConfig) -> list[Split]:
    """Halves in time of the one drive, in both orders."""
    first, second = time_halves(run.samples)
    return [
        _split("second half", first, second, config),
        _split("first half", second, first, config),
    ]


def read_indoor(folder: Path) -> ChemnitzRun:
    """The Labyrinth drive."""
    return read_chemnitz(folder / "Indoor_UWB_Input.txt", folder / "Indoor_UWB_GT.txt")


def agents_of(samples: RangeSamples) -> list[str]:
    """Pair of agents of each link of MURP, ``1-2``."""
    return [f"{a.split('.')[0]}-{b.split('.')[0]}" for a, b in samples.links]


def set_metrics(splits: list[Split]) -> dict[str, Any]:
    """Figures of each split, of all, and the model's own."""
    result: dict[str, Any] = {"all": summary(*join([split.scored for split in splits])), "splits": {}}
    for split in splits:
        result["splits"][split.name] = summary(split.scored.nll, split.scored.level) | {
            "correlation_s": split.model.correlation_s,
            "slope_per_m": split.model.slope_per_m,
        }
    return result


def pair_metrics(splits: list[Split]) -> dict[str, Any]:
    """MURP's figures by pair of agents, over all held-out trials."""
    nll, level = join([split.scored for split in splits])
    pairs = np.concatenate(
        [np.array(agents_of(split.scored.samples))[split.scored.samples.link] for split in splits]
    )
    return {
        str(pair): summary(
            {k: v[pairs == pair] for k, v in nll.items()}, {k: v[pairs == pair] for k, v in level.items()}
        )
        for pair in np.unique(pairs)
    }


def outlier_metrics(splits: list[Split], trials: dict[str, list[RangeSamples]]) -> dict[str, Any]:
    """Rejection in every trial by the model that never saw it."""
    models = {split.name: split.model for split in splits}
    return {
        samples.name: rejection(models[trial], samples)
        for trial, pairs in trials.items()
        for samples in pairs
    }
