"""What answers which reference, over a registry in this process."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.errors import CspaceError, ModelNotFoundError, RegistryError, StorageError
from cspace.files import encode_png
from cspace.view_file import View
from inference_api.pictures import PictureCache
from inference_api.problems import ModelNotReadyError
from inference_api.served_models import BundleFolders, ModelStore
from inference_api.settings import ApiSettings
from services.registry.entities import ModelReference, ModelVersion
from tests.bundles import picture
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import MODEL, CountingRegistry

CHALLENGER = f"{MODEL}@challenger"


@pytest.fixture
def store(tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]) -> ModelStore:
    return make_store(tmp_path, registry, bundles)


def verify_here(folder: Path, digest: str) -> None:
    Bundle.load(folder, digest=digest)


def make_store(
    folder: Path,
    registry: CountingRegistry | None,
    bundles: dict[str, Path],
    verify: Callable[[Path, str], object] = verify_here,
    **settings: object,
) -> ModelStore:
    options = {"model_cache": folder / "cache", "pretrained_model": bundles["shipped"], "loaded_models": 2}
    made = ApiSettings.model_validate(options | {"model_poll_s": 0.1} | settings)
    store = ModelStore(made, None if registry is None else lambda: registry, verify)
    store.load_shipped()
    return store


def served(store: ModelStore, text: str = MODEL) -> tuple[str, int]:
    found = store.get(ModelReference.parse(text))
    return found.name, found.version


def test_a_promotion_is_served_without_a_restart_or_a_request_that_waits_for_it(
    own_api: ApiClient, png: bytes, registry: CountingRegistry
) -> None:
    first = own_api.post("/sample", files={"image": png}).json()["model"]
    registry.set_alias(MODEL, "champion", 2)
    assert own_api.post("/sample", files={"image": png}).json()["model"] == first
    own_api.refresh()
    calls = registry.calls
    for model in (MODEL, f"{MODEL}@champion", "pretrained"):
        second = own_api.post("/sample", files={"image": png}, data={"model": model})
        assert second.status_code == 200
        assert second.json()["model"]["version"] == (0 if model == "pretrained" else 2)
    assert own_api.get("/health/ready").status_code == 200
    assert registry.calls == calls


def test_requests_go_on_while_one_champion_follows_another(
    own_api: ApiClient, png: bytes, registry: CountingRegistry
) -> None:
    statuses: set[int] = set()
    ended = threading.Event()

    def ask() -> None:
        while not ended.is_set():
            statuses.add(own_api.post("/sample", files={"image": png}, data={"n": "1"}).status_code)

    asking = threading.Thread(target=ask)
    asking.start()
    for number in (2, 1, 4, 2):
        registry.set_alias(MODEL, "champion", number)
        own_api.refresh()
    ended.set()
    asking.join()
    assert statuses == {200}


def test_a_registry_that_goes_away_leaves_what_is_loaded(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.add(bundles["other"], "challenger")
    store.refresh()
    assert served(store, CHALLENGER) == (MODEL, 2)
    registry.away = True
    store.refresh()
    assert store.registry_state == "unreachable"
    for text, number in ((MODEL, 1), (CHALLENGER, 2)):
        found = store.get(ModelReference.parse(text))
        assert (found.version, found.confirmed) == (number, False)
    # It is asked once for all that ask meanwhile.
    calls = registry.calls
    for _ in range(3):
        with pytest.raises(RegistryError):
            served(store, f"{MODEL}/7")
    assert registry.calls == calls
    registry.away = False
    registry.set_alias(MODEL, "champion", 2)
    time.sleep(0.1)
    store.refresh()
    assert (store.registry_state, served(store)) == ("reachable", (MODEL, 2))
    assert store.get(ModelReference.parse(CHALLENGER)).confirmed


def test_a_restart_while_the_registry_is_away_serves_the_last_champion(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    make_store(tmp_path, registry, bundles).refresh()
    registry.away = True
    after = make_store(tmp_path, registry, bundles)
    after.refresh()
    assert served(after) == (MODEL, 1)
    assert after.default is not None
    assert not after.default.confirmed
    # What does not follow the format is only a copy.
    (champion,) = (tmp_path / "cache").rglob("champion.json")
    champion.write_text("{}")
    last = make_store(tmp_path, registry, bundles)
    last.refresh()
    assert served(last) == ("pretrained", 0)


@pytest.fixture
def reloads(store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]) -> list[str]:
    """What is told of champions by a store that follows one."""
    told: list[str] = []
    store.on_reload = told.append
    registry.add(bundles["plain"], "champion")
    store.refresh()
    return told


def test_a_champion_that_is_refused_is_logged_and_counted_once_and_what_is_served_stays(
    store: ModelStore,
    registry: CountingRegistry,
    bundles: dict[str, Path],
    caplog: pytest.LogCaptureFixture,
    reloads: list[str],
) -> None:
    registry.add(bundles["other"], "champion", digest="1" * 64)
    downloads = registry.downloads
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            store.refresh()
    assert caplog.text.count("cannot follow") == 1
    assert reloads == ["served", "refused"]
    # Equal sums are equal bytes, which were looked at once.
    assert registry.downloads == downloads + 1
    assert (served(store), store.successor) == ((MODEL, 1), "refused")
    assert store.default is not None
    assert not store.default.confirmed
    with pytest.raises(ModelNotReadyError, match="refused"):
        served(store, f"{MODEL}/2")


def test_a_champion_that_is_deleted_is_logged_and_counted_once_and_the_shipped_model_answers(
    store: ModelStore, registry: CountingRegistry, caplog: pytest.LogCaptureFixture, reloads: list[str]
) -> None:
    registry.drop_alias("champion")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            store.refresh()
    assert caplog.text.count("no champion any more") == 1
    assert reloads == ["served", "removed"]
    found = store.get(ModelReference.parse(MODEL))
    assert (found.name, found.fallback) == ("pretrained", True)
    with pytest.raises(ModelNotFoundError):
        served(store, f"{MODEL}@champion")


def test_a_registry_that_was_set_up_again_is_not_answered_from_the_old_ones_cache(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    store.refresh()
    served(store, f"{MODEL}/1")
    registry.start_again()
    registry.add(bundles["other"], "champion")
    time.sleep(0.11)
    store.refresh()
    digest = Bundle.load(bundles["other"]).digest
    for text in (MODEL, f"{MODEL}/1"):
        assert store.get(ModelReference.parse(text)).bundle.digest == digest


def test_a_sound_copy_in_the_cache_is_not_fetched_again_and_a_damaged_one_is(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")

    def downloads_after_a_start() -> int:
        store = make_store(tmp_path, registry, bundles)
        store.refresh()
        assert served(store) == (MODEL, 1)
        return registry.downloads

    assert [downloads_after_a_start() for _ in range(2)] == [1, 1]
    (copy,) = (tmp_path / "cache").glob(f"{MODEL}/*/generator.onnx")
    copy.write_bytes(b"torn")
    assert downloads_after_a_start() == 2


def test_the_least_recently_used_leave_memory_and_disk_first_and_the_champion_stays(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    store = make_store(tmp_path, registry, bundles, loaded_models=1, stored_models=2)
    registry.add(bundles["plain"], "champion")
    store.refresh()
    for name in ("other", "path", "scored"):
        registry.add(bundles[name])

    def kept() -> set[str]:
        return {path.name.partition("-")[0] for path in (tmp_path / "cache" / MODEL).glob("?-*")}

    for text in (f"{MODEL}/2", f"{MODEL}/3"):
        served(store, text)
    assert kept() == {"1", "2", "3"}
    assert [one.number for one in store.listing(MODEL) if store.loaded(one)] == [3, 1]
    # Used again from disk, so that the third is the one that was left alone for longest.
    served(store, f"{MODEL}/2")
    assert registry.downloads == 3
    served(store, f"{MODEL}/4")
    assert kept() == {"1", "2", "4"}


def test_an_alias_that_a_request_has_named_is_asked_for_once_in_a_poll(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "challenger")
    registry.add(bundles["other"])
    reference = ModelReference.parse(CHALLENGER)
    assert store.peek(reference) is None
    assert served(store, CHALLENGER)[1] == 1
    # In a poll of its own.
    time.sleep(0.11)
    assert served(store, CHALLENGER)[1] == 1
    calls = registry.calls
    assert [served(store, CHALLENGER)[1] for _ in range(3)] == [1, 1, 1]
    assert registry.calls == calls
    registry.set_alias(MODEL, "challenger", 2)
    time.sleep(0.11)
    assert served(store, CHALLENGER)[1] == 2
    registry.add(bundles["scored"], "challenger", digest="1" * 64)
    time.sleep(0.11)
    with pytest.raises(ModelNotReadyError, match="refused"):
        served(store, CHALLENGER)
    registry.drop_alias("challenger")
    time.sleep(0.11)
    with pytest.raises(ModelNotFoundError):
        store.get(reference)


def test_what_was_unknown_a_moment_ago_is_not_asked_again(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    nobody = f"{MODEL}@nobody"
    for _ in range(3):
        with pytest.raises(ModelNotFoundError, match="the model is unknown"):
            served(store, nobody)
    assert registry.calls == 1
    registry.add(bundles["scored"], "nobody")
    time.sleep(0.11)
    assert served(store, nobody) == (MODEL, 1)


def test_a_slow_download_delays_neither_the_champion_nor_what_is_in_memory(
    tmp_path: Path, bundles: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    free, begun = threading.Event(), threading.Event()

    class SlowRegistry(CountingRegistry):
        def download(self, version: ModelVersion, folder: Path) -> Path:
            if version.number == 2:
                begun.set()
                free.wait(20)
            return super().download(version, folder)

    slow = SlowRegistry(tmp_path / "slow")
    for name in ("plain", "other", "path"):
        slow.add(bundles[name])
    store = make_store(tmp_path, slow, bundles)
    served(store, f"{MODEL}/1")
    waiting = threading.Thread(target=lambda: served(store, f"{MODEL}/2"))
    waiting.start()
    begun.wait(20)
    slow.set_alias(MODEL, "champion", 3)
    store.refresh()
    assert (served(store), served(store, f"{MODEL}/1")) == ((MODEL, 3), (MODEL, 1))
    monkeypatch.setattr("inference_api.served_models.LOAD_WAIT_S", 0.1)
    with pytest.raises(ModelNotReadyError, match="being loaded"):
        served(store, f"{MODEL}/2")
    free.set()
    waiting.join()
    downloads = slow.downloads
    assert served(store, f"{MODEL}/2") == (MODEL, 2)
    assert slow.downloads == downloads


@pytest.mark.parametrize("false", [{"name": "../../elsewhere"}, {"name": "another"}, {"number": 3}])
def test_an_answer_about_another_model_is_refused_before_a_path_is_made(
    tmp_path: Path,
    store: ModelStore,
    registry: CountingRegistry,
    bundles: dict[str, Path],
    false: dict[str, object],
) -> None:
    registry.add(bundles["plain"])
    wrong = replace(registry.version(MODEL, 1), **false)  # type: ignore[arg-type]
    registry.version = lambda *_: wrong  # type: ignore[method-assign]
    with pytest.raises(RegistryError, match="another model"):
        served(store, f"{MODEL}/1")
    assert not (tmp_path / "cache").exists()


def test_stores_that_share_a_cache_never_fail_and_leave_nothing_behind(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    for name in ("plain", "other", "path"):
        registry.add(bundles[name])
    stores = [make_store(tmp_path, registry, bundles, loaded_models=1, stored_models=3) for _ in range(4)]
    failures: list[CspaceError] = []

    def use(store: ModelStore) -> None:
        for number in (1, 2, 3) * 3:
            try:
                served(store, f"{MODEL}/{number}")
            except CspaceError as error:
                failures.append(error)

    threads = [threading.Thread(target=use, args=(store,)) for store in stores]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert len(list((tmp_path / "cache" / MODEL).iterdir())) == 3


def test_a_cache_that_cannot_be_written_is_an_error_in_the_systems_words(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], start_api: StartApi, png: bytes
) -> None:
    (tmp_path / "cache").write_text("a file")
    registry.add(bundles["plain"])
    with pytest.raises(StorageError, match="Not a directory") as caught:
        BundleFolders(tmp_path / "cache", 1).fetch(registry.version(MODEL, 1), registry.download)
    assert str(tmp_path) not in str(caught.value)
    answer = start_api(registry).post("/sample", files={"image": png}, data={"model": f"{MODEL}/1"})
    assert (answer.status_code, answer.json()["type"].rpartition(":")[2]) == (503, "storage-unavailable")


def test_known_pictures_come_back_and_the_least_recently_used_are_dropped(bundles: dict[str, Path]) -> None:
    cache, bundle = PictureCache(2), Bundle.load(bundles["plain"])

    def is_known(shade: int) -> bool:
        view = View.of(encode_png(np.full_like(picture(), shade)))
        return cache.prepare(bundle, view, lambda: None).decode_ms == 0.0

    assert [is_known(shade) for shade in (250, 250, 251, 250, 252, 250, 251)] == [
        False, True, False, True, False, True, False
    ]  # fmt: skip
