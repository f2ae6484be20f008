import os
from pathlib import Path

import numpy as np
import pytest

from mulan.evaluation.aoa.truth import true_azimuth
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.link_bearing import DisplacementSource, link_bearing
from mulan.wireless.recordings.wsr import read_wsr_run

DATA = Path(os.environ.get("MULAN_DATA", Path(__file__).parents[2].parent / "shared" / "data")) / "wsr_aoa"


@pytest.mark.data
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")
@pytest.mark.parametrize(
    ("source", "mean_deg", "published_deg"),
    [
        (DisplacementSource.MOCAP, 3.0, 3.99),
        (DisplacementSource.T265_WHEELS, 3.5, 7.37),
        (DisplacementSource.T265, 5.0, 7.37),
    ],
)
def test_line_of_sight_bearings_of_real_cards_beat_the_published_ones(source, mean_deg, published_deg):
    errors_deg, levels = [], []
    for file in sorted((DATA / "LOS_Set_A" / "npz").glob("*.npz"))[::5]:
        run = read_wsr_run(file)
        for link in run.links:
            bearing = link_bearing(run, link, source, BearingConfig())
            assert bearing is not None
            assert bearing.origin_odom_m is not None
            assert np.isinf(bearing.tangent_covariance[:, 1, 1]).all()
            truth = np.array([true_azimuth(run, link, source, bearing.origin_odom_m).origin_rad])
            mixture = azimuth_mixture(bearing)
            errors_deg.append(np.degrees(np.abs(np.angle(np.exp(1j * (mixture.mean_rad[0] - truth[0]))))))
            levels.append(float(mixture.level_of(truth)[0]))
    assert len(errors_deg) == 18
    assert np.mean(errors_deg) < mean_deg < published_deg
    assert np.mean(np.array(levels) < 0.95) > 0.8
