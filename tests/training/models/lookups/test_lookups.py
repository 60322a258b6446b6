"""Where the arm reads the picture, and what it reads there."""

import numpy as np
import pytest
import torch

from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from training.models.lookups import ArmLookups, PictureReader

THREE_LINK = PlanarArm((1.6, 1.4, 1.0), 0.1)


def positions(lookups, camera, configurations):
    """Points of the links in the plane: (..., d) rad to (..., points, 2) m."""
    across, down = lookups.shares_of_frame(configurations).chunk(2, dim=-1)
    x = camera.x_min_m + across * (camera.x_max_m - camera.x_min_m)
    y = camera.y_max_m - down * (camera.y_max_m - camera.y_min_m)
    return torch.stack([x, y], dim=-1)


@pytest.mark.parametrize(
    "camera", [Camera(), Camera(x_min_m=-3.0, x_max_m=6.0, y_min_m=-7.0, y_max_m=5.0)], ids=["usual", "other"]
)
def test_a_picture_that_shows_coordinates_is_read_as_the_points_coordinates(camera):
    # Pixel centres, y up: each pixel holds where it is, and bilinear look-ups are exact for that.
    centre = (np.arange(camera.pixels) + 0.5) / camera.pixels
    x = camera.x_min_m + centre * (camera.x_max_m - camera.x_min_m)
    y = camera.y_max_m - centre * (camera.y_max_m - camera.y_min_m)
    picture = torch.tensor(np.stack(np.meshgrid(x, y)), dtype=torch.float32)[None]
    lookups = ArmLookups(PlanarWorld(PlanarArm((1.2, 1.0), 0.1), camera), points_per_link=5, side_m=0.1)
    configurations = torch.rand(1, 7, 2, generator=torch.Generator().manual_seed(0)) * 6.0 - 3.0
    read = lookups(picture, configurations).view(1, 7, lookups.points, 2)
    torch.testing.assert_close(read, positions(lookups, camera, configurations), atol=1e-4, rtol=0.0)


def test_one_picture_alone_is_read_as_among_others():
    rng = torch.Generator().manual_seed(1)
    pictures, lookups = (
        torch.rand(3, 3, 48, 48, generator=rng),
        ArmLookups(PlanarWorld(THREE_LINK, Camera()), 6, 0.2),
    )
    configurations = torch.rand(3, 50, 3, generator=rng) * 6.0 - 3.0
    together = lookups(pictures, configurations)
    for picture, rows, expected in zip(pictures, configurations, together, strict=True):
        alone = lookups(picture.unsqueeze(0), rows.unsqueeze(0)).squeeze(0)
        torch.testing.assert_close(alone, expected, atol=2e-5, rtol=0.0)


def reader(points_per_link=4, side_m=0.1):
    images = torch.randint(256, (3, 48, 48, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(2))
    return PictureReader(
        ArmLookups(PlanarWorld(THREE_LINK, Camera()), points_per_link, side_m), images
    ), images


def test_the_reader_sees_in_each_ones_picture_what_the_lookups_see():
    read, images = reader()
    rng = torch.Generator().manual_seed(0)
    ids, configurations = torch.tensor([2, 0, 1, 2]), torch.rand(4, 3, generator=rng) * 6.0 - 3.0
    pictures = images[ids].permute(0, 3, 1, 2).float() / 127.5 - 1.0
    expected = read.lookups(pictures, configurations.unsqueeze(1)).squeeze(1)
    torch.testing.assert_close(read(ids, configurations), expected, atol=2e-4, rtol=0.0)


def test_the_readers_derivative_and_its_derivative_are_those_of_finite_differences():
    read, _ = reader(points_per_link=2)
    read = read.double()
    ids = torch.tensor([0, 1])
    configurations = torch.tensor([[0.3, -1.1, 2.0], [1.7, 0.4, -0.6]], dtype=torch.float64)
    configurations.requires_grad_()
    see = lambda q: read(ids, q).square().mean(dim=1)  # noqa: E731
    assert torch.autograd.gradcheck(see, configurations, eps=1e-7, atol=1e-4)
    assert torch.autograd.gradgradcheck(see, configurations, eps=1e-7, atol=1e-3)
