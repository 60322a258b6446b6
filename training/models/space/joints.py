"""A joint space as networks have it: what they see of a joint, where they start, how they stay in its limits.

A limited joint is seen as a circle is, for so it moves the arm, and by its place within its range besides.
What is moved beyond a limit is folded back: that is continuous, keeps a gradient everywhere and heaps nothing
up at the limits, as clipping would, and what is inside stays where it is, as by a smooth bound it would not.
Without limits all of it is the torus, number for number.
"""

import torch
from torch import Tensor, nn

from cspace.space import JointSpace
from training.models import losses
from training.models.space.features import HARMONICS, harmonics, on_torus, torus_features


class Joints(nn.Module):
    """A joint space's mathematics on tensors; it has no weights.

    Args:
        space: circles and limited joints.
    """

    limited: Tensor
    columns: Tensor
    order: Tensor
    lower: Tensor
    width: Tensor

    def __init__(self, space: JointSpace) -> None:
        super().__init__()
        self.dim, self.is_torus = space.dim, space.is_torus
        limited = ~torch.tensor(space.periodic)
        lower, upper = (torch.tensor(ends, dtype=torch.float64) for ends in (space.lower, space.upper))
        columns = torch.nonzero(limited).flatten()
        order = torch.cat([torch.nonzero(~limited).flatten(), columns])
        values = {
            "limited": limited,
            "columns": columns,
            "order": torch.argsort(order),
            "lower": lower.float(),
            "width": (upper - lower).float(),
        }
        for name, value in values.items():
            self.register_buffer(name, value, persistent=False)
        self.limits = len(columns)

    @property
    def features_size(self) -> int:
        """How many values :meth:`features` gives."""
        return 2 * HARMONICS * self.dim + self.limits

    @property
    def pair_features_size(self) -> int:
        """How many values :meth:`pair_features` gives."""
        return self.features_size + 2 * self.dim * (self.dim - 1)

    @property
    def embedded_size(self) -> int:
        """How many values :meth:`embed` gives."""
        return 2 * self.dim - self.limits

    def features(self, angles: Tensor) -> Tensor:
        """Harmonics of every joint, and places within the limits: (..., d) to (..., features_size)."""
        return self._with_places(harmonics(angles), angles)

    def pair_features(self, angles: Tensor) -> Tensor:
        """The same with harmonics of sums and differences: (..., d) to (..., pair_features_size)."""
        return self._with_places(torus_features(angles), angles)

    def from_torus(self, angles: Tensor) -> Tensor:
        """What is uniform on the torus, (..., d) in [-pi, pi), made uniform within the limits."""
        if self.is_torus:
            return angles
        return torch.where(self.limited, self.lower + (angles / (2.0 * torch.pi) + 0.5) * self.width, angles)

    def fold(self, angles: Tensor) -> Tensor:
        """Limited joints folded back at their limits, circles as they are; (..., d) rad."""
        if self.is_torus:
            return angles
        beyond = angles - self.lower
        beyond = beyond - 2.0 * self.width * torch.floor(beyond / (2.0 * self.width))
        return torch.where(self.limited, self.lower + self.width - (beyond - self.width).abs(), angles)

    def way(self, start: Tensor, end: Tensor) -> Tensor:
        """From one to the other, the shorter way round on circles; (..., d) rad."""
        plain = end - start
        round_circles = torch.remainder(plain + torch.pi, 2.0 * torch.pi) - torch.pi
        return round_circles if self.is_torus else torch.where(self.limited, plain, round_circles)

    def between(self, start: Tensor, end: Tensor, share: Tensor) -> Tensor:
        """Points at shares (b, 1) of :meth:`way`; (b, d) rad."""
        wrapped = losses.wrapped_interpolation(end, start, share)
        if self.is_torus:
            return wrapped
        return torch.where(self.limited, losses.straight_interpolation(end, start, share), wrapped)

    def apart(self, first: Tensor, second: Tensor) -> Tensor:
        """How far joints are apart, as a loss: 1 - cos of the difference, half its square with limits."""
        gap = first - second
        round_circles = 1.0 - torch.cos(gap)
        return (
            round_circles if self.is_torus else torch.where(self.limited, gap.square() / 2.0, round_circles)
        )

    def embed(self, angles: Tensor) -> Tensor:
        """Cosines of the circles, their sines, places within the limits: (m, d) to (m, embedded_size)."""
        if self.is_torus:
            return torch.cat([torch.cos(angles), torch.sin(angles)], dim=1)
        turning = angles[:, ~self.limited]
        return self._with_places(torch.cat([torch.cos(turning), torch.sin(turning)], dim=1), angles)

    def unembed(self, embedded: Tensor) -> Tensor:
        """The inverse: (m, embedded_size), cosines and sines of any length above 0, to (m, d) rad."""
        if self.is_torus:
            return on_torus(embedded)
        turning = self.dim - self.limits
        angles = on_torus(embedded[:, : 2 * turning])
        low, width = self.lower[self.columns], self.width[self.columns]
        placed = low + (embedded[:, 2 * turning :] + 1.0) / 2.0 * width
        return self.fold(torch.cat([angles, placed], dim=1)[:, self.order])

    def _with_places(self, seen: Tensor, angles: Tensor) -> Tensor:
        """With the places of limited joints within their ranges, -1 to 1, behind."""
        if self.is_torus:
            return seen
        places = 2.0 * (angles - self.lower) / self.width - 1.0
        return torch.cat([seen, places[..., self.columns]], dim=-1)
