"""Pixel-aligned look-ups: what the picture shows where the robot would be.

Forward kinematics and the camera's frame are known, obstacles are not. Reading the picture along the links is
what a single latent for the whole picture cannot give: sharp answers near contact.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from cspace.robot import PlanarArm
from cspace.scenario import Camera


class ArmLookups(nn.Module):
    """Reads pictures at points along the links of an arm and beside them.

    Args:
        robot: links and their lengths.
        camera: the part of the plane that the pictures show.
        points_per_link: along each link, from its first joint to its tip.
        side_m: distance of the two rows of points beside each link, m.

    Shapes: pictures (p, C, P, P), configurations (p, c, d) rad to (p, c, points * C).
    """

    along: Tensor
    lengths: Tensor
    sides: Tensor

    def __init__(self, robot: PlanarArm, camera: Camera, points_per_link: int, side_m: float) -> None:
        super().__init__()
        self.frame = (camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m)
        self.points = 3 * points_per_link * len(robot.link_lengths_m)
        shares = torch.linspace(0.0, 1.0, points_per_link)
        self.register_buffer("along", shares, persistent=False)
        self.register_buffer("lengths", torch.tensor(robot.link_lengths_m), persistent=False)
        self.register_buffer("sides", torch.tensor([-side_m, 0.0, side_m]), persistent=False)

    def forward(self, pictures: Tensor, configurations: Tensor) -> Tensor:
        """Bilinear values of the pictures at each configuration's points; beyond the frame, the edge's."""
        x_min, x_max, y_min, y_max = self.frame
        points = self.positions(configurations)
        # Row 0 of a picture is its top; grid_sample wants (-1, -1) at the top left corner.
        across = (points[..., 0] - x_min) * (2.0 / (x_max - x_min)) - 1.0
        down = 1.0 - (points[..., 1] - y_min) * (2.0 / (y_max - y_min))
        values = functional.grid_sample(
            pictures, torch.stack([across, down], dim=-1), padding_mode="border", align_corners=False
        )
        return values.permute(0, 2, 3, 1).flatten(2)

    def positions(self, configurations: Tensor) -> Tensor:
        """Points of the links in the plane: (p, c, d) rad to (p, c, points, 2) m."""
        angles = torch.cumsum(configurations, dim=-1)
        direction = torch.stack([torch.cos(angles), torch.sin(angles)], dim=-1)
        steps = direction * self.lengths.unsqueeze(-1)
        joints = torch.cumsum(steps, dim=-2) - steps
        normal = torch.stack([-direction[..., 1], direction[..., 0]], dim=-1)
        line = joints.unsqueeze(-2) + self.along.unsqueeze(-1) * steps.unsqueeze(-2)
        rows = line.unsqueeze(-3) + (self.sides.unsqueeze(-1) * normal.unsqueeze(-2)).unsqueeze(-2)
        return rows.flatten(2, 4)
