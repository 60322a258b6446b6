"""What a generated data set is made of."""

import hashlib
import json
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, model_validator
from pydantic_core import CoreSchema

from cspace.errors import InputError
from cspace.world import Body, World
from cspace.worlds import default_world, examples, named_world, part_types, usual_world
from training.config_section import AbsolutePath, RobotName

# Counts on with every change of what worlds propose for labelling, and of how they are seen then.
_PROPOSALS = 4


@dataclass(frozen=True, slots=True)
class Shard:
    """A range of scenarios, or of pictures alone (``extra``)."""

    first: int
    count: int
    extra: bool = False

    @property
    def rows(self) -> slice:
        """Its place among all of its kind."""
        return slice(self.first, self.first + self.count)

    @property
    def file_name(self) -> str:
        """The shard's file within the unfinished data set."""
        return f"{'extra' if self.extra else 'scenes'}-{self.first:08d}-{self.count}.npz"


@dataclass(frozen=True, slots=True)
class _OfAnyKind:
    """A part of a world by the fields of its type."""

    part: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return handler.generate_schema(reduce(or_, part_types(self.part)))


class GeneratedConfig(BaseModel):
    """What fixes any generated data set."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    robot: Annotated[Body, _OfAnyKind("body")] = Field(
        default_world().body,
        description="its fields, an example's name, or the absolute path of a robot's file",
    )
    camera: Annotated[Any, _OfAnyKind("sensor")] | None = Field(
        None, exclude_if=lambda part: part is None, description="None: the usual one"
    )
    scenes: Annotated[Any, _OfAnyKind("scenes")] | None = Field(
        None, exclude_if=lambda part: part is None, description="a family, or given ones; None: the usual"
    )
    robot_name: RobotName = None
    split: Literal["train", "validation", "test", "demo"] = Field("train", description="whose scenes")
    seed: int = Field(0, ge=0, description="of the scenes and of what is sampled in them")
    shard_size: int = Field(500, ge=1, description="scenarios that one Ray task makes")

    @model_validator(mode="before")
    @classmethod
    def _robot_of_a_name_or_file(cls, values: Any) -> Any:
        if not isinstance(values, dict) or not isinstance(robot := values.get("robot"), str):
            return values
        # A job runs in another folder than it is submitted from.
        if robot not in examples() and not Path(robot).is_absolute():
            known = ", ".join(examples())
            raise ValueError(f"robot is one of {known}, an absolute path of a robot's file, or its fields")
        try:
            body = named_world(robot).body
        except InputError as error:
            raise ValueError(str(error)) from error
        return values | {"robot": body}

    @property
    def world(self) -> World:
        """Robot and sensor as the value that the rest of the code takes."""
        return usual_world(self.robot, sensor=self.camera, scenes=self.scenes)

    @property
    def key(self) -> str:
        """Twelve hex digits that change with every field that changes the data (not with their sharding)."""
        content = self.model_dump(mode="json", exclude={"shard_size", "robot_name"}) | self._versions()
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]

    def _versions(self) -> dict[str, int]:
        """Of what changes the data and is no setting."""
        return {}

    @property
    def folder_name(self) -> str:
        """A name for the data set's folder: its split and its key."""
        return f"{self.split}-{self.key}"


class DatasetConfig(GeneratedConfig):
    """Everything that fixes a generated data set of configurations."""

    scenario_count: int = Field(3000, ge=1, description="scenes with configurations")
    free_per_scenario: int = Field(300, ge=1, description="uniform free configurations")
    collision_per_scenario: int = Field(50, ge=0, description="uniform colliding configurations")
    proposals_per_scenario: int = Field(
        0,
        ge=0,
        exclude_if=lambda count: count == 0,
        description="configurations of all kinds that a head learns from, free or not, with their clearance; "
        "0: uniform ones, in the numbers of free_per_scenario and collision_per_scenario",
    )
    extra_image_count: int = Field(6000, ge=0, description="pictures without configurations")
    outcomes: AbsolutePath | None = Field(
        None,
        exclude_if=lambda folder: folder is None,
        description="absolute: a data set of python -m training.data import-outcomes, which the head of an "
        "arm in space learns from as well",
    )

    def _versions(self) -> dict[str, int]:
        return {"proposals": _PROPOSALS} if self.proposals_per_scenario else {}


# Of an arm in space, where no number is given: as in the preset panda_quick. One picture takes a megabyte.
USUAL_OF_ARMS = {
    "scenario_count": 600,
    "proposals_per_scenario": 384,
    "extra_image_count": 0,
    "shard_size": 25,
}


class PathDatasetConfig(GeneratedConfig):
    """Everything that fixes a generated data set of paths."""

    scenario_count: int = Field(4000, ge=1, description="scenes with paths")
    narrow_share: float = Field(
        0.5, ge=0, le=1, description="of scenarios, with a narrow passage on every path"
    )
    pairs_per_scenario: int = Field(8, ge=1, description="of start and goal, each with a path")
    points_per_path: int = Field(64, ge=2, description="at equal distances")
    free_per_scenario: int = Field(50, ge=1, description="free configurations that are stored")
    source: Literal["grid", "rrt_star"] = Field(
        "grid", description="grid: the world's own, near-optimal; rrt_star: OMPL's, as in the paper"
    )
    time_limit_s: float = Field(10.0, gt=0, description="of RRT* for each path")
    shard_size: int = Field(100, ge=1, description="scenarios that one Ray task makes")

    @property
    def narrow_count(self) -> int:
        """How many scenarios have a narrow passage; these come first."""
        return round(self.narrow_share * self.scenario_count)
