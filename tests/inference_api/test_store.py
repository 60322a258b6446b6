import logging
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError, RegistryUnavailableError, StorageError
from inference_api.failures import ModelNotReadyError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderHere
from inference_api.models.bundle_cache import RETRY_S, BundleCache
from inference_api.models.shipped import ShippedModels
from inference_api.models.store import ModelStore
from services.registry.references import PRETRAINED, ModelReference
from tests.inference_api.client import ApiClient
from tests.inference_api.clock import Clock
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock) -> ModelStore:
    return make_store(tmp_path, registry, bundles, clock)


def make_store(
    folder: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> ModelStore:
    loader = LoaderHere(disk := DiskCache(folder / "cache"), registry)
    cache = BundleCache(disk, loader, 2, clock)
    store = ModelStore(
        registry, cache, ShippedModels({PRETRAINED: bundles["shipped"]}), "cspace-sampler", 2.0, clock
    )
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
    before = registry.asked
    for model in ("cspace-sampler", "cspace-sampler@champion", "pretrained"):
        assert own_api.post("/sample", files={"image": png}, data={"model": model}).status_code == 200
    assert own_api.get("/health/ready").status_code == 200
    assert registry.asked == before


def test_a_champion_that_comes_later_takes_over_from_the_shipped_model(
    start_api: StartApi, png: bytes, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    api = start_api(registry)
    assert api.post("/sample", files={"image": png}).json()["model"]["fallback"] is True
    registry.add(bundles["plain"], "champion")
    api.refresh()
    assert api.post("/sample", files={"image": png}).json()["model"]["fallback"] is False


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
    assert registry.asked == 1
    clock.now += 2.1
    with pytest.raises(RegistryUnavailableError):
        store.resolve(ModelReference.parse("cspace-sampler/1"))
    assert registry.asked == 2


def test_a_lookup_is_trusted_for_a_while_and_then_asked_again(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "challenger")
    registry.add(bundles["other"])
    assert served(store, "cspace-sampler@challenger")[1] == 1
    registry.set_alias("cspace-sampler", "challenger", 2)
    asked = registry.asked
    assert served(store, "cspace-sampler@challenger")[1] == 1
    assert registry.asked == asked
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


def test_a_registry_that_was_set_up_anew_is_not_answered_from_the_old_ones_cache(
    store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    store.refresh()
    registry.start_anew()
    registry.add(bundles["other"], "champion")
    store.refresh()
    clock.now += 2.1
    digest = Bundle.load(bundles["other"]).digest
    for text in ("cspace-sampler", "cspace-sampler/1"):
        assert store.resolve(ModelReference.parse(text)).bundle.digest == digest


def test_a_damaged_copy_in_the_cache_is_fetched_anew(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    make_store(tmp_path, registry, bundles, clock).refresh()
    (copy,) = (tmp_path / "cache").glob("cspace-sampler/*/bundle/generator.onnx")
    copy.write_bytes(b"torn")
    after = make_store(tmp_path, registry, bundles, clock)
    after.refresh()
    assert served(after) == ("cspace-sampler", 1)
    assert registry.downloads == 2


def test_a_sound_copy_in_the_cache_is_not_fetched_again(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    registry.add(bundles["plain"], "champion")
    for _ in range(2):
        store = make_store(tmp_path, registry, bundles, clock)
        store.refresh()
        assert served(store) == ("cspace-sampler", 1)
    assert registry.downloads == 1


def test_nothing_half_downloaded_is_left_behind(
    tmp_path: Path, store: ModelStore, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion", digest="2" * 64)
    store.refresh()
    assert [path.name for path in (tmp_path / "cache" / "cspace-sampler").iterdir()] == []


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
    disk = DiskCache(tmp_path / "cache", stored=2)
    loader = LoaderHere(disk, registry)
    cache = BundleCache(disk, loader, 1)
    store = ModelStore(
        registry, cache, ShippedModels({PRETRAINED: bundles["shipped"]}), "cspace-sampler", 0.0
    )
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


def test_a_cache_that_cannot_be_written_leaves_what_is_in_service(
    tmp_path: Path, registry: CountingRegistry, bundles: dict[str, Path], clock: Clock
) -> None:
    (tmp_path / "cache").write_text("a file where a folder should be")
    store = make_store(tmp_path, registry, bundles, clock)
    registry.add(bundles["plain"], "champion")
    store.refresh()
    assert served(store) == ("pretrained", 0)
    with pytest.raises(StorageError, match="CSPACE_MODEL_CACHE"):
        store.resolve(ModelReference.parse("cspace-sampler/1"))
