"""No request waits for the registry or for another's model: what is in memory, on its way, or unknown."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cspace.errors import BundleError, ModelNotFoundError, RegistryError
from inference_api.failures import ModelNotReadyError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderHere
from inference_api.models.bundle_cache import RETRY_S, BundleCache
from inference_api.models.registry_view import REMEMBERED
from inference_api.models.shipped import ShippedModels
from inference_api.models.store import ModelStore
from services.registry.models.port import ModelVersion
from services.registry.references import PRETRAINED, ModelReference
from tests.inference_api.clock import Clock
from tests.inference_api.fake_registry import MODEL, CountingRegistry


class SlowLoader(LoaderHere):
    """Downloads of a version wait until a test lets them go."""

    def __init__(self, disk: DiskCache, registry: CountingRegistry, slow: int) -> None:
        super().__init__(disk, registry)
        self._slow, self.free = slow, threading.Event()

    def download(self, version: ModelVersion) -> None:
        if version.number == self._slow:
            self.free.wait(20)
        super().download(version)


class Refusing(LoaderHere):
    """Refuses all, and counts how often it is asked."""

    asked = 0

    def verify(self, version: ModelVersion) -> None:
        self.asked += 1
        raise BundleError("loops")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def disk(tmp_path: Path) -> DiskCache:
    return DiskCache(tmp_path / "cache")


@pytest.fixture
def slow(disk: DiskCache, registry: CountingRegistry) -> SlowLoader:
    return SlowLoader(disk, registry, slow=2)


@pytest.fixture
def store(
    disk: DiskCache, registry: CountingRegistry, slow: SlowLoader, bundles: dict[str, Path], clock: Clock
) -> ModelStore:
    """Of a registry with three versions, the second of which takes long to download."""
    for name in ("plain", "other", "path"):
        registry.add(bundles[name])
    return store_over(registry, BundleCache(disk, slow, 4, clock), bundles, clock)


def store_over(
    registry: CountingRegistry, cache: BundleCache, bundles: dict[str, Path], clock: Clock
) -> ModelStore:
    store = ModelStore(
        registry, cache, ShippedModels({PRETRAINED: bundles["shipped"]}), MODEL, 2.0, clock, wait_s=0.3
    )
    store.load_shipped()
    return store


def reference(text: str) -> ModelReference:
    return ModelReference.parse(text)


def wait_until(condition: Callable[[], bool]) -> None:
    pause, until_s = threading.Event(), time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < until_s, "waited in vain"
        pause.wait(0.01)


def test_what_is_in_memory_is_answered_without_a_question(
    store: ModelStore, registry: CountingRegistry
) -> None:
    one = reference(f"{MODEL}/1")
    asked = registry.asked
    assert store.resolve_now(one) is None
    assert registry.asked == asked
    loaded = store.resolve(one)
    asked = registry.asked
    again = store.resolve_now(one)
    assert again is not None
    assert (again.bundle, again.version) == (loaded.bundle, 1)
    for text in (MODEL, "pretrained"):
        assert store.resolve_now(reference(text)) is not None
    assert registry.asked == asked


def test_what_was_unknown_a_moment_ago_is_not_asked_again(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    nobody = reference(f"{MODEL}@nobody")
    with pytest.raises(ModelNotFoundError):
        store.resolve(nobody)
    asked = registry.asked
    for ask in (store.resolve, store.resolve_now):
        with pytest.raises(ModelNotFoundError, match="the model is unknown"):
            ask(nobody)
    assert registry.asked == asked
    registry.add(bundles["scored"], "nobody")
    clock.now += 2.1
    assert store.resolve(nobody).version == 4


def test_names_that_nobody_knows_take_bounded_memory(store: ModelStore) -> None:
    view = store._view
    assert view is not None
    for number in range(REMEMBERED + 50):
        with pytest.raises(ModelNotFoundError):
            store.resolve(reference(f"nobody-{number}"))
    assert len(view._unknown) == REMEMBERED


def test_a_version_that_takes_long_is_told_as_on_its_way_and_delays_no_other(
    store: ModelStore, slow: SlowLoader, disk: DiskCache, registry: CountingRegistry
) -> None:
    on_disk = registry.version(MODEL, 1)
    disk.download(on_disk, registry.download)
    downloads = registry.downloads
    for _ in range(2):
        with pytest.raises(ModelNotReadyError, match="still being fetched"):
            store.resolve(reference(f"{MODEL}/2"))
    assert store.resolve(reference(f"{MODEL}/1")).version == 1
    slow.free.set()
    wait_until(lambda: store.resolve_now(reference(f"{MODEL}/2")) is not None)
    # Once, however many have asked.
    assert registry.downloads == downloads + 1


def test_a_champion_on_its_way_is_pending_and_then_served_without_another_look(
    store: ModelStore, slow: SlowLoader, registry: CountingRegistry
) -> None:
    registry.set_alias(MODEL, "champion", 2)
    store.refresh(wait_s=0.05)
    store.refresh(wait_s=0.05)
    assert (store.successor, store.resolve(reference(MODEL)).name) == ("pending", "pretrained")
    slow.free.set()
    wait_until(lambda: store.resolve(reference(MODEL)).version == 2)
    assert store.successor == "none"


def test_a_champion_that_is_no_more_when_it_arrives_is_not_served(
    store: ModelStore, slow: SlowLoader, registry: CountingRegistry
) -> None:
    registry.set_alias(MODEL, "champion", 2)
    store.refresh(wait_s=0.05)
    registry.drop_alias("champion")
    store.refresh(wait_s=0.05)
    slow.free.set()
    wait_until(lambda: store.loaded(registry.version(MODEL, 2)) is not None)
    assert store.resolve(reference(MODEL)).name == "pretrained"


def test_a_bundle_that_was_refused_is_not_verified_for_every_request(
    disk: DiskCache, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    loader = Refusing(disk, registry)
    store = store_over(registry, BundleCache(disk, loader, 4, clock), bundles, clock)
    store.refresh()
    assert store.successor == "refused"
    for _ in range(5):
        with pytest.raises(ModelNotReadyError, match="refused"):
            store.resolve(reference(f"{MODEL}/1"))
    assert loader.asked == 1
    # Nor at every look, and less and less often.
    asked = []
    for _ in range(20):
        clock.now += RETRY_S + 1.0
        store.refresh()
        asked.append(loader.asked)
    assert asked[0] == 2
    assert asked[-1] <= 6
    assert disk.stored(MODEL) == []


@pytest.mark.parametrize("false", ["../../elsewhere", "another", "..", ""])
def test_an_answer_about_another_model_is_refused_before_a_path_is_made(
    store: ModelStore,
    registry: CountingRegistry,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    false: str,
) -> None:
    before = sorted(tmp_path.rglob("*"))
    true = registry.version(MODEL, 1)
    monkeypatch.setattr(registry, "by_alias", lambda name, alias: replace(true, name=false))
    monkeypatch.setattr(registry, "version", lambda name, number: replace(true, name=false))
    monkeypatch.setattr(registry, "versions", lambda name: (replace(true, name=false),))
    store.refresh()
    with pytest.raises(RegistryError):
        store.resolve(reference(f"{MODEL}/1"))
    assert store.versions(MODEL) == []
    assert store.resolve(reference(MODEL)).name == "pretrained"
    assert sorted(tmp_path.rglob("*")) == before


def test_another_number_than_was_asked_for_is_refused(
    store: ModelStore, registry: CountingRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    third = registry.version(MODEL, 3)
    monkeypatch.setattr(registry, "version", lambda name, number: third)
    with pytest.raises(RegistryError, match="another model"):
        store.resolve(reference(f"{MODEL}/1"))


def test_a_version_that_another_process_takes_away_is_fetched_anew(
    store: ModelStore, disk: DiskCache, registry: CountingRegistry, slow: SlowLoader, clock: Clock
) -> None:
    version = registry.version(MODEL, 1)
    disk.download(version, registry.download)
    verify = slow.verify

    def pruned(version: ModelVersion) -> None:
        slow.verify = verify  # type: ignore[method-assign]
        disk.remove(version)
        verify(version)

    slow.verify = pruned  # type: ignore[method-assign]
    assert store.resolve(reference(f"{MODEL}/1")).version == 1
