"""What path models know: the picture's latent, start and goal, and where along the path to sample."""

from dataclasses import dataclass

import torch
from torch import Tensor

from training.models.networks import beside
from training.models.space.joints import Joints

PLACE_FEATURES = 9


@dataclass(frozen=True, slots=True)
class Condition:
    """Of each sample.

    Args:
        latent: (m, L).
        start: (m, d) rad.
        goal: (m, d) rad.
        place: (m, 1), 0 to 1; None for models that are not asked for a place.
    """

    latent: Tensor
    start: Tensor
    goal: Tensor
    place: Tensor | None

    def features(self, joints: Joints) -> Tensor:
        """Side by side, (m, F)."""
        parts = [self.latent, joints.features(self.start), joints.features(self.goal)]
        return beside(parts, None if self.place is None else place_features(self.place))


def condition_size(latent_dim: int, joints: Joints, *, place: bool) -> int:
    """F, of :meth:`Condition.features`."""
    return latent_dim + 2 * joints.features_size + (PLACE_FEATURES if place else 0)


def place_features(place: Tensor) -> Tensor:
    """A place with its cosines and sines of up to four half turns, (m, 1) to (m, 9)."""
    turns = torch.cat([place * (torch.pi * k) for k in range(1, 5)], dim=1)
    return torch.cat([place, torch.cos(turns), torch.sin(turns)], dim=1)


def swept(place: Tensor, sweep: int) -> Tensor:
    """Places (m, 1) in [0, 1) in rising sweeps of ``sweep`` rows, each row within its own share of the way.

    A planner draws samples in their order, and a tree that grows from the start can use them best from the
    start on. All rows together are as evenly spread as before; fewer rows than a sweep are one sweep.
    """
    row = torch.arange(place.shape[0], device=place.device)
    count = torch.clamp(row.max() + 1, max=sweep)
    return ((row % count).unsqueeze(1).to(place.dtype) + place) / count
