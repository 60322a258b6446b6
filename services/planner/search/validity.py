"""Collision checks as OMPL calls them: the project's numba kernels behind two thin callbacks."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from cspace.worlds.planar.collision import CollisionChecker, arm_is_free, checked_edge
from services.planner.search.state_space import StateAccess


class EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Checks the straight wrapped segment between two states and counts the checks, and the states in them.

    Args:
        information: OMPL's space information.
        checker: of the scenario.
        resolution_rad: largest distance between checked states in any joint.
    """

    def __init__(self, information: Any, checker: CollisionChecker, resolution_rad: float) -> None:
        super().__init__(information)
        space = checker.scenario.robot.space
        self.checks = self.states = 0
        self._access = StateAccess(space)
        self._arguments = (resolution_rad, *checker.kernel_args)
        self._from, self._to = np.zeros(space.dim), np.zeros(space.dim)
        # A process's first call loads the compiled kernel, which is no part of a search.
        checked_edge(self._from, self._to, *self._arguments)

    def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - OMPL's name
        """Whether the motion is free, both ends included."""
        self.checks += 1
        self._access.read(start, self._from)
        self._access.read(end, self._to)
        free, states = checked_edge(self._from, self._to, *self._arguments)
        self.states += states
        return bool(free)


class StateValidator:
    """Checks one state and counts the checks.

    Args:
        checker: of the scenario.
    """

    def __init__(self, checker: CollisionChecker) -> None:
        space = checker.scenario.robot.space
        self.checks = 0
        self._access = StateAccess(space)
        self._arguments = checker.kernel_args
        self._buffer = np.zeros(space.dim)
        arm_is_free(self._buffer, *self._arguments)

    def __call__(self, state: Any) -> bool:
        """Whether the state is free."""
        self.checks += 1
        self._access.read(state, self._buffer)
        return bool(arm_is_free(self._buffer, *self._arguments))


def free_test(checker: CollisionChecker) -> Callable[[Sequence[float]], bool]:
    """A check of configurations of d values in rad, as plain numbers instead of OMPL's states."""
    buffer, arguments = np.zeros(checker.scenario.robot.dim), checker.kernel_args
    # A process's first call loads the compiled kernel, which is no part of a search.
    arm_is_free(buffer, *arguments)

    def is_free(configuration: Sequence[float]) -> bool:
        buffer[:] = configuration
        return bool(arm_is_free(buffer, *arguments))

    return is_free
