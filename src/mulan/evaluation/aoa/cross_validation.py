"""What a calibration is worth on places it was not fitted on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.aoa.scored_link import MeasuredLink
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.calibration import AzimuthCalibration, fit_calibration, mean_nll
from mulan.wireless.types import Bearing


@dataclass(frozen=True)
class CrossValidation:
    """Claims about held-out links, before and after calibration on the others.

    Attributes:
        place: Of each link; a place's links are held out together.
        level_before, level_after: Smallest highest-density region that contains the truth.
        nll_before, nll_after: Mean negative log-likelihood of the truth [nats].
        folds: The calibration of each fold.
    """

    place: tuple[str, ...]
    level_before: Float[NDArray, "n"]
    level_after: Float[NDArray, "n"]
    nll_before: float
    nll_after: float
    folds: tuple[AzimuthCalibration, ...]

    def figures(self) -> dict[str, Any]:
        """For JSON."""
        figures: dict[str, Any] = {"links": len(self.place), "places": len(set(self.place))}
        for name, level, nll in (
            ("before", self.level_before, self.nll_before),
            ("after", self.level_after, self.nll_after),
        ):
            figures[name] = {
                "coverage_68": float((level <= 0.68).mean()),
                "coverage_95": float((level <= 0.95).mean()),
                "mean_nll": nll,
            }
        return figures


def place_of(link: MeasuredLink) -> str:
    """Set and start position; runs are named after theirs (``L3_2021-…``)."""
    return f"{link.scored.set} {link.scored.run.split('_')[0]}"


def _levels(bearings: Sequence[Bearing], true_azimuth_rad: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
    return np.array(
        [
            float(azimuth_mixture(b).level_of(np.array([t]))[0])
            for b, t in zip(bearings, true_azimuth_rad, strict=True)
        ]
    )


def cross_validate(
    bearings: Sequence[Bearing], true_azimuth_rad: Float[NDArray, "n"], place: Sequence[str], most_folds: int
) -> CrossValidation:
    """Fit on all places but those of one fold, judge on that fold, for every fold.

    Args:
        bearings: Uncalibrated.
        true_azimuth_rad: In the same axes.
        place: Of each link.
        most_folds: Places are dealt out to so many folds in turn, or one place a fold where there are fewer.

    Raises:
        ValueError: There is only one place, or the others hold too few links to fit on.
    """
    places = list(dict.fromkeys(place))
    if len(places) < 2:
        raise ValueError("all links are from one place, so none can be held out")
    fold_of = {name: number % min(most_folds, len(places)) for number, name in enumerate(places)}
    fold = np.array([fold_of[name] for name in place])
    after: list[Bearing] = list(bearings)
    fitted = []
    for number in range(fold.max() + 1):
        learn = np.flatnonzero(fold != number)
        calibration = fit_calibration([bearings[i] for i in learn], true_azimuth_rad[learn])
        fitted.append(calibration)
        for i in np.flatnonzero(fold == number):
            after[i] = calibration.applied(bearings[i])
    return CrossValidation(
        tuple(place),
        _levels(bearings, true_azimuth_rad),
        _levels(after, true_azimuth_rad),
        mean_nll(bearings, true_azimuth_rad),
        mean_nll(after, true_azimuth_rad),
        tuple(fitted),
    )
