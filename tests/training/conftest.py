"""What jobs that run as a user runs them need."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.contracts.mlflow_server import mlflow_server


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a tracking server of the module's own."""
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as uri:
        yield uri


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a module's jobs put their data."""
    return tmp_path_factory.mktemp("data")
