"""The typed configurations of the jobs: defaults here, presets and overrides on top, checked once."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from cspace.dataset import Manifest
from cspace.errors import ConfigError, InputError
from cspace.strict_json import refused
from cspace.world import World
from cspace.worlds import default_world, simulator_of
from cspace.yaml_file import read_yaml, read_yaml_file
from services.names import model_name
from services.registry.entities import ModelReference, flatten
from training.data.config import DatasetConfig, GeneratedConfig, PathDatasetConfig
from training.models.settings import (
    GanConfig,
    GateConfig,
    GlobalConfig,
    LookupConfig,
    PathGanConfig,
    VaeConfig,
    ValidityConfig,
)
from training.section import AbsolutePath, RobotName, Section


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    both = {key: _merged(base[key], changes[key]) for key in base if isinstance(changes.get(key), dict)}
    return base | changes | both


def _set(values: dict[str, Any], override: str) -> None:
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise ConfigError("an override does not fit", expected="key.sub=value", got=repr(override))
    *parents, last = key.split(".")
    for parent in parents:
        values = values.setdefault(parent, {})
        if not isinstance(values, dict):
            raise ConfigError(
                f"{key!r} is no section", expected="a section's name before the dot", got=parent
            )
    values[last] = read_yaml(text, f"the value of {key!r}", ConfigError)


# Settings that tell which networks there are and what their weights fit, in whatever section they stand.
_SHAPING = {
    *("latent_dim", "width", "patches", "checkpoint", "count", "form", "cells", "hidden", "layers"),
    *("noise_dim", "means", "generator", "critic_condition", "critic_features", "critic_hidden"),
    *("critic_layers", "points_per_link", "side_m", "encoder", "place", "code_dim", "refinements", "ways"),
}


class JobConfig(Section):
    """What fixes any training job."""

    SCRIPT: ClassVar[str]
    PRESETS: ClassVar[Path]

    preset: str
    seed: int = Field(0, ge=0, description="of everything that is drawn, except the data")
    data: GeneratedConfig = GeneratedConfig()
    data_folder: AbsolutePath | None = Field(
        None, description="absolute: an existing data set in the documented format"
    )
    robot_name: RobotName = None
    start_from: str | None = Field(
        None,
        min_length=1,
        exclude_if=lambda start: start is None,
        description="name@alias, name/version or a run's id: trials start from the weights of the job that "
        "made it",
    )

    @classmethod
    def presets(cls) -> list[str]:
        """Names of the presets that ship."""
        return sorted(path.stem for path in cls.PRESETS.glob("*.yaml"))

    @classmethod
    def load(cls, preset: str, overrides: Sequence[str] = ()) -> Self:
        """A preset with ``key.sub=value`` overrides, validated."""
        values = cls._read(preset)
        values["preset"] = preset
        for override in overrides:
            _set(values, override)
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            remedy = f"{cls.SCRIPT} --help lists presets, --print-config the keys"
            raise refused(error, ConfigError, f"the configuration {values.get('preset')}", remedy) from error

    @classmethod
    def _read(cls, preset: str) -> dict[str, Any]:
        """A preset's values, on top of those of the preset that it names as its ``base``."""
        path = cls.PRESETS / f"{preset}.yaml"
        if not path.is_file() or path.parent != cls.PRESETS:
            raise ConfigError("the preset is unknown", expected=", ".join(cls.presets()), got=repr(preset))
        values: dict[str, Any] = read_yaml_file(path, ConfigError) or {}
        base = values.pop("base", None)
        return values if base is None else _merged(cls._read(base), values)

    @property
    def world(self) -> World:
        """Robot and sensor of the data."""
        return self.data.world if self.data_folder is None else Manifest.read(self.data_folder).world

    @property
    def shapes(self) -> dict[str, str]:
        """The settings that the networks' shapes follow from, as text by key."""
        return {
            key: value
            for key, value in flatten(self.to_dict()).items()
            if key.rpartition(".")[2] in _SHAPING and not key.startswith("data.")
        }


# In a job's folder: centres of its cells, and the cluster of each.
CLUSTERS_FILE = "clusters.npz"
SCENE_MODEL = Path(__file__).parent / "pretrained" / "scene_model.safetensors"


class EncoderConfig(VaeConfig):
    """The picture's variational auto-encoder: trained, or taken from an earlier job."""

    checkpoint: AbsolutePath | None = Field(
        None, description="absolute: a VAE trial's final.ckpt whose encoder is taken; none is trained"
    )


class ClusterConfig(Section):
    """k-means over the configuration space, and what is made of the clusters."""

    count: int = Field(2, ge=1, description="trials that train side by side, one a cluster")
    form: Literal["guided", "mixture"] = Field(
        "guided",
        description="guided: the local critics guide a global generator, as in the paper; mixture: the local "
        "generators themselves, behind a gate",
    )


