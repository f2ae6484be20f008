from dataclasses import replace

import numpy as np

from mulan.mission.types import RobotLog
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.remembered_bearings import RememberedBearings

from .signals import two_robots


def until(log: RobotLog, end_s: float) -> RobotLog:
    """The first part of a recording."""
    csi = {
        peer: replace(
            track,
            time_s=track.time_s[track.time_s < end_s],
            frame_counter=track.frame_counter[track.time_s < end_s],
            channel=track.channel[track.time_s < end_s],
        )
        for peer, track in log.csi.items()
    }
    return replace(log, csi=csi)


def first_gap_s(log: RobotLog) -> float:
    """A moment in the longest silence of a recording's only link."""
    (track,) = log.csi.values()
    gap = int(np.argmax(np.diff(track.time_s)))
    return float(track.time_s[gap] + track.time_s[gap + 1]) / 2


def test_a_recording_read_as_it_grows_gives_the_bearings_of_the_whole_each_estimated_once() -> None:
    robots, _ = two_robots(np.random.default_rng(4))
    remembered, config = RememberedBearings(), BearingConfig()
    part = [until(log, first_gap_s(log)) for log in robots]
    early = estimate_bearings(part, config, of_aperture=remembered)
    remembered.forget_others()
    after_the_first_part = remembered.estimated
    assert len(early) > 0
    grown = estimate_bearings(robots, config, of_aperture=remembered)
    remembered.forget_others()
    whole = estimate_bearings(robots, config)
    assert len(grown) == len(whole) > len(early)
    assert remembered.estimated - after_the_first_part == len(whole) - after_the_first_part
    for got, expected in zip(grown, whole, strict=True):
        # sums over arrays that lie otherwise in memory may differ in their last bit on some processors
        np.testing.assert_allclose(got.direction_odom, expected.direction_odom, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            got.tangent_covariance, expected.tangent_covariance, rtol=1e-12, atol=1e-17
        )
    assert [b.profile is not None for b in grown] == [b.profile is not None for b in whole]
    again = remembered.estimated
    estimate_bearings(robots, config, of_aperture=remembered)
    assert remembered.estimated == again
