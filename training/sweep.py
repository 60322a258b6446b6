#!/usr/bin/env python
"""The Ray job that trains a whole grid: a complete training job for each of its points, several at once.

ray job submit --working-dir . -- python training/sweep.py --job seeds --preset quickstart \
    --grid 'clusters.count=[1, 2, 4]' --grid 'seed=[0, 1, 2]'

All points are runs under the sweep's, which the MLflow UI compares. Submitted again under the same --job, the
sweep goes on: points that have finished stay, others go on where they were, failed ones are tried again, and
the grid may have grown. Nothing is registered unless --register asks for it.
"""

import argparse
import logging
import sys
from collections.abc import Sequence

from cspace.errors import CspaceError, InputError
from services.command_errors import tell_error
from services.results import tell_result
from training.command import STOPPED
from training.config.clusters import load_config, presets
from training.jobs.environment import job_environment
from training.sweeps.grid import EXAMPLE, axis, points
from training.sweeps.plan import Plan
from training.sweeps.record import MEASURES, sweep_folder


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="Reads MLFLOW_TRACKING_URI, CSPACE_DATA_DIR. "
        "Exit codes: 0 all points finished, 1 some failed, 2 bad input, 3 stopped.",
    )
    parser.add_argument("--job", required=True, metavar="NAME", help="the sweep's name, by which it goes on")
    parser.add_argument("--preset", default="quickstart", help=f"one of {', '.join(presets())}")
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[])
    parser.add_argument("--grid", metavar="KEY=[VALUE, ...]", action="append", default=[], help=EXAMPLE)
    parser.add_argument("--at-once", type=int, default=2, help="points that run side by side")
    parser.add_argument(
        "--sort", choices=sorted(MEASURES), default="edr", help="what the final table goes by"
    )
    parser.add_argument("--scenarios", type=int, default=20, help="validation scenarios that judge a point")
    parser.add_argument("--register", action="store_true", help="register every point's bundle")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, train, print."""
    line = parser()
    options = line.parse_args(arguments)
    if min(options.at_once, options.scenarios) < 1:
        line.error("--at-once and --scenarios take 1 or more")
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    logging.getLogger("training").setLevel(logging.INFO)
    try:
        grid = points([axis(text) for text in options.grid])
        configs = {
            point: load_config(options.preset, [*options.overrides, *point.overrides]) for point in grid
        }
        plan = Plan(
            options.job,
            options.preset,
            tuple(options.overrides),
            configs,
            options.at_once,
            options.sort,
            options.scenarios,
            options.register,
        )
        environment = job_environment()
        # Imported here so that a wrong key is told at once, not after the frameworks have loaded.
        from training.sweeps.run import run_sweep  # noqa: PLC0415

        found = run_sweep(plan, environment)
    except CspaceError as error:
        return tell_error(error, InputError, program="sweep")
    except KeyboardInterrupt:
        print("sweep: stopped; nothing is lost: submit it again", file=sys.stderr)
        return STOPPED
    rows = {"run": found["run_id"], "points": f"{len(found['points'])}, {found['failed']} failed"}
    tell_result(found, rows, sweep_folder(environment.data_folder, options.job))
    return 0 if found["failed"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
