"""Scene files: a robot, how it is seen, its obstacles, start and goal, as YAML or JSON.

:func:`schema` is a JSON Schema, for editors and for other programs.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema

from cspace.errors import InputError, ScenarioError
from cspace.files import project_error, read_yaml_file
from cspace.simulator import Problem
from cspace.world import Scene, World
from cspace.worlds import FIRST, KINDS, named_world


@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """What a scene file says: start and goal (d,) rad, and a scene where it lists obstacles."""

    path: Path
    name: str | None
    world: World
    scene: Scene | None
    start: NDArray[np.float64] | None
    goal: NDArray[np.float64] | None

    def problem(self) -> Problem:
        """Start and goal in the scene."""
        if self.scene is None or self.start is None or self.goal is None:
            parts = {"obstacles": self.scene, "start": self.start, "goal": self.goal}
            raise ScenarioError(
                f"{self.path} holds no problem",
                expected="obstacles (an empty list for none), start and goal",
                got="no " + ", no ".join(name for name, part in parts.items() if part is None),
            )
        return Problem(self.scene, self.start, self.goal)


def schema(kind: str = FIRST) -> dict[str, Any]:
    """The JSON Schema of the scene files of a kind of world."""
    return {"$schema": GenerateJsonSchema.schema_dialect, **_part(kind).Values.model_json_schema()}


def read_scene_file(path: Path) -> SceneFile:
    """Read a scene file; ``robot`` may be the path of a robot's file, from the scene file's folder."""
    values = read_yaml_file(path, ScenarioError)
    with _naming(path):
        kind = values.get("world", FIRST) if isinstance(values, dict) else FIRST
        if kind not in KINDS:
            raise ScenarioError("the world is unknown", expected=" or ".join(KINDS), got=repr(kind)[:200])
        if isinstance(values, dict) and str(values.get("robot")).endswith(".json"):
            values["robot"] = named_world(str(path.parent / values["robot"])).body.to_dict()
        part = _part(kind)
        try:
            parsed = part.Values.model_validate_json(json.dumps(values, default=repr), strict=True)
        except ValidationError as error:
            raise project_error(error, ScenarioError, "the file") from error
        world: World = part.read_world(parsed)
        scene = part.read_scene(world, parsed) if "obstacles" in parsed.model_fields_set else None
        ends = [_end(world, getattr(parsed, name), name) for name in ("start", "goal")]
    return SceneFile(path, parsed.name or None, world, scene, *ends)


def given_scenes(world: World, files: Sequence[SceneFile]) -> Any:
    """The obstacles of files as the scenes of a world, some of them held out."""
    for one in files:
        if one.scene is None:
            raise ScenarioError(f"{one.path} holds no scene", expected="obstacles")
        if (one.world.body, one.world.sensor) != (world.body, world.sensor):
            raise ScenarioError(f"{one.path} has another robot or camera", expected=str(world.to_dict()))
    return _part(world.kind).given([one.scene for one in files])


def _end(world: World, angles: tuple[float, ...], name: str) -> NDArray[np.float64] | None:
    if not angles:
        return None
    if len(angles) != (dim := world.dim):
        raise ScenarioError(f"{name} does not fit", expected=f"{dim} angles", got=str(len(angles)))
    return world.space.admitted(angles, f"{name} lies outside the robot's limits", ScenarioError)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file's name before what is wrong with it."""
    try:
        yield
    except InputError as error:
        raise ScenarioError(
            f"{path}: {error.what}", expected=error.expected, got=error.got, remedy=error.remedy
        ) from error


def _part(kind: str) -> Any:
    return import_module(f"cspace.worlds.{kind}.simulator")
