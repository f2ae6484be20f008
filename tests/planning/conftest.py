import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.planning.candidates import look_at


@pytest.fixture(autouse=True)
def one_thread():
    """The tensors here are small; threads only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def camera() -> PinholeCamera:
    return PinholeCamera(160, 120, 150.0, 150.0, 80.0, 60.0)


@pytest.fixture
def T_world_camera() -> NDArray:
    """Two metres from the origin on +x, looking at it."""
    return look_at(np.array([2.0, 0.0, 0.3]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
