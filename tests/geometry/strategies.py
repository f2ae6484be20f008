"""Random rotations, transforms and lenses for property tests."""

import math

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mulan.geometry.camera import PinholeCamera


def numbers(limit: float) -> st.SearchStrategy[float]:
    return st.floats(-limit, limit, allow_nan=False)


def vectors(limit: float) -> st.SearchStrategy[np.ndarray]:
    return st.tuples(numbers(limit), numbers(limit), numbers(limit)).map(np.array)


@st.composite
def unit_vectors(draw: st.DrawFn) -> np.ndarray:
    azimuth, height = draw(numbers(math.pi)), draw(numbers(1.0))
    r = math.sqrt(max(0.0, 1 - height**2))
    return np.array([r * math.cos(azimuth), r * math.sin(azimuth), height])


@st.composite
def rotation_vectors(draw: st.DrawFn, largest_rad: float = math.pi - 1e-6) -> np.ndarray:
    """Angles spread evenly, and crowded at both ends where series and branches switch."""
    tiny = st.floats(1e-12, 1e-3)
    angle = draw(
        st.one_of(st.just(0.0), tiny, st.floats(0.0, largest_rad), tiny.map(lambda a: largest_rad - a))
    )
    return angle * draw(unit_vectors())


@st.composite
def twists(draw: st.DrawFn) -> np.ndarray:
    return np.concatenate([draw(rotation_vectors()), draw(vectors(10.0))])


@st.composite
def transforms(draw: st.DrawFn) -> np.ndarray:
    """Rigid transforms made without the code under test."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(draw(rotation_vectors())).as_matrix()
    T[:3, 3] = draw(vectors(10.0))
    return T


@st.composite
def cameras(draw: st.DrawFn) -> PinholeCamera:
    """Lenses with distortion up to what a wide-angle camera has."""
    return PinholeCamera(
        width=640,
        height=480,
        fx=draw(st.floats(350.0, 900.0)),
        fy=draw(st.floats(350.0, 900.0)),
        cx=draw(st.floats(300.0, 340.0)),
        cy=draw(st.floats(220.0, 260.0)),
        k1=draw(st.floats(-0.25, 0.3)),
        k2=draw(st.floats(-0.02, 0.1)),
        p1=draw(st.floats(-5e-3, 5e-3)),
        p2=draw(st.floats(-5e-3, 5e-3)),
        k3=draw(st.floats(0.0, 0.02)),
    )
