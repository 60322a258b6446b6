"""Where an arm is read in its camera's pictures: points along its links and beside them.

A point of the arm is linear in the cosines and sines of the directions of its links, and so is its place in a
picture that shows the plane to scale.
"""

import numpy as np
from numpy.typing import NDArray

from cspace.world import Levers
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.seeing.camera import Camera


def levers(robot: PlanarArm, camera: Camera, points_per_link: int, side_m: float) -> Levers:
    """See :meth:`cspace.world.World.levers`."""
    sides = [-side_m, 0.0, side_m] if side_m > 0.0 else [0.0]
    along, beside = _reaches(robot, points_per_link, np.asarray(sides, dtype=np.float32))
    points = along.shape[1]
    width = np.float32(camera.x_max_m - camera.x_min_m)
    height = np.float32(camera.y_max_m - camera.y_min_m)
    across = np.concatenate([along, -beside]) / width
    # Row 0 of a picture is its top.
    down = -np.concatenate([beside, along]) / height
    left = -camera.x_min_m / (camera.x_max_m - camera.x_min_m)
    top = camera.y_max_m / (camera.y_max_m - camera.y_min_m)
    origin = np.repeat(np.asarray([left, top], dtype=np.float32), points)
    return Levers(np.concatenate([across, down], axis=1), origin)


def _reaches(
    robot: PlanarArm, points_per_link: int, sides: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What each link adds to each point along its own direction and across it, both (d, points) m."""
    lengths = np.asarray(robot.link_lengths_m, dtype=np.float32)
    links = len(lengths)
    along = np.zeros((links, links, len(sides), points_per_link), dtype=np.float32)
    beside = np.zeros_like(along)
    for link in range(links):
        along[:link, link] = lengths[:link, None, None]
        along[link, link] = lengths[link] * _shares(points_per_link)
        beside[link, link] = sides[:, None]
    return along.reshape(links, -1), beside.reshape(links, -1)


def _shares(count: int) -> NDArray[np.float32]:
    """0 to 1 in equal steps, from both ends in single precision."""
    index = np.arange(count, dtype=np.float32)
    step = np.float32(1.0) / np.float32(max(1, count - 1))
    from_end = np.float32(1.0) - step * (np.float32(count - 1) - index)
    return np.where(index < count // 2, step * index, from_end) if count > 1 else np.zeros(1, np.float32)
