"""The planar world in a scene file: its values, and what they mean."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from cspace.errors import ScenarioError
from cspace.strict_json import validated
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera, Length, Place
from cspace.worlds.planar.scenes import MAX_DISCS, DiscScenes, GivenScenes
from cspace.worlds.planar.world import Disc, PlanarWorld, Scenario

_Configuration = Annotated[tuple[Place, ...], Field(min_length=1, description="rad")]


@validated(ScenarioError)
class _Robot(PlanarArm):
    link_lengths_m: Annotated[tuple[Length, ...], Field(min_length=1, max_length=64)]
    kind: Literal["planar_arm"] = "planar_arm"


@validated(ScenarioError)
class _Disc(Disc):
    shape: Literal["disc"] = "disc"


class Values(BaseModel):
    """What a file says; start, goal and name are empty where it does not name them."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, title="A scene file of the planar world")

    world: Literal["planar"] = "planar"
    name: Annotated[str, Field(pattern="^[a-z0-9]([a-z0-9-]{0,38}[a-z0-9])?$")] = ""
    robot: _Robot
    camera: Camera = Camera()
    scenes: DiscScenes = DiscScenes()
    obstacles: Annotated[tuple[_Disc, ...], Field(max_length=MAX_DISCS)] = ()
    start: _Configuration = ()
    goal: _Configuration = ()


def read_world(values: Values) -> PlanarWorld:
    """Robot, camera and family of scenes."""
    one = values.robot
    arm = PlanarArm(
        one.link_lengths_m, one.half_width_m, one.joint_limits_rad, self_collision=one.self_collision
    )
    return PlanarWorld(arm, values.camera, values.scenes)


def read_scene(world: PlanarWorld, values: Values) -> Scenario:
    """The obstacles about a world's robot."""
    discs = tuple(Disc(one.x_m, one.y_m, one.radius_m) for one in values.obstacles)
    return Scenario(world.body, discs, world.sensor)


def given(scenes: list[Scenario]) -> GivenScenes:
    """Scenes as those of a world; see :meth:`cspace.worlds.planar.scenes.GivenScenes.of`."""
    rows = [tuple((disc.x_m, disc.y_m, disc.radius_m) for disc in scene.discs) for scene in scenes]
    return GivenScenes.of(tuple(rows))
