"""References that requests name are looked up in the background, so that no request waits for that."""

from pathlib import Path

import pytest

from cspace.errors import ModelNotFoundError
from inference_api.models.apart.disk import DiskCache
from inference_api.models.apart.loading import LoaderHere
from inference_api.models.bundle_cache import BundleCache
from inference_api.models.registry_view import IN_USE_S, RegistryView
from services.registry.references import ModelReference
from tests.inference_api.clock import Clock
from tests.inference_api.fake_registry import MODEL, CountingRegistry

POLL_S = 2.0
CHALLENGER = ModelReference.parse(f"{MODEL}@challenger")


class Polled(Clock):
    """A clock that can go on to the background's next look."""

    def a_poll_later(self) -> None:
        """The time between two looks: the pause, and what the look itself takes."""
        self.now += POLL_S + 0.1


@pytest.fixture
def clock() -> Polled:
    return Polled()


@pytest.fixture
def cache(tmp_path: Path, registry: CountingRegistry, clock: Polled) -> BundleCache:
    disk = DiskCache(tmp_path / "cache")
    loader = LoaderHere(disk, registry)
    return BundleCache(disk, loader, 2, clock)


@pytest.fixture
def view(
    registry: CountingRegistry, cache: BundleCache, clock: Polled, bundles: dict[str, Path]
) -> RegistryView:
    """Of a registry with two versions, the first of which is the challenger."""
    registry.add(bundles["plain"], "challenger")
    registry.add(bundles["other"])
    return RegistryView(registry, cache, POLL_S, clock)


def asked_for(registry: CountingRegistry, view: RegistryView, reference: ModelReference) -> tuple[int, bool]:
    """The version that a request gets, and whether it asks the registry for it."""
    before = registry.asked
    return view.look_up(reference).number, registry.asked > before


@pytest.mark.parametrize("reference", [CHALLENGER, ModelReference.parse(f"{MODEL}/1")], ids=str)
def test_only_the_first_of_many_requests_asks_the_registry(
    view: RegistryView, registry: CountingRegistry, clock: Polled, reference: ModelReference
) -> None:
    assert asked_for(registry, view, reference) == (1, True)
    for _ in range(5):
        view.keep_up()
        clock.a_poll_later()
        assert asked_for(registry, view, reference) == (1, False)


def test_a_successor_is_loaded_before_a_request_names_it(
    view: RegistryView, registry: CountingRegistry, cache: BundleCache, clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    registry.set_alias(MODEL, "challenger", 2)
    clock.a_poll_later()
    view.keep_up()
    assert asked_for(registry, view, CHALLENGER) == (2, False)
    assert cache.peek(view.look_up(CHALLENGER)) is not None


def test_what_did_not_change_is_not_loaded_again_after_it_left_memory(
    view: RegistryView, registry: CountingRegistry, clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    clock.a_poll_later()
    view.keep_up()
    assert registry.downloads == 0


def test_a_reference_that_nobody_names_for_a_while_is_left_alone(
    view: RegistryView, registry: CountingRegistry, clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    clock.now += IN_USE_S + 1.0
    asked = registry.asked
    view.keep_up()
    assert registry.asked == asked
    assert asked_for(registry, view, CHALLENGER) == (1, True)


def test_an_alias_that_was_taken_away_is_unknown(
    view: RegistryView, registry: CountingRegistry, clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    registry.drop_alias("challenger")
    clock.a_poll_later()
    view.keep_up()
    with pytest.raises(ModelNotFoundError):
        view.look_up(CHALLENGER)


def test_while_the_registry_is_away_it_is_asked_once_and_what_is_known_stays(
    view: RegistryView, registry: CountingRegistry, clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    view.look_up(ModelReference.parse(f"{MODEL}/2"))
    registry.away = True
    clock.a_poll_later()
    asked = registry.asked
    view.keep_up()
    assert registry.asked == asked + 1
    assert asked_for(registry, view, CHALLENGER) == (1, False)


def test_a_successor_that_is_refused_is_fetched_once_and_told_to_the_request(
    view: RegistryView, registry: CountingRegistry, bundles: dict[str, Path], clock: Polled
) -> None:
    view.look_up(CHALLENGER)
    registry.add(bundles["other"], "challenger", digest="1" * 64)
    for _ in range(3):
        clock.a_poll_later()
        view.keep_up()
    assert registry.downloads == 1
    assert asked_for(registry, view, CHALLENGER) == (3, False)
