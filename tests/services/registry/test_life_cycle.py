"""What people do with versions by hand, on the registry in memory, and the command where no server is."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import psutil
import pytest

from cspace.bundle import Bundle
from cspace.errors import BundleError, ConfigError, ModelNotFoundError
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, TAG_ROLLED_BACK
from services.registry.__main__ import main
from services.registry.entities import ModelVersion
from services.registry.promotion import (
    decisions,
    decisions_of,
    delete,
    import_version,
    promote,
    record_decision,
    roll_back,
)
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking
from tests.inference_api.bad_bundles import write_hungry_bundle

NAME = "cspace-sampler"


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> list[Bundle]:
    folder = tmp_path_factory.mktemp("bundles")
    return [Bundle.load(write_tiny_bundle(folder / str(n), scale=n / 4)) for n in (1, 2, 3)]


@pytest.fixture
def registry(tmp_path: Path, bundles: list[Bundle]) -> FakeRegistry:
    """Three versions of one model."""
    registry = FakeRegistry(tmp_path / "registry")
    for number, bundle in enumerate(bundles, 1):
        registry.register(NAME, bundle.folder, str(number), bundle.digest, {"preset": f"p{number}"})
    return registry


@pytest.fixture(autouse=True)
def quickly_verified(request: pytest.FixtureRequest) -> None:
    """But in the tests of the worker."""
    if "worker" not in request.node.name:
        request.getfixturevalue("verified_here")


def champion(registry: FakeRegistry) -> int:
    return registry.by_alias(NAME, ALIAS_CHAMPION).number


def version(registry: FakeRegistry, number: int) -> ModelVersion:
    return registry.version(NAME, number)


def promote_all(registry: FakeRegistry, *numbers: int) -> None:
    for number in numbers:
        promote(registry, version(registry, number), "better")


def test_a_promotion_by_hand_is_a_decision_with_its_reason(registry: FakeRegistry) -> None:
    promote(registry, version(registry, 2), "the demo is today")
    assert champion(registry) == 2
    (decision,) = decisions_of(version(registry, 2))
    assert (decision.promoted, decision.reasons) == (True, ("by hand: the demo is today",))
    assert decision.robot is not None


def test_a_damaged_version_is_not_promoted(registry: FakeRegistry, tmp_path: Path) -> None:
    (tmp_path / "registry" / NAME / "2" / "generator.onnx").write_bytes(b"damaged")
    with pytest.raises(BundleError):
        promote(registry, version(registry, 2), "in a hurry")
    assert decisions(registry, NAME) == ()


def tagged(registry: FakeRegistry) -> list[int]:
    """The versions that were rolled back from."""
    return [one.number for one in registry.versions(NAME) if TAG_ROLLED_BACK in one.tags]


def test_rolling_back_walks_down_the_row_of_champions_and_dates_those_that_were_left(
    registry: FakeRegistry,
) -> None:
    promote_all(registry, 1, 2, 3)
    assert tagged(registry) == []
    assert roll_back(registry, NAME, "worse in the field").version == 2
    left = datetime.fromisoformat(version(registry, 3).tags[TAG_ROLLED_BACK])
    assert abs((datetime.now(UTC) - left).total_seconds()) < 3600
    assert roll_back(registry, NAME, "that one as well").version == 1
    with pytest.raises(ModelNotFoundError, match="rolled back"):
        roll_back(registry, NAME, "and again")
    assert champion(registry) == 1
    assert tagged(registry) == [3, 2]
    # Whatever makes a version champion takes the date off, and a refusal does not.
    decision = decisions_of(version(registry, 3))[-1]
    record_decision(registry, replace(decision, promoted=False))
    assert tagged(registry) == [3, 2]
    record_decision(registry, decision)
    assert tagged(registry) == [2]
    assert roll_back(registry, NAME, "it was not").version == 1


def test_what_an_alias_names_is_not_deleted(registry: FakeRegistry) -> None:
    registry.set_alias(NAME, ALIAS_CHALLENGER, 3)
    with pytest.raises(ConfigError, match="in use"):
        delete(registry, version(registry, 3))
    assert version(registry, 3)


def test_an_exported_bundle_is_imported_once(registry: FakeRegistry, tmp_path: Path) -> None:
    folder = registry.download(version(registry, 2), tmp_path / "out")
    elsewhere, tracking = FakeRegistry(tmp_path / "elsewhere"), FakeTracking()
    for _ in range(2):
        came = import_version(elsewhere, tracking, folder, "mine")
    assert elsewhere.versions("mine") == (came,)
    assert (came.digest, came.aliases) == (version(registry, 2).digest, (ALIAS_CHALLENGER,))


OWN, OTHER = PlanarArm((1.0, 1.0)), PlanarArm((1.0, 1.1))
OWN_NAME = f"planar-{robot_digest(PlanarWorld(OWN))[:8]}"


@pytest.mark.parametrize(
    ("robot", "name", "advice"),
    [
        (THREE_LINK, "path-sampler", "three-link-sampler"),
        (THREE_LINK, "two-link-sampler", "three-link-sampler"),
        (OWN, "three-link-sampler", f"{OWN_NAME}-sampler"),
        (OTHER, f"{OWN_NAME}-sampler", "planar-"),
        (TWO_LINK, f"{OWN_NAME}-path-sampler", "cspace-sampler"),
    ],
)
def test_a_version_is_not_imported_under_a_name_of_another_robot(robot, name, advice, tmp_path) -> None:
    registry, tracking = FakeRegistry(tmp_path / "registry"), FakeTracking()
    bundle = write_tiny_bundle(tmp_path / "bundle", robot)
    with pytest.raises(ConfigError, match=f"another robot's.*{advice}"):
        import_version(registry, tracking, bundle, name)
    assert (registry.names(), tracking.runs) == ((), {})


def test_a_version_is_not_imported_where_the_registry_has_those_of_another_robot(tmp_path) -> None:
    registry, tracking = FakeRegistry(tmp_path / "registry"), FakeTracking()
    import_version(registry, tracking, write_tiny_bundle(tmp_path / "own", OWN), "arm-7-sampler")
    bundle = write_tiny_bundle(tmp_path / "other", OTHER)
    with pytest.raises(ConfigError, match=r"arm-7-sampler/1 is of robot.*planar-"):
        import_version(registry, tracking, bundle, "arm-7-sampler")
    assert [len(registry.versions(name)) for name in registry.names()] == [1]
    assert import_version(registry, tracking, bundle, "arm-8-sampler").number == 1


@pytest.mark.parametrize(
    ("environment", "code"), [({}, 2), ({"MLFLOW_TRACKING_URI": "http://127.0.0.1:1"}, 1)]
)
def test_no_server_is_told_by_the_exit_code(
    environment: dict[str, str], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["models", "list"], environment) == code
    assert "error: " in capsys.readouterr().err


def test_a_worker_verifies_what_is_imported_and_ends_what_takes_memory(
    registry: FakeRegistry, tmp_path: Path
) -> None:
    hungry = write_hungry_bundle(tmp_path / "hungry")
    before = psutil.Process().memory_info().rss
    with pytest.raises(BundleError, match="memory"):
        import_version(registry, FakeTracking(), hungry, NAME)
    assert psutil.Process().memory_info().rss - before < 20 * 2**20
    assert len(registry.versions(NAME)) == 3
