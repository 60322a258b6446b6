"""Scene files: a robot, how it is seen, its obstacles, start and goal, as YAML or JSON.

Errors name the file's line. :func:`schema` is a JSON Schema, for editors and for other programs.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError, best_match
from numpy.typing import NDArray

from cspace.errors import ScenarioError
from cspace.simulator import Problem
from cspace.world import Scene, World
from cspace.worlds import FIRST, KINDS
from cspace.yaml_file import YamlDocument, read_yaml, read_yaml_file

# Letters of a wrong value in an error.
MAX_SHOWN = 200
_NAME = {"type": "string", "pattern": "^[a-z0-9]([a-z0-9-]{0,38}[a-z0-9])?$"}
_WORDS = {"exclusiveMinimum": "above", "minimum": "at least", "maximum": "at most", "required": "the keys"}
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """What a scene file says.

    Args:
        path: where it lies.
        name: of the robot, for the names of its models; None where it has none.
        world: robot and camera, and the family that scenes are drawn from.
        scene: the robot among the file's obstacles; None where it lists none.
        start: (d,) rad.
        goal: (d,) rad.
    """

    path: Path
    name: str | None
    world: World
    scene: Scene | None
    start: NDArray[np.float64] | None
    goal: NDArray[np.float64] | None

    def problem(self) -> Problem:
        """Start and goal in the scene.

        Raises:
            ScenarioError: the file lacks obstacles, start or goal.
        """
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
    part = _part(kind)
    return {
        "$schema": Draft202012Validator.META_SCHEMA["$id"],
        "title": f"A scene file of the {kind} world",
        "type": "object",
        "properties": {"world": {"enum": [kind]}, "name": _NAME, **part.PROPERTIES},
        "required": list(part.REQUIRED),
        "additionalProperties": False,
    }


def read_scene_file(path: Path) -> SceneFile:
    """Read a scene file.

    Raises:
        ScenarioError: it cannot be read, is no YAML, or a value does not fit; the line is named.
    """
    return _read(path, read_yaml_file(path, ScenarioError))


def read_scene_text(data: bytes, path: Path, kinds: Sequence[str] = tuple(KINDS)) -> SceneFile:
    """Read what a scene file holds.

    Args:
        data: UTF-8.
        path: what it is called in errors.
        kinds: of worlds that are read.

    Raises:
        ScenarioError: as :func:`read_scene_file`.
    """
    return _read(path, read_yaml(data, str(path), ScenarioError), kinds)


def _read(path: Path, document: YamlDocument, kinds: Sequence[str] = tuple(KINDS)) -> SceneFile:
    values = document.values
    kind = values.get("world", FIRST) if isinstance(values, Mapping) else FIRST
    if kind not in kinds:
        raise _at(
            path, document, ("world",), "the world is unknown", " or ".join(kinds), repr(kind)[:MAX_SHOWN]
        )
    errors = list(Draft202012Validator(schema(kind)).iter_errors(values))
    if errors:
        raise _unfit(path, document, next(filter(_unknown, errors), None) or best_match(errors))
    world = _told(path, document, "robot", lambda: cast("World", _part(kind).read_world(values)))
    scene = _part(kind).read_scene(world, values) if "obstacles" in values else None
    ends = [_end(path, document, world, values, name) for name in ("start", "goal")]
    return SceneFile(path, values.get("name"), world, scene, *ends)


def given_scenes(world: World, files: Sequence[SceneFile]) -> Any:
    """The obstacles of files as the scenes of a world, some of them held out.

    Raises:
        ScenarioError: a file has another robot or camera, or no obstacles.
    """
    for one in files:
        if one.scene is None:
            raise ScenarioError(f"{one.path} holds no scene", expected="obstacles")
        if (one.world.body, one.world.sensor) != (world.body, world.sensor):
            raise ScenarioError(f"{one.path} has another robot or camera", expected=str(world.to_dict()))
    return _part(world.kind).given([one.scene for one in files])


def _end(
    path: Path, document: YamlDocument, world: World, values: Mapping[str, Any], name: str
) -> NDArray[np.float64] | None:
    if name not in values:
        return None
    angles, space = np.array(values[name], dtype=np.float64), world.space
    if angles.shape != (world.dim,):
        raise _at(path, document, (name,), f"{name} does not fit", f"{world.dim} angles", f"{angles.size}")
    what = f"{name} lies outside the robot's limits"
    return _told(path, document, name, lambda: space.admitted(angles, what, ScenarioError))


def _unknown(error: ValidationError) -> list[str]:
    """Keys that the schema does not have."""
    if error.validator != "additionalProperties":
        return []
    instance = cast("Mapping[str, Any]", error.instance)
    return [key for key in instance if key not in _schema(error)["properties"]]


def _schema(error: ValidationError) -> dict[str, Any]:
    return cast("dict[str, Any]", error.schema)


def _unfit(path: Path, document: YamlDocument, error: ValidationError) -> ScenarioError:
    place, unknown = tuple(error.absolute_path), _unknown(error)
    name = ": ".join(map(str, place)) or "the file"
    if unknown:
        known = f"one of {', '.join(sorted(_schema(error)['properties']))}"
        return _at(path, document, (*place, unknown[0]), f"{name} has an unknown key", known, unknown[0])
    words = _WORDS.get(str(error.validator), str(error.validator))
    expected = _schema(error).get("description") or f"{words} {error.validator_value}"
    got = error.message if len(error.message) <= MAX_SHOWN else f"{error.message[:MAX_SHOWN]} ..."
    return _at(path, document, place, f"{name} does not fit", expected, got)


def _told(path: Path, document: YamlDocument, part: str, read: Callable[[], _T]) -> _T:
    try:
        return read()
    except ScenarioError as error:
        raise _at(path, document, (part,), error.what, error.expected, error.got, error.remedy) from error


def _at(
    path: Path,
    document: YamlDocument,
    place: tuple[Hashable, ...],
    what: str,
    expected: str | None,
    got: str | None,
    remedy: str | None = None,
) -> ScenarioError:
    where = f"{path}:{document.line(place)}"
    return ScenarioError(f"{where}: {what}", expected=expected, got=got, remedy=remedy)


def _part(kind: str) -> Any:
    return import_module(f"cspace.worlds.{kind}.scene_file")
