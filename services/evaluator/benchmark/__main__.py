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
from cspace.worlds import examples, named_world, partly_seen
from services.commands import finite, report_error
from services.evaluator.benchmark.job import REPORT, Request, executor, run_benchmark
from services.evaluator.benchmark.sources import bundled, parse_named, served
from services.evaluator.benchmark.variants import (
    AIMS,
    GROUPS,
    LIMITS,
    PICTURES,
    RUNS,
    SAMPLES,
    SHARES,
    Group,
    Protocol,
    Setting,
    Variant,
    pick,
    table,
)
from services.registry import tracking_uri
from services.registry.tracking import Tracking

WORLDS = examples()
SPLITS = (Split.VALIDATION, Split.TEST)
# Problems of each family where nothing else is asked for.
PROBLEMS, UNSOLVABLE, PAPER_PROBLEMS, PLAN_PROBLEMS = 300, 30, 10, 30
MAX_SEED = 2**63 - 1


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, run, print; returns the exit code."""
    options = parser().parse_args(arguments)
    try:
        tracking = None if options.no_mlflow else _tracking(environment)
        request = make_request(options)
        show = partial(print, flush=True)
        results = run_benchmark(request, executor(environment, options.processes), show, tracking)
    except CspaceError as error:
        return report_error(error, ConfigError)
    print(f"{results.note()}\n{options.out / REPORT}", flush=True)
    return 0


def _tracking(environment: Mapping[str, str]) -> Tracking:
    uri = tracking_uri(environment, remedy="set it, or give --no-mlflow")
    # MLflow takes seconds to import.
    from services.registry.tracking import Tracking  # noqa: PLC0415

    return Tracking(uri)


def parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator planning",
        description="Solve the same problems with the same seeds by planners with uniform samples and with "
        "models, and report from which cost of a collision check on the models pay.",
        epilog="Given again, the command goes on from the runs that --out holds. Reads RAY_ADDRESS and "
        "MLFLOW_TRACKING_URI. Exit codes: 0 done, 1 a run failed, 2 wrong request.",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of runs, report and figures")
    parser.add_argument("--protocol", type=Protocol, choices=list(Protocol), default=Protocol.FAMILIES)
    models = parser.add_argument_group("models, each option any number of times")
    models.add_argument("--api", help="of the models, for example http://127.0.0.1:8000")
    models.add_argument(
        "--model", action="append", default=[], metavar="[NAME=]REFERENCE", help="as path-sampler@champion"
    )
    models.add_argument(
        "--bundle", action="append", default=[], metavar="NAME=FOLDER", help="in the planner's process"
    )
    what = parser.add_argument_group("what is run")
    robots = f"{', '.join(WORLDS)}, or a robot's file (default: %(default)s)"
    what.add_argument("--robot", default=next(iter(WORLDS)), help=robots)
    what.add_argument("--family", action="append", help="default: all")
    what.add_argument("--split", type=Split, choices=SPLITS, default=Split.VALIDATION)
    what.add_argument(
        "--problems", type=_count,
        help="of each family (default: 300, without a path 30; of the paper's protocol 10, of plans 30)",
    )  # fmt: skip
    what.add_argument(
        "--runs", type=_count, help="of each problem (default: 1, of the paper's protocol 100, of plans 3)"
    )
    what.add_argument("--seed", type=int, default=0, help="of problems, planners and samplers")
    what.add_argument(
        "--variants", nargs="+", help=f"names, or groups: {', '.join(Group)} (default: all of the protocol)"
    )
    what.add_argument(
        "--samples", type=_count, default=SAMPLES, help="learned ones for a run (default: %(default)s)"
    )
    what.add_argument(
        "--shares", type=finite, nargs="+", default=SHARES, metavar="SHARE",
        help="of learned samples, above 0 to 1; one variant for each (default: 0.7 1)",
    )  # fmt: skip
    what.add_argument("--iterations", type=_count, help="after which a search ends (default: 20000)")
    what.add_argument(
        "--time-limit", type=finite, metavar="S", help="default: 10, of the paper's protocol 1, of plans 20"
    )
    plans = parser.add_argument_group("protocol plans: paths through scenes that depth pictures show in part")
    plans.add_argument(
        "--pictures", type=int, nargs="+", metavar="N", choices=range(1, 5), default=PICTURES,
        help="by which each is seen (default: 1 2 3)",
    )  # fmt: skip
    plans.add_argument("--aim", choices=AIMS, default=AIMS[0], help="what cameras look at (default: goal)")
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
        "--processes", type=_count, default=os.cpu_count() or 1,
        help="on this machine; one gives the truest times (default: one a core)",
    )  # fmt: skip
    how.add_argument("--no-mlflow", action="store_true", help="log no run")
    return parser


def _count(text: str) -> int:
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{value} is below 1")
    return value


def _variants(options: argparse.Namespace) -> tuple[Variant, ...]:
    names = [parse_named(text)[0] for text in (*options.model, *options.bundle)]
    variants = table(options.protocol, names, options.samples, tuple(dict.fromkeys(options.shares)))
    if len({one.name for one in variants}) < len(variants):
        raise ConfigError(
            "models share a name", expected="NAME=REFERENCE with other names", got=", ".join(names)
        )
    return pick(variants, options.variants or GROUPS[options.protocol])


def make_request(options: argparse.Namespace) -> Request:
    """What the options ask for; models are asked once, bundles loaded."""
    for name, holds, expected in (
        ("seed", 0 <= options.seed <= MAX_SEED, f"0 to {MAX_SEED}"),
        ("samples", options.samples <= MAX_SAMPLES, f"1 to {MAX_SAMPLES}"),
        ("shares", all(0.0 < one <= 1.0 for one in options.shares), "above 0 to 1"),
        ("time-limit", options.time_limit is None or options.time_limit > 0.0, "above 0"),
    ):
        if not holds:
            raise ConfigError(
                f"--{name} is out of range", expected=expected, got=str(vars(options)[name.replace("-", "_")])
            )
    if options.model and not options.api:
        raise ConfigError("models are behind an API", remedy="name it with --api")
    variants, setting = _variants(options), _setting(options)
    plans = setting.protocol is Protocol.PLANS
    folder = None if options.problems_folder is None else options.problems_folder.resolve()
    problems = _plan_problems(options, setting, folder) if plans else _problems(options, setting)
    used, world = {one.sampler for one in variants}, setting.world
    models, bundles = (map(parse_named, given) for given in (options.model, options.bundle))
    specs = [
        *(served(name, model, options.api, world, plans=plans) for name, model in models if name in used),
        *(bundled(name, Path(path), world if plans else None) for name, path in bundles if name in used),
    ]
    pictures = tuple(dict.fromkeys(options.pictures)) if plans else (0,)
    repeats = options.runs or RUNS[setting.protocol]
    return Request(options.out, setting, problems, repeats, variants, tuple(specs), pictures, folder)


def _setting(options: argparse.Namespace) -> Setting:
    limits = LIMITS[options.protocol]
    return Setting(
        options.protocol,
        options.split,
        options.seed,
        options.iterations or int(limits["max_iterations"]),
        options.time_limit or limits["time_limit_s"],
        aim=options.aim,
        world=named_world(options.robot),
        held=options.held,
    )


def _wanted(options: argparse.Namespace, usual: Sequence[str], known: Sequence[str]) -> list[str]:
    wanted = list(dict.fromkeys(options.family or usual))
    if not set(wanted) <= set(known):
        raise ConfigError(
            f"the robot {options.robot} has no such family of problems",
            expected=", ".join(known),
            got=", ".join(wanted),
        )
    return wanted


def _problems(options: argparse.Namespace, setting: Setting) -> dict[str, int]:
    """How many of each family."""
    families = setting.families
    if setting.protocol is Protocol.PAPER:
        usual = dict.fromkeys(families.solvable, PAPER_PROBLEMS)
    else:
        # A problem without a path takes every variant to its limit, about a minute in all.
        usual = dict.fromkeys((families.decisive, *families.solvable), PROBLEMS)
        usual |= dict.fromkeys(families.unsolvable, UNSOLVABLE)
    wanted = _wanted(options, tuple(usual), families.names)
    return {family: options.problems or usual.get(family, PAPER_PROBLEMS) for family in wanted}


def _plan_problems(options: argparse.Namespace, setting: Setting, folder: Path | None) -> dict[str, int]:
    """How many of each family, at most as many as a set of problems has."""
    try:
        seen = partly_seen(setting.world)
    except ScenarioError as error:
        raise ConfigError(
            f"the robot {options.robot} has no problems that are seen in part",
            remedy="name another one with --robot, as panda",
        ) from error
    if not options.model and not options.bundle:
        raise ConfigError("no model plans", remedy="name one with --bundle, or with --api and --model")
    known = [family for families in seen.sources.values() for family in families]
    known = list(seen.grasping) if options.held else known
    problems: dict[str, int] = {}
    for family in _wanted(options, known, known):
        most = seen.count(family, setting.split)
        if most is not None and not problems:
            # Problems that do not ship fail here, before any run.
            seen.problem(ProblemRequest(setting.split, setting.seed, setting.aim, folder), family, 0, 1)
        requested = options.problems or most or PLAN_PROBLEMS
        problems[family] = requested if most is None else min(requested, most)
    return problems


if __name__ == "__main__":
    sys.exit(main())
