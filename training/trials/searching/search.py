"""The search itself: Tune's ASHA over settings of the generators."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.schedulers import ASHAScheduler
from ray.tune.search.basic_variant import BasicVariantGenerator

from cspace.errors import JobError
from cspace.splits import derived_seed
from training.config.clusters import ResourceConfig
from training.trials.searching.trial import METRIC, search_trial

REDUCTION = 3
MEASURES = ("validation_precision", "validation_coverage", METRIC)


@dataclass(frozen=True, slots=True)
class Tried:
    """One trial of a search.

    Args:
        settings: keys of ``local`` to the values that it tried.
        step: how far it came before it ended or was ended.
        metrics: its last quality on validation scenarios.
    """

    settings: Mapping[str, Any]
    step: int
    metrics: Mapping[str, float]


def space() -> dict[str, Any]:
    """What is searched: keys of the section ``local`` to distributions."""
    points = [{"points_per_link": count, "side_m": 0.1} for count in (6, 12)]
    return {
        "hidden": tune.choice([64, 128, 192]),
        "critic_hidden": tune.choice([64, 128, 192]),
        "critic_steps": tune.choice([2, 4]),
        "noise_dim": tune.choice([2, 4]),
        "generator_learning_rate": tune.loguniform(3e-4, 3e-3),
        "critic_learning_rate": tune.loguniform(5e-4, 4e-3),
        "generator_lookups": tune.choice(points),
        "critic_lookups": tune.choice(points),
    }


def claimed(resources: ResourceConfig) -> dict[str, float]:
    """What a trial of a search claims: no GPU, for its networks and its measurements stay on processors."""
    return {**resources.of_a_trial(), "gpu": 0.0}


def search(
    shared: Mapping[str, Any], steps: int, trials: int, seed: int, resources: ResourceConfig, storage: Path
) -> list[Tried]:
    """Asynchronous successive halving (Li et al. 2020) on the validation energy ratio, best first.

    Args:
        shared: what every trial gets, put into the object store once.
        steps: generator steps of a trial that is never ended early.
        trials: how many settings are tried.
        seed: of the settings.
        resources: of each trial.
        storage: folder for Tune's own files.

    Raises:
        JobError: no trial reported anything.
    """
    # Two cuts. Tune kills what it ends, so neither a third cut nor max_t may fall on a trial's last step.
    scheduler = ASHAScheduler(
        time_attr="step",
        max_t=steps + 1,
        grace_period=steps // REDUCTION**2 + 1,
        reduction_factor=REDUCTION,
    )
    tuner = tune.Tuner(
        tune.with_resources(
            tune.with_parameters(search_trial, **shared),
            claimed(resources),
        ),
        param_space={"settings": space()},
        tune_config=tune.TuneConfig(
            metric=METRIC,
            mode="min",
            scheduler=scheduler,
            search_alg=BasicVariantGenerator(random_state=derived_seed(seed, "searched settings") % 2**32),
            num_samples=trials,
            reuse_actors=False,
        ),
        run_config=tune.RunConfig(name=storage.name, storage_path=str(storage.parent), verbose=0),
    )
    grid = tuner.fit()
    tried = [
        _tried(result)
        for result in map(grid.__getitem__, range(len(grid)))
        if METRIC in (result.metrics or {})
    ]
    if not tried:
        raise JobError("the search found nothing", got="; ".join(map(str, grid.errors)) or "no reports")
    # A trial that went further was better at every cut before; among equals the lower ratio counts.
    return sorted(tried, key=lambda one: (-one.step, one.metrics[METRIC]))


def _tried(result: Any) -> Tried:
    metrics = {name: float(result.metrics[name]) for name in MEASURES}
    return Tried(result.config["settings"], int(result.metrics["step"]), metrics)
