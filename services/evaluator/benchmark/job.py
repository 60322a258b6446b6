"""The planning benchmark: its command line, and the job that runs what is missing and writes the files."""

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError, ScenarioError
from cspace.query import MAX_SAMPLES
from cspace.splits import Split
from cspace.worlds import examples, partly_seen, workshop_of
from services.command_errors import finite
from services.evaluator.benchmark.arms import (
    LEARNED_SHARES,
    LIMITS,
    MIN_CONFIDENCE,
    RUNS,
    SAMPLES,
    Arm,
    Group,
    Protocol,
    Setting,
    Taken,
    pick,
    problems_of,
    table,
    units,
)
from services.evaluator.benchmark.execution import Execute
from services.evaluator.benchmark.figures import pages
from services.evaluator.benchmark.files import log_run, write_files
from services.evaluator.benchmark.plans.job import add_options
from services.evaluator.benchmark.results import Results
from services.evaluator.benchmark.sources import SourceSpec, bundled, parse_named, served
from services.evaluator.benchmark.store import Run, RunStore
from services.evaluator.evaluation.units import MAX_SEED
from services.planner.settings import PLANNERS
from services.progress import Progress
from services.registry.tracking.port import Tracking

Show = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What a benchmark is asked for.

    Args:
        out: folder of runs and report.
        setting: the limits.
        problems: how many of each family.
        repeats: runs of each problem.
        arms: that are compared.
        specs: the learned samplers of the arms.
        pages: of single problems that are drawn, of each family.
    """

    out: Path
    setting: Setting
    problems: Mapping[str, int]
    repeats: int
    arms: tuple[Arm, ...]
    specs: tuple[SourceSpec, ...]
    pages: int = 3

    def covers(self, run: Run) -> bool:
        """Whether a run is among those asked for; the folder may hold others of the same setting."""
        return (
            run.arm in {arm.name for arm in self.arms}
            and run.problem < self.problems.get(run.family, 0)
            and run.run < self.repeats
        )


def run_benchmark(
    request: Request, execute: Execute, show: Show, tracking: Tracking | None = None
) -> Results:
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
    store = RunStore.open(request.out, request.setting, request.arms, request.specs)
    work = list(
        units(request.problems, request.repeats, request.arms, store.done(), request.setting.families)
    )
    show(f"{len(request.arms)} arms; {len(work)} runs of problems to do")
    with Progress("planning", len(work), show) as progress:
        for found in execute(work, request.setting, request.specs) if work else ():
            store.append(found)
            progress.advance()
    runs = [run for run in store.runs() if request.covers(run)]
    results = Results.gather(runs, list(request.problems), request.arms, request.setting)
    shown = {family: min(request.pages, count) for family, count in request.problems.items()}
    write_files(results, store, pages(shown, request.arms, request.setting, request.specs))
    if tracking is not None:
        show(f"logged as run {log_run(tracking, results, store)}")
    return results


GROUPS = (Group.UNIFORM, Group.LEARNED, Group.OPTIMISING)
WORLDS = examples()
SPLITS = (Split.VALIDATION, Split.TEST)


def parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator planning",
        description="Solve the same problems with the same seeds by uniform planners and by planners with "
        "learned samples; tell from which cost of a collision check on the learned ones are worth it.",
        epilog="Given again, the command goes on from the runs that --out holds. Reads RAY_ADDRESS and "
        "MLFLOW_TRACKING_URI. Exit codes: 0 done, 1 a run failed, 2 wrong request.",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of runs, report and figures")
    parser.add_argument("--protocol", type=Protocol, choices=list(Protocol), default=Protocol.FAMILIES)
    learned = parser.add_argument_group("learned samplers, each option any number of times")
    learned.add_argument("--api", help="of the models, for example http://127.0.0.1:8000")
    learned.add_argument(
        "--model", action="append", default=[], metavar="[NAME=]REFERENCE", help="as path-sampler@champion"
    )
    learned.add_argument(
        "--bundle", action="append", default=[], metavar="NAME=FOLDER", help="in the planner's process"
    )
    what = parser.add_argument_group("what is run")
    what.add_argument(
        "--robot", choices=list(WORLDS), default=next(iter(WORLDS)), help="default: %(default)s"
    )
    what.add_argument("--family", choices=_families(), action="append", help="default: all")
    what.add_argument("--split", type=Split, choices=SPLITS, default=Split.VALIDATION)
    what.add_argument(
        "--problems",
        type=int,
        help="of each family (default: 300, disconnected 30; of the paper's protocol 10)",
    )
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
        "--min-confidence",
        type=finite,
        default=MIN_CONFIDENCE,
        help="of the filtered and the ordered arms; 0: none is dropped",
    )
    what.add_argument(
        "--samples", type=int, default=SAMPLES,
        help="learned ones for a run, but in arms that name a number (default: %(default)s)",
    )  # fmt: skip
    what.add_argument(
        "--shares", type=finite, nargs="+", default=LEARNED_SHARES, metavar="SHARE",
        help="of learned samples, 0 to 1; of each there is an arm (default: 0.7 1)",
    )  # fmt: skip
    what.add_argument("--iterations", type=int, help="after which a search ends (default: 20000)")
    what.add_argument(
        "--optimising-iterations", type=int, help="the same, of optimising arms (default: 2000)"
    )
    what.add_argument("--time-limit", type=finite, metavar="S", help="default: 10, of the paper's protocol 1")
    add_options(parser)
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
        found += workshop_of(world).families.names
        try:
            found += [name for names in partly_seen(world).sources.values() for name in names]
        except ScenarioError:
            continue
    return list(dict.fromkeys(found))


def chosen_arms(options: argparse.Namespace) -> tuple[Arm, ...]:
    """The arms that the options name.

    Raises:
        ConfigError: a name is unknown, or two samplers share one.
    """
    names = [parse_named(text)[0] for text in (*options.model, *options.bundle)]
    if len(set(names)) < len(names):
        raise ConfigError("samplers share a name", expected="NAME=REFERENCE with other names", got=str(names))
    if not 0.0 <= options.min_confidence <= 1.0:
        raise ConfigError(
            "the confidence is out of range", expected="0 to 1", got=str(options.min_confidence)
        )
    if not 1 <= options.samples <= MAX_SAMPLES:
        raise ConfigError(
            "the samples are out of range", expected=f"1 to {MAX_SAMPLES}", got=str(options.samples)
        )
    shares = tuple(dict.fromkeys(options.shares))
    if not all(0.0 < share <= 1.0 for share in shares):
        raise ConfigError("a share is out of range", expected="above 0 to 1", got=str(options.shares))
    taken = Taken(options.min_confidence, options.samples, shares)
    range_rad = workshop_of(WORLDS[options.robot]).measures.range_rad
    return pick(table(names, range_rad, taken), options.arms, options.planners)


def make_request(options: argparse.Namespace) -> Request:
    """What the options ask for; models are asked once, bundles loaded.

    Raises:
        ConfigError: a value is out of range.
        SamplerError: the API refuses a model, or does not answer.
        BundleError: a bundle is damaged.
    """
    arms = chosen_arms(options)
    protocol: Protocol = options.protocol
    setting = _setting(options)
    counts_by_family = problems_of(protocol, setting.families)
    wanted = dict.fromkeys(options.family or counts_by_family)
    if not set(wanted) <= set(setting.families.names):
        raise ConfigError(
            f"the arm {options.robot} has no such family of problems",
            expected=", ".join(setting.families.names),
            got=", ".join(wanted),
        )
    problems = {family: options.problems or counts_by_family.get(family, 10) for family in wanted}
    repeats = RUNS[protocol] if options.runs is None else options.runs
    counts = {"problems": options.problems, "runs": repeats, "processes": options.processes}
    if options.pages < 0:
        raise ConfigError("there are too few pages", expected="0 or more", got=str(options.pages))
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ConfigError(f"there are too few {name}", expected="at least 1", got=str(count))
    used = {arm.sampler for arm in arms}
    specs = [spec for spec in _specs(options) if spec.name in used]
    return Request(options.out, setting, problems, repeats, arms, tuple(specs), options.pages)


def _setting(options: argparse.Namespace) -> Setting:
    if not 0 <= options.seed <= MAX_SEED:
        raise ConfigError("the seed is out of range", expected=f"0 to {MAX_SEED}", got=str(options.seed))
    limits = dict(LIMITS[options.protocol])
    given = {
        "max_iterations": options.iterations,
        "optimising_iterations": options.optimising_iterations,
        "time_limit_s": options.time_limit,
    }
    limits |= {name: value for name, value in given.items() if value is not None}
    for name, value in limits.items():
        if not value > 0:
            raise ConfigError(f"{name} is out of range", expected="above 0", got=str(value))
    world = WORLDS[options.robot]
    return Setting(
        options.protocol,
        options.split,
        options.seed,
        int(limits["max_iterations"]),
        int(limits["optimising_iterations"]),
        float(limits["time_limit_s"]),
        workshop_of(world).measures.resolution_rad,
        world=world,
    )


def _specs(options: argparse.Namespace) -> Sequence[SourceSpec]:
    if options.model and not options.api:
        raise ConfigError("models are behind an API", remedy="name it with --api")
    world = WORLDS[options.robot]
    models = [served(*parse_named(text), options.api, world) for text in options.model]
    return [*models, *(bundled(name, Path(at)) for name, at in map(parse_named, options.bundle))]
