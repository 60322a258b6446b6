"""The U-Net over the validity head's map with start and goal, on a grid whose axes may wrap."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.space import JointSpace
from training.models.space.joints import Joints

# One cell wide, so that start and goal are seen wherever in their cells they lie.
MARK_CELLS = 1.0
OUTPUTS = 4
# Detours far below the first are as good as none, far beyond the second as good as no way.
DETOUR_RAD = (0.3, 1.5)


class CellGrid(nn.Module):
    """The cells of the joint space.

    Args:
        space: of two joints, both circles or with limits.
        cells: along each joint.
    """

    centres: Tensor
    low: Tensor
    size: Tensor
    wraps: Tensor

    def __init__(self, space: JointSpace, cells: int) -> None:
        super().__init__()
        self.cells, self.periodic, self.joints = cells, tuple(space.periodic), Joints(space)
        low, high = torch.tensor(space.lower), torch.tensor(space.upper)
        size = (high - low) / cells
        axes = [low[joint] + (torch.arange(cells) + 0.5) * size[joint] for joint in range(space.dim)]
        grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
        self.register_buffer("centres", grid.reshape(-1, space.dim).float(), persistent=False)
        self.register_buffer("low", low.float(), persistent=False)
        self.register_buffer("size", size.float(), persistent=False)
        self.register_buffer("wraps", torch.tensor(space.periodic).float(), persistent=False)

    def difference(self, start: Tensor, end: Tensor) -> Tensor:
        """The way from one to the other, the shorter one on circles."""
        plain = end - start
        return plain - self.wraps * (2.0 * torch.pi) * torch.round(plain / (2.0 * torch.pi))

    def cell(self, points: Tensor) -> Tensor:
        """Number of the cell of each point, (..., d) rad to (...)."""
        place = ((points - self.low) / self.size).floor().long().clamp(0, self.cells - 1)
        return place[..., 0] * self.cells + place[..., 1]

    def marks(self, points: Tensor) -> Tensor:
        """(b, d) rad to (b, c, c): 1 at the point, falling off as a bell."""
        away = self.difference(points.unsqueeze(1), self.centres) / self.size
        bell = torch.exp(-away.square().sum(dim=-1) / (2.0 * MARK_CELLS**2))
        return bell.view(-1, self.cells, self.cells)


class WrappedConv(nn.Module):
    """A 3 x 3 convolution on a grid whose axes may wrap: (b, i, h, w) to (b, o, h, w)."""

    def __init__(self, inputs: int, outputs: int, periodic: tuple[bool, ...]) -> None:
        super().__init__()
        self.periodic = periodic
        self.conv = nn.Conv2d(inputs, outputs, 3)

    def forward(self, values: Tensor) -> Tensor:
        """Joined at the ends, or zero beyond limits."""
        for axis, wraps in zip((2, 3), self.periodic, strict=True):
            first, last = values.narrow(axis, 0, 1), values.narrow(axis, values.shape[axis] - 1, 1)
            parts = [last, values, first] if wraps else [0.0 * first, values, 0.0 * last]
            values = torch.cat(parts, dim=axis)
        convolved: Tensor = self.conv(values)
        return convolved


class Block(nn.Module):
    """Two convolutions, with what came in added to what goes out."""

    def __init__(self, inputs: int, outputs: int, periodic: tuple[bool, ...]) -> None:
        super().__init__()
        self.first = WrappedConv(inputs, outputs, periodic)
        self.second = WrappedConv(outputs, outputs, periodic)

    def forward(self, values: Tensor) -> Tensor:
        """(b, inputs, h, w) to (b, outputs, h, w)."""
        before = functional.leaky_relu(self.first(values), 0.1)
        return functional.leaky_relu(self.second(before), 0.1) + before


class CellMaps(NamedTuple):
    """What the U-Net tells of each cell.

    Args:
        density: (b, n) logits of the path's share in it.
        progress: (b, n) logits of the place along the path.
        offset: (b, n, 2) from the cell's centre, in cells.
    """

    density: Tensor
    progress: Tensor
    offset: Tensor


class PathUNet(nn.Module):
    """The U-Net: maps (b, k, c, c), start and goal (b, d) rad to :class:`CellMaps`.

    The maps are the head's confidence and, for ``ways``, the detour and the progress of
    :mod:`training.models.ways.fields`. It works at half their resolution and below, where convolutions cost a
    quarter; the last one sees them again as they are.
    """

    def __init__(self, grid: CellGrid, width: int, *, ways: bool) -> None:
        super().__init__()
        self.grid, self.ways, periodic = grid, ways, grid.periodic
        channels = 6 if ways else 3
        self.down = nn.ModuleList(
            [
                Block(4 * channels, width, periodic),
                Block(width, 2 * width, periodic),
                Block(2 * width, 2 * width, periodic),
            ]
        )
        self.up = nn.ModuleList([Block(4 * width, 2 * width, periodic), Block(3 * width, width, periodic)])
        self.last = nn.Sequential(
            WrappedConv(width // 4 + channels, 16, periodic), nn.LeakyReLU(0.1), nn.Conv2d(16, OUTPUTS, 1)
        )

    @property
    def maps(self) -> int:
        """How many maps it sees."""
        return 3 if self.ways else 1

    def forward(self, maps: Tensor, start: Tensor, goal: Tensor) -> CellMaps:
        """What it tells of every cell."""
        ends = torch.stack([self.grid.marks(start), self.grid.marks(goal)], dim=1)
        detour = [torch.exp(-maps[:, 1:2] / scale) for scale in DETOUR_RAD] if self.ways else []
        seen = torch.cat([maps[:, :1], ends, *detour, *([maps[:, 2:]] if self.ways else [])], dim=1)
        values, kept = functional.pixel_unshuffle(seen, 2), []
        for level, block in enumerate(self.down):
            values = block(values if level == 0 else functional.avg_pool2d(values, 2))
            kept.append(values)
        for block, beside in zip(self.up, (kept[1], kept[0]), strict=True):
            values = block(torch.cat([functional.interpolate(values, scale_factor=2.0), beside], dim=1))
        whole = self.last(torch.cat([functional.pixel_shuffle(values, 2), seen], dim=1))
        flat = whole.flatten(2)
        return CellMaps(flat[:, 0], flat[:, 1], flat[:, 2:].transpose(1, 2))
