#!/usr/bin/env python
"""The Ray job: train a sampler on clusters of the configuration space and register it.

ray job submit training/cluster_train.py
ray job submit --working-dir . -- python training/cluster_train.py --preset quickstart --set seed=1
ray job submit --working-dir . -- python training/cluster_train.py --job arm-1   # again: it goes on
ray job submit --working-dir . -- python training/cluster_train.py --resume RUN_ID
"""

import sys

from training.command import JobCommand, Resume, Train
from training.config import load_config, presets


def job() -> tuple[Train, Resume]:
    """What trains, and what goes on."""
    from training.clusters.pipeline import resume, train  # noqa: PLC0415

    return train, resume


COMMAND = JobCommand(
    program="cluster_train",
    description=(__doc__ or "").partition("\n")[0],
    presets=presets,
    preset="quickstart",
    example="global.steps=200",
    load=load_config,
    job=job,
)

if __name__ == "__main__":
    sys.exit(COMMAND.main())
