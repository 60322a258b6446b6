"""Success with samples that are filtered, put in order or checked, beside the same planner's as they come."""

from collections.abc import Sequence

import numpy as np

from services.evaluator.benchmark.runs.arms import Arm, Group
from services.evaluator.benchmark.summary.paired import Flags, PairedRuns
from services.evaluator.benchmark.summary.summaries import WITHIN
from services.evaluator.benchmark.telling.rows import table_of
from services.evaluator.evaluation.tables import Table
from services.evaluator.statistics import difference_interval


def treated_table(runs: PairedRuns, arms: Sequence[Arm], rng: np.random.Generator) -> Table:
    """What a treatment of the samples does to success, run by run on the same problem under the same seed.

    The interval of the difference is over problems, whose runs stay together.

    Args:
        runs: of one family.
        arms: that were run.
        rng: source of the resampling.
    """
    rows = []
    for arm in arms:
        plain = plain_arm(arm, arms)
        if plain is None:
            continue
        mine, others = (_within(runs, one.name) for one in (arm, plain))
        difference = difference_interval(mine.mean(axis=1), others.mean(axis=1), rng)
        rows.append(
            {
                "arm": arm.name,
                "beside": plain.name,
                f"solved within {WITHIN}": f"{mine.mean():.4f}, {others.mean():.4f}",
                "its runs lost": f"{int((others & ~mine).sum())} of {mine.size}",
                "won": str(int((mine & ~others).sum())),
                "difference": f"{difference:.4f}",
            }
        )
    return table_of(rows)


def plain_arm(arm: Arm, arms: Sequence[Arm]) -> Arm | None:
    """The arm that takes the samples as they come and is else the same; None if there is none."""
    if not _treated(arm):
        return None
    plain = (one for one in arms if one.group is Group.LEARNED and not _treated(one))
    return next((one for one in plain if _planning(one) == _planning(arm)), None)


def _treated(arm: Arm) -> bool:
    return arm.min_confidence > 0.0 or arm.ordered or arm.colliding_last


def _planning(arm: Arm) -> tuple[object, ...]:
    return (arm.planner, arm.sampler, arm.learned_share, arm.samples, arm.epsilon_sigma, arm.stop_at_first)


def _within(runs: PairedRuns, arm: str) -> Flags:
    return runs.solved(arm) & (runs.values(arm, "iterations") <= WITHIN)
