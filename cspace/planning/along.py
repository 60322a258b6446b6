"""Configurations along ways, in their order: first on the ways, then with growing noise about them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.connecting import spaced
from cspace.space import JointSpace

# Standard deviations of the noise, each joint, from turn to turn; and how far apart draws are along a way.
NOISE_RAD = (0.0, 0.05, 0.1, 0.2)
STEP_RAD = 0.3


class AlongWays:
    """A stream of configurations about ways.

    A turn goes along one way after the other, each from its start to its goal; each next turn adds more
    noise, and all that follow the last of :data:`NOISE_RAD` as much as it does.

    Args:
        ways: (k, d) rad each, at least one.
        space: the robot's joint space; no configuration leaves it.
        rng: of the noise.
    """

    def __init__(
        self, ways: Sequence[NDArray[np.float64]], space: JointSpace, rng: np.random.Generator
    ) -> None:
        lines = [spaced(way, space, STEP_RAD) for way in ways]
        self._line, self._space, self._rng = np.concatenate(lines), space, rng
        self._number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
        self._turn, self._at = 0, 0
        self._rows = self._line

    def take(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The next configurations (count, d) rad, and the number of each one's way (count,)."""
        parts: list[slice] = []
        rows = [self._rows[:0]]
        while count > 0:
            part = slice(self._at, min(self._at + count, len(self._line)))
            rows.append(self._rows[part])
            parts.append(part)
            count, self._at = count - (part.stop - part.start), part.stop
            if self._at == len(self._line):
                self._next_turn()
        numbers = [self._number[part] for part in parts]
        return np.concatenate(rows), np.concatenate([self._number[:0], *numbers])

    @property
    def turn_rows(self) -> int:
        """Configurations of one turn."""
        return len(self._line)

    def _next_turn(self) -> None:
        self._turn, self._at = self._turn + 1, 0
        sigma = NOISE_RAD[min(self._turn, len(NOISE_RAD) - 1)]
        self._rows = self._space.bound(self._line + sigma * self._rng.normal(size=self._line.shape))
