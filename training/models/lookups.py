"""Pixel-aligned look-ups: what a picture, or an array of space, shows where the arm would be."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.errors import ConfigError
from cspace.world import World
from training.models.joints import Points
from training.models.kinematics import ArmPoints, buffer
from training.models.settings import LookupConfig

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
        near, known = points.interpolate(table), points.interpolate(table, 1, self._known)
        return self.features(torch.cat([near, known], dim=-1).reshape(scenes, count, self.groups, -1))

    def places(self, configurations: Tensor) -> Tensor:
        """Centres of the groups, (n, d) rad to (n, 3, G) in voxels from the grid's lowest corner."""
        _, centres = self.points(configurations)
        places: Tensor = (centres - self.low) / self.voxel_m
        return places

    def read(self, codes: Tensor) -> Tensor:
        """Stored voxels (..., 2) uint8 to (..., 3): what :meth:`features` takes of them."""
        shares = codes.to(self.radii.dtype) / 255.0
        return torch.cat([shares[..., :1], self._known(shares[..., 1:])], dim=-1)

    def features(self, read: Tensor) -> Tensor:
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
        return self.lookups.features(points.interpolate(self.voxels, transform=self.lookups.read))


class ArmLookups(nn.Module):
    """Reads pictures at points along the links of an arm and beside them.

    Args:
        world: robot and sensor.
        points_per_link: along each link, from its first joint to its tip.
        side_m: distance of the two rows of points beside each link, m; with 0 there is the middle row alone.

    Shapes: pictures (p, 3, P, P), configurations (p, c, d) rad to (p, c, values).
    """

    levers: Tensor
    origin: Tensor
    levers_across: Tensor
    levers_down: Tensor
    origin_across: Tensor
    origin_down: Tensor

    def __init__(self, world: World, points_per_link: int, side_m: float) -> None:
        super().__init__()
        found = world.levers(points_per_link, side_m)
        self.points = len(found.origin) // 2
        self.values = 3 * self.points
        levers, origin = torch.from_numpy(found.levers), torch.from_numpy(found.origin)
        values = {"levers": levers, "origin": origin}
        # For each side of the picture apart, a point a row: what a served graph multiplies by.
        for side, turned, start in zip(
            ("across", "down"), levers.T.chunk(2), origin.unsqueeze(1).chunk(2), strict=True
        ):
            values |= {f"levers_{side}": turned.contiguous(), f"origin_{side}": start.contiguous()}
        for name, value in values.items():
            self.register_buffer(name, value, persistent=False)

    def forward(self, pictures: Tensor, configurations: Tensor) -> Tensor:
        """Bilinear values of the pictures at each configuration's points; beyond the frame, the edge's."""
        if len(pictures) == 1:
            return self._of_one(pictures[0], configurations[0]).unsqueeze(0)
        # grid_sample wants (-1, -1) at the top left corner.
        places = torch.stack((2.0 * self.shares_of_frame(configurations) - 1.0).chunk(2, dim=-1), dim=-1)
        values = functional.grid_sample(pictures, places, padding_mode="border", align_corners=False)
        return values.permute(0, 2, 3, 1).flatten(2)

    def _of_one(self, picture: Tensor, configurations: Tensor) -> Tensor:
        """As a served graph reads, at a fifth of what onnxruntime's GridSample takes.

        Configurations come last, so that each step goes along long rows, and single values are picked one by
        one, which costs less than picking rows and turning them (ADR 0010).
        """
        count, side = len(picture), picture.shape[-1]
        directions = _directions(configurations).T
        column, across = _cell((self.levers_across @ directions + self.origin_across) * side - 0.5, side)
        row, down = _cell((self.levers_down @ directions + self.origin_down) * side - 0.5, side)
        first = (row * side + column).long().unsqueeze(1)
        across, down = across.unsqueeze(1), down.unsqueeze(1)
        # a + b x + c y + d x y between four neighbours, as tables; what rolls in at the border is never read.
        corner = picture.flatten(1)
        right, below, beyond = (corner.roll(-step, 1) for step in (1, side, side + 1))
        tables = (corner, right - corner, below - corner, beyond - below - right + corner)
        channels = side * side * torch.arange(count, device=picture.device).view(1, -1, 1)
        places = (first + channels).flatten()
        shape = (self.points, count, -1)
        constant, by_x, by_y, by_both = (table.flatten().gather(0, places).view(shape) for table in tables)
        values: Tensor = constant + across * by_x + down * (by_y + across * by_both)
        return values.reshape(count * self.points, -1).T

    def pixels(self, configurations: Tensor, side: int) -> tuple[Tensor, Tensor, Tensor]:
        """Where the arm is read in a picture of ``side`` pixels: (..., d) rad to three of (..., points).

        The number of the upper left of four pixels, int64, and the shares of the way to its right and lower
        neighbours, 0 to 1.
        """
        places = (self.shares_of_frame(configurations) * side - 0.5).chunk(2, dim=-1)
        (column, across), (row, down) = (_cell(place, side) for place in places)
        return (row * side + column).long(), across, down

    def shares_of_frame(self, configurations: Tensor) -> Tensor:
        """(..., d) rad to (..., 2 points): shares of the picture's width, then of its height.

        A point of the arm is linear in the cosines and sines of the links' directions.
        """
        shares: Tensor = _directions(configurations) @ self.levers + self.origin
        return shares


