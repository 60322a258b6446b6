"""The runs in the format of OMPL's benchmark logs, for its statistics and for Planner Arena.

The grammar is that of OMPL's page "How to Benchmark Planners"; OMPL's own ``ompl_benchmark_statistics`` turns
such a log into the database that Planner Arena opens. A family is an experiment, an arm is a planner.
"""

import platform
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from services.evaluator.benchmark.runs.arms import Arm
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.summary.results import FamilyResult, Results
from services.planner.plan_result import Reason

LIBRARY = "OMPL"
# OMPL's PlannerStatus; a run's status is a place in this list.
STATUS = (
    "Unknown status",
    "Invalid start",
    "Invalid goal",
    "Unrecognized goal type",
    "Timeout",
    "Approximate solution",
    "Exact solution",
    "Crash",
    "Abort",
    "Infeasible",
)
_STATUS_OF = {
    Reason.SOLVED: "Exact solution",
    Reason.START_COLLIDES: "Invalid start",
    Reason.GOAL_COLLIDES: "Invalid goal",
    Reason.ITERATION_LIMIT: "Timeout",
    Reason.TIME_LIMIT: "Timeout",
    Reason.NO_PATH: "Timeout",
}
_LAST_WORDS = {"*": "star", "%": " "}


@dataclass(frozen=True, slots=True)
class Property:
    """A column of a log: its name with its type in SQL, and what a run has in it."""

    name: str
    kind: str
    of: Callable[[Any], float | int | bool | None]


def status_of(reason: str) -> int:
    """The place in ``STATUS`` of why a run ended; a path that the check rejects solves nothing."""
    return STATUS.index(_STATUS_OF.get(Reason(reason), "Unknown status"))


PROPERTIES = (
    Property("time", "REAL", lambda run: run.solve_s),
    Property("solved", "BOOLEAN", lambda run: run.solved),
    Property("status", "ENUM", lambda run: status_of(run.reason)),
    Property("solution length", "REAL", lambda run: run.length_rad),
    Property("iterations", "INTEGER", lambda run: run.iterations),
    Property("edge checks", "INTEGER", lambda run: run.edge_checks),
    Property("state checks", "INTEGER", lambda run: run.state_checks),
    Property("check time", "REAL", lambda run: run.check_s),
    Property("request time", "REAL", lambda run: run.request_s),
    Property("server time", "REAL", lambda run: run.server_s),
    Property("transport time", "REAL", lambda run: run.transport_s),
    Property("total time", "REAL", lambda run: run.total_s),
    Property("first solution time", "REAL", lambda run: run.first_s),
    Property("first solution iterations", "INTEGER", lambda run: run.first_iterations),
    Property("first solution length", "REAL", lambda run: run.first_length_rad),
    Property("learned states", "INTEGER", lambda run: run.learned_drawn),
    Property("uniform states", "INTEGER", lambda run: run.uniform_drawn),
    Property("problem", "INTEGER", lambda run: run.problem),
    Property("run", "INTEGER", lambda run: run.run),
)
PROGRESS = ("time REAL", "iterations INTEGER", "collision checks INTEGER", "best cost REAL")


def ompl_log(found: FamilyResult, results: Results, version: str) -> str:
    """One family as a log.

    Args:
        found: the family.
        results: that it is of.
        version: of OMPL.
    """
    arms = [arm for arm in results.arms if arm.name in found.runs.arms]
    lines = [*_header(found, results, version), f"{len(arms)} planners"]
    for arm in arms:
        lines += _planner(arm, found.runs.runs(arm.name))
    return "\n".join(lines) + "\n"


def planner_name(arm: str) -> str:
    """An arm's name without blanks, as OMPL writes names of planners."""
    for sign, word in _LAST_WORDS.items():
        arm = arm.replace(sign, word)
    return "geometric_" + re.sub(r"[^A-Za-z0-9.-]+", "_", arm).strip("_")


