"""The OpenAPI document: what changed against the snapshot, and that it describes what the server does.

``python -m tests.inference_api.test_openapi`` renews the snapshot.
"""

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.inference_api.client import ApiClient

SNAPSHOT = Path(__file__).with_name("openapi.json")


def written() -> str:
    """The document as the snapshot has it, without the version of the release."""
    found = create_app(ApiSettings(registry_uri=None, model_cache=Path("unused"))).openapi()
    found["info"]["version"] = "0"
    return json.dumps(found, indent=1, sort_keys=True) + "\n"


def test_the_document_is_that_of_the_snapshot() -> None:
    # A difference is a change of the contract: renew the snapshot, and read it in the diff.
    assert written().splitlines() == SNAPSHOT.read_text(encoding="utf-8").splitlines()


@pytest.fixture
def document(api: ApiClient) -> dict[str, Any]:
    found: dict[str, Any] = api.get("/openapi.json").json()
    return found


def validate(document: dict[str, Any], schema: dict[str, Any], value: object) -> None:
    Draft202012Validator({**schema, "components": document["components"]}).validate(value)


def answers(document: dict[str, Any], path: str, method: str, status: str, media_type: str) -> dict[str, Any]:
    response = document["paths"][path][method]["responses"][status]
    schema: dict[str, Any] = response["content"][media_type]["schema"]
    return schema


def test_the_proxies_pass_every_page_on_but_the_metrics(document: dict[str, Any]) -> None:
    text = Path(__file__).parents[2].joinpath("docker/nginx/pages.conf").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"location ~ (\S+) \{", text)
    assert {path for path in document["paths"] if not re.search(pattern, path)} == {"/metrics"}


REQUESTS: list[tuple[dict[str, Any], bool]] = [
    ({}, True),
    ({"n": 5, "seed": 3, "epsilon_sigma": [0.5], "min_confidence": 0}, True),
    ({"n": 5, "seed": "18446744073709551615", "epsilon_sigma": [0, 1]}, True),
    ({"scene": [{"name": "pole", "disc": {"x_m": 1.5, "y_m": 1.0, "radius_m": 0.3}}]}, True),
    ({"n": 0}, False),
    ({"n": "5"}, False),
    ({"seed": "x"}, False),
    ({"epsilon_sigma": []}, False),
    ({"min_confidence": 2}, False),
    ({"start": "0, 0"}, False),
    ({"scene": [{"name": "pole", "disc": {"x_m": 1.5}}]}, False),
    ({"colour": "red"}, False),
]


def test_the_described_body_and_the_server_agree(
    api: ApiClient, document: dict[str, Any], png: bytes
) -> None:
    schema = document["paths"]["/sample"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    schema = {**schema, "components": document["components"]}
    for fields, good in REQUESTS:
        body = {"image": [base64.b64encode(png).decode()], **fields}
        assert Draft202012Validator(schema).is_valid(body) is good, fields
        assert api.post("/sample", json=body).status_code == (200 if good else 422), fields


def test_real_answers_fit_their_description(api: ApiClient, document: dict[str, Any], png: bytes) -> None:
    for model in ("cspace-sampler@careful", "pretrained"):
        answer = api.post("/sample", files={"image": png}, data={"model": model, "n": "3"})
        validate(document, answers(document, "/sample", "post", "200", "application/json"), answer.json())
    for path in ("/models", "/health/live", "/health/ready"):
        validate(document, answers(document, path, "get", "200", "application/json"), api.get(path).json())
    answer = api.post("/sample", files={"image": png}, data={"n": "0", "colour": "red"})
    validate(document, answers(document, "/sample", "post", "4XX", "application/problem+json"), answer.json())


def test_npy_answers_carry_exactly_the_described_headers(
    api: ApiClient, document: dict[str, Any], png: bytes
) -> None:
    described = document["paths"]["/sample"]["post"]["responses"]["200"]
    # Of the models here the one that tells all that there is to tell.
    fields = {"model": "cspace-sampler@careful"}
    answer = api.post("/sample", data=fields, files={"image": png}, headers={"accept": "application/x-npy"})
    sent = {name for name in answer.headers if name.startswith(("x-", "server-timing"))}
    assert sent - {"x-content-type-options"} == {name.lower() for name in described["headers"]}


if __name__ == "__main__":
    SNAPSHOT.write_text(written(), encoding="utf-8")
