"""The whole flow in containers: come up, train, evaluate, serve the new version, go down."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from cspace.image import encode_png
from cspace.render import render
from cspace.robot import TWO_LINK
from cspace.scenario import Split, random_scenarios
from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def stack(engine: None, root: Path) -> Iterator[Stack]:
    stack = Stack.unique(root)
    try:
        stack.up()
        yield stack
    finally:
        stack.down()


@pytest.fixture(scope="module")
def trained(stack: Stack) -> Mapping[str, Any]:
    """What the training job says of the version that it registered."""
    return result_of(stack.job("train"))


def result_of(log: str) -> Mapping[str, Any]:
    lines = [line for line in log.splitlines() if line.startswith("RESULT ")]
    assert lines, log[-4000:]
    result = json.loads(lines[-1].removeprefix("RESULT "))
    assert isinstance(result, dict)
    return result


def ask_for_samples(stack: Stack, **fields: str) -> httpx.Response:
    scenario = random_scenarios(Split.TEST, seed=3, count=1, robot=TWO_LINK)[0]
    return httpx.post(
        f"{stack.url('API')}/sample",
        files={"image": ("scenario.png", encode_png(render(scenario)), "image/png")},
        data={"n": "300", "seed": "7", **fields},
        timeout=60,
    )


def test_an_empty_registry_serves_the_shipped_model(stack: Stack) -> None:
    answer = ask_for_samples(stack)
    assert answer.status_code == 200, answer.text
    assert answer.json()["model"]["fallback"] is True


def test_the_cluster_takes_no_job_from_a_stranger(stack: Stack) -> None:
    assert httpx.get(f"{stack.url('RAY')}/api/jobs/", timeout=30).status_code == 401


def test_the_new_version_is_served(stack: Stack, trained: Mapping[str, Any]) -> None:
    answer = ask_for_samples(stack, model=f"{trained['model']}/{trained['version']}")
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert np.asarray(body["samples"]).shape == (300, 2)
    assert body["model"]["version"] == trained["version"]
    assert body["model"]["digest"] == trained["digest"]


def test_the_evaluation_decides_about_the_new_version(stack: Stack, trained: Mapping[str, Any]) -> None:
    decision = result_of(stack.job("evaluate"))
    assert decision["version"] == trained["version"]
    assert decision["digest"] == trained["digest"]
    assert isinstance(decision["promoted"], bool)


def test_a_failed_job_fails_the_command(stack: Stack) -> None:
    with pytest.raises(AssertionError, match="no_such_setting"):
        stack.job("train", "--set", "no_such_setting=1")
