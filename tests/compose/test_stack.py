"""The whole flow in containers: come up, train, evaluate, serve the new champion, take more workers."""

import time
from collections.abc import Mapping
from typing import Any

import httpx
import numpy as np
import pytest

from tests.compose.answers import ask_for_plan, ask_for_samples
from tests.compose.stack import Stack

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]

COUNT_NODES = "import ray; ray.init(logging_level=50); print(sum(node['Alive'] for node in ray.nodes()))"


def test_an_empty_registry_serves_the_shipped_model(untrained: httpx.Response) -> None:
    assert untrained.status_code == 200, untrained.text
    assert untrained.json()["model"]["fallback"] is True


def test_the_cluster_takes_no_job_from_a_stranger(stack: Stack) -> None:
    assert httpx.get(f"{stack.url('RAY')}/api/jobs/", timeout=30).status_code == 401


SERVICES = ("postgres", "mlflow", "ray-head", "ray-worker", "inference-api", "edge", "mlflow-reader")


@pytest.mark.parametrize("service", SERVICES)
def test_a_container_is_not_root_and_cannot_write_to_its_root(stack: Stack, service: str) -> None:
    assert stack.compose("exec", "-T", service, "id", "-u").strip() != "0"
    with pytest.raises(AssertionError, match="Read-only file system"):
        stack.compose("exec", "-T", service, "touch", "/written")


def test_what_callers_report_is_uploaded(stack: Stack, untrained: httpx.Response) -> None:
    named = {"request_id": untrained.headers["x-request-id"], "model": "pretrained/0"}
    told = {"outcomes": [{"kind": "samples", "checked": 3, "free": 2, **named}]}
    assert httpx.post(f"{stack.url('API')}/outcomes", json=told, timeout=60).json() == {"kept": 1}
    until = time.monotonic() + 60.0
    while "uploaded 1 of samples" not in stack.job("outcomes"):
        assert time.monotonic() < until


def test_the_api_plans_without_compiling_first(stack: Stack) -> None:
    began = stack.compose("exec", "-T", "inference-api", "ls", "-R", "/opt/cspace/kernels")
    answer = ask_for_plan(stack, model="pretrained").json()
    assert answer["status"] in ("solved", "refused"), answer
    assert began.count(".nbc") > 10
    assert stack.compose("exec", "-T", "inference-api", "ls", "-R", "/opt/cspace/kernels") == began


CONNECT = "import socket, sys; socket.create_connection((sys.argv[1], int(sys.argv[2])), 5)"
ASK = """
import sys, urllib.error, urllib.request
data = sys.argv[3].encode() if len(sys.argv) > 3 else None
asked = urllib.request.Request("http://mlflow-reader:5000" + sys.argv[2], data, method=sys.argv[1])
try:
    print(urllib.request.urlopen(asked, timeout=30).status)
except urllib.error.HTTPError as refused:
    print(refused.code)
"""


@pytest.mark.parametrize(
    ("name", "port"), [("postgres", 5432), ("mlflow", 5000), ("ray-head", 8265), ("1.1.1.1", 443)]
)
def test_the_apis_container_reaches_neither_the_rest_of_the_stack_nor_the_internet(
    stack: Stack, name: str, port: int
) -> None:
    with pytest.raises(AssertionError, match=r"gaierror|OSError|TimeoutError"):
        stack.compose("exec", "-T", "inference-api", "python", "-c", CONNECT, name, str(port))


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/api/2.0/mlflow/registered-models/search", 200),
        ("POST", "/api/2.0/mlflow/registered-models/create", 403),
        ("POST", "/api/2.0/mlflow/registered-models/alias", 403),
        ("PUT", "/api/2.0/mlflow-artifacts/artifacts/1/model", 403),
        ("DELETE", "/api/2.0/mlflow/registered-models/delete", 403),
        ("POST", "/graphql", 403),
        ("GET", "/", 403),
    ],
)
def test_the_apis_container_reads_the_registry_and_changes_nothing(
    stack: Stack, method: str, path: str, status: int
) -> None:
    data = () if method == "GET" else ('{"name": "written", "alias": "champion", "version": "1"}',)
    said = stack.compose("exec", "-T", "inference-api", "python", "-c", ASK, method, path, *data)
    assert said.strip() == str(status)


@pytest.mark.parametrize("framework", ["torch", "ray", "lightning", "sklearn"])
def test_the_api_s_image_holds_no_training_framework(stack: Stack, framework: str) -> None:
    with pytest.raises(AssertionError, match="ModuleNotFoundError"):
        stack.compose("exec", "-T", "inference-api", "python", "-c", f"import {framework}")


def test_a_new_version_is_served_to_those_who_name_it(stack: Stack, trained: Mapping[str, Any]) -> None:
    answer = ask_for_samples(stack, model=f"{trained['model']}/{trained['version']}")
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert np.asarray(body["samples"]).shape == (300, 2)
    assert body["model"]["version"] == trained["version"]
    assert body["model"]["digest"] == trained["digest"]


def test_the_gate_promotes_it_and_the_api_serves_it(
    stack: Stack, trained: Mapping[str, Any], decided: Mapping[str, Any]
) -> None:
    model = ask_for_samples(stack).json()["model"]
    assert (model["fallback"], model["digest"]) == (False, trained["digest"])


def test_a_version_that_learned_nothing_is_not_promoted(stack: Stack, decided: Mapping[str, Any]) -> None:
    champion = ask_for_samples(stack).json()["model"]
    weak = stack.result("train", "--preset", "smoke")
    verdict = stack.result("evaluate")
    assert (verdict["version"], verdict["promoted"]) == (weak["version"], False)
    assert ask_for_samples(stack).json()["model"] == champion


def test_a_failed_job_fails_the_command(stack: Stack) -> None:
    with pytest.raises(AssertionError, match="no_such_setting"):
        stack.job("train", "--set", "no_such_setting=1")


def test_more_workers_join_the_cluster(stack: Stack) -> None:
    stack.compose("up", "--no-build", "--wait", "--scale", "ray-worker=2", limit_s=300)
    assert stack.compose("exec", "-T", "ray-head", "python", "-c", COUNT_NODES).split()[-1] == "3"
    stack.start()
