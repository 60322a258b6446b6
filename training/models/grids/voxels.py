"""Reading one grid at many points that lie with the configurations last, so that a graph of it is quick.

What is read of a point is the same as :class:`training.models.space.reading.Points` reads.
"""

import torch
from torch import Tensor
from torch.nn import functional

Counts = tuple[int, int, int]


class Corners:
    """The eight voxels round each point, and its place between them.

    Args:
        places: (3, k, n) in voxels from the lowest corner.
        counts: X, Y, Z of the grid.
        rows: (n,) where in a table each configuration's scene begins; one number for all.
    """

    def __init__(self, places: Tensor, counts: Counts, rows: Tensor | int) -> None:
        last = torch.tensor(counts, dtype=places.dtype, device=places.device).reshape(3, 1, 1) - 1.001
        middle = torch.minimum((places - 0.5).clamp(min=0.0), last)
        first = middle.floor()
        self.start = _numbers(first, counts, rows)
        self.shares = (middle - first).unbind(dim=0)
        self.steps = (counts[1] * counts[2], counts[2], 1)

    def of_values(self, table: Tensor) -> Tensor:
        """Trilinear between single values, (k, n), of a table (m,)."""
        x, y, z = self.steps
        steps = torch.tensor([a + b + c for c in (0, z) for b in (0, y) for a in (0, x)])
        at = self.start + steps.to(self.start.device).reshape(-1, 1, 1)
        # Picked one by one, which a graph does in a seventh of the time of reading rows of a single value.
        found = torch.gather(table, 0, at.reshape(-1)).reshape(at.shape)
        for share, count in zip(self.shares[::-1], (4, 2, 1), strict=True):
            low, high = found[:count], found[count:]
            found = low + share * (high - low)
        return found[0]

    def of_rows(self, table: Tensor) -> Tensor:
        """Trilinear between rows, (k n, C), of a table (m, C)."""
        start = self.start.reshape(-1)
        # As wide as the rows by a product, for a graph multiplies what is as large far quicker.
        wide = table.new_ones(1, table.shape[1])
        shares = [share.reshape(-1, 1) @ wide for share in self.shares]

        def along(axis: int, at: Tensor) -> Tensor:
            if axis == len(shares):
                return functional.embedding(at, table)
            low = along(axis + 1, at)
            return low + shares[axis] * (along(axis + 1, at + self.steps[axis]) - low)

        return along(0, start)


def nearest_value(table: Tensor, places: Tensor, counts: Counts, rows: Tensor | int) -> Tensor:
    """The value of the voxel that each point lies in, or of the nearest one, (k, n), of a table (m,)."""
    last = torch.tensor(counts, dtype=places.dtype, device=places.device).reshape(3, 1, 1) - 1.0
    at = _numbers(torch.minimum(places.clamp(min=0.0), last).floor(), counts, rows)
    return torch.gather(table, 0, at.reshape(-1)).reshape(at.shape)


def _numbers(voxels: Tensor, counts: Counts, rows: Tensor | int) -> Tensor:
    """Whole places (3, k, n) to rows of a table, (k, n): below 2^24, so that floats tell them exactly."""
    at = ((voxels[0] * counts[1] + voxels[1]) * counts[2] + voxels[2]).long()
    return at if isinstance(rows, int) and rows == 0 else at + rows