def _header(found: FamilyResult, results: Results, version: str) -> Iterator[str]:
    setting, runs = results.setting, [run for arm in found.runs.arms for run in found.runs.runs(arm)]
    experiment = f"{setting.protocol.value}_{setting.split.value}_{found.family}"
    each, spent_s = len(found.runs.problems) * len(found.runs.numbers), sum(run.total_s for run in runs)
    limit_s = setting.time_limit_s
    return log_header(experiment, version, list(_setup(results)), setting.seed, limit_s, each, spent_s)


def log_header(
    experiment: str, version: str, setup: Sequence[str], seed: int, limit_s: float, each: int, spent_s: float
) -> Iterator[str]:
    """The lines before the planners.

    Args:
        experiment: its name, without blanks.
        version: of OMPL.
        setup: lines about it.
        seed: of all draws.
        limit_s: of a run.
        each: runs of each planner.
        spent_s: by all of them.
    """
    yield f"{LIBRARY} version {version}"
    yield f"Experiment {experiment}"
    yield f"Running on {platform.node() or 'unknown'}"
    yield f"Starting at {datetime.now(UTC):%Y-%m-%d %H:%M:%S}"
    yield from ("<<<|", *setup, "|>>>")
    yield from ("<<<|", platform.processor() or platform.machine() or "unknown", "|>>>")
    yield f"{seed} is the random seed"
    yield f"{limit_s:g} seconds per run"
    # No run is limited in memory.
    yield "0 MB per run"
    yield f"{each} runs per planner"
    yield f"{spent_s:.6f} seconds spent to collect the data"
    yield "1 enum type"
    yield "|".join(("status", *STATUS))


def _setup(results: Results) -> Iterator[str]:
    setting = results.setting
    space = setting.world.space
    joints = f"{setting.world.kind} world, {space.dim} joints, {space.to_dict()['kind']}"
    yield f"{joints}; one run for each problem and arm, with paired seeds."
    yield f"Resolution {setting.resolution_rad} rad a joint, goal bias {setting.goal_bias}."
    yield f"At most {setting.max_iterations} iterations, {setting.optimising_iterations} of optimising arms."


def _planner(arm: Arm, runs: Sequence[Run]) -> Iterator[str]:
    common = {
        "planner": arm.planner,
        "range": arm.range_rad,
        "sampler": arm.sampler or "uniform",
        "learned_share": arm.learned_share,
        "samples": arm.samples,
        "min_confidence": arm.min_confidence,
        "epsilon_sigma": ",".join(f"{value:g}" for value in arm.epsilon_sigma),
    }
    yield from planner_lines(arm.name, common, PROPERTIES, runs)
    if not arm.stop_at_first:
        yield f"{len(PROGRESS)} progress properties for each run"
        yield from PROGRESS
        yield f"{len(runs)} runs"
        yield from (_series(run) for run in runs)
    yield "."


def planner_lines(
    arm: str, common: Mapping[str, object], properties: Sequence[Property], runs: Sequence[Any]
) -> Iterator[str]:
    """An arm with what its runs share and what each has, without the closing line."""
    yield planner_name(arm)
    yield f"{len(common)} common properties"
    yield from (f"{name} = {value}" for name, value in common.items())
    yield f"{len(properties)} properties for each run"
    yield from (f"{one.name} {one.kind}" for one in properties)
    yield f"{len(runs)} runs"
    yield from ("".join(f"{_data(one.of(run))}; " for one in properties) for run in runs)


def _series(run: Run) -> str:
    steps = zip(run.cost_s, run.cost_iterations, run.cost_edge_checks, run.cost_length_rad, strict=True)
    return "".join("".join(f"{_data(value)}," for value in step) + ";" for step in steps)


def _data(value: float | bool | None) -> str:
    if value is None:
        return ""
    return str(int(value)) if isinstance(value, int) else f"{value:.9g}"
