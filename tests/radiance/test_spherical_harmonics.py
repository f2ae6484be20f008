import numpy as np
import pytest
import torch

from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_bands_are_orthonormal_on_the_sphere(degree):
    z, weight = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(16))
    azimuth = torch.arange(32, dtype=torch.float64) * torch.pi / 16
    zz, aa = torch.meshgrid(z, azimuth, indexing="ij")
    r = (1 - zz**2).sqrt()
    d = torch.stack([r * aa.cos(), r * aa.sin(), zz], -1).view(-1, 3)
    area = (weight[:, None] * torch.pi / 16).expand_as(zz).reshape(-1)
    Y = spherical_harmonics(d, degree)
    torch.testing.assert_close(Y.T @ (Y * area[:, None]), torch.eye(degree**2, dtype=torch.float64))


def test_unknown_degree_is_refused():
    with pytest.raises(ValueError, match="degree"):
        spherical_harmonics(torch.zeros(1, 3), 5)
