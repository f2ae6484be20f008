"""``--calibration FILE``: what 'mulan calibrate' learned, put into the estimator's options."""

from dataclasses import replace
from pathlib import Path

from mulan.wireless.bearing import BearingConfig
from mulan.wireless.calibration import read_calibration


def calibrated(config: BearingConfig, calibration: Path | None) -> BearingConfig:
    """The options with the file's calibration, or as they are where no file is given.

    Raises:
        InputError: The file is no calibration.
    """
    return config if calibration is None else replace(config, calibration=read_calibration(calibration))
