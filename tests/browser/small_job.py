"""A small job in an MLflow server, written through the adapters: runs, figure, data set, version."""

from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from cspace.bundle import Bundle
from services.names import ALIAS_CHALLENGER, EXPERIMENT, MODEL_NAME
from services.registry.models import ModelRegistry
from services.registry.promotion import Decision, record_decision
from services.registry.tracking import Tracking
from tests.bundles import write_tiny_bundle

CHILDREN = ("vae", "local-0", "local-1", "global", "evaluation")
DATA_DIGEST = "5b" * 32
STEPS = 20


@dataclass(frozen=True)
class SmallJob:
    """What was written.

    Args:
        parent: run id of the job.
        children: run ids by name.
        version: the registered version's number.
    """

    parent: str
    children: dict[str, str]
    version: int


def write_small_job(uri: str, folder: Path) -> SmallJob:
    """A parent run with children as training leaves them, and a champion that came out of it."""
    tracking = Tracking(uri)
    with tracking.start(EXPERIMENT, "cluster-train", tags={"preset": "smoke", "seed": "0"}) as parent:
        parent.params({"preset": "smoke", "global": {"steps": STEPS}})
        parent.dataset("train-0123456789ab", DATA_DIGEST, str(folder), "training")
        parent.figure(_curve(), "wgan-losses")
        children = {name: _child(tracking, parent.run_id, name, at) for at, name in enumerate(CHILDREN)}
    return SmallJob(parent.run_id, children, _version(uri, folder, parent.run_id))


def _child(tracking: Tracking, parent_run_id: str, name: str, offset: int) -> str:
    with tracking.start(EXPERIMENT, name, parent_run_id=parent_run_id) as run:
        run.params({"steps": STEPS, "seed": offset})
        for step in range(1, STEPS + 1):
            run.metrics({"critic_loss": -1.0 / step - offset, "generator_loss": offset + 1.0 / step}, step)
    return run.run_id


def _version(uri: str, folder: Path, run_id: str) -> int:
    registry = ModelRegistry(uri)
    bundle = Bundle.load(write_tiny_bundle(folder / "bundle"))
    tags = {"data_digest": DATA_DIGEST, "preset": "smoke"}
    version = registry.register(
        MODEL_NAME, bundle.folder, run_id, bundle.digest, tags, alias=ALIAS_CHALLENGER
    )
    reasons = ("precision beats uniform beyond the interval",)
    decision = Decision(MODEL_NAME, version.number, True, reasons, {"precision": 0.9}, None, 0)  # noqa: FBT003
    record_decision(registry, decision)
    return version.number


def _curve() -> Figure:
    figure = Figure(figsize=(4, 3))
    figure.subplots().plot([1, 2, 3], [3, 2, 1])
    return figure
