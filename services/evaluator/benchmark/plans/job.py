"""The benchmark of plans: its part of the command line, and the job that runs what is missing."""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError, EvaluationError, ScenarioError
from cspace.worlds import examples, partly_seen
from services.evaluator.benchmark.arms import Protocol
from services.evaluator.benchmark.execution import Executes
from services.evaluator.benchmark.plans.planners import bundled_planner, served_planner
from services.evaluator.benchmark.plans.report import PlanResults, log_plan_run, write_plan_files
from services.evaluator.benchmark.plans.setting import (
    AIMS,
    CHECKED_ITERATIONS,
    CHECKED_LIMIT_S,
    PICTURES,
    PLAN_LIMIT_S,
    PROBLEMS,
    RUNS,
    WAYS,
    PlanRun,
    PlanSetting,
    PlanUnit,
    arms_of,
    plan_units,
)
from services.evaluator.benchmark.sources import SourceSpec, parse_named
from services.evaluator.benchmark.store import RunStore
from services.evaluator.evaluation.units import MAX_SEED
from services.progress import Progress
from services.registry.tracking.port import Tracking

PlanExecute = Executes[PlanUnit, PlanSetting, PlanRun]


@dataclass(frozen=True)
class PlanRequest:
    """What a benchmark of plans is asked for.

    Args:
        out: folder of runs and report.
        setting: the limits.
        problems: how many of each family.
        pictures: by how many each is seen, in turn.
        runs: with exact checks, of each problem.
        specs: the models that plan.
        folder: of problems that do not ship.
    """

    out: Path
    setting: PlanSetting
    problems: Mapping[str, int]
    pictures: tuple[int, ...]
    runs: int
    specs: tuple[SourceSpec, ...]
    folder: Path | None = None

    def covers(self, run: PlanRun) -> bool:
        """Whether a run is among those asked for; the folder may hold others of the same setting."""
        return (
            run.arm in {arm.name for arm in arms_of([spec.name for spec in self.specs])}
            and run.problem < self.problems.get(run.family, 0)
            and run.pictures in (0, *self.pictures)
            and run.run < self.runs
        )


