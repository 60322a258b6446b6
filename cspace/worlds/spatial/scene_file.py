"""The spatial world in a scene file: its schema, and what the values mean."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cspace.errors import ScenarioError
from cspace.view_file import MAX_PICTURES
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import MAX_FIELD_DEG, MIN_FIELD_DEG, DepthCamera, looking
from cspace.worlds.spatial.obstacles import MAX_OBSTACLES, Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Pose, make_pose, pose_of, turned
from cspace.worlds.spatial.scenes import SpatialScene
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual

_LENGTH = {"type": "number", "exclusiveMinimum": 0}
_NUMBER = {"type": "number"}
# Where nothing is said of cameras, one stands to the right of what is before the robot.
_USUAL_CAMERA = {"at_m": [1.3, -0.8, 1.0], "look_at_m": [0.5, 0.0, 0.4]}
_USUAL_FIELD_DEG = 70.0


def _object(required: list[str], **properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _vector(words: str) -> dict[str, Any]:
    return {"type": "array", "items": _NUMBER, "minItems": 3, "maxItems": 3, "description": words}


_PLACE = {
    "at_m": _vector("x, y, z of the middle in the base frame, m"),
    "yaw_pitch_roll_deg": _vector("turns about z, then y, then x"),
}
_BOX = _object(["shape", "at_m", "size_m"], shape={"const": "box"}, size_m=_vector("sides, m"), **_PLACE)
_CYLINDER = _object(
    ["shape", "at_m", "radius_m", "height_m"],
    shape={"const": "cylinder"},
    radius_m=_LENGTH,
    height_m=_LENGTH,
    **_PLACE,
)
_CAMERA = _object(
    ["at_m", "look_at_m"],
    at_m=_vector("x, y, z, m"),
    look_at_m=_vector("x, y, z, m"),
    field_deg={"type": "number", "minimum": MIN_FIELD_DEG, "maximum": MAX_FIELD_DEG},
)
_CONFIGURATION = {"type": "array", "items": _NUMBER, "minItems": 1, "description": "rad"}

PROPERTIES: Mapping[str, Any] = {
    "robot": {
        "anyOf": [{"type": "string"}, {"type": "object"}],
        "description": "the name of an arm that ships, or what python -m training.robots import wrote",
    },
    "cameras": {"type": "array", "items": _CAMERA, "minItems": 1, "maxItems": MAX_PICTURES},
    "state": _CONFIGURATION,
    "obstacles": {"type": "array", "items": {"anyOf": [_BOX, _CYLINDER]}, "maxItems": MAX_OBSTACLES},
    "start": _CONFIGURATION,
    "goal": _CONFIGURATION,
}
REQUIRED = ("robot",)


def read_world(values: Mapping[str, Any]) -> SpatialWorld:
    """The robot of values that follow the schema, seen and standing as most are.

    Raises:
        ScenarioError: there is no such robot, or it cannot be.
    """
    robot = values["robot"]
    return usual(shipped(robot) if isinstance(robot, str) else SerialArm.from_dict(robot))


def read_scene(world: SpatialWorld, values: Mapping[str, Any]) -> SpatialScene:
    """Obstacles, cameras and the arm's state, of values that follow the schema; pictures are exact.

    The arm is where ``state`` says, else at the start, else in no picture.

    Raises:
        ScenarioError: a camera looks nowhere, or the state is none of the robot's.
    """
    views, state = world.sensor.views, values.get("state", values.get("start"))
    if state is not None:
        if len(state) != world.dim:
            raise ScenarioError(
                "the state does not fit the robot", expected=f"{world.dim} angles", got=str(state)
            )
        state = world.space.admitted(state, "the state does not fit the robot", ScenarioError).tolist()
    cameras = [
        DepthCamera.of_field(
            views.width,
            views.height,
            one.get("field_deg", _USUAL_FIELD_DEG),
            looking(one["at_m"], one["look_at_m"]),
        )
        for one in values.get("cameras", [_USUAL_CAMERA])
    ]
    obstacles = Obstacles.of(tuple(_shape(one) for one in values["obstacles"]))
    return SpatialScene(world, obstacles, tuple(cameras), None if state is None else tuple(state))


def given(scenes: list[SpatialScene]) -> None:
    """None: scenes of one's own are planned in, not learned from.

    Raises:
        ScenarioError: always.
    """
    raise ScenarioError(
        "scenes of this world are not learned from as files",
        expected="families of scenes, or recordings of your own",
        got=f"{len(scenes)} scene files",
    )


def _shape(values: Mapping[str, Any]) -> Box | Cylinder:
    pose = _pose(values)
    if values["shape"] == "box":
        x, y, z = (side / 2.0 for side in values["size_m"])
        return Box(pose, (x, y, z))
    return Cylinder(pose, values["radius_m"], values["height_m"] / 2.0)


def _pose(values: Mapping[str, Any]) -> Pose:
    yaw, pitch, roll = np.radians(values.get("yaw_pitch_roll_deg", (0.0, 0.0, 0.0)))
    return pose_of(make_pose(turned(float(yaw), float(pitch), float(roll)), values["at_m"]))
