"""Pixel-aligned look-ups: what a picture shows where a planar arm would be."""

from dataclasses import dataclass

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional

from cspace.world import World
from training.config_section import Section


class LookupConfig(Section):
    """Where a network reads a picture of a plane: along the links and beside them."""

    points_per_link: int = Field(0, ge=0, description="0 for no look-ups")
    side_m: float = Field(0.0, ge=0, description="distance of the rows beside each link; 0 for none")

    @model_validator(mode="after")
    def _one_point_is_no_row(self) -> "LookupConfig":
        if self.points_per_link == 1:
            raise ValueError("points_per_link counts both ends of a link: 2 or more, or 0 for no look-ups")
        return self


class ArmLookups(nn.Module):
    """Reads pictures at points along the links of an arm and beside them.

    ``side_m`` distance of the two rows of points beside each link, m; with 0 there is the middle row alone.
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
        found = world.link_sample_points(points_per_link, side_m)
        self.points = len(found.origin) // 2
        self.values = 3 * self.points
        levers, origin = torch.from_numpy(found.offsets), torch.from_numpy(found.origin)
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

    ``images`` (S, P, P, 3) uint8, all pictures. Shapes: ids (b,) and configurations (b, d) rad to (b,
    values) in [-1, 1].
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
    """The pictures with what look-ups need to know of them."""

    world: World
    images: Tensor  # (S, P, P, 3) uint8


def make_lookups(config: LookupConfig, world: World) -> ArmLookups | None:
    """The look-ups that a configuration names for pictures such as a world's; None for none."""
    if config.points_per_link == 0:
        return None
    return ArmLookups(world, config.points_per_link, config.side_m)


# Of a generator and of its critic.
Readers = tuple[PictureReader | None, PictureReader | None]


def make_reader(config: LookupConfig, scenes: Scenes | None) -> PictureReader | None:
    """The reader that a configuration names; None for no look-ups."""
    if config.points_per_link == 0:
        return None
    assert scenes is not None  # noqa: S101 - for the type checker
    return PictureReader(ArmLookups(scenes.world, config.points_per_link, config.side_m), scenes.images)


def read(reader: PictureReader | None, ids: Tensor, configurations: Tensor) -> Tensor | None:
    """What a reader finds at configurations (b, d) in the pictures of the ids (b,); None for no look-ups."""
    return None if reader is None else reader(ids, configurations)


def values_read(found: PictureReader | ArmLookups | None) -> int:
    """How many values look-ups give for one configuration; 0 for none."""
    return 0 if found is None else found.values


def look(lookups: ArmLookups | None, image: Tensor | None, base: Tensor) -> Tensor | None:
    """What one picture (1, ...) shows at (m, d) configurations, (m, values); None without look-ups."""
    if lookups is None or image is None:
        return None
    seen: Tensor = lookups(image, base.unsqueeze(0))
    return seen.squeeze(0)
