"""The typed configurations of the jobs: defaults here, presets and overrides on top, checked once."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from cspace.dataset import Manifest
from cspace.errors import ConfigError, InputError
from cspace.files import project_error, read_yaml, read_yaml_file
from cspace.world import World
from services.names import model_name
from services.registry.entities import ModelReference
from training.config_section import AbsolutePath, RobotName, Section
from training.data.config import DatasetConfig, GeneratedConfig, PathDatasetConfig


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A preset's values on top of another's; null takes a key away."""
    both = {key: _merged(base[key], changes[key]) for key in base if isinstance(changes.get(key), dict)}
    return {key: value for key, value in (base | changes | both).items() if changes.get(key, 0) is not None}


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


class JobConfig(Section):
    """What fixes any training job."""

    SCRIPT: ClassVar[str]
    PRESETS: ClassVar[Path]

    preset: str = Field(description="settings that the job starts from")
    seed: int = Field(0, ge=0, description="of everything that is drawn, except the data")
    data: GeneratedConfig = GeneratedConfig()
    data_folder: AbsolutePath | None = Field(
        None, description="absolute: an existing data set in the documented format"
    )
    robot_name: RobotName = None

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
            return cls.from_dict(values)
        except ValidationError as error:
            remedy = f"{cls.SCRIPT} --help lists presets, --print-config the keys"
            raise project_error(
                error, ConfigError, f"the configuration {values.get('preset')}", remedy
            ) from error

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The configuration of values as of :meth:`to_dict`, validated."""
        return cls.model_validate(values)

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


# In a job's folder: centres of its cells, and the cluster of each.
CLUSTERS_FILE = "clusters.npz"
SCENE_MODEL = Path(__file__).parent / "pretrained" / "scene_model.safetensors"


class TrialSettings(Section):
    """A section by which one kind of trial is trained."""

    steps: int = Field(1000, ge=0, description="optimiser steps")


class VaeConfig(TrialSettings):
    """The picture's variational auto-encoder: trained, or taken from an earlier job."""

    checkpoint: AbsolutePath | None = Field(
        None, description="absolute: a VAE trial's final.ckpt whose encoder is taken; none is trained"
    )
    latent_dim: int = Field(64, ge=1, description="numbers that a picture is encoded by")
    width: int = Field(16, ge=1, description="channels of the first convolution")
    patches: Literal[1, 4] = Field(4, description="of a flat picture that share their convolutions")
    steps: int = Field(400, ge=1, description="optimiser steps")
    batch_size: int = Field(64, ge=2, description="pictures a step")
    learning_rate: float = Field(2e-3, gt=0, description="highest of the one-cycle schedule")


class ClusterConfig(Section):
    """k-means over the configuration space, and what is made of the clusters."""

    count: int = Field(2, ge=1, description="trials that train side by side, one a cluster")
    form: str = Field(
        "guided",
        description="the model family. guided: local critics guide a global generator, as in the paper; "
        "mixture: the local generators themselves, behind a gate; wgan_gp: one generator; joint: one "
        "generator, and the encoder trained with it",
    )


class CollisionBoundConfig(Section):
    """Bound on the collisions of samples that pass the threshold, on validation scenarios."""

    at_most: float = Field(
        0.04, gt=0, lt=1, description="share of what passes that may collide, as expected of a scene"
    )
    scenarios: int = Field(
        300, ge=30, description="a third chooses the threshold, one computes the bound, one measures it"
    )


class GridConfig(Section):
    """What a head that reads arrays of space has beside the sizes of others."""

    groups: int = Field(
        64, ge=1, description="of the arm's spheres, base included, whose hazards are predicted"
    )
    finest: int = Field(
        0,
        ge=0,
        multiple_of=4,
        description="channels of features in voxels of 5 cm; 0: those of 10 cm are read",
    )
    width: int = Field(20, ge=4, multiple_of=4, description="channels of features in voxels of 10 cm")
    middle: int = Field(40, ge=4, multiple_of=4, description="channels in voxels of 20 cm")
    deep: int = Field(64, ge=4, multiple_of=4, description="channels in voxels of 40 cm")
    hazard_weight: float = Field(1.0, ge=0, description="of the groups' cross entropy, where truth is known")
    gradient_clip: float = Field(1.0, gt=0, description="largest norm of the gradient")


