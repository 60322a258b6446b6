"""The joint space as networks see it: features, limits, wrapped differences, and reading grids at points."""

from itertools import combinations

import torch
from torch import Tensor, nn

from cspace.space import JointSpace

HARMONICS = 3


def harmonics(angles: Tensor) -> Tensor:
    """Cos and sin of k theta for k up to 3: (..., d) to (..., 6 d)."""
    multiples = torch.cat([angles * k for k in range(1, HARMONICS + 1)], dim=-1)
    return torch.cat([torch.cos(multiples), torch.sin(multiples)], dim=-1)


def torus_features(angles: Tensor) -> Tensor:
    """Harmonics of every joint, and of the sum and difference of every pair.

    Shapes: (..., d) to (..., 6 d + 2 d (d - 1)).
    """
    pairs = list(combinations(range(angles.shape[-1]), 2))
    if not pairs:
        return harmonics(angles)
    first = torch.stack([angles[..., i] for i, _ in pairs], dim=-1)
    second = torch.stack([angles[..., j] for _, j in pairs], dim=-1)
    mixed = torch.cat([first + second, first - second], dim=-1)
    return torch.cat([harmonics(angles), torch.cos(mixed), torch.sin(mixed)], dim=-1)


def on_torus(embedded: Tensor) -> Tensor:
    """Angles of an embedding: (m, 2 d) cosines, then sines, of any length above 0, to (m, d) rad."""
    cosines, sines = embedded.chunk(2, dim=-1)
    return torch.atan2(sines, cosines)


class Joints(nn.Module):
    """A joint space's mathematics on tensors; it has no weights."""

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
        """How many values :meth:`unembed` takes."""
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

    def difference(self, start: Tensor, end: Tensor) -> Tensor:
        """The difference from one to the other, the shorter way round on circles; (..., d) rad."""
        plain = end - start
        round_circles = torch.remainder(plain + torch.pi, 2.0 * torch.pi) - torch.pi
        return round_circles if self.is_torus else torch.where(self.limited, plain, round_circles)

    def interpolate(self, start: Tensor, end: Tensor, share: Tensor) -> Tensor:
        """Points at shares (b, 1) of :meth:`difference` (eq. gangp on the torus); (b, d) rad."""
        return start + share * self.difference(start, end)

    def unembed(self, embedded: Tensor) -> Tensor:
        """Cosines of the circles, their sines, places within the limits: (m, embedded_size) to (m, d) rad.

        Cosines and sines may have any length above 0.
        """
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


def table_of(features: Tensor) -> Tensor:
    """Features (p, C, X, Y, Z) as the rows (p X Y Z, C) that :class:`Points` reads."""
    return features.permute(0, 2, 3, 4, 1).reshape(-1, features.shape[1])