def _directions(configurations: Tensor) -> Tensor:
    """(..., d) rad to the cosines and sines of the links' directions, (..., 2 d)."""
    angles = torch.cumsum(configurations, dim=-1)
    return torch.cat([torch.cos(angles), torch.sin(angles)], dim=-1)


def _cell(places: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """Along one axis the pixel before each place and the share of the way to the next, in the picture."""
    inside = places.clamp(0.0, side - 1.0)
    before = inside.detach().floor().clamp(max=side - 2)
    return before, inside - before


class PictureReader(nn.Module):
    """The look-ups of :class:`ArmLookups` for configurations that each have a picture of their own.

    Its derivative by the configurations has a derivative again, as the gradient penalty needs and
    ``grid_sample`` does not give; and it reads stored bytes, so that no batch of pictures is ever made.

    Args:
        lookups: where the arm reads.
        images: (S, P, P, 3) uint8, all pictures.

    Shapes: ids (b,) and configurations (b, d) rad to (b, values) in [-1, 1].
    """

    pixels: Tensor

    def __init__(self, lookups: ArmLookups, images: Tensor) -> None:
        super().__init__()
        self.lookups, self.side, self.values = lookups, images.shape[1], lookups.values
        self.register_buffer("pixels", images.reshape(-1, images.shape[3]), persistent=False)

    def forward(self, ids: Tensor, configurations: Tensor) -> Tensor:
        """Bilinear values at each configuration's points in the picture of its id; beyond it, the edge's."""
        side = self.side
        first, across, down = self.lookups.pixels(configurations, side)
        first = first + ids.unsqueeze(-1) * side * side
        across, down = across.unsqueeze(-1), down.unsqueeze(-1)

        def pixel(offset: int) -> Tensor:
            return self.pixels[first + offset].to(across.dtype)

        upper = torch.lerp(pixel(0), pixel(1), across)
        lower = torch.lerp(pixel(side), pixel(side + 1), across)
        return (torch.lerp(upper, lower, down) / 127.5 - 1.0).flatten(1)


@dataclass(frozen=True, slots=True)
class Scenes:
    """The pictures with what look-ups need to know of them.

    Args:
        world: robot and sensor.
        images: (S, P, P, 3) uint8, or (S, X, Y, Z, 2) of arrays of space.
    """

    world: World
    images: Tensor


Lookups = ArmLookups | SpaceLookups
Reader = PictureReader | SpaceReader


def make_lookups(config: LookupConfig, world: World) -> Lookups | None:
    """The look-ups that a configuration names for pictures such as a world's; None for none."""
    if world.sensor.extent_m is None:
        return SpaceLookups(world, config.groups) if config.groups else None
    if config.points_per_link == 0:
        return None
    return ArmLookups(world, config.points_per_link, config.side_m)


def make_reader(config: LookupConfig, scenes: Scenes | None) -> Reader | None:
    """The reader that a configuration names; None for no look-ups.

    Raises:
        ConfigError: look-ups without pictures.
    """
    if not config.wanted:
        return None
    if scenes is None:
        raise ConfigError(
            "look-ups need the pictures", expected="pictures, or points_per_link=0", got="no pictures"
        )
    lookups = make_lookups(config, scenes.world)
    if isinstance(lookups, SpaceLookups):
        return SpaceReader(lookups, scenes.images)
    return None if lookups is None else PictureReader(lookups, scenes.images)


def read(reader: Reader | None, ids: Tensor, configurations: Tensor) -> Tensor | None:
    """What a reader finds at configurations (b, d) in the pictures of the ids (b,); None for no look-ups."""
    return None if reader is None else reader(ids, configurations)


def values_read(found: Reader | Lookups | None) -> int:
    """How many values look-ups give for one configuration; 0 for none."""
    return 0 if found is None else found.values
