"""The planning problem that a person changes, and what the API answers about it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from cspace.query import DOUBTED
from cspace.simulator import UNIFORM, Split
from cspace.world import World
from cspace.worlds import simulator_of
from cspace_client import DepthPictures, FoundPlan, PlanQuery, SamplingClient

Floats = NDArray[np.float64]
# For the shipped model: a collision-free plan, and a refused one.
EXAMPLES = {"table-top": ("table", 4), "hard bin": ("bin", 17)}
CHECK_RAD, POINTS_AT_MOST = 0.005, 8000


class Samples(NamedTuple):
    """Samples (n, d) rad, and whether each is free in the true scene."""

    rows: Floats
    confidence: NDArray[np.float32]
    free: NDArray[np.bool_]
    novelty: float | None
    unseen: float | None


class SceneState:
    """A planning problem for a model's arm."""

    def __init__(self, api: SamplingClient, world: World, model: str) -> None:
        self.api, self.world, self.model = api, world, model
        self.simulator, self.arm = simulator_of(world), cast("Any", world).body
        self.families = tuple(name for name in self.simulator.families.names if name != UNIFORM)
        family, seed = EXAMPLES["table-top"]
        self.problem = self.simulator.problem(family, Split.DEMO, seed)

    @property
    def scene(self) -> Any:
        """Obstacles, cameras and the arm's state."""
        return self.problem.scenario

    def draw(self, family: str, seed: int) -> None:
        """Takes the problem of a family and a seed."""
        self.problem = self.simulator.problem(family, Split.DEMO, seed)

    def change(self, **parts: Any) -> None:
        """Replaces ``obstacles``, ``cameras`` or ``state`` of the scene."""
        self.problem = replace(self.problem, scenario=replace(self.scene, **parts))

    def move(self, kind: str, at: int, pose: Floats) -> None:
        """Moves one of the ``boxes``, ``cylinders`` or ``cameras`` to a pose (4, 4)."""
        obstacles = self.scene.obstacles
        shapes = list(self.scene.cameras if kind == "cameras" else getattr(obstacles, kind))
        shapes[at] = replace(shapes[at], pose=pose)
        moved = {kind: tuple(shapes)}
        self.change(**(moved if kind == "cameras" else {"obstacles": replace(obstacles, **moved)}))

    def set_end(self, name: str, configuration: Sequence[float]) -> None:
        """Sets ``start`` or ``goal``, rad; the arm stands at the start while it is pictured."""
        ends: dict[str, Any] = {name: np.asarray(configuration)}
        self.problem = replace(self.problem, **ends)
        if name == "start":
            self.change(state=tuple(configuration))

    def pictures(self) -> DepthPictures:
        """What the cameras see, as the API takes it."""
        view, fields = self.scene.view(), ("fx", "fy", "cx", "cy", "pose")
        cameras = [{name: one.to_dict()[name] for name in fields} for one in view.cameras]
        return DepthPictures(view.pictures, cameras, view.state)

    def points_m(self) -> Floats:
        """What the cameras read, (N, 3) m in the base frame, thinned out."""
        view = self.scene.view()
        clouds = [
            camera.points_m(depth / 1000.0).reshape(-1, 3)[(depth > 0).reshape(-1)]
            for camera, depth in zip(view.cameras, view.pictures, strict=True)
        ]
        points = np.concatenate(clouds)
        return points[:: max(1, len(points) // POINTS_AT_MOST)]

    def expected(self) -> tuple[Floats, NDArray[np.float32], float]:
        """Centres (N, 3) m of cells that careful paths avoid, how likely each is filled, a cell's side."""
        found = self.api.belief(self.pictures(), self.model)
        return found.centres_m(DOUBTED), found.cells[found.cells >= DOUBTED], found.cell_m

    def sample(self, count: int, seed: int = 0) -> Samples:
        """Unfiltered samples with their confidence and the scene's own verdict."""
        shown = self.pictures()
        batch = self.api.sample(shown, count, seed, model=self.model, min_confidence=0.0)
        rows = np.asarray(batch.samples, dtype=np.float64)
        scored = self.api.validity(shown, rows, self.model)
        unseen = None if scored.unseen is None else float(np.mean(scored.unseen))
        free = self.simulator.checker(self.scene).valid_batch(rows)
        return Samples(rows, scored.confidence, free, batch.novelty, unseen)

    def plan(self, min_confidence: float, seed: int = 0) -> tuple[FoundPlan, str]:
        """A plan from start to goal, and what the scene's own obstacles say of it."""
        start, goal = self.problem.start.tolist(), self.problem.goal.tolist()
        query = PlanQuery(start=start, goal=goal, seed=seed, min_confidence=min_confidence, explain=True)
        found = self.api.plan(self.pictures(), query, self.model)
        path = found.path
        if len(path) < 2:
            return found, f"{found.status}: {found.reason}"
        hits = int(self.blocked(path).sum())
        truth = "collision-free" if hits == 0 else f"in collision on {hits} of {len(path) - 1} edges"
        return found, f"Confidence {found.confidence:.0%}. In the true scene the path is {truth}."

    def blocked(self, path: Floats) -> NDArray[np.bool_]:
        """Which edges (M - 1,) of a path (M, d) collide in the true scene."""
        return ~self.simulator.checker(self.scene).edge_batch(path[:-1], path[1:], CHECK_RAD)