def run_plans(
    request: PlanRequest,
    execute: PlanExecute,
    show: Callable[[str], None],
    tracking: Tracking | None = None,
) -> PlanResults:
    """Run what is missing, then tell of all that was asked for.

    Args:
        request: what is asked for.
        execute: in processes, or over a cluster; the numbers are the same, times apart.
        show: takes lines for people.
        tracking: where a run is logged; None for nowhere.

    Raises:
        ConfigError: the folder holds runs of another setting.
        CspaceError: a run failed; those before it are kept.
    """
    arms = arms_of([spec.name for spec in request.specs])
    store = RunStore.begin(request.out, PlanRun, request.setting, arms, request.specs)
    work = list(
        plan_units(request.problems, request.pictures, request.runs, arms, store.done(), request.folder)
    )
    show(f"{len(arms)} arms; {len(work)} views of problems to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    runs = [run for run in store.runs() if request.covers(run)]
    results = PlanResults.gather(runs, request.pictures, request.setting)
    if not results.plans:
        raise EvaluationError("no problem was run by all arms", expected="one or more", got="none")
    write_plan_files(results, store)
    if tracking is not None:
        show(f"logged as run {log_plan_run(tracking, results, store)}")
    return results


# Of planners with samples, and of plans alone; where they are given for the others they are refused.
OF_SAMPLES = (
    "arms", "planners", "min_confidence", "samples", "shares", "optimising_iterations", "pages", "list_arms",
)  # fmt: skip
OF_PLANS = ("pictures", "aim", "problems_folder")


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the protocol ``plans`` alone takes."""
    group = parser.add_argument_group("protocol plans: ways in scenes that pictures show in part")
    group.add_argument(
        "--pictures", type=int, nargs="+", metavar="N", help=f"by which each is seen (default: {_words()})"
    )
    group.add_argument("--aim", choices=AIMS, help="what cameras look at (default: goal)")
    group.add_argument(
        "--problems-folder",
        type=Path,
        help="of test problems that python -m training.motionbench fetch wrote",
    )


def refuse_others(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Refuse options of another protocol.

    Raises:
        ConfigError: one is given.
    """
    others = OF_SAMPLES if options.protocol is Protocol.PLANS else OF_PLANS
    given = [name for name in others if getattr(options, name) != parser.get_default(name)]
    if given:
        raise ConfigError(
            f"the protocol {options.protocol} has no such options",
            got=", ".join(f"--{name.replace('_', '-')}" for name in given),
        )


def make_plan_request(options: argparse.Namespace) -> PlanRequest:
    """What the options ask for; models are asked once, bundles loaded.

    Raises:
        ConfigError: a value is out of range, or the robot's pictures hide nothing.
        SamplerError: the API refuses a model, or does not answer.
        BundleError: a bundle is damaged, or another robot's.
        DatasetError: the problems that do not ship are not in their folder.
    """
    world = examples()[options.robot]
    try:
        seen = partly_seen(world)
    except ScenarioError as error:
        raise ConfigError(
            f"the robot {options.robot} has no problems that are seen in part",
            remedy="name another one with --robot, as panda",
        ) from error
    pictures = tuple(dict.fromkeys(options.pictures or PICTURES))
    runs = RUNS if options.runs is None else options.runs
    limits = {
        "seed": (options.seed, 0, MAX_SEED),
        "runs": (runs, 1, 1000),
        "processes": (options.processes, 1, 1000),
        **{f"pictures, {count}": (count, 1, 4) for count in pictures},
    }
    if options.problems is not None:
        limits["problems"] = (options.problems, 1, 100_000)
    if options.iterations is not None:
        limits["iterations"] = (options.iterations, 1, 10**9)
    for name, (value, low, high) in limits.items():
        if not low <= value <= high:
            raise ConfigError(f"{name}: out of range", expected=f"{low} to {high}", got=str(value))
    limit_s = CHECKED_LIMIT_S if options.time_limit is None else options.time_limit
    if not limit_s > 0.0:
        raise ConfigError("the time limit is out of range", expected="above 0", got=str(limit_s))
    setting = PlanSetting(
        protocol=options.protocol.value,
        split=options.split,
        seed=options.seed,
        aim=options.aim or AIMS[0],
        plan_limit_s=PLAN_LIMIT_S,
        ways=WAYS,
        checked_limit_s=limit_s,
        max_iterations=options.iterations or CHECKED_ITERATIONS,
        world=world,
    )
    problems = _problems(options, setting)
    folder = None if options.problems_folder is None else options.problems_folder.resolve()
    for family in problems:
        if seen.count(family, setting.split) is not None:
            # The folder, before any run.
            seen.problem(setting.asked(folder), family, 0, pictures[0])
            break
    return PlanRequest(options.out, setting, problems, pictures, runs, _specs(options, setting), folder)


def _problems(options: argparse.Namespace, setting: PlanSetting) -> dict[str, int]:
    known = [family for families in setting.seen.sources.values() for family in families]
    wanted = dict.fromkeys(options.family or known)
    if not set(wanted) <= set(known):
        raise ConfigError(
            f"the robot {options.robot} has no such family of problems",
            expected=", ".join(known),
            got=", ".join(wanted),
        )
    found = {}
    for family in wanted:
        most = setting.seen.count(family, setting.split)
        asked = options.problems or most or PROBLEMS
        found[family] = asked if most is None else min(asked, most)
    return found


def _specs(options: argparse.Namespace, setting: PlanSetting) -> tuple[SourceSpec, ...]:
    if options.model and not options.api:
        raise ConfigError("models are behind an API", remedy="name it with --api")
    models, bundles = ([parse_named(text) for text in given] for given in (options.model, options.bundle))
    names = [name for name, _ in (*models, *bundles)]
    if not names:
        raise ConfigError("no model plans", remedy="name one with --bundle, or with --api and --model")
    if len({arm.name for arm in arms_of(names)}) < len(arms_of(names)):
        raise ConfigError("models share a name", expected="names of their own", got=", ".join(names))
    return (
        *(served_planner(name, model, options.api, setting.world) for name, model in models),
        *(bundled_planner(name, Path(folder), setting.world) for name, folder in bundles),
    )


def _words() -> str:
    return " ".join(map(str, PICTURES))
