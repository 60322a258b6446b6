#!/usr/bin/env python
"""The Ray job: train a sampler on clusters of the configuration space and register it.

ray job submit training/cluster_train.py
ray job submit --working-dir . -- python training/cluster_train.py --preset quickstart --set seed=1
ray job submit --working-dir . -- python training/cluster_train.py --job arm-1   # again: it goes on
ray job submit --working-dir . -- python training/cluster_train.py --resume RUN_ID
"""

import sys

from training.command import JobCommand
from training.config import TrainConfig

COMMAND = JobCommand(
    description=(__doc__ or "").partition("\n")[0],
    example="local.steps=100",
    config=TrainConfig,
    run="training.clusters.pipeline:run_job",
)

if __name__ == "__main__":
    sys.exit(COMMAND.main())
