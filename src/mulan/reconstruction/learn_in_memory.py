"""A small field learnt in seconds and kept in memory: what planners ask, and what they are judged by."""

from collections.abc import Sequence

import torch

from mulan.radiance.engine import RadianceEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.field_file import FieldDescription
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import next_rays
from mulan.reconstruction.weights import Weighting

FIRST_RAYS = 512


def learn_in_memory(
    images: Sequence[CapturedImage],
    weighting: Weighting,
    space: SceneSpace,
    config: TrainConfig,
    optimiser: OptimiserConfig | None = None,
) -> RadianceEngine:
    """Learn a field as :func:`mulan.reconstruction.trainer.train` does, without files, curve or checkpoints.

    A pixel is one ray throughout; the scene's place is given, so that fields of different views compare.

    Args:
        images: Photographs at the size to learn from.
        weighting: How far each pixel is trusted.
        space: Where the scene is.
        config: Options; ``steps`` must be given.
        optimiser: How the field learns; chosen by the kind of scene if not given.

    Raises:
        ValueError: No number of steps is given, or every pixel has weight 0.
    """
    if config.steps is None:
        raise ValueError("a field learnt in memory needs a number of steps")
    ignored = weighting.ignored(images, space)
    kept = [image for image, out in zip(images, ignored, strict=True) if not out]
    device = config.device.resolve()
    on_gpu = device.type == "cuda"
    field = config.field or choose_field(config.image_size, len(kept), space.unbounded, on_gpu)
    march = config.march or choose_march(config.image_size, space.unbounded, config.quick, on_gpu)
    optimiser = optimiser or choose_optimiser(space.unbounded, config.quick and not on_gpu)
    description = FieldDescription(field, march, space, white_background=not space.unbounded)
    engine = description.new_engine(config.seed, optimiser, device)
    data = ImageTensors(images, weighting.weight_maps(images, space))
    if not data.drawable_pixels:
        raise ValueError("every pixel has weight 0")
    data.move_to(device)
    sampler, rays = torch.Generator().manual_seed(config.seed + 1), FIRST_RAYS
    for step in range(config.steps):
        done = step / config.steps
        report = engine.train_step(data.sample(rays, sampler), config.learning_rate_factor(done))
        target = config.batch_samples_at(done, space.unbounded, on_gpu)
        rays = next_rays(rays, report.samples, target)
    return engine
