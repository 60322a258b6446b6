"""Running trials on the cluster: Ray Tune with explicit resources and retries.

What a trial has done is known by its own checkpoints and by the record that is written when it finishes, not
by Tune's picture of the experiment, which is seconds old when the driver is killed.
"""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ray import tune
from ray.tune.experiment import Trial

from cspace.errors import JobError
from services.evaluator.cluster import join
from training.config.clusters import ResourceConfig
from training.trials.outcomes import Outcomes, TrialOutcome, read_outcome
from training.trials.request import TrialRequest
from training.trials.stopping import Stop, end_on_request

_LOG = logging.getLogger("training")


# The job's log is for its own progress; what the libraries print of theirs is switched off.
QUIET = {
    "RAY_AIR_NEW_OUTPUT": "0",
    "TUNE_WARN_EXCESSIVE_EXPERIMENT_CHECKPOINT_SYNC_THRESHOLD_S": "0",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}


def connect() -> None:
    """Join the cluster that ``RAY_ADDRESS`` names (a submitted job has it set), or start a local one."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    for library in ("ray.tune", "ray.train", "mlflow"):
        logging.getLogger(library).setLevel(logging.ERROR)
    join(runtime_env={"env_vars": QUIET})
    end_on_request()


def run_trials(
    trainable: Callable[..., None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> list[TrialOutcome]:
    """Run the trials of a stage, as many at once as the cluster has room for.

    Where their folders are those of a job that was stopped, finished ones are not run again, and the others
    go on from their checkpoints.

    Args:
        trainable: gets a trial and ``shared`` by keyword, in Tune's worker.
        trials: of one stage.
        shared: arrays and settings, put into the object store once.
        resources: of each trial.

    Returns:
        Outcomes in the order of ``trials``.

    Raises:
        JobError: a trial failed more often than it may.
        KeyboardInterrupt: the job was asked to stop; its trials have written their checkpoints.
    """
    left = [trial for trial in trials if read_outcome(trial) is None]
    if len(left) < len(trials):
        finished = len(trials) - len(left)
        _LOG.info("%s: %d of %d trials are finished", trials[0].stage.name, finished, len(trials))
    if left:
        _fit(trainable, left, shared, resources)
    outcomes = [read_outcome(trial) for trial in trials]
    return [outcome for outcome in outcomes if outcome is not None]


def _fit(
    trainable: Callable[..., None],
    trials: Sequence[TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> None:
    storage, requests = trials[0].stage, {trial.name: trial for trial in trials}
    bound = bind(trainable, requests, shared, resources)
    stop = Stop(trials[0].stop)
    tuner = tune.Tuner(
        bound,
        param_space={"trial": tune.grid_search(list(requests))},
        tune_config=tune.TuneConfig(
            reuse_actors=True,
            trial_name_creator=_trial_name,
            trial_dirname_creator=_trial_name,
        ),
        run_config=tune.RunConfig(
            name=_attempt(storage),
            storage_path=str(storage),
            failure_config=tune.FailureConfig(max_failures=resources.max_failures),
            callbacks=[Outcomes(storage), stop],
            verbose=0,
        ),
    )
    with stop:
        grid = tuner.fit()
    failed = [str(error) for error in grid.errors]
    if failed:
        raise JobError(
            f"{len(failed)} of {len(trials)} trials failed",
            expected=f"at most {resources.max_failures} faults each",
            got=failed[0].strip().splitlines()[-1],
            remedy=f"their logs are under {storage}; submitted again the job goes on from its checkpoints",
        )
    if any(read_outcome(trial) is None for trial in trials):
        raise KeyboardInterrupt


def bind(
    trainable: Callable[..., None],
    requests: Mapping[str, TrialRequest],
    shared: Mapping[str, Any],
    resources: ResourceConfig,
) -> Callable[..., None]:
    """A Tune function of a stage's trials that Tune knows by a name which no other job's has.

    Tune finds a function by its name alone among all that one driver has registered: of two jobs in one
    driver, one would otherwise be handed the trials of the other.
    """
    bound: Callable[..., None] = tune.with_resources(
        tune.with_parameters(_asked(trainable), requests=requests, **shared),
        resources.of_a_trial(),
    )
    stage = next(iter(requests.values())).stage
    # Read by Tune before __name__, which stays what logs show.
    vars(bound)["_name"] = f"{trainable.__name__}-{stage.parent.name}-{stage.name}"
    return bound


def _asked(trainable: Callable[..., None]) -> Callable[..., None]:
    """A Tune function: Tune keeps what it is configured with on disk, so it gets the trial's name alone."""

    def run(config: Mapping[str, str], requests: Mapping[str, TrialRequest], **shared: Any) -> None:
        trainable(requests[config["trial"]], **shared)

    # Ray shows it in its logs.
    run.__name__ = trainable.__name__
    return run


def _attempt(storage: Path) -> str:
    """A name for Tune's own files: each attempt has a folder, and none depends on an earlier one."""
    return f"tune-{1 + sum(1 for _ in storage.glob('tune-*')):03d}"


def _trial_name(trial: Trial) -> str:
    return str(trial.config["trial"])
