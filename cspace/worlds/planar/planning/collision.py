"""Collision checks of one scenario.

A configuration is free when the clearance between every link's capsule and every disc is above zero and every
limited joint is within its limits. Where the arm collides with itself, the clearance between the capsules of
any two links that are not neighbours is above zero as well.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.space import JointSpace
from cspace.workshop import EdgeTest, StateTest
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.planning.kernels import (
    arm_is_free,
    checked_edge,
    clearance_batch,
    edge_batch,
    free_batch,
)
from cspace.worlds.planar.planning.tree_growth import advance
from cspace.worlds.planar.scene import Scenario


class CollisionChecker:
    """Exact collision checks for one scenario.

    ``kernel_args`` are the arguments that the raw kernels :func:`arm_is_free` and :func:`edge_is_free` take
    after their own.
    """

    def __init__(self, scenario: Scenario) -> None:
        space = scenario.robot.space
        self.scenario = scenario
        self.kernel_args: tuple[Any, ...] = (
            np.asarray(scenario.robot.link_lengths_m, dtype=np.float64),
            float(scenario.robot.half_width_m),
            scenario.disc_array,
            _pairs(scenario.robot),
            np.asarray(space.lower, dtype=np.float64),
            np.asarray(space.upper, dtype=np.float64),
            np.asarray(space.periodic, dtype=np.bool_),
        )

    @property
    def space(self) -> JointSpace:
        """The arm's joint space."""
        return self.scenario.robot.space

    def valid(self, configuration: ArrayLike) -> bool:
        """Whether one configuration (d,) rad is free."""
        return bool(self.valid_batch(np.atleast_2d(np.asarray(configuration, dtype=np.float64)))[0])

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""
        result: NDArray[np.bool_] = free_batch(self._rows(configurations), *self.kernel_args)
        return result

    def clearance(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Distance from arm to discs, or to itself, for each of (N, d) rad, (N,) m; negative in collision."""
        result: NDArray[np.float64] = clearance_batch(self._rows(configurations), *self.kernel_args[:4])
        return result

    def edge(self, start: ArrayLike, end: ArrayLike, resolution_rad: float) -> bool:
        """Whether the straight wrapped segment between two configurations (d,) is free."""
        start, end = (np.atleast_2d(np.asarray(q, dtype=np.float64)) for q in (start, end))
        return bool(self.edge_batch(start, end, resolution_rad)[0])

    def edge_batch(self, starts: ArrayLike, ends: ArrayLike, resolution_rad: float) -> NDArray[np.bool_]:
        """Which of the segments between (N, d) and (N, d) are free, (N,).

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
        result: NDArray[np.bool_] = edge_batch(first, second, float(resolution_rad), *self.kernel_args)
        return result

    def state_test(self) -> StateTest:
        """See :meth:`cspace.workshop.Checker.state_test`."""
        arguments = self.kernel_args

        def is_free(configuration: NDArray[np.float64]) -> bool:
            return bool(arm_is_free(configuration, *arguments))

        # A process's first call loads the compiled kernel, which is no part of a search.
        is_free(np.zeros(self.scenario.robot.dim))
        return is_free

    def edge_test(self, resolution_rad: float) -> EdgeTest:
        """See :meth:`cspace.workshop.Checker.edge_test`."""
        arguments = (resolution_rad, *self.kernel_args)

        def check(start: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[bool, int]:
            found: tuple[bool, int] = checked_edge(start, end, *arguments)
            return found

        check(np.zeros(self.scenario.robot.dim), np.zeros(self.scenario.robot.dim))
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
        """See :func:`cspace.worlds.planar.planning.tree_growth.advance`."""
        grown: tuple[int, int, int, int] = advance(
            nodes, parents, counts, checks, states, side, range_rad, resolution_rad, *self.kernel_args
        )
        return grown

    def _rows(self, configurations: ArrayLike) -> NDArray[np.float64]:
        rows = np.ascontiguousarray(configurations, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.scenario.robot.dim:
            raise ScenarioError(
                "the configurations do not fit the robot",
                expected=f"shape (N, {self.scenario.robot.dim})",
                got=str(rows.shape),
            )
        return rows


def _pairs(robot: PlanarArm) -> NDArray[np.int64] | None:
    """The links that collide with each other, (K, 2); None where none do."""
    if not robot.self_collision or robot.dim < 3:
        return None
    return np.argwhere(np.triu(np.ones((robot.dim, robot.dim)), 2)).astype(np.int64)
