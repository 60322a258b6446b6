"""What a model takes unseen space to hold: how likely an arm touches it, and checks that stay clear of it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from cspace.kernel_cache import njit
from cspace.query import DOUBTED
from cspace.worlds.spatial.bodies import reach_into
from cspace.worlds.spatial.collision import CollisionChecker, world_checkers
from cspace.worlds.spatial.kinematics import arm_arrays, link_frames_into, points_into, sphere_centres_batch
from cspace.worlds.spatial.obstacles import NO_BODIES
from cspace.worlds.spatial.sensor import FREE
from cspace.worlds.spatial.visibility import distances_m

# How far a careful path keeps away from doubted voxels, m.
_MARGIN_M = 0.005
# About an arm whose configuration is free, m.
_ROOM_M = 0.03


class UnseenSpace:
    """The occupancy (X, Y, Z) of what no picture shows free.

    Args:
        world: arm and grid.
        picture: uint8 (X, Y, Z, 2).
        occupancy: (X, Y, Z), how likely each voxel holds something.
        ends: (k, d) rad, configurations about which the arm has room.
        known: a scene checker, whose arm may hold a body; None without one.
    """

    def __init__(
        self,
        world: Any,
        picture: NDArray[np.uint8],
        occupancy: NDArray[np.floating],
        ends: NDArray[np.float64],
        known: Any = None,
    ) -> None:
        self._grid, self._low, self._ends = world.sensor.grid, np.asarray(world.sensor.grid.low_m), ends
        self._arm, self._bodies, self._picture = world.body, NO_BODIES, picture
        if known is not None:
            self._arm, self._bodies = known.arm, known.bodies
            self._picture = picture if known.seen is None else known.seen
        arrays = arm_arrays(self._arm)
        self._held = np.where(self._picture[..., 1] == FREE, 0.0, occupancy).astype(np.float32)
        moving = arrays.links > 0
        centres = sphere_centres_batch(np.ascontiguousarray(ends, dtype=np.float64), arrays)[:, moving]
        radii = np.tile(arrays.radii[moving], len(ends))
        _clear_into(self._held, self._low, self._grid.voxel_m, centres.reshape(-1, 3), radii)

    def touched(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """The highest occupancy (n,) of a voxel within the arm's spheres at configurations (n, d) rad."""
        arrays = arm_arrays(self._arm)
        found: NDArray[np.float32] = _highest(
            rows.astype(np.float64), arrays, self._held, self._low, self._grid.voxel_m
        )
        return found

    def careful_checker(self) -> CollisionChecker:
        """Checks by what is seen, and by all voxels that may well hold something."""
        away, doubted = distances_m(self._picture), self._held > DOUBTED
        if doubted.any():
            away = np.minimum(away, self._grid.voxel_m * distance_transform_edt(~doubted))
        careful = [away.astype(np.float32) - np.float32(_MARGIN_M)]
        return world_checkers(self._arm, careful, self._grid, self._ends, bodies=self._bodies)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _clear_into(values, low, voxel, centres, radii):  # type: ignore[no-untyped-def]
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for at in range(centres.shape[0]):
        reach_into(first, last, values.shape, low, voxel, centres[at], radii[at] + _ROOM_M)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    if _is_within(i, j, k, low, voxel, centres[at], radii[at] + _ROOM_M):
                        values[i, j, k] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(rows, arm, values, low, voxel):  # type: ignore[no-untyped-def]
    found = np.zeros(rows.shape[0], dtype=np.float32)
    frames, centres = np.empty((arm.axes.shape[0] + 1, 4, 4)), np.empty(arm.centres.shape)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for row in range(rows.shape[0]):
        link_frames_into(rows[row], arm.origins, arm.axes, frames)
        points_into(frames, arm.links, arm.centres, centres)
        most = np.float32(0.0)
        for at in range(centres.shape[0]):
            if arm.links[at] == 0:
                continue
            reach_into(first, last, values.shape, low, voxel, centres[at], arm.radii[at])
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    for k in range(first[2], last[2] + 1):
                        # Few voxels hold more than what is found already, and only these are measured.
                        if values[i, j, k] > most and _is_within(
                            i, j, k, low, voxel, centres[at], arm.radii[at]
                        ):
                            most = values[i, j, k]
        found[row] = most
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _is_within(i, j, k, low, voxel, centre, radius):  # type: ignore[no-untyped-def]
    x = low[0] + (i + 0.5) * voxel - centre[0]
    y = low[1] + (j + 0.5) * voxel - centre[1]
    z = low[2] + (k + 0.5) * voxel - centre[2]
    return x * x + y * y + z * z <= radius * radius
