"""What the 3D viewer asks the API for, and what it makes of the answers."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cspace.worlds import examples, simulator_of
from cspace_client import DepthPictures
from services.planner.viewer_state import SceneState

WORLD = examples()["panda"]


class FakeApi:
    """Answers with what it is given, and remembers the pictures."""

    def __init__(self) -> None:
        self.shown: list[DepthPictures] = []
        self.rows = WORLD.space.sample_uniform(np.random.default_rng(0), 20)
        self.path = np.empty((0, 7))

    def sample(self, picture: DepthPictures, n: int, seed: int, **options: Any) -> Any:
        assert options == {"model": "m", "min_confidence": 0.0}
        self.shown.append(picture)
        return SimpleNamespace(samples=self.rows[:n], novelty=0.25)

    def validity(self, picture: DepthPictures, configurations: Any, model: str) -> Any:
        return SimpleNamespace(confidence=np.full(len(configurations), 0.5), unseen=None)

    def plan(self, picture: DepthPictures, query: Any, model: str) -> Any:
        solved = len(self.path) > 0
        assert query.explain
        status, reason = ("solved", None) if solved else ("refused", "none is sure enough")
        return SimpleNamespace(path=self.path, confidence=0.75, status=status, reason=reason)


@pytest.fixture
def api() -> FakeApi:
    return FakeApi()


@pytest.fixture
def state(api: FakeApi) -> SceneState:
    return SceneState(api, WORLD, "m")


def test_samples_are_checked_against_the_scenes_own_obstacles(api: FakeApi, state: SceneState) -> None:
    found = state.sample(20)
    assert (found.free == simulator_of(WORLD).checker(state.scene).valid_batch(api.rows)).all()
    assert (found.novelty, found.unseen) == (0.25, None)


def test_a_path_through_an_obstacle_is_called_in_collision(api: FakeApi, state: SceneState) -> None:
    free = api.rows[state.sample(20).free]
    api.path = np.stack([free[0], free[0]])
    assert "collision-free" in state.plan(0.5)[1]
    blocked = api.rows[~state.sample(20).free]
    api.path = np.stack([free[0], blocked[0]])
    assert "in collision on 1 of 1 edges" in state.plan(0.5)[1]
    # Where along it, by its parts.
    parts = np.linspace(free[0], blocked[0], 50)
    marked = state.blocked(parts)
    collides = ~simulator_of(WORLD).checker(state.scene).valid_batch(parts)
    assert marked[collides[:-1] | collides[1:]].all()
    assert not marked.all()
    api.path = api.path[:0]
    assert state.plan(0.5)[1] == "refused: none is sure enough"


def test_what_is_dragged_is_seen_in_the_next_pictures(api: FakeApi, state: SceneState) -> None:
    pose = np.asarray(state.scene.cameras[0].pose).copy()
    state.sample(1)
    state.change(obstacles=type(state.scene.obstacles)())
    state.sample(1)
    pose[2, 3] += 0.1
    state.move("cameras", 0, pose)
    state.sample(1)
    state.set_end("start", WORLD.space.sample_uniform(np.random.default_rng(1), 1)[0].tolist())
    state.sample(1)
    for before, after in pairwise(api.shown):
        assert not np.array_equal(before.pictures[0], after.pictures[0])
    assert np.isfinite(state.points_m()).all()
