"""A field known in closed form: a solid ball with a striped skin, for proving planners against."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.engine import RadianceEngine, RayBatch, RaySamples, Rendering, StepReport


@dataclass
class BallEngine(RadianceEngine):
    """A ball at the origin; colour varies with azimuth; the half x > 0 may be less certain than the other."""

    radius_m: float = 0.5
    stripes: float = 6.0
    variance_front: float = 0.01
    variance_back: float = 0.01
    far_m: float = 3.6
    steps: int = 144

    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        return torch.where(points.norm(dim=-1) < self.radius_m, 50.0, 0.0)

    def sample(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> RaySamples:
        dt = self.far_m / self.steps
        t = (torch.arange(self.steps) + 0.5) * dt
        points = origins[:, None] + t[None, :, None] * directions[:, None]
        alpha = 1 - torch.exp(-self.density(points.reshape(-1, 3)).reshape(points.shape[:2]) * dt)
        through = torch.cumprod(torch.cat([torch.ones(len(origins), 1), 1 - alpha], 1), 1)[:, :-1]
        blend = through * alpha
        keep = blend > 1e-4
        p = points[keep]
        azimuth = torch.atan2(p[:, 1], p[:, 0])
        colour = (0.5 + 0.5 * torch.sin(self.stripes * azimuth))[:, None].repeat(1, 3)
        variance = torch.where(p[:, 0] > 0, self.variance_front, self.variance_back)
        ray = torch.arange(len(origins))[:, None].expand(keep.shape)[keep]
        return RaySamples(ray, blend[keep], colour, variance, t.expand(keep.shape)[keep])

    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        s = self.sample(origins, directions)
        rays = len(origins)

        def total(value: Tensor) -> Tensor:
            return torch.zeros(rays, *value.shape[1:]).index_add(0, s.ray_index, value)

        return Rendering(
            total(s.blend[:, None] * s.colour),
            total(s.blend * s.distance_m),
            total(s.blend),
            total(s.blend**2 * s.variance),
        )

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        raise NotImplementedError

    def set_level_weights(self, weights):
        raise NotImplementedError

    def ray_gradients(self, origins, directions, colour_gradient):
        raise NotImplementedError

    def state(self) -> dict[str, Tensor]:
        return {}

    def load_state(self, state: dict[str, Tensor]) -> None:
        return None
