"""What the workbench is told of the truth, held against the checks themselves."""

import base64
from typing import Any

import numpy as np

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.checks import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.workbench.conftest import StartBench

CELLS = 16
DISCS = [[2.5, 0.0, 1.0]]
CHECKER = CollisionChecker(Scenario(TWO_LINK, (Disc(2.5, 0.0, 1.0),)))


def truth(api: ApiClient, **fields: Any) -> dict[str, Any]:
    answer = api.post("/workbench/truth", json={"discs": DISCS, "cells": CELLS, **fields})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_regions_are_those_of_the_checks_joint_one_the_slower_axis(bench: ApiClient) -> None:
    found = truth(bench)
    bits = np.unpackbits(np.frombuffer(base64.b64decode(found["free"]), np.uint8))
    centres = -np.pi + (np.arange(CELLS) + 0.5) * 2.0 * np.pi / CELLS
    grid = np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)
    expected = CHECKER.valid_batch(grid)
    assert np.array_equal(bits.astype(bool), expected)
    assert 0 < expected.sum() < len(expected)


def test_precision_and_coverage_are_those_of_what_is_shown(bench: ApiClient) -> None:
    # Straight into the disc, and straight away from it.
    found = truth(bench, configurations=[[0.0, 0.0], [3.0, 0.0]])
    assert found["sample_free"] == [False, True]
    assert found["precision"] == 0.5
    # One ball of 0.2 rad on a torus of (2 pi)^2, most of it free.
    assert 0.0 < found["coverage"] < 0.02
    everywhere = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 2))
    assert truth(bench, configurations=everywhere.tolist())["coverage"] > 0.95


def test_nothing_shown_has_neither_precision_nor_coverage_and_samples_that_collide_cover_nothing(
    bench: ApiClient,
) -> None:
    found = truth(bench)
    assert (found["precision"], found["coverage"], found["path_verdict"]) == (None, None, None)
    found = truth(bench, configurations=[[0.0, 0.0]])
    assert (found["precision"], found["coverage"]) == (0.0, 0.0)


def test_a_way_is_judged_piece_by_piece(bench: ApiClient) -> None:
    way = truth(bench, path=[[2.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])["path_verdict"]
    assert way["free"] is False
    assert way["edges"] == [True, False]
    away = truth(bench, path=[[2.0, 0.0], [3.0, 0.5]])["path_verdict"]
    assert away["free"] is True
    assert away["clearance_m"] > 0.5


def test_circles_are_taken_at_any_angle_within_a_turn(bench: ApiClient) -> None:
    turned = truth(bench, configurations=[[2.0 * np.pi, 0.0], [3.0 - 2.0 * np.pi, 0.0]])
    assert turned["sample_free"] == [False, True]


def test_the_same_seed_draws_the_same_scene_and_another_one_another(bench: ApiClient) -> None:
    def scene(seed: int, family: str = "uniform") -> dict[str, Any]:
        answer = bench.post("/workbench/scene", json={"family": family, "seed": seed})
        found: dict[str, Any] = answer.json()
        return found

    first = scene(1)
    assert first == scene(1)
    assert first["discs"] != scene(2)["discs"]
    assert first["families"] == ["uniform", "narrow", "disconnected"]
    assert len(first["discs"]) == 3
    checker = CollisionChecker(Scenario(TWO_LINK, tuple(Disc(*row) for row in first["discs"])))
    assert checker.valid_batch([first["start"], first["goal"]]).all()


BAD: list[tuple[str, dict[str, Any], str]] = [
    ("truth", {}, "discs"),
    ("truth", {"discs": [[0.0, 0.0, "1"]]}, "discs"),
    ("truth", {"discs": [[0.0, 0.0]]}, "discs"),
    ("truth", {"discs": [[0.0, 0.0, 1.0]] * 65}, "discs"),
    ("truth", {"discs": [], "cells": 1000}, "cells"),
    ("truth", {"discs": [], "colour": "red"}, "colour"),
    ("truth", {"discs": [[0.0, 0.0, 0.0]]}, "discs"),
    ("truth", {"discs": [], "configurations": [[0.0]]}, "configurations"),
    ("truth", {"discs": [], "configurations": [[0.0, 0.0], [0.0, 1e5]]}, "configurations"),
    ("truth", {"discs": [], "at": [-19.0, 0.0]}, "at"),
    ("truth", {"discs": [], "path": [[0.0, 0.0], [1e5, 0.0]]}, "path"),
    ("truth", {"discs": [], "path": [[0.0, 0.0], [3.0, 0.0]] * 1000}, "path"),
    ("scene", {"seed": -1}, "seed"),
]


def test_wrong_fields_are_told_by_name(bench: ApiClient) -> None:
    for page, body, field in BAD:
        answer = bench.post(f"/workbench/{page}", json=body)
        assert answer.status_code == 422, body
        assert answer.json()["errors"][0]["field"] == field, body


UNFIT: list[tuple[str, dict[str, Any]]] = [
    ("truth", {"discs": [[0.0, 0.0, -1.0]]}),
    ("truth", {"discs": [], "path": [[0.0, 0.0], [0.0, 0.0, 0.0]]}),
    ("truth", {"discs": [], "at": [0.0]}),
    ("scene", {"family": "gothic"}),
]


def test_what_does_not_fit_the_robot_is_refused_with_what_was_expected(bench: ApiClient) -> None:
    for page, body in UNFIT:
        problem = assert_problem(bench.post(f"/workbench/{page}", json=body), 422, "invalid-value")
        assert problem["expected"]


def test_an_unknown_model_is_refused_as_everywhere(bench: ApiClient) -> None:
    assert_problem(
        bench.post("/workbench/truth", json={"discs": [], "model": "nobody"}), 404, "unknown-model"
    )
    answer = bench.post("/workbench/truth", content=b"{", headers={"content-type": "application/json"})
    assert_problem(answer, 400, "malformed-body")


def test_the_truth_is_not_there_unless_it_was_asked_for(start_bench: StartBench) -> None:
    api = start_bench(truth=False)
    assert api.get("/").status_code == 200
    assert api.get("/workbench/about").json()["truth"] is False
    for page in ("truth", "scene", "scene-file", "search"):
        assert api.post(f"/workbench/{page}", json={}).status_code == 404
