"""Planning problems of worlds that no picture shows whole, and what planners take the rest to be.

As a workshop they are opened when they are first asked for (:func:`cspace.worlds.partly_seen`), by no server.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.problem import Problem
from cspace.splits import Split
from cspace.workshop import Checker
from cspace.world import Image


class Taken(StrEnum):
    """What a planner takes the space to be that no picture shows; what is seen stays as it is seen."""

    FREE = "unseen is free"
    OCCUPIED = "unseen is occupied"
    CLEARED = "unseen is occupied, goal cleared"
    TRUE = "truth where unseen"
    KNOWN = "truth everywhere"


@dataclass(frozen=True, slots=True)
class Asked:
    """Which problems are asked for, and how they are seen.

    Args:
        split: of the problems.
        seed: of those that are drawn.
        aim: what cameras look at: ``goal``, or ``scene`` for the middle of all obstacles.
        folder: of problems that do not ship; None where none are needed.
    """

    split: Split
    seed: int = 0
    aim: str = "goal"
    folder: Path | None = None


class Judge(Protocol):
    """Verdicts beside those of a checker."""

    def valid_batch(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free, (N,)."""


class PartlySeen(Protocol):
    """See this module."""

    @property
    def sources(self) -> dict[str, tuple[str, ...]]:
        """Families of problems by where they come from."""

    @property
    def hard(self) -> tuple[str, ...]:
        """The families that planners find hard although all is known; none where nobody looked."""

    def count(self, family: str, split: Split) -> int | None:
        """How many problems a family has; None where they are drawn without end."""

    def problem(self, asked: Asked, family: str, index: int, pictures: int) -> Problem | None:
        """A problem, seen in so many pictures; None where an end collides or nothing in reach is seen.

        Raises:
            DatasetError: problems that do not ship are not in the folder.
            ScenarioError: there is no such family, or none of its problems was found.
        """

    def checkers(self, problem: Problem, image: Image, taken: Taken) -> Sequence[Checker]:
        """Checks by what a picture shows and what the rest is taken to be, the most careful first."""

    def unseen(self, image: Image, configurations: ArrayLike) -> NDArray[np.float64]:
        """Share of the robot that a picture does not show to be free, at (N, d) rad, (N,)."""

    def judge(self, problem: Problem) -> Judge | None:
        """Verdicts by the robot's meshes; None where they or what judges by them are not installed."""
