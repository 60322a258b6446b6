"""The searches with exact checks in the format of OMPL's benchmark logs; a set is an experiment."""

from collections.abc import Sequence

from services.evaluator.benchmark.plans.checked import Checked
from services.evaluator.benchmark.plans.record import PlanRun
from services.evaluator.benchmark.plans.setting import PlanSetting
from services.evaluator.benchmark.telling.ompl_log import Property, log_header, planner_lines, status_of

PROPERTIES = (
    Property("time", "REAL", lambda run: run.solve_s),
    Property("solved", "BOOLEAN", lambda run: run.solved),
    Property("status", "ENUM", lambda run: status_of(run.status)),
    Property("solution length", "REAL", lambda run: run.length_rad),
    Property("iterations", "INTEGER", lambda run: run.iterations),
    Property("edge checks", "INTEGER", lambda run: run.edge_checks),
    Property("state checks", "INTEGER", lambda run: run.state_checks),
    Property("request time", "REAL", lambda run: run.request_s),
    Property("total time", "REAL", lambda run: run.request_s + run.solve_s),
    Property("free as it was", "BOOLEAN", lambda run: run.as_is),
    Property("problem", "INTEGER", lambda run: run.problem),
    Property("run", "INTEGER", lambda run: run.run),
)


def arena_log(found: Checked, setting: PlanSetting, version: str) -> str:
    """A family as a log.

    Args:
        found: the family, as so many pictures show it.
        setting: of the runs.
        version: of OMPL.
    """
    runs = {arm: [run for own in problems for run in own] for arm, problems in found.arms.items()}
    experiment = f"{setting.protocol}_{setting.split.value}_{found.name}_{found.pictures}"
    setup = [
        f"{found.pictures} pictures that look at the {setting.aim}; ways within {setting.plan_limit_s:g} s.",
        f"At most {setting.max_iterations} iterations of a search with exact checks.",
    ]
    spent_s = sum(run.request_s + (run.solve_s or 0.0) for own in runs.values() for run in own)
    each = found.count * found.runs_each
    lines = [
        *log_header(experiment, version, setup, setting.seed, setting.checked_limit_s, each, spent_s),
        f"{len(runs)} planners",
    ]
    for arm, own in runs.items():
        lines += [*planner_lines(arm, _common(own), PROPERTIES, own), "."]
    return "\n".join(lines) + "\n"


def _common(runs: Sequence[PlanRun]) -> dict[str, object]:
    return {"sampler": runs[0].sampler or "none", "pictures": runs[0].pictures}
