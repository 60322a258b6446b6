#!/usr/bin/env python
"""The Ray job: train the paper's path model and register it.

ray job submit --working-dir . -- python training/path_train.py
ray job submit --working-dir . -- python training/path_train.py --preset paper --set seed=1
ray job submit --working-dir . -- python training/path_train.py --resume RUN_ID
"""

import sys

from training.command import JobCommand
from training.config import PathTrainConfig

COMMAND = JobCommand(
    description=(__doc__ or "").partition("\n")[0],
    example="wgan.steps=500",
    config=PathTrainConfig,
    run="training.paths:run_job",
)

if __name__ == "__main__":
    sys.exit(COMMAND.main())
