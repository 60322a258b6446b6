"""The OpenAPI document and the page that shows it tell the truth."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from inference_api.app import create_app
from inference_api.problem_types import SAMPLE_PROBLEMS
from inference_api.settings import ApiSettings
from tests.bundles import picture
from tests.inference_api.client import ApiClient
from tests.inference_api.tensor_client import LENGTH, json_input


@pytest.fixture
def document(api: ApiClient) -> dict[str, Any]:
    found: dict[str, Any] = api.get("/openapi.json").json()
    return found


def validate(document: dict[str, Any], schema: dict[str, Any], value: object) -> None:
    Draft202012Validator({**schema, "components": document["components"]}).validate(value)


def answers(document: dict[str, Any], path: str, method: str, status: str, media_type: str) -> dict[str, Any]:
    schema: dict[str, Any] = document["paths"][path][method]["responses"][status]["content"][media_type][
        "schema"
    ]
    return schema


def test_health_is_shown_as_free_and_the_rest_as_possibly_locked(document: dict[str, Any]) -> None:
    free = {path for path, item in document["paths"].items() if item.get("get", {}).get("security") == []}
    assert free == {"/health/live", "/health/ready", "/v2/health/live", "/v2/health/ready"}
    assert document["security"] == [{}, {"key": []}]


def test_every_page_of_the_contract_is_in_the_document(document: dict[str, Any]) -> None:
    assert {path: set(item) for path, item in document["paths"].items()} == {
        "/sample": {"post"},
        "/validity": {"post"},
        "/plan": {"post"},
        "/belief": {"post"},
        "/doctor": {"post"},
        "/outcomes": {"post"},
        "/models": {"get"},
        "/metrics": {"get"},
        "/health/live": {"get"},
        "/health/ready": {"get"},
        "/v2": {"get"},
        "/v2/health/live": {"get"},
        "/v2/health/ready": {"get"},
        "/v2/models/{model}": {"get"},
        "/v2/models/{model}/ready": {"get"},
        "/v2/models/{model}/infer": {"post"},
        "/v2/models/{model}/versions/{version}": {"get"},
        "/v2/models/{model}/versions/{version}/ready": {"get"},
        "/v2/models/{model}/versions/{version}/infer": {"post"},
    }


def test_the_proxies_pass_every_page_on_but_the_metrics(document: dict[str, Any]) -> None:
    text = Path(__file__).parents[2].joinpath("docker/nginx/pages.conf").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"location ~ (\S+) \{", text)
    assert {path for path in document["paths"] if not re.search(pattern, path)} == {"/metrics"}


REQUESTS: list[tuple[dict[str, Any], bool]] = [
    ({}, True),
    ({"n": 5, "seed": 3, "epsilon_sigma": 0.5, "min_confidence": 0}, True),
    ({"n": 5, "seed": "18446744073709551615", "epsilon_sigma": [0, 1]}, True),
    ({"n": 0}, False),
    ({"n": "5"}, False),
    ({"seed": -1}, False),
    ({"seed": "x"}, False),
    ({"epsilon_sigma": []}, False),
    ({"epsilon_sigma": 11}, False),
    ({"min_confidence": 2}, False),
    ({"start": "0, 0"}, False),
    ({"colour": "red"}, False),
]


def test_the_described_body_and_the_server_agree(
    api: ApiClient, document: dict[str, Any], png: bytes
) -> None:
    schema = document["paths"]["/sample"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    for fields, good in REQUESTS:
        body = {"image": base64.b64encode(png).decode(), **fields}
        assert Draft202012Validator(schema).is_valid(body) is good, fields
        assert api.post("/sample", json=body).status_code == (200 if good else 422), fields


def test_real_answers_fit_their_description(api: ApiClient, document: dict[str, Any], png: bytes) -> None:
    for model in ("cspace-sampler@careful", "pretrained"):
        answer = api.post("/sample", files={"image": png}, data={"model": model, "n": "3"})
        validate(document, answers(document, "/sample", "post", "200", "application/json"), answer.json())
    pages = ("/v2", "/v2/health/live", "/v2/health/ready", "/v2/models/{model}", "/v2/models/{model}/ready")
    for path in ("/models", "/health/live", "/health/ready", *pages):
        answer = api.get(path.replace("{model}", "cspace-sampler@scored"))
        validate(document, answers(document, path, "get", "200", "application/json"), answer.json())


def test_npy_answers_carry_exactly_the_described_headers(
    api: ApiClient, document: dict[str, Any], png: bytes
) -> None:
    described = document["paths"]["/sample"]["post"]["responses"]["200"]
    assert "application/x-npy" in described["content"]
    # Of the models here the one that tells all that there is to tell.
    fields = {"model": "cspace-sampler@careful"}
    answer = api.post("/sample", data=fields, files={"image": png}, headers={"accept": "application/x-npy"})
    sent = {name for name in answer.headers if name.startswith(("x-", "server-timing"))}
    sent.remove("x-content-type-options")
    assert sent == {name.lower() for name in described["headers"]}


def test_every_problem_is_described_and_real_ones_fit(
    api: ApiClient, document: dict[str, Any], png: bytes
) -> None:
    described = document["paths"]["/sample"]["post"]["responses"]
    assert set(described) == {"200", *(str(problem.status) for problem in SAMPLE_PROBLEMS)}
    examples = {
        example["value"]["type"]
        for status, response in described.items()
        if status != "200"
        for example in response["content"]["application/problem+json"]["examples"].values()
    }
    assert examples == {problem.uri for problem in SAMPLE_PROBLEMS}
    answer = api.post("/sample", files={"image": png}, data={"n": "0", "colour": "red"})
    validate(document, answers(document, "/sample", "post", "422", "application/problem+json"), answer.json())


@pytest.mark.parametrize(
    ("page", "binary"),
    [("/v2/models/{model}/infer", False), ("/v2/models/{model}/versions/{version}/infer", True)],
)
def test_the_protocol_s_requests_and_answers_fit_their_description(
    api: ApiClient, document: dict[str, Any], page: str, binary: bool
) -> None:
    described = document["paths"][page]["post"]
    request = {"inputs": [json_input(picture()[None])], "parameters": {"n": 3, "binary_data_output": binary}}
    validate(document, described["requestBody"]["content"]["application/json"]["schema"], request)
    answer = api.post(page.replace("{model}", "cspace-sampler").replace("{version}", "4"), json=request)
    head = answer.content[: int(answer.headers.get(LENGTH, len(answer.content)))]
    schema = answers(document, page, "post", "200", "application/json")
    validate(document, schema, json.loads(head))
    assert answer.headers["content-type"] in described["responses"]["200"]["content"]
    assert LENGTH in described["responses"]["200"]["headers"]
    assert (LENGTH in answer.headers) is binary
    refused = api.post("/v2/models/cspace-sampler/infer", json={**request, "colour": "red"})
    schema = answers(document, page, "post", "400", "application/json")
    validate(document, schema, refused.json())


def test_the_documentation_needs_nothing_from_elsewhere(api: ApiClient) -> None:
    page = api.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    assert not re.findall(r"(?:https?:)?//[a-z]", re.sub(r"//#.*|// .*", "", page.text))
    addresses = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(addresses) == 3
    for address in addresses:
        asset = api.get(f"/{address}")
        assert asset.status_code == 200
        assert len(asset.content) > 1000
    assert "url: 'openapi.json'" in page.text


def test_the_default_model_that_is_shown_is_the_one_that_answers(tmp_path) -> None:
    settings = ApiSettings(cache_folder=tmp_path, model_name="three-link-sampler")
    found = create_app(settings).openapi()
    named = [schema for schema in _properties(found) if schema.get("maxLength") == 300]
    assert len(named) == 10
    assert {schema["default"] for schema in named} == {"three-link-sampler"}


def _properties(value):
    if isinstance(value, dict):
        if "model" in value.get("properties", {}):
            yield value["properties"]["model"]
        for inner in value.values():
            yield from _properties(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _properties(inner)
