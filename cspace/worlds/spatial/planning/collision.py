"""Collision checks of a serial arm in one scene, by the spheres that cover it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.space import JointSpace
from cspace.workshop import EdgeTest, StateTest
from cspace.worlds.spatial.frames import moved
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.obstacles.signed_distance import sets_are_free
from cspace.worlds.spatial.planning.distance_grid import NOTHING, DistanceGrid
from cspace.worlds.spatial.planning.kernels import (
    checked_edge,
    clearance_batch,
    edge_batch,
    free_batch,
    room_of,
    scene_arrays,
    state_is_free,
)
from cspace.worlds.spatial.planning.tree_growth import advance
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.covering import grouped
from cspace.worlds.spatial.robot.kinematics import arm_arrays, sphere_centres_batch


class CollisionChecker:
    """The port :class:`cspace.workshop.Checker` for a serial arm.

    Args:
        arm: with its spheres.
        obstacles: in the base frame.
        grid: distances to what else is there, as pictures show it.
    """

    def __init__(self, arm: SerialArm, obstacles: Obstacles, grid: DistanceGrid = NOTHING) -> None:
        self.arm, self.obstacles = arm, obstacles
        self.scene = scene_arrays(arm, obstacles, grid)

    @property
    def space(self) -> JointSpace:
        """The arm's joint space."""
        return self.arm.space

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        found: NDArray[np.bool_] = free_batch(self._rows(configurations), self.scene)
        return found

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance to obstacles or of the arm to itself, of (N, d) rad, (N,) m; negative in collision."""
        found: NDArray[np.float64] = clearance_batch(self._rows(configurations), self.scene)
        return found

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the straight way between two configurations (d,) rad is free."""
        first, second = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(first, second, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the ways between (N, d) and (N, d) rad are free, (N,).

        Raises:
            ScenarioError: the shapes differ or the resolution is not positive.
        """
        first, second = self._rows(starts), self._rows(ends)
        if first.shape != second.shape or not resolution_rad > 0.0:
            raise ScenarioError(
                "the edges do not fit",
                expected="as many starts as ends and a positive resolution",
                got=f"{first.shape}, {second.shape}, {resolution_rad} rad",
            )
        found: NDArray[np.bool_] = edge_batch(first, second, float(resolution_rad), self.scene)
        return found

    def state_test(self) -> StateTest:
        """See :meth:`cspace.workshop.Checker.state_test`."""
        scene, room = self.scene, room_of(self.scene)

        def is_free(configuration: NDArray[np.float64]) -> bool:
            return bool(state_is_free(configuration, scene, room))

        # A process's first call loads the compiled kernel, which is no part of a search.
        is_free(np.zeros(self.arm.dim))
        return is_free

    def edge_test(self, resolution_rad: float) -> EdgeTest:
        """See :meth:`cspace.workshop.Checker.edge_test`."""
        scene, room = self.scene, room_of(self.scene)

        def check(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[bool, int]:
            found: tuple[bool, int] = checked_edge(start, end, resolution_rad, scene, room)
            return found

        check(np.zeros(self.arm.dim), np.zeros(self.arm.dim))
        return check

    def grow_trees(
        self,
        nodes: NDArray[np.float64],
        parents: NDArray[np.int64],
        counts: NDArray[np.int64],
        checks: NDArray[np.int64],
        states: NDArray[np.float64],
        side: int,
        range_rad: float,
        resolution_rad: float,
    ) -> tuple[int, int, int, int]:
        """See :func:`cspace.worlds.spatial.planning.tree_growth.advance`."""
        grown: tuple[int, int, int, int] = advance(
            nodes, parents, counts, checks, states, side, range_rad, resolution_rad, self.scene
        )
        return grown

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.arm.dim:
            raise ScenarioError(
                "the configurations do not fit the robot",
                expected=f"shape (N, {self.arm.dim})",
                got=str(rows.shape),
            )
        return rows


def group_hits(
    arm: SerialArm, obstacles: Obstacles, configurations: ArrayLike, groups: int
) -> NDArray[np.bool_]:
    """Which groups of spheres touch an obstacle at (N, d) rad, (N, G); those that do not move are left out.

    Args:
        arm: with its spheres.
        obstacles: in the base frame.
        configurations: of the arm.
        groups: as :func:`cspace.worlds.spatial.robot.covering.grouped` has it.
    """
    found, radii, stood = grouped(arm, groups), arm.spheres_m()[:, 3], obstacles.arrays
    rows = np.ascontiguousarray(configurations, dtype=np.float64)
    centres = sphere_centres_batch(rows, arm_arrays(arm))
    moving = np.flatnonzero(found.links > 0)
    round_groups = moved(arm.link_frames(rows)[:, found.links], found.spheres_m[:, :3])

    def are_hit(spheres: NDArray[np.float64], own: NDArray[np.float64]) -> NDArray[np.bool_]:
        held = np.ascontiguousarray(spheres)
        return np.asarray(~sets_are_free(held, own.copy(), stood.boxes, stood.cylinders))

    hits = np.zeros((len(rows), len(moving)), dtype=np.bool_)
    for column, number in enumerate(moving):
        # Few of the spheres that hold a group are near anything.
        perhaps = are_hit(round_groups[:, number, None], found.spheres_m[number, 3:])
        members = np.flatnonzero(found.groups == number)
        hits[perhaps, column] = are_hit(centres[perhaps][:, members], radii[members])
    return hits
