"""The simulator of the spatial world: scenes, also from files, their depth pictures, checks and problems."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat
from scipy.spatial import ConvexHull

from cspace.errors import ScenarioError
from cspace.simulator import (
    UNIFORM,
    Families,
    Measures,
    PathSearch,
    Problem,
    Proposals,
    Simulator,
    Split,
    scenario_rng,
)
from cspace.view_file import MAX_PICTURES
from cspace.world import Image, Scene, World
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import MAX_FIELD_DEG, MIN_FIELD_DEG, DepthCamera, looking
from cspace.worlds.spatial.collision import CollisionChecker, group_hits
from cspace.worlds.spatial.furniture import FAMILIES
from cspace.worlds.spatial.obstacles import MAX_OBSTACLES, Box, Cylinder, Obstacles, obstacles_of, rows_of
from cspace.worlds.spatial.poses import Pose, make_pose, pose_of, turned, vector
from cspace.worlds.spatial.problems import Ends, PathLimits, draw_problem, draw_proposals, find_path
from cspace.worlds.spatial.scenes import SpatialScene, draw_scene, scenes_of, seen
from cspace.worlds.spatial.sensor import DISTANCE_STEP_M, FREE
from cspace.worlds.spatial.view import write_view
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual

# Which coordinates are across and up.
SIDE = (0, 2)
_ROUND = 24
_SURFACE = (0.77, 0.19, 0.19)


def _corners(shape: Box | Cylinder) -> NDArray[np.float64]:
    """(n, 3) m, whose hull is the shape's on any plane; of a cylinder's circles some points."""
    pose = np.asarray(shape.pose)
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
        own = signs * np.asarray(shape.half_m)
    else:
        angles = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
        circle = shape.radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = (-shape.half_length_m, shape.half_length_m)
        own = np.concatenate([np.column_stack([circle, np.full(_ROUND, end)]) for end in ends])
    return np.asarray(own @ pose[:3, :3].T + pose[:3, 3])


_NOTE = "A family is what stands about the arm; every problem has a path through the true scene."


@dataclass(frozen=True)
class SpatialSimulator(Simulator):
    """The spatial world's: obstacles about a serial arm, seen by depth cameras."""

    world: SpatialWorld

    @property
    def families(self) -> Families:
        """Scenes of all families, and each of them; all their problems have solutions."""
        names = (UNIFORM, *FAMILIES)
        return Families(names, names, "shelf", _NOTE, "tables, shelves, bins, cages and clutter")

    @property
    def measures(self) -> Measures:
        """Lengths as planners of seven joints have them; no thousand samples cover such a space."""
        return Measures(
            coverage_radius_rad=1.0,
            near_contact_m=0.02,
            range_rad=2.0,
            resolution_rad=0.02,
            coverage_share=None,
            margins={"precision": 0.02, "edr": 0.1, "planning_success": 0.1},
            path_margins={"planning_success": 0.1},
            free_share=0.6,
        )

    def scene(self, rng: np.random.Generator, split: Split, index: int) -> SpatialScene:
        return draw_scene(rng, self.world, split, index)

    def arrays_of(self, scene: Scene) -> dict[str, NDArray[Any]]:
        return dict(rows_of(cast("SpatialScene", scene).obstacles))

    def render(self, scene: Scene) -> Image:
        return self.world.observed(cast("SpatialScene", scene).view())

    def picture_file(self, scene: Scene) -> bytes:
        return write_view(cast("SpatialScene", scene).view())

    def checker(self, scene: Scene) -> CollisionChecker:
        found = cast("SpatialScene", scene)
        return CollisionChecker(found.world.body, found.obstacles)

    def proposals(self, scene: Scene, rng: np.random.Generator, count: int) -> Proposals:
        found = cast("SpatialScene", scene)
        start = None if found.state is None else np.asarray(found.state)
        return draw_proposals(self.checker(scene), found.regions, start, rng, count)

    def group_hits(
        self, arrays: Mapping[str, NDArray[Any]], configurations: ArrayLike, groups: int
    ) -> NDArray[np.bool_]:
        obstacles = obstacles_of(arrays["boxes"], arrays["cylinders"])
        return group_hits(self.world.body, obstacles, configurations, groups)

    def ends(
        self, scene: Scene, free: NDArray[np.float64], rng: np.random.Generator, count: int
    ) -> Iterator[NDArray[np.float64]]:
        """See :meth:`cspace.worlds.spatial.problems.Ends.pairs`; the arm sets out where it waits."""
        del free
        found = cast("SpatialScene", scene)
        state = None if found.state is None else np.asarray(found.state)
        return Ends(self.checker(scene), found.regions, rng).pairs(count, state)

    def path_search(self, scene: Scene) -> PathSearch:
        checker = self.checker(scene)

        def search(start: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64] | None:
            return find_path(checker, start, goal, np.random.default_rng(0), PathLimits())

        return search

    def problem(self, family: str, split: Split, seed: int, index: int = 0) -> Problem:
        """See :func:`cspace.worlds.spatial.problems.draw_problem`; the arm waits at the start."""
        self.require(family)
        named = None if family == UNIFORM else family
        found = draw_problem(self.world.body, scenes_of(self.world), split, seed, index, named)
        # A child of its own, beside that of the problem.
        rng = scenario_rng(split, seed, index).spawn(2)[1]
        scene = seen(rng, self.world, found.layout, found.start)
        return Problem(scene, found.start, found.goal, family, seed=seed, rejected=found.rejected)

    def draw_picture(self, axes: Any, picture: Image) -> None:
        """From the side: surfaces that are seen in red, grey as far as space is unseen."""
        grid = self.world.sensor.grid
        surface = picture[..., 0].min(axis=1) * DISTANCE_STEP_M < grid.voxel_m / 2.0
        unseen = (picture[..., 1] != FREE).mean(axis=1)
        shown = np.repeat(1.0 - 0.6 * unseen[..., None], 3, axis=2)
        shown[surface] = _SURFACE
        (left, _, low), (right, _, high) = grid.low_m, grid.high_m
        axes.imshow(shown.transpose(1, 0, 2), extent=(left, right, low, high), origin="lower")
        axes.set(xlabel="x [m]", ylabel="z [m]")

    def draw_scene(self, axes: Any, scene: Scene, colour: str) -> None:
        for one in cast("SpatialScene", scene).obstacles.shapes:
            corners = _corners(one)[:, SIDE]
            outline = corners[ConvexHull(corners).vertices]
            axes.fill(*outline.T, facecolor=colour, edgecolor="black", linewidth=0.4, alpha=0.35)
        axes.set(aspect="equal", xlabel="x [m]", ylabel="z [m]")

    def draw_robot(self, axes: Any, configuration: ArrayLike, colour: str, order: int) -> None:
        """The arm's spheres, and the line through its joints."""
        angles = np.linspace(0.0, 2.0 * np.pi, _ROUND)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        for sphere in self.world.body.spheres_at(configuration):
            outline = sphere[list(SIDE)] + sphere[3] * ring
            axes.fill(*outline.T, color=colour, alpha=0.15, linewidth=0, zorder=order)
        axes.plot(*self.drawn_joints_m(configuration)[0].T, color=colour, linewidth=1.2, zorder=order)

    def drawn_joints_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        return self.world.body.joint_positions_m(np.atleast_2d(configurations))[..., SIDE]


def open_simulator(world: World) -> SpatialSimulator:
    """The simulator of a world of this kind."""
    return SpatialSimulator(cast("SpatialWorld", world))


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
    """Obstacles, cameras and the arm at the state, else at the start, else in no picture; without noise."""
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
        "scenes of this world are not learned from as files", got=f"{len(scenes)} scene files"
    )
