"""One trial of a search: a generator behind the gate, measured on validation scenarios as it learns."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from ray import tune

from cspace.splits import derived_seed
from services.names import EXPERIMENT
from services.registry.tracking.experiment import TAG_STAGE
from services.registry.tracking.mlflow_tracking import MlflowTracking
from training.config.clusters import TrainConfig
from training.models.encode import load_encoder
from training.trials.arrays import TrainingArrays
from training.trials.loading import gated_sampler, load_gate, make_wgan
from training.trials.searching.quality import Validation

METRIC = "validation_edr"


def search_trial(
    config: Mapping[str, Any],
    train: TrainConfig,
    arrays: TrainingArrays,
    checkpoints: Mapping[str, str],
    parent_run_id: str,
    tracking_uri: str,
    looks: int,
    scenarios: int,
) -> None:
    """Train with one choice of settings, and report the quality ``looks`` times.

    Args:
        config: ``settings``, keys of ``local`` to values.
        train: everything else.
        arrays: data, latents and cells with the gate's probabilities.
        checkpoints: of ``vae`` and ``gate``.
        parent_run_id: the search's run.
        tracking_uri: of the tracking server.
        looks: how often the quality is measured.
        scenarios: validation scenarios that it is measured on.
    """
    torch.set_num_threads(train.resources.threads)
    logging.getLogger("ray.tune").setLevel(logging.ERROR)
    settings = dict(config["settings"])
    gan = type(train.local).model_validate(train.local.model_dump() | settings)
    encoder = load_encoder(train.vae, arrays.world.sensor, Path(checkpoints["vae"]))
    validation = Validation.draw(encoder, arrays.world, scenarios)
    module = make_wgan(gan, arrays, None, derived_seed(train.seed, "search"))
    gate = load_gate(train, Path(checkpoints["gate"]))
    name = "search " + tune.get_context().get_trial_id()
    run = MlflowTracking(tracking_uri).start(
        EXPERIMENT, name, parent_run_id=parent_run_id, tags={TAG_STAGE: "search-trial"}
    )
    with run:
        run.params({key: str(value) for key, value in settings.items()})
        every = -(-gan.steps // looks)
        for step in range(1, gan.steps + 1):
            module.training_step(step, step)
            if step % every == 0 or step == gan.steps:
                sampler = gated_sampler(gate, arrays, [module.generator], gan.generator_lookups)
                found = validation.measure(sampler)
                run.metrics(module.metrics() | found, step)
                # Tune ends a trial that falls behind inside of report, so the run must be whole by then.
                run.flush()
                tune.report(found | {"step": step})
