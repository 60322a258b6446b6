#!/usr/bin/env python
"""The Ray job: train path models side by side and register them.

ray job submit --working-dir . -- python training/path_train.py
ray job submit --working-dir . -- python training/path_train.py --set models='[density, flow]' --set seed=1
ray job submit --working-dir . -- python training/path_train.py --resume RUN_ID
"""

import argparse
import dataclasses
import json
import logging
import sys
from collections.abc import Sequence

from cspace.errors import CspaceError, InputError
from training.environment import job_environment
from training.path_config import load_path_config, path_presets


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="Reads MLFLOW_TRACKING_URI, CSPACE_DATA_DIR. Exit codes: 0 registered, 1 failed, 2 bad input.",
    )
    parser.add_argument("--preset", default="paths", help=f"one of {', '.join(path_presets())}")
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="such as density.steps=500",
    )
    parser.add_argument(
        "--resume", metavar="RUN_ID", help="go on with a stopped job, by its own configuration"
    )
    parser.add_argument("--print-config", action="store_true", help="print the whole configuration and end")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, train, print."""
    line = parser()
    options = line.parse_args(arguments)
    if options.resume and options.overrides:
        line.error("--resume goes on with the job's own configuration and takes no --set")
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    logging.getLogger("training").setLevel(logging.INFO)
    try:
        config = load_path_config(options.preset, options.overrides)
        if options.print_config:
            print(json.dumps(config.to_dict(), indent=2))
            return 0
        environment = job_environment()
        # Imported here so that a wrong key is told at once, not after the frameworks have loaded.
        from training.path_pipeline import resume_paths, train_paths  # noqa: PLC0415

        result = (
            resume_paths(options.resume, environment) if options.resume else train_paths(config, environment)
        )
    except CspaceError as error:
        print(f"path_train: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    print("RESULT " + json.dumps(dataclasses.asdict(result)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
