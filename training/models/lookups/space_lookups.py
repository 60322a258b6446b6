"""Look-ups in arrays of space: what a picture says of the places where a serial arm's spheres would be.

The twin of :class:`training.models.lookups.lookups.ArmLookups` for worlds that are seen in three dimensions.
"""

from dataclasses import replace

import torch
from torch import Tensor, nn

from cspace.world import World
from training.models.space.arm import ArmPoints, buffer
from training.models.space.reading import Points

# Margins to the surface seen that are told apart: about contact, and on the whole.
_NEAR_M, _FAR_M = 0.03, 0.1
_VALUES = 4
_HALF = 0.5 / 255.0


class SpaceLookups(nn.Module):
    """Reads arrays of space at the centres of an arm's groups of spheres.

    Of each group: its margin to the surface seen on two scales, the share of the voxels about its centre that
    no camera saw free, and how far behind a surface these are; all trilinear, so that they have a derivative.

    Args:
        world: robot and sensor.
        groups: of all spheres; those that do not move are left out.

    Shapes: pictures (p, 2, X, Y, Z) in [0, 1], configurations (p, c, d) rad to (p, c, values).

    Raises:
        ConfigError: pictures of the world are no arrays of space.
    """

    radii: Tensor
    low: Tensor

    def __init__(self, world: World, groups: int) -> None:
        super().__init__()
        arm = world.grid_arm(groups)
        x, y, z, _ = world.sensor.picture_shape
        self.counts, self.voxel_m, self.scale_m = (x, y, z), arm.voxel_m, 255.0 * arm.distance_step_m
        self.unknown = min(arm.no_reading, arm.out_of_view) / 255.0 - _HALF
        self.groups = len(arm.group_links)
        self.values = _VALUES * self.groups
        self.points = ArmPoints(replace(arm, spheres_m=arm.spheres_m[:0], links=arm.links[:0]))
        self.register_buffer("radii", buffer(arm.group_spheres_m[:, 3:]), persistent=False)
        self.register_buffer("low", buffer(arm.low_m)[:, None], persistent=False)

    def forward(self, pictures: Tensor, configurations: Tensor) -> Tensor:
        """What each picture says at each of its configurations; beyond the grid, what its edge says."""
        scenes, count, dim = configurations.shape
        places = self.places(configurations.reshape(-1, dim)).reshape(scenes, count, 3, self.groups)
        points = Points(places.transpose(1, 2).reshape(scenes, 3, -1), self.counts, 2)
        table = pictures.reshape(-1, 1)
        near, known = points.between(table), points.between(table, 1, self._known)
        return self.told(torch.cat([near, known], dim=-1).reshape(scenes, count, self.groups, -1))

    def places(self, configurations: Tensor) -> Tensor:
        """Centres of the groups, (n, d) rad to (n, 3, G) in voxels from the grid's lowest corner."""
        _, centres = self.points(configurations)
        places: Tensor = (centres - self.low) / self.voxel_m
        return places

    def read(self, codes: Tensor) -> Tensor:
        """Stored voxels (..., 2) uint8 to (..., 3): what :meth:`told` takes of them."""
        shares = codes.to(self.radii.dtype) / 255.0
        return torch.cat([shares[..., :1], self._known(shares[..., 1:])], dim=-1)

    def told(self, read: Tensor) -> Tensor:
        """(..., G, 3): distance as a share of the farthest, unseen, depth; to (..., values)."""
        margins = read[..., :1] * self.scale_m - self.radii
        scales = [margins / _FAR_M, torch.tanh(margins / _NEAR_M)]
        return torch.cat([*scales, read[..., 1:]], dim=-1).flatten(-2)

    def _known(self, codes: Tensor) -> Tensor:
        """Codes (..., 1) in [0, 1] to whether not seen free, and the depth behind a surface, (..., 2)."""
        unseen = (codes > _HALF).to(codes.dtype)
        return torch.cat([unseen, torch.where(codes < self.unknown, codes, torch.zeros_like(codes))], dim=-1)


class SpaceReader(nn.Module):
    """The look-ups of :class:`SpaceLookups` for configurations that each have a picture of their own.

    It reads stored bytes where they lie, in memory or on disk, so that no batch of pictures is ever made.

    Args:
        lookups: where the arm reads.
        images: (S, X, Y, Z, 2) uint8, all pictures.

    Shapes: ids (b,) and configurations (b, d) rad to (b, values).
    """

    voxels: Tensor

    def __init__(self, lookups: SpaceLookups, images: Tensor) -> None:
        super().__init__()
        self.lookups, self.values = lookups, lookups.values
        self.register_buffer("voxels", images.reshape(-1, images.shape[-1]), persistent=False)

    def forward(self, ids: Tensor, configurations: Tensor) -> Tensor:
        """What the picture of each id says at its configuration."""
        points = Points(self.lookups.places(configurations), self.lookups.counts, scenes=ids)
        return self.lookups.told(points.between(self.voxels, told=self.lookups.read))
