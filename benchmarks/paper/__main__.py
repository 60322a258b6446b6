"""The paper's comparison in one command; stopped at any time, it goes on where it was.

    python -m benchmarks.paper --out paper-study
    python -m benchmarks.paper --out paper-study --share 1 --hidden 512

Trains every column by the real job, on a Ray cluster of its own with an MLflow store in the output
folder, on a GPU where there is one; then writes bundles, figures and the table. Exit codes: 0 done,
1 failed, 2 bad input.
"""

import logging
import os
import signal
import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.command import arguments
from benchmarks.paper.columns import COLUMNS, CONTROLS, Scale
from benchmarks.paper.jobs import Study, train_columns
from benchmarks.paper.measures import Effort
from benchmarks.paper.report import compare_columns
from cspace.errors import CspaceError, InputError
from cspace.files import make_output_folder
from services.command_errors import report_error


def parser() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of checkpoints and results")
    parser.add_argument("--share", type=float, default=0.1, help="of the paper's steps (0.1)")
    parser.add_argument("--hidden", type=int, default=128, help="width of generators and critics (128)")
    parser.add_argument("--snapshots", type=int, default=6, help="checkpoints on the learning curves (6)")
    parser.add_argument("--at-once", type=int, choices=(1, 2), default=1, help="trials at once (1)")
    parser.add_argument("--controls", nargs="*", default=[], choices=[c.name for c in CONTROLS])
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--scenarios", type=int, default=100, help="seen and unseen, for the table (100)")
    parser.add_argument(
        "--only", choices=("train", "judge"), help="one half; judge evaluates what is trained"
    )
    return parser


def main(given: Sequence[str] | None = None) -> int:
    options = parser().parse_args(given)
    os.environ.update({"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"})
    os.environ.update({"MLFLOW_DISABLE_TELEMETRY": "true", "ORT_DISABLE_TELEMETRY": "1"})
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    scale = Scale(options.share, options.hidden, options.snapshots, changes=tuple(options.changes))
    make_output_folder(options.out)
    study = Study(options.out.resolve(), scale, options.at_once)
    columns = [*COLUMNS, *(control for control in CONTROLS if control.name in options.controls)]
    # Ends the jobs that run, too; they go on with the next call.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    say = partial(print, flush=True)
    try:
        if options.only != "judge":
            train_columns(study, columns, say)
        if options.only != "train":
            compare_columns(study, columns, Effort(scenarios=options.scenarios), say)
    except CspaceError as error:
        return report_error(error, InputError, program="paper")
    return 0


if __name__ == "__main__":
    sys.exit(main())
