"""``POST /outcomes``: what is kept, and what is refused."""

import base64
import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cspace.worlds import robot_digest
from cspace_client import OutcomeSender, SamplingClient
from inference_api.auth import digest_of
from services.outcomes import files_of
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp
from tests.inference_api.conftest import api_over
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.test_plan import PNG as PLANNED
from tests.inference_api.test_plan import WORLD, ask

Keeping = Callable[..., AbstractContextManager[ApiClient]]

PLAN = {
    "kind": "plan",
    "request_id": "robot-1.7",
    "model": "cspace-sampler/3",
    "stamp_s": 1.77e9,
    "confidence": 0.75,
    "novelty": None,
    "site": "cell-4",
    "success": False,
    "executed": True,
    "collided": True,
    "collided_at": 0.25,
    "time_s": 3,
}
SAMPLES = {
    "kind": "samples",
    "request_id": "robot-1.7",
    "model": "pretrained/0",
    "stamp_s": 1.77e9,
    "checked": 300,
    "free": 297,
}


@pytest.fixture
def keeping(tmp_path: Path, bundles: dict[str, Path]) -> Keeping:
    """Starts an API that keeps outcomes in ``outcomes`` of the test's folder."""
    return partial(api_over, tmp_path, bundles, None, outcomes=tmp_path / "outcomes")


def rows_in(place: Path) -> list[dict[str, Any]]:
    return [
        json.loads(line) for path in files_of(place / "outcomes") for line in path.read_text().splitlines()
    ]


def tell(api: ApiClient, *told: dict[str, Any], **options: Any) -> int:
    answer = api.post("/outcomes", json={"outcomes": told}, **options)
    assert answer.status_code == 202, answer.text
    kept: int = answer.json()["kept"]
    return kept


def test_outcomes_are_in_whole_files_when_the_server_has_ended(keeping: Keeping, tmp_path: Path) -> None:
    began = time.time()
    with keeping() as api:
        assert tell(api, PLAN, SAMPLES) == 2
        assert tell(api, {**SAMPLES, "request_id": "robot-1.8"}) == 1
    rows = rows_in(tmp_path)
    expected = {name: value for name, value in PLAN.items() if value is not None}
    assert rows[0] == expected | {"client": None, "received_s": rows[0]["received_s"]}
    assert began - 1 < rows[0]["received_s"] < time.time() + 1
    assert [row["request_id"] for row in rows] == ["robot-1.7", "robot-1.7", "robot-1.8"]
    assert {name: rows[1][name] for name in SAMPLES} == SAMPLES


def test_an_outcome_has_the_name_of_its_key(keeping: Keeping, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.touch(0o600)
    keys.write_text(f"one:{digest_of('csk_one')}\ntwo:{digest_of('csk_two')}\n")
    with keeping(api_keys_file=keys) as api:
        assert_problem(api.post("/outcomes", json={"outcomes": [PLAN]}), 401, "unauthorized")
        for name in ("one", "two"):
            tell(api, PLAN, headers={"authorization": f"Bearer csk_{name}"})
    assert [row["client"] for row in rows_in(tmp_path)] == ["one", "two"]


WRONG: list[tuple[object, str]] = [
    ([], "outcomes"),
    ([SAMPLES] * 1001, "outcomes"),
    ([SAMPLES, 7], "outcomes.1"),
    ([{**PLAN, "kind": "route"}], "outcomes.0"),
    ([{**PLAN, "success": None}], "outcomes.0.plan.success"),
    ([{**PLAN, "collided": None}], "outcomes.0.plan"),
    ([{**PLAN, "request_id": "a b"}], "outcomes.0.plan.request_id"),
    ([{**PLAN, "model": "cspace-sampler"}], "outcomes.0.plan.model"),
    ([{**PLAN, "site": "x" * 65}], "outcomes.0.plan.site"),
    ([{**PLAN, "picture": "aGVsbG8="}], "outcomes.0.plan.picture"),
    ([{**SAMPLES, "free": 301}], "outcomes.0.samples"),
]


def test_what_is_no_outcome_is_refused_by_name_and_nothing_of_its_batch_is_kept(
    keeping: Keeping, tmp_path: Path
) -> None:
    with keeping() as api:
        for told, field in WRONG:
            problem = assert_problem(api.post("/outcomes", json={"outcomes": told}), 422, "invalid-value")
            assert [one["field"] for one in problem["errors"]] == [field], problem
        form = api.post("/outcomes", data={"outcomes": "[]"}, files={"image": PNG})
        assert_problem(form, 415, "unsupported-media-type")
    assert rows_in(tmp_path) == []


def test_a_server_without_a_folder_says_that_it_keeps_nothing(api: ApiClient) -> None:
    problem = assert_problem(api.post("/outcomes", json={"outcomes": [PLAN]}), 404, "no-outcomes")
    assert "CSPACE_OUTCOMES" in problem["remedy"]


def test_the_client_reports_the_outcome_of_a_real_answer(keeping: Keeping, tmp_path: Path) -> None:
    with keeping() as api:
        into = IntoApp(api)
        with SamplingClient("http://localhost", transport=into) as client:
            batch = client.sample(PNG, 20, seed=7)
        with OutcomeSender("http://localhost", transport=into) as sender:
            sender.samples(batch, checked=20, free=19, site="cell-4")
        assert (sender.sent, sender.dropped) == (1, 0)
    [row] = rows_in(tmp_path)
    assert row["request_id"] == batch.request_id is not None
    assert (row["model"], row["checked"], row["free"]) == ("pretrained/0", 20, 19)


def test_pictures_are_kept_only_of_plans_that_say_so_and_where_the_server_may(
    tmp_path: Path, bundles: dict[str, Path], registry: CountingRegistry
) -> None:
    registry.add(bundles["careful"], "champion")
    folder = tmp_path / "outcomes"
    with api_over(tmp_path, bundles, registry, outcomes=folder) as api:
        assert ask(api, model=None, keep=True).json()["kept"] is False
    assert rows_in(tmp_path) == []
    began = time.time()
    with api_over(tmp_path, bundles, registry, outcomes=folder, outcomes_keep_days=2.0) as api:
        assert "kept" not in ask(api, model=None).json()
        answer = ask(api, model=None, keep=True)
        assert answer.json()["kept"] is True
        refused = ask(api, model=None, keep=True, min_confidence=1.0).json()
        assert (refused["status"], refused["kept"]) == ("refused", False)
    [row] = rows_in(tmp_path)
    assert row["request_id"] == answer.headers["X-Request-ID"]
    assert (row["kind"], row["model"], row["robot"]) == ("view", f"{MODEL}/1", robot_digest(WORLD))
    assert base64.b64decode(row["image"]) == PLANNED
    assert row["path"] == answer.json()["path"]
    assert 172_800.0 <= row["keep_until_s"] - began < 172_860.0
