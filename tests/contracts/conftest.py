"""What fakes keep as MLflow does runs on both: on the fake, and on MLflow over a database file."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.run_records import RunRecord, read_fake, read_mlflow
from tests.fakes.registry import FakeRegistry, FakeTracking

BACKENDS = ["fake", "database"]
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Backend:
    """Tracking, registry, and a way to read runs back, all on one store."""

    tracking: Tracking
    registry: ModelRegistry
    read: Callable[[str], RunRecord]


@pytest.fixture(scope="session")
def server_uri(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with mlflow_server(tmp_path_factory.mktemp("mlflow-server")) as uri:
        yield uri


@pytest.fixture(scope="session")
def database_uri(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("mlflow-database")
    with pytest.MonkeyPatch.context() as patch:
        # The store fixes its folder of artifacts, ./mlruns, when it is opened for the first time.
        patch.chdir(folder)
        return mlflow_backend(f"sqlite:///{folder / 'mlflow.db'}")[0]


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest, tmp_path: Path) -> Backend:
    if request.param == "fake":
        tracking = FakeTracking()
        registry = FakeRegistry(tmp_path / "fake-registry", tracking.runs)
        return Backend(tracking, registry, lambda run_id: read_fake(tracking, run_id))
    return mlflow_backend(request.getfixturevalue(f"{request.param}_uri"))[1]


@pytest.fixture
def tracking(backend: Backend) -> Tracking:
    return backend.tracking


@pytest.fixture
def registry(backend: Backend) -> ModelRegistry:
    return backend.registry


@pytest.fixture
def model_name() -> str:
    """A model that no other test knows."""
    return f"model-{next(_numbers)}"


def mlflow_backend(uri: str) -> tuple[str, Backend]:
    """Tracking and registry at an address, which is returned as well."""
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=uri, registry_uri=uri)
    tracking = Tracking(uri)
    return uri, Backend(
        tracking,
        ModelRegistry(uri),
        lambda run_id: read_mlflow(client, run_id),
    )
