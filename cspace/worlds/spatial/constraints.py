"""What a request asks of the tool: a pose at the goal, and an axis that stays near a direction all along."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import InputError
from cspace.files import read_object, validated
from cspace.simulator import Checker
from cspace.space import JointSpace
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.kinematics import Solving, aligned, solve_pose
from cspace.worlds.spatial.poses import nearest_rotation, read_pose

_Direction = tuple[float, float, float]
_Angle = Annotated[float, Field(ge=1e-3, le=np.pi)]
# Uniform configurations from which a pose is solved, and how exactly at first.
_STARTS, _PLACE_M, _TURN_RAD = 64, 0.0005, 0.005
# Of a tolerance; single precision takes a little of the rest.
_SHARE = 0.95
# Of the angle of an upright axis: what states may exceed it between those that are checked, most.
_BETWEEN_RAD, _BETWEEN_SHARE = 0.01, 0.1
# Share of that angle to which states are turned.
_ALIGNED = 0.5
# Longest step of a tree that follows the constraint, the sum over the joints; the share of it that it has to
# come nearer; and states that are taken between two looks at the clock.
_STEP_RAD, _LEAST_GAIN, _AT_ONCE = 0.6, 0.1, 4


@validated(InputError)
class GoalPose:
    """Where the tool shall be in the end."""

    pose: Any  # of its frame in the base, m, as that of a camera: 4 x 4, or translation and quaternion_xyzw
    tolerance_m: Annotated[float, Field(ge=1e-4, le=1.0)] = 0.005
    tolerance_rad: _Angle = 0.05
    free_z_rotation: bool = False  # whether any turn about the frame's z axis will do


@validated(InputError)
class Upright:
    """An axis of the tool that stays near a direction."""

    axis: _Direction  # in the tool's frame, of any length above 0
    max_rad: _Angle
    up: _Direction = (0.0, 0.0, 1.0)  # in the base frame, of any length above 0


class ToolConstraints:
    """Constraints on the tool, of plain values of a :class:`GoalPose` and an :class:`Upright`, or None."""

    def __init__(
        self, arm: SerialArm, goal_pose: Mapping[str, Any] | None, upright: Mapping[str, Any] | None
    ) -> None:
        self._arm = arm
        if goal_pose is not None:
            self._goal = read_object(GoalPose, dict(goal_pose), "goal_pose", InputError)
            self._pose = np.array(read_pose(self._goal.pose, "goal_pose", InputError))
            # Written with few digits, it is one but for rounding.
            self._pose[:3, :3] = nearest_rotation(self._pose[:3, :3])
        if upright is not None:
            bound = read_object(Upright, dict(upright), "upright", InputError)
            # Largest angle of the axis.
            self.max_rad = bound.max_rad
            # Of the last link, which the tool does not move against.
            self._axis = arm.tool.matrix()[:3, :3] @ _unit("upright.axis", bound.axis)
            self._up = _unit("upright.up", bound.up)

    @property
    def reach(self) -> str:
        goal = self._goal
        turn = f"{goal.tolerance_rad:g} rad{' of its z axis' if goal.free_z_rotation else ''}"
        return f"goal_pose within {goal.tolerance_m:g} m and {turn}"

    def goals(self, space: JointSpace, rng: np.random.Generator) -> NDArray[np.float64]:
        """Distinct configurations within a space's limits that bring the tool to its goal, (n, d) rad."""
        goal, turn = self._goal, self._pose[:3, :3]
        wanted = {"approach": turn[:, 2]} if goal.free_z_rotation else {"rotation": turn}
        most = _SHARE * goal.tolerance_m, _SHARE * goal.tolerance_rad
        # What cannot be reached exactly may be within the tolerance.
        for place_m, turn_rad in ((min(most[0], _PLACE_M), min(most[1], _TURN_RAD)), most):
            solving = Solving(starts=_STARTS, place_m=place_m, turn_rad=turn_rad)
            found = solve_pose(self._arm, self._pose[:3, 3], rng, **wanted, solving=solving, space=space)
            if len(found):
                break
        return space.to_float32(found).astype(np.float64)

    def angles_rad(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Between the axis and its direction at (N, d) rad, (N,)."""
        along = self._arm.link_frames(configurations)[:, -1, :3, :3] @ self._axis
        across = np.linalg.norm(np.cross(along, self._up), axis=1)
        return np.asarray(np.arctan2(across, along @ self._up))

    def upright(self, checkers: Sequence[Checker], ends: NDArray[np.float64]) -> list[Checker]:
        """Checkers that also keep the axis near its direction, where its angle holds at ends (n, d) rad."""
        # A little less, for states between those that are checked; no less than the ends have.
        between = min(_BETWEEN_RAD, _BETWEEN_SHARE * self.max_rad)
        least = max(self.max_rad - between, float(self.angles_rad(ends).max()) + 1e-6)
        row = np.concatenate([self._axis, self._up, [np.cos(min(least, np.pi))]])
        return [_UprightChecker(one, self._arm, row, _ALIGNED * self.max_rad) for one in checkers]


class _UprightChecker(Checker):
    """A checker of an arm that also keeps an axis near a direction: ``row`` as its scene's arrays have it.

    Its trees follow the constraint: each new node is turned back to it. Source: Berenson, Srinivasa, Ferguson
    and Kuffner, Manipulation Planning on Constraint Manifolds, ICRA 2009.
    """

    def __init__(
        self, checker: Checker, arm: SerialArm, row: NDArray[np.float64], aligned_rad: float
    ) -> None:
        super().__init__(checker.space, checker.scene._replace(upright=row[None]), checker.kernels)
        self._arm, self._row, self._aligned_rad = arm, row, aligned_rad

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
        """See :meth:`cspace.simulator.Checker.grow_trees`; few states of a block are taken at once."""
        test = self.edge_test(resolution_rad)

        def step(side: int, target: NDArray[np.float64]) -> bool | None:
            """Whether a tree has reached a target; None where it could not grow."""
            count = counts[side]
            gaps = self.space.difference(nodes[side, :count], target)
            sizes = np.abs(gaps).sum(axis=1)
            nearest = int(np.argmin(sizes))
            begin, size = nodes[side, nearest], float(sizes[nearest])
            reached = size <= step_rad
            new = target if reached else self._turned(begin + step_rad / size * gaps[nearest])
            left = float(np.abs(self.space.difference(new, target)).sum())
            # What is turned back all the way would go on for ever.
            stays = not reached and left > size - _LEAST_GAIN * step_rad
            if stays or count == nodes.shape[1]:
                return None
            free, looked_at = test(begin, new)
            checks[:] += 1, looked_at
            if not free:
                return None
            nodes[side, count], parents[side, count] = new, nearest
            counts[side] += 1
            return reached

        step_rad = min(range_rad, _STEP_RAD)
        taken = states[:_AT_ONCE]
        for index, state in enumerate(taken):
            other = 1 - side
            if step(side, self._turned(state)) is not None:
                target = nodes[side, counts[side] - 1].copy()
                reached: bool | None = False
                while reached is False:
                    reached = step(other, target)
                if reached:
                    return index + 1, other, int(counts[0]) - 1, int(counts[1]) - 1
            side = other
        return len(taken), side, -1, -1

    def _turned(self, configuration: NDArray[np.float64]) -> NDArray[np.float64]:
        axis, up = self._row[:3], self._row[3:6]
        turned = aligned(self._arm, configuration[None], axis, up, self._aligned_rad, self.space)
        return np.asarray(turned[0])


def _unit(what: str, direction: _Direction) -> NDArray[np.float64]:
    length = float(np.linalg.norm(direction))
    # A square of what is longer, or shorter, may be none.
    if not 1e-6 <= length <= 1e6:
        raise InputError(
            f"{what} is no direction", expected="x, y, z of a length from 1e-6 to 1e6", got=str(direction)
        )
    return np.asarray(direction, dtype=np.float64) / length
