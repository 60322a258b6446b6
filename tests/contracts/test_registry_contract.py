import json
from dataclasses import replace
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleIntegrityError, ModelNotFoundError, StorageError
from cspace.worlds import robot_digest
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION
from services.registry.entities import ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.bundles import write_tiny_bundle
from tests.contracts.conftest import Backend
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("bundles") / "first"))


@pytest.fixture(scope="session")
def other(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("bundles") / "other", scale=0.5))


@pytest.fixture
def run_id(tracking: Tracking) -> str:
    return tracking.start("contract", "global").run_id


@pytest.fixture
def first(registry: ModelRegistry, bundle: Bundle, run_id: str, model_name: str) -> ModelVersion:
    return registry.register(
        model_name, bundle.folder, run_id, bundle.digest, {"data_digest": "d1"}, alias=ALIAS_CHALLENGER
    )


def test_a_registered_bundle_is_version_one_with_its_lineage(
    registry: ModelRegistry, first: ModelVersion, bundle: Bundle, run_id: str, model_name: str
) -> None:
    assert (first.name, first.number, first.run_id) == (model_name, 1, run_id)
    assert first.digest == bundle.digest
    assert first.tags == {
        "data_digest": "d1",
        "digest": bundle.digest,
        "robot": robot_digest(bundle.spec.world),
        "world": json.dumps(bundle.spec.world.to_dict(), sort_keys=True),
    }
    assert first.aliases == (ALIAS_CHALLENGER,)
    assert first.created_ms > 1_600_000_000_000
    assert registry.version(model_name, 1) == first
    names = registry.names()
    assert model_name in names
    assert list(names) == sorted(names)


def test_the_same_bundle_of_the_same_run_is_registered_once(
    registry: ModelRegistry, first: ModelVersion, bundle: Bundle
) -> None:
    again = registry.register(
        first.name, bundle.folder, first.run_id, bundle.digest, {"preset": "quickstart"}
    )
    assert again.number == 1
    assert again.tags == {**first.tags, "preset": "quickstart"}
    assert registry.versions(first.name) == (again,)


def test_another_run_or_another_bundle_is_the_next_version(
    backend: Backend, first: ModelVersion, bundle: Bundle, other: Bundle
) -> None:
    registry, name = backend.registry, first.name
    run_id = backend.tracking.start("contract", "global").run_id
    assert registry.register(name, bundle.folder, run_id, bundle.digest, {}).number == 2
    assert registry.register(name, other.folder, run_id, other.digest, {}, alias=ALIAS_CHALLENGER).number == 3
    listed = registry.versions(name)
    assert [version.number for version in listed] == [3, 2, 1]
    assert [version.aliases for version in listed] == [(ALIAS_CHALLENGER,), (), ()]


def test_a_deleted_version_is_gone_and_its_number_is_not_given_again(
    backend: Backend, first: ModelVersion, bundle: Bundle, other: Bundle
) -> None:
    registry, name = backend.registry, first.name
    second = registry.register(name, other.folder, first.run_id, other.digest, {})
    registry.delete(name, second.number)
    assert registry.versions(name) == (registry.version(name, 1),)
    for call in (registry.version, registry.delete):
        with pytest.raises(ModelNotFoundError):
            call(name, second.number)
    run_id = backend.tracking.start("contract", "global").run_id
    assert registry.register(name, bundle.folder, run_id, bundle.digest, {}).number == 3


def test_an_alias_moves_from_one_version_to_another(
    registry: ModelRegistry, first: ModelVersion, other: Bundle
) -> None:
    registry.register(first.name, other.folder, first.run_id, other.digest, {})
    registry.set_alias(first.name, ALIAS_CHAMPION, 1)
    assert registry.by_alias(first.name, ALIAS_CHAMPION).aliases == (ALIAS_CHALLENGER, ALIAS_CHAMPION)
    registry.set_alias(first.name, ALIAS_CHAMPION, 2)
    assert registry.by_alias(first.name, ALIAS_CHAMPION).number == 2
    assert registry.version(first.name, 1).aliases == (ALIAS_CHALLENGER,)


def test_tags_are_added_to_those_that_are_there_and_taken_off_again(
    registry: ModelRegistry, first: ModelVersion
) -> None:
    words = 'it\'s 5 % "better" → yes'
    registry.set_tags(first.name, 1, {"note": words, "other": "stays", "data_digest": "d2"})
    changed = {**first.tags, "other": "stays", "data_digest": "d2"}
    assert registry.version(first.name, 1).tags == {**changed, "note": words}
    # One that is not there is no error.
    for _ in range(2):
        registry.remove_tag(first.name, 1, "note")
    assert registry.version(first.name, 1).tags == changed


def test_figures_of_a_version_are_shown_on_the_run_that_made_it_the_last_ones_hold(
    backend: Backend, first: ModelVersion
) -> None:
    for value in (0.5, 0.75):
        shown = ({"validation/precision": value}, "## not promoted", "planar scenes", "ab" * 32)
        backend.registry.show(first, *shown)
    assert backend.tracking.run(first.run_id).data.metrics["validation/precision"] == 0.75
    with pytest.raises(ModelNotFoundError):
        backend.registry.show(replace(first, number=99), *shown)


def test_a_downloaded_bundle_is_the_registered_one_and_no_folder_is_overwritten(
    registry: ModelRegistry, first: ModelVersion, bundle: Bundle, tmp_path: Path
) -> None:
    folder = registry.download(first, tmp_path / "models" / "bundle")
    assert folder == tmp_path / "models" / "bundle"
    assert Bundle.load(folder).digest == bundle.digest
    assert [entry.name for entry in folder.parent.iterdir()] == ["bundle"]
    with pytest.raises(StorageError):
        registry.download(first, folder)
    assert Bundle.load(folder).digest == bundle.digest


def test_what_is_not_there_is_not_found(registry: ModelRegistry, first: ModelVersion, tmp_path: Path) -> None:
    name = first.name
    gone = ModelVersion(name, 7, first.run_id, first.digest, (), {}, 0)
    for call in (
        lambda: registry.version(name, 7),
        lambda: registry.version("nobody", 1),
        lambda: registry.by_alias(name, ALIAS_CHAMPION),
        lambda: registry.by_alias("nobody", ALIAS_CHAMPION),
        lambda: registry.set_alias(name, ALIAS_CHAMPION, 7),
        lambda: registry.set_tags(name, 7, {"a": "b"}),
        lambda: registry.remove_tag(name, 7, "a"),
        lambda: registry.download(gone, tmp_path / "bundle"),
    ):
        with pytest.raises(ModelNotFoundError):
            call()
    assert registry.versions("nobody") == ()
    assert list(tmp_path.glob("*bundle*")) == []


def test_a_bundle_with_another_digest_is_not_registered(
    registry: ModelRegistry, bundle: Bundle, other: Bundle, run_id: str, model_name: str
) -> None:
    with pytest.raises(BundleIntegrityError):
        registry.register(model_name, bundle.folder, run_id, other.digest, {})
    assert registry.versions(model_name) == ()
