"""Adam (Kingma and Ba 2015) as ``torch.optim.Adam`` computes it, in one pass; clears the gradient too."""

from typing import no_type_check

import triton
import triton.language as tl
from torch import Tensor

from mulan.radiance.gpu.launch import programs
from mulan.radiance.optimiser_config import OptimiserConfig

ELEMENTS = 1024  # of one program


@triton.jit(do_not_specialize=["rate", "correction"])
@no_type_check
def adam_kernel(
    value,
    mean,
    square,
    gradient,
    level_weight,
    rate,
    correction,
    n,
    level_size,
    BETA1: tl.constexpr,
    BETA2: tl.constexpr,
    EPSILON: tl.constexpr,
    SKIP_UNTOUCHED: tl.constexpr,
    LEVELLED: tl.constexpr,
    B: tl.constexpr,
):
    """One step of B numbers; levels of weight 0 stay as they are."""
    i = tl.program_id(0) * B + tl.arange(0, B)
    on = i < n
    g = tl.load(gradient + i, mask=on, other=0.0)
    tl.store(gradient + i, tl.zeros_like(g), mask=on)
    if SKIP_UNTOUCHED:
        on = on & (g != 0)
    if LEVELLED:
        on = on & (tl.load(level_weight + i // level_size, mask=on, other=0.0) != 0)
    m = BETA1 * tl.load(mean + i, mask=on, other=0.0) + (1 - BETA1) * g
    s = BETA2 * tl.load(square + i, mask=on, other=0.0) + (1 - BETA2) * g * g
    v = tl.load(value + i, mask=on, other=0.0) - rate * m / (tl.sqrt(s) * correction + EPSILON)
    tl.store(value + i, v, mask=on)
    tl.store(mean + i, m, mask=on)
    tl.store(square + i, s, mask=on)


def adam_step(
    value: Tensor,
    moments: Tensor,
    gradient: Tensor,
    rate: float,
    step: int,
    config: OptimiserConfig,
    skip_untouched: bool = False,
    level_weight: Tensor | None = None,
) -> None:
    """Move ``value``, update its two moments (stacked first) and clear its gradient, all in place.

    Args:
        value: Parameters.
        moments: Mean and mean square of the gradients, ``[2, *value]``.
        gradient: Set to zero.
        rate: Step length.
        step: Number of this step, from 1.
        config: Adam's constants.
        skip_untouched: Leave numbers without gradient entirely alone.
        level_weight: Weight of each row of ``value``; rows of weight 0 stay as they are.
    """
    n, b1, b2 = value.numel(), config.beta1, config.beta2
    adam_kernel[(programs(n, ELEMENTS),)](
        *(value, moments[0], moments[1], gradient, value if level_weight is None else level_weight),
        *(rate / (1 - b1**step), 1 / (1 - b2**step) ** 0.5, n),
        *(n if level_weight is None else n // len(level_weight), b1, b2, config.epsilon),
        SKIP_UNTOUCHED=skip_untouched,
        LEVELLED=level_weight is not None,
        B=ELEMENTS,
    )
