"""The typed configuration of a training job: defaults here, presets only override them.

Unknown keys are errors, values are validated once, and nothing changes afterwards.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from training.config.files import Section, load_values, named_presets, validated
from training.datasets.config import DatasetConfig

PRESET_FOLDER = Path(__file__).parents[1] / "presets"


class VaeConfig(Section):
    """The picture's variational auto-encoder."""

    latent_dim: int = Field(64, ge=1)
    width: int = Field(16, ge=1, description="channels of the first convolution")
    patches: Literal[1, 4] = 4
    steps: int = Field(400, ge=1)
    batch_size: int = Field(64, ge=2)
    learning_rate: float = Field(2e-3, gt=0)
    kl_weight: float = Field(1.0, ge=0)
    kl_warmup: float = Field(0.3, ge=0, le=1, description="share of the steps over which the KL term grows")
    gradient_clip: float = Field(200.0, gt=0)
    checkpoint: Path | None = Field(
        None, description="a VAE trial's checkpoint whose encoder is taken; none is trained"
    )


class ClusterConfig(Section):
    """k-means over the configuration space, and what is made of the clusters."""

    count: int = Field(2, ge=1, description="trials that train side by side, one a cluster")
    fit_samples: int = Field(50_000, ge=10)
    form: Literal["guided", "mixture", "distilled"] = Field(
        "guided",
        description="guided: the local critics guide a global generator, as in the paper; mixture: the local "
        "generators themselves, behind a gate; distilled: one generator that has learned the mixture",
    )


class GateConfig(Section):
    """The gate: which cell of the configuration space a picture's free configurations lie in."""

    cells: int = Field(0, ge=0, description="0 for none: the generators start from the whole torus")
    points: int = Field(1024, ge=1, description="stored in each cell, from which the generators start")
    steps: int = Field(600, ge=1)
    batch_size: int = Field(128, ge=1)
    hidden: int = Field(128, ge=1)
    layers: int = Field(2, ge=1)
    learning_rate: float = Field(4e-3, gt=0)


class LookupConfig(Section):
    """Where a network reads the picture: at points along the links and beside them."""

    points_per_link: int = Field(0, ge=0, description="0 for no look-ups")
    side_m: float = Field(0.0, ge=0, description="distance of the rows beside each link; 0 for none")

    @model_validator(mode="after")
    def _one_point_is_no_row(self) -> "LookupConfig":
        if self.points_per_link == 1:
            raise ValueError("points_per_link counts both ends of a link: 2 or more, or 0 for no look-ups")
        return self


class GanConfig(Section):
    """One WGAN-GP: generator, critic, losses and budget."""

    generator: Literal["torus", "means"] = "torus"
    hidden: int = Field(128, ge=1)
    layers: int = Field(3, ge=1)
    noise_dim: int = Field(2, ge=1, description="explicit noise of the torus generator")
    means: int = Field(1, ge=1, description="K of the means generator")
    sigma: float = Field(0.0, ge=0, description="standard deviation round each mean, on standardised angles")
    smooth_maximum: float | None = Field(
        None, gt=0, description="epsilon of the smooth maximum; none switches it off"
    )
    critic_condition: Literal["latent", "projection"] = "latent"
    critic_features: Literal["torus", "standardised"] = "torus"
    critic_hidden: int = Field(128, ge=1)
    critic_layers: int = Field(3, ge=2)
    generator_lookups: LookupConfig = LookupConfig()
    critic_lookups: LookupConfig = LookupConfig()
    penalty: Literal["one_sided", "two_sided"] = "one_sided"
    penalty_weight: float = Field(10.0, ge=0)
    critic_steps: int = Field(4, ge=1, description="critic steps before each generator step")
    generator_learning_rate: float = Field(1e-3, gt=0)
    critic_learning_rate: float = Field(2e-3, gt=0)
    betas: tuple[float, float] = (0.0, 0.9)
    decay_from: float = Field(0.4, ge=0, le=1, description="share of the steps after which the rates fall")
    batch_size: int = Field(512, ge=2)
    steps: int = Field(1000, ge=1, description="generator steps")

    @model_validator(mode="after")
    def _means_need_their_generator(self) -> "GanConfig":
        if self.generator == "torus" and (self.means != 1 or self.sigma != 0.0):
            raise ValueError(
                "means and sigma belong to generator=means; the torus generator takes means=1, sigma=0"
            )
        if self.generator == "means" and self.generator_lookups.points_per_link:
            raise ValueError("generator_lookups belong to generator=torus: the means have no base to look up")
        return self


class GlobalConfig(GanConfig):
    """The global WGAN-GP, guided by the local critics."""

    local_critic_weight: float = Field(0.1, ge=0, description="weight of the local critics' mean; 0 is off")
    encoder: Literal["trained", "joint"] = Field(
        "trained", description="trained before, or together with the generator: the paper's baseline"
    )
    reconstruction_weight: float = Field(
        1.0,
        ge=0,
        description="of the decoded pictures' error for a joint encoder; 0 leaves the KL term alone",
    )

    @model_validator(mode="after")
    def _joint_encoder_needs_its_critic(self) -> "GlobalConfig":
        if self.encoder == "joint" and self.critic_condition != "projection":
            raise ValueError("a joint encoder takes critic_condition=projection: latents change as it learns")
        return self


