"""What answers which reference, over a registry in this process."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import (
    BundleError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
)
from inference_api.models.cache import RETRY_S, BundleCache, DiskCache
from inference_api.models.served import ShippedModels
from inference_api.models.store import IN_USE_S, ModelStore
from inference_api.problem_types import ModelNotReadyError
from services.registry.entities import PRETRAINED, ModelReference, ModelVersion
from tests.inference_api.client import ApiClient
from tests.inference_api.clock import Clock
from tests.inference_api.fake_registry import MODEL, CountingRegistry
from tests.inference_api.raw import until

CHALLENGER = ModelReference.parse(f"{MODEL}@challenger")
# Of the background's next look: the pause, and what the look itself takes.
POLL_S = 2.1


class SlowRegistry(CountingRegistry):
    """Downloads of the second version wait until a test lets them go."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.free = threading.Event()

    def download(self, version: ModelVersion, folder: Path) -> Path:
        if version.number == 2:
            self.free.wait(20)
        return super().download(version, folder)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock) -> ModelStore:
    return make_store(tmp_path, registry, bundles, clock)


@pytest.fixture
def slow(tmp_path: Path, bundles: dict[str, Path]) -> SlowRegistry:
    """With three versions."""
    registry = SlowRegistry(tmp_path / "slow")
    for name in ("plain", "other", "path"):
        registry.add(bundles[name])
    return registry


@pytest.fixture
def impatient(tmp_path: Path, slow: SlowRegistry, bundles: dict[str, Path], clock: Clock) -> ModelStore:
    return make_store(tmp_path, slow, bundles, clock, wait_s=0.3)


def verify_here(folder: Path, digest: str) -> None:
    Bundle.load(folder, digest=digest)


def make_store(
    folder: Path,
    registry: CountingRegistry,
    bundles: dict[str, Path],
    clock: Callable[[], float] = time.monotonic,
    *,
    verify: Callable[[Path, str], object] = verify_here,
    capacity: int = 2,
    stored: int = 20,
    wait_s: float = 30.0,
) -> ModelStore:
    cache = BundleCache(DiskCache(folder / "cache", stored), registry, verify, capacity, clock)
    shipped = ShippedModels({PRETRAINED: bundles["shipped"]})
    store = ModelStore(registry, cache, shipped, MODEL, 2.0, clock, wait_s=wait_s)
    store.load_shipped()
    return store


def served(store: ModelStore, text: str = "cspace-sampler") -> tuple[str, int]:
    found = store.resolve(ModelReference.parse(text))
    return found.name, found.version


def test_a_promotion_is_served_without_a_restart(
    own_api: ApiClient, png: bytes, registry: CountingRegistry
) -> None:
    first = own_api.post("/sample", files={"image": png}).json()["model"]
    registry.set_alias("cspace-sampler", "champion", 2)
    assert own_api.post("/sample", files={"image": png}).json()["model"] == first
    own_api.refresh()
    second = own_api.post("/sample", files={"image": png}).json()["model"]
    assert (first["version"], second["version"]) == (1, 2)
    assert first["digest"] != second["digest"]


def test_no_request_for_the_champion_waits_for_the_registry(
    own_api: ApiClient, png: bytes, registry: CountingRegistry
) -> None:
    before = registry.calls
    for model in ("cspace-sampler", "cspace-sampler@champion", "pretrained"):
        assert own_api.post("/sample", files={"image": png}, data={"model": model}).status_code == 200
    assert own_api.get("/health/ready").status_code == 200
    assert registry.calls == before


