"""A challenger that is compared with the champion's plans, off the caller's path."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.query import PlanQuery
from services.outcomes import files_of
from services.registry.promotion import shadow
from tests.bundles import tiny_graphs, tiny_spec
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.test_metrics import scrape, value
from tests.inference_api.test_plan import PNG, PROBLEM, WORLD, ask

CHAMPION, CHALLENGER = f"{MODEL}/1", f"{MODEL}/2"


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle whose plans are less likely to be free than its head says."""
    spec = replace(tiny_spec(), confidence_threshold=0.45, plan_calibration=(0.5, 1.0))
    folder = tmp_path_factory.mktemp("doubtful") / "bundle"
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


@pytest.fixture
def versions(registry: CountingRegistry, bundles: dict[str, Path], doubtful: Path) -> CountingRegistry:
    """A champion and a challenger, both with validity heads."""
    registry.add(bundles["careful"], "champion")
    registry.add(doubtful, "challenger")
    return registry


@contextmanager
def api_beside(folder: Path, bundles: dict[str, Path], registry: CountingRegistry) -> Iterator[ApiClient]:
    with api_over(folder, bundles, registry, outcomes_folder=folder / "outcomes") as client:
        yield client


def rows_in(folder: Path) -> list[dict[str, Any]]:
    texts = [path.read_text() for path in files_of(folder / "outcomes")]
    return [json.loads(line) for text in texts for line in text.splitlines()]


def counted(api: ApiClient, result: str, number: int) -> None:
    """Waits until so many plans have had a result."""
    until = time.monotonic() + 60.0
    while value(scrape(api), "cspace_shadow_total", result=result) != number:
        assert time.monotonic() < until
        time.sleep(0.05)


def plan(api: ApiClient, **fields: Any) -> Any:
    answer = ask(api, model=None, min_confidence=0.0, **fields)
    assert answer.status_code == 200, answer.text
    return answer


def test_the_champions_plan_is_scored_by_the_challenger_as_well(tmp_path, bundles, versions, doubtful):
    shadow(versions, versions.version(MODEL, 2), 1.0)
    with api_beside(tmp_path, bundles, versions) as api:
        answer = plan(api)
        counted(api, "compared", 1)
        assert answer.json()["model"]["version"] == 1
    (row,) = rows_in(tmp_path)
    assert (row["kind"], row["model"], row["beside"]) == ("shadow", CHALLENGER, CHAMPION)
    assert row["request_id"] == answer.headers["X-Request-ID"]
    assert row["confidence_beside"] == pytest.approx(answer.json()["confidence"], abs=1e-9)
    challenger = Bundle.load(doubtful)
    image = WORLD.sensor.decode(PNG)
    path = np.array(answer.json()["path"])
    assert row["confidence"] == pytest.approx(challenger.path_confidence(image, path), abs=1e-6)
    # exp(-exp(0.5 + log D)), where the champion, which has no calibration, says exp(-D).
    assert row["confidence"] == pytest.approx(row["confidence_beside"] ** np.exp(0.5), rel=1e-6)


def test_a_bundle_states_of_its_own_plan_what_the_plan_states(bundles):
    bundle, image = Bundle.load(bundles["careful"]), WORLD.sensor.decode(PNG)
    found = bundle.plan(image, PlanQuery(PROBLEM.start, PROBLEM.goal, 3, 0.0))
    assert bundle.path_confidence(image, found.path) == pytest.approx(found.confidence, abs=1e-9)


def test_without_the_alias_or_with_a_share_of_none_nothing_is_compared(tmp_path, bundles, versions):
    challenger = versions.version(MODEL, 2)
    shadow(versions, challenger, 0.5)
    shadow(versions, challenger, 0.0)
    with api_beside(tmp_path, bundles, versions) as api:
        for _ in range(3):
            plan(api)
        time.sleep(0.3)
        assert value(scrape(api), "cspace_shadow_total", result="compared") == 0
    assert rows_in(tmp_path) == []


def test_other_models_than_the_champion_are_not_compared(tmp_path, bundles, versions):
    shadow(versions, versions.version(MODEL, 2), 1.0)
    with api_beside(tmp_path, bundles, versions) as api:
        for model in (CHALLENGER, f"{MODEL}@challenger"):
            assert ask(api, model=model, min_confidence=0.0).status_code == 200
        time.sleep(0.3)
    assert rows_in(tmp_path) == []


def test_a_challenger_that_cannot_be_loaded_or_has_no_share_harms_no_answer(tmp_path, bundles, versions):
    versions.add(bundles["other"], "shadow", digest="0" * 64)
    versions.set_tags(MODEL, 3, {"shadow_share": "1"})
    with api_beside(tmp_path / "damaged", bundles, versions) as api:
        assert plan(api).json()["model"]["version"] == 1
        time.sleep(0.5)
        assert plan(api).json()["status"] == "solved"
    assert rows_in(tmp_path / "damaged") == []
    for share in ("much", "nan"):
        versions.set_tags(MODEL, 2, {"shadow_share": share})
        versions.set_alias(MODEL, "shadow", 2)
        with api_beside(tmp_path / share, bundles, versions) as api:
            assert plan(api).json()["status"] == "solved"
            time.sleep(0.3)
        assert rows_in(tmp_path / share) == []