class ValidityConfig(TrialSettings):
    """The validity head: an occupancy network that reads the picture where the arm would be."""

    steps: int = Field(3000, ge=0, description="0 leaves the bundle without a head")
    pictures_per_step: int = Field(32, ge=1, description="scenarios of a batch")
    configurations_per_picture: int = Field(64, ge=2, description="of each scenario of a batch")
    points_per_link: int = Field(12, ge=2, description="look-ups along each link, both ends included")
    side_m: float = Field(0.1, ge=0, description="distance of the look-ups beside each link")
    grid: GridConfig | None = Field(
        None,
        exclude_if=lambda part: part is None,
        description="of a head that reads arrays of space at an arm's spheres; none: pictures along links",
    )
    hidden: int = Field(160, ge=1, description="units of a layer")
    layers: int = Field(2, ge=1, description="hidden layers")
    learning_rate: float = Field(4e-3, gt=0, description="highest of the one-cycle schedule")


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
    """What fixes a training job of any model family; each adds sections of its own."""

    SCRIPT = "cluster_train.py"
    PRESETS = Path(__file__).parent / "presets"
    # Whether the encoder is trained with the generator.
    trains_encoder: ClassVar[bool] = False

    preset: str = Field("quickstart", description="settings that the job starts from")
    data: DatasetConfig = DatasetConfig()
    vae: VaeConfig = VaeConfig()
    clusters: ClusterConfig = ClusterConfig()
    validity: HeadConfig = HeadConfig()
    resources: ResourceConfig = ResourceConfig()

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """The configuration of the family that ``clusters.form`` names, validated."""
        clusters = values.get("clusters")
        form = clusters.get("form", "guided") if isinstance(clusters, dict) else "guided"
        # Families are found by their names; each is imported with its networks, and imports this module.
        found = import_module("training.models.families").family(form)
        made: Self = found.configuration.model_validate(values)
        return made

    @property
    def reads_pictures(self) -> bool:
        """Whether trials on configurations read the pictures beside their latents."""
        return False

    @property
    def cells(self) -> int:
        """Into how many cells the configuration space is divided, which are grouped into clusters."""
        return self.clusters.count

    @property
    def cell_points(self) -> int:
        """How many configurations are stored in each cell."""
        return 0

    @property
    def known_world(self) -> World | None:
        """Robot and sensor; None where the data tell when they are opened or made what does not fit."""
        try:
            return self.world
        except InputError:
            return None

    @model_validator(mode="after")
    def _name_is_the_robots(self) -> Self:
        # That of a data set's folder is looked at when it is opened.
        if self.data_folder is None:
            model_name(self.data.world, self.robot_name)
        return self

    @model_validator(mode="after")
    def _head_reads_the_worlds_pictures(self) -> Self:
        world, grid = self.known_world, self.validity.grid
        if world is None:
            return self
        if self.data.outcomes is not None and (grid is None or not self.validity.steps):
            raise ValueError("data.outcomes is for heads of arms in space; it needs validity.grid and steps")
        if self.validity.scene_model is not None and grid is None:
            raise ValueError("validity.scene_model reads arrays of space; it needs validity.grid")
        if self.validity.steps and grid is None:
            world.link_sample_points(self.validity.points_per_link, self.validity.side_m)
        elif self.validity.steps and grid is not None:
            world.grid_arm(grid.groups)
        return self


class AdversarialConfig(TrialSettings):
    """What any WGAN-GP is trained by."""

    layers: int = Field(3, ge=1, description="hidden layers of the generator")
    noise_dim: int = Field(2, ge=1, description="numbers of explicit noise")
    critic_layers: int = Field(3, ge=2, description="hidden layers of the critic")
    penalty: Literal["one_sided", "two_sided"] = Field(
        "one_sided", description="form of the gradient penalty"
    )
    penalty_weight: float = Field(10.0, ge=0, description="lambda of the gradient penalty")
    critic_steps: int = Field(4, ge=1, description="critic steps before each generator step")
    critic_learning_rate: float = Field(2e-3, gt=0, description="Adam's, of the critic")
    betas: tuple[float, float] = Field((0.0, 0.9), description="Adam's")
    batch_size: int = Field(512, ge=2, description="of real samples a step")
    steps: int = Field(1000, ge=1, description="generator steps")


class PathGanConfig(AdversarialConfig):
    """A WGAN-GP whose condition is latent, start and goal (MultiWGAN-GP paper, section 4)."""

    hidden: int = Field(256, ge=1, description="units of the generator's layers")
    critic_hidden: int = Field(256, ge=1, description="units of the critic's layers")
    steps: int = Field(1500, ge=1, description="generator steps")
    learning_rate: float = Field(1e-3, gt=0, description="Adam's, of the generator")


class PathTrainConfig(JobConfig):
    """Everything that fixes a job that trains a path model."""

    SCRIPT = "path_train.py"
    PRESETS = TrainConfig.PRESETS / "paths"

    preset: str = Field("paths", description="settings that the job starts from")
    source: str = Field(
        "cspace-sampler@champion",
        description="a bundle's absolute folder or a registered version: its encoder and head are seen with",
    )
    data: PathDatasetConfig = PathDatasetConfig()
    points: int = Field(64, ge=2, description="of each path")
    wgan: PathGanConfig = PathGanConfig()
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
