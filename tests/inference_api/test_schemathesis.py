"""Requests made from the OpenAPI document, right and wrong: no 5xx, no answer that it does not tell of."""

import base64
from collections.abc import Iterator
from pathlib import Path

import pytest
import schemathesis
from hypothesis import HealthCheck, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi import checks

from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]

CHECKS = [
    not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    chosen = {"CSPACE_PRETRAINED_MODEL": str(bundles["careful"])}
    with api_server(tmp_path_factory.mktemp("schemathesis"), chosen) as found:
        yield found


schema = schemathesis.openapi.from_dict(create_app(ApiSettings(model_cache=Path("unused"))).openapi())
lenient = {"deadline": None, "derandomize": True, "suppress_health_check": list(HealthCheck)}


@schema.parametrize()
@settings(max_examples=10, **lenient)
def test_no_request_is_answered_in_an_undocumented_way(address: str, case: schemathesis.Case) -> None:
    case.call_and_validate(base_url=address, checks=CHECKS, timeout=20)


@pytest.mark.slow
@schema.parametrize()
@settings(max_examples=200, **lenient)
def test_nor_is_any_of_many(address: str, case: schemathesis.Case) -> None:
    case.call_and_validate(base_url=address, checks=CHECKS, timeout=20)


@schema.include(path="/sample", method="POST").parametrize()
@settings(max_examples=60, **lenient)
def test_other_fields_beside_a_real_picture_are_answered_as_documented(
    address: str, png: bytes, case: schemathesis.Case
) -> None:
    if isinstance(case.body, dict):
        form = case.media_type == "multipart/form-data"
        # Hardly any text that is drawn names a model.
        kept = {name: value for name, value in case.body.items() if name != "model"}
        case.body = kept | {"image": png if form else base64.b64encode(png).decode()}
    answer = case.call_and_validate(base_url=address, checks=CHECKS, timeout=20)
    if answer.status_code == 200 and answer.headers["content-type"] == "application/json":
        body = answer.json()
        count = case.body.get("n", 300)
        assert len(body["samples"]) + body["shortfall"] == int(count)
