"""What the field has learnt, flat on one device, and its form in a saved state."""

import torch
from torch import Tensor

from mulan.radiance.config import FieldConfig
from mulan.radiance.native_engine import NETWORKS
from mulan.radiance.networks import RadianceField

_PREFIXES = ("", "exp_avg.", "exp_avg_sq.")


class FlatParameters:
    """Table and networks with Adam's moments and room for their gradients.

    Attributes:
        table: ``[levels, entries, features]``.
        networks: All matrices one after another, in the order of ``NETWORKS``.
        table_moments, network_moments: Mean and mean square of the gradients.
        table_gradient, network_gradient: Zero between steps.
    """

    def __init__(self, field: FieldConfig, generator: torch.Generator, device: torch.device) -> None:
        """The initial parameters of every other engine of the same seed."""
        initial = RadianceField(field, generator)
        self._shapes = [tuple(getattr(initial, name).shape) for name in NETWORKS]
        self.table = initial.table.detach().to(device).contiguous()
        flat = torch.cat([getattr(initial, name).detach().flatten() for name in NETWORKS])
        self.networks = flat.to(device)
        self.table_moments = torch.zeros(2, *self.table.shape, device=device)
        self.network_moments = torch.zeros(2, *self.networks.shape, device=device)
        self.table_gradient = torch.zeros_like(self.table)
        self.network_gradient = torch.zeros_like(self.networks)

    def state(self) -> dict[str, Tensor]:
        """Copies in main memory, under the names of the torch engine's state."""
        state = {}
        for prefix, table, networks in self._parts():
            state[f"{prefix}table"] = table.clone().cpu()
            sizes = [rows * columns for rows, columns in self._shapes]
            for name, shape, flat in zip(NETWORKS, self._shapes, networks.split(sizes), strict=True):
                state[prefix + name] = flat.view(shape).clone().cpu()
        return state

    def load(self, state: dict[str, Tensor]) -> None:
        """Inverse of :meth:`state`; shapes are checked by the caller."""
        for prefix, table, networks in self._parts():
            table.copy_(state[f"{prefix}table"])
            networks.copy_(torch.cat([state[prefix + name].flatten() for name in NETWORKS]))

    def _parts(self) -> list[tuple[str, Tensor, Tensor]]:
        tables, networks = (self.table, *self.table_moments), (self.networks, *self.network_moments)
        return list(zip(_PREFIXES, tables, networks, strict=True))
