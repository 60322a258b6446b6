"""What depth pictures show, for checks that know the pictures alone."""

import numpy as np
from numpy.typing import NDArray

from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.planning.distance_grid import clear_spheres, distance_grid
from cspace.worlds.spatial.robot.kinematics import arm_arrays, sphere_centres_batch
from cspace.worlds.spatial.seeing.observed import distances_m
from cspace.worlds.spatial.world import SpatialWorld

# That is kept to what is seen; the most careful first.
MARGINS_M = (0.015, 0.005, 0.0)
# More than what lies between the centres of neighbouring voxels.
_ROOM_M = 0.035
_NO_OBSTACLES = Obstacles((), ())


def seen_checkers(
    world: SpatialWorld,
    picture: NDArray[np.uint8],
    ends: NDArray[np.float64],
    obstacles: Obstacles = _NO_OBSTACLES,
) -> list[CollisionChecker]:
    """See :func:`cspace.worlds.seen_checkers`; distances are those of the picture's voxels.

    Obstacles are known to stand there, too, whatever the picture shows.
    """
    arm, grid = world.body, world.sensor.grid
    arrays = arm_arrays(arm)
    moving = arrays.links > 0
    centres = sphere_centres_batch(np.ascontiguousarray(ends, dtype=np.float64), arrays)[:, moving]
    radii = np.tile(arrays.radii[moving], len(centres))
    found = []
    for margin_m in MARGINS_M:
        known = distance_grid(distances_m(picture) - np.float32(margin_m), grid.low_m, grid.voxel_m)
        clear_spheres(known, centres.reshape(-1, 3), radii, _ROOM_M)
        found.append(CollisionChecker(arm, obstacles, known))
    return found