class ValidityConfig(Section):
    """The validity head: an occupancy network with pixel-aligned look-ups."""

    steps: int = Field(3000, ge=0, description="0 leaves the bundle without a head")
    pictures_per_step: int = Field(32, ge=1)
    configurations_per_picture: int = Field(64, ge=2)
    free_share: float = Field(
        0.69, gt=0, lt=1, description="of the joint space, on average: the prior that confidences are true to"
    )
    points_per_link: int = Field(12, ge=2)
    side_m: float = Field(0.1, ge=0, description="distance of the look-ups beside each link")
    hidden: int = Field(160, ge=1)
    layers: int = Field(2, ge=1)
    learning_rate: float = Field(4e-3, gt=0)
    threshold: float | None = Field(
        None, gt=0, lt=1, description="the confidence that the bundle recommends; none to choose it"
    )
    target_precision: float = Field(
        0.995, gt=0, lt=1, description="that the chosen threshold reaches on validation scenarios"
    )
    uniform_share: float | None = Field(
        None, ge=0, lt=1, description="of uniform proposals among those that are filtered; none to choose it"
    )
    target_acceptance: float = Field(
        0.85, ge=0, le=1, description="that the chosen uniform share leaves on validation scenarios"
    )


class ResourceConfig(Section):
    """What a trial gets from the cluster and how it survives faults."""

    cpus_per_trial: float = Field(1.0, gt=0)
    gpus_per_trial: float = Field(0.0, ge=0)
    memory_mb_per_trial: float = Field(
        0.0,
        ge=0,
        description="MiB that a node must have free for a trial, so that none is overfilled; 0 to ignore",
    )
    max_failures: int = Field(2, ge=0)
    log_every_steps: int = Field(20, ge=1)
    checkpoint_every_steps: int = Field(250, ge=1)
    checkpoints_kept: int = Field(1, ge=1, description="of each trial, the last ones")

    def of_a_trial(self) -> dict[str, float]:
        """What a trial claims, in the words of Ray Tune; memory in bytes."""
        claimed = {"cpu": self.cpus_per_trial, "gpu": self.gpus_per_trial}
        return claimed | ({"memory": self.memory_mb_per_trial * 2**20} if self.memory_mb_per_trial else {})


class TrainConfig(Section):
    """Everything that fixes a training job."""

    preset: str = "quickstart"
    seed: int = Field(0, ge=0)
    data: DatasetConfig = DatasetConfig()
    data_folder: Path | None = Field(None, description="an existing data set in the documented format")
    vae: VaeConfig = VaeConfig()
    clusters: ClusterConfig = ClusterConfig()
    gate: GateConfig = GateConfig()
    validity: ValidityConfig = ValidityConfig()
    local: GanConfig = GanConfig(steps=400)
    global_: GlobalConfig = Field(GlobalConfig(), alias="global")
    resources: ResourceConfig = ResourceConfig()

    @model_validator(mode="after")
    def _parts_fit(self) -> "TrainConfig":
        form, cells = self.clusters.form, self.gate.cells
        if form != "guided" and cells < self.clusters.count:
            raise ValueError(
                f"clusters.form={form} needs gate.cells of at least clusters.count, {self.clusters.count}"
            )
        guided = form == "guided" and self.local_trials and self.global_.local_critic_weight > 0
        if guided and self.local.critic_lookups != self.global_.critic_lookups:
            raise ValueError("local critics that guide look where the global one does: equal critic_lookups")
        if cells and "means" in (self.local.generator, self.global_.generator):
            raise ValueError("gate.cells belong to generator=torus: the means have no base to draw in a cell")
        return self

    @model_validator(mode="after")
    def _joint_encoder_has_no_other(self) -> "TrainConfig":
        if not self.joint:
            return self
        if self.local_trials:
            raise ValueError(
                "local trials need an encoder trained before; global.encoder=joint takes clusters.count=1 "
                "and global.local_critic_weight=0"
            )
        if self.vae.checkpoint is not None:
            raise ValueError("global.encoder=joint trains its own encoder; leave vae.checkpoint out")
        return self

    @property
    def joint(self) -> bool:
        """Whether the encoder is trained with the global generator."""
        return self.global_.encoder == "joint"

    @property
    def local_trials(self) -> int:
        """How many local WGAN-GPs there are; none where one cluster is everything and no critic is asked."""
        unasked = self.clusters.form == "guided" and self.global_.local_critic_weight == 0
        return 0 if self.clusters.count == 1 and unasked else self.clusters.count


def load_config(preset: str, overrides: Sequence[str] = ()) -> TrainConfig:
    """A preset with ``key.sub=value`` overrides, validated.

    Args:
        preset: name of a file in ``presets`` without its ending.
        overrides: YAML scalars by dotted key, such as ``global.steps=200``.

    Raises:
        ConfigError: an unknown preset or key, or a value of the wrong type or range.
    """
    return validated(TrainConfig, load_values(PRESET_FOLDER, preset, overrides), "cluster_train.py")


def presets() -> list[str]:
    """Names of the presets that ship."""
    return named_presets(PRESET_FOLDER)
