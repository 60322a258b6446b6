"""Services that are killed and started again under a light load, and a stack that goes down and comes up."""

import time
from collections.abc import Mapping
from typing import Any

import pytest

from tests.compose.answers import ask_for_samples, serves_champion
from tests.compose.kept import Kept, data_files
from tests.compose.load import Load
from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]


@pytest.mark.parametrize("service", ["postgres", "mlflow", "ray-head", "ray-worker"])
def test_no_request_fails_while_another_service_is_killed_and_started_again(
    stack: Stack, decided: Mapping[str, Any], service: str
) -> None:
    before = ask_for_samples(stack).json()
    with Load(stack) as load:
        load.more_answers()
        stack.compose("kill", service)
        load.more_answers()
        stack.start()
        load.more_answers()
    assert load.faults == []
    assert ask_for_samples(stack).json()["samples"] == before["samples"]


def test_requests_fail_only_while_the_api_itself_is_down(stack: Stack, decided: Mapping[str, Any]) -> None:
    before = ask_for_samples(stack).json()
    with Load(stack) as load:
        load.more_answers()
        killed_s = time.monotonic()
        stack.compose("kill", "inference-api")
        load.a_fault()
        stack.start()
        back_s = time.monotonic()
        load.more_answers()
    serves_champion(stack, decided)
    outside = [fault for fault in load.faults if fault.answered_s < killed_s or fault.sent_s > back_s]
    assert outside == []
    assert ask_for_samples(stack).json()["samples"] == before["samples"]


def test_the_api_comes_back_with_the_champion_while_the_registry_is_away(
    stack: Stack, decided: Mapping[str, Any]
) -> None:
    before = ask_for_samples(stack).json()
    stack.compose("kill", "mlflow", "inference-api")
    stack.compose("start", "inference-api")
    serves_champion(stack, decided)
    after = ask_for_samples(stack).json()
    stack.start()
    assert after["samples"] == before["samples"]


def test_a_job_runs_on_the_cluster_that_was_killed_and_started(
    stack: Stack, decided: Mapping[str, Any]
) -> None:
    versions = len(Kept.by(stack).versions)
    stack.result("train", "--preset", "smoke", "--set", "seed=11")
    assert len(Kept.by(stack).versions) == versions + 1


def test_down_and_up_again_keeps_runs_models_and_data(stack: Stack, decided: Mapping[str, Any]) -> None:
    kept, data, answer = Kept.by(stack), data_files(stack), ask_for_samples(stack).json()
    assert kept.runs
    assert data
    stack.down()
    stack.start()
    assert Kept.by(stack) == kept
    assert data_files(stack) == data
    serves_champion(stack, decided)
    again = ask_for_samples(stack).json()
    assert (again["model"], again["samples"]) == (answer["model"], answer["samples"])
