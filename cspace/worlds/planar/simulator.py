"""The simulator of the planar world: scenarios of discs, their pictures and files, checks and problems."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, cast

import numpy as np
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field

from cspace.errors import ScenarioError
from cspace.files import encode_png, validated
from cspace.kernel_cache import njit
from cspace.simulator import (
    Checker,
    Families,
    Measures,
    PathSearch,
    Problem,
    Proposals,
    Simulator,
    Split,
    near_contact,
)
from cspace.world import Image, Scene
from cspace.worlds.planar.arm import PlanarArm
from cspace.worlds.planar.camera import Camera, Length, Place
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import (
    Family,
    PathFinder,
    apart,
    draw_problem,
    narrow_pairs,
    resolves_narrow,
)
from cspace.worlds.planar.world import MAX_DISCS, Disc, DiscScenes, GivenScenes, PlanarWorld, Scenario, Scenes

SUBSAMPLES = 8
WHITE = (255, 255, 255)
DISC_COLOUR = (255, 0, 0)
ARM_COLOUR = (0, 0, 255)


@njit(cache=True, nogil=True)
def _signed_distances(x, y, joints, half_width, discs):  # type: ignore[no-untyped-def]
    to_disc = np.inf
    for disc in range(discs.shape[0]):
        gap = np.hypot(x - discs[disc, 0], y - discs[disc, 1]) - discs[disc, 2]
        to_disc = min(to_disc, gap)
    to_arm = np.inf
    for link in range(joints.shape[0] - 1):
        dx, dy = joints[link + 1, 0] - joints[link, 0], joints[link + 1, 1] - joints[link, 1]
        px, py = x - joints[link, 0], y - joints[link, 1]
        along = min(1.0, max(0.0, (px * dx + py * dy) / (dx * dx + dy * dy)))
        to_arm = min(to_arm, np.hypot(px - along * dx, py - along * dy) - half_width)
    return to_disc, to_arm


@njit(cache=True, nogil=True)
def _shares(x0, y1, width, height, joints, half_width, discs):  # type: ignore[no-untyped-def]
    """Shares of one pixel that discs and arm cover, the discs over the arm."""
    to_disc, to_arm = _signed_distances(x0 + width / 2, y1 - height / 2, joints, half_width, discs)
    reach = np.hypot(width, height) / 2
    if to_disc <= -reach:
        return 1.0, 0.0
    if to_disc >= reach and (to_arm >= reach or to_arm <= -reach):
        return 0.0, 1.0 if to_arm < 0 else 0.0
    in_disc, in_arm = 0, 0
    for row in range(SUBSAMPLES):
        for column in range(SUBSAMPLES):
            x = x0 + (column + 0.5) * width / SUBSAMPLES
            y = y1 - (row + 0.5) * height / SUBSAMPLES
            to_disc, to_arm = _signed_distances(x, y, joints, half_width, discs)
            if to_disc <= 0:
                in_disc += 1
            elif to_arm <= 0:
                in_arm += 1
    return in_disc / SUBSAMPLES**2, in_arm / SUBSAMPLES**2


@njit(cache=True, nogil=True)
def _draw(pixels, x_min, x_max, y_min, y_max, joints, half_width, discs):  # type: ignore[no-untyped-def]
    out = np.empty((pixels, pixels, 3), dtype=np.uint8)
    width, height = (x_max - x_min) / pixels, (y_max - y_min) / pixels
    for row in range(pixels):
        for column in range(pixels):
            disc, arm = _shares(
                x_min + column * width, y_max - row * height, width, height, joints, half_width, discs
            )
            for channel in range(3):
                value = (
                    disc * DISC_COLOUR[channel]
                    + arm * ARM_COLOUR[channel]
                    + (1 - disc - arm) * WHITE[channel]
                )
                out[row, column, channel] = np.uint8(np.floor(value + 0.5))
    return out


def render(scenario: Scenario) -> NDArray[np.uint8]:
    """The picture, (P, P, 3) uint8: red discs over the blue arm at angle zero, white ground, y up."""
    camera, robot = scenario.camera, scenario.robot
    joints = robot.joint_positions_m(np.zeros((1, robot.dim)))[0]
    return np.asarray(_draw(camera.pixels, *camera.extent_m, joints, robot.half_width_m, scenario.disc_array))


_NOTE = (
    "Those of the family narrow have a passage whose middle is 0.03 to 0.08 rad from collision, those of "
    "disconnected a free space in parts."
)


@dataclass(frozen=True)
class PlanarSimulator(Simulator):
    """The planar world's: scenarios of discs, and what a grid of the joint space says of them."""

    world: PlanarWorld

    @property
    def families(self) -> Families:
        """Uniform and disconnected; narrow where the grid is as fine as its passages."""
        narrow = (Family.NARROW,) if resolves_narrow(self.world.body) else ()
        solvable = (Family.UNIFORM, *narrow)
        words = "unknown discs" if self.world.scenes is None else self.world.scenes.words
        return Families((*solvable, Family.DISCONNECTED), solvable, solvable[-1], _NOTE, words)

    @property
    def measures(self) -> Measures:
        """Measured with two links; margins are beyond the spread between training seeds."""
        return Measures(
            coverage_radius_rad=0.2,
            near_contact_m=0.1,
            range_rad=1.0,
            resolution_rad=0.0314,
            coverage_share=0.8,
            margins={"precision": 0.02, "coverage": 0.03, "edr": 0.1, "planning_success": 0.1},
            path_margins={"planning_success": 0.1, f"{self.families.decisive}_edge_checks_ratio": 1.0},
            free_share=0.69,
        )

    def scene(self, rng: np.random.Generator, split: Split, index: int) -> Scenario:
        discs = self._scenes.draw(rng, split, index)
        return Scenario.from_array(self.world.body, discs, self.world.sensor)

    def arrays_of(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """(D, 3) discs: x, y, radius in m; the last one again until they are as many as the world's most."""
        discs = cast("Scenario", scene).disc_array
        return {"discs": np.pad(discs, ((0, max(0, self._most - len(discs))), (0, 0)), mode="edge")}

    def render(self, scene: Scene) -> Image:
        return render(cast("Scenario", scene))

    def picture_file(self, scene: Scene) -> bytes:
        return encode_png(self.render(scene))

    def checker(self, scene: Scene) -> Checker:
        return CollisionChecker(cast("Scenario", scene))

    def proposals(self, scene: Scene, rng: np.random.Generator, count: int) -> Proposals:
        checker, anywhere = self.checker(scene), count - count // 2
        rows = (
            self.world.space.sample_uniform(rng, anywhere),
            near_contact(checker, rng, count // 2, self.measures.near_contact_m, 0.0),
        )
        return Proposals(
            np.concatenate(rows), np.repeat(np.arange(2, dtype=np.uint8), [len(r) for r in rows])
        )

    def narrow_pairs(self, scene: Scene, configurations: NDArray[np.float64]) -> NDArray[np.int64]:
        return narrow_pairs(cast("Scenario", scene), configurations)

    def ends(
        self, scene: Scene, free: NDArray[np.float64], rng: np.random.Generator, count: int
    ) -> NDArray[np.float64]:
        """Any two free configurations, (count, 2, d) rad."""
        del scene
        return free[rng.integers(len(free), size=(count, 2))]

    def path_search(self, scene: Scene) -> PathSearch:
        return PathFinder(cast("Scenario", scene)).path

    def problem(self, family: str, split: Split, seed: int, index: int = 0) -> Problem:
        self.require(family)
        found = draw_problem(Family(family), split, seed, index, self.world.body, self._scenes)
        scenario = replace(cast("Scenario", found.scenario), camera=self.world.sensor)
        return replace(found, scenario=scenario)

    def obstruction(self, problem: Problem) -> str | None:
        """See :func:`cspace.worlds.planar.problems.apart` beside what is known in any world."""
        ends = np.stack([problem.start, problem.goal])
        return super().obstruction(problem) or apart(cast("Scenario", problem.scenario), ends)

    def count(self, split: Split) -> int | None:
        return len(self._scenes.part(split)) if isinstance(self._scenes, GivenScenes) else None

    def draw_picture(self, axes: Any, picture: Image) -> None:
        axes.imshow(picture, extent=self.world.sensor.extent_m)
        axes.set(xlabel="x [m]", ylabel="y [m]")

    def draw_scene(self, axes: Any, scene: Scene, colour: str) -> None:
        scenario = cast("Scenario", scene)
        for x_m, y_m, radius_m in scenario.disc_array:
            axes.add_patch(Circle((x_m, y_m), radius_m, facecolor=colour, edgecolor="none", zorder=1))
        left, right, bottom, top = scenario.camera.extent_m
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x (m)", ylabel="y (m)")

    def draw_robot(self, axes: Any, configuration: ArrayLike, colour: str, order: int) -> None:
        arm, turn = self.world.body, np.linspace(-np.pi / 2.0, np.pi / 2.0, 12)
        for base, tip in pairwise(arm.joint_positions_m(configuration)[0]):
            heading = np.arctan2(tip[1] - base[1], tip[0] - base[0])
            cap = arm.half_width_m * np.stack([np.cos(heading + turn), np.sin(heading + turn)], axis=-1)
            outline = Polygon(np.concatenate([tip + cap, base - cap]), facecolor=colour, edgecolor="white")
            outline.set(linewidth=0.4, zorder=order)
            axes.add_patch(outline)

    def drawn_joints_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        return self.world.body.joint_positions_m(configurations)

    @property
    def _scenes(self) -> Scenes:
        if self.world.scenes is None:
            raise ScenarioError(
                "nobody knows where this world's scenes come from", remedy="name a data set that holds scenes"
            )
        return self.world.scenes

    @property
    def _most(self) -> int:
        scenes = self._scenes
        if isinstance(scenes, GivenScenes):
            return max(map(len, (*scenes.train, *scenes.held_out)))
        return scenes.count[1]


open_simulator = PlanarSimulator


_Configuration = Annotated[tuple[Place, ...], Field(min_length=1, description="rad")]


@validated(ScenarioError)
class _Robot(PlanarArm):
    link_lengths_m: Annotated[tuple[Length, ...], Field(min_length=1, max_length=64)]
    kind: Literal["planar_arm"] = "planar_arm"


class Values(BaseModel):
    """What a file says; start, goal and name are empty where it does not name them."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, title="A scene file of the planar world")

    world: Literal["planar"] = "planar"
    name: Annotated[str, Field(pattern="^[a-z0-9]([a-z0-9-]{0,38}[a-z0-9])?$")] = ""
    robot: _Robot
    camera: Camera = Camera()
    scenes: DiscScenes = DiscScenes()
    obstacles: Annotated[tuple[Disc, ...], Field(max_length=MAX_DISCS)] = ()
    start: _Configuration = ()
    goal: _Configuration = ()


def read_world(values: Values) -> PlanarWorld:
    """Robot, camera and family of scenes."""
    one = values.robot
    arm = PlanarArm(one.link_lengths_m, one.half_width_m, one.joint_limits_rad)
    return PlanarWorld(arm, values.camera, values.scenes)


def read_scene(world: PlanarWorld, values: Values) -> Scenario:
    """The obstacles about a world's robot."""
    return Scenario(world.body, values.obstacles, world.sensor)


def given(scenes: list[Scenario]) -> GivenScenes:
    """Scenes as those of a world; see :meth:`cspace.worlds.planar.world.GivenScenes.of`."""
    rows = [tuple((disc.x_m, disc.y_m, disc.radius_m) for disc in scene.discs) for scene in scenes]
    return GivenScenes.of(tuple(rows))
