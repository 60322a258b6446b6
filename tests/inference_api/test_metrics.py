"""What /metrics says after known requests."""

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from cspace.bundle import Bundle
from cspace.bundle.golden import GoldenCase
from inference_api.problem_types import PROBLEMS
from inference_api.settings import Protection
from inference_api.telemetry import STAGES
from tests.bundles import picture
from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.tensor_client import json_input

Series = tuple[str, frozenset[tuple[str, str]]]


def scrape(api: ApiClient) -> dict[Series, float]:
    answer = api.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def value(found: Mapping[Series, float], name: str, /, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def labelled(found: Mapping[Series, float], name: str, label: str) -> set[str]:
    return {dict(labels)[label] for series, labels in found if series == name}


def test_requests_are_counted_by_template_method_and_status(start_api: StartApi) -> None:
    api = start_api()
    for path in ("/models", "/models?x=1", "/health/live", "/docs/assets/swagger-ui.css", "/sample"):
        api.get(path)
    for number in range(5):
        api.get(f"/nothing/{number}")
    found = scrape(api)
    for route, status, count in (
        ("/models", "200", 2),
        ("/health/live", "200", 1),
        ("/docs/assets", "200", 1),
        ("/sample", "405", 1),
        ("unknown", "404", 5),
    ):
        assert value(found, "cspace_requests_total", route=route, method="GET", status=status) == count


def test_no_client_can_add_names(start_api: StartApi) -> None:
    api = start_api()
    before = len(scrape(api))
    for number in range(20):
        api._call(lambda number=number: api._client.request(f"METHOD{number}", f"/models/{number}"))
        api.post("/sample", files={"image": PNG}, data={"model": f"no-{number}", f"field-{number}": "1"})
        api.post("/sample", files={"image": PNG}, data={"model": f"no-{number}"})
    found = scrape(api)
    # Metrics itself, two statuses of samples and the unknown method, each with the time of its first.
    assert len(found) - before == 2 * (1 + 2 + 1)
    assert labelled(found, "cspace_requests_total", "method") == {"GET", "POST", "other"}


def test_failures_are_counted_by_problem_type(start_api: StartApi, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    api = start_api(protection=Protection(rate_per_s=0.001, rate_burst=8))
    api.post("/sample", files={"image": PNG}, data={"n": "0"})
    api.post("/sample", files={"image": PNG}, data={"n": "many"})
    api.post("/sample", files={"image": b"no PNG"})
    api.post("/sample", files={"image": PNG}, data={"model": "nobody"})
    api.post("/sample", content=b"{", headers={"content-type": "application/json"})
    api.post("/sample", content=bytes(9 * 2**20), headers={"content-type": "application/json"})
    api.get("/sample")
    with monkeypatch.context() as patch:
        patch.setattr(Bundle, "answer", fail)
        assert api.post("/sample", files={"image": PNG}).status_code == 500
    api.get("/models")
    found = scrape(api)
    expected = {
        "invalid-value": 2.0,
        "invalid-image": 1.0,
        "unknown-model": 1.0,
        "malformed-body": 1.0,
        "body-too-large": 1.0,
        "method-not-allowed": 1.0,
        "internal-error": 1.0,
        "too-many-requests": 1.0,
    }
    reasons = labelled(found, "cspace_failures_total", "reason")
    counts = {name: value(found, "cspace_failures_total", reason=name) for name in reasons}
    assert {name: count for name, count in counts.items() if count} == expected
    assert reasons == {problem.name for problem in PROBLEMS}


def test_stages_samples_and_acceptance_are_those_of_the_answers(
    own_api: ApiClient, registry: CountingRegistry
) -> None:
    fields = {"model": "cspace-sampler@scored", "min_confidence": "0.5", "n": "50", "seed": "1"}
    answers = [own_api.post("/sample", files={"image": PNG}, data=fields).json() for _ in range(2)]
    own_api.post("/sample", files={"image": PNG}, data={"n": "0"})
    found = scrape(own_api)
    for stage in STAGES:
        assert value(found, "cspace_stage_seconds_count", stage=stage) == 2
        total = sum(answer["timing_ms"][stage] for answer in answers) / 1e3
        assert value(found, "cspace_stage_seconds_sum", stage=stage) == pytest.approx(total)
    assert value(found, "cspace_samples_requested_total") == 100
    assert value(found, "cspace_samples_returned_total") == sum(len(a["samples"]) for a in answers)
    total = sum(answer["acceptance"] for answer in answers)
    assert value(found, "cspace_acceptance_ratio_sum") == pytest.approx(total)
    assert value(found, "cspace_fallback_answers_total") == 0


def test_the_open_inference_protocol_is_counted_as_its_own_pages(own_api: ApiClient) -> None:
    request = {
        "inputs": [json_input(np.stack([picture(), picture()]))],
        "parameters": {"n": 3, "seed": 1},
    }
    answer = own_api.post("/v2/models/cspace-sampler/infer", json=request)
    assert answer.status_code == 200, answer.text
    assert answer.headers["x-request-id"]
    own_api.post("/v2/models/cspace-sampler/infer", json={**request, "colour": "red"})
    found = scrape(own_api)
    page = {"route": "/v2/models/{model}/infer", "method": "POST"}
    assert value(found, "cspace_requests_total", **page, status="200") == 1
    assert value(found, "cspace_requests_total", **page, status="400") == 1
    assert value(found, "cspace_failures_total", reason="invalid-value") == 1
    assert value(found, "cspace_samples_requested_total") == 6
    assert value(found, "cspace_stage_seconds_count", stage="total") == 1


def test_fallback_answers_and_the_model_in_service_follow_the_registry(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    api = start_api(registry)
    api.post("/sample", files={"image": PNG}, data={"n": "3"})
    found = scrape(api)
    assert value(found, "cspace_fallback_answers_total") == 1
    assert labelled(found, "cspace_model_info", "fallback") == {"true"}
    registry.add(bundles["plain"], "champion")
    api.refresh()
    api.post("/sample", files={"image": PNG}, data={"n": "3"})
    found = scrape(api)
    digest = Bundle.load(bundles["plain"]).digest
    model = {"name": "cspace-sampler", "version": "1", "digest": digest, "fallback": "false"}
    assert value(found, "cspace_model_info", **model) == 1
    assert labelled(found, "cspace_model_info", "version") == {"1"}
    assert value(found, "cspace_fallback_answers_total") == 1


def test_reloads_are_counted_by_outcome_and_reason(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path], tmp_path: Path
) -> None:
    api = start_api(registry)

    def counts() -> dict[str, float]:
        found = scrape(api)
        return {
            reason: value(found, "cspace_model_reloads_total", outcome=outcome, reason=reason)
            for outcome, reason in (
                ("served", "none"),
                ("refused", "bundle"),
                ("refused", "golden"),
                ("refused", "registry"),
                ("refused", "storage"),
            )
        }

    assert set(counts().values()) == {0}
    registry.add(bundles["plain"], "champion")
    api.refresh()
    api.refresh()
    registry.add(bundles["other"], "champion", digest="0" * 64)
    api.refresh()
    registry.add(with_another_answer(bundles["other"], tmp_path / "lying"), "champion")
    api.refresh()
    assert counts() == {"none": 1, "bundle": 1, "golden": 1, "registry": 0, "storage": 0}


def with_another_answer(bundle: Path, folder: Path) -> Path:
    """A bundle whose sums are right and whose golden samples are not what it gives."""
    shutil.copytree(bundle, folder)
    golden = folder / "golden.npz"
    case = GoldenCase.from_npz(golden.read_bytes())
    golden.write_bytes(replace(case, samples=-case.samples).to_npz())
    sums = folder / "SHA256SUMS"
    lines = [line.split("  ") for line in sums.read_text().splitlines()]
    sums.write_text(
        "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for _, name in lines)
    )
    return folder


def test_a_scrape_sees_itself_in_flight_and_nothing_stays_there(api: ApiClient) -> None:
    for _ in range(2):
        assert value(scrape(api), "cspace_requests_in_flight") == 1
