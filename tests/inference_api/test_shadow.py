"""A challenger that is compared with the champion's plans, off the caller's path."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.query import PlanQuery
from services.registry.promotion import shadow
from tests.bundles import tiny_graphs, tiny_spec
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.raw import until
from tests.inference_api.test_metrics import scrape, value
from tests.inference_api.test_outcomes import rows_in
from tests.inference_api.test_plan import PNG, PROBLEM, WORLD, ask

CHAMPION, CHALLENGER = f"{MODEL}/1", f"{MODEL}/2"


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle whose plans are less likely to be free than its head says."""
    spec = replace(tiny_spec(), confidence_threshold=0.45, plan_calibration=((0.5, 1.0),))
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


def plan(api: ApiClient, **fields: Any) -> Any:
    answer = ask(api, model=None, min_confidence=0.0, **fields)
    assert answer.status_code == 200, answer.text
    return answer


def test_the_champions_plan_is_scored_by_the_challenger_as_well(tmp_path, bundles, versions, doubtful):
    shadow(versions, versions.version(MODEL, 2), 1.0)
    with api_beside(tmp_path, bundles, versions) as api:
        answer = plan(api)
        until(partial(has_compared_one, api))
        assert answer.json()["model"]["version"] == 1
    (row,) = rows_in(tmp_path)
    assert (row["kind"], row["model"], row["beside"]) == ("shadow", CHALLENGER, CHAMPION)
    assert row["request_id"] == answer.headers["X-Request-ID"]
    assert row["confidence_beside"] == pytest.approx(answer.json()["confidence"], abs=1e-9)
    challenger = Bundle.load(doubtful)
    image = WORLD.read_picture(PNG)
    path = np.array(answer.json()["path"])
    assert row["confidence"] == pytest.approx(challenger.path_confidence(image, path), abs=1e-6)
    # exp(-exp(0.5 + log D)), where the champion, which has no calibration, says exp(-D).
    assert row["confidence"] == pytest.approx(row["confidence_beside"] ** np.exp(0.5), rel=1e-6)


def test_a_bundle_states_of_its_own_plan_what_the_plan_states(bundles):
    bundle, image = Bundle.load(bundles["careful"]), WORLD.read_picture(PNG)
    found = bundle.plan(image, PlanQuery(PROBLEM.start, PROBLEM.goal, 3, 0.0))
    assert bundle.path_confidence(image, found.path) == pytest.approx(found.confidence, abs=1e-9)


def test_other_models_than_the_champion_are_not_compared(tmp_path, bundles, versions):
    shadow(versions, versions.version(MODEL, 2), 1.0)
    versions.add(bundles["scored"], "other")
    with api_beside(tmp_path, bundles, versions) as api:
        for model in (f"{MODEL}/3", f"{MODEL}@other"):
            assert ask(api, model=model, min_confidence=0.0).status_code == 200
        answer = plan(api)
        until(partial(has_compared_one, api))
    assert [row["request_id"] for row in rows_in(tmp_path)] == [answer.headers["X-Request-ID"]]


def test_there_is_nothing_to_compare_without_the_alias_or_with_the_champion_itself(
    tmp_path, bundles, versions
):
    shadow(versions, versions.version(MODEL, 2), 0.5)
    assert compared_with(tmp_path / "one", bundles, versions) == (2, 0.5)
    shadow(versions, versions.version(MODEL, 2), 0.0)
    assert compared_with(tmp_path / "none", bundles, versions) is None
    shadow(versions, versions.version(MODEL, 1), 0.5)
    assert compared_with(tmp_path / "itself", bundles, versions) is None


@pytest.mark.parametrize("share", ["much", "nan", "0", "-1"])
def test_a_share_that_is_none_compares_nothing(share, tmp_path, bundles, versions):
    shadow(versions, versions.version(MODEL, 2), 0.5)
    versions.set_tags(MODEL, 2, {"shadow_share": share})
    assert compared_with(tmp_path, bundles, versions) is None


def test_a_challenger_that_cannot_be_loaded_harms_no_answer(tmp_path, bundles, versions):
    versions.add(bundles["other"], "shadow", digest="0" * 64)
    versions.set_tags(MODEL, 3, {"shadow_share": "1"})
    assert compared_with(tmp_path, bundles, versions) is None


def compared_with(folder: Path, bundles: dict[str, Path], registry: CountingRegistry) -> Any:
    """With which version and share the champion is compared, after it has answered; None for none."""
    with api_beside(folder, bundles, registry) as api:
        assert plan(api).json()["model"]["version"] == 1
        store = api.app.state.store
        found = store.shadow(store.default)
    return found and (found[0].version, found[1])


def has_compared_one(api: ApiClient) -> bool:
    return value(scrape(api), "cspace_shadow_total", result="compared") == 1
