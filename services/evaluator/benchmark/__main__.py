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
from services.commands import ANY_SEED, COUNT, number, report_error
from services.evaluator.benchmark.job import REPORT, Request, executor, packed_bundle, run_benchmark
from services.evaluator.benchmark.variants import (
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
from services.registry import connect, tracking_uri

WORLDS = examples()
ABOVE_0 = number("above 0, at most 1", sys.float_info.min, 1.0)
SPLITS = (Split.VALIDATION, Split.TEST)
# Problems of each family where nothing else is asked for.
PROBLEMS, UNSOLVABLE, PAPER_PROBLEMS, PLAN_PROBLEMS = 300, 30, 10, 30


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, run, print; returns the exit code."""
    options = parser().parse_args(arguments)
    try:
        tracking = None
        if not options.no_mlflow:
            tracking, _ = connect(tracking_uri(environment, remedy="set it, or give --no-mlflow"))
        request = make_request(options)
        show = partial(print, flush=True)
        results = run_benchmark(request, executor(environment, options.processes), show, tracking)
    except CspaceError as error:
        return report_error(error, ConfigError)
    print(f"{results.note()}\n{options.out / REPORT}", flush=True)
    return 0


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
    parser.add_argument(
        "--bundle",
        action="append",
        default=[],
        type=_named,
        metavar="NAME=FOLDER",
        help="a model, repeatable",
    )
    what = parser.add_argument_group("what is run").add_argument
    robots = f"{', '.join(WORLDS)}, or a robot's file (default: %(default)s)"
    what("--robot", default=next(iter(WORLDS)), help=robots)
    what("--family", action="append", help="default: all")
    what("--split", type=Split, choices=SPLITS, default=Split.VALIDATION)
    each = "of each family (default: 300, without a path 30; of the paper's protocol 10, of plans 30)"
    what("--problems", type=COUNT, help=each)
    what("--runs", type=COUNT, help="of each problem (default: 1, of the paper's protocol 100)")
    what("--seed", type=ANY_SEED, default=0, help="of problems, planners and samplers")
    groups = f"names, or groups: {', '.join(Group)} (default: all of the protocol)"
    what("--variants", nargs="+", help=groups)
    drawn, count = (
        "learned ones for a run (default: %(default)s)",
        number(f"1 to {MAX_SAMPLES}", 1, MAX_SAMPLES, int),
    )
    what("--samples", type=count, default=SAMPLES, help=drawn)
    shares = "of learned samples, above 0 to 1; one variant for each (default: 0.7 1)"
    what("--shares", type=ABOVE_0, nargs="+", default=SHARES, metavar="SHARE", help=shares)
    _add_plan_options(parser.add_argument_group("protocol plans: scenes that depth pictures show in part"))
    how = parser.add_argument_group("how").add_argument
    times = "on this machine; one gives the truest times (default: one a core)"
    how("--processes", type=COUNT, default=os.cpu_count() or 1, help=times)
    how("--no-mlflow", action="store_true", help="log no run")
    return parser


def _add_plan_options(plans: argparse._ArgumentGroup) -> None:
    seen, four = "by which each is seen, at most 4 (default: 1 2 3)", number("1 to 4", 1, 4, int)
    plans.add_argument("--pictures", type=four, nargs="+", metavar="N", default=PICTURES, help=seen)
    fetched = "of test problems that python -m training.motionbench fetch wrote"
    plans.add_argument("--problems-folder", type=Path, help=fetched)


def _named(text: str) -> tuple[str, Path]:
    name, _, folder = text.partition("=")
    if not name or not folder or "," in name:
        raise argparse.ArgumentTypeError(f"expected NAME=FOLDER without a comma in the name, got {text!r}")
    return name, Path(folder)


def _variants(options: argparse.Namespace) -> tuple[Variant, ...]:
    names = [name for name, _ in options.bundle]
    variants = table(options.protocol, names, options.samples, tuple(dict.fromkeys(options.shares)))
    if len({one.name for one in variants}) < len(variants):
        raise ConfigError(
            "models share a name", expected="NAME=FOLDER with other names", got=", ".join(names)
        )
    return pick(variants, options.variants or GROUPS[options.protocol])


def make_request(options: argparse.Namespace) -> Request:
    """What the options ask for; bundles are loaded."""
    world, (max_iterations, time_limit_s) = named_world(options.robot), LIMITS[options.protocol]
    setting = Setting(
        options.protocol,
        options.split,
        options.seed,
        max_iterations,
        time_limit_s,
        world=world,
    )
    variants, plans = _variants(options), setting.protocol is Protocol.PLANS
    folder = None if options.problems_folder is None else options.problems_folder.resolve()
    problems = _plan_problems(options, setting, folder) if plans else _problems(options, setting)
    used = {one.sampler for one in variants}
    robot = world if plans else None
    models = tuple((name, packed_bundle(folder, robot)) for name, folder in options.bundle if name in used)
    pictures = tuple(dict.fromkeys(options.pictures)) if plans else (0,)
    repeats = options.runs or RUNS[setting.protocol]
    return Request(options.out, setting, problems, repeats, variants, models, pictures, folder)


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
    usual = dict.fromkeys(families.solvable, PAPER_PROBLEMS)
    if setting.protocol is Protocol.FAMILIES:
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
    if not options.bundle:
        raise ConfigError("no model plans", remedy="name one with --bundle")
    known = [family for families in seen.sources.values() for family in families]
    problems: dict[str, int] = {}
    for family in _wanted(options, known, known):
        most = seen.count(family, setting.split)
        if most is not None and not problems:
            # Problems that do not ship fail here, before any run.
            seen.problem(ProblemRequest(setting.split, setting.seed, folder=folder), family, 0, 1)
        requested = options.problems or most or PLAN_PROBLEMS
        problems[family] = requested if most is None else min(requested, most)
    return problems


if __name__ == "__main__":
    sys.exit(main())
