"""The runs of one family as tables: a row a problem, a column a run, the same ones for every arm."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from services.evaluator.benchmark.runs.run import Run

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class PairedRuns:
    """Runs of one family, every arm on the same problems as often.

    Args:
        runs: of one family, complete.

    Raises:
        EvaluationError: none, of several families, or an arm lacks a run.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        families = sorted({run.family for run in runs})
        if len(families) != 1:
            raise EvaluationError("runs are paired within one family", expected="one", got=str(families))
        self.family = families[0]
        self.problems = tuple(sorted({run.problem for run in runs}))
        self.numbers = tuple(sorted({run.run for run in runs}))
        self._by_arm: dict[str, dict[tuple[int, int], Run]] = {}
        for run in runs:
            self._by_arm.setdefault(run.arm, {})[run.problem, run.run] = run
        pairs = {(problem, number) for problem in self.problems for number in self.numbers}
        for arm, mine in self._by_arm.items():
            if set(mine) != pairs:
                raise EvaluationError(
                    f"the arm {arm} lacks runs", expected=str(len(pairs)), got=str(len(mine))
                )

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(self._by_arm)

    def runs(self, arm: str) -> list[Run]:
        """All runs of an arm, problem by problem.

        Raises:
            EvaluationError: there is no such arm.
        """
        if arm not in self._by_arm:
            raise EvaluationError("there is no such arm", expected=", ".join(self._by_arm), got=arm)
        mine = self._by_arm[arm]
        return [mine[problem, number] for problem in self.problems for number in self.numbers]

    def values(self, arm: str, column: str) -> Floats:
        """(P, R) values of a column; nan where a run has none."""
        found = [getattr(run, column) for run in self.runs(arm)]
        numbers = [np.nan if value is None else float(value) for value in found]
        return np.array(numbers).reshape(len(self.problems), len(self.numbers))

    def solved(self, arm: str) -> Flags:
        """(P, R) whether a run succeeded."""
        return self.values(arm, "solved").astype(bool)
