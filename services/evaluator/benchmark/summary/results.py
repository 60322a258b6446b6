"""All that the runs of a benchmark say, family by family."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.setting import Setting
from services.evaluator.benchmark.runs.store import complete
from services.evaluator.benchmark.summary.convergence import Convergence, converge
from services.evaluator.benchmark.summary.paired import PairedRuns
from services.evaluator.benchmark.summary.summaries import ArmSummary, summarise


@dataclass(frozen=True)
class FamilyResult:
    """One family of problems.

    Args:
        family: which.
        runs: of all arms, paired.
        solvable: whether its problems have a path.
        summaries: of the arms that end with their first solution.
        convergence: of the optimising arms; none where there is no path.
    """

    family: str
    runs: PairedRuns
    solvable: bool
    summaries: tuple[ArmSummary, ...]
    convergence: tuple[Convergence, ...]


@dataclass(frozen=True)
class Results:
    """The whole benchmark.

    Args:
        setting: of all runs.
        arms: that were compared.
        families: by family, in the order of the request.
    """

    setting: Setting
    arms: tuple[Arm, ...]
    families: Mapping[str, FamilyResult]

    @classmethod
    def gather(
        cls, runs: Sequence[Run], families: Sequence[str], arms: Sequence[Arm], setting: Setting
    ) -> "Results":
        """Pair and summarise the runs.

        Raises:
            EvaluationError: a family has no problem that all of its arms have run.
        """
        found: dict[str, FamilyResult] = {}
        for family in families:
            paired = PairedRuns(complete(run for run in runs if run.family == family))
            # A generator a family: its intervals do not depend on which others there are.
            rng = np.random.default_rng([setting.seed, setting.families.names.index(family)])
            solvable = family in setting.families.solvable
            found[family] = FamilyResult(
                family,
                paired,
                solvable,
                tuple(summarise(paired, arms, rng)),
                tuple(converge(paired, arms, rng)) if solvable else (),
            )
        return cls(setting, tuple(arms), found)

    def runs(self) -> list[Run]:
        """Every run that counts, family by family and arm by arm."""
        return [run for one in self.families.values() for arm in one.runs.arms for run in one.runs.runs(arm)]
