"""Collision checks as OMPL calls them: the project's numba kernels behind two thin callbacks."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from cspace.simulator import Checker
from cspace_client.ompl.state_space import StateAccess


class EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Checks the straight wrapped segment between two states and counts the checks, and the states in them.

    Args:
        information: OMPL's space information.
        checker: of the scenario.
        resolution_rad: largest distance between checked states in any joint.
    """

    def __init__(self, information: Any, checker: Checker, resolution_rad: float) -> None:
        super().__init__(information)
        space = checker.space
        self.checks = self.states = 0
        self._access = StateAccess(space)
        self._from, self._to = np.zeros(space.dim), np.zeros(space.dim)
        self._test = checker.edge_test(resolution_rad)

    def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - OMPL's name
        """Whether the motion is free, both ends included."""
        self.checks += 1
        self._access.read(start, self._from)
        self._access.read(end, self._to)
        free, states = self._test(self._from, self._to)
        self.states += states
        return bool(free)


class StateValidator:
    """Checks one state and counts the checks.

    Args:
        checker: of the scenario.
    """

    def __init__(self, checker: Checker) -> None:
        self.checks = 0
        self._access = StateAccess(checker.space)
        self._buffer = np.zeros(checker.space.dim)
        self._test = checker.state_test()

    def __call__(self, state: Any) -> bool:
        """Whether the state is free."""
        self.checks += 1
        self._access.read(state, self._buffer)
        return self._test(self._buffer)


def free_test(checker: Checker) -> Callable[[Sequence[float]], bool]:
    """A check of configurations of d values in rad, as plain numbers instead of OMPL's states."""
    buffer, test = np.zeros(checker.space.dim), checker.state_test()

    def is_free(configuration: Sequence[float]) -> bool:
        buffer[:] = configuration
        return test(buffer)

    return is_free
