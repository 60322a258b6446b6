"""The typed configuration of a training job: defaults here, presets only override them.

Unknown keys are errors, values are validated once, and nothing changes afterwards.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from cspace.dataset.manifest import Manifest
from cspace.errors import ConfigError, InputError
from cspace.world import World
from cspace.worlds import default_world, workshop_of
from services.names import model_name
from training.config.files import load_values, named_presets, validated
from training.config.job import JobConfig
from training.datasets.config import DatasetConfig
from training.models.settings import (
    GanConfig,
    GateConfig,
    GlobalConfig,
    LookupConfig,
    VaeConfig,
    ValidityConfig,
)
from training.section import AbsolutePath, Section

# In a job's folder: centres of its cells, and the cluster of each.
CLUSTERS_FILE = "clusters.npz"
PRESET_FOLDER = Path(__file__).parents[1] / "presets"


class EncoderConfig(VaeConfig):
    """The picture's variational auto-encoder: trained, or taken from an earlier job."""

    checkpoint: AbsolutePath | None = Field(
        None, description="absolute: a VAE trial's checkpoint whose encoder is taken; none is trained"
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


class PromiseConfig(Section):
    """What a bundle is to promise of samples that pass its threshold, on validation scenarios."""

    at_most: float = Field(
        0.04, gt=0, lt=1, description="share of what passes that may collide, as expected of a scene"
    )
    scenarios: int = Field(
        300, ge=30, description="a third chooses the threshold, one makes the promise, one measures it"
    )


class HeadConfig(ValidityConfig):
    """The validity head, and by what rules its bundle uses it."""

    threshold: float | None = Field(
        None, gt=0, lt=1, description="the confidence that the bundle recommends; none to choose it"
    )
    promise: PromiseConfig | None = Field(
        None,
        exclude_if=lambda part: part is None,
        description="chooses the threshold by a bound that is stated; none: by target_precision",
    )
    plan_problems: int = Field(
        0,
        ge=0,
        exclude_if=lambda count: count == 0,
        description="validation problems on which the confidence of plans is calibrated; 0 to leave it",
    )
    target_precision: float = Field(
        0.995, gt=0, lt=1, description="that the chosen threshold reaches on validation scenarios"
    )
    uniform_share: float | None = Field(
        None, ge=0, le=1, description="of uniform proposals among those that are filtered; none to choose it"
    )
    target_acceptance: float = Field(
        0.4, ge=0, le=1, description="of all proposals, that the chosen uniform share leaves at least"
    )


class ResourceConfig(Section):
    """What a trial gets from the cluster and how it survives faults."""

    cpus_per_trial: float = Field(1.0, gt=0, description="a trial computes on so many threads, at least one")
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

    @property
    def threads(self) -> int:
        """On which a trial computes."""
        return max(1, int(self.cpus_per_trial))

    def of_a_trial(self) -> dict[str, float]:
        """What a trial claims, in the words of Ray Tune; memory in bytes."""
        claimed = {"cpu": self.cpus_per_trial, "gpu": self.gpus_per_trial}
        return claimed | ({"memory": self.memory_mb_per_trial * 2**20} if self.memory_mb_per_trial else {})


class TrainConfig(JobConfig):
    """Everything that fixes a training job."""

    KEPT = (CLUSTERS_FILE,)

    preset: str = "quickstart"
    data: DatasetConfig = DatasetConfig()
    vae: EncoderConfig = EncoderConfig()
    clusters: ClusterConfig = ClusterConfig()
    gate: GateConfig = GateConfig()
    validity: HeadConfig = Field({}, validate_default=True)
    local: GanConfig = GanConfig(steps=400)
    global_: GlobalConfig = Field(GlobalConfig(), alias="global")
    resources: ResourceConfig = ResourceConfig()

    @field_validator("validity", mode="before")
    @classmethod
    def _free_share_of_the_world(cls, head: Any, before: ValidationInfo) -> Any:
        """The world's own where none is given."""
        if not isinstance(head, dict) or "free_share" in head:
            return head
        # Data that did not fit are told on their own.
        known = {"data", "data_folder"} <= before.data.keys()
        world = _world(before.data["data"], before.data["data_folder"]) if known else default_world()
        return {**head, "free_share": workshop_of(world).measures.free_share}

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
    def _name_is_the_robots(self) -> "TrainConfig":
        # That of a data set's folder is looked at when it is opened.
        if self.data_folder is None:
            model_name(self.data.world, self.robot_name)
        return self

    @model_validator(mode="after")
    def _networks_read_the_worlds_pictures(self) -> "TrainConfig":
        try:
            world = self.world
        except InputError:
            # The job tells when it opens or makes the data.
            return self
        grid = self.validity.grid
        if self.validity.steps and grid is None:
            world.levers(self.validity.points_per_link, self.validity.side_m)
        elif self.validity.steps and grid is not None:
            world.grid_arm(grid.groups)
        for section, gan in (("local", self.local), ("global", self.global_)):
            for part in ("generator_lookups", "critic_lookups"):
                _check_lookups(f"{section}.{part}", getattr(gan, part), world)
        if self.joint and world.sensor.extent_m is None:
            raise ValueError("global.encoder=joint reads pictures of a plane, not arrays of space")
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

    @model_validator(mode="after")
    def _starts_without_ids(self) -> "TrainConfig":
        if self.start_from and "projection" in (self.local.critic_condition, self.global_.critic_condition):
            raise ValueError(
                "start_from takes critic_condition=latent: projection knows scenarios by their place in data"
            )
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


def _check_lookups(key: str, lookups: LookupConfig, world: World) -> None:
    """Refuse look-ups that generators and critics of configurations do not have in a world's pictures."""
    if lookups.groups:
        raise ValueError(
            f"{key}.groups belongs to path models; those of configurations look along the links "
            "of a planar arm, by points_per_link"
        )
    if lookups.points_per_link:
        try:
            world.levers(lookups.points_per_link, lookups.side_m)
        except ConfigError as error:
            raise ValueError(f"{key}.points_per_link does not fit the robot: {error}") from error


def _world(data: DatasetConfig, folder: Path | None) -> World:
    """That of the data; what does not fit there the job tells when it opens or makes them."""
    try:
        return data.world if folder is None else Manifest.read(folder).world
    except InputError:
        return default_world()


def presets() -> list[str]:
    """Names of the presets that ship."""
    return named_presets(PRESET_FOLDER)
