"""``POST /outcomes``: what counts, what is refused, and that a disk that refuses harms nothing else."""

import base64
import json
import sqlite3
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cspace.worlds import robot_digest
from inference_api.auth import digest_of
from services.outcomes import DATABASE
from tests.inference_api.answers import assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.test_plan import ENDS, PNG, WORLD, ask
from tests.inference_api.test_telemetry import increase, scrape, value

Keeping = Callable[..., AbstractContextManager[ApiClient]]
REPORT = {"kind": "plan", "model": f"{MODEL}/1", "success": False, "collided": True, "collided_at": 0.25}
SAMPLES = {"kind": "samples", "request_id": "robot-1.7", "model": "pretrained/0", "checked": 300, "free": 297}


@pytest.fixture
def keeping(tmp_path: Path, bundles: dict[str, Path], registry: CountingRegistry) -> Keeping:
    """Starts an API that keeps outcomes in ``outcomes`` of the test's folder."""
    registry.add(bundles["careful"], "champion")
    return partial(api_over, tmp_path, bundles, registry, outcomes=tmp_path / "outcomes")


def rows_in(place: Path) -> list[dict[str, Any]]:
    if not (place / "outcomes" / DATABASE).exists():
        return []
    with closing(sqlite3.connect(place / "outcomes" / DATABASE)) as database:
        return [json.loads(line) for (line,) in database.execute("SELECT row FROM outcomes ORDER BY number")]


def planned(api: ApiClient, **more: Any) -> dict[str, Any]:
    """A report of a new plan."""
    answer = ask(api, model=None, **more)
    return REPORT | {"request_id": answer.headers["X-Request-ID"], "receipt": answer.json()["receipt"]}


def send(api: ApiClient, *reports: dict[str, Any], **options: Any) -> Any:
    return api.post("/outcomes", json={"outcomes": reports}, **options)


def test_a_plan_counts_as_what_its_answer_stated(keeping: Keeping, tmp_path: Path) -> None:
    with keeping() as api:
        report = planned(api)
        forged = {**report, "confidence": 0.999, "model": "other/7"}
        assert send(api, forged, {**report, "request_id": "other"}, SAMPLES).json() == {"kept": 2}
        # It is on disk by now.
        plan, samples = rows_in(tmp_path)
        for bad in ({}, {"receipt": None}, {"receipt": report["receipt"][:-1] + "x"}):
            problem = assert_problem(send(api, {**REPORT, "request_id": "r", **bad}), 422, "invalid-value")
            assert "match no answer" in problem["detail"]
    assert (plan["model"], plan["collided_at"], plan["client"]) == (f"{MODEL}/1", 0.25, None)
    assert 0.0 < plan["confidence"] < 0.999
    assert len(plan["problem"]) == 16
    assert samples["checked"] == 300


def test_a_receipt_is_of_one_client(keeping: Keeping, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.touch(0o600)
    keys.write_text(f"one:{digest_of('csk_one')}\ntwo:{digest_of('csk_two')}\n")
    own = {name: {"authorization": f"Bearer csk_{name}"} for name in ("one", "two")}
    with keeping(api_keys_file=keys) as api:
        body = {"image": base64.b64encode(PNG).decode(), "time_limit_s": 10.0, **ENDS}
        answer = api.post("/plan", json=body | {"min_confidence": 0.0}, headers=own["one"])
        report = REPORT | {"request_id": answer.headers["X-Request-ID"], "receipt": answer.json()["receipt"]}
        assert_problem(send(api, report), 401, "unauthorized")
        assert_problem(send(api, report, headers=own["two"]), 422, "invalid-value")
        assert send(api, report, headers=own["one"]).json() == {"kept": 1}
    assert [row["client"] for row in rows_in(tmp_path)] == ["one"]


WRONG: list[tuple[object, str]] = [
    ([], "outcomes"),
    ([SAMPLES] * 1001, "outcomes"),
    ([SAMPLES, 7], "outcomes.1"),
    ([{**SAMPLES, "kind": "route"}], "outcomes.0"),
    ([{**REPORT, "request_id": "r", "collided": None}], "outcomes.0.plan"),
    ([{**SAMPLES, "request_id": "a b"}], "outcomes.0.samples.request_id"),
    ([{**SAMPLES, "site": "x" * 65}], "outcomes.0.samples.site"),
    ([{**SAMPLES, "free": 301}], "outcomes.0.samples"),
]


def test_what_is_no_outcome_is_refused_by_name_and_nothing_of_its_batch_is_kept(
    keeping: Keeping, tmp_path: Path, api: ApiClient
) -> None:
    with keeping() as own:
        for reports, field in WRONG:
            problem = assert_problem(own.post("/outcomes", json={"outcomes": reports}), 422, "invalid-value")
            assert [one["field"] for one in problem["errors"]] == [field], problem
        form = own.post("/outcomes", data={"outcomes": "[]"}, files={"image": PNG})
        assert_problem(form, 415, "unsupported-media-type")
    assert rows_in(tmp_path) == []
    # A server without a folder keeps none.
    assert "CSPACE_OUTCOMES" in assert_problem(send(api, SAMPLES), 404, "no-outcomes")["remedy"]
    assert "receipt" not in ask(api).json()


def test_a_full_disk_refuses_outcomes_and_nothing_else(
    keeping: Keeping, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with keeping() as api:
        before = scrape(api)
        assert send(api, SAMPLES).json() == {"kept": 1}
        with monkeypatch.context() as patch:
            patch.setattr(sqlite3, "connect", full)
            assert send(api, {**SAMPLES, "request_id": "lost"}).json() == {"kept": 0}
        assert_answers(api)
        assert send(api, {**SAMPLES, "request_id": "later"}).json() == {"kept": 1}
        found = increase(before, scrape(api))
        counts = [value(found, "cspace_outcomes_total", result=name) for name in ("kept", "storage")]
    assert counts == [2, 1]
    assert [row["request_id"] for row in rows_in(tmp_path)] == ["robot-1.7", "later"]


def test_pictures_are_kept_only_of_plans_that_say_so_and_where_the_server_may(
    keeping: Keeping, tmp_path: Path
) -> None:
    with keeping() as api:
        assert ask(api, model=None, keep=True).json()["kept"] is False
    began = time.time()
    with keeping(outcomes_keep_days=2.0) as api:
        assert "kept" not in ask(api, model=None).json()
        answer = ask(api, model=None, keep=True)
        assert answer.json()["kept"] is True
        refused = ask(api, model=None, keep=True, min_confidence=1.0).json()
        assert (refused["status"], refused["kept"]) == ("refused", False)
    [row] = rows_in(tmp_path)
    assert row["request_id"] == answer.headers["X-Request-ID"]
    assert (row["kind"], row["model"], row["robot"]) == ("view", f"{MODEL}/1", robot_digest(WORLD))
    assert base64.b64decode(row["image"]) == PNG
    assert row["path"] == answer.json()["path"]
    assert 172_800.0 <= row["keep_until_s"] - began < 172_860.0
