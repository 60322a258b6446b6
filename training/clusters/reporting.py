"""What a job writes into its parent run: configuration, data set, curves, galleries."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from cspace.splits import Split
from services.evaluator.evaluation.report import gallery
from services.evaluator.measures.scenes import Scene, Stage
from services.planner.sources.local_sampler import BundleSampler
from services.registry.tracking.port import RunLog
from training.config.clusters import TrainConfig
from training.jobs.figures import PANELS, own_curves, wgan_curves
from training.jobs.labels import log_configuration
from training.models.checkpoint import read_progress
from training.trials.outcomes import TrialOutcome

SHOWN_SCENARIOS = 3


def log_start(run: RunLog, config: TrainConfig, dataset: Dataset) -> None:
    """The configuration as parameters and the data set as an input with its digest."""
    log_configuration(run, config)
    run.dataset(dataset.folder.name, dataset.digest, str(dataset.folder), "training")


def log_result(
    run: RunLog, bundle: Bundle, dataset: Dataset, outcomes: Sequence[TrialOutcome]
) -> tuple[str, ...]:
    """Curves of all trials, samples against truth for seen and unseen scenarios; returns their names."""
    histories = {outcome.name: read_progress(outcome.checkpoint).history for outcome in outcomes}
    own = {name: own_curves(name, histories.pop(name)) for name in PANELS if name in histories}
    figures = {
        **{f"{name}-losses": figure for name, figure in own.items()},
        **({"wgan-losses": wgan_curves(histories)} if histories else {}),
        **_galleries(bundle, dataset),
    }
    for name, figure in figures.items():
        run.figure(figure, name)
    final = outcomes[-1].metrics
    run.metrics({f"last/{name}": value for name, value in final.items() if name != "steps_per_s"}, 0)
    # The registry copies what the server holds by the time of registration.
    run.flush()
    return tuple(figures)


def _galleries(bundle: Bundle, dataset: Dataset) -> dict[str, Figure]:
    """Galleries where the truth is known: generated scenarios, and unseen ones of the same robot.

    Of data whose world nobody can draw further scenes of there is none.
    """
    figures: dict[str, Figure] = {}
    sampler = BundleSampler(bundle)
    seed = dataset.generator_seed
    if seed is not None:
        seen = _scenes(dataset, Split.TRAIN, seed)
        figures["samples-seen"] = gallery(seen, sampler, "training scenarios")
    if dataset.world.scenes is not None:
        unseen = _scenes(dataset, Split.VALIDATION, 0)
        figures["samples-unseen"] = gallery(unseen, sampler, "unseen scenarios")
    return figures


def _scenes(dataset: Dataset, split: Split, seed: int) -> list[Scene]:
    stage = Stage(dataset.world, split, seed)
    return [Scene(stage, index) for index in range(SHOWN_SCENARIOS)]
