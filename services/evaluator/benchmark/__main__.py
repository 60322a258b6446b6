"""The planning benchmark: ``python -m services.evaluator planning --out FOLDER --bundle NAME=FOLDER``."""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from cspace.errors import ConfigError, CspaceError, ScenarioError
from cspace.query import MAX_SAMPLES
from cspace.simulator import ProblemRequest, Split
from cspace.worlds import examples, named_world, partly_seen, simulator_of
from services.command_errors import finite, report_error
from services.evaluator.benchmark.arms import (
    AIMS,
    LEARNED_SHARES,
    LIMITS,
    MIN_CONFIDENCE,
    PICTURES,
    PLAN_LIMIT_S,
    RUNS,
    SAMPLES,
    Arm,
    Group,
    Protocol,
    Setting,
    Taken,
    pick,
    plan_arms,
    table,
)
from services.evaluator.benchmark.execution import executor
from services.evaluator.benchmark.job import REPORT, Request, run_benchmark
from services.evaluator.benchmark.sources import (
    SourceSpec,
    bundled,
    bundled_planner,
    parse_named,
    served,
    served_planner,
)
from services.evaluator.evaluation.units import MAX_SEED
from services.planner.settings import PLANNERS
from services.registry.tracking import Tracking

GROUPS = (Group.UNIFORM, Group.LEARNED, Group.OPTIMISING)
WORLDS = examples()
SPLITS = (Split.VALIDATION, Split.TEST)
# Problems of each family where nothing else is asked for.
PLAN_PROBLEMS, PAPER_PROBLEMS, PROBLEMS, UNSOLVABLE = 30, 10, 300, 30
# Options of one kind of protocol; the others refuse them.
OF_SAMPLES = (
    "arms", "planners", "min_confidence", "samples", "shares", "optimising_iterations", "pages", "list_arms",
)  # fmt: skip
OF_PLANS = ("pictures", "aim", "held", "problems_folder")


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, run, print; returns the exit code."""
    known = parser()
    options = known.parse_args(arguments)
    try:
        refuse_others(options, known)
        if options.list_arms:
            print("\n".join(f"{arm.group:11} {arm.name}" for arm in chosen_arms(options)))
            return 0
        tracking = None if options.no_mlflow else _tracking(environment)
        request = make_request(options)
        show = partial(print, flush=True)
        results = run_benchmark(request, executor(environment, options.processes), show, tracking)
    except CspaceError as error:
        return report_error(error, ConfigError)
    print(f"{results.terminal()}\n{options.out / REPORT}", flush=True)
    return 0


def _tracking(environment: Mapping[str, str]) -> Tracking:
    uri = environment.get("MLFLOW_TRACKING_URI", "")
    if not uri:
        raise ConfigError(
            "no tracking server is named", remedy="set MLFLOW_TRACKING_URI, or give --no-mlflow"
        )
    # MLflow takes seconds to import.
    from services.registry.tracking import Tracking  # noqa: PLC0415

    return Tracking(uri)


def parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator planning",
        description="Solve the same problems with the same seeds by uniform planners and by planners with "
        "learned samples, and report from which cost of a collision check on the learned ones pay.",
        epilog="Given again, the command goes on from the runs that --out holds. Reads RAY_ADDRESS and "
        "MLFLOW_TRACKING_URI. Exit codes: 0 done, 1 a run failed, 2 wrong request.",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of runs, report and figures")
    parser.add_argument("--protocol", type=Protocol, choices=list(Protocol), default=Protocol.FAMILIES)
    learned = parser.add_argument_group("models, each option any number of times")
    learned.add_argument("--api", help="of the models, for example http://127.0.0.1:8000")
    learned.add_argument(
        "--model", action="append", default=[], metavar="[NAME=]REFERENCE", help="as path-sampler@champion"
    )
    learned.add_argument(
        "--bundle", action="append", default=[], metavar="NAME=FOLDER", help="in the planner's process"
    )
    what = parser.add_argument_group("what is run")
    what.add_argument(
        "--robot",
        default=next(iter(WORLDS)),
        help=f"{', '.join(WORLDS)}, or a robot's file (default: %(default)s)",
    )
    what.add_argument("--family", choices=_families(), action="append", help="default: all")
    what.add_argument("--split", type=Split, choices=SPLITS, default=Split.VALIDATION)
    what.add_argument(
        "--problems", type=int,
        help="of each family (default: 300, disconnected 30; of the paper's protocol 10, of plans 30)",
    )  # fmt: skip
    what.add_argument(
        "--runs", type=int, help="of each problem (default: 1, of the paper's protocol 100, of plans 3)"
    )
    what.add_argument("--seed", type=int, default=0, help="of problems, planners and samplers")
    what.add_argument(
        "--arms", nargs="+", default=[group.value for group in GROUPS],
        help=f"names of arms, or groups: {', '.join(Group)} (default: %(default)s)",
    )  # fmt: skip
    what.add_argument("--planners", nargs="+", default=[], metavar="PLANNER", help=", ".join(PLANNERS))
    what.add_argument(
        "--min-confidence", type=finite, default=MIN_CONFIDENCE,
        help="of the filtered and the ordered arms; 0: none is dropped",
    )  # fmt: skip
    what.add_argument(
        "--samples", type=int, default=SAMPLES,
        help="learned ones for a run, but in arms that name a number (default: %(default)s)",
    )  # fmt: skip
    what.add_argument(
        "--shares", type=finite, nargs="+", default=LEARNED_SHARES, metavar="SHARE",
        help="of learned samples, above 0 to 1; one arm for each (default: 0.7 1)",
    )  # fmt: skip
    what.add_argument("--iterations", type=int, help="after which a search ends (default: 20000)")
    what.add_argument(
        "--optimising-iterations", type=int, help="the same, of optimising arms (default: 2000)"
    )
    what.add_argument(
        "--time-limit", type=finite, metavar="S", help="default: 10, of the paper's protocol 1, of plans 20"
    )
    plans = parser.add_argument_group("protocol plans: paths through scenes that pictures show in part")
    plans.add_argument(
        "--pictures", type=int, nargs="+", metavar="N", help="by which each is seen (default: 1 2 3)"
    )
    plans.add_argument("--aim", choices=AIMS, help="what cameras look at (default: goal)")
    plans.add_argument(
        "--held", action="store_true",
        help="of problems with a table alone: the robot holds what its goal grasps; planners know both",
    )  # fmt: skip
    plans.add_argument(
        "--problems-folder", type=Path,
        help="of test problems that python -m training.motionbench fetch wrote",
    )  # fmt: skip
    how = parser.add_argument_group("how")
    how.add_argument(
        "--processes", type=int, default=os.cpu_count() or 1,
        help="on this machine; one gives the truest times (default: one a core)",
    )  # fmt: skip
    how.add_argument("--pages", type=int, default=3, help="problems of each family that get a page")
    how.add_argument("--no-mlflow", action="store_true", help="log no run")
    how.add_argument("--list-arms", action="store_true", help="print the arms and end")
    return parser


def _families() -> list[str]:
    found: list[str] = []
    for world in WORLDS.values():
        found += simulator_of(world).families.names
        try:
            found += [name for names in partly_seen(world).sources.values() for name in names]
        except ScenarioError:
            continue
    return list(dict.fromkeys(found))


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


def chosen_arms(options: argparse.Namespace) -> tuple[Arm, ...]:
    """The arms that the options name.

    Raises:
        ConfigError: a name is unknown, or two samplers share one.
    """
    _require(0.0 <= options.min_confidence <= 1.0, "min-confidence", "0 to 1", options.min_confidence)
    _require(1 <= options.samples <= MAX_SAMPLES, "samples", f"1 to {MAX_SAMPLES}", options.samples)
    _require(all(0.0 < one <= 1.0 for one in options.shares), "shares", "above 0 to 1", options.shares)
    taken = Taken(options.min_confidence, options.samples, tuple(dict.fromkeys(options.shares)))
    range_rad = simulator_of(named_world(options.robot)).measures.range_rad
    return pick(table(_names(options), range_rad, taken), options.arms, options.planners)


def _names(options: argparse.Namespace) -> list[str]:
    """Names of the models, no two alike."""
    names = [parse_named(text)[0] for text in (*options.model, *options.bundle)]
    if len(set(names)) < len(names):
        raise ConfigError("models share a name", expected="NAME=REFERENCE with other names", got=str(names))
    return names


def _require(holds: bool, name: str, expected: str, got: object) -> None:
    if not holds:
        raise ConfigError(f"--{name} is out of range", expected=expected, got=str(got))


def make_request(options: argparse.Namespace) -> Request:
    """What the options ask for; models are asked once, bundles loaded.

    Raises:
        ConfigError: a value is out of range, or the robot's pictures hide nothing.
        SamplerError: the API refuses a model, or does not answer.
        BundleError: a bundle is damaged, or another robot's.
        DatasetError: the problems that do not ship are not in their folder.
    """
    setting = _setting(options)
    for name, least in (("problems", 1), ("runs", 1), ("processes", 1), ("pages", 0)):
        value = getattr(options, name)
        _require(value is None or value >= least, name, f"{least} or more", value)
    if options.model and not options.api:
        raise ConfigError("models are behind an API", remedy="name it with --api")
    repeats = RUNS[setting.protocol] if options.runs is None else options.runs
    if setting.protocol is Protocol.PLANS:
        return _plan_request(options, setting, repeats)
    arms, families, world = chosen_arms(options), setting.families, setting.world
    if setting.protocol is Protocol.PAPER:
        usual = dict.fromkeys(families.solvable, PAPER_PROBLEMS)
    else:
        # A problem without a path takes every arm to its limit, about a minute in all.
        usual = dict.fromkeys((families.decisive, *families.solvable), PROBLEMS)
        usual |= dict.fromkeys(families.unsolvable, UNSOLVABLE)
    wanted = _wanted(options, tuple(usual), families.names)
    problems = {family: options.problems or usual.get(family, PAPER_PROBLEMS) for family in wanted}
    used = {arm.sampler for arm in arms}
    models = [(name, text) for name, text in map(parse_named, options.model) if name in used]
    bundles = [(name, text) for name, text in map(parse_named, options.bundle) if name in used]
    specs = [
        *(served(name, model, options.api, world) for name, model in models),
        *(bundled(name, Path(folder)) for name, folder in bundles),
    ]
    return Request(options.out, setting, problems, repeats, arms, tuple(specs), options.pages)


def _wanted(options: argparse.Namespace, usual: Sequence[str], known: Sequence[str]) -> list[str]:
    wanted = list(dict.fromkeys(options.family or usual))
    if not set(wanted) <= set(known):
        raise ConfigError(
            f"the robot {options.robot} has no such family of problems",
            expected=", ".join(known),
            got=", ".join(wanted),
        )
    return wanted


def _setting(options: argparse.Namespace) -> Setting:
    _require(0 <= options.seed <= MAX_SEED, "seed", f"0 to {MAX_SEED}", options.seed)
    limits, given = dict(LIMITS[options.protocol]), {
        "max_iterations": ("iterations", options.iterations),
        "optimising_iterations": ("optimising-iterations", options.optimising_iterations),
        "time_limit_s": ("time-limit", options.time_limit),
    }  # fmt: skip
    for name, (option, value) in given.items():
        if value is not None:
            _require(value > 0, option, "above 0", value)
            limits[name] = value
    return Setting(
        options.protocol,
        options.split,
        options.seed,
        int(limits["max_iterations"]),
        int(limits["optimising_iterations"]),
        float(limits["time_limit_s"]),
        options.aim or AIMS[0],
        PLAN_LIMIT_S,
        named_world(options.robot),
        options.held,
    )


def _plan_request(options: argparse.Namespace, setting: Setting, repeats: int) -> Request:
    world = setting.world
    try:
        seen = partly_seen(world)
    except ScenarioError as error:
        raise ConfigError(
            f"the robot {options.robot} has no problems that are seen in part",
            remedy="name another one with --robot, as panda",
        ) from error
    pictures = tuple(dict.fromkeys(options.pictures or PICTURES))
    _require(all(1 <= count <= 4 for count in pictures), "pictures", "1 to 4", pictures)
    known = [family for families in seen.sources.values() for family in families]
    if options.held:
        known = list(seen.grasping)
        _require(bool(known), "held", "a robot with problems of a table, as panda", options.robot)
    problems = {}
    for family in _wanted(options, known, known):
        most = seen.count(family, setting.split)
        requested = options.problems or most or PLAN_PROBLEMS
        problems[family] = requested if most is None else min(requested, most)
    names = _names(options)
    arms = plan_arms(names)
    if not names:
        raise ConfigError("no model plans", remedy="name one with --bundle, or with --api and --model")
    if len({arm.name for arm in arms}) < len(arms):
        raise ConfigError("models share a name with an arm", got=", ".join(names))
    folder = None if options.problems_folder is None else options.problems_folder.resolve()
    for family in problems:
        if seen.count(family, setting.split) is not None:
            # Problems that do not ship fail here, before any run.
            seen.problem(
                ProblemRequest(setting.split, setting.seed, setting.aim, folder), family, 0, pictures[0]
            )
            break
    models, bundles = (map(parse_named, given) for given in (options.model, options.bundle))
    specs: list[SourceSpec] = [
        *(served_planner(name, model, options.api, world) for name, model in models),
        *(bundled_planner(name, Path(path), world) for name, path in bundles),
    ]
    return Request(options.out, setting, problems, repeats, arms, tuple(specs), 0, pictures, folder)


if __name__ == "__main__":
    sys.exit(main())
