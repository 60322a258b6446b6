"""The spatial world in a scene file: its values, and what they mean."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat

from cspace.errors import ScenarioError
from cspace.view_file import MAX_PICTURES
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import MAX_FIELD_DEG, MIN_FIELD_DEG, DepthCamera, looking
from cspace.worlds.spatial.obstacles import MAX_OBSTACLES, Box, Cylinder, Obstacles
from cspace.worlds.spatial.poses import Pose, make_pose, pose_of, turned, vector
from cspace.worlds.spatial.scenes import SpatialScene
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual

_Vector = Annotated[tuple[float, float, float], Field(description="x, y, z in the base frame, m")]
_Configuration = Annotated[tuple[float, ...], Field(min_length=1, description="rad")]


class _Values(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Placed(_Values):
    at_m: _Vector
    yaw_pitch_roll_deg: Annotated[
        tuple[float, float, float], Field(description="turns about z, then y, then x")
    ] = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        yaw, pitch, roll = np.radians(self.yaw_pitch_roll_deg)
        return pose_of(make_pose(turned(float(yaw), float(pitch), float(roll)), self.at_m))


class _Box(_Placed):
    shape: Literal["box"]
    size_m: Annotated[tuple[float, float, float], Field(description="sides, m")]

    def made(self) -> Box:
        return Box(self.pose, vector(side / 2.0 for side in self.size_m))


class _Cylinder(_Placed):
    shape: Literal["cylinder"]
    radius_m: PositiveFloat
    height_m: PositiveFloat

    def made(self) -> Cylinder:
        return Cylinder(self.pose, self.radius_m, self.height_m / 2.0)


class _Camera(_Values):
    at_m: _Vector
    look_at_m: _Vector
    field_deg: Annotated[float, Field(ge=MIN_FIELD_DEG, le=MAX_FIELD_DEG)] = 70.0


# Where nothing is said of cameras, one stands to the right of what is before the robot.
_USUAL_CAMERA = _Camera(at_m=(1.3, -0.8, 1.0), look_at_m=(0.5, 0.0, 0.4))


class Values(_Values):
    """What a file says; state, start, goal and name are empty where it does not name them."""

    model_config = ConfigDict(title="A scene file of the spatial world")

    world: Literal["spatial"]
    name: Annotated[str, Field(pattern="^[a-z0-9]([a-z0-9-]{0,38}[a-z0-9])?$")] = ""
    robot: Annotated[
        str | dict[str, Any],
        Field(
            description="the name of an arm that ships, or what python -m training.robots import wrote",
        ),
    ]
    cameras: Annotated[tuple[_Camera, ...], Field(min_length=1, max_length=MAX_PICTURES)] = (_USUAL_CAMERA,)
    state: _Configuration = ()
    obstacles: Annotated[
        tuple[Annotated[_Box | _Cylinder, Field(discriminator="shape")], ...],
        Field(max_length=MAX_OBSTACLES),
    ] = ()
    start: _Configuration = ()
    goal: _Configuration = ()


def read_world(values: Values) -> SpatialWorld:
    """The robot, seen and standing as most are."""
    robot = values.robot
    return usual(shipped(robot) if isinstance(robot, str) else SerialArm.from_dict(robot))


def read_scene(world: SpatialWorld, values: Values) -> SpatialScene:
    """Obstacles, cameras and the arm's state; pictures are exact.

    The arm is where ``state`` says, else at the start, else in no picture.
    """
    views, state = world.sensor.views, values.state or values.start
    if state:
        if len(state) != world.dim:
            raise ScenarioError(
                "the state does not fit the robot", expected=f"{world.dim} angles", got=str(state)
            )
        state = tuple(world.space.admitted(state, "the state does not fit the robot", ScenarioError).tolist())
    cameras = tuple(
        DepthCamera.of_field(views.width, views.height, one.field_deg, looking(one.at_m, one.look_at_m))
        for one in values.cameras
    )
    obstacles = Obstacles.of(one.made() for one in values.obstacles)
    return SpatialScene(world, obstacles, cameras, state or None)


def given(scenes: list[SpatialScene]) -> None:
    """None: scenes of one's own are planned in, not learned from."""
    raise ScenarioError(
        "scenes of this world are not learned from as files",
        expected="families of scenes, or recordings of your own",
        got=f"{len(scenes)} scene files",
    )
