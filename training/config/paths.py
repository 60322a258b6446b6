"""The typed configuration of a job that trains path models: defaults here, presets only override them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from services.registry.references import ModelReference
from training.config.clusters import PRESET_FOLDER, ResourceConfig
from training.config.files import load_values, named_presets, validated
from training.config.job import JobConfig
from training.datasets.config import PathDatasetConfig
from training.models.paths.settings import FlowConfig, PathGanConfig, PointConfig
from training.section import AbsolutePath

PATH_PRESET_FOLDER = PRESET_FOLDER / "paths"

PathModel = Literal["flow", "wgan", "wgan_guided"]
UNGUIDED: tuple[PathModel, ...] = ("flow", "wgan")


class PathTrainConfig(JobConfig):
    """Everything that fixes a job that trains path models."""

    preset: str = "paths"
    source: str = Field(
        "cspace-sampler@champion",
        description="a bundle's absolute folder or a registered version: its encoder and head are seen with",
    )
    data: PathDatasetConfig = PathDatasetConfig()
    points: int = Field(64, ge=2, description="of each path")
    models: tuple[PathModel, ...] = UNGUIDED
    guides: AbsolutePath | None = Field(
        None, description="absolute: folder of a cluster-train job whose local critics guide"
    )
    sweep: int = Field(
        16, ge=1, description="samples from start to goal before the next begin at the start again"
    )
    flow: FlowConfig = FlowConfig()
    wgan: PathGanConfig = PathGanConfig()
    wgan_guided: PathGanConfig = PathGanConfig(guide_weight=0.1)
    resources: ResourceConfig = ResourceConfig(log_every_steps=50, checkpoint_every_steps=500)

    @field_validator("source")
    @classmethod
    def _source_is_absolute_or_registered(cls, source: str) -> str:
        if not Path(source).is_absolute():
            ModelReference.parse_version(
                source, "no source", "an absolute path of a bundle's folder, name@alias or name/version"
            )
        return source

    @model_validator(mode="after")
    def _models_have_what_they_need(self) -> "PathTrainConfig":
        if not self.models or len(set(self.models)) != len(self.models):
            raise ValueError("models names one or more, each once")
        if "wgan_guided" in self.models and self.guides is None:
            raise ValueError("wgan_guided needs guides: the folder of a job with local critics")
        return self

    def points_of(self, name: PathModel) -> PointConfig:
        """Sizes and look-ups of a model that gives points."""
        found: PointConfig = getattr(self, name)
        return found


def load_path_config(preset: str, overrides: Sequence[str] = ()) -> PathTrainConfig:
    """A preset with ``key.sub=value`` overrides, validated.

    Raises:
        ConfigError: an unknown preset or key, or a value of the wrong type or range.
    """
    values = load_values(PATH_PRESET_FOLDER, preset, overrides)
    return validated(PathTrainConfig, values, "path_train.py")


def path_presets() -> list[str]:
    """Names of the presets that ship."""
    return named_presets(PATH_PRESET_FOLDER)
