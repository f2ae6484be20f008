"""A trained field on disk: tensors and, in the header, the sizes and the space they belong to."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from mulan.errors import InputError
from mulan.mission.run_folder import write_atomically
from mulan.radiance.backend import new_engine
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace

_HEADER = "mulan"
_REMEDY = "make it again with 'mulan train'"


@dataclass(frozen=True)
class FieldDescription:
    """Everything but the numbers that makes a field.

    Attributes:
        field: Sizes.
        march: Sampling.
        space: Where it lives.
        white_background: Whether rays that hit nothing see white, or black.
        sub_pixels: Rays a side of a pixel that its pictures are the mean of, as it was learnt.
    """

    field: FieldConfig
    march: MarchConfig
    space: SceneSpace
    white_background: bool
    sub_pixels: int = 1

    def new_engine(
        self, seed: int, optimiser: OptimiserConfig | None = None, device: torch.device | None = None
    ) -> RadianceEngine:
        """An untrained field of this description; on the GPU if there is one and no device is given."""
        return new_engine(self.field, self.march, self.space, self.white_background, seed, optimiser, device)

    def to_json(self) -> dict[str, Any]:
        """Plain values for a file header."""
        value = asdict(self)
        value["space"]["centre_m"] = list(self.space.centre_m)  # as JSON gives it back
        return value

    @staticmethod
    def from_json(value: dict[str, Any]) -> "FieldDescription":
        """Inverse of :meth:`to_json`.

        Raises:
            KeyError, TypeError: Something is missing or unknown.
        """
        space = value["space"]
        x, y, z = (float(v) for v in space["centre_m"])
        return FieldDescription(
            FieldConfig(**value["field"]),
            MarchConfig(**value["march"]),
            SceneSpace((x, y, z), float(space["radius_m"]), bool(space["unbounded"])),
            bool(value["white_background"]),
            int(value["sub_pixels"]),
        )


def write_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Write tensors with a JSON header, atomically.

    Raises:
        InputError: The folder cannot be written or the disk is full; an earlier file is untouched.
    """
    text = json.dumps(header, sort_keys=True)
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}

    def write(temporary: Path) -> None:
        try:
            save_file(contiguous, temporary, metadata={_HEADER: text})
        except SafetensorError as error:
            raise OSError(None, str(error)) from error

    write_atomically(path, write)


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and header of :func:`write_tensors`.

    Raises:
        InputError: The file is missing, damaged or from another program.
    """
    if not path.is_file():
        raise InputError(path, "file", "does not exist", _REMEDY)
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})[_HEADER])
            return {name: file.get_tensor(name) for name in file.keys()}, header  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError(path, "tensors", f"cannot be read ({error})", _REMEDY) from error
    except (KeyError, json.JSONDecodeError) as error:
        raise InputError(path, "header", "was not written by mulan", _REMEDY) from error


def save_field(path: Path, engine: RadianceEngine, description: FieldDescription) -> None:
    """Write a trained field."""
    write_tensors(path, engine.state(), description.to_json())


def load_engine(path: Path) -> RadianceEngine:
    """A trained field, ready to render or to go on learning; see :func:`load_field`."""
    return load_field(path)[0]


def load_field(path: Path) -> tuple[RadianceEngine, FieldDescription]:
    """A trained field and its description.

    Raises:
        InputError: The file is missing, damaged or does not hold a field of this version.
    """
    tensors, header = read_tensors(path)
    try:
        description = FieldDescription.from_json(header)
        engine = description.new_engine(seed=0)
        engine.load_state(tensors)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "field", f"does not fit this version ({error})", _REMEDY) from error
    return engine, description
