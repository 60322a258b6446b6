"""Scenes in space as the workbench is told of them, held against the world's own simulator."""

import base64
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.errors import DatasetError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.spatial.benchmark import BenchProblem, problems, write_problems
from cspace.worlds.spatial.camera import looking
from cspace.worlds.spatial.view import read_view
from inference_api.app import create_app
from inference_api.settings import PRETRAINED_FOLDER, ApiSettings
from inference_api.workbench.benchmark import benchmark_problem
from inference_api.workbench.space_faces import faces_of
from tests.inference_api.client import ApiClient, running

PANDA = "pretrained-panda"
FAMILY, SEED = "table", 2


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiClient]:
    """An API on the shipped models with the truth."""
    settings = ApiSettings(
        registry_uri=None,
        cache_folder=tmp_path_factory.mktemp("cache"),
        further_folders={PANDA: Path(PRETRAINED_FOLDER).with_name("pretrained_panda")},
        workbench=True,
    )
    with running(create_app(settings)) as client:
        yield client


@pytest.fixture(scope="module")
def simulator(bench: ApiClient) -> Any:
    shipped = bench.app.state.store.shipped
    return simulator_of(next(one.spec.world for one in shipped if one.name == PANDA))


def told(bench: ApiClient, **fields: Any) -> dict[str, Any]:
    body = {"model": PANDA, "family": FAMILY, "seed": SEED, **fields}
    answer = bench.post("/workbench/space", json=body)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_a_scene_is_the_demo_s_of_its_family_and_seed_as_its_cameras_see_it(
    bench: ApiClient, simulator: Any
) -> None:
    problem = simulator.problem(FAMILY, Split.DEMO, SEED)
    found = told(bench)
    assert base64.b64decode(found["image"]) == simulator.picture_file(problem.scenario)
    assert found["faces"] == [face.model_dump() for face in faces_of(problem.scenario.obstacles.to_dict())]
    assert np.allclose(found["goal"], problem.goal)
    assert np.allclose(found["start"], problem.start)
    assert len(found["previews"]) == len(found["cameras"]) == len(problem.scenario.cameras)
    own = len(simulator.families.names)
    assert found["families"][:own] == list(simulator.families.names)
    assert len(found["families"]) == own + 7


def test_cameras_that_one_places_see_the_scene_from_there(bench: ApiClient, simulator: Any) -> None:
    poses = [looking((1.2, y, 1.0), (0.4, 0.0, 0.3)) for y in (-0.8, 0.8)]
    found = told(bench, cameras=[pose.tolist() for pose in poses])
    view = read_view(base64.b64decode(found["image"]), simulator.world.space)
    assert np.allclose([camera.pose for camera in view.cameras], poses)
    assert found["image"] != told(bench)["image"]
    assert found["faces"] == told(bench)["faces"]


def test_an_arm_that_is_moved_stands_there_in_the_pictures(bench: ApiClient, simulator: Any) -> None:
    state = simulator.problem(FAMILY, Split.DEMO, SEED).goal.tolist()
    found = told(bench, state=state)
    assert found["start"] == state
    view = read_view(base64.b64decode(found["image"]), simulator.world.space)
    assert view.state == pytest.approx(state)


def test_samples_and_ways_are_judged_by_the_scene_s_checks(bench: ApiClient, simulator: Any) -> None:
    problem = simulator.problem(FAMILY, Split.DEMO, SEED)
    checker = simulator.checker(problem.scenario)
    rows = simulator.world.space.sample_uniform(np.random.default_rng(0), 40)
    free = checker.valid_batch(rows)
    assert 0 < free.sum() < len(free)
    straight = [problem.start.tolist(), problem.goal.tolist()]
    found = told(bench, configurations=rows.tolist(), path=straight)
    assert found["sample_free"] == free.tolist()
    assert found["way"]["free"] == bool(checker.edge_batch(*np.array(straight)[:, None], 0.005).all())


REFUSED: list[tuple[str, dict[str, Any]]] = [
    ("space", {"model": "pretrained"}),
    ("truth", {"model": PANDA, "discs": []}),
    ("scene", {"model": PANDA}),
    ("space", {"model": PANDA, "family": "gothic"}),
    ("space", {"model": PANDA, "cameras": [np.ones((4, 4)).tolist()]}),
    ("space", {"model": PANDA, "cameras": []}),
    ("space", {"model": PANDA, "cameras": [np.eye(4).tolist()] * 5}),
    ("space", {"model": PANDA, "state": [0.0]}),
]


@pytest.mark.parametrize(("page", "body"), REFUSED, ids=lambda value: str(value)[:60])
def test_what_does_not_fit_is_refused_with_what_was_expected(
    bench: ApiClient, page: str, body: dict[str, Any]
) -> None:
    answer = bench.post(f"/workbench/{page}", json=body)
    assert answer.status_code == 422, answer.text
    assert answer.json()["expected"]


ZERO, FAR = [0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0], [0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 1e5]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("state", FAR),
        ("configurations", [ZERO, FAR]),
        ("path", [ZERO, FAR]),
        ("cameras", [np.ones((4, 4)).tolist()]),
        ("cameras", [looking((200.0, 0.0, 0.0), (0.0, 0.0, 0.0)).tolist()]),
    ],
)
def test_what_is_beyond_limits_is_told_by_its_field(bench: ApiClient, field: str, value: Any) -> None:
    answer = bench.post("/workbench/space", json={"model": PANDA, field: value})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, field)


CAGE = "motionbench_cage"


def shipped_problem(number: int) -> BenchProblem:
    """A validation problem of the cage."""
    return problems(Split.VALIDATION, families=["cage"])[number - 1]


def test_a_seed_counts_the_benchmark_s_problems_that_ship_and_begins_anew_after_the_last(
    bench: ApiClient,
) -> None:
    found = told(bench, family=CAGE, seed=3)
    problem = shipped_problem(4)
    assert np.allclose(found["start"], problem.start)
    assert np.allclose(found["goal"], problem.goal)
    assert found["faces"] == [face.model_dump() for face in faces_of(problem.obstacles.to_dict())]
    assert len(found["cameras"]) == 1
    assert told(bench, family=CAGE, seed=33) == found
    # Its cameras are turned, and its arm moved, as those of other scenes.
    pose = looking((1.2, 0.8, 1.0), (0.4, 0.0, 0.3)).tolist()
    assert told(bench, family=CAGE, seed=3, cameras=[pose])["image"] != found["image"]


def test_fetched_problems_follow_those_that_ship(tmp_path: Path, simulator: Any) -> None:
    validation = problems(Split.VALIDATION)
    write_problems(tmp_path, Split.VALIDATION, validation)
    # As if fetched: the shipped ones under the numbers of the test's.
    test = [replace(one, number=one.number + 30) for one in validation]
    test += [replace(one, number=one.number + 60) for one in validation]
    test += [replace(one, number=one.number + 90) for one in validation if one.number <= 10]
    write_problems(tmp_path, Split.TEST, test)
    found = benchmark_problem(simulator.world, CAGE, 33, tmp_path)
    assert np.allclose(found.goal, shipped_problem(4).goal)
    assert np.allclose(benchmark_problem(simulator.world, CAGE, 103, tmp_path).goal, found.goal)


def test_a_folder_without_the_problems_is_told(tmp_path: Path, simulator: Any) -> None:
    with pytest.raises(DatasetError, match="cannot be read"):
        benchmark_problem(simulator.world, CAGE, 0, tmp_path)
