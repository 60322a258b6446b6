"""All results of a benchmark, family by family, with the convergence of optimising planners."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from services.evaluator.benchmark.arms import Arm, Setting
from services.evaluator.benchmark.store import Run, complete
from services.evaluator.benchmark.summary import (
    ArmSummary,
    Flags,
    Floats,
    PairedRuns,
    Ratios,
    length_ratio,
    ratios,
    summarise,
)
from services.evaluator.statistics import CensoredSummary, Interval, clopper_pearson, summarise_censored

# A path is as good as the best where it is at most this much longer.
CLOSE = 1.05
MEASURES = ("iterations", "edge_checks", "s")


@dataclass(frozen=True, slots=True)
class Convergence:
    """One optimising arm on one family.

    Args:
        arm: what was run.
        close: share of the runs whose path came close to the best known.
        iterations: until then; runs that did not rank last.
        edge_checks: likewise.
        time_s: likewise, of the search.
        iteration_ratios: to the base, which is RRT* with uniform samples; None for the base.
        first_length: first solution's length over the base's; None for the base.
        final_excess: median of the last length over the best known; infinite where half the runs have none.
    """

    arm: Arm
    close: Interval
    iterations: CensoredSummary
    edge_checks: CensoredSummary
    time_s: CensoredSummary
    iteration_ratios: Ratios | None
    first_length: Interval | None
    final_excess: float


def converge(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> list[Convergence]:
    """All optimising arms, in the order given.

    Args:
        runs: of one family, of all arms.
        arms: that were run.
        rng: source of the resampling.
    """
    best = best_known(runs)
    present = [arm for arm in arms if not arm.stop_at_first and arm.name in runs.arms]
    reached = {arm.name: until_close(runs, arm.name, best) for arm in present}
    return [_arm(runs, arm, best, reached, rng) for arm in present]


def best_known(runs: PairedRuns) -> Floats:
    """(P,) length of the shortest accepted path of any arm, rad; infinite where there is none."""
    lengths = np.concatenate([runs.values(arm, "length_rad") for arm in runs.arms], axis=1)
    return np.asarray(np.min(np.where(np.isnan(lengths), np.inf, lengths), axis=1))


def until_close(runs: PairedRuns, arm: str, best: Floats) -> Mapping[str, Floats]:
    """By measure (P, R) what it took until a path was within 5 % of the best known; infinite where none was.

    Args:
        runs: of one family.
        arm: an optimising one.
        best: (P,) of :func:`best_known`.
    """
    found: dict[str, list[float]] = {measure: [] for measure in MEASURES}
    columns = len(runs.numbers)
    for position, run in enumerate(runs.runs(arm)):
        limit = CLOSE * best[position // columns]
        at = next((step for step, length in enumerate(run.cost_length_rad) if length <= limit), None)
        for measure, values in found.items():
            series: Sequence[float] = getattr(run, f"cost_{measure}")
            values.append(np.inf if at is None else float(series[at]))
    return {measure: np.array(values).reshape(-1, columns) for measure, values in found.items()}


def _arm(
    runs: PairedRuns,
    arm: Arm,
    best: Floats,
    reached: Mapping[str, Mapping[str, Floats]],
    rng: np.random.Generator,
) -> Convergence:
    mine = reached[arm.name]
    missed = np.isinf(mine["iterations"])
    # What a run that came nowhere near had taken when it ended.
    spent = {
        "iterations": runs.values(arm.name, "iterations"),
        "edge_checks": runs.values(arm.name, "edge_checks"),
        "s": runs.values(arm.name, "solve_s"),
    }
    filled = {name: np.where(missed, spent[name], values) for name, values in mine.items()}
    iterations, edge_checks, time_s = (
        summarise_censored(filled[name].ravel(), missed.ravel()) for name in MEASURES
    )
    is_base = arm.name == arm.base or arm.base not in reached
    lengths = runs.values(arm.name, "length_rad") / best[:, None]
    return Convergence(
        arm,
        clopper_pearson(int((~missed).sum()), missed.size),
        iterations,
        edge_checks,
        time_s,
        None if is_base else _ratios(runs, arm, filled["iterations"], missed, reached[arm.base], rng),
        None if is_base else length_ratio(runs, arm.name, arm.base, rng),
        float(np.median(np.where(np.isnan(lengths), np.inf, lengths))),
    )


def _ratios(
    runs: PairedRuns,
    arm: Arm,
    values: Floats,
    missed: Flags,
    base: Mapping[str, Floats],
    rng: np.random.Generator,
) -> Ratios:
    base_missed = np.isinf(base["iterations"])
    base_values = np.where(base_missed, runs.values(arm.base, "iterations"), base["iterations"])
    return ratios(values, missed, base_values, base_missed, rng)


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
