"""A registry and a data folder that an earlier release left: one job over, one stopped before its last trial.

``earlier/schema_2.tar.xz`` was made at commit 9008868, when ``bundle.json`` had schema 2 and a data set's
manifest schema 1: the jobs ``whole`` and ``stopped`` with the settings below, the second ended by SIGTERM.
"""

import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from cspace.bundle import Bundle
from services.names import MODEL_NAME
from services.registry.models.mlflow_registry import MlflowRegistry
from tests.chaos.checks import left_behind
from tests.chaos.system import System

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

STATE = Path(__file__).parent / "earlier" / "schema_2.tar.xz"
DATA = ("scenario_count=12", "extra_image_count=4", "free_per_scenario=32", "collision_per_scenario=8")
WHOLE = (*(f"data.{value}" for value in DATA), "data.shard_size=12")
STOPPED = (*WHOLE, "global.steps=40")
STEPS = {"vae": 6, "validity": 6, "local-0": 6, "local-1": 6, "global": 40}


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp("earlier")
    with tarfile.open(STATE) as archive:
        archive.extractall(folder, filter="data")
    with System(folder / "server", folder / "data") as system:
        yield system


def kept(system: System) -> dict[str, tuple[int, bytes]]:
    """Times and content of what the jobs had trained, and of the data."""
    files = [*system.data.rglob("step-*/*"), *(system.data / "datasets").rglob("*.*")]
    return {
        str(path.relative_to(system.data)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files
    }


def test_a_registered_version_is_read_and_answers_as_it_did(system: System, tmp_path: Path) -> None:
    registry = MlflowRegistry(system.server.address)
    (version,) = registry.versions(MODEL_NAME)
    # Loading replays the request and the answers that it was registered with.
    bundle = Bundle.load(registry.download(version, tmp_path / "bundle"))
    assert (version.number, bundle.digest) == (1, version.digest)


def test_a_job_that_was_over_is_over(system: System) -> None:
    before = kept(system)
    driver = system.submit("whole", WHOLE)
    assert driver.wait() == 0, driver.printed
    assert driver.result["version"] == 1
    assert kept(system) == before


def test_a_job_that_was_stopped_goes_on_and_trains_only_what_is_left(system: System) -> None:
    before = kept(system)
    driver = system.submit("stopped", STOPPED)
    assert driver.wait() == 0, driver.printed
    left = left_behind(system.server.address, system.data, driver.result, STEPS, every=2)
    assert left.version == 2
    now = kept(system)
    assert before.items() <= now.items()
    assert {Path(name).parents[1].name for name in now.keys() - before.keys()} == {"global"}
