"""What the 3D viewer asks the API for, and what it makes of the answers."""

import base64
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cspace.errors import ImageError, InputError
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.spatial.obstacles import Box
from cspace.worlds.spatial.poses import HERE
from cspace.worlds.spatial.view import write_view
from cspace_client import Belief, DepthPictures
from services.planner.viewer import SceneState

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

    def belief(self, picture: DepthPictures, model: str) -> Belief:
        self.shown.append(picture)
        occupied = np.zeros((4, 4, 4), dtype=np.uint8)
        occupied[1, 2, 3], occupied[0, 0, 0] = 204, 51
        packed = base64.b64encode(occupied.tobytes()).decode()
        return Belief.model_construct(low_m=[-1.0, 0.0, 1.0], cell_m=0.5, counts=[4, 4, 4], occupied=packed)

    def doctor(self, picture: DepthPictures, model: str) -> Any:
        self.shown.append(picture)
        verdict = SimpleNamespace(code="holes", seen="few readings", effect="little is known", remedy="mend")
        return SimpleNamespace(verdicts=[verdict], poses=[], notes=["a table"])


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


def test_cells_are_shown_in_which_something_is_expected(state: SceneState) -> None:
    centres, surely, cell_m = state.believed()
    np.testing.assert_allclose(centres, [[-0.25, 1.25, 2.75]])
    assert (surely.tolist(), cell_m) == ([pytest.approx(0.8)], 0.5)


def test_a_path_through_an_obstacle_is_called_in_collision(api: FakeApi, state: SceneState) -> None:
    free = api.rows[state.sample(20).free]
    api.path = np.stack([free[0], free[0]])
    assert "collision-free" in state.plan(0.5)[1]
    blocked = api.rows[~state.sample(20).free]
    api.path = np.stack([free[0], blocked[0]])
    assert "in collision** on 1 of 1 edges" in state.plan(0.5)[1]
    # Where along it, by its parts.
    parts = np.linspace(free[0], blocked[0], 50)
    marked = state.blocked(parts)
    collides = ~state.checker().valid_batch(parts)
    assert marked[collides[:-1] | collides[1:]].all()
    assert not marked.all()
    api.path = api.path[:0]
    assert state.plan(0.5)[1] == "**refused**: none is sure enough"


def test_what_is_dragged_is_seen_in_the_next_pictures(api: FakeApi, state: SceneState) -> None:
    state.use_cameras(1)
    state.sample(1)
    state.change(obstacles=type(state.scene.obstacles)())
    state.sample(1)
    state.use_cameras(3)
    state.sample(1)
    state.set_end("start", WORLD.space.sample_uniform(np.random.default_rng(1), 1)[0].tolist())
    state.sample(1)
    with_obstacles, without, three, moved = api.shown
    assert not np.array_equal(with_obstacles.pictures[0], without.pictures[0])
    assert [len(one.pictures) for one in api.shown] == [1, 1, 3, 3]
    assert not np.array_equal(three.pictures[0], moved.pictures[0])
    assert np.isfinite(state.points_m()).all()


def test_what_is_known_is_sent_and_counts_as_true(api: FakeApi, state: SceneState) -> None:
    free = api.rows[state.sample(20).free]
    place = WORLD.body.joint_positions_m(free)[0, -1]
    box = Box(
        np.block([[np.eye(3), place[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]).tolist(), (0.1,) * 3
    )
    state.boxes = (box,)
    api.path = np.stack([free[0], free[0]])
    assert "in collision" in state.plan(0.5)[1]
    state.boxes = ()
    assert "collision-free" in state.plan(0.5)[1]
    # A rod of two metres reaches the ground or the arm from nearly everywhere.
    state.hold(Box(HERE, (1.0, 0.02, 0.02)))
    assert state.sample(20).free.sum() < len(free)
    sent = api.shown[-1].known
    assert [one["name"] for one in sent.attached] == ["held"]
    assert not sent.scene
    state.hold(None)
    assert state.sample(20).free.sum() == len(free)


def test_sets_of_the_benchmark_are_families_of_its_robot(state: SceneState) -> None:
    assert "table" in state.families
    named = [name for name in state.families if name.startswith("motionbench_")]
    assert named
    checker = simulator_of(WORLD).checker
    drawn = 0
    for seed in range(10):
        with suppress(InputError):
            problem = state.draw(named[0], seed)
            ends = np.stack([problem.start, problem.goal])
            assert WORLD.space.contains(ends).all()
            assert checker(problem.scenario).valid_batch(ends).all()
            drawn += 1
    assert drawn > 0


def test_a_view_file_takes_the_scenes_place_until_the_next_is_drawn(api: FakeApi, state: SceneState) -> None:
    view = simulator_of(WORLD).problem("table", Split.DEMO, 5).scenario.view()
    with pytest.raises(ImageError, match="without its camera"):
        state.open(b"no view")
    state.open(write_view(view))
    assert state.sample(3).free is None
    assert state.findings() == "- **holes**: few readings; little is known. Remedy: mend.\n\n- a table"
    for shown in api.shown:
        np.testing.assert_array_equal(shown.pictures[0], view.pictures[0])
        np.testing.assert_array_equal(shown.state, view.state)
    np.testing.assert_array_equal(state.problem.start, view.state)
    api.path = api.rows[:2]
    assert state.plan(0.5)[1] == "Confidence 75%. The true scene is unknown."
    unseen = state.unseen_m()
    assert len(unseen) > 1000
    # What a camera reads is seen.
    nearest = [np.linalg.norm(unseen - point, axis=1).min() for point in state.points_m()[::500]]
    assert np.median(nearest) > WORLD.sensor.grid.voxel_m / 2.0
    state.draw("table", 5)
    assert state.sample(3).free is not None
