"""Whether a GPU is there that the Triton engine runs on."""

import importlib.util
from functools import cache

import torch

LEAST_CAPABILITY = (8, 0)  # Ampere: the first with bf16 matrix units, and the oldest Triton supports


@cache
def find_gpu() -> tuple[torch.device | None, str]:
    """The GPU to use and its name; None, and why, where there is none."""
    if not torch.cuda.is_available():
        return None, "torch sees no CUDA GPU"
    name, capability = torch.cuda.get_device_name(), torch.cuda.get_device_capability()
    if capability < LEAST_CAPABILITY:
        has, needs = ("{}.{}".format(*c) for c in (capability, LEAST_CAPABILITY))
        return None, f"{name} has compute capability {has}, below {needs}"
    if importlib.util.find_spec("triton") is None:
        return None, f"{name} is there but Triton is not: 'pip install triton'"
    return torch.device("cuda", torch.cuda.current_device()), name
