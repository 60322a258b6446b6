"""Scene files: a robot, how it is seen, its obstacles, start and goal, as YAML or JSON.

Errors name the file's line. :func:`schema` is a JSON Schema, for editors and for other programs.
"""

import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema

from cspace.errors import CspaceError, InputError, ScenarioError
from cspace.simulator import Problem
from cspace.strict_json import first_of, refused
from cspace.world import Scene, World
from cspace.worlds import FIRST, KINDS, named_world
from cspace.yaml_file import YamlDocument, read_yaml, read_yaml_file

_T = TypeVar("_T")


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
    document = read_yaml_file(path, ScenarioError)
    values = document.values
    if isinstance(values, dict) and str(values.get("robot")).endswith(".json"):
        place = str(path.parent / values["robot"])
        values["robot"] = _located(path, document, "robot", lambda: named_world(place)).body.to_dict()
    return _read(path, document)


def read_scene_text(data: bytes, path: Path, kinds: Sequence[str] = tuple(KINDS)) -> SceneFile:
    """Read what a scene file holds, UTF-8; ``path`` is what it is called in errors."""
    return _read(path, read_yaml(data, str(path), ScenarioError), kinds)


def _read(path: Path, document: YamlDocument, kinds: Sequence[str] = tuple(KINDS)) -> SceneFile:
    values = document.values
    kind = values.get("world", FIRST) if isinstance(values, Mapping) else FIRST
    if kind not in kinds:
        unknown = ScenarioError("the world is unknown", expected=" or ".join(kinds), got=repr(kind)[:200])
        raise _at(path, document, ("world",), unknown)
    try:
        parsed = _part(kind).Values.model_validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        refusal = refused(error, ScenarioError, "the file")
        raise _at(path, document, first_of(error)["loc"], refusal) from error
    world = _located(path, document, "robot", lambda: cast("World", _part(kind).read_world(parsed)))
    scene = _part(kind).read_scene(world, parsed) if "obstacles" in parsed.model_fields_set else None
    ends = [_end(path, document, world, getattr(parsed, name), name) for name in ("start", "goal")]
    return SceneFile(path, parsed.name or None, world, scene, *ends)


def given_scenes(world: World, files: Sequence[SceneFile]) -> Any:
    """The obstacles of files as the scenes of a world, some of them held out."""
    for one in files:
        if one.scene is None:
            raise ScenarioError(f"{one.path} holds no scene", expected="obstacles")
        if (one.world.body, one.world.sensor) != (world.body, world.sensor):
            raise ScenarioError(f"{one.path} has another robot or camera", expected=str(world.to_dict()))
    return _part(world.kind).given([one.scene for one in files])


def _end(
    path: Path, document: YamlDocument, world: World, angles: tuple[float, ...], name: str
) -> NDArray[np.float64] | None:
    if not angles:
        return None
    if len(angles) != (dim := world.dim):
        unfit = ScenarioError(f"{name} does not fit", expected=f"{dim} angles", got=str(len(angles)))
        raise _at(path, document, (name,), unfit)
    what = f"{name} lies outside the robot's limits"
    return _located(path, document, name, lambda: world.space.admitted(angles, what, ScenarioError))


def _located(path: Path, document: YamlDocument, part: str, read: Callable[[], _T]) -> _T:
    try:
        return read()
    except InputError as error:
        raise _at(path, document, (part,), error) from error


def _at(path: Path, document: YamlDocument, place: tuple[Hashable, ...], error: CspaceError) -> ScenarioError:
    what = f"{path}:{document.line(place)}: {error.what}"
    return ScenarioError(what, expected=error.expected, got=error.got, remedy=error.remedy)


def _part(kind: str) -> Any:
    return import_module(f"cspace.worlds.{kind}.scene_file")
