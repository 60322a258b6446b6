"""``POST /outcomes``: what is kept, what is refused, and that a disk that refuses harms nothing else."""

import base64
import errno
import json
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cspace.worlds import robot_digest
from cspace_client import OutcomeSender, SamplingClient
from inference_api import app
from inference_api.keys import digest_of
from inference_api.settings import Protection
from services.outcomes import files_of
from tests.inference_api.answers import PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.client_transports import IntoApp
from tests.inference_api.conftest import api_over
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.test_metrics import scrape, value
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
    return partial(api_over, tmp_path, bundles, None, outcomes_folder=tmp_path / "outcomes")


def rows_in(place: Path) -> list[dict[str, Any]]:
    return [
        json.loads(line) for path in files_of(place / "outcomes") for line in path.read_text().splitlines()
    ]


def tell(api: ApiClient, *told: dict[str, Any], **options: Any) -> int:
    answer = api.post("/outcomes", json={"outcomes": told}, **options)
    assert answer.status_code == 202, answer.text
    kept: int = answer.json()["kept"]
    return kept


def counted(api: ApiClient, result: str, number: int) -> None:
    """Waits until so many outcomes have had a result."""
    until = time.monotonic() + 60.0
    while value(scrape(api), "cspace_outcomes_total", result=result) != number:
        assert time.monotonic() < until
        time.sleep(0.05)


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
    with keeping(protection=Protection(keys_file=keys)) as api:
        assert_problem(api.post("/outcomes", json={"outcomes": [PLAN]}), 401, "unauthorized")
        for name in ("one", "two"):
            tell(api, PLAN, headers={"authorization": f"Bearer csk_{name}"})
    assert [row["client"] for row in rows_in(tmp_path)] == ["one", "two"]


WRONG: list[tuple[object, str]] = [
    ([], "outcomes"),
    ([SAMPLES] * 1001, "outcomes"),
    ([SAMPLES, 7], "outcomes[1]"),
    ([{**PLAN, "kind": "route"}], "outcomes[0]"),
    ([{**PLAN, "success": None}], "outcomes[0].success"),
    ([{**PLAN, "collided": None}], "outcomes[0].collided_at"),
    ([{**PLAN, "time_s": -1}], "outcomes[0].time_s"),
    ([{**PLAN, "confidence": 2}], "outcomes[0].confidence"),
    ([{**PLAN, "request_id": "a b"}], "outcomes[0].request_id"),
    ([{**PLAN, "model": "cspace-sampler"}], "outcomes[0].model"),
    ([{**PLAN, "site": "x" * 65}], "outcomes[0].site"),
    ([{**PLAN, "picture": "aGVsbG8="}], "outcomes[0].picture"),
    ([{**SAMPLES, "free": 301}], "outcomes[0].free"),
    ([{**SAMPLES, "checked": 20_001}], "outcomes[0].checked"),
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


def test_a_full_disk_drops_and_counts_outcomes_and_nothing_else(
    keeping: Keeping, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "FLUSH_S", 0.01)
    write_bytes = Path.write_bytes

    def write_half(path: Path, data: bytes) -> int:
        write_bytes(path, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    with keeping() as api:
        tell(api, PLAN)
        counted(api, "kept", 1)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", write_half)
            assert tell(api, *({**SAMPLES, "request_id": str(number)} for number in range(3))) == 3
            counted(api, "storage", 3)
            assert_answers(api)
            assert api.get("/health/ready").status_code == 200
        # There is room again.
        tell(api, {**SAMPLES, "request_id": "later"})
    assert [row["request_id"] for row in rows_in(tmp_path)] == [PLAN["request_id"], "later"]
    assert len(list((tmp_path / "outcomes").iterdir())) == 2


def test_a_disk_that_hangs_holds_up_no_answer_and_a_bounded_number_waits(
    keeping: Keeping, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "FLUSH_S", 0.01)
    write_bytes, release = Path.write_bytes, threading.Event()

    def hang(path: Path, data: bytes) -> int:
        release.wait(60.0)
        return write_bytes(path, data)

    with keeping(outcomes_bytes=2**16) as api:
        monkeypatch.setattr(Path, "write_bytes", hang)
        kept = [tell(api, PLAN) for _ in range(40)]
        assert (kept[0], kept[-1]) == (1, 0)
        assert_answers(api)
        release.set()
        counted(api, "kept", sum(kept))


def test_the_folder_stays_within_its_bytes_and_the_oldest_go(
    keeping: Keeping, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "FLUSH_S", 0.01)
    sent = 0
    with keeping(outcomes_bytes=2**17) as api:
        while not value(scrape(api), "cspace_outcomes_total", result="space"):
            sent += tell(api, {**PLAN, "request_id": str(sent)})
            counted(api, "kept", sent)
            assert sum(path.stat().st_size + 4096 for path in files_of(tmp_path / "outcomes")) <= 2**17
            assert sent < 100
    kept = [row["request_id"] for row in rows_in(tmp_path)]
    assert 0 < len(kept) < sent
    assert kept == [str(number) for number in range(sent)][-len(kept) :]


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
    with api_over(tmp_path, bundles, registry, outcomes_folder=folder) as api:
        assert ask(api, model=None, keep=True).json()["kept"] is False
    assert rows_in(tmp_path) == []
    began = time.time()
    with api_over(tmp_path, bundles, registry, outcomes_folder=folder, kept_pictures_days=2.0) as api:
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
