"""How a field learns; every backend reads the same options."""

from dataclasses import dataclass, field

from mulan.radiance.loss import ColourLoss, SquaredLoss


@dataclass(frozen=True)
class OptimiserConfig:
    """How the field learns."""

    table_learning_rate: float = 2e-2
    """Adam's step for the hash table."""
    network_learning_rate: float = 1e-2
    """Adam's step for the networks."""
    beta1: float = 0.9
    """Adam's memory of the gradient."""
    beta2: float = 0.95
    """Adam's memory of its square; a grid entry meets few rays, so a long memory lags behind."""
    epsilon: float = 1e-15
    """Adam's floor under the root of the square."""
    loss: ColourLoss = field(default_factory=SquaredLoss)
    """What colour errors cost."""
    distortion_weight: float = 0.0
    """Weight of the distortion along each ray, which draws its samples together (mip-NeRF 360, eq. 15)."""
    entropy_weight: float = 0.0
    """Weight of the entropy of each ray's opacity, which makes it hit or miss."""
    random_background: bool = False
    """Learn before a new background colour every ray, which leaves nothing to gain from painting the true one
    in the air; batches then need opacities."""
    occupancy_every: int = 16
    """Steps between refreshes of the occupancy grid."""
