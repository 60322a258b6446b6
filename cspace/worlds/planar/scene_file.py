"""The planar world in a scene file: its schema, and what the values mean."""

from collections.abc import Mapping
from typing import Any

from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.scenes import MAX_DISCS, DiscScenes, GivenScenes
from cspace.worlds.planar.world import DISC_RADIUS_M, Disc, PlanarWorld, Scenario

# Squares of lengths and places are numbers, too.
_FARTHEST = 1e6
_LENGTH = {"type": "number", "exclusiveMinimum": 0, "maximum": _FARTHEST}
_NUMBER = {"type": "number", "minimum": -_FARTHEST, "maximum": _FARTHEST}


def _pair(item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": item, "minItems": 2, "maxItems": 2}


def _object(required: list[str], **properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


_LIMIT = {"anyOf": [{"type": "null"}, _pair(_NUMBER)], "description": "low and high in rad; null: a circle"}
_ROBOT = _object(
    ["link_lengths_m"],
    kind={"const": "planar_arm"},
    link_lengths_m={"type": "array", "items": _LENGTH, "minItems": 1, "maxItems": 64},
    half_width_m=_LENGTH,
    joint_limits_rad={"anyOf": [{"type": "null"}, {"type": "array", "items": _LIMIT}]},
    self_collision={"type": "boolean", "description": "true or false"},
)
_CAMERA = _object(
    [],
    **dict.fromkeys(("x_min_m", "x_max_m", "y_min_m", "y_max_m"), _NUMBER),
    pixels={"type": "integer", "minimum": 16, "maximum": 2048},
)
_DISC = _object(["x_m", "y_m"], shape={"const": "disc"}, x_m=_NUMBER, y_m=_NUMBER, radius_m=_LENGTH)
_SCENES = _object(
    [],
    count=_pair({"type": "integer", "minimum": 1, "maximum": MAX_DISCS}),
    radius_m=_pair(_LENGTH),
    range_m=_LENGTH,
    base_clearance_m={"type": "number", "minimum": 0},
)
_CONFIGURATION = {"type": "array", "items": _NUMBER, "minItems": 1, "description": "rad"}

PROPERTIES: Mapping[str, Any] = {
    "robot": _ROBOT,
    "camera": _CAMERA,
    "obstacles": {"type": "array", "items": _DISC, "maxItems": MAX_DISCS},
    "scenes": _SCENES,
    "start": _CONFIGURATION,
    "goal": _CONFIGURATION,
}
REQUIRED = ("robot",)


def read_world(values: Mapping[str, Any]) -> PlanarWorld:
    """Robot, camera and family of scenes of values that follow the schema.

    Raises:
        ScenarioError: they cannot be, beyond what a schema says.
    """
    arm = PlanarArm.from_dict({"half_width_m": PlanarArm().half_width_m, **values["robot"]})
    family = {key: _tuple(value) for key, value in values.get("scenes", {}).items()}
    return PlanarWorld(arm, Camera(**values.get("camera", {})), DiscScenes(**family))


def read_scene(world: PlanarWorld, values: Mapping[str, Any]) -> Scenario:
    """The obstacles of values that follow the schema, about a world's robot."""
    discs = (Disc(one["x_m"], one["y_m"], one.get("radius_m", DISC_RADIUS_M)) for one in values["obstacles"])
    return Scenario(world.body, tuple(discs), world.sensor)


def given(scenes: list[Scenario]) -> GivenScenes:
    """Scenes as those of a world; see :meth:`cspace.worlds.planar.scenes.GivenScenes.of`."""
    rows = [tuple((disc.x_m, disc.y_m, disc.radius_m) for disc in scene.discs) for scene in scenes]
    return GivenScenes.of(tuple(rows))


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
