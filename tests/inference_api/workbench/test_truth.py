"""Pictures of scenes and their ground truth, compared with the planar world's own functions."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.simulator import render
from cspace.worlds.planar.world import Disc, Scenario
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over

CELLS = 16
DISCS = [[2.5, 0.0, 1.0]]
SCENE = Scenario(TWO_LINK, (Disc(2.5, 0.0, 1.0),))
CHECKER = CollisionChecker(SCENE)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    with api_over(tmp_path_factory.mktemp("bench"), bundles, None, api_workbench=True) as client:
        yield client


def ask(api: ApiClient, route: str, **fields: Any) -> dict[str, Any]:
    answer = api.post(f"/workbench/{route}", json={"discs": DISCS, "cells": CELLS, **fields})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_the_picture_is_the_one_that_training_draws(bench: ApiClient) -> None:
    for discs, scene in ((DISCS, SCENE), ([], Scenario(TWO_LINK, ()))):
        image = base64.b64decode(ask(bench, "picture", discs=discs)["image"])
        assert np.array_equal(decode_png(image, 48), render(scene))


def test_regions_are_those_of_the_checks(bench: ApiClient) -> None:
    bits = np.unpackbits(np.frombuffer(base64.b64decode(ask(bench, "truth")["free"]), np.uint8))
    centres = -np.pi + (np.arange(CELLS) + 0.5) * 2.0 * np.pi / CELLS
    grid = np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)
    expected = CHECKER.valid_batch(grid)
    assert np.array_equal(bits.astype(bool), expected)
    assert 0 < expected.sum() < len(expected)


def test_precision_and_coverage_describe_the_samples(bench: ApiClient) -> None:
    found = ask(bench, "truth")
    assert (found["precision"], found["coverage"], found["path_free"]) == (None, None, None)
    # Into the disc, and away from it, an angle beyond a half turn.
    found = ask(bench, "truth", configurations=[[0.0, 0.0], [3.0 - 2.0 * np.pi, 0.0]])
    assert (found["sample_free"], found["precision"]) == ([False, True], 0.5)
    # One ball of 0.2 rad on a torus of (2 pi)^2, most of it free.
    assert 0.0 < found["coverage"] < 0.02
    assert ask(bench, "truth", configurations=[[0.0, 0.0]])["coverage"] == 0.0
    everywhere = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 2))
    assert ask(bench, "truth", configurations=everywhere.tolist())["coverage"] > 0.95


def test_a_path_is_checked_edge_by_edge(bench: ApiClient) -> None:
    found = ask(bench, "truth", path=[[2.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    assert found["path_free"] == [True, False]


WRONG: list[dict[str, Any]] = [
    {"discs": [[0.0, 0.0, "one"]]},
    {"discs": [[0.0, 0.0]]},
    {"discs": [[0.0, 0.0, 0.0]]},
    {"discs": [[0.0, 0.0, 1.0]] * 65},
    {"cells": 1000},
    {"colour": "red"},
    {"configurations": [[0.0]]},
    {"configurations": [[0.0, 0.0], [0.0, 1e5]]},
    {"at": [0.0]},
    {"at": [-19.0, 0.0]},
    {"path": [[0.0, 0.0], [0.0, 0.0, 0.0]]},
    {"path": [[0.0, 0.0]] * 501},
]


@pytest.mark.parametrize("fields", WRONG, ids=str)
def test_wrong_fields_are_refused(bench: ApiClient, fields: dict[str, Any]) -> None:
    answer = bench.post("/workbench/truth", json={"discs": [], **fields})
    problem = assert_problem(answer, 422, "invalid-value")
    assert next(iter(fields)) in str(problem)


def test_errors_are_those_of_the_api(bench: ApiClient) -> None:
    answer = bench.post("/workbench/truth", json={"discs": [], "model": "nobody"})
    assert_problem(answer, 404, "unknown-model")
    answer = bench.post("/workbench/truth", content=b"{", headers={"content-type": "application/json"})
    assert_problem(answer, 400, "malformed-body")
