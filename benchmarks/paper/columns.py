"""What is compared: each column a preset, all with the same data, encoder, share of the steps and width."""

from dataclasses import dataclass
from pathlib import Path

from training.config import TrainConfig


@dataclass(frozen=True, slots=True)
class Column:
    """One way to train.

    Args:
        name: on the command line and in file names.
        label: in tables and figures.
        preset: of the training job.
        changes: overrides beside the preset.
    """

    name: str
    label: str
    preset: str
    changes: tuple[str, ...] = ()


# Trains the encoder that all take that do not train one jointly, and so comes before them.
BASE = Column("single", "encoder apart, no means", "paper_single")
COLUMNS = (
    Column("joint", "encoder trained jointly", "paper_joint"),
    BASE,
    Column("means", "K = 4 means, one cluster", "paper_means"),
    Column("clusters", "two clusters, local critics", "paper"),
)
CONTROLS = (
    Column("means-one-sided", "K = 4 means, one-sided penalty", "paper_means", ("global.penalty=one_sided",)),
    Column("joint-kl", "jointly, KL term alone", "paper_joint", ("global.reconstruction_weight=0",)),
)


@dataclass(frozen=True, slots=True)
class Scale:
    """How much of the paper's budget a study spends.

    Args:
        share: of all training steps.
        hidden: width of generators and critics.
        snapshots: checkpoints of each global trial that are judged, evenly spaced.
        seed: of every training.
        changes: further overrides for all columns, such as the size of the data set.
    """

    share: float = 0.1
    hidden: int = 128
    snapshots: int = 6
    seed: int = 0
    changes: tuple[str, ...] = ()

    def overrides(self, column: Column, encoder: Path | None, gpus: float = 0.0) -> list[str]:
        """What the training job of a column is told beside its preset.

        Args:
            column: which one.
            encoder: a VAE trial's checkpoint; None trains one, or none where it is trained jointly.
            gpus: of each trial.
        """
        plain = TrainConfig.load(column.preset, [*self.changes, *column.changes])
        steps = {"vae": plain.vae.steps, "local": plain.local.steps, "global": plain.global_.steps}
        scaled = {name: max(1, round(self.share * count)) for name, count in steps.items()}
        # The last checkpoint is that of the last step, which a further one just before it would crowd.
        every = -(-scaled["global"] // self.snapshots)
        return [
            *self.changes,
            *column.changes,
            *(f"{name}.steps={count}" for name, count in scaled.items()),
            *(f"{part}.{key}={self.hidden}" for part in ("local", "global") for key in _WIDTHS),
            f"seed={self.seed}",
            f"resources.checkpoint_every_steps={every}",
            f"resources.checkpoints_kept={self.snapshots + 1}",
            f"resources.log_every_steps={max(1, scaled['global'] // 400)}",
            f"resources.gpus_per_trial={gpus}",
            # Hours on a shared machine: Ray takes a worker that gets no processor for dead.
            "resources.max_failures=20",
            *([] if encoder is None else [f"vae.checkpoint={encoder}"]),
        ]

    def config(self, column: Column, encoder: Path | None, gpus: float = 0.0) -> TrainConfig:
        """The configuration that these overrides make."""
        return TrainConfig.load(column.preset, self.overrides(column, encoder, gpus))


_WIDTHS = ("hidden", "critic_hidden")