class CollisionBoundConfig(Section):
    """Bound on the collisions of samples that pass the threshold, on validation scenarios."""

    at_most: float = Field(
        0.04, gt=0, lt=1, description="share of what passes that may collide, as expected of a scene"
    )
    scenarios: int = Field(
        300, ge=30, description="a third chooses the threshold, one computes the bound, one measures it"
    )


class HeadConfig(ValidityConfig):
    """The validity head, and by what rules its bundle uses it."""

    scene_model: Literal["shipped"] | AbsolutePath | None = Field(
        None,
        exclude_if=lambda part: part is None,
        description="of arms in space: shipped, or the absolute path of what python -m training.scene_model "
        "wrote, instead of training a head; with data.outcomes it is trained further; none to train one",
    )
    threshold: float | None = Field(
        None, gt=0, lt=1, description="the confidence that the bundle recommends; none to choose it"
    )
    promise: CollisionBoundConfig | None = Field(
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

    @property
    def scene_model_file(self) -> Path | None:
        """Of the scene model; None where a head is trained."""
        return SCENE_MODEL if self.scene_model == "shipped" else self.scene_model


class ResourceConfig(Section):
    """What a trial gets from the cluster and how it survives faults."""

    cpus_per_trial: float = Field(1.0, gt=0, description="a trial computes on so many threads, at least one")
    gpus_per_trial: float = Field(0.0, ge=0, description="shares of a GPU can be given")
    memory_mb_per_trial: float = Field(
        0.0,
        ge=0,
        description="MiB that a node must have free for a trial, so that none is overfilled; 0 to ignore",
    )
    max_failures: int = Field(2, ge=0, description="after so many faults a trial fails, and with it the job")
    log_every_steps: int = Field(20, ge=1, description="steps between two points of a curve")
    checkpoint_every_steps: int = Field(250, ge=1, description="steps that a fault loses at most")

    @property
    def threads(self) -> int:
        """On which a trial computes."""
        return max(1, int(self.cpus_per_trial))

    def of_a_trial(self) -> dict[str, float]:
        """What a trial claims, as Tune's resources; memory in bytes."""
        claimed = {"cpu": self.cpus_per_trial, "gpu": self.gpus_per_trial}
        return claimed | ({"memory": self.memory_mb_per_trial * 2**20} if self.memory_mb_per_trial else {})


class TrainConfig(JobConfig):
    """Everything that fixes a training job."""

    SCRIPT = "cluster_train.py"
    PRESETS = Path(__file__).parent / "presets"

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
        return {**head, "free_share": simulator_of(world).measures.free_share}

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
        if self.data.outcomes is not None and (grid is None or not self.validity.steps):
            raise ValueError("data.outcomes is for heads of arms in space; it needs validity.grid and steps")
        if self.validity.scene_model is not None and grid is None:
            raise ValueError("validity.scene_model reads arrays of space; it needs validity.grid")
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


def _check_lookups(key: str, lookups: LookupConfig, world: World) -> None:
    """Refuse look-ups that generators and critics of configurations do not have in a world's pictures."""
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


PathModel = Literal["wgan", "wgan_guided"]


class PathTrainConfig(JobConfig):
    """Everything that fixes a job that trains path models."""

    SCRIPT = "path_train.py"
    PRESETS = TrainConfig.PRESETS / "paths"

    preset: str = "paths"
    source: str = Field(
        "cspace-sampler@champion",
        description="a bundle's absolute folder or a registered version: its encoder and head are seen with",
    )
    data: PathDatasetConfig = PathDatasetConfig()
    points: int = Field(64, ge=2, description="of each path")
    models: tuple[PathModel, ...] = ("wgan",)
    guides: AbsolutePath | None = Field(
        None, description="absolute: folder of a cluster-train job whose local critics guide"
    )
    wgan: PathGanConfig = PathGanConfig()
    wgan_guided: PathGanConfig = PathGanConfig(guide_weight=0.1)
    resources: ResourceConfig = ResourceConfig(log_every_steps=50, checkpoint_every_steps=500)

    @field_validator("source")
    @classmethod
    def _source_is_absolute_or_registered(cls, source: str) -> str:
        if not Path(source).is_absolute():
            ModelReference.parse_version(
                source,
                "source does not fit",
                "an absolute path of a bundle's folder, name@alias or name/version",
            )
        return source

    @model_validator(mode="after")
    def _models_have_what_they_need(self) -> "PathTrainConfig":
        if not self.models or len(set(self.models)) != len(self.models):
            raise ValueError("models names one or more, each once")
        if "wgan_guided" in self.models and self.guides is None:
            raise ValueError("wgan_guided needs guides: the folder of a job with local critics")
        return self

    def points_of(self, name: PathModel) -> PathGanConfig:
        """Settings of a model."""
        return self.wgan if name == "wgan" else self.wgan_guided
