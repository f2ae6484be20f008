"""``mulan calibrate``: recordings with known geometry teach bearings what their claims are worth."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.table import Table

from mulan.cli.evaluate_aoa import print_failures
from mulan.cli.evaluate_engine import recordings
from mulan.cli.progress import console, progress_stages
from mulan.errors import InputError
from mulan.evaluation.aoa.cross_validation import CrossValidation, cross_validate, place_of
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.aoa.pictures import draw_before_and_after
from mulan.evaluation.aoa.protocol import AoaProtocolConfig, measure_links
from mulan.evaluation.aoa.truth import DEFINITIONS
from mulan.evaluation.provenance import provenance
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.calibration import AzimuthCalibration, fit_calibration, write_calibration
from mulan.wireless.link_bearing import DisplacementSource


@dataclass(frozen=True)
class Options:
    """Fit a calibration of bearings to recorded links with known geometry; the default works without any."""

    out: Path
    """Calibration to write (.json); a picture of the same name lies beside it."""
    data: Path = field(default_factory=lambda: recordings() / "wsr_aoa")
    """Folder in the WSR layout: every sub-folder with npz/ and reference.csv is a set."""
    sets: tuple[str, ...] = ()
    """Only these sets; all unless given."""
    source: DisplacementSource = DisplacementSource.T265
    """Where the moving antenna's path comes from; a calibration is good for that kind of odometry."""
    truth: Literal["own_axes", "origin"] = "own_axes"
    """In the odometry's axes, as localization uses bearings, or in the world's, its unknown yaw included."""
    folds: int = 10
    """Parts the places are dealt out to; each is judged by a calibration fitted on the others."""
    workers: int = AoaProtocolConfig.workers
    """Processes, of one thread each."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """The estimator to calibrate."""


def print_calibration(calibration: AzimuthCalibration, validation: CrossValidation) -> None:
    """The fitted numbers, and held-out figures before and after."""
    console.print(
        f"sigma x {calibration.sigma_scale:.2f}, in quadrature with "
        f"{np.degrees(calibration.sigma_floor_rad):.2f}°, "
        f"weights to the power {calibration.weight_exponent:.2f}, "
        f"odds of an outlier x {calibration.outlier_odds_factor:.2f}"
    )
    table = Table(box=None, header_style="dim", padding=(0, 1))
    for heading in ("held-out places", "in 68 %", "in 95 %", "NLL"):
        table.add_column(heading, justify="left" if heading.startswith("held") else "right", no_wrap=True)
    figures = validation.figures()
    for name in ("before", "after"):
        row = figures[name]
        table.add_row(
            name, f"{row['coverage_68']:.0%}", f"{row['coverage_95']:.0%}", f"{row['mean_nll']:.2f} nats"
        )
    console.print(table)


def main(arguments: Sequence[str]) -> int:
    """Measure, fit, judge, save."""
    options = tyro.cli(Options, args=arguments, prog="mulan calibrate")
    found = link_sets(options.data)
    names = [s.name for s in found]
    if unknown := [name for name in options.sets if name not in names]:
        raise InputError(
            options.data, f"set '{unknown[0]}'", "is not there", f"choose from {', '.join(names)}"
        )
    if options.bearings.calibration != AzimuthCalibration():
        raise InputError(
            "--bearings.calibration", "options", "would be calibrated twice", "leave them out here"
        )
    chosen = [s for s in found if not options.sets or s.name in options.sets]
    config = AoaProtocolConfig(options.bearings, (options.source,), options.workers)
    with progress_stages() as stage:
        measured, failed = measure_links(chosen, config, stage("Links"))
        bearings = [m.bearing for m in measured]
        truth = np.array(
            [m.truth.own_axes_rad if options.truth == "own_axes" else m.truth.origin_rad for m in measured]
        )
        try:
            validation = cross_validate(bearings, truth, [place_of(m) for m in measured], options.folds)
            calibration = fit_calibration(bearings, truth)
        except ValueError as error:
            raise InputError(options.data, "links", str(error), "record more places") from error
    record = {
        "source": options.source.value,
        "truth": {options.truth: DEFINITIONS[options.truth]},
        "sets": [s.name for s in chosen],
        "held_out": validation.figures(),
        "folds": [asdict(fold) for fold in validation.folds],
        "failed": [asdict(f) for f in failed],
        # nothing is random; the seed is recorded as everywhere
        "provenance": {**provenance(0), "data": str(options.data), "bearings": repr(options.bearings)},
    }
    write_calibration(options.out, calibration, record)
    picture = options.out.with_suffix(".png")
    draw_before_and_after(validation, f"{options.source.value}, {', '.join(record['sets'])}", picture)
    print_calibration(calibration, validation)
    print_failures(failed)
    console.print(f"Calibration: [bold]{options.out}[/], reliability: [bold]{picture}[/]")
    console.print(f"Next: [cyan]mulan localize BAG --out RUN --calibration {options.out}[/]")
    return 1 if failed else 0
