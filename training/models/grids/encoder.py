"""Arrays of space to features on a coarser grid."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import GridArm

# What a voxel of 5 cm says: nearest surface; seen free, no reading, out of view, hidden; how far behind.
CHANNELS = 6
# Voxels of the picture along a side of a voxel of features.
STRIDE = 4
_HALF = 0.5 / 255.0


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv3d(width, width, 3, padding=1) for _ in range(2))
        self.norm = nn.GroupNorm(4, width)

    def forward(self, features: Tensor) -> Tensor:
        inner = functional.relu(self.norm(self.first(functional.relu(features))))
        found: Tensor = features + self.second(inner)
        return found


class GridEncoder(nn.Module):
    """Pictures (p, 2, X, Y, Z) in [0, 1] to features (p, C, X / 4, Y / 4, Z / 4), and pooled ones (p, L).

    A U-net of three scales: each sees more of the scene than the one before.
    """

    def __init__(self, arm: GridArm, width: int, middle: int, deep: int) -> None:
        super().__init__()
        self.no_reading = arm.no_reading / 255.0
        self.into = nn.Conv3d(CHANNELS, width, 2, stride=2)
        self.where = nn.Conv3d(3, width, 1)
        self.fine, self.fine_again = _Residual(width), _Residual(width)
        self.down, self.up = nn.Conv3d(width, middle, 2, stride=2), nn.Conv3d(middle, width, 1)
        self.middle, self.middle_again = _Residual(middle), _Residual(middle)
        self.deeper, self.out_of_deep = nn.Conv3d(middle, deep, 2, stride=2), nn.Conv3d(deep, middle, 1)
        self.deep = _Residual(deep)

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Features, and what the deepest scale says on the whole."""
        told = self._channels(pictures)
        axes = [torch.linspace(-1.0, 1.0, size // 2) for size in told.shape[2:]]
        places = torch.stack(torch.meshgrid(*axes, indexing="ij")).to(told.device).unsqueeze(0)
        fine = self.fine(self.into(told) + self.where(places))
        middle = self.middle(self.down(functional.relu(fine)))
        deep = self.deep(self.deeper(functional.relu(middle)))
        middle = self.middle_again(middle + _doubled(self.out_of_deep(functional.relu(deep))))
        fine = self.fine_again(fine + _doubled(self.up(functional.relu(middle))))
        return functional.relu(fine), deep.mean(dim=(2, 3, 4))

    def _channels(self, pictures: Tensor) -> Tensor:
        near, code = pictures[:, :1], pictures[:, 1:]
        free, out = (code < _HALF).float(), (code > 1.0 - _HALF).float()
        unread = ((code - self.no_reading).abs() < _HALF).float()
        hidden = 1.0 - free - out - unread
        told = functional.avg_pool3d(torch.cat([free, unread, out, hidden, hidden * code], dim=1), 2)
        return torch.cat([-functional.max_pool3d(-near, 2), told], dim=1)


def _doubled(features: Tensor) -> Tensor:
    doubled: Tensor = functional.interpolate(features, scale_factor=2.0, mode="nearest")
    return doubled
