#!/usr/bin/env python
"""The Ray job: train path models side by side and register them.

ray job submit --working-dir . -- python training/path_train.py
ray job submit --working-dir . -- python training/path_train.py --set models='[flow]' --set seed=1
ray job submit --working-dir . -- python training/path_train.py --resume RUN_ID
"""

import sys

from training.command import JobCommand, Resume, Train
from training.config import load_path_config, path_presets


def job() -> tuple[Train, Resume]:
    """What trains, and what goes on."""
    from training.paths.pipeline import resume_paths, train_paths  # noqa: PLC0415

    return train_paths, resume_paths


COMMAND = JobCommand(
    program="path_train",
    description=(__doc__ or "").partition("\n")[0],
    presets=path_presets,
    preset="paths",
    example="flow.steps=500",
    load=load_path_config,
    job=job,
)

if __name__ == "__main__":
    sys.exit(COMMAND.main())