def test_a_registry_that_goes_away_leaves_what_is_loaded(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.add(bundles["other"], "challenger")
    store.refresh()
    assert served(store, "cspace-sampler@challenger") == ("cspace-sampler", 2)
    registry.away = True
    clock.now += 60
    store.refresh()
    assert store.registry_state == "unreachable"
    assert served(store) == ("cspace-sampler", 1)
    assert served(store, "cspace-sampler/1") == ("cspace-sampler", 1)
    assert served(store, "cspace-sampler@challenger") == ("cspace-sampler", 2)
    registry.away = False
    registry.set_alias("cspace-sampler", "champion", 2)
    store.refresh()
    assert (store.registry_state, served(store)) == ("reachable", ("cspace-sampler", 2))


def test_a_restart_while_the_registry_is_away_serves_the_last_champion(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.add(bundles["other"])
    before = make_store(tmp_path, registry, bundles, clock)
    before.refresh()
    registry.set_alias("cspace-sampler", "champion", 2)
    before.refresh()
    registry.away = True
    after = make_store(tmp_path, registry, bundles, clock)
    after.refresh()
    assert served(after) == ("cspace-sampler", 2)
    assert served(after, "cspace-sampler/1") == ("cspace-sampler", 1)
    assert [version.number for version in after.versions("cspace-sampler")] == [2, 1]


def test_an_absent_registry_is_left_alone_for_a_while(
    store: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    registry.away = True
    for _ in range(5):
        with pytest.raises(RegistryUnavailableError):
            store.resolve(ModelReference.parse("cspace-sampler/1"))
    assert registry.calls == 1
    clock.now += 2.1
    with pytest.raises(RegistryUnavailableError):
        store.resolve(ModelReference.parse("cspace-sampler/1"))
    assert registry.calls == 2


def test_a_lookup_is_trusted_for_a_while_and_then_asked_again(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "challenger")
    registry.add(bundles["other"])
    assert served(store, "cspace-sampler@challenger")[1] == 1
    registry.set_alias("cspace-sampler", "challenger", 2)
    calls = registry.calls
    assert served(store, "cspace-sampler@challenger")[1] == 1
    assert registry.calls == calls
    clock.now += 2.1
    assert served(store, "cspace-sampler@challenger")[1] == 2


def test_a_refused_successor_leaves_the_champion_and_is_tried_again_later(
    store: ModelStore,
    registry: CountingRegistry,
    bundles: dict[str, Path],
    clock: Clock,
    caplog: pytest.LogCaptureFixture,
) -> None:
    registry.add(bundles["plain"], "champion")
    store.refresh()
    registry.add(bundles["other"], "champion", digest="1" * 64)
    with caplog.at_level(logging.WARNING):
        store.refresh()
        store.refresh()
    assert served(store) == ("cspace-sampler", 1)
    assert caplog.text.count("cannot follow") == 1
    downloads = registry.downloads
    clock.now += RETRY_S + 1
    store.refresh()
    assert registry.downloads == downloads + 1


def test_a_champion_without_a_digest_is_refused(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion", digest="")
    store.refresh()
    assert served(store) == ("pretrained", 0)
    with pytest.raises(ModelNotReadyError, match="digest"):
        store.resolve(ModelReference.parse("cspace-sampler/1"))


def test_a_dropped_alias_brings_the_shipped_model_back(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    store.refresh()
    registry.drop_alias("champion")
    store.refresh()
    found = store.resolve(ModelReference.parse("cspace-sampler"))
    assert (found.name, found.fallback) == ("pretrained", True)
    with pytest.raises(ModelNotFoundError):
        store.resolve(ModelReference.parse("cspace-sampler@champion"))


def test_a_registry_that_was_set_up_again_is_not_answered_from_the_old_ones_cache(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    store.refresh()
    registry.start_again()
    registry.add(bundles["other"], "champion")
    store.refresh()
    clock.now += 2.1
    digest = Bundle.load(bundles["other"]).digest
    for text in ("cspace-sampler", "cspace-sampler/1"):
        assert store.resolve(ModelReference.parse(text)).bundle.digest == digest


def test_a_sound_copy_in_the_cache_is_not_fetched_again_and_a_damaged_one_is(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")

    def downloads_after_a_start() -> int:
        store = make_store(tmp_path, registry, bundles, clock)
        store.refresh()
        assert served(store) == ("cspace-sampler", 1)
        return registry.downloads

    assert [downloads_after_a_start() for _ in range(2)] == [1, 1]
    (copy,) = (tmp_path / "cache").glob("cspace-sampler/*/bundle/generator.onnx")
    copy.write_bytes(b"torn")
    assert downloads_after_a_start() == 2


def test_the_least_recently_used_bundle_leaves_memory_first(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    for name in ("plain", "other", "path"):
        registry.add(bundles[name])
    for text in ("cspace-sampler/1", "cspace-sampler/2", "cspace-sampler/1", "cspace-sampler/3"):
        served(store, text)
    loaded = {version.number for version in store.versions("cspace-sampler") if store.loaded(version)}
    assert loaded == {1, 3}
    assert served(store, "cspace-sampler/2") == ("cspace-sampler", 2)


def test_the_versions_used_last_and_the_champion_stay_on_disk(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    store = make_store(tmp_path, registry, bundles, capacity=1, stored=2)
    registry.add(bundles["plain"], "champion")
    store.refresh()
    for name in ("other", "path", "scored"):
        registry.add(bundles[name])

    def kept() -> set[str]:
        return {path.name.partition("-")[0] for path in (tmp_path / "cache" / "cspace-sampler").glob("*-*")}

    for text in ("cspace-sampler/2", "cspace-sampler/3"):
        served(store, text)
    assert kept() == {"1", "2", "3"}
    # Used again from disk, so that the third is the one that was left alone for longest.
    served(store, "cspace-sampler/2")
    assert registry.downloads == 3
    served(store, "cspace-sampler/4")
    assert kept() == {"1", "2", "4"}
    assert served(store, "cspace-sampler/3") == ("cspace-sampler", 3)


def asked_for(registry: CountingRegistry, store: ModelStore, reference: ModelReference) -> tuple[int, bool]:
    """The version that a request gets, and whether it asks the registry for it."""
    before = registry.calls
    return store.resolve(reference).version, registry.calls > before


def test_what_is_in_memory_is_answered_without_a_question(impatient: ModelStore, slow: SlowRegistry) -> None:
    one, before = ModelReference.parse(f"{MODEL}/1"), slow.calls
    assert impatient.resolve_now(one) is None
    assert slow.calls == before
    loaded = impatient.resolve(one)
    calls = slow.calls
    again = impatient.resolve_now(one)
    assert again is not None
    assert (again.bundle, again.version) == (loaded.bundle, 1)
    for text in (MODEL, "pretrained"):
        assert impatient.resolve_now(ModelReference.parse(text)) is not None
    assert slow.calls == calls


def test_what_was_unknown_a_moment_ago_is_not_asked_again(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    nobody = ModelReference.parse(f"{MODEL}@nobody")
    with pytest.raises(ModelNotFoundError):
        store.resolve(nobody)
    calls = registry.calls
    for ask in (store.resolve, store.resolve_now):
        with pytest.raises(ModelNotFoundError, match="the model is unknown"):
            ask(nobody)
    assert registry.calls == calls
    registry.add(bundles["scored"], "nobody")
    clock.now += POLL_S
    assert store.resolve(nobody).version == 1


def test_a_version_that_takes_long_is_told_as_on_its_way_and_delays_no_other(
    tmp_path: Path, impatient: ModelStore, slow: SlowRegistry
) -> None:
    DiskCache(tmp_path / "cache").download(slow.version(MODEL, 1), slow.download)
    downloads = slow.downloads
    for _ in range(2):
        with pytest.raises(ModelNotReadyError, match="still being fetched"):
            served(impatient, f"{MODEL}/2")
    assert served(impatient, f"{MODEL}/1") == (MODEL, 1)
    slow.free.set()
    until(lambda: impatient.resolve_now(ModelReference.parse(f"{MODEL}/2")) is not None)
    # Once, however many have asked.
    assert slow.downloads == downloads + 1


def test_too_many_versions_at_once_are_refused_and_the_champion_is_not_among_them(
    impatient: ModelStore, slow: SlowRegistry, bundles: dict[str, Path]
) -> None:
    for number in range(18):
        for _ in range(2):
            slow.add(bundles["plain"], name=f"other-{number}")
    waiting = [
        threading.Thread(target=partial(resolve_anyway, impatient, f"other-{number}/2"), daemon=True)
        for number in range(16)
    ]
    for thread in waiting:
        thread.start()
    for thread in waiting:
        thread.join()
    with pytest.raises(ModelNotReadyError, match="too many"):
        served(impatient, "other-17/2")
    slow.set_alias(MODEL, "champion", 1)
    impatient.refresh()
    assert served(impatient) == (MODEL, 1)
    slow.free.set()


def resolve_anyway(store: ModelStore, text: str) -> None:
    with pytest.raises(ModelNotReadyError):
        served(store, text)


def test_a_champion_on_its_way_is_pending_and_then_served_without_another_look(
    impatient: ModelStore, slow: SlowRegistry
) -> None:
    slow.set_alias(MODEL, "champion", 2)
    impatient.refresh(wait_s=0.05)
    impatient.refresh(wait_s=0.05)
    assert (impatient.successor, served(impatient)[0]) == ("pending", "pretrained")
    slow.free.set()
    until(lambda: served(impatient)[1] == 2)
    assert impatient.successor == "none"


def test_a_champion_that_is_no_more_when_it_arrives_is_not_served(
    impatient: ModelStore, slow: SlowRegistry
) -> None:
    slow.set_alias(MODEL, "champion", 2)
    impatient.refresh(wait_s=0.05)
    slow.drop_alias("champion")
    impatient.refresh(wait_s=0.05)
    slow.free.set()
    until(lambda: impatient.loaded(slow.version(MODEL, 2)) is not None)
    assert served(impatient)[0] == "pretrained"


def test_a_bundle_that_was_refused_is_not_verified_for_every_request(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    verified: list[str] = []

    def refuse(folder: Path, digest: str) -> None:
        verified.append(digest)
        raise BundleError("loops")

    registry.add(bundles["plain"], "champion")
    store = make_store(tmp_path, registry, bundles, clock, verify=refuse)
    store.refresh()
    assert store.successor == "refused"
    for _ in range(5):
        with pytest.raises(ModelNotReadyError, match="refused"):
            served(store, f"{MODEL}/1")
    assert len(verified) == 1
    # Nor at every look, and less and less often.
    counts = []
    for _ in range(20):
        clock.now += RETRY_S + 1.0
        store.refresh()
        counts.append(len(verified))
    assert counts[0] == 2
    assert counts[-1] <= 6
    assert DiskCache(tmp_path / "cache").stored(MODEL) == []


@pytest.mark.parametrize("false", ["../../elsewhere", "another"])
def test_an_answer_about_another_model_is_refused_before_a_path_is_made(
    impatient: ModelStore, slow: SlowRegistry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, false: str
) -> None:
    before = sorted(tmp_path.rglob("*"))
    wrong = replace(slow.version(MODEL, 1), name=false)
    monkeypatch.setattr(slow, "by_alias", lambda name, alias: wrong)
    monkeypatch.setattr(slow, "version", lambda name, number: wrong)
    monkeypatch.setattr(slow, "versions", lambda name: (wrong,))
    impatient.refresh()
    with pytest.raises(RegistryError, match="another model"):
        served(impatient, f"{MODEL}/1")
    assert impatient.versions(MODEL) == []
    assert served(impatient)[0] == "pretrained"
    assert sorted(tmp_path.rglob("*")) == before


def test_another_number_than_was_asked_for_is_refused(
    impatient: ModelStore, slow: SlowRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    third = slow.version(MODEL, 3)
    monkeypatch.setattr(slow, "version", lambda name, number: third)
    with pytest.raises(RegistryError, match="another model"):
        served(impatient, f"{MODEL}/1")


def test_a_version_that_another_process_takes_away_is_fetched_again(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"])
    disk, taken = DiskCache(tmp_path / "cache"), []

    def verify(folder: Path, digest: str) -> None:
        if not taken:
            taken.append(digest)
            disk.remove(registry.version(MODEL, 1))
        verify_here(folder, digest)

    assert served(make_store(tmp_path, registry, bundles, verify=verify), f"{MODEL}/1") == (MODEL, 1)
    assert registry.downloads == 2


@pytest.mark.parametrize("reference", [CHALLENGER, ModelReference.parse(f"{MODEL}/1")], ids=str)
def test_only_the_first_of_many_requests_asks_the_registry(
    store: ModelStore,
    registry: CountingRegistry,
    bundles: dict[str, Path],
    clock: Clock,
    reference: ModelReference,
) -> None:
    registry.add(bundles["plain"], "challenger")
    assert asked_for(registry, store, reference) == (1, True)
    for _ in range(5):
        store.refresh()
        clock.now += POLL_S
        assert asked_for(registry, store, reference) == (1, False)


@pytest.fixture
def challenged(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> ModelStore:
    """Of a registry with two versions, whose challenger, the first, a request has named."""
    registry.add(bundles["plain"], "challenger")
    registry.add(bundles["other"])
    store = make_store(tmp_path, registry, bundles, clock, capacity=1)
    store.resolve(CHALLENGER)
    return store


def test_a_successor_is_loaded_before_a_request_names_it(
    challenged: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    registry.set_alias(MODEL, "challenger", 2)
    clock.now += POLL_S
    challenged.refresh()
    found = challenged.resolve_now(CHALLENGER)
    assert found is not None
    assert (found.version, found.confirmed) == (2, True)


def test_what_did_not_change_is_not_loaded_again_after_it_left_memory(
    challenged: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    served(challenged, f"{MODEL}/2")
    clock.now += POLL_S
    challenged.refresh()
    assert challenged.loaded(registry.version(MODEL, 1)) is None


def test_a_reference_that_nobody_names_for_a_while_is_left_alone(
    challenged: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    clock.now += IN_USE_S + 1.0
    calls = registry.calls
    challenged.refresh()
    # For the champion alone.
    assert registry.calls == calls + 1
    assert asked_for(registry, challenged, CHALLENGER) == (1, True)


def test_an_alias_that_was_taken_away_is_unknown(
    challenged: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    registry.drop_alias("challenger")
    clock.now += POLL_S
    challenged.refresh()
    with pytest.raises(ModelNotFoundError):
        challenged.resolve(CHALLENGER)


def test_while_the_registry_is_away_it_is_asked_once_and_what_is_known_stays(
    challenged: ModelStore, registry: CountingRegistry, clock: Clock
) -> None:
    registry.away = True
    clock.now += POLL_S
    calls = registry.calls
    challenged.refresh()
    assert registry.calls == calls + 1
    assert asked_for(registry, challenged, CHALLENGER) == (1, False)


def test_a_successor_that_is_refused_is_fetched_once_and_told_to_the_request(
    challenged: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["other"], "challenger", digest="1" * 64)
    downloads = registry.downloads
    for _ in range(3):
        clock.now += POLL_S
        challenged.refresh()
    assert registry.downloads == downloads + 1
    with pytest.raises(ModelNotReadyError, match="cspace-sampler/3 is refused"):
        challenged.resolve(CHALLENGER)


def test_the_list_of_models_is_remembered_as_long_as_a_lookup(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    for number in range(20):
        registry.add(bundles["plain"], "champion", name=f"arm-{number}")
    before = registry.calls
    listed = store.listed()
    calls = registry.calls
    assert calls - before > 20
    assert store.listed() == listed
    assert registry.calls == calls
    registry.add(bundles["plain"], "champion", name="another")
    clock.now += 2.1
    assert {version.name for version in store.listed()} == {*(version.name for version in listed), "another"}
