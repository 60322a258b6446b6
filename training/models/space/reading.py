"""Reading grids at points: pictures and features, of several scenes at once."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional


class Points:
    """Points of several scenes in one grid.

    Args:
        places: (p, 3, n) in voxels from the lowest corner.
        counts: X, Y, Z of the grid.
        channels: that lie one behind the other in each scene's part of a table, as a picture (p, C, X, Y, Z)
            that is only reshaped has them.
        scenes: (p,) their numbers in the table; None for all in their order.
    """

    def __init__(
        self,
        places: Tensor,
        counts: tuple[int, int, int],
        channels: int = 1,
        scenes: Tensor | None = None,
    ) -> None:
        self.places, self.counts = places, counts
        self.voxels = counts[0] * counts[1] * counts[2]
        numbers = torch.arange(places.shape[0], device=places.device) if scenes is None else scenes
        self.rows = numbers[:, None] * (channels * self.voxels)

    @property
    def inside(self) -> Tensor:
        """(p, n): which lie in the grid."""
        low = self.places.amin(dim=1) >= 0.0
        sides = [self.places[:, axis] < float(self.counts[axis]) for axis in range(3)]
        return low & sides[0] & sides[1] & sides[2]

    def nearest(self, channel: int = 0) -> Tensor:
        """(p, n): rows of a channel for the voxels that they lie in, or for the nearest ones."""
        x, y, z = (self.places[:, axis].clamp(0.0, float(self.counts[axis] - 1)).long() for axis in range(3))
        return self._number(x, y, z) + channel * self.voxels

    def between(
        self, table: Tensor, channel: int = 0, told: Callable[[Tensor], Tensor] | None = None
    ) -> Tensor:
        """Trilinear between voxels, (p, n, C), of a table (p X Y Z, C) or of one of its channels.

        Args:
            table: rows of all voxels.
            channel: which, where several lie one behind the other.
            told: what becomes of rows (p, n, C) before they are mixed; None for themselves.
        """
        firsts, shares = [], []
        for axis in range(3):
            middle = (self.places[:, axis] - 0.5).clamp(0.0, self.counts[axis] - 1.001)
            first = middle.long()
            firsts.append(first)
            shares.append((middle - first).unsqueeze(-1))
        start = self._number(firsts[0], firsts[1], firsts[2])
        start = start + channel * self.voxels if channel else start
        steps = (self.counts[1] * self.counts[2], self.counts[2], 1)

        def along(axis: int, at: Tensor) -> Tensor:
            if axis == 3:
                rows = functional.embedding(at, table)
                return rows if told is None else told(rows)
            low = along(axis + 1, at)
            return low + shares[axis] * (along(axis + 1, at + steps[axis]) - low)

        return along(0, start)

    def _number(self, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
        return (x * self.counts[1] + y) * self.counts[2] + z + self.rows


def table_of(features: Tensor) -> Tensor:
    """Features (p, C, X, Y, Z) as the rows (p X Y Z, C) that :class:`Points` reads."""
    return features.permute(0, 2, 3, 4, 1).reshape(-1, features.shape[1])
