"""What the configurations of all jobs have."""

from typing import ClassVar

from pydantic import Field

from cspace.dataset.manifest import Manifest
from cspace.world import World
from services.registry.tracking.parameters import flatten
from training.datasets.config import GeneratedConfig
from training.section import AbsolutePath, RobotName, Section

# Settings that tell which networks there are and what their weights fit, in whatever section they stand.
_SHAPING = {
    *("latent_dim", "width", "patches", "checkpoint", "count", "form", "cells", "hidden", "layers"),
    *("noise_dim", "means", "generator", "critic_condition", "critic_features", "critic_hidden"),
    *("critic_layers", "points_per_link", "side_m", "encoder", "place", "code_dim", "refinements", "ways"),
}


class JobConfig(Section):
    """What fixes any training job."""

    # Files of a job's folder without which no other job can start from it.
    KEPT: ClassVar[tuple[str, ...]] = ()

    preset: str
    seed: int = Field(0, ge=0)
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

    @property
    def world(self) -> World:
        """Robot and sensor of the data.

        Raises:
            InputError: the data do not fit.
        """
        return self.data.world if self.data_folder is None else Manifest.read(self.data_folder).world

    @property
    def shapes(self) -> dict[str, str]:
        """The settings that the networks' shapes follow from, as text by key."""
        return {
            key: value
            for key, value in flatten(self.to_dict()).items()
            if key.rpartition(".")[2] in _SHAPING and not key.startswith("data.")
        }
