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
from training.models.paths.settings import (
    DensityConfig,
    DistillationConfig,
    FlowConfig,
    PathGanConfig,
    PathVaeConfig,
    PointConfig,
)
from training.models.settings import LookupConfig
from training.section import AbsolutePath

PATH_PRESET_FOLDER = PRESET_FOLDER / "paths"

PathModel = Literal["density", "flow", "flow_distilled", "cvae", "wgan", "wgan_guided", "wgan_lookups"]
ALL_MODELS: tuple[PathModel, ...] = ("density", "flow", "flow_distilled", "cvae", "wgan", "wgan_lookups")


class PathTrainConfig(JobConfig):
    """Everything that fixes a job that trains path models."""

    preset: str = "paths"
    source: str = Field(
        "cspace-sampler@champion",
        description="a bundle's absolute folder or a registered version: its encoder and head are seen with",
    )
    data: PathDatasetConfig = PathDatasetConfig()
    points: int = Field(64, ge=2, description="of each path")
    models: tuple[PathModel, ...] = ALL_MODELS
    guides: AbsolutePath | None = Field(
        None, description="absolute: folder of a cluster-train job whose local critics guide"
    )
    sweep: int = Field(
        16, ge=1, description="samples from start to goal before the next begin at the start again"
    )
    density: DensityConfig = DensityConfig()
    flow: FlowConfig = FlowConfig()
    flow_distilled: DistillationConfig = DistillationConfig()
    cvae: PathVaeConfig = PathVaeConfig()
    wgan: PathGanConfig = PathGanConfig()
    wgan_guided: PathGanConfig = PathGanConfig(guide_weight=0.1)
    wgan_lookups: PathGanConfig = PathGanConfig(
        place=True,
        refinements=3,
        steps=600,
        lookups=LookupConfig(points_per_link=8, side_m=0.1, groups=32),
    )
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
        if "flow_distilled" in self.models and "flow" not in self.models:
            raise ValueError("flow_distilled needs flow among the models, for it learns from it")
        return self

    def points_of(self, name: PathModel) -> PointConfig:
        """Sizes and look-ups of a model that gives points."""
        if name == "flow_distilled":
            return self.flow_distilled.student_of(self.flow)
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
