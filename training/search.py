#!/usr/bin/env python
"""The Ray job that searches settings of the generators: many short trials, the weak ones ended early.

ray job submit --working-dir . -- python training/search.py --preset reference --trials 24

All trials share data, encoder and gate. Each is a run under the search's, with its settings as parameters
and its quality on validation scenarios as metrics, so that the MLflow UI compares them. Nothing is
registered: put the settings that you choose into a preset and train.
"""

import argparse
import json
import logging
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cspace.errors import ConfigError, CspaceError, InputError
from services.commands import report_error, report_result
from training.config import TrainConfig

_LOG = logging.getLogger("training")
LOOKS = 9


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="Reads MLFLOW_TRACKING_URI, CSPACE_DATA_DIR. Exit codes: 0 found, 1 failed, 2 bad input.",
    )
    parser.add_argument("--preset", default="reference", help=f"one of {', '.join(TrainConfig.presets())}")
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[])
    parser.add_argument("--trials", type=int, default=24, help="settings that are tried")
    parser.add_argument("--scenarios", type=int, default=40, help="validation scenarios that decide")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, search, print."""
    options = parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    _LOG.setLevel(logging.INFO)
    try:
        # One generator over all cells a trial, and no head: the search is about generators.
        fixed = ["clusters.count=1", "validity.steps=0"]
        config = TrainConfig.load(options.preset, [*options.overrides, *fixed])
        if config.clusters.form != "mixture" or min(options.trials, options.scenarios) < 1:
            raise ConfigError(
                "there is nothing to search",
                expected="a preset with clusters.form=mixture, one trial and one scenario or more",
                got=f"{config.clusters.form}, {options.trials} trials, {options.scenarios} scenarios",
            )
        # Its trials look along the links: told here, and not after the encoder was trained.
        config.world.link_sample_points(points_per_link=2, side_m=0.0)
        found, folder = run(config, options.trials, options.scenarios)
    except CspaceError as error:
        return report_error(error, InputError, program="search")
    best = found["tried"][0]
    rows = {"run": found["run_id"], "best settings": json.dumps(best["settings"])}
    report_result(found, rows, folder)
    return 0


def run(config: TrainConfig, trials: int, scenarios: int) -> tuple[dict[str, Any], Path]:
    """Search, and return the run's id with what was tried, best first, and the folder of the job."""
    # Imported here so that a wrong key is told at once, not after the frameworks have loaded.
    from training.clusters.pipeline import (  # noqa: PLC0415
        cluster_data,
        encode_data,
        encoder_checkpoint,
        prepare_data,
        train_family,
        train_on_pictures,
    )
    from training.jobs.job import Job, job_environment  # noqa: PLC0415
    from training.trials.launch import connect  # noqa: PLC0415
    from training.trials.search import search  # noqa: PLC0415

    environment = job_environment()
    connect()
    job = Job.start(config, environment, {"preset": config.preset, "search": "asha"}, stage="search")
    with job.running() as parent:
        dataset = prepare_data(config, environment.data_folder)
        job.log_configuration()
        data = cluster_data(job, dataset)
        vae, _ = train_on_pictures(job, dataset)
        arrays = encode_data(job, dataset, vae, data)
        (gate,) = train_family(job, arrays, until="gate")
        shared = {
            "train": config,
            # Some of the settings look the pictures up, whatever the preset does.
            "arrays": replace(arrays, images=np.asarray(dataset.images)),
            "checkpoints": {"vae": str(encoder_checkpoint(job, vae)), "gate": str(gate.checkpoint)},
            "parent_run_id": parent.run_id,
            "tracking_uri": environment.tracking_uri,
            "looks": LOOKS,
            "scenarios": scenarios,
        }
        steps = config.to_dict()["local"]["steps"]
        _LOG.info("search: %d trials of at most %d steps", trials, steps)
        tried = search(shared, steps, trials, config.seed, config.resources, job.folder / "search")
        for one in tried:
            quality = " / ".join(f"{value:.3f}" for value in one.metrics.values())
            _LOG.info("step %d: precision / coverage / EDr %s, %s", one.step, quality, dict(one.settings))
        parent.metrics(dict(tried[0].metrics), 0)
        rows = [{"settings": dict(one.settings), "step": one.step, **one.metrics} for one in tried]
        return {"run_id": parent.run_id, "tried": rows}, job.folder


if __name__ == "__main__":
    sys.exit(main())
