"""The spatial world's workshop: scenes, their depth pictures, checks and problems."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ScenarioError
from cspace.problem import UNIFORM, Problem
from cspace.splits import Split, scenario_rng
from cspace.workshop import Checker, Families, Measures, PathSearch, Proposals
from cspace.world import Image, Scene, World
from cspace.worlds.spatial.drawing import draw_arm, draw_obstacles, draw_seen
from cspace.worlds.spatial.obstacles.obstacle_rows import obstacles_of, rows_of
from cspace.worlds.spatial.obstacles.scenes import FAMILIES
from cspace.worlds.spatial.planning.collision import CollisionChecker, group_hits
from cspace.worlds.spatial.planning.problems import Ends, draw_problem
from cspace.worlds.spatial.planning.proposals import draw_proposals
from cspace.worlds.spatial.planning.ways import WayLimits, find_way
from cspace.worlds.spatial.scene import SpatialScene, draw_scene, scenes_of, seen
from cspace.worlds.spatial.seeing.view import write_view
from cspace.worlds.spatial.world import SpatialWorld

_NOTE = "A family is what stands about the arm; every problem has a way that was found in the scene as it is."


@dataclass(frozen=True, slots=True)
class SpatialWorkshop:
    """See :class:`cspace.workshop.Workshop`."""

    world: SpatialWorld

    @property
    def families(self) -> Families:
        """Scenes of all families, and each of them; all their problems have solutions."""
        names = (UNIFORM, *FAMILIES)
        return Families(names, names, "shelf", _NOTE, "tables, shelves, bins, cages and clutter")

    @property
    def measures(self) -> Measures:
        """Lengths as planners of seven joints have them; no thousand samples cover such a space.

        The free share is that of the Panda's uniform configurations among scenes for training.
        """
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
        """See :func:`cspace.worlds.spatial.scene.draw_scene`."""
        return draw_scene(rng, self.world, split, index)

    def scenes(self, split: Split, seed: int, count: int) -> Sequence[SpatialScene]:
        """See :meth:`scene`."""
        return [self.scene(scenario_rng(split, seed, index), split, index) for index in range(count)]

    def arrays_of(self, scene: Scene) -> dict[str, NDArray[Any]]:
        """See :func:`cspace.worlds.spatial.obstacles.obstacle_rows.rows_of`."""
        return dict(rows_of(_spatial(scene).obstacles))

    def render(self, scene: Scene) -> Image:
        """See :meth:`cspace.worlds.spatial.world.SpatialWorld.observed`."""
        return self.world.observed(_spatial(scene).view())

    def picture_file(self, scene: Scene) -> bytes:
        """See :mod:`cspace.worlds.spatial.seeing.view`."""
        return write_view(_spatial(scene).view())

    def checker(self, scene: Scene) -> Checker:
        """See :class:`cspace.worlds.spatial.planning.collision.CollisionChecker`."""
        found = _spatial(scene)
        return CollisionChecker(found.world.body, found.obstacles)

    def proposals(self, scene: Scene, rng: np.random.Generator, count: int) -> Proposals:
        """See :func:`cspace.worlds.spatial.planning.proposals.draw_proposals`."""
        found = _spatial(scene)
        start = None if found.state is None else np.asarray(found.state)
        checker = CollisionChecker(found.world.body, found.obstacles)
        return draw_proposals(checker, found.regions, start, rng, count)

    def group_hits(
        self, arrays: Mapping[str, NDArray[Any]], configurations: ArrayLike, groups: int
    ) -> NDArray[np.bool_]:
        """See :func:`cspace.worlds.spatial.planning.collision.group_hits`."""
        obstacles = obstacles_of(arrays["boxes"], arrays["cylinders"])
        return group_hits(self.world.body, obstacles, configurations, groups)

    def require(self, family: str) -> None:
        """Any of the families."""
        if family not in self.families.names:
            raise ScenarioError(
                "there is no such family",
                expected=f"one of {', '.join(self.families.names)}",
                got=repr(family),
            )

    def narrow_pairs(self, scene: Scene, configurations: NDArray[np.float64]) -> NDArray[np.int64]:
        """None: narrow passages of this world are not told on a grid."""
        del scene, configurations
        return np.empty((0, 2), dtype=np.int64)

    def ends(
        self, scene: Scene, free: NDArray[np.float64], rng: np.random.Generator, count: int
    ) -> Iterator[NDArray[np.float64]]:
        """See :meth:`cspace.worlds.spatial.planning.problems.Ends.pairs`; the arm sets out where it waits."""
        del free
        found = _spatial(scene)
        state = None if found.state is None else np.asarray(found.state)
        checker = CollisionChecker(found.world.body, found.obstacles)
        return Ends(checker, found.regions, rng).pairs(count, state)

    def path_search(self, scene: Scene) -> PathSearch:
        """See :func:`cspace.worlds.spatial.planning.ways.find_way`."""
        checker = cast("CollisionChecker", self.checker(scene))

        def search(start: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64] | None:
            return find_way(checker, start, goal, np.random.default_rng(0), WayLimits())

        return search

    def problem(self, family: str, split: Split, seed: int, index: int = 0) -> Problem:
        """See :func:`cspace.worlds.spatial.planning.problems.draw_problem`; the arm waits at the start."""
        self.require(family)
        named = None if family == UNIFORM else family
        found = draw_problem(self.world.body, scenes_of(self.world), split, seed, index, named)
        # A child of its own, beside that of the problem.
        rng = scenario_rng(split, seed, index).spawn(2)[1]
        scene = seen(rng, self.world, found.layout, found.start)
        return Problem(scene, found.start, found.goal, family, seed=seed, rejected=found.rejected)

    def obstruction(self, problem: Problem) -> str | None:
        """Start or goal in collision; whether a way is there nobody knows."""
        ends = np.stack([problem.start, problem.goal])
        clearance = self.checker(problem.scenario).clearance(ends)
        for name, clearance_m in zip(("start", "goal"), clearance, strict=True):
            if clearance_m <= 0.0:
                return f"the {name} is {-clearance_m:.3f} m deep in collision"
        return None

    def count(self, split: Split) -> int | None:
        """They are drawn without end."""
        del split
        return None

    def draw_picture(self, axes: Any, picture: Image) -> None:
        """See :func:`cspace.worlds.spatial.drawing.draw_seen`."""
        draw_seen(axes, picture, self.world.sensor.grid)

    def draw_scene(self, axes: Any, scene: Scene, colour: str) -> None:
        """Obstacles, from the side."""
        draw_obstacles(axes, _spatial(scene).obstacles, colour)

    def draw_robot(self, axes: Any, configuration: ArrayLike, colour: str, order: int) -> None:
        """Spheres, from the side."""
        draw_arm(axes, self.world.body, configuration, colour, order)


def open_workshop(world: World) -> SpatialWorkshop:
    """The workshop of a world of this kind."""
    return SpatialWorkshop(cast("SpatialWorld", world))


def _spatial(scene: Scene) -> SpatialScene:
    if not isinstance(scene, SpatialScene):
        raise ScenarioError(
            "the scene is of another world", expected="a spatial one", got=type(scene).__name__
        )
    return scene
