"""What the validity trial reads, from the data set to the trial by way of the object store."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.dataset import Dataset
from cspace.world import World
from training.models.modules import TrialModule
from training.models.settings import ValidityConfig
from training.models.validity import OccupancySamples, ValidityModule


@dataclass(frozen=True, slots=True)
class OccupancyArrays:
    """Free and colliding configurations by scenario, with what the look-ups need to know.

    Args:
        world: robot and sensor.
        free: (M, d) float32 rad.
        free_offsets: (S + 1,) int64.
        collision: (N, d) float32 rad.
        collision_offsets: (S + 1,) int64.
    """

    world: World
    free: NDArray[np.float32]
    free_offsets: NDArray[np.int64]
    collision: NDArray[np.float32]
    collision_offsets: NDArray[np.int64]

    @classmethod
    def of(cls, dataset: Dataset) -> "OccupancyArrays | None":
        """The data set's configurations; None unless some scenario has both kinds."""
        if dataset.collision is None or dataset.collision_offsets is None:
            return None
        found = cls(
            dataset.world,
            np.asarray(dataset.free),
            np.asarray(dataset.free_offsets),
            np.asarray(dataset.collision),
            np.asarray(dataset.collision_offsets),
        )
        return found if len(found.scenarios) else None

    @property
    def scenarios(self) -> NDArray[np.int64]:
        """Indices of the scenarios that have configurations of both kinds."""
        return np.flatnonzero((np.diff(self.free_offsets) > 0) & (np.diff(self.collision_offsets) > 0))

    def module(self, config: ValidityConfig, images: torch.Tensor, seed: int) -> TrialModule:
        """The head's training; arguments as of :meth:`samples`."""
        return ValidityModule(config, self.samples(images), self.world, seed)

    def samples(self, images: torch.Tensor) -> OccupancySamples:
        """Tensors for the module; copied, for the shared arrays are read-only.

        Args:
            images: (S, 3, P, P) uint8, and further ones behind them that have no configurations.
        """
        rest = (self.free, self.free_offsets, self.collision, self.collision_offsets, self.scenarios)
        return OccupancySamples(images[: len(self.free_offsets) - 1], *(torch.tensor(part) for part in rest))
