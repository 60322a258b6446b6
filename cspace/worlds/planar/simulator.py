"""The simulator of the planar world: scenarios of discs, their pictures, checks and problems."""

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.files import encode_png
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
from cspace.world import Image, Scene, World
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.problems import (
    Family,
    PathFinder,
    apart,
    draw_problem,
    narrow_pairs,
    require_resolution,
    resolves_narrow,
)
from cspace.worlds.planar.render import draw_arm, draw_discs, render
from cspace.worlds.planar.scenes import GivenScenes, Scenes
from cspace.worlds.planar.world import PlanarWorld, Scenario

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
        """Measured with two links; others have the same.

        A margin is about ten times the spread between training seeds for precision and coverage, twice for
        EDr, and six of sixty problems for planning success; the factor by which checks are saved is known to
        about a third.
        """
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
        """Discs about the arm."""
        discs = self._scenes.draw(rng, split, index)
        return Scenario.from_array(self.world.body, discs, self.world.sensor)

    def arrays_of(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """(D, 3) discs: x, y, radius in m; the last one again until they are as many as the world's most."""
        discs = cast("Scenario", scene).disc_array
        return {"discs": np.pad(discs, ((0, max(0, self._most - len(discs))), (0, 0)), mode="edge")}

    def render(self, scene: Scene) -> Image:
        """See :func:`cspace.worlds.planar.render.render`."""
        return render(cast("Scenario", scene))

    def picture_file(self, scene: Scene) -> bytes:
        """PNG."""
        return encode_png(self.render(scene))

    def checker(self, scene: Scene) -> Checker:
        """See :class:`cspace.worlds.planar.checks.CollisionChecker`."""
        return CollisionChecker(cast("Scenario", scene))

    def proposals(self, scene: Scene, rng: np.random.Generator, count: int) -> Proposals:
        """Half of them uniform, half near contact."""
        checker, anywhere = self.checker(scene), count - count // 2
        rows = (
            self.world.space.sample_uniform(rng, anywhere),
            near_contact(checker, rng, count // 2, self.measures.near_contact_m, 0.0),
        )
        return Proposals(
            np.concatenate(rows), np.repeat(np.arange(2, dtype=np.uint8), [len(r) for r in rows])
        )

    def require(self, family: str) -> None:
        """Also refuses narrow passages that are finer than the grid."""
        if family == Family.NARROW:
            require_resolution(self.world.body)
        super().require(family)

    def narrow_pairs(self, scene: Scene, configurations: NDArray[np.float64]) -> NDArray[np.int64]:
        """See :func:`cspace.worlds.planar.problems.narrow_pairs`."""
        return narrow_pairs(cast("Scenario", scene), configurations)

    def ends(
        self, scene: Scene, free: NDArray[np.float64], rng: np.random.Generator, count: int
    ) -> NDArray[np.float64]:
        """Any two free configurations, (count, 2, d) rad."""
        del scene
        return free[rng.integers(len(free), size=(count, 2))]

    def path_search(self, scene: Scene) -> PathSearch:
        """See :mod:`cspace.worlds.planar.problems`."""
        return PathFinder(cast("Scenario", scene)).path

    def problem(self, family: str, split: Split, seed: int, index: int = 0) -> Problem:
        """See :func:`cspace.worlds.planar.problems.draw_problem`."""
        self.require(family)
        found = draw_problem(Family(family), split, seed, index, self.world.body, self._scenes)
        scenario = replace(cast("Scenario", found.scenario), camera=self.world.sensor)
        return replace(found, scenario=scenario)

    def obstruction(self, problem: Problem) -> str | None:
        """See :func:`cspace.worlds.planar.problems.apart` beside what is known in any world."""
        ends = np.stack([problem.start, problem.goal])
        return super().obstruction(problem) or apart(cast("Scenario", problem.scenario), ends)

    def count(self, split: Split) -> int | None:
        """How many were given; a family has no end."""
        return len(self._scenes.part(split)) if isinstance(self._scenes, GivenScenes) else None

    def draw_picture(self, axes: Any, picture: Image) -> None:
        """As it is."""
        axes.imshow(picture, extent=self.world.sensor.extent_m)
        axes.set(xlabel="x [m]", ylabel="y [m]")

    def draw_scene(self, axes: Any, scene: Scene, colour: str) -> None:
        """Discs in the camera's frame."""
        draw_discs(axes, cast("Scenario", scene), colour)

    def draw_robot(self, axes: Any, configuration: ArrayLike, colour: str, order: int) -> None:
        """Links as capsules."""
        draw_arm(axes, self.world.body, configuration, colour, order)

    def drawn_joints_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """In the arm's plane."""
        return self.world.body.joint_positions_m(configurations)

    @property
    def _scenes(self) -> Scenes:
        if self.world.scenes is None:
            raise ScenarioError(
                "nobody knows where this world's scenes come from",
                expected="a family of scenes, or given ones",
                got="data of one's own, whose obstacles are not known",
                remedy="name a data set that holds scenes",
            )
        return self.world.scenes

    @property
    def _most(self) -> int:
        scenes = self._scenes
        if isinstance(scenes, GivenScenes):
            return max(map(len, (*scenes.train, *scenes.held_out)))
        return scenes.count[1]


def open_simulator(world: World) -> PlanarSimulator:
    """The simulator of a planar world."""
    return PlanarSimulator(cast("PlanarWorld", world))
