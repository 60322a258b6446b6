"""Pixel-aligned look-ups: what the picture shows where the robot would be.

Forward kinematics and the camera's frame are known, obstacles are not. Reading the picture along the links is
what a single latent for the whole picture cannot give: sharp answers near contact.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.errors import ConfigError
from cspace.robot import PlanarArm
from cspace.scenario import Camera
from training.config import LookupConfig


class ArmLookups(nn.Module):
    """Reads pictures at points along the links of an arm and beside them.

    Args:
        robot: links and their lengths.
        camera: the part of the plane that the pictures show.
        points_per_link: along each link, from its first joint to its tip.
        side_m: distance of the two rows of points beside each link, m; with 0 there is the middle row alone.

    Shapes: pictures (p, 3, P, P), configurations (p, c, d) rad to (p, c, values).
    """

    along: Tensor
    lengths: Tensor
    sides: Tensor

    def __init__(self, robot: PlanarArm, camera: Camera, points_per_link: int, side_m: float) -> None:
        super().__init__()
        self.frame = (camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m)
        sides = [-side_m, 0.0, side_m] if side_m > 0.0 else [0.0]
        self.points = len(sides) * points_per_link * len(robot.link_lengths_m)
        self.values = 3 * self.points
        shares = torch.linspace(0.0, 1.0, points_per_link)
        self.register_buffer("along", shares, persistent=False)
        self.register_buffer("lengths", torch.tensor(robot.link_lengths_m), persistent=False)
        self.register_buffer("sides", torch.tensor(sides), persistent=False)

    def forward(self, pictures: Tensor, configurations: Tensor) -> Tensor:
        """Bilinear values of the pictures at each configuration's points; beyond the frame, the edge's."""
        # grid_sample wants (-1, -1) at the top left corner.
        grid = 2.0 * self.shares_of_frame(configurations) - 1.0
        values = functional.grid_sample(pictures, grid, padding_mode="border", align_corners=False)
        return values.permute(0, 2, 3, 1).flatten(2)

    def shares_of_frame(self, configurations: Tensor) -> Tensor:
        """(..., d) rad to (..., points, 2), shares of the picture's width and height from its top left."""
        x_min, x_max, y_min, y_max = self.frame
        points = self.positions(configurations)
        across = (points[..., 0] - x_min) / (x_max - x_min)
        # Row 0 of a picture is its top.
        down = (y_max - points[..., 1]) / (y_max - y_min)
        return torch.stack([across, down], dim=-1)

    def positions(self, configurations: Tensor) -> Tensor:
        """Points of the links in the plane: (..., d) rad to (..., points, 2) m."""
        angles = torch.cumsum(configurations, dim=-1)
        direction = torch.stack([torch.cos(angles), torch.sin(angles)], dim=-1)
        steps = direction * self.lengths.unsqueeze(-1)
        joints = torch.cumsum(steps, dim=-2) - steps
        normal = torch.stack([-direction[..., 1], direction[..., 0]], dim=-1)
        line = joints.unsqueeze(-2) + self.along.unsqueeze(-1) * steps.unsqueeze(-2)
        rows = line.unsqueeze(-3) + (self.sides.unsqueeze(-1) * normal.unsqueeze(-2)).unsqueeze(-2)
        return rows.flatten(-4, -2)


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
        self.lookups, self.side = lookups, images.shape[1]
        self.register_buffer("pixels", images.reshape(-1, images.shape[3]), persistent=False)

    def forward(self, ids: Tensor, configurations: Tensor) -> Tensor:
        """Bilinear values at each configuration's points in the picture of its id; beyond it, the edge's."""
        side = self.side
        place = (self.lookups.shares_of_frame(configurations) * side - 0.5).clamp(0.0, side - 1.0)
        corner = place.detach().floor().clamp(max=side - 2)
        across, down = (place - corner).unsqueeze(-1).unbind(dim=-2)
        first = (corner[..., 1] * side + corner[..., 0]).long() + ids.unsqueeze(-1) * side * side

        def pixel(offset: int) -> Tensor:
            return self.pixels[first + offset].to(across.dtype)

        upper = torch.lerp(pixel(0), pixel(1), across)
        lower = torch.lerp(pixel(side), pixel(side + 1), across)
        return (torch.lerp(upper, lower, down) / 127.5 - 1.0).flatten(1)


@dataclass(frozen=True, slots=True)
class Scenes:
    """The pictures with what look-ups need to know of them.

    Args:
        robot: the arm.
        camera: the frame of the pictures.
        images: (S, P, P, 3) uint8.
    """

    robot: PlanarArm
    camera: Camera
    images: Tensor


def make_lookups(config: LookupConfig, robot: PlanarArm, camera: Camera) -> ArmLookups | None:
    """The look-ups that a configuration names; None for none."""
    if config.points_per_link == 0:
        return None
    return ArmLookups(robot, camera, config.points_per_link, config.side_m)


def make_reader(config: LookupConfig, scenes: Scenes | None) -> PictureReader | None:
    """The reader that a configuration names; None for no look-ups.

    Raises:
        ConfigError: look-ups without pictures.
    """
    if config.points_per_link and scenes is None:
        raise ConfigError(
            "look-ups need the pictures",
            expected="pictures, or points_per_link=0",
            got="no pictures",
        )
    lookups = None if scenes is None else make_lookups(config, scenes.robot, scenes.camera)
    return None if lookups is None or scenes is None else PictureReader(lookups, scenes.images)


def values_read(reader: PictureReader | None) -> int:
    """How many values a reader gives for one configuration; 0 for none."""
    return 0 if reader is None else reader.lookups.values
