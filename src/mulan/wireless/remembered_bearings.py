"""Bearings of a recording that grows: each aperture is looked at once."""

import hashlib
from dataclasses import replace

import numpy as np

from mulan.mission.types import RobotLog
from mulan.wireless.apertures import Aperture
from mulan.wireless.bearing import BearingConfig, KeepProfile, bearing_of_aperture, sharpness
from mulan.wireless.types import Bearing


class RememberedBearings:
    """Stands for :func:`bearing_of_aperture` where the same recording is read again with more at its end.

    An aperture is known again by its packets' times and its path, so one whose late packets or poses have
    come since is looked at anew. With ``KeepProfile.ONE`` a profile is kept only while no sharper bearing is
    known.

    Attributes:
        estimated: How many apertures were looked at.
    """

    def __init__(self) -> None:
        self.estimated = 0
        self._known: dict[bytes, Bearing | None] = {}
        self._asked: dict[bytes, Bearing | None] = {}
        self._sharpest: bytes | None = None

    def __call__(
        self, aperture: Aperture, observer: RobotLog, range_m: float | None, config: BearingConfig
    ) -> Bearing | None:
        """The bearing of an aperture, from memory where it is known."""
        key = _fingerprint(aperture)
        if key not in self._known:
            self.estimated += 1
            self._known[key] = self._kept(
                key, bearing_of_aperture(aperture, observer, range_m, config), config
            )
        self._asked[key] = self._known[key]
        return self._known[key]

    def forget_others(self) -> None:
        """Let go of apertures nobody asked for since the last call: they were parts of longer ones."""
        self._known, self._asked = self._asked, {}

    def _kept(self, key: bytes, bearing: Bearing | None, config: BearingConfig) -> Bearing | None:
        if bearing is None or config.keep_profile is not KeepProfile.ONE:
            return bearing
        sharpest = self._known.get(self._sharpest) if self._sharpest is not None else None
        if sharpest is not None and sharpness(sharpest) <= sharpness(bearing):
            return replace(bearing, profile=None)
        if sharpest is not None and self._sharpest is not None:
            self._known[self._sharpest] = replace(sharpest, profile=None)
        self._sharpest = key
        return bearing


def _fingerprint(aperture: Aperture) -> bytes:
    digest = hashlib.sha256(f"{aperture.observer} {aperture.peer}".encode())
    # a channel is computed from all packets together, so its last bits change as a recording grows
    for part in (aperture.time_s, aperture.peer_time_s, np.round(aperture.position_odom_m, 9)):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.digest()
