"""What a problem has to look like, and that the server goes on after it."""

import base64
from typing import Any

import httpx

from cspace.files import encode_png
from inference_api.problems import PROBLEMS
from tests.bundles import picture
from tests.inference_api.client import ApiClient

PNG = encode_png(picture())
IMAGE = base64.b64encode(PNG).decode()
TITLES = {problem.name: problem.title for problem in PROBLEMS}


def assert_problem(answer: httpx.Response, status: int, name: str) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = answer.json()
    assert problem["type"] == f"urn:cspace-sampler:problem:{name}"
    assert (problem["status"], problem["title"]) == (status, TITLES[name])
    assert problem["detail"]
    return problem


def assert_answers(api: ApiClient) -> None:
    answer = api.post("/sample", files={"image": PNG}, data={"n": "3", "model": "pretrained"})
    assert answer.status_code == 200, answer.text
    assert len(answer.json()["samples"]) == 3
